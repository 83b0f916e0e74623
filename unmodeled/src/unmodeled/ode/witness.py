"""Comparison of functions with their traces, with themselves in another order, and with arrays.

A trace may differ from its function where the function asks for the type of its arguments, or
catches what a symbol refuses; it may have a state of its own; it may mix jobs if it gets arrays.
No list of such functions is complete. Therefore each function is called with plain numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, shown
from unmodeled.models.model import Candidate, Jobs
from unmodeled.ode.calling import explained, line_of
from unmodeled.ode.tape import NotTraceable, Traced
from unmodeled.ode.traces import Key, Part, System, Untrue, Values, has_state, keys_of

#: Number of points at which a function is compared, half of them on motions.
POINTS = 24
#: Points among them that are far outside of the range.
FAR = 4
#: Largest difference, relative to the value, and the change of arguments that tells branches [1].
EQUAL = 1e-9

#: Values by target, or the text of an exception.
Row = dict[Key, float] | str


@dataclass(frozen=True, eq=False)
class Motion:
    """A simulated record."""

    record: Record
    jobs: Jobs
    """Jobs of the record; the first one is simulated."""
    states: Array
    """(n, nx)"""


def points_of(system: System, motions: Sequence[Motion]) -> dict[Key, Array]:
    """Points of the range of records: on the motions, then anywhere in it, (POINTS,)."""
    random = np.random.default_rng(0)
    good = [np.flatnonzero(np.isfinite(m.states).all(axis=1)) for m in motions]
    where = [(m, i) for m, rows in enumerate(good) for i in rows]
    places = [where[k] for k in np.sort(random.integers(len(where), size=POINTS // 2))]
    out: dict[Key, Array] = {}
    trial = {("x", s.name): 2.0 * (abs(s.start) + s.scale) for s in system.states}
    trial |= {("u", n): 2.0 for n in system.inputs}
    for key in keys_of(system):
        signals = [_signal(system, m, key) for m in motions]
        on = np.array([signals[m][i] for m, i in places])
        seen = [s[g] for s, g in zip(signals, good, strict=True)]
        box = _box(np.concatenate([*seen, *_further(system, motions, key)]))
        out[key] = np.append(on, random.uniform(*box, POINTS - len(on)))
        if key in trial:  # a running maximum has seen the trial of the model
            size = (3.0 * max(map(abs, box)) + trial[key]) * random.uniform(1.0, 2.0, FAR)
            out[key][-FAR:] = size * random.choice([-1.0, 1.0], FAR)
    return out


def _further(system: System, motions: Sequence[Motion], key: Key) -> Iterator[Array]:
    """Values of a state or parameter beside the motions: measured ones, and those of all jobs."""
    if key[0] == "x":
        shown_as = {of: n for n, of in system.outputs.items() if isinstance(of, str)}
        measured = (m.record.outputs.get(shown_as.get(key[1], "")) for m in motions)
        yield from (v for v in measured if v is not None)
        yield from (m.jobs.starts[:, system.names.index(key[1])] for m in motions)
    elif key[0] == "p":
        yield from (m.jobs.theta[:, system.parameters.index(key[1])] for m in motions)


def points_along(system: System, motion: Motion, states: Sequence[str]) -> dict[Key, Array]:
    """Points of a motion in the order of time, with all of its states, (POINTS,)."""
    good = np.flatnonzero(np.isfinite(motion.states).all(axis=1))
    rows = good[np.linspace(0, len(good) - 1, POINTS).astype(int)]
    out = {key: _signal(system, motion, key)[rows] for key in keys_of(system)}
    return out | {("x", n): motion.states[rows, i] for i, n in enumerate(states)}


def _signal(system: System, motion: Motion, key: Key) -> Array:
    """Values of an input of a tape along a motion, (n,)."""
    record, n = motion.record, len(motion.states)
    if key[0] == "t":
        return record.time
    if key[0] == "x":
        return np.asarray(motion.states[:, system.names.index(key[1])])
    if key[0] == "u":
        return record.inputs[key[1]]
    return np.full(n, motion.jobs.theta[0, system.parameters.index(key[1])])


def _box(values: Array) -> tuple[float, float]:
    """A range that is a tenth wider than that of values, and of the same sign."""
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    more = 0.1 * ((high - low) or abs(high) or 10.0)
    return low - (more if low < 0.0 else min(more, 0.5 * low)), high + more


def effect_points(points: Mapping[Key, Array], candidate: Candidate) -> dict[Key, Array]:
    """Points with the hidden states, the magnitude and the shape of an effect."""
    random, effect = np.random.default_rng(1), candidate.effect
    out = dict(points)
    for h in effect.hidden:
        out["x", h.name] = h.start + h.scale * random.uniform(-1.0, 1.0, POINTS)
    low, high = (np.clip(v, -effect.scale, effect.scale) for v in effect.bounds)
    out["size",] = random.uniform(low, high, POINTS)
    parts = candidate.shape if isinstance(candidate.shape, tuple) else (candidate.shape,)
    for k, value in enumerate(v for v in parts if isinstance(v, float)):
        out["shape", k] = np.full(POINTS, value)
    return out


def compare(
    parts: Iterable[Part], traced: Traced | NotTraceable, points: Mapping[Key, Array]
) -> tuple[bool, ...]:
    """Compare functions at points with what they return again, and with their trace or with arrays.

    Returns whether each of them, if it is not traced, takes arrays of jobs.

    Raises
    ------
    InvalidParameter
        They differ.
    """
    with np.errstate(all="ignore"):
        return tuple(_takes_arrays(part, traced, points) for part in parts)


def _takes_arrays(part: Part, traced: Traced | NotTraceable, points: Mapping[Key, Array]) -> bool:
    at = [_point(points, i) for i in range(len(points["t",]))]
    found = [_called(part, p) for p in at]
    again = [_called(part, p) for p in at[::-1]][::-1]
    for p, one, other in zip(at, found, again, strict=True):
        for target, a, b in _pairs(one, other):
            if not equal(a, b):
                raise has_state(part, f"{word(target)} is {_text(a)}, then {_text(b)}{_at(p)}")
    if isinstance(traced, Traced):
        for text in differences(part, traced, points, found):
            raise Untrue(text)
        return False
    return all(_as_arrays(part, points, found, count) for count in (POINTS, 2))


def differences(
    part: Part, traced: Traced, points: Mapping[Key, Array], found: Sequence[Row]
) -> Iterator[str]:
    """Sentences about where a function and its trace differ."""
    nodes = {t: n for t, n in traced.values.items() if t in _targets(traced, found)}
    values = traced.tape.evaluated(nodes.values(), points)
    for i, row in enumerate(found):
        at = _point(points, i)
        if isinstance(row, str):
            yield f"{part.what} raises {row}{_at(at)}"
            continue
        for target, node in nodes.items():
            a, b = row.get(target, 0.0), float(np.broadcast_to(values[node], len(found))[i])
            if not equal(a, b) and not _near(part, target, at, points, a, b):
                yield (
                    f"{part.what} gives {_text(a)} for {word(target)} when it is called with "
                    f"numbers, and {_text(b)} when it is traced{line_of(part.function)}{_at(at)}; "
                    "expected a function that does not ask for the type of its arguments, that "
                    "catches no exception of them, and that multiplies or adds no conditions but "
                    "by np.where"
                )


def _targets(traced: Traced, found: Sequence[Row]) -> set[Key]:
    """Targets of a part: those that it returned; all, if its rates differ from call to call."""
    own = {t for row in found if not isinstance(row, str) for t in row}
    return own or set(traced.values)


def _point(points: Values, i: int) -> dict[Key, Any]:
    return {k: v[i] for k, v in points.items()}


def _called(part: Part, at: Values) -> Row:
    """What a function returns for numbers."""
    try:
        return {t: _number(v) for t, v in part.of(at).items()}
    except NotTraceable:
        raise has_state(part) from None
    except InvalidParameter:
        raise
    except Exception as error:
        return explained(error)


def _number(value: Any) -> float:
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "biuf":
        return float(value)  # a symbol, or an exception
    return float(array.reshape(())[()])


def _pairs(one: Row, other: Row) -> Iterator[tuple[Key, Any, Any]]:
    if isinstance(one, str) or isinstance(other, str):
        if type(one) is not type(other):
            yield ("rate", ""), one, other
        return
    for target in dict.fromkeys([*one, *other]):
        yield target, one.get(target, 0.0), other.get(target, 0.0)


def equal(a: Any, b: Any) -> bool:
    """Whether two values differ by rounding only."""
    if isinstance(a, str) or isinstance(b, str):
        return False
    return bool(a == b or abs(a - b) <= EQUAL * max(abs(a), abs(b)) or (a != a and b != b))


def _near(part: Part, target: Key, at: Values, points: Values, a: float, b: float) -> bool:
    """Whether changes of the arguments in the last digits change a value as much: a branch."""
    random, spread = np.random.default_rng(2), 0.0
    for _ in range(4):
        moved = {
            k: v + EQUAL * random.choice([-1.0, 1.0]) * (abs(v) + np.ptp(points[k]))
            for k, v in at.items()
        }
        row = _called(part, moved)
        other = np.nan if isinstance(row, str) else row.get(target, 0.0)
        if np.isfinite(other) != np.isfinite(a):
            return True
        spread = max(spread, abs(other - a)) if np.isfinite(a) else spread
    return bool(abs(a - b) <= 10.0 * spread)


def _as_arrays(part: Part, points: Values, found: Sequence[Row], count: int) -> bool:
    """Whether a function returns for arrays what it returns for numbers."""
    at = {k: np.array(v[:count]) for k, v in points.items()}
    for v in at.values():
        v.setflags(write=False)
    try:
        got = {t: column(v, count) for t, v in part.of(at).items()}
    except Exception:
        return False
    rows = [r for r in found[:count] if not isinstance(r, str)]
    return len(rows) == count and all(
        equal(row.get(t, 0.0), float(got[t][i]) if t in got else 0.0)
        for i, row in enumerate(rows)
        for t in dict.fromkeys([*row, *got])
    )


def column(value: Any, count: int) -> Array:
    """A value for each of some jobs.

    Raises
    ------
    ValueError
        It has another shape, or is no real number.
    """
    array = np.asarray(value)
    if array.shape not in ((), (1,), (count,)) or array.dtype.kind not in "biuf":
        raise ValueError(f"is {shown(value)}")
    return np.broadcast_to(array.astype(np.float64), (count,))


def word(target: Key) -> str:
    """A target in words."""
    return f"the rate of {target[1]}" if target[0] == "rate" and target[1] else target[-1] or "it"


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.12g}"


def _at(at: Values) -> str:
    """A point in words."""
    return ", at " + ", ".join(f"{k[-1]} = {v:.6g}" for k, v in at.items())
