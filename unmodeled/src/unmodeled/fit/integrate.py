"""Integration of the equations of an ``Equations`` for all jobs simultaneously."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array, Integers, Record
from unmodeled.errors import InvalidParameter
from unmodeled.fit.calling import calling
from unmodeled.fit.coordinates import Named, Rate
from unmodeled.fit.model import BETWEEN, Batch, Candidate, Jobs

__all__ = [
    "GAMMA",
    "Clock",
    "Law",
    "Steps",
    "System",
    "Trajectory",
    "effects_of",
    "integrate",
    "solved",
]

#: Numbers of a state that are integrated at once.
BLOCK = 16_000
#: Largest number of corrections of a motion, and the relative size of the last one.
TRIES, SETTLED = 8, 1e-9
#: Step of differences by states, relative to the state and its scale.
STEP = 1e-7
#: Coefficient of ROS2.
GAMMA = 1.0 - np.sqrt(0.5)


@dataclass(frozen=True, eq=False)
class Clock:
    """Time and inputs of jobs by sample, (longest, B); constant after the end of a record."""

    time: Array
    signals: list[Array]
    bends: list[Array]
    """Second derivatives of the cubic splines through the inputs; empty: not needed."""

    @classmethod
    def of(
        cls,
        model: Any,
        batches: Sequence[Batch],
        longest: int,
    ) -> Clock:
        """Times and inputs of all jobs of several batches."""
        times: list[Array] = []
        signals: list[list[Array]] = [[] for _ in model.inputs]
        bends: list[list[Array]] = [[] for _ in model.inputs]
        bent: dict[int, list[Array]] = {}
        for record, jobs in batches:
            at = np.minimum(np.arange(longest), record.samples - 1)
            at = np.repeat(at[:, None], jobs.count, axis=1)
            times.append(record.time[at])
            values = [record.inputs[n] for n in model.inputs]
            for i, value in enumerate(values):
                signals[i].append(value[at])
            if model.hold in ("spline", "between"):
                if id(record) not in bent:
                    bent[id(record)] = _bends(record, values)
                for i, bend in enumerate(bent[id(record)]):
                    bends[i].append(bend[at])
        return cls(
            np.hstack(times),
            [np.hstack(parts) for parts in signals],
            [np.hstack(parts) for parts in bends if parts],
        )

    def held(self, model: Any, j: Any, share: Array, p: Named) -> list[Array]:
        """Inputs in the intervals that begin at the samples j, at these shares of the intervals.

        ``signal[j]`` and ``share`` are broadcast together.
        """
        nxt = np.minimum(j + 1, len(self.time) - 1)
        columns = []
        for i, (name, signal) in enumerate(zip(model.inputs, self.signals, strict=True)):
            value = signal[j] + 0.0 * share
            if model.hold != "zero":
                value = value + share * (signal[nxt] - signal[j])
            if self.bends:
                rest, square = 1.0 - share, (self.time[nxt] - self.time[j]) ** 2 / 6.0
                bent = square * (
                    (rest**3 - rest) * self.bends[i][j] + (share**3 - share) * self.bends[i][nxt]
                )
                value = value + (p[BETWEEN + name] * bent if model.hold == "between" else bent)
            columns.append(value)
        return columns


def _bends(record: Record, signals: Sequence[Array]) -> list[Array]:
    """Second derivatives, at the samples, of the cubic splines through the inputs."""
    from scipy.interpolate import CubicSpline

    return [np.asarray(CubicSpline(record.time, s)(record.time, 2)) for s in signals]


class Law:
    """The rate of an effect that acts on consecutive jobs, and the rows of the states it changes.

    Parameters
    ----------
    names
        States of the model.
    candidate
        Effect and shape.
    memory
        Row of its first hidden state.
    jobs
        First job, and end.
    """

    def __init__(
        self, names: Sequence[str], candidate: Candidate, memory: int, jobs: tuple[int, int]
    ):
        self.candidate, self.jobs = candidate, jobs
        hidden = [h.name for h in candidate.effect.hidden]
        self.memory = {name: memory + j for j, name in enumerate(hidden)}
        self._rows = {**{n: i for i, n in enumerate(names)}, **self.memory}
        self._calling = calling(f"effect {candidate.name}: its rate")

    def changes(
        self, t: Array, x: Any, named: Named, u: Named, p: Named, magnitude: Array
    ) -> list[tuple[int, Any]]:
        """Row of a state and change of its rate, for every state that the effect changes.

        ``x``: rows of states; ``named``: those of the model by name.
        """
        effect = self.candidate.effect
        own: Any = effect.rate
        seen = named
        if self.memory:
            held = {name: x[row] for name, row in self.memory.items()}
            seen = Named._of({**named._values, **held})
        with self._calling:
            change: Any = own(t, seen, u, p, magnitude, self.candidate.shape)
        if not isinstance(change, Mapping):
            raise InvalidParameter(
                f"effect {effect.name}: rate returned {type(change).__name__}, expected a "
                "dictionary of rates by name of the state"
            )
        found = []
        for name, value in change.items():
            row = self._rows.get(name)
            if row is None:
                raise InvalidParameter(
                    f"effect {effect.name}: rate changes {name!r}, which is no state; known are "
                    f"{', '.join(self._rows)}"
                )
            if np.shape(value) not in ((), (1,), t.shape):
                raise _wrong_shape(f"effect {effect.name}", name, value, t.size)
            found.append((row, value))
        return found


def effects_of(jobs: Jobs) -> tuple[tuple[int, str], ...]:
    """Key of the included effects with their shapes."""
    return tuple((id(t.effect), repr(t.shape)) for t in jobs.included)


def _wrong_shape(of: str, state: str, value: Any, count: int) -> InvalidParameter:
    return InvalidParameter(
        f"{of}: rate of {state} has shape {np.shape(value)}, expected a number or one value a "
        f"job, ({count},)"
    )


class System:
    """Rates of the states of jobs, with the included effects of each.

    All arrays have one entry per job, or n entries per job: first those of the first job, then
    those of the second one. ``own``: False takes the effects alone, without the rates of the model.
    """

    def __init__(self, model: Any, batches: Sequence[Batch], own: bool = True):
        self.model, self.own = model, own
        self.names = [s.name for s in model._states]
        self.rows = {n: i for i, n in enumerate(self.names)}
        self.count = sum(jobs.count for _, jobs in batches)
        self.size = max(len(model.states(jobs.included)) for _, jobs in batches)
        self.most = max(len(jobs.included) for _, jobs in batches)
        self.laws: list[tuple[int, Law]] = []
        """Effects, and their places among the included ones of their jobs."""
        self.scales = np.ones((self.size, self.count))
        self.magnitudes = np.zeros((self.most, self.count))
        """Magnitudes of the included effects, (most, B)."""
        theta = np.vstack([jobs.theta for _, jobs in batches])
        self.p = Named({q.name: theta[:, i] for i, q in enumerate(model.parameters)})
        self._calling = calling(f"model {model.name}: its rates function")
        end = 0
        for _, group in groupby((jobs for _, jobs in batches), effects_of):
            same = list(group)
            begin, end = end, end + sum(jobs.count for jobs in same)
            included = same[0].included
            states = model.states(included)
            self.scales[: len(states), begin:end] = np.array([[s.scale] for s in states])
            if included:
                sizes = np.vstack([jobs.magnitudes for jobs in same])
                self.magnitudes[: len(included), begin:end] = sizes.T
            row = len(self.names)
            for k, candidate in enumerate(included):
                self._check_names(candidate)
                self.laws.append((k, Law(self.names, candidate, row, (begin, end))))
                row += len(candidate.effect.hidden)

    def _check_names(self, candidate: Candidate) -> None:
        """Refuse hidden states with the name of a state of the model."""
        taken = [h.name for h in candidate.effect.hidden if h.name in self.rows]
        if taken:
            raise InvalidParameter(
                f"effect {candidate.name}: its hidden state {taken[0]!r} has the name "
                f"of a state of model {self.model.name}; rename one of them"
            )

    def view(self, x: Any) -> Named:
        """States of the model by name."""
        return Named._of(dict(zip(self.names, x, strict=False)))

    def rates(self, t: Array, x: Array, u: Named, p: Named, magnitudes: Array) -> Array:
        """Rates of all states, (size, n)."""
        named, out = self.view(x), np.zeros(x.shape)
        if self.own:
            self._set_own(t, named, u, p, out)
        for k, law in self.laws:
            if law.jobs == (0, self.count):
                for row, value in law.changes(t, x, named, u, p, magnitudes[k]):
                    out[row] += value
                continue
            own = slice(*(e * (t.size // self.count) for e in law.jobs))
            y = x[:, own]
            for row, value in law.changes(
                t[own],
                y,
                self.view(y),
                selected(u, own),
                selected(p, own),
                magnitudes[k, own],
            ):
                out[row, own] += value
        return out

    def _set_own(self, t: Array, named: Named, u: Named, p: Named, out: Array) -> None:
        """Set the rates of the model."""
        model = self.model
        with self._calling:
            own_rates = tuple(model._rates(t, named, u, p))
            if len(own_rates) != len(self.names):
                raise InvalidParameter(
                    f"model {model.name}: rates returned {len(own_rates)} values, expected one for "
                    f"each state: {', '.join(self.names)}"
                )
            for i, value in enumerate(own_rates):
                if np.shape(value) not in ((), (1,), t.shape):
                    raise _wrong_shape(f"model {model.name}", self.names[i], value, t.size)
                out[i] = value

    def outputs(self, t: Array, x: Array, u: Named, p: Named, slopes: Array | None) -> Array:
        """Outputs, (outputs, n); ``slopes``: rates of the states, if an output needs them."""
        named = self.view(x)
        out = np.zeros((len(self.model.outputs), t.size))
        for o, (name, of) in enumerate(self.model._outputs.items()):
            if isinstance(of, Rate):
                assert slopes is not None
                out[o] = slopes[self.rows[of.state]]
            elif not self.own:
                continue  # an effect changes the other outputs by the states
            elif isinstance(of, str):
                out[o] = named[of]
            else:
                with calling(f"model {self.model.name}: its output {name}"):
                    out[o] = of(t, named, u, p)
        return out


def selected(values: Named, own: slice) -> Named:
    """Values of some instants or jobs."""
    return Named._of({name: value[own] for name, value in values._values.items()})


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Results of an integration."""

    runs: list[Array]
    """Outputs by batch, (B, n, ny)."""
    samples: Array
    """States at the samples, (longest, states, jobs); empty if not wanted."""


