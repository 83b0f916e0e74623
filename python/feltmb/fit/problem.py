"""The least-squares problem of fitting a model with some effects to records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array
from feltmb.files import Store
from feltmb.fit.filter import Chain, reduce_chain
from feltmb.fit.linearize import InputColumns, Linear, Place, linearize, with_nuisances
from feltmb.fit.model import VARIABILITY, Candidate, Jobs, Model, by_segment, with_hidden
from feltmb.fit.observe import machine_candidates, observe_all
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.watch import current

__all__ = ["Normal", "Point", "Problem"]

#: What is known of an unknown start state beside the records, if they tell nothing of it: one over
#: its standard deviation [1 / scale of the state].
FAINT_START = 1e-3


@dataclass(frozen=True, eq=False)
class Point:
    """Parameters, magnitudes, and the start states and nuisances of every segmented record."""

    theta: Array
    magnitudes: Array
    places: tuple[Place, ...]
    memo: dict[object, tuple[object, list[Linear]]] = field(default_factory=dict, repr=False)
    """Linearizations that were already computed at this point."""


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations for the globals, with the states eliminated.

    Globals are the parameters, the magnitudes, the candidates, and then the nuisances of each
    record. ``columns`` holds the indices that belong to a segmented record.
    """

    matrix: Array
    right: Array
    chains: tuple[Chain, ...]
    columns: tuple[Array, ...]
    shared: int
    """Number of globals that are common to all records."""

    def gain(self, delta: Array) -> float:
        """Reduction of the sum of squares by a step of the globals, to second order."""
        return float(2.0 * self.right @ delta - delta @ self.matrix @ delta)


