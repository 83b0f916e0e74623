"""Strikes of a run: the numbers of each strike, by the roles and rules of the mechanism file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.run.events import Change, matches, name_events, undoes

if TYPE_CHECKING:
    import numpy.typing as npt

    from feltmb.mechanism import Action

    Array = npt.NDArray[np.float64]

#: Contacts of hammer and string that follow each other within this time are one strike [s].
ONE_STRIKE = 6e-3

#: The distance in check is a mean over this time [s].
CHECK_WINDOW = 0.010


def find_strikes(changes: Sequence[Change], contact: int) -> list[tuple[int, int | None]]:
    """First closing of the strike contact, and its last opening within one strike, for each."""
    found: list[tuple[int, int | None]] = []
    for i, change in enumerate(changes):
        if change.contact != contact:
            continue
        on = found[-1][0] if found else None
        late = on is None or change.time > changes[on].time + ONE_STRIKE
        if change.closes and late:
            found.append((i, None))
        elif not change.closes and on is not None and not late:
            found[-1] = (on, i)
    return found


def strike_numbers(
    changes: Sequence[Change], on: int, off: int | None, result: Any, column: int
) -> dict[str, float]:
    """Time, speeds and duration of one strike; ``column``: place of the strike contact."""
    out = {
        "impact_time": changes[on].time,
        "impact_speed": float(result.event_approach[on, column]),
    }
    if off is not None:
        out["rebound_speed"] = float(-result.event_approach[off, column])
        out["impact_duration"] = changes[off].time - changes[on].time
    return out


def list_strikes(action: Action, changes: Sequence[Change], result: Any) -> list[dict[str, float]]:
    """Numbers of each strike of a run, SI units; names as in its summary.

    A strike begins where the key starts for the last time before its impact; if the key did not
    come back, where it is highest after the former impact; without a key, where the striker is
    farthest from the string. The named events of a strike are those until the next one begins.
    """
    roles = action.config.reading
    if roles.strike_contact is None:
        return []
    column = action.mechanism.contact_numbers.index(roles.strike_contact)
    strikes = find_strikes(changes, roles.strike_contact)
    turns = _turns(action, changes, [changes[on].time for on, _ in strikes], column, result)
    if turns is None:
        return []
    found = []
    times = [change.time for change in changes]
    for (on, off), low, high in zip(strikes, [-math.inf, *turns], [*turns, math.inf], strict=True):
        first, end = np.searchsorted(times, [low, high])
        part = changes[first:end]
        named = name_events(part, action.config.events)
        start = named.get(str(roles.touch.start))
        if start is not None and part[start].time > changes[on].time:
            del named[str(roles.touch.start)]  # of a bounce of the key
        out = {f"{name}_time": part[i].time for name, i in named.items()}
        out |= strike_numbers(changes, on, off, result, column)
        out |= _peak(action, changes[on].time, changes[off].time if off else high, column, result)
        if "let_off" in named:
            i = first + named["let_off"]
            out["let_off_gap"] = float(-result.event_compression[i, column])
        if "check" in named:
            add_check(action, column, result, out, low, high)
        out |= _ends(action, part, changes[on].time)
        if result.time.size and result.time[0] <= changes[on].time:
            out |= _key_travel(action, result, low, high)
        found.append(out)
    return found


def _samples(result: Any, name: str) -> Array | None:
    if name not in result.names:
        return None
    values: Array = result.data[:, result.names.index(name)]
    return values


def _turns(
    action: Action,
    changes: Sequence[Change],
    impacts: list[float],
    column: int,
    result: Any,
) -> list[float] | None:
    """Times between impacts at which the next strike begins; None if the samples do not tell."""
    if len(impacts) < 2:
        return [] if impacts else None
    back = _samples(result, f"{action.config.reading.key_point}.y")
    if back is None:
        compression = _samples(result, f"{action.mechanism.contact_names[column]}.compression")
        back = None if compression is None else -compression
    if back is None or result.time.size == 0 or result.time[0] > impacts[0]:
        return None
    name = str(action.config.reading.touch.start)
    rule = action.config.events.get(name)
    starts = [c.time for c in changes if rule is not None and matches(c, name, rule)]
    turns = []
    for one, two in pairwise(impacts):
        between = [time for time in starts if one < time < two]
        within = np.flatnonzero((result.time > one) & (result.time < two))
        if between:
            turns.append(between[-1])
        elif within.size:
            turns.append(float(result.time[within[np.argmax(back[within])]]))
        else:
            turns.append((one + two) / 2)
    return turns


def _peak(action: Action, on: float, off: float, column: int, result: Any) -> dict[str, float]:
    """Largest sample of the force of a strike; the integrator keeps that of the run alone."""
    force = _samples(result, f"{action.mechanism.contact_names[column]}.force")
    if force is None:
        return {}
    values = force[(result.time >= on) & (result.time <= off)]
    return {"sampled_impact_force": float(values.max())} if values.size else {}


def _ends(action: Action, part: Sequence[Change], impact: float) -> dict[str, float]:
    """When the backcheck lets the hammer go, and when the key is back."""
    out = {}
    checks = action.config.reading.check_contacts
    held: set[int | None] = set()
    for change in part:
        if change.contact in checks and change.time > impact:
            held = held | {change.contact} if change.closes else held - {change.contact}
            if not held:
                out["check_end_time"] = change.time
            else:
                out.pop("check_end_time", None)
    start = action.config.reading.touch.start
    rule = action.config.events.get(start) if start is not None else None
    if start is not None and rule is not None:
        back = [c.time for c in part if c.time > impact and undoes(c, start, rule)]
        if back:
            out["key_return_time"] = back[0]
    return out


def _key_travel(action: Action, result: Any, low: float, high: float) -> dict[str, float]:
    """Depth of the key below its first sample of the run."""
    y = _samples(result, f"{action.config.reading.key_point}.y")
    if y is None:
        return {}
    own = y[(result.time >= low) & (result.time <= high)]
    return {"key_travel": float(y[0] - own.min())} if own.size else {}


def add_check(
    action: Action,
    column: int,
    result: Any,
    out: dict[str, float],
    low: float = -math.inf,
    high: float = math.inf,
) -> None:
    """Distance of hammer and undisplaced string in check: a mean over 10 ms.

    These are the last 10 ms of the run if the hammer is in check then. If the backcheck has
    released it, they are the ones with the smallest swing of the last check that is so long.
    Samples from ``low`` to ``high`` [s] are used.
    """
    name = action.mechanism.contact_names[column]
    compression = _samples(result, f"{name}.compression")
    within = (result.time >= low) & (result.time <= high)
    if compression is None or np.count_nonzero(within) < 2:
        return
    time = result.time[within]
    held = sum(
        result.data[within, result.names.index(f"contact{c:02d}.force")]
        for c in action.config.reading.check_contacts
    )
    gap = -compression[within]
    displaced = _samples(result, "string.strike")
    if displaced is not None:
        gap = gap - displaced[within]
    tail = time >= time[-1] - CHECK_WINDOW
    if math.isfinite(high) or np.mean(np.asarray(held)[tail]) <= 0.0:
        found = _quietest(time, gap, held > 0.0)
        if found is None:
            return
        tail = found
    out["check_gap"] = float(np.mean(gap[tail]))
    out["check_gap_swing"] = float(np.ptp(gap[tail]))


def _quietest(time: Any, gap: Any, held: Any) -> Any:
    """Samples of the quietest window of the last check that is as long; None: there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
    for first, end in zip(edges[-2::-2], edges[::-2], strict=True):
        last = end - 1
        count = int((time[last] - time[first]) / CHECK_WINDOW)
        if count:
            starts = time[last] - CHECK_WINDOW * np.arange(count, 0, -1)
            windows = [(time >= t) & (time <= t + CHECK_WINDOW) for t in starts]
            return min(windows, key=lambda window: np.ptp(gap[window]))
    return None
