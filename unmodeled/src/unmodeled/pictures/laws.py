"""The evidence of a change in the coordinates of its law: what the rest of the model leaves.

A law is shown with points that do not know it. For a force, they are the mean forces in intervals
of the variable of the law with which the rest of the model follows a record (least squares on the
derivatives by a force at the port of the law). For an input they are such changes of the input, and
for a sensor the readings less those without its error. If the law is wrong, the points leave it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.fit.observe import motion, observe_all
from unmodeled.models.coordinates import Coordinate, Coupling, Named
from unmodeled.models.model import Candidate, Jobs
from unmodeled.pictures.curves import Axis, Law, Line, Points, thinned
from unmodeled.search.evidence import Fitted, effective_share
from unmodeled.search.held_out import HALF
from unmodeled.search.linear import (
    EvaluationRequest,
    Linear,
    evaluate,
    local_of,
    magnitudes_at,
    shapes_of,
    start_states,
    theta_at,
)
from unmodeled.search.problem import Problem
from unmodeled.search.result import Change
from unmodeled.search.score import by_record, index_of

#: Largest numbers of records that a law shows, of intervals of its variable (and of those in each
#: direction), of points of a cloud.
RECORDS, INTERVALS, IN_EACH, CLOUD = 3, 12, 8, 300
#: Standard deviation above which a point is not shown, as a share of the range of the law.
UNSURE = 0.35
#: Share of the variance that a function of a variable leaves up to which the law is one, and from
#: which it is shown by means.
FUNCTION, SMOOTH = 0.05, 1e-3
#: Number of fits of an action, each with the noise that the one before it leaves.
ROUNDS = 3
#: Amplitude of a force for a derivative, in the scale of its port.
STEP = 1e-3
#: Faults of sensors and inputs that are seen over time.
OVER_TIME = ("delay", "lag", "clock")
#: Length of the part that shows a delay, in delays, and its smallest number of samples.
LATE, FEWEST = 20.0, 16
#: Faults with a level, beyond or within which a signal is lost.
LEVELS = ("saturation", "dead zone")


@dataclass(frozen=True, eq=False)
class _Path:
    """An effect along the motion of one record."""

    r: int
    values: Array
    """Force, or other action, at each sample, (n,)."""
    variables: Mapping[str, tuple[Array, str]]
    """What it may depend on by name: values, (n,), and unit."""
    acts: float = 1.0
    """Share of it that acts in this record; 0: the values are zero."""


def laws(problem: Problem, fitted: Fitted, changes: Sequence[Change]) -> tuple[Law, ...]:
    """The evidence of each change of a list that a set has.

    Parameters
    ----------
    problem, fitted
        The problem and the set.
    changes
        The changes with their intervals.
    """
    found = []
    with np.errstate(all="ignore"):
        for change in in_the_set(problem, fitted, changes):
            law = law_of(problem, fitted, change)
            if law is not None:
                found.append(law)
    return tuple(found)


def in_the_set(problem: Problem, fitted: Fitted, changes: Sequence[Change]) -> list[Change]:
    """The changes; in place of one that a set does not have, its equivalent that it has."""
    own = {problem.causes[i].name for i in fitted.causes}
    return [next((e for e in (c, *c.equivalents) if e.name in own), c) for c in changes]


def law_of(problem: Problem, fitted: Fitted, change: Change) -> Law | None:
    """The evidence of one change; None: the set does not have it, or a simulation fails."""
    index = next((i for i in fitted.causes if problem.causes[i].name == change.name), None)
    if change.records and len(change.records) == len(change.by_record) > 1:
        return _by_records(change)
    if index is None or problem.causes[index].effect is None:
        return _likelihood(problem, fitted, change, index)
    effect = problem.causes[index].effect
    assert effect is not None
    without = _without(problem, fitted, index)
    if without is None:
        return None
    if problem.causes[index].subject.fault in OVER_TIME:
        return _over_time(problem, fitted, change, without)
    if effect.observe is not None:
        return _reading(problem, fitted, change, index, without)
    chosen = _shown(problem, fitted, index, without)
    if effect.regressor is not None:
        return _output(problem, fitted, change, index, chosen)
    if effect.excite is not None:
        return _input(problem, fitted, change, index, chosen)
    place = _Place.of(problem, fitted, index, chosen) if effect.rate is not None else None
    if place is not None:
        return _force(problem, fitted, change, place)
    return _moved(problem, fitted, change, index, without)


def _without(problem: Problem, fitted: Fitted, index: int) -> list[Linear] | None:
    """Residuals with the effect at zero, all other unknowns as they are; None: it fails."""
    x = fitted.point.x.copy()
    x[index_of(problem, fitted.members, index)] = 0.0
    point = replace(fitted.point, x=x)
    ask = EvaluationRequest(fitted.members, point, problem.fit, derivatives=False)
    found = evaluate(problem, [ask])[0]
    return None if any(linear.failed for linear in found) else found


def _shown(problem: Problem, fitted: Fitted, index: int, without: Sequence[Linear]) -> list[int]:
    """Records in which an effect is seen best, in their order.

    If it acts in some records, the first one in which it does not is among them: its points are
    near zero.
    """
    gains = [
        float((((a.residual - b.residual) / fitted.noise) ** 2).sum())
        for a, b in zip(without, fitted.linears, strict=True)
    ]
    acts = [problem.causes[index].acts_in(o) for o in problem.fit]
    best = [r for r in np.argsort(gains)[::-1].tolist() if acts[r]]
    quiet = [r for r, own in enumerate(acts) if not own][:1]
    return sorted(best[: RECORDS - len(quiet)] + quiet)


def _law(
    change: Change,
    kind: Any,
    x: Axis,
    y: Axis,
    points: Sequence[Points],
    lines: Sequence[Line],
) -> Law:
    return Law(change.name, change.title, kind, x, y, tuple(points), tuple(lines))


def _scaled(change: Change, label: str, x: Array, y: Array) -> Line:
    """A line in proportion to the size of a change, with its interval."""
    low, high = (v / change.size if change.size else 1.0 for v in (change.low, change.high))
    return Line(label, x, y, low * y, high * y)


# ------------------------------------------------------------------------------ numbers by record


def _by_records(change: Change) -> Law:
    """Sizes of an error that each record has by itself."""
    at = np.arange(len(change.by_record), dtype=np.float64)
    shown = 100.0 if change.relative else 1.0
    half = shown * (change.high - change.low) / (2.0 * HALF)
    points = [
        Points(name, at[k : k + 1], np.array([shown * v]), np.array([half]))
        for k, (name, v) in enumerate(zip(change.records, change.by_record, strict=True))
    ]
    y = Axis(change.subject.fault or "size", "%" if change.relative else change.unit)
    return _law(change, "records", Axis("record", ""), y, points, ())


def _likelihood(problem: Problem, fitted: Fitted, change: Change, index: int | None) -> Law | None:
    """Likelihood of a number, and its value in each record by itself, to first order."""
    k = _unknown(problem, fitted, change, index)
    if k is None:
        return None
    shown = 100.0 if change.relative else 1.0
    at, size = shown * change.tabulated, shown * change.size
    value, sd = at + size, shown * (change.high - change.low) / (2.0 * HALF)
    if not sd > 0.0:
        return None
    own = fitted.point.x[k]
    scale = size / own if own else 0.0
    values, covariance = by_record(problem, fitted, k)
    each = at + scale * values
    spread = abs(scale) * np.sqrt(np.maximum(np.diag(covariance), 0.0) / fitted.effective)
    reach = max(4.0 * sd, 1.2 * abs(size))
    grid = np.unique(np.append(np.linspace(value - reach, value + reach, 200),
                               value + sd * np.linspace(-4.0, 4.0, 81)))  # fmt: skip
    likelihood = np.exp(-0.5 * ((grid - value) / sd) ** 2)
    near = [r for r in range(len(each)) if spread[r] < max(reach, 4.0 * sd)]
    points = [
        Points(problem.fit[r].record.name, each[r : r + 1], np.array([float(r)]), spread[r : r + 1])
        for r in near
    ]
    line = Line("likelihood", grid, likelihood, likelihood, likelihood)
    as_it_is = Line("as it is", np.full(2, at), np.array([0.0, 1.0]), np.zeros(2), np.ones(2))
    x = Axis("value", "%" if change.relative else change.unit)
    return _law(change, "likelihood", x, Axis("likelihood", "1"), points, (line, as_it_is))


def _unknown(problem: Problem, fitted: Fitted, change: Change, index: int | None) -> int | None:
    """Index of a change among the global unknowns of a set."""
    if index is not None and problem.causes[index].local is None:
        return index_of(problem, fitted.members, index)
    known = [problem.model.parameters[i].name for i in problem.free]
    if change.name in known:
        return known.index(change.name)
    alias = [c.parameter for c in problem.causes if c.name == change.name]
    return problem.free.index(alias[0]) if alias and alias[0] in problem.free else None


def _short(title: str) -> str:
    """At most three words of a name."""
    words = title.removeprefix("The ").removeprefix("the ").split()
    return " ".join(words[:3])


# --------------------------------------------------------------------------- readings and signals


def _over_time(
    problem: Problem, fitted: Fitted, change: Change, without: Sequence[Linear]
) -> Law | None:
    """The part of a channel where a late signal differs most from one in time."""
    late = abs(change.size) if change.unit == "s" else math.inf
    r, c, part = _best_part(problem, fitted, without, LATE * late)
    if r is None:
        return None
    o = problem.fit[r]
    time = o.record.time[part]
    valid = o.valid[part, c]
    if valid.sum() < 4:
        return None
    measured = np.where(valid, o.measured[part, c], np.nan)
    left, right = (
        np.interp(time, time[valid], (measured - x[r].residual[part, c] * o.sd[part, c])[valid])
        for x in (without, fitted.linears)
    )
    cloud = Points(o.record.name, time[valid], measured[valid], np.zeros(int(valid.sum())))
    lines = [Line("without", time, left, left, left), Line("with", time, right, right, right)]
    y = Axis(_short(problem.names[c]), problem.units[c])
    return _law(change, "step", Axis("time", "s"), y, [_few(cloud)], lines)


def _best_part(
    problem: Problem, fitted: Fitted, without: Sequence[Linear], longest: float
) -> tuple[int | None, int, slice]:
    """Record, channel and part in which an effect takes away most; ``longest``: its length [s]."""
    best, found = 0.0, (None, 0, slice(0, 0))
    for r, (o, a, b) in enumerate(zip(problem.fit, without, fitted.linears, strict=True)):
        gain = ((a.residual**2 - b.residual**2) / fitted.noise**2)[: o.end]
        most = min(longest / o.record.interval, 400.0)
        width = int(np.clip(min(o.end / 12, most), min(FEWEST, o.end), o.end))
        for c in range(gain.shape[1]):
            sums = np.convolve(gain[:, c], np.ones(width), "valid")
            at = int(np.argmax(sums))
            if sums[at] > best:
                best, found = float(sums[at]), (r, c, slice(at, at + width))  # type: ignore[assignment]
    return found


def _few(points: Points) -> Points:
    """At most ``CLOUD`` of the points, evenly chosen."""
    every = slice(None, None, -(-len(points.x) // CLOUD))
    return Points(points.label, points.x[every], points.y[every], points.sd[every])


def _channel(fitted: Fitted, without: Sequence[Linear]) -> int:
    """The channel that an effect moves most, in its noise."""
    moved = [
        (((a.residual - b.residual) / fitted.noise) ** 2).sum(axis=0)
        for a, b in zip(without, fitted.linears, strict=True)
    ]
    return int(np.argmax(np.sum(moved, axis=0)))


def _moved(
    problem: Problem, fitted: Fitted, change: Change, index: int, without: Sequence[Linear]
) -> Law | None:
    """What an effect inside a model without ports moves, against what the records ask for."""
    c, points, reach = _channel(fitted, without), [], 0.0
    for r in _shown(problem, fitted, index, without):
        o = problem.fit[r]
        good, sd = o.valid[:, c], o.sd[:, c]
        asked = (without[r].residual[:, c] * sd)[good]
        moves = asked - (fitted.linears[r].residual[:, c] * sd)[good]
        points.append(_few(Points(o.record.name, moves, asked, np.zeros(asked.size))))
        reach = max(reach, float(np.abs(moves).max(initial=0.0)))
    ends = np.array([-reach, reach])
    line = _scaled(change, "law", ends, ends)
    name, unit = _short(problem.names[c]), problem.units[c]
    axes = Axis(f"{name}, change predicted", unit), Axis(f"{name}, change measured", unit)
    return _law(change, "law", *axes, points, [line]) if reach > 0.0 else None


def _reading(
    problem: Problem, fitted: Fitted, change: Change, index: int, without: Sequence[Linear]
) -> Law | None:
    """Error of a sensor against the value that it would show without this error."""
    c = _channel(fitted, without)
    points, x, y = [], [], []
    for r in _shown(problem, fitted, index, without):
        o = problem.fit[r]
        good, sd = o.valid[:, c], o.sd[:, c]
        error = without[r].residual[:, c] * sd
        truth = o.measured[:, c] - error
        law = error - fitted.linears[r].residual[:, c] * sd
        points.append(Points(o.record.name, truth[good], error[good], np.zeros(int(good.sum()))))
        if problem.causes[index].acts_in(o):
            x.append(truth[good])
            y.append(law[good])
    if not x or sum(map(len, x)) < 4:
        return None
    unit, name = problem.units[c], _short(problem.names[c])
    line, label = _function(change, "law", np.concatenate(x), np.concatenate(y)), "reading error"
    if change.subject.fault in LEVELS:  # of which the reading tells more
        points = [Points(p.label, p.x, p.x + p.y, p.sd) for p in points]
        y_, low, high = (line.x + v for v in (line.y, line.low, line.high))
        line, label = replace(line, y=y_, low=low, high=high), "reading"
    axes = Axis(f"true {name}", unit), Axis(label, unit)
    return _law(change, "law", *axes, [_few(p) for p in points], [line])


def _function(change: Change, label: str, x: Array, y: Array) -> Line:
    """A law as a function of its variable, from values along a motion."""
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    if _scatter(x, y) > SMOOTH:  # another variable moves it a little
        x, y = (np.array([part.mean() for part in np.array_split(v, 25)]) for v in (x, y))
    keep = thinned([y], 240)
    return _scaled(change, label, x[keep], y[keep])


# --------------------------------------------------------------------------------- forces and more


def _output(
    problem: Problem, fitted: Fitted, change: Change, index: int, chosen: Sequence[int]
) -> Law | None:
    """A part of a measured output, such as a force balance, against what it depends on."""
    candidate = _candidate(problem, fitted, index)
    assert candidate.effect.regressor is not None
    size = _size(problem, fitted, index)
    paths, left = [], []
    for r in chosen:
        o = problem.fit[r]
        acts = problem.causes[index].acts_in(o)
        values = acts * size * np.asarray(candidate.effect.regressor(o.record, candidate.shape))
        paths.append(_Path(r, values, _inputs_of(o.record), acts))
        left.append(fitted.linears[r].residual[:, 0] * o.sd[:, 0] + values)
    variable = _variable(paths)
    points = []
    for path, y in zip(paths, left, strict=True):
        o = problem.fit[path.r]
        good = o.valid[:, 0]
        z = path.variables[variable][0]
        points.append(_few(Points(o.record.name, z[good], y[good], np.zeros(int(good.sum())))))
    lines, loop = _lines(change, paths, variable)
    x = Axis(_short(variable), paths[0].variables[variable][1])
    y_axis = Axis(_short(problem.names[0]), problem.units[0])
    return _law(change, "loop" if loop else "law", x, y_axis, points, lines)


def _inputs_of(record: Record) -> dict[str, tuple[Array, str]]:
    """Inputs of a record and their rates."""
    out = {n: (v, record.input_units.get(n, "")) for n, v in record.inputs.items()}
    for n, (v, unit) in list(out.items()):
        out[f"rate of {n}"] = np.gradient(v, record.time), f"{unit}/s" if unit else ""
    return out


def _variable(paths: Sequence[_Path], among: Sequence[str] = ()) -> str:
    """The variable of which the values are a function, or nearly so; earlier ones first."""
    paths = [p for p in paths if p.acts]
    names = [n for n in paths[0].variables if not among or n in among]
    values = np.concatenate([p.values for p in paths])
    scores = {n: _scatter(np.concatenate([p.variables[n][0] for p in paths]), values)
              for n in names}  # fmt: skip
    least = min(scores.values())
    return next(n for n in names if scores[n] <= least + 0.01)


def _scatter(z: Array, values: Array) -> float:
    """Share of the variance of values that no function of a variable has [1]."""
    whole = float(np.var(values))
    if whole <= 1e-9 * float(np.mean(values**2)):
        return 0.0
    steps = np.diff(values[np.argsort(z, kind="stable")])
    return float(np.mean(steps**2)) / (2.0 * whole)


def _lines(change: Change, paths: Sequence[_Path], variable: str) -> tuple[list[Line], bool]:
    """The law as one curve, or one in each direction; whether it is a loop."""
    paths = [p for p in paths if p.acts]
    z = np.concatenate([p.variables[variable][0] for p in paths])
    values = np.concatenate([p.values for p in paths])
    if _scatter(z, values) <= FUNCTION:
        return [_function(change, "law", z, values)], False
    lines = []
    longest = max(paths, key=lambda p: float(np.ptp(p.variables[variable][0])))
    z, values = longest.variables[variable][0], longest.values
    keep = _cycle(z)
    at = thinned([z[keep], values[keep]], 240)
    lines.append(_scaled(change, "law", z[keep][at], values[keep][at]))
    return lines, True


def _cycle(z: Array) -> slice:
    """The widest stretch between three turns of a variable."""
    smooth = np.convolve(z, np.ones(5) / 5.0, "same") if z.size > 50 else z
    turns = np.flatnonzero(np.diff(np.sign(np.diff(smooth))) != 0.0) + 1
    reach = 0.3 * float(np.ptp(z))
    ends = [0]
    for t in turns:
        if abs(smooth[t] - smooth[ends[-1]]) > reach:
            ends.append(int(t))
    ends.append(len(z) - 1)
    if len(ends) < 4:
        return slice(None)
    spans = [float(np.ptp(z[a : b + 1])) for a, b in zip(ends, ends[2:], strict=False)]
    best = int(np.argmax(spans))
    return slice(ends[best], ends[best + 2] + 1)


def _candidate(problem: Problem, fitted: Fitted, index: int) -> Candidate:
    """The effect of a set with its fitted shape."""
    at = index_of(problem, fitted.members, index) - len(problem.free)
    return shapes_of(problem, fitted.members, fitted.point.x)[at]


def _size(problem: Problem, fitted: Fitted, index: int) -> float:
    """Magnitude of an effect of a set [its unit]."""
    at = index_of(problem, fitted.members, index) - len(problem.free)
    return float(magnitudes_at(problem, fitted.members, fitted.point.x)[at])


@dataclass(frozen=True, eq=False)
class _Place:
    """The port at which an effect acts, and its force along the records."""

    port: int
    label: str
    unit: str
    paths: tuple[_Path, ...]
    among: tuple[str, ...]
    """Variables on which it depends."""
    sign: float
    """-1: the force is shown as a resistance."""

    @classmethod
    def of(
        cls, problem: Problem, fitted: Fitted, index: int, chosen: Sequence[int]
    ) -> _Place | None:
        """The port of an effect; None: the model has none there."""
        effect, model = problem.causes[index].effect, problem.model
        assert effect is not None
        found = []
        place: Coordinate | Coupling | None = None
        port, depends = -1, set()
        for r in chosen:
            along = _Along.of(problem, fitted, index, r)
            if along is None:
                return None
            keys = [k for k in along.at({}) if k in along.own]
            if port < 0:
                place = _coordinate(model.coordinates, effect.component, keys)
                port = next(
                    (
                        j
                        for j, p in enumerate(model.ports)
                        if (place is not None and p.name == place.name)
                        or (place is None and [p.position] == keys and not p.speed)
                    ),
                    -1,
                )
            if port < 0 or not keys:
                return None
            force = along.force(place, keys[0])
            depends |= {n for n in along.names if along.changes(n, keys[0])}
            acts = problem.causes[index].acts_in(problem.fit[r])
            found.append(_Path(r, acts * force, along.variables(place), acts))
        among = _those(found[0].variables, place, depends)
        moves = place is not None and bool(among)
        return cls(
            port,
            ("resisting " * moves + _kind(model.ports[port].unit)) if place else "rate",
            model.ports[port].unit,
            tuple(replace(p, values=-p.values) if moves else p for p in found),
            among or tuple(found[0].variables),
            -1.0 if moves else 1.0,
        )


def _kind(unit: str) -> str:
    """Word for what acts on a coordinate, by its unit."""
    return {"N": "force", "N m": "torque"}.get(unit, "acceleration" if "s^2" in unit else "force")


def _coordinate(
    coordinates: Sequence[Coordinate | Coupling], component: str, keys: Sequence[str]
) -> Coordinate | Coupling | None:
    """The coordinate of an effect: that of its component, or else of the speed that it changes."""
    named = next((c for c in coordinates if c.name == component), None)
    moved = (c for c in coordinates if {p.speed for p in c.parts} == {*keys})
    return named or next(moved, None)


def _those(
    variables: Mapping[str, Any], place: Coordinate | Coupling | None, depends: set[str]
) -> tuple[str, ...]:
    """Names of the variables on which an effect depends, those of its place first."""
    own = []
    if place is not None:
        first = place.parts[0]
        own += ["position"] * bool(first.position and first.position in depends)
        own += ["speed"] * (first.speed in depends)
    return tuple([*own, *(n for n in variables if n in depends)])


@dataclass(frozen=True, eq=False)
class _Along:
    """The rate of an effect along one record."""

    rate: Callable[[dict[str, Array]], Mapping[str, Any]]
    own: tuple[str, ...]
    """States of the model."""
    names: tuple[str, ...]
    """States and inputs."""
    x: Mapping[str, Array]
    u: Mapping[str, Array]
    p: Named
    time: Array
    units: Mapping[str, str]

    @classmethod
    def of(cls, problem: Problem, fitted: Fitted, index: int, r: int) -> _Along | None:
        """The effect along the fitted motion of a record; None: the motion is not known."""
        o, model = problem.fit[r], problem.model
        jobs = _jobs(problem, fitted, r, 1)
        path = motion(model, o.record, jobs)
        if path is None or not np.isfinite(path).all():
            return None
        candidate, size = _candidate(problem, fitted, index), _size(problem, fitted, index)
        states = [s.name for s in model.states()]
        x = {n: path[:, i] for i, n in enumerate(states)}
        at = len(states)
        for c in jobs.included:  # hidden states are those of the effects in their order
            hidden = c.effect.hidden if c.effect.observe is None and c.effect.excite is None else ()
            if c.effect is candidate.effect:
                x |= {h.name: path[:, at + i] for i, h in enumerate(hidden)}
            at += len(hidden)
        u = {n: o.record.inputs[n] for n in o.record.inputs}
        theta = theta_at(problem, fitted.point.x)
        p = Named({q.name: v for q, v in zip(model.parameters, theta, strict=True)})
        time = o.record.time

        def rate(changed: dict[str, Array]) -> Mapping[str, Any]:
            assert candidate.effect.rate is not None
            named = [Named({n: changed.get(n, v) for n, v in of.items()}) for of in (x, u)]
            return candidate.effect.rate(time, *named, p, size, candidate.shape)

        units = {s.name: s.unit for s in model.states()} | dict(o.record.input_units)
        return cls(rate, tuple(states), (*states, *u), x, u, p, time, units)

    def at(self, changed: dict[str, Array]) -> dict[str, Array]:
        """Rates, with other values of some states or inputs."""
        return {k: 0.0 * self.time + v for k, v in self.rate(changed).items()}

    def changes(self, name: str, key: str) -> bool:
        """Whether the rate of a state depends on a state or an input."""
        values = self.x.get(name, self.u.get(name))
        assert values is not None
        plain, other = self.at({})[key], self.at({name: np.roll(values, values.size // 3)})[key]
        return float(np.abs(plain - other).max()) > 1e-6 * float(np.abs(plain).max())

    def force(self, place: Coordinate | Coupling | None, key: str) -> Array:
        """Force of the effect on a coordinate, or the rate of a state without one, (n,)."""
        values = self.at({})[key]
        if place is None:
            return values
        pushed = place.push(np.float64(1.0), self.time, Named(self.x), Named(self.u), self.p)
        return np.asarray(values / pushed[key])

    def variables(self, place: Coordinate | Coupling | None) -> dict[str, tuple[Array, str]]:
        """What the effect may depend on, with units."""
        out: dict[str, tuple[Array, str]] = {}
        if place is not None:
            q, v = place.motion(Named(self.x))
            unit = place.travel_unit
            if q is not None:
                out["position"] = np.asarray(q), unit
            out["speed"] = np.asarray(v), f"{unit}/s"
        for n in self.names:
            values = self.x.get(n, self.u.get(n))
            assert values is not None
            out[n] = values, self.units.get(n, "")
        return out


def _jobs(problem: Problem, fitted: Fitted, r: int, count: int) -> Jobs:
    """Equal simulations of a record."""
    ask = EvaluationRequest(fitted.members, fitted.point, problem.fit)
    x = fitted.point.x
    return Jobs(
        theta=np.tile(theta_at(problem, x), (count, 1)),
        starts=np.tile(start_states(problem, ask, r), (count, 1)),
        included=shapes_of(problem, fitted.members, x),
        magnitudes=np.tile(magnitudes_at(problem, fitted.members, x, problem.fit[r]), (count, 1)),
    )


def _force(
    problem: Problem,
    fitted: Fitted,
    change: Change,
    place: _Place,
) -> Law | None:
    """A force against the variable of its law."""
    variable = _variable(place.paths, place.among)
    lines, loop = _lines(change, place.paths, variable)
    z = np.concatenate([p.variables[variable][0] for p in place.paths])
    both = loop or variable == "position"
    edges = _edges(z, IN_EACH if both else INTERVALS, at_zero=variable == "speed")
    port = problem.model.ports[place.port]

    def responses(r: int, patterns: Array) -> Array:
        jobs = _jobs(problem, fitted, r, 1 + len(patterns))
        record = problem.fit[r].record
        evenly = np.linspace(record.time[0], record.time[-1], record.samples)
        forces = np.zeros((1 + len(patterns), len(problem.model.ports), record.samples))
        step = STEP * port.scale
        for k, pattern in enumerate(patterns):
            forces[1 + k, place.port] = step * np.interp(evenly, record.time, pattern)
        y = observe_all(problem.model, [(record, replace(jobs, forces=forces))])[0]
        return np.asarray((y[1:] - y[0]) / step)

    points = [
        found
        for path in place.paths
        for found in _estimated(
            problem, fitted, path, variable, edges, both, responses, port.scale, place.sign
        )
    ]
    points = _sure(points, lines) if points else []
    if not points:
        return None
    x = Axis(variable, place.paths[0].variables[variable][1])
    kind = "loop" if loop else "law"
    return _law(change, kind, x, Axis(place.label, place.unit), points, lines)


def _input(
    problem: Problem, fitted: Fitted, change: Change, index: int, chosen: Sequence[int]
) -> Law | None:
    """Change of an input against its record: what drives the machine less what was recorded."""
    candidate, size = _candidate(problem, fitted, index), _size(problem, fitted, index)
    excite, paths = candidate.effect.excite, []
    assert excite is not None
    name = ""
    for r in chosen:
        record = problem.fit[r].record
        acting = record.with_changed_inputs(lambda whole: excite(whole, size, candidate.shape))
        acts = problem.causes[index].acts_in(problem.fit[r])
        moved = {n: acting.inputs[n] - v for n, v in record.inputs.items()}
        name = name or max(moved, key=lambda n: float(np.abs(moved[n]).max()))
        unit = record.input_units.get(name, "")
        paths.append(_Path(r, acts * moved[name], {name: (record.inputs[name], unit)}, acts))
    z = np.concatenate([p.variables[name][0] for p in paths])
    edges = _edges(z, INTERVALS, at_zero=True)

    def responses(r: int, patterns: Array) -> Array:
        record = problem.fit[r].record
        step = STEP * float(np.std(record.inputs[name]) or 1.0)
        batches = [
            (replace(record, inputs={**record.inputs, name: record.inputs[name] + step * pattern}),
             _jobs(problem, fitted, r, 1))
            for pattern in (0.0 * record.time, *patterns)
        ]  # fmt: skip
        y = np.array([run[0] for run in observe_all(problem.model, batches)])
        return np.asarray((y[1:] - y[0]) / step)

    lines, loop = _lines(change, paths, name)
    points = [
        found
        for path in paths
        for found in _estimated(
            problem, fitted, path, name, edges, loop, responses, float(np.ptp(z)) or 1.0
        )
    ]
    points = _sure(points, lines) if points else []
    unit = paths[0].variables[name][1]
    axes = Axis(f"recorded {_short(name)}", unit), Axis("acting, less recorded", unit)
    return _law(change, "loop" if loop else "law", *axes, points, lines) if points else None


def _edges(z: Array, count: int, *, at_zero: bool) -> Array:
    """Ends of the intervals of a variable: half by its values, half by its samples."""
    share = np.linspace(0.0, 1.0, count + 1)
    low, high = float(z.min()), float(z.max())
    edges = 0.5 * (np.quantile(z, share) + low + share * (high - low))
    if at_zero and low < 0.0 < high:
        inner = 1 + int(np.argmin(np.abs(edges[1:-1])))
        edges[inner] = 0.0
    return np.unique(edges)


def _estimated(
    problem: Problem,
    fitted: Fitted,
    path: _Path,
    variable: str,
    edges: Array,
    both: bool,
    responses: Callable[[int, Array], Array],
    scale: float,
    sign: float = 1.0,
) -> Iterator[Points]:
    """Mean action in each interval of a variable in a record, in each direction if ``both``.

    Least squares of what remains on the responses to an action in one interval. Starts and other
    unknowns of the record are fitted with it; nothing is assumed about the action.
    """
    o, z = problem.fit[path.r], path.variables[variable][0]
    at = np.clip(np.searchsorted(edges, z, side="right") - 1, 0, len(edges) - 2)
    ways = [np.ones(z.size, dtype=bool)]
    if both:
        rising = np.gradient(z) > 0.0
        ways = [rising, ~rising]
    cells = [(at == k) & way for way in ways for k in range(len(edges) - 1)]
    kept = [k for k, cell in enumerate(cells) if cell.sum() >= 3]
    if not kept:
        return
    patterns = np.array([cells[k] for k in kept], dtype=np.float64)
    response = np.moveaxis(responses(path.r, patterns)[:, :, list(problem.channels)], 0, -1)
    good = o.valid[..., None] & np.isfinite(response)
    columns = np.where(good, response / o.sd[..., None], 0.0)
    linear = fitted.linears[path.r]
    # A wide prior: where no reading shows the action, it has a large deviation.
    weight = [q.weight for q in local_of(problem, fitted.members, o)]
    prior = np.concatenate([np.full(len(kept), (100.0 * scale) ** -2), weight])
    a = np.concatenate([columns, linear.by_local], axis=2)
    noise = np.ones_like(fitted.noise)
    for _ in range(ROUNDS):  # as if the action explained everything but the noise of the sensors
        b = (a / noise[:, None]).reshape(-1, a.shape[2])
        covariance = np.linalg.inv(b.T @ b + np.diag(prior))
        step = covariance @ (b.T @ (linear.residual / noise).ravel())
        left = linear.residual - a @ step
        noise = np.sqrt(np.maximum((left**2).sum(axis=0) / np.maximum(o.samples, 1.0), 1.0))
    share = effective_share([replace(linear, residual=left)], noise)
    sd = np.sqrt(np.diag(covariance)[: len(kept)] / share)
    law = np.array([path.values[cells[k]].mean() for k in kept])
    mean = np.array([z[cells[k]].mean() for k in kept])
    values = law + sign * step[: len(kept)]
    count = len(edges) - 1
    for way in range(len(ways)):
        own = np.array([k // count == way for k in kept])
        arrow = ("rising", "falling")[way] if both else ""
        label = f"{o.record.name}{f', {arrow}' if arrow else ''}"
        yield Points(label, mean[own], values[own], sd[own])


def _sure(points: Sequence[Points], lines: Sequence[Line]) -> list[Points]:
    """Points whose deviation is small beside the law."""
    values, sd = (np.concatenate([getattr(p, of) for p in points]) for of in ("y", "sd"))
    sure = values[sd <= np.median(sd)]
    limit = UNSURE * max(float(np.ptp(v)) for v in (sure, *(x.y for x in lines)))
    out = []
    for p in points:
        keep = p.sd < limit
        if keep.any():
            out.append(Points(p.label, p.x[keep], p.y[keep], p.sd[keep]))
    return out