@dataclass(frozen=True, eq=False)
class Problem:
    """A model with some included effects, to be fitted to segmented records."""

    model: Model
    segmented_records: tuple[SegmentedRecord, ...]
    included: tuple[Candidate, ...] = ()
    state_scale: Array | None = None
    """Unit of the continuity defects, by state [its unit]."""
    frozen: bool = False
    """Whether parameters and magnitudes are fixed (for held-out records)."""
    fixed: tuple[int, ...] = ()
    """Indices of magnitudes that are fixed."""
    store: Store | None = None
    """Store for finished optimizations; None: they are not stored."""
    refuted: tuple[str, ...] = ()
    """Parameters without a prior, because the records refute it."""

    @property
    def free(self) -> list[int]:
        """Indices of the fitted parameters."""
        if self.frozen:
            return []
        return [i for i, p in enumerate(self.model.parameters) if p.sd > 0.0]

    @property
    def has_priors(self) -> bool:
        """Whether every fitted parameter has a prior."""
        return all(np.isfinite(self.model.parameters[i].sd) for i in self.free)

    @property
    def samples(self) -> int:
        """Number of measured values."""
        return int(sum(s.samples.sum() for s in self.segmented_records))

    def start(self, magnitudes: Array | None = None, theta: Array | None = None) -> Point:
        """Point with the prior means and the start states that the model estimates."""
        if theta is None:
            theta = np.array([p.value for p in self.model.parameters], dtype=np.float64)
        states = self.model.states(machine_candidates(self.included))
        guesses = self.model.guess(
            [s.record for s in self.segmented_records],
            [s.segments for s in self.segmented_records],
        )
        places = tuple(
            Place(with_hidden(guess, states), np.zeros(len(segmented.nuisances)))
            for guess, segmented in zip(guesses, self.segmented_records, strict=True)
        )
        size = np.zeros(len(self.included)) if magnitudes is None else magnitudes
        return Point(theta, size, places)

    def scale(self, point: Point) -> Array:
        """Spread of each state over the segments; at least a small share of its declared scale."""
        states = self.model.states(machine_candidates(self.included))
        if not states:
            return np.zeros(0)
        starts = np.vstack([p.starts for p in point.places])
        spread = np.std(starts, axis=0)
        declared = np.array([s.scale for s in states])
        # A memory state of an effect has no spread while the magnitude of the effect is small.
        known = np.where([s.hidden for s in states], 1.0, 1e-3) * declared
        if self.state_scale is not None:
            known[: len(self.state_scale)] = self.state_scale
            spread[: len(self.state_scale)] = 0.0
        return np.asarray(np.maximum(spread, known))

    def start_prior(self, segmented: SegmentedRecord) -> tuple[Array, Array]:
        """Mean and standard deviation of the state at the first sample of a segmented record."""
        states = self.model.states(machine_candidates(self.included))
        prior = segmented.record.start
        mean = np.array([s.start for s in states])
        sd = np.array(
            [s.scale if s.hidden and np.isinf(s.start_sd) else s.start_sd for s in states]
        )
        if prior is not None and not prior.known:
            sd = np.array([s.scale if s.hidden else np.inf for s in states])
        if prior is not None:
            for i, s in enumerate(states):
                if s.name in prior.mean:
                    mean[i] = prior.mean[s.name]
                if s.name in prior.sd:
                    sd[i] = prior.sd[s.name]
        return mean, sd

    def log_start_prior(self, segmented: SegmentedRecord, linear: Linear) -> float:
        """Log normalization of the prior of the state at the first sample of a segmented record.

        Without it, every hidden state with a known start would cost an effect -log(1e-12) = 28
        units of log evidence per record. For unknown states, whose prior is flat, it is half the
        log determinant of what the first samples tell of them, in as many segments as have that
        many values. The evidence then does not depend on the unit of a state, nor on a gain of the
        sensor that shows it [Francke, Koopman and de Vos, J. Time Series Analysis 31 (2010) 407].
        """
        _, sd = self.start_prior(segmented)
        stated = -float(np.sum(np.log(np.maximum(sd[np.isfinite(sd)], 1e-12))))
        unknown = np.flatnonzero(np.isinf(sd))
        if not unknown.size:
            return stated
        states = self.model.states(machine_candidates(self.included))
        least = FAINT_START / np.array([states[i].scale for i in unknown])
        known = np.diag(least**2)
        by_start = np.eye(len(states))[:, unknown]
        values = np.cumsum(segmented.samples.sum(axis=1))
        for w in range(1 + min(int(np.sum(values < unknown.size)), segmented.count - 1)):
            seen = linear.by_state[w] @ by_start
            known = known + seen.T @ seen
            by_start = linear.ends_by_state[w] @ by_start
        return stated + 0.5 * float(np.linalg.slogdet(known)[1])

    def cost(
        self, point: Point, defect_sd: Array, linears: Sequence[Linear]
    ) -> tuple[float, list[Array]]:
        """Sum of squares, and its part by segment of every record; infinite if a simulation fails.

        The noise of the inputs is eliminated with the derivatives in ``linears``, as in the
        computation of steps. Otherwise steps and their acceptance would use different functions.
        """
        current().step()
        seen = self.predict(point)
        return self._cost(
            point, defect_sd, linears, [(residual, defect) for _, residual, defect in seen]
        )

    def predict(self, point: Point) -> list[tuple[Array, Array, Array]]:
        """Outputs, whitened residual and continuity defects of each record.

        Their shapes are (W, L, ny), (W, m) and (W - 1, nx).
        """
        records, included = self.segmented_records, self.included
        batches = [
            (
                s.record,
                Jobs.at_point(point.theta, s.segments, at.starts, included, point.magnitudes),
            )
            for s, at in zip(records, point.places, strict=True)
        ]
        found = []
        for s, at, run in zip(records, point.places, observe_all(self.model, batches), strict=True):
            outputs, _ = with_nuisances(s, run.outputs[:, : s.measured.shape[1]], at.nuisances)
            with np.errstate(over="ignore", invalid="ignore"):
                residual = s.whiten(s.measured - outputs)
            found.append((outputs, residual.reshape(s.count, -1), run.ends[:-1] - at.starts[1:]))
        return found

    def cost_at(
        self, point: Point, defect_sd: Array, linears: Sequence[Linear]
    ) -> tuple[float, list[Array]]:
        """Sum of squares at the point of the linearization, without a simulation."""
        seen = [(np.where(x.good[:, None], x.residual, np.inf), x.defect) for x in linears]
        return self._cost(point, defect_sd, linears, seen)

    def _cost(
        self,
        point: Point,
        defect_sd: Array,
        linears: Sequence[Linear],
        seen: Sequence[tuple[Array, Array]],
    ) -> tuple[float, list[Array]]:
        total, parts = 0.0, []
        for segmented, place, linear, (residual, defect) in zip(
            self.segmented_records, point.places, linears, seen, strict=True
        ):
            with np.errstate(over="ignore", invalid="ignore"):
                part = np.sum(residual**2, axis=1)
                part -= _by_input_noise(linear, residual, defect, defect_sd)
                if defect.shape[1]:
                    tied = np.sum((defect / defect_sd) ** 2, axis=1)
                    part[:-1] += tied
                    mean, sd = self.start_prior(segmented)
                    known = np.isfinite(sd)
                    part[0] += np.sum(
                        ((place.starts[0] - mean)[known] / np.maximum(sd[known], 1e-12)) ** 2
                    )
            part = np.where(np.isfinite(part), part, np.inf)
            parts.append(part)
            total += float(np.sum(part))
        return self.prior_cost(point, total), parts

    def prior_cost(self, point: Point, total: float = 0.0) -> float:
        """``total`` and the part of the sum of squares that does not belong to a segment."""
        for segmented, place in zip(self.segmented_records, point.places, strict=True):
            for (_, _, sd), value in zip(segmented.nuisances, place.nuisances, strict=True):
                total += float((value / sd) ** 2)
        for i in self.free:
            p = self.model.parameters[i]
            total += float(((point.theta[i] - p.value) / p.sd) ** 2)
        return total

    def linear(
        self,
        point: Point,
        candidates: tuple[Candidate, ...] = (),
        known: Sequence[Linear | InputColumns] | None = None,
    ) -> list[Linear]:
        """Residuals and derivatives of all segmented records, computed once per point.

        ``known``: nearby linearizations, whose derivatives by the input noise are reused.
        """
        key = (
            tuple(id(segmented) for segmented in self.segmented_records),
            tuple((id(t.effect), repr(t.shape)) for t in (*self.included, *candidates)),
            len(candidates),
            self.frozen,
        )
        if key in point.memo:
            return point.memo[key][1]
        current().step()
        made = linearize(
            self.model,
            self.segmented_records,
            point.theta,
            self.free,
            self.included,
            point.magnitudes,
            point.places,
            candidates,
            known,
        )
        if not candidates:  # keeps objects alive whose id is part of the key
            point.memo[key] = ((self.segmented_records, self.included), made)
        return made

    def normal(
        self,
        point: Point,
        linears: Sequence[Linear],
        defect_sd: Array,
        damping: Sequence[Array | None] | None = None,
        *,
        keep_rows: bool = False,
        keep_heads: bool = False,
    ) -> Normal:
        """Eliminate the states and sum over the records."""
        chains = []
        for i, (segmented, place, linear) in enumerate(
            zip(self.segmented_records, point.places, linears, strict=True)
        ):
            mean, sd = self.start_prior(segmented)
            offset = mean - place.starts[0] if place.starts.shape[1] else np.zeros(0)
            chains.append(
                reduce_chain(
                    linear,
                    defect_sd,
                    offset,
                    sd,
                    None if damping is None else damping[i],
                    keep_rows=keep_rows,
                    keep_heads=keep_heads,
                )
            )
        nuisances = [len(s.nuisances) for s in self.segmented_records]
        shared = linears[0].by_global.shape[2] - nuisances[0]
        size = shared + sum(nuisances)
        matrix, right = np.zeros((size, size)), np.zeros(size)
        columns, at = [], shared
        for segmented, place, chain, nn in zip(
            self.segmented_records, point.places, chains, nuisances, strict=True
        ):
            own = np.concatenate([np.arange(shared), np.arange(at, at + nn)])
            gram = np.sum(chain.grams, axis=0)
            matrix[np.ix_(own, own)] += gram[:-1, :-1]
            right[own] += gram[:-1, -1]
            for j, (_, _, sd_n) in enumerate(segmented.nuisances):
                matrix[at + j, at + j] += 1.0 / sd_n**2
                right[at + j] -= place.nuisances[j] / sd_n**2
            columns.append(own)
            at += nn
        for c, i in enumerate(self.free):
            p = self.model.parameters[i]
            if np.isfinite(p.sd):
                matrix[c, c] += 1.0 / p.sd**2
                right[c] += (p.value - point.theta[i]) / p.sd**2
        return Normal(matrix, right, tuple(chains), tuple(columns), shared)

    def room(self, point: Point) -> tuple[Array, Array]:
        """Distances of free parameters and magnitudes to their lower and upper limits, (p + k,)."""
        parameters = [self.model.parameters[i] for i in self.free]
        limits = [(p.lower, p.upper) for p in parameters]
        limits += [t.effect.bounds for t in self.included]
        at = np.concatenate([point.theta[self.free], point.magnitudes])
        low, high = np.array(limits, dtype=np.float64).reshape(-1, 2).T
        which = [len(self.free) + k for k in self.fixed]
        low[which] = high[which] = at[which]
        return low - at, high - at

    @property
    def reach(self) -> Array:
        """Unit of step lengths of free parameters and magnitudes, (p + k,).

        It is the prior standard deviation, or else the scale. It is infinite for the run-to-run
        variability, because its influence is linear.
        """
        parameters = [self.model.parameters[i] for i in self.free]
        units = [
            np.inf if p.component == VARIABILITY else p.sd if np.isfinite(p.sd) else p.size
            for p in parameters
        ]
        return np.array(units + [t.effect.scale for t in self.included], dtype=np.float64)

    def pressed(self, point: Point, normal: Normal) -> NDArray[np.bool_]:
        """Free parameters and magnitudes at a limit that a step would cross, (p + k,)."""
        low, high = self.room(point)
        push = normal.right[: low.size]
        return np.asarray(((low >= 0.0) & (push < 0.0)) | ((high <= 0.0) & (push > 0.0)))

    def newton(self, point: Point, normal: Normal, damping: Array | float = 0.0) -> Array:
        """Levenberg step of the globals within the limits of parameters and magnitudes.

        ``damping``: value that is added to the diagonal of the normal equations.
        """
        return self.newton_within(point, normal, damping)[0]

    def newton_within(
        self, point: Point, normal: Normal, damping: Array | float = 0.0
    ) -> tuple[Array, NDArray[np.bool_]]:
        """The step of :meth:`newton`, and the globals that no limit stops."""
        count = len(self.free) + len(self.included)
        low = np.full(normal.right.size, -np.inf)
        high = np.full(normal.right.size, np.inf)
        low[:count], high[:count] = self.room(point)
        matrix = normal.matrix + damping * np.eye(normal.right.size)
        fixed = np.zeros(normal.right.size, dtype=bool)
        fixed[count : normal.shared] = True  # candidates remain unchanged
        if self.frozen:
            fixed[: normal.shared] = True
        delta = np.zeros(normal.right.size)
        for _ in range(count + 1):
            open_ = ~fixed
            rhs = normal.right - matrix[:, fixed] @ delta[fixed]
            delta[open_] = solve_scaled(matrix[np.ix_(open_, open_)], rhs[open_])
            beyond = open_ & ((delta < low) | (delta > high))
            if not beyond.any():
                break
            delta[beyond] = np.clip(delta[beyond], low[beyond], high[beyond])
            fixed |= beyond
        return delta, ~fixed

    def step(self, point: Point, normal: Normal, damping: Array | float) -> tuple[Point, float]:
        """Point after a Levenberg step of :meth:`newton`, and its predicted gain."""
        delta = self.newton(point, normal, damping)
        return self.moved(point, normal, delta), normal.gain(delta)

    def moved(self, point: Point, normal: Normal, delta: Array) -> Point:
        """Point after a step of the globals."""
        free = self.free
        count = len(free) + len(self.included)
        theta = point.theta.copy()
        theta[free] += delta[: len(free)]
        magnitudes = point.magnitudes + delta[len(free) : count]
        for i in free:
            p = self.model.parameters[i]
            theta[i] = np.clip(theta[i], p.lower, p.upper)
        for k, candidate in enumerate(self.included):
            magnitudes[k] = np.clip(magnitudes[k], *candidate.effect.bounds)
        places = []
        for place, chain, own in zip(point.places, normal.chains, normal.columns, strict=True):
            moved = delta[own]
            starts = place.starts
            if starts.shape[1]:
                starts = starts + chain.back(moved)
            nuisances = place.nuisances + moved[normal.shared :]
            places.append(Place(starts, nuisances))
        return Point(theta, magnitudes, tuple(places))

    def with_candidates(self, included: tuple[Candidate, ...]) -> Problem:
        """The problem with the same records and other included effects."""
        return replace(self, included=included)

    def carry(self, point: Point, included: tuple[Candidate, ...], magnitudes: Array) -> Point:
        """Convert a point of this problem to the problem with other included effects.

        New hidden states start at their prior mean; hidden states that remain keep their values.
        """
        base = len(self.model.states())
        old = machine_candidates(self.included)
        new = machine_candidates(included)
        starts = []
        for segmented, place in zip(self.segmented_records, point.places, strict=True):
            blocks = [place.starts[:, :base]]
            for candidate in new:
                width = len(candidate.effect.hidden)
                if width and candidate in old:
                    at = base + sum(len(t.effect.hidden) for t in old[: old.index(candidate)])
                    blocks.append(place.starts[:, at : at + width])
                elif width:
                    blocks.append(
                        np.tile([h.start for h in candidate.effect.hidden], (segmented.count, 1))
                    )
            starts.append(np.hstack(blocks))
        if any(candidate.effect.hidden for candidate in new if candidate not in old):
            self._run_hidden(point.theta, new, starts, base)
        places = tuple(
            replace(place, starts=x) for x, place in zip(starts, point.places, strict=True)
        )
        return Point(point.theta, np.asarray(magnitudes, dtype=np.float64), places)

    def _run_hidden(
        self, theta: Array, included: tuple[Candidate, ...], starts: list[Array], base: int
    ) -> None:
        """Hidden states at the segment starts, driven by the motion of the model.

        Changes ``starts``, (W, nx) by record, from state ``base`` on.
        """
        none = np.zeros(len(included))
        segmented = self.segmented_records
        for w, which in by_segment([s.count - 1 for s in segmented]):
            one = slice(w, w + 1)
            batches = [
                (
                    segmented[i].record,
                    Jobs.at_point(
                        theta, segmented[i].segments[one], starts[i][one], included, none
                    ),
                )
                for i in which
            ]
            for i, run in zip(which, self.model.simulate_all(batches), strict=True):
                if np.all(np.isfinite(run.ends)):
                    starts[i][w + 1, base:] = run.ends[0, base:]