def integrate(model: Any, batches: Sequence[Batch], keep: int = 0) -> Trajectory:
    """Integrate with fixed steps between the samples; the class describes the methods.

    A model that is prepared for a fit remembers the last motion in each record. Then all steps of
    many samples are evaluated at once along this motion, and Newton's method corrects it until
    every step ends where the next one begins. Batches without a known motion, and those for which
    this fails, are integrated step by step.

    Parameters
    ----------
    model
        The model.
    batches
        Records and jobs; either with unknown forces of equal knots, or with none. It is faster if
        those with the same included effects follow each other.
    keep
        Number of the first batches whose states are kept.
    """
    longest = max(record.samples for record, _ in batches)
    guesses = {
        i: guess
        for i, (record, jobs) in enumerate(batches)
        if (guess := _last_motion(model, record, jobs, longest)) is not None
    }
    found: dict[int, Trajectory] = {}
    for begun in (guesses, {}):
        some = [i for i in (begun or range(len(batches))) if i not in found]
        if some:
            steps = Steps(model, [batches[i] for i in some], longest)
            own = steps.integrated([begun[i] for i in some if begun], sum(i < keep for i in some))
            found |= {i: run for i, run in zip(some, own, strict=True) if run is not None}
    done = [found[i] for i in range(len(batches))]
    size = max((run.samples.shape[1] for run in done[:keep]), default=0)
    samples = [
        np.pad(run.samples, ((0, 0), (0, size - run.samples.shape[1]), (0, 0)))
        for run in done[:keep]
    ]
    return Trajectory(
        [run.runs[0] for run in done], np.concatenate([np.zeros((longest, size, 0)), *samples], -1)
    )


