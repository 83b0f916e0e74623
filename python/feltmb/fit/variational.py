"""Derivatives of the outputs of an ``System`` from its variational equations.

The integrator evaluates the rates at the states of its stages. Here the rates are differentiated at
all of these states at once, by differences of a few calls with long arrays. The result is the
derivative of each step of the integrator: a linear recurrence from sample to sample, for all
variables of differentiation simultaneously. Only this recurrence is a loop over samples.

The derivative of a rate that jumps, such as np.sign, misses the jump. Therefore the difference of
two more simulations, with changed parameters and start states, is compared with its prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feltmb.data import Array, Integers
from feltmb.errors import FeltmbError
from feltmb.fit.calling import calling
from feltmb.fit.coordinates import Named, Rate
from feltmb.fit.integrate import (
    GAMMA,
    Clock,
    System,
    Trajectory,
    advanced,
    integrate,
    selected,
    solved,
)
from feltmb.fit.model import (
    BETWEEN,
    Batch,
    Candidate,
    Sensitivity,
    SensitivityRequest,
    difference_offsets,
)

__all__ = ["variational_sensitivities"]

#: Step of differences by states, relative to the state and its scale, and by changes of inputs.
STATE_STEP, INPUT_STEP = 1e-6, 1e-2
#: Largest difference between a simulated change and its prediction, relative to the change; and the
#: size of the change in steps of finite differences.
SMALL, CHANGE = 0.1, 2.0
#: Numbers of a block of derivatives that are computed at once.
BLOCK = 1_000_000
#: A function of (t, x, u, p, magnitudes).
Function = Callable[[Array, Array, Named, Named, Array], Array]
#: Slice of all jobs.
ALL = slice(None)


def variational_sensitivities(
    model: Any, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity | None]:
    """Outputs and derivatives, one result per request.

    None: the right-hand side jumps, so that the request needs differences of simulations.
    """
    known: dict[object, bool] = model._smooth
    keys = [tuple((c.effect.name, _octaves(c.shape)) for c in r.included) for r in requests]
    steady = [i for i, key in enumerate(keys) if known.get(key, True)]
    if len(steady) < len(requests):
        rest = iter(variational_sensitivities(model, [requests[i] for i in steady]))
        return [next(rest) if i in steady else None for i in range(len(requests))]
    if not requests:
        return []
    # One request decides for all with the same included effects: the test takes two simulations.
    tested = {key: i for i, key in reversed(list(enumerate(keys))) if key not in known}
    batches = [(r.record, r.jobs()) for r in requests]
    moves = {key: _moves(model, requests[i]) for key, i in tested.items()}
    moved = [(requests[tested[key]].record, to.jobs()) for key, m in moves.items() for to in m[:2]]
    run = integrate(model, [*batches, *moved], keep=len(batches))
    found = _Variation(model, requests, batches, run).results()
    for k, (key, i) in enumerate(tested.items()):
        at = len(requests) + 2 * k
        changed = [other[0] for other in run.runs[at : at + 2]]
        known[key] = _predicts(model, found[i], changed, moves[key][2])
    return [
        _asked(request, s) if known[key] else None
        for request, s, key in zip(requests, found, keys, strict=True)
    ]


def _octaves(shape: Any) -> tuple[object, ...]:
    """A shape with its numbers rounded to powers of two: those of a fit change little."""
    row = shape if isinstance(shape, tuple) else (shape,)
    return tuple(
        (v > 0.0, round(math.log2(abs(v)))) if isinstance(v, float) and v != 0.0 else v for v in row
    )


def _moves(
    model: Any, request: SensitivityRequest
) -> tuple[SensitivityRequest, SensitivityRequest, Array]:
    """Two requests with opposite changes of parameters, magnitudes and start states.

    Also returns the differences between the two, in the order of the variables of differentiation.
    At a limit, only one of the two changes the value.
    """
    signs = np.random.default_rng(0)
    more, less = (
        [np.array(v, dtype=np.float64) for v in (request.theta, request.sizes, request.start)]
        for _ in range(2)
    )
    own = [
        (0, i, CHANGE * model.difference_step * q.size, q.lower, q.upper)
        for i, q in ((i, model.parameters[i]) for i in request.parameters_of(model))
    ]
    own += [
        (1, k, t.effect.step * t.effect.scale, *t.effect.bounds)
        for k, t in enumerate(request.included)
    ]
    changes = []
    for what, i, step, low, high in own:
        step = step if signs.random() < 0.5 else -step
        more[what][i] = np.clip(more[what][i] + step, low, high)
        less[what][i] = np.clip(less[what][i] - step, low, high)
        changes.append(more[what][i] - less[what][i])
    scales = np.array([s.scale for s in model.states(request.included)])
    start = signs.choice([-1.0, 1.0], scales.size)
    start *= 0.1 * CHANGE * model.difference_step * scales
    one, other = (
        replace(request, theta=theta, magnitudes=sizes, start=request.start + sign * start)
        for (theta, sizes, _), sign in ((more, 1.0), (less, -1.0))
    )
    return one, other, np.array([*changes, *(2.0 * start)])


def _predicts(
    model: Any,
    s: Sensitivity,
    two: Sequence[Array],
    changes: Array,
) -> bool:
    """Whether the derivatives predict the difference of the outputs of two changed simulations.

    Outputs that are rates show each steep part of a rate itself. They are left out if there are
    others.
    """
    columns = np.concatenate([s.d_theta, s.d_magnitudes, s.d_starts], axis=-1)
    change = two[0] - two[1]
    error = change - columns @ changes
    good = np.isfinite(change)
    if np.any(good & ~np.isfinite(error)):
        return False
    change, error, y = (np.where(good, v, 0.0) for v in (change, error, s.outputs))
    allowed = SMALL**2 * np.sum(change**2, axis=0) + 1e-18 * np.sum(y**2, axis=0)
    agrees = np.sum(error**2, axis=0) <= allowed
    steady = [o for o, of in enumerate(model._outputs.values()) if not isinstance(of, Rate)]
    return bool(np.all(agrees[steady] if steady else agrees))


def _asked(request: SensitivityRequest, s: Sensitivity) -> Sensitivity:
    """The result without derivatives that were only needed for its test."""
    if request.by_starts:
        return s
    return replace(s, d_starts=s.d_starts[..., :0])


@dataclass(frozen=True, eq=False)
class _Points:
    """Arguments of the rates at instants of all jobs, (n,): those of a job together."""

    t: Array
    x: Array
    u: Named
    p: Named
    magnitudes: Array


class _Variation:
    """Derivatives along a trajectory.

    The variables of differentiation of all requests share one list of columns: parameters,
    magnitudes, start states, candidates, changes of inputs.
    """

    def __init__(
        self,
        model: Any,
        requests: Sequence[SensitivityRequest],
        batches: Sequence[Batch],
        run: Trajectory,
    ):
        self.model, self.requests, self.runs = model, requests, run.runs
        self.equations = System(model, batches)
        self.count, self.size = self.equations.count, self.equations.size
        self.longest = len(run.samples)
        self.clock = Clock.of(model, batches, self.longest)
        self.samples = run.samples[:, None, None]  # as the stages: one step with one stage
        self.stages = run.stages
        self.substeps = self.stages.shape[1]
        instants = np.array([0.0, 0.5, 0.5, 1.0] if model.method == "rk4" else [0.0, 1.0])
        self.shares = (np.arange(self.substeps)[:, None] + instants) / self.substeps
        self.theta = sorted({i for r in requests for i in r.parameters_of(model)})
        self.candidates: list[Candidate] = []
        self.which: list[list[int]] = []
        """Places of the candidates of each request in the list of all."""
        known: dict[object, int] = {}
        for request in requests:
            for t in request.candidates:
                key = (id(t.effect), repr(t.shape))
                if key not in known:
                    known[key] = len(known)
                    self.candidates.append(t)
            self.which.append([known[id(t.effect), repr(t.shape)] for t in request.candidates])
        self.laws = [self.equations.law(t, len(self.equations.names)) for t in self.candidates]
        self.changes = [
            Clock.of(
                model,
                batches,
                self.longest,
                [r.input_changes[k] if k < len(r.input_changes) else {} for r in requests],
            )
            for k in range(max((len(r.input_changes) for r in requests), default=0))
        ]
        self.at_starts = len(self.theta) + self.equations.most
        self.at_candidates = self.at_starts + self.size
        self.at_changes = self.at_candidates + len(self.laws)
        self.at_shapes = self.at_changes + len(self.changes)
        self.columns = self.at_shapes + max((len(r.shape_changes) for r in requests), default=0)
        self.memories = self._memories()

    # -------------------------------------------------------------------------- points

    def _inputs(self, clock: Clock, j: Integers, shares: Array, p: Named) -> Named:
        """Inputs at these shares, (substeps, stages), of the intervals from the samples j.

        (j, substeps, stages, jobs)
        """
        values = clock.held(self.model, j[:, None, None], shares[:, :, None], p)
        return Named._of(dict(zip(self.model.inputs, values, strict=True)))

    def _held(self, j: Integers, shares: Array, jobs: Integers | slice) -> tuple[Array, Named]:
        """Times and inputs of some jobs, as :meth:`_inputs`."""
        time, after = self.clock.time, np.minimum(j + 1, self.longest - 1)
        begin = time[j][:, None, None]
        t = begin + shares[:, :, None] * (time[after][:, None, None] - begin)
        u = self._inputs(self.clock, j, shares, self.equations.p)
        return t[..., jobs], Named._of({n: v[..., jobs] for n, v in u._values.items()})

    def _points(self, j: Integers, shares: Array, states: Array) -> _Points:
        """Points in the intervals from the samples j, with their states, (j, ..., states, jobs)."""
        t, u = self._held(j, shares, ALL)
        times = len(j) * shares.size
        return _Points(
            _flat(t),
            np.moveaxis(states, (3, 4), (0, 1)).reshape(self.size, -1),
            _each(u, _flat),
            _each(self.equations.p, lambda v: np.repeat(v, times)),
            np.repeat(self.equations.magnitudes, times, axis=1),
        )

    # ---------------------------------------------------------------- memories of candidates

    def _memories(self) -> dict[int, tuple[Array, Array]]:
        """Hidden states of the candidates at magnitude zero, by candidate.

        Those at the stages, (hidden, jobs, longest - 1, substeps, stages), and at the samples,
        (hidden, jobs, longest). They are driven by the motion alone. Shapes of an effect are
        integrated together, if its rate works with arrays of their numbers.
        """
        groups: dict[int, list[int]] = {}
        for c, law in enumerate(self.laws):
            if law.memory:
                groups.setdefault(id(law.candidate.effect), []).append(c)
        if not groups or self.longest < 2:
            return {c: self._empty(c) for group in groups.values() for c in group}
        first = self._points(
            np.arange(self.longest - 1), self.shares[:1, :1], self.stages[:, :1, :1]
        )
        found: dict[int, tuple[Array, Array]] = {}
        for group in groups.values():
            parts = [group] if self._together(group, first) else [[c] for c in group]
            for part in parts:
                found |= zip(part, self._memory(part), strict=True)
        return found

    def _together(self, group: list[int], at: _Points) -> bool:
        """Whether the rate of an effect gives the same with arrays of the numbers of its shapes."""
        laws, base = [self.laws[c] for c in group], len(self.equations.names)
        shape = _stacked([law.candidate.shape for law in laws], len(at.t))
        if shape is None or len(group) == 1:
            return False
        t, x = np.tile(at.t, len(laws)), np.tile(at.x[:base], (1, len(laws)))
        z = np.array([[s.start] for s in laws[0].candidate.effect.hidden])
        x = np.vstack([x, np.repeat(z, len(t), axis=1)])
        u, p = (_each(v, lambda v: np.tile(v, len(laws))) for v in (at.u, at.p))
        size = np.zeros_like(t)
        try:
            all_of_them = laws[0].changes(t, x, self.equations.view(x), u, p, size, shape)
        except FeltmbError:  # it works with single numbers only
            return False
        for k, law in enumerate(laws):
            own = slice(k * len(at.t), (k + 1) * len(at.t))
            y = x[:, own]
            one = law.changes(
                at.t, y, self.equations.view(y), at.u, at.p, size[own], law.candidate.shape
            )
            for (row, value), (other, values) in zip(one, all_of_them, strict=True):
                if row != other or not np.allclose(
                    value, np.broadcast_to(values, t.shape)[own], rtol=1e-9, equal_nan=True
                ):
                    return False
        return True

    def _empty(self, c: int) -> tuple[Array, Array]:
        hidden = self.laws[c].candidate.effect.hidden
        z = np.tile(
            np.array([s.start for s in hidden])[:, None, None], (1, self.count, self.longest)
        )
        return np.zeros((len(z), self.count, self.longest - 1, *self.shares.shape)), z

    def _memory(self, group: list[int]) -> list[tuple[Array, Array]]:
        """Hidden states of an effect with the shapes of a group, over all records.

        For each shape as in :meth:`_memories`.
        """
        laws, states, shapes = [self.laws[c] for c in group], self.equations.names, len(group)
        effect, shape = laws[0].candidate.effect, laws[0].candidate.shape
        if shapes > 1:
            shape = _stacked([law.candidate.shape for law in laws], self.count)
        length = self.longest - 1
        times = (1, 1, 1, shapes)
        t, u = self._held(np.arange(length), self.shares, ALL)
        signals = [np.tile(v, times) for v in u._values.values()]
        t, h = np.tile(t, times), np.diff(self.clock.time, axis=0)
        x = np.tile(self.stages[:, :, :, : len(states)], (1, *times))
        p = _each(self.equations.p, lambda v: np.tile(v, shapes))
        h = np.tile(h / self.substeps, (1, shapes))
        names, hidden = list(u._values), list(laws[0].memory)
        now = np.tile([[s.start] for s in effect.hidden], (1, shapes * self.count))
        scales = np.tile([[s.scale] for s in effect.hidden], (1, shapes * self.count))
        zero, rate = np.zeros(shapes * self.count), effect.rate
        assert rate is not None
        step, kept = (0, 0), []

        def rates(k: int, y: Array) -> Array:
            at, out = (*step, k), np.zeros_like(y)
            seen = dict(zip(states, x[at], strict=True)) | dict(zip(hidden, y, strict=True))
            held = {name: v[at] for name, v in zip(names, signals, strict=True)}
            found = rate(t[at], Named._of(seen), Named._of(held), p, zero, shape)
            for i, name in enumerate(hidden):
                if name in found:
                    out[i] = found[name]
            return out

        with calling(f"effect {effect.name}: its rate"):
            for j in range(length):
                for s in range(self.substeps):
                    step = (j, s)
                    now, stages = advanced(rates, self.model.method, h[j], now, scales)
                    kept.append(stages)
        path = np.array(kept).reshape(length, *self.shares.shape, len(hidden), shapes, self.count)
        last = now.reshape(1, len(hidden), shapes, self.count)
        samples = np.concatenate([path[:, 0, 0], last])
        return [
            (path[:, :, :, :, k].transpose(3, 4, 0, 1, 2), samples[:, :, k].transpose(1, 2, 0))
            for k in range(shapes)
        ]

    # ------------------------------------------------------------------------ derivatives

    def _differences(
        self,
        f: Function,
        at: _Points,
        j: Integers,
        shares: Array,
        memories: dict[int, Array],
        rows: Sequence[int],
    ) -> Array:
        """Derivatives of a function at points, (jobs, j, substeps, stages, values, columns).

        The first columns are the derivatives by the states. ``rows``: states whose rates are
        values of the function, -1: another value.
        """
        values = f(at.t, at.x, at.u, at.p, at.magnitudes)
        times = len(at.t) // self.count
        out = np.zeros((len(at.t), len(values), self.size + self.columns))
        own = out[:, :, self.size :]
        self._by_states(f, at, times, out)
        self._by_theta(f, at, times, j, shares, values, own)
        self._by_magnitudes(f, at, times, values, own[:, :, len(self.theta) :])
        # A start state changes nothing but the state.
        self._by_candidates(at, memories, rows, own[:, :, self.at_candidates :])
        self._by_inputs(f, at, j, shares, own[:, :, self.at_changes :])
        self._by_shapes(at, times, rows, own[:, :, self.at_shapes :])
        return out.reshape(self.count, len(j), *shares.shape, *out.shape[1:])

    def _by_states(self, f: Function, at: _Points, times: int, out: Array) -> None:
        """Add the derivatives by the states."""
        scales = np.repeat(self.equations.scales, times, axis=1)
        for i in range(self.size):
            small = STATE_STEP * (np.abs(at.x[i]) + scales[i])
            up, down = at.x.copy(), at.x.copy()
            up[i] += small
            down[i] -= small
            change = f(at.t, up, at.u, at.p, at.magnitudes)
            change -= f(at.t, down, at.u, at.p, at.magnitudes)
            out[:, :, i] = (change / (up[i] - down[i])).T

    def _by_theta(
        self,
        f: Function,
        at: _Points,
        times: int,
        j: Integers,
        shares: Array,
        values: Array,
        out: Array,
    ) -> None:
        """Add the derivatives by the parameters."""
        for column, i in enumerate(self.theta):
            q = self.model.parameters[i]
            step = self.model.difference_step * q.size
            for offset, weight in self._offsets(
                [(r.theta[i], step, q.lower, q.upper) for r in self.requests]
            ):
                moved = {**at.p._values, q.name: at.p[q.name] + np.repeat(offset, times)}
                u = at.u
                if q.name.startswith(BETWEEN):
                    few = self.equations.p
                    few = Named._of({**few._values, q.name: few[q.name] + offset})
                    u = _each(self._inputs(self.clock, j, shares, few), _flat)
                change = f(at.t, at.x, u, Named._of(moved), at.magnitudes) - values
                out[:, :, column] += (np.repeat(weight, times) * change).T

    def _by_magnitudes(
        self, f: Function, at: _Points, times: int, values: Array, out: Array
    ) -> None:
        """Add the derivatives by the magnitudes of the included effects."""
        for k in range(self.equations.most):
            limits = []
            for r in self.requests:
                t = r.included[k].effect if k < len(r.included) else None
                limits.append(
                    (0.0, 1.0, -1.0, 1.0)
                    if t is None
                    else (float(r.sizes[k]), t.step * t.scale, *t.bounds)
                )
            for offset, weight in self._offsets(limits):
                sizes = at.magnitudes.copy()
                sizes[k] += np.repeat(offset, times)
                change = f(at.t, at.x, at.u, at.p, sizes) - values
                out[:, :, k] += (np.repeat(weight, times) * change).T

    def _by_candidates(
        self, at: _Points, memories: dict[int, Array], rows: Sequence[int], out: Array
    ) -> None:
        """Add the derivatives by the magnitudes of the candidates, at zero."""
        base = len(self.equations.names)
        named = self.equations.view(at.x)
        for c, (candidate, law) in enumerate(zip(self.candidates, self.laws, strict=True)):
            x = np.vstack([at.x[:base], memories[c]]) if c in memories else at.x
            step = candidate.effect.step * candidate.effect.scale
            for size, factor in difference_offsets(0.0, step, *candidate.effect.bounds):
                sizes = np.full_like(at.t, size)
                for row, value in law.changes(at.t, x, named, at.u, at.p, sizes, candidate.shape):
                    for o, wanted in enumerate(rows):
                        if row == wanted and row < base:
                            out[:, o, c] += factor * value

    def _by_inputs(self, f: Function, at: _Points, j: Integers, shares: Array, out: Array) -> None:
        """Add the derivatives by the changes of the inputs."""
        for c, clock in enumerate(self.changes):
            added = _each(self._inputs(clock, j, shares, self.equations.p), _flat)
            up, down = (
                f(
                    at.t,
                    at.x,
                    Named._of({n: v + s * added[n] for n, v in at.u._values.items()}),
                    at.p,
                    at.magnitudes,
                )
                for s in (INPUT_STEP, -INPUT_STEP)
            )
            out[:, :, c] = ((up - down) / (2.0 * INPUT_STEP)).T

    def _by_shapes(self, at: _Points, times: int, rows: Sequence[int], out: Array) -> None:
        """Add the derivatives of rates by the shapes of included effects, (n, values, changes)."""
        for i, r in enumerate(self.requests):
            if not r.shape_changes:
                continue
            own = slice(i * times, (i + 1) * times)
            t, x, u, p = at.t[own], at.x[:, own], selected(at.u, own), selected(at.p, own)
            named = self.equations.view(x)
            for c, change in enumerate(r.shape_changes):
                law = next(
                    law
                    for k, law in self.equations.laws
                    if k == change.effect and law.jobs[0] <= i < law.jobs[1]
                )
                size = at.magnitudes[change.effect, own]
                for shape, sign in ((change.upper, 1.0), (change.lower, -1.0)):
                    for row, value in law.changes(t, x, named, u, p, size, shape):
                        for o, wanted in enumerate(rows):
                            if row == wanted:
                                out[own, o, c] += sign * value / change.width

    def _offsets(self, limits: Sequence[tuple[float, float, float, float]]) -> list[list[Array]]:
        """Two changes of a variable and their weights, (jobs,) each, from its values and limits."""
        found = np.array([difference_offsets(*one) for one in limits])  # (requests, 2, 2)
        return [[found[:, i, k] for k in range(2)] for i in range(2)]

    def _steps(self, by: Array, h: Array) -> Array:
        """Changes of the derivatives over the samples, (jobs, j, states, columns).

        They are those by the derivatives at the sample, followed by what is added to them. ``by``:
        derivatives of the rates at the stages; ``h``: steps.
        """
        n, h = self.size, h[..., None, None]
        step: Array
        total = np.zeros(())
        for s in range(self.substeps):
            own = by[:, :, s]
            first = own[:, :, 0]
            if self.model.method == "rk4":
                step, stage = first.copy(), first
                for k, share, weight in ((1, 0.5, 2.0), (2, 0.5, 2.0), (3, 1.0, 1.0)):
                    stage = own[:, :, k] + share * h * (own[:, :, k, :, :n] @ stage)
                    step += weight * stage
                step *= h / 6.0
            else:
                matrix = np.eye(n) - GAMMA * h * first[..., :n]
                k1 = solved(matrix, first)
                k2 = own[:, :, 1] + h * (own[:, :, 1, :, :n] @ k1) - 2.0 * k1
                step = h * (1.5 * k1 + 0.5 * solved(matrix, k2))
            total = step if s == 0 else total + step + step[..., :n] @ total
        return total

    def _along(self) -> Array:
        """Derivatives of the outputs, (jobs, longest, outputs, columns)."""
        model, equations, n, count = self.model, self.equations, self.size, self.count
        direct = [o for o, of in enumerate(model._outputs.values()) if isinstance(of, str)]
        other = [o for o in range(len(model.outputs)) if o not in direct]
        names = [model.outputs[o] for o in other]
        states = [equations.rows[str(model._outputs[model.outputs[o]])] for o in direct]
        rates_of = [model._outputs[name] for name in names]
        rows = [equations.rows[of.state] if isinstance(of, Rate) else -1 for of in rates_of]

        def shown(t: Array, x: Array, u: Named, p: Named, magnitudes: Array) -> Array:
            slopes = None
            if any(row >= 0 for row in rows):
                slopes = equations.rates(t, x, u, p, magnitudes)
            return equations.outputs(t, x, u, p, slopes, names)

        d = np.zeros((count, self.longest, len(model.outputs), self.columns))
        s = np.zeros((count, n, self.columns))
        s[:, range(n), range(self.at_starts, self.at_starts + n)] = 1.0
        block = max(1, BLOCK // (count * self.shares.size * n * (n + self.columns)))
        for first in range(0, self.longest, block):
            j = np.arange(first, min(first + block, self.longest))
            steps = j[j < self.longest - 1]
            if len(steps):
                own = slice(first, first + len(steps))
                at = self._points(steps, self.shares, self.stages[own])
                memories = {
                    c: m[0][:, :, own].reshape(len(m[0]), -1) for c, m in self.memories.items()
                }
                by = self._differences(equations.rates, at, steps, self.shares, memories, range(n))
                h = (self.clock.time[steps + 1] - self.clock.time[steps]).T / self.substeps
                changes = np.ascontiguousarray(np.moveaxis(self._steps(by, h), 1, 0))
            path = np.empty((len(j), count, n, self.columns))
            for i, sample in enumerate(j):
                path[i] = s
                if sample < self.longest - 1:
                    s = s + changes[i, ..., :n] @ s + changes[i, ..., n:]
            path = np.moveaxis(path, 1, 0)
            own = slice(first, first + len(j))
            d[:, own, direct] = path[:, :, states]
            if other:
                zero = np.zeros((1, 1))
                at = self._points(j, zero, self.samples[own])
                memories = {
                    c: m[1][:, :, own].reshape(len(m[1]), -1) for c, m in self.memories.items()
                }
                by = self._differences(shown, at, j, zero, memories, rows)[:, :, 0, 0]
                d[:, own, other] = by[..., :n] @ path + by[..., n:]
        return d

    def results(self) -> list[Sensitivity]:
        """Outputs and derivatives by request."""
        d, out = self._along(), []
        for i, (request, run) in enumerate(zip(self.requests, self.runs, strict=False)):
            own = d[i, : run.shape[1]]

            def following(first: int, count: int, own: Array = own) -> Array:
                return own[..., first : first + count]

            by_theta = [self.theta.index(k) for k in request.parameters_of(self.model)]
            out.append(
                Sensitivity(
                    outputs=run[0],
                    d_theta=own[..., by_theta],
                    d_magnitudes=following(len(self.theta), len(request.included)),
                    d_starts=following(self.at_starts, request.start.size),
                    d_candidates=own[..., [self.at_candidates + c for c in self.which[i]]],
                    d_inputs=following(self.at_changes, len(request.input_changes)),
                    d_shapes=following(self.at_shapes, len(request.shape_changes)),
                )
            )
        return out


def _flat(values: Array) -> Array:
    """Values by job, (..., jobs), as one axis with those of a job together."""
    return np.moveaxis(values, -1, 0).reshape(-1)


def _each(values: Named, change: Callable[[Array], Array]) -> Named:
    return Named._of({name: change(value) for name, value in values._values.items()})


def _stacked(shapes: Sequence[Any], jobs: int) -> Any:
    """Arrays of the numbers of several shapes, for so many jobs each; None: they are no numbers."""
    numbers = (float, tuple)
    if not all(isinstance(shape, numbers) for shape in shapes):
        return None
    if isinstance(shapes[0], float):
        return np.repeat(np.array(shapes, float), jobs)
    if not all(isinstance(v, float) for shape in shapes for v in shape):
        return None
    return tuple(np.repeat(np.array(v), jobs) for v in zip(*shapes, strict=True))