def _by_input_noise(linear: Linear, residual: Array, defect: Array, defect_sd: Array) -> Array:
    """Part of the sum of squares that the noise of the inputs explains, by segment (W,).

    |v|^2 - min over u of |v - A u|^2 + |u|^2, where u are standard normal variables.
    """
    count, _, mi = linear.by_input.shape
    if mi == 0:
        return np.zeros(count)
    tied = np.zeros((count, defect.shape[1], mi))
    tied[:-1] = -linear.ends_by_input[:-1] / defect_sd[:, None]
    full_defect = np.zeros((count, defect.shape[1]))
    full_defect[:-1] = defect / defect_sd
    with np.errstate(invalid="ignore", over="ignore"):
        pull = np.einsum("wmi,wm->wi", linear.by_input, residual)
        pull += np.einsum("wni,wn->wi", tied, full_defect)
    matrix = np.einsum("wmi,wmj->wij", linear.by_input, linear.by_input, optimize=True)
    matrix += np.einsum("wni,wnj->wij", tied, tied, optimize=True) + np.eye(mi)
    good = np.all(np.isfinite(pull), axis=1) & np.all(np.isfinite(matrix), axis=(1, 2))
    out = np.zeros(count)
    # If columns are much larger than the noise, the identity matrix is lost in double precision.
    # The diagonals are made equal first, and dependent directions are dropped.
    size = np.sqrt(np.einsum("wii->wi", matrix[good]))
    values, vectors = np.linalg.eigh(matrix[good] / (size[:, :, None] * size[:, None, :]))
    along = np.einsum("wij,wi->wj", vectors, pull[good] / size)
    kept = values > 1e-13 * values[:, -1:]
    out[good] = np.sum(np.where(kept, along**2 / np.where(kept, values, 1.0), 0.0), axis=1)
    return out


def solve_scaled(matrix: Array, right: Array) -> Array:
    """Solve symmetric equations after scaling their diagonal to 1; drop undetermined directions.

    ``right``: (n,), or (n, k) for several right-hand sides.
    """
    if right.size == 0:
        return right
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    seen = size > 1e-150
    out = np.zeros_like(right)
    if not seen.any():
        return out
    own = size[seen] if right.ndim == 1 else size[seen][:, None]
    scaled = matrix[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    values, vectors = np.linalg.eigh(scaled)
    keep = values > 1e-11 * values[-1]
    weight = values[keep] if right.ndim == 1 else values[keep][:, None]
    part = vectors[:, keep] @ ((vectors[:, keep].T @ (right[seen] / own)) / weight)
    out[seen] = part / own
    return out
