"""Parameters and states estimated together along the records: where a fit of a mechanism starts.

The records are assimilated piece by piece, as an iterated extended Kalman filter does, in square
root information form (G. J. Bierman, Factorization Methods for Discrete Sequential Estimation,
1977; B. M. Bell, SIAM J. Optim. 4 (1994) 626, for the iterated smoother as Gauss-Newton). What the
pieces so far say of the state x and of all numbers g that are fitted is kept as rows

    | C_x (x - x') + C_g (g - g') - c |^2 ,

and each piece is a small least-squares problem: these rows, its own residuals, unit normal numbers
for the noise of inputs and the process noise. Motion is predicted over one piece only, from where
the measurements put the machine, so that impacts and what follows them stay nearly linear. Pieces
are halved where a step does not do what its linear model promises, and doubled again after.

Then the states are smoothed from the last piece to the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import Linear, Place, linearize, predict_ends
from feltmb.fit.model import Memory
from feltmb.fit.observe import machine_candidates
from feltmb.fit.problem import Point, Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.watch import current

__all__ = ["assimilate"]

#: Steps of a piece at most; a step has to give this share of what it promises, and is cut by this.
ITERATIONS, PROMISED, SHORTER, CUTS = 25, 0.25, 0.4, 5
#: A gain of the sum of squares below this ends a piece [1].
DECREMENT = 0.3
#: Fewest intervals of a piece.
LEAST = 4
#: Noise in the residual of a piece, in standard deviations of its sum of squares, above which it is
#: tried again in two halves, and what is always allowed.
ABOVE, SLACK = 8.0, 20.0
#: Precision of what is known exactly, as a share of its scale.
EXACT = 1e-9


@dataclass
class _Known:
    """Rows that say what is known of a state and of the globals, about a place."""

    state: Array
    """(rows, nx)"""
    shared: Array
    """(rows, ng)"""
    right: Array
    """(rows,)"""

    def moved(self, state: Array, shared: Array) -> _Known:
        """About a place that is so far away."""
        right = self.right - self.state @ state - self.shared @ shared
        return _Known(self.state, self.shared, right)

    @property
    def cost(self) -> float:
        return float(self.right @ self.right)


@dataclass
class _Step:
    """What is needed to go back through a piece: rows of its own unknowns over what follows."""

    own: Array
    after: Array
    shared: Array
    right: Array
    inputs: int
    x: Array
    g: Array
    end: Array
    segment: int
    """Of which it is the first piece, else -1."""


@dataclass
class _Place:
    """Where a piece stands."""

    x: Array
    g: Array
    known: _Known
    linear: Linear
    cost: float
    """Without that of the rows known at its beginning."""


def assimilate(problem: Problem, point: Point, gap_sd: Array, *, held: bool = False) -> Point:
    """A point from which a fit of all records converges.

    Parameters
    ----------
    problem
        Segmented records and a model with states.
    point
        Where to start: its parameters and magnitudes; its start states are not looked at.
    gap_sd
        Standard deviation of the continuity defect between pieces, by state [its unit].
    held
        Whether parameters and magnitudes stay as they are and the states alone are estimated.

    Returns
    -------
    Point
        Parameters after the last record; start states smoothed along each record.
    """
    theta, magnitudes = point.theta.copy(), point.magnitudes.copy()
    shared = len(problem.free) + len(problem.included)
    g = np.concatenate([theta[problem.free], magnitudes])
    rows, right = _prior(problem)
    right = right - rows @ g
    if held:
        scale = [problem.model.parameters[i].size for i in problem.free]
        scale += [t.effect.scale for t in problem.included]
        rows, right = np.diag(1.0 / (EXACT * np.array(scale))), np.zeros(shared)
    known = _Known(np.zeros((shared, 0)), rows, right)
    places: list[Place] = []
    for i, segmented in enumerate(problem.segmented_records):
        run = _Record(problem, segmented, point, g, known, point.places[i], gap_sd)
        g, known, place = run.through()
        places.append(place)
        if current().stopping():
            return Point(*_split(problem, point, g), (*places, *point.places[i + 1 :]))
    return Point(*_split(problem, point, g), tuple(places))


def _prior(problem: Problem) -> tuple[Array, Array]:
    """Rows of the priors of parameters and magnitudes, and their right-hand side at zero."""
    parameters = [problem.model.parameters[i] for i in problem.free]
    weight = np.array([1.0 / p.sd if np.isfinite(p.sd) else 0.0 for p in parameters])
    mean = np.array([p.value for p in parameters])
    extra = np.zeros(len(problem.included))
    rows = np.diag(np.concatenate([weight, extra]))
    return rows, np.concatenate([weight * mean, extra])


def _split(problem: Problem, point: Point, g: Array) -> tuple[Array, Array]:
    count = len(problem.free)
    theta = point.theta.copy()
    theta[problem.free] = g[:count]
    return theta, g[count : count + len(problem.included)].copy()


class _Record:
    """One record on its way through the filter."""

    def __init__(
        self,
        problem: Problem,
        segmented: SegmentedRecord,
        point: Point,
        g: Array,
        known: _Known,
        place: Place,
        gap_sd: Array,
    ):
        self.problem, self.segmented, self.point = problem, segmented, point
        self.gap_sd = gap_sd
        self.model = problem.model
        self.memory: Memory | None = None if place.memory is None else place.memory[:1]
        self.shared = g.size
        own = np.array([sd for _, _, sd in segmented.nuisances])
        self.g = np.concatenate([g, place.nuisances])
        mean, sd = problem.start_prior(segmented)
        states = problem.model.states(machine_candidates(problem.included))
        scale = np.array([s.scale for s in states])
        weight = 1.0 / np.maximum(np.where(np.isfinite(sd), sd, np.inf), EXACT * scale)
        self.x = np.where(np.isfinite(sd), mean, place.starts[0])
        nx, nn, rows = self.x.size, own.size, known.right.size
        self.known = _Known(
            np.vstack([np.diag(weight), np.zeros((rows + nn, nx))]),
            np.block(
                [
                    [np.zeros((nx, g.size + nn))],
                    [known.shared, np.zeros((rows, nn))],
                    [np.zeros((nn, g.size)), np.diag(1.0 / own)],
                ]
            ),
            np.concatenate([weight * (mean - self.x), known.right, -place.nuisances / own]),
        )
        parameters = [problem.model.parameters[i] for i in problem.free]
        limits = [(p.lower, p.upper) for p in parameters]
        limits += [t.effect.bounds for t in problem.included]
        limits += [(-np.inf, np.inf)] * nn
        self.low, self.high = np.array(limits, dtype=np.float64).reshape(-1, 2).T
        self.steps: list[_Step] = []

    def through(self) -> tuple[Array, _Known, Place]:
        """Globals after the record, what is known of them, and the smoothed record."""
        segments = self.segmented.segments
        starts_memory: list[object] = []
        for w, (begin, end) in enumerate(segments):
            starts_memory.append(None if self.memory is None else self.memory[0])
            first, longest = int(begin), int(end - begin)
            length = longest
            while first < int(end):
                if current().stopping():
                    break
                length = min(length, int(end) - first)
                piece = self.segmented.piece(w, first, first + length)
                at, sound = self._fit(piece, length > LEAST)
                if not sound and length > LEAST:
                    length = max(length // 2, LEAST)
                    continue
                last = w == len(segments) - 1 and first + length == int(end)
                self._leave(piece, at, w if first == int(begin) else -1, last=last)
                first += length
                length = min(2 * length, longest)
        starts = self._smoothed(len(segments))
        memory = None if starts_memory[-1] is None else tuple(starts_memory)
        count = self.shared
        rest = _triangle(
            np.hstack(
                [
                    self.known.shared[:, count:],
                    self.known.shared[:, :count],
                    self.known.right[:, None],
                ]
            )
        )
        nn = self.g.size - count
        rows = rest[nn:, nn:]
        known = _Known(np.zeros((len(rows), 0)), rows[:, :-1], rows[:, -1])
        return self.g[:count], known, Place(starts, self.g[count:], memory)

    # --- one piece ------------------------------------------------------------------------------

    def _numbers(self, g: Array) -> tuple[Array, Array, Array]:
        theta, magnitudes = _split(self.problem, self.point, g)
        return theta, magnitudes, g[self.shared :]

    def _linearize(self, piece: SegmentedRecord, x: Array, g: Array) -> Linear:
        theta, magnitudes, nuisances = self._numbers(g)
        return linearize(
            self.model,
            piece,
            theta,
            self.problem.free,
            self.problem.included,
            magnitudes,
            Place(x[None], nuisances, self.memory),
            (),
            self.problem.input_knots,
        )

    def _look(
        self, piece: SegmentedRecord, x: Array, g: Array
    ) -> tuple[Array, Array, Memory | None]:
        """Whitened residual, end state and memory of a piece."""
        theta, magnitudes, nuisances = self._numbers(g)
        return predict_ends(
            self.model,
            piece,
            theta,
            self.problem.included,
            magnitudes,
            Place(x[None], nuisances, self.memory),
        )

    def _fit(self, piece: SegmentedRecord, may_split: bool) -> tuple[_Place, bool]:
        """The piece with what is known before it; whether its steps did what they promised."""
        x, g, known = self.x, self.g, self.known
        before = known.cost
        linear = self._linearize(piece, x, g)
        if not linear.good[0]:
            return _Place(x, g, known, linear, np.inf), False
        cost = _without_noise(linear, linear.residual[0]) + before
        for _ in range(ITERATIONS):
            step, promised = self._step(linear, known, cost)
            if promised < DECREMENT:
                break
            share, found = 1.0, None
            for _ in range(CUTS):
                there = x + share * step[: x.size]
                to = np.clip(g + share * step[x.size :], self.low, self.high)
                residual, end, _ = self._look(piece, there, to)
                if np.all(np.isfinite(end)) and np.all(np.isfinite(residual)):
                    rows = known.moved(there - x, to - g)
                    new = _without_noise(linear, residual) + rows.cost
                    if cost - new > PROMISED * share * promised:
                        found = (there, to, rows, new)
                        break
                share *= SHORTER
            if found is None or (share < SHORTER and may_split):
                if may_split:
                    return _Place(x, g, known, linear, cost - before), False
                break
            small = cost - found[3] < 0.5
            x, g, known, _ = found
            linear = self._linearize(piece, x, g)
            cost = _without_noise(linear, linear.residual[0]) + known.cost
            if small:
                break
        n = float(piece.samples.sum())
        sound = cost - before < n + ABOVE * np.sqrt(2.0 * n) + SLACK
        return _Place(x, g, known, linear, cost - before), bool(sound)

    def _step(self, linear: Linear, known: _Known, cost: float) -> tuple[Array, float]:
        """Gauss-Newton step of state and globals, and the gain of its linear model."""
        inputs = linear.by_input.shape[2]
        nx = self.x.size
        rows = np.vstack(
            [
                np.hstack([linear.by_input[0], linear.by_state[0], linear.by_global[0]]),
                np.hstack([np.zeros((known.right.size, inputs)), known.state, known.shared]),
                np.hstack([np.eye(inputs), np.zeros((inputs, nx + self.g.size))]),
            ]
        )
        right = np.concatenate([linear.residual[0], known.right, np.zeros(inputs)])
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        solved = np.linalg.lstsq(rows / size, right, rcond=1e-13)[0] / size
        left = right - rows @ solved
        return solved[inputs:], cost - float(left @ left)

    def _leave(self, piece: SegmentedRecord, at: _Place, segment: int, *, last: bool) -> None:
        """Take over what the piece says, and go on to its end."""
        linear, known = at.linear, at.known
        inputs, nx, ng = linear.by_input.shape[2], at.x.size, at.g.size
        extra = 0 if last else nx
        m = linear.residual.shape[1]
        rows = [
            np.hstack(
                [
                    linear.by_input[0],
                    linear.by_state[0],
                    np.zeros((m, extra)),
                    linear.by_global[0],
                    linear.residual[0][:, None],
                ]
            ),
            np.hstack(
                [
                    np.zeros((known.right.size, inputs)),
                    known.state,
                    np.zeros((known.right.size, extra)),
                    known.shared,
                    known.right[:, None],
                ]
            ),
            np.hstack([np.eye(inputs), np.zeros((inputs, nx + extra + ng + 1))]),
        ]
        _, end, memory = self._look(piece, at.x, at.g)
        if not last:
            inverse = 1.0 / self.gap_sd
            rows.append(
                np.hstack(
                    [
                        -inverse[:, None] * linear.ends_by_input[0],
                        -inverse[:, None] * linear.ends_by_state[0],
                        np.diag(inverse),
                        -inverse[:, None] * linear.ends_by_global[0],
                        np.zeros((nx, 1)),
                    ]
                )
            )
        r = _triangle(np.vstack(rows))
        own = inputs + nx
        self.steps.append(
            _Step(
                own=r[:own, :own],
                after=r[:own, own : own + extra],
                shared=r[:own, own + extra : -1],
                right=r[:own, -1],
                inputs=inputs,
                x=at.x,
                g=at.g,
                end=end,
                segment=segment,
            )
        )
        rest = r[own : own + extra + ng]
        self.known = _Known(rest[:, own : own + extra], rest[:, own + extra : -1], rest[:, -1])
        self.x, self.g = (end if not last else at.x), at.g
        self.memory = memory

    def _smoothed(self, count: int) -> Array:
        """Start states of the segments, from the last to the first."""
        starts = np.zeros((count, self.x.size))
        # What is known after the last piece moves the globals once more.
        g = self.g + np.linalg.lstsq(self.known.shared, self.known.right, rcond=1e-13)[0]
        self.known = self.known.moved(np.zeros(self.known.state.shape[1]), g - self.g)
        self.g = np.clip(g, self.low, self.high)
        x = self.x
        for i, step in enumerate(reversed(self.steps)):
            right = step.right - step.shared @ (self.g - step.g)
            if i:
                right = right - step.after @ (x - step.end)
            moved = np.linalg.lstsq(step.own, right, rcond=1e-13)[0]
            x = step.x + moved[step.inputs :]
            if step.segment >= 0:
                starts[step.segment] = x
        return starts


def _without_noise(linear: Linear, residual: Array) -> float:
    """Sum of squares of a residual less what unit normal numbers of the noise explain."""
    columns = linear.by_input[0]
    pull = columns.T @ residual
    matrix = columns.T @ columns + np.eye(columns.shape[1])
    return float(residual @ residual - pull @ np.linalg.solve(matrix, pull))


def _triangle(rows: Array) -> Array:
    """Upper triangle of a QR factorization, as many rows as columns."""
    r: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    if r.shape[0] < r.shape[1]:
        r = np.vstack([r, np.zeros((r.shape[1] - r.shape[0], r.shape[1]))])
    return r
