"""Derivatives of the values of a summary: event times, and quantities at events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feltmb.mechanism import Action
from feltmb.run.events import name_events
from feltmb.run.simulate import list_changes
from feltmb.run.strikes import find_strikes

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]


def summary_outputs(action: Action) -> list[str]:
    """Outputs that the summary needs in addition to the requested ones."""
    point = action.config.reading.key_point
    return [f"{point}.y"] if point is not None else []


def add_rules(action: Action, options: Any) -> list[str]:
    """Add the travels of tracking points that are events."""
    import numpy as np

    names = []
    for name, rule in action.config.events.items():
        if rule.point is None or rule.travel is None:
            continue
        direction = np.asarray(rule.direction) / np.linalg.norm(rule.direction)
        index = action.mechanism.point_names.index(rule.point)
        options.add_rule(name, index, (float(direction[0]), float(direction[1])), rule.travel)
        names.append(name)
    return names


def summarize(
    action: Action, result: Any, rules: list[str]
) -> tuple[dict[str, float], dict[str, Array], list[dict[str, Any]]]:
    """Values of the summary with their derivatives, and events with theirs."""
    numbers = action.mechanism.contact_numbers
    run = result.run
    changes = list_changes(action, run.events, rules)
    named = name_events(changes, action.config.events)
    derived = {(e.contact, e.monitor, e.direction, e.when): e for e in result.events}
    begin = float(result.time[0])
    by_index = {
        i: derived.get((contact, monitor, direction, time + begin))
        for i, (time, contact, monitor, direction) in enumerate(run.events)
    }
    summary: dict[str, float] = {}
    out: dict[str, Array] = {}

    def put(name: str, value: float, derivative: Any) -> None:
        summary[name] = float(value)
        out[name] = derivative

    for name, i in named.items():
        event = by_index[i]
        if event is not None:
            put(f"{name}_time", changes[i].time + begin, event.time)
    strike = action.config.reading.strike_contact
    if strike is not None:
        column = numbers.index(strike)
        on, off = next(iter(find_strikes(changes, strike)), (None, None))
        first = by_index.get(on) if on is not None else None
        last = by_index.get(off) if off is not None else None
        if on is not None and first is not None:
            put("impact_time", changes[on].time + begin, first.time)
            put("impact_speed", run.event_approach[on, column], first.approach[column])
        if on is not None and off is not None and first is not None and last is not None:
            put("rebound_speed", -run.event_approach[off, column], -last.approach[column])
            duration = changes[off].time - changes[on].time
            put("string_contact_duration", duration, last.time - first.time)
        for (contact, force, _), derivative in zip(run.peaks, result.peaks, strict=True):
            if contact == column and force > 0:
                put("max_string_force", force, derivative)
        let_off = by_index.get(named["let_off"]) if "let_off" in named else None
        if let_off is not None:
            gap = -run.event_compression[named["let_off"], column]
            put("let_off_gap", gap, -let_off.compression[column])
    names = {i: name for name, i in reversed(list(named.items()))}
    events = []
    for i, change in enumerate(changes):
        event = by_index[i]
        if event is None:
            continue
        name = (
            names.get(i)
            or change.monitor
            or (f"contact{change.contact:02d}" if change.contact else "finger")
            + ("_on" if change.closes else "_off")
        )
        events.append({"event": name, "time": event.when, "gradient": event.time})
    return summary, out, events


def add_key_travel(
    action: Action,
    result: Any,
    names: list[str],
    array: Array,
    summary: dict[str, float],
    out: dict[str, Array],
) -> None:
    """Add the largest downward travel of the key point, if the segment starts at rest."""
    import numpy as np

    column = f"{action.config.reading.key_point}.y"
    if column not in names or result.time[0] != 0.0:
        return
    i = names.index(column)
    y = result.values[:, i]
    lowest = int(np.argmin(y))
    summary["key_travel"] = float(y[0] - y[lowest])
    out["key_travel"] = array[0, i] - array[lowest, i]