def _last_motion(model: Any, record: Record, jobs: Jobs, longest: int) -> Array | None:
    """The last motion in a record with the same effects, (states, longest); None: not known.

    If there was none, that of the model alone; hidden states then keep their start.
    """
    known = (model._motions or {}).get(_motion_key(record, jobs.included))
    if known is None:
        known = (model._motions or {}).get(_motion_key(record, ()))
    if known is None or longest < 2:
        return None
    path = np.repeat(jobs.starts[0][:, None], longest, axis=1)
    path[: len(known)] = np.pad(known, ((0, 0), (0, longest - record.samples)), mode="edge")
    return path


def _motion_key(record: Record, included: Sequence[Candidate]) -> tuple[object, ...]:
    return record.name, record.samples, *(t.effect.name for t in included)


def _by_job(values: Array) -> Array:
    """Values by sample and job, as one axis with those of a job together."""
    return values.T.reshape(-1)


class Steps:
    """Steps of all jobs between samples, several samples at once."""

    def __init__(self, model: Any, batches: Sequence[Batch], longest: int, own: bool = True):
        self.model, self.batches, self.longest = model, batches, longest
        self.clock = Clock.of(model, batches, longest)
        self.equations = System(model, batches, own)
        self.forces: Array | None = None
        if batches[0][1].forces is not None:
            self.forces = np.concatenate([q.forces for _, q in batches if q.forces is not None])
        self.substeps = model.substeps or 1
        self._repeated: tuple[int, Named, Array] = 1, self.equations.p, self.equations.magnitudes

    # ------------------------------------------------------------------------------ motions

    def integrated(self, guesses: Sequence[Array], keep: int) -> list[Trajectory | None]:
        """Results by batch; None: Newton's method from the guess of its motion fails.

        Without guesses, all are integrated step by step.
        """
        model, count, size, longest = (
            self.model,
            self.equations.count,
            self.equations.size,
            self.longest,
        )
        counts = [jobs.count for _, jobs in self.batches]
        ends = np.cumsum(counts)
        guess = np.zeros((size, count, longest)) if guesses else None
        x = np.zeros((size, count))
        for k, ((_, jobs), end) in enumerate(zip(self.batches, ends, strict=True)):
            own = slice(end - jobs.count, end)
            x[: jobs.starts.shape[1], own] = jobs.starts.T
            if guess is not None:
                guess[: len(guesses[k]), own] = guesses[k][:, None]
        kept = int(ends[keep - 1]) if keep else 0
        outputs = np.empty((longest, count, len(model.outputs)))
        samples = np.empty((longest, size, kept))
        firsts = np.empty((longest, size, len(counts)))
        lost = np.zeros(count, dtype=bool)
        block = max(1, BLOCK // count)
        for first in range(0, longest, block):
            j = np.arange(first, min(first + block, longest))
            ahead = j[j < longest - 1]
            if guess is None:
                states = self._in_turn(ahead, x)
            else:
                states = self._corrected(ahead, x, guess[:, :, first:], lost)
            x, states = states[:, :, -1], states[:, :, : len(j)]
            outputs[j] = self.outputs(j, states).T
            samples[j] = np.moveaxis(states[:, :kept], -1, 0)
            firsts[j] = np.moveaxis(states[:, ends - counts], -1, 0)
        out: list[Trajectory | None] = []
        for k, ((record, jobs), end) in enumerate(zip(self.batches, ends, strict=True)):
            own = slice(end - jobs.count, end)
            if lost[own].any():
                out.append(None)
                continue
            path = firsts[: record.samples, : jobs.starts.shape[1], k].T
            if model._motions is not None and np.isfinite(path).all():
                model._motions[_motion_key(record, jobs.included)] = path.copy()
            run = np.ascontiguousarray(np.moveaxis(outputs[: record.samples, own], 0, 1))
            out.append(Trajectory([run], samples[..., own]))
        return out

    def _in_turn(self, j: Integers, x: Array) -> Array:
        """States at the samples j and after them, (states, jobs, len(j) + 1), one after another."""
        states = [x]
        for i in range(len(j)):
            states.append(self.after(j[i : i + 1], states[-1])[0])
        return np.stack(states, axis=-1)

    def _corrected(self, j: Integers, begin: Array, guess: Array, lost: NDArray[np.bool_]) -> Array:
        """The same by Newton's method from a guess of the states at the samples.

        ``lost``: jobs for which it has failed; further ones are marked.
        """
        size, count = begin.shape
        path = guess[:, :, : len(j) + 1].copy()
        path[:, :, 0] = begin
        scales = self.equations.scales[:, :, None]
        far = np.full(count, np.inf)
        for k in range(TRIES + 1):
            x = path[:, :, :-1].reshape(size, -1)
            end, _ = self.after(j, x)
            settled = far < SETTLED
            if (settled | lost).all() or k == TRIES:
                break
            slopes = np.empty((len(j), count, size, size))
            for i in range(size):
                moved = x.copy()
                moved[i] += STEP * (np.abs(x[i]) + self.equations.scales[i].repeat(len(j)))
                change = (self.after(j, moved)[0] - end) / (moved[i] - x[i])
                slopes[..., i] = change.reshape(size, count, len(j)).T
            steps = np.ascontiguousarray((end.reshape(size, count, len(j)) - path[:, :, 1:]).T)
            now = np.zeros((count, size, 1))
            for i, slope in enumerate(slopes):
                now = slope @ now
                now += steps[i, ..., None]
                steps[i] = now[..., 0]
            path[:, :, 1:] += steps.T
            far = (np.abs(steps.T) / (np.abs(path[:, :, 1:]) + scales)).max(axis=(0, 2), initial=0)
            lost |= ~np.isfinite(far)
        lost |= ~settled
        return path

    def after(self, j: Integers, x: Array, motion: Array | None = None) -> tuple[Array, Array]:
        """States after the intervals that begin at the samples j, and at their stages.

        ``x``: states at the samples, (states, n), those of a job together. The stages are
        (substeps, stages, states, n). ``motion``: known first states at the stages.
        """
        h, stages = self._durations(j), []
        scales = self.equations.scales.repeat(len(j), axis=1)
        for s, instants in enumerate(self._instants(j, h)):

            def rates(k: int, y: Array, s: int = s, at: Any = instants) -> Array:
                if motion is not None:
                    y = np.vstack([motion[s, k], y[motion.shape[2] :]])
                return self.rates(at[k][0], y, at[k][1])

            x, passed = advanced(rates, self.model.method, h, x, scales)
            stages.append(passed)
        return x, np.array(stages)

    def slopes(self, j: Integers, stages: Array) -> Array:
        """Rates at the stages, (substeps, stages, states, jobs, j), in the intervals from j.

        Effects alone give those of the states of the model. ``stages``: states, of the same shape.
        """
        shape = *stages.shape[:3], -1
        found = [
            [self.rates(t, x, u) for (t, u), x in zip(instants, own, strict=True)]
            for instants, own in zip(
                self._instants(j, self._durations(j)), stages.reshape(shape), strict=True
            )
        ]
        out = np.array(found).reshape(*stages.shape)
        return out if self.equations.own else out[:, :, : len(self.equations.names)]

    def _durations(self, j: Integers) -> Array:
        """Durations of the steps of each job in the intervals from the samples j."""
        return _by_job(self.clock.time[j + 1] - self.clock.time[j]) / self.substeps

    def _instants(self, j: Integers, h: Array) -> Iterator[list[tuple[Array, Named]]]:
        """Times and inputs at the stages of each step in the intervals from the samples j.

        ``h``: durations of the steps.
        """
        t = _by_job(self.clock.time[j])
        u = self._inputs(j, np.arange(2 * self.substeps + 1) / (2 * self.substeps))
        for s in range(self.substeps):
            begin = t + s * h
            middle = begin + 0.5 * h, u[2 * s + 1]
            instants = [(begin, u[2 * s]), middle, middle, (begin + h, u[2 * s + 2])]
            yield instants[::3] if self.model.method == "rosenbrock" else instants

    def _inputs(self, j: Integers, shares: Array) -> list[Named]:
        """Inputs at these shares of the intervals that begin at the samples j."""
        columns = self.clock.held(self.model, j, shares[:, None, None], self.equations.p)
        if not columns:
            return [Named._of({})] * len(shares)
        flat = [[_by_job(v) for v in column] for column in columns]
        names = self.model.inputs
        return [Named._of(dict(zip(names, row, strict=True))) for row in zip(*flat, strict=True)]

    # -------------------------------------------------------------------------------- rates

    def _of_jobs(self, times: int) -> tuple[Named, Array]:
        """Parameters and magnitudes for so many instants of each job."""
        if self._repeated[0] != times:
            p = self.equations.p._values
            self._repeated = (
                times,
                Named._of({name: v.repeat(times) for name, v in p.items()}),
                self.equations.magnitudes.repeat(times, axis=1),
            )
        return self._repeated[1:]

    def rates(self, t: Array, x: Array, u: Named) -> Array:
        """Rates of the states, with unknown forces."""
        times = t.size // self.equations.count
        p, magnitudes = self._of_jobs(times)
        out = self.equations.rates(t, x, u, p, magnitudes)
        if self.forces is not None:
            self._push(t, x, u, p, out)
        return out

    def _push(self, t: Array, x: Array, u: Named, p: Named, out: Array) -> None:
        """Add the rates by unknown forces."""
        model, forces, count = self.model, self.forces, self.equations.count
        assert forces is not None
        times, time = t.size // count, self.clock.time
        begin, span = time[0].repeat(times), (time[-1] - time[0]).repeat(times)
        job, knots = np.arange(count).repeat(times), forces.shape[2]
        coordinates = {c.name: c for c in model.coordinates}
        named = self.equations.view(x)
        place = np.clip((t - begin) / span, 0.0, 1.0) * (knots - 1)
        left = np.minimum(place.astype(np.intp), knots - 2)
        share = place - left
        for k, port in enumerate(model.ports):
            force = (1.0 - share) * forces[job, k, left] + share * forces[job, k, left + 1]
            if port.name in coordinates:
                pushed = coordinates[port.name]._push(force, t, named, u, p)
            else:
                pushed = {model._port_states[port.name]: force}
            for state, value in pushed.items():
                out[self.equations.rows[state]] += value

    def outputs(self, j: Integers, x: Array) -> Array:
        """Outputs, (outputs, jobs, len(j)), at the samples j with the states (states, jobs, j)."""
        flat = x.reshape(len(x), -1)
        t, u = _by_job(self.clock.time[j]), self._inputs(j, np.zeros(1))[0]
        p, _ = self._of_jobs(len(j))
        shows_rates = any(isinstance(of, Rate) for of in self.model._outputs.values())
        slopes = self.rates(t, flat, u) if shows_rates else None
        found = self.equations.outputs(t, flat, u, p, slopes)
        return found.reshape(-1, x.shape[1], len(j))


def advanced(
    rates: Callable[[int, Array], Array], method: str, h: Array, x: Array, scales: Array
) -> tuple[Array, tuple[Array, ...]]:
    """States after one step, (states, jobs), and at its stages; ``rates(stage, x)``.

    ``"rosenbrock"`` is ROS2 (Verwer et al. 1999). It is L-stable and keeps order 2 with any
    approximate Jacobian; here it is computed by finite differences.
    """
    k1 = rates(0, x)
    if method == "rk4":
        half = 0.5 * h
        x2 = x + half * k1
        k2 = rates(1, x2)
        x3 = x + half * k2
        k3 = rates(2, x3)
        x4 = x + h * k3
        return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(3, x4)), (x, x2, x3, x4)
    nx, count = x.shape
    jacobian = np.empty((count, nx, nx))
    for i in range(nx):
        step = 1e-6 * (np.abs(x[i]) + scales[i])
        moved = x.copy()
        moved[i] += step
        jacobian[:, :, i] = ((rates(0, moved) - k1) / step).T
    matrix = np.eye(nx) - GAMMA * h[:, None, None] * jacobian
    k1 = solved(matrix, k1.T[:, :, None])[:, :, 0].T
    x1 = x + h * k1
    k2 = solved(matrix, (rates(1, x1) - 2.0 * k1).T[:, :, None])[:, :, 0].T
    return x + h * (1.5 * k1 + 0.5 * k2), (x, x1)


def solved(matrix: Array, right: Array) -> Array:
    """Solutions of linear systems; NaN where the matrix is not finite."""
    bad = ~np.all(np.isfinite(matrix), axis=(-2, -1))
    out = np.linalg.solve(np.where(bad[..., None, None], np.eye(matrix.shape[-1]), matrix), right)
    out[bad] = np.nan
    return np.asarray(out)
