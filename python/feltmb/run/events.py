"""Named events of a run, found by rules of the mechanism file among contact changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from feltmb.mechanism import Action, NamedEvent


@dataclass(frozen=True)
class Change:
    """Opening or closing of a contact, or a tracking point that reaches the travel of an event."""

    time: float  #: time [s]
    contact: int | None  #: contact number
    monitor: str | None  #: name of a point event
    closes: bool  #: whether the contact closes, or the travel rises


def _concerns(change: Change, name: str, rule: NamedEvent) -> bool:
    if rule.point is not None:
        return change.monitor == name
    numbers = rule.contact if isinstance(rule.contact, list) else [rule.contact]
    return change.contact in numbers


def matches(change: Change, name: str, rule: NamedEvent) -> bool:
    """Whether a change is of the kind of a named event."""
    forward = rule.point is not None or rule.change == "closes"
    return _concerns(change, name, rule) and change.closes == forward


def undoes(change: Change, name: str, rule: NamedEvent) -> bool:
    """Whether a change is the reverse of a named event."""
    return _concerns(change, name, rule) and not matches(change, name, rule)


def _chosen(
    changes: Sequence[Change], name: str, rule: NamedEvent, low: float, high: float
) -> int | None:
    """Index of the change that a rule selects between two times [s]."""
    candidates = [
        i for i, c in enumerate(changes) if low <= c.time <= high and matches(c, name, rule)
    ]
    if not candidates:
        return None
    chosen = candidates[0] if rule.which == "first" else candidates[-1]
    last = changes[chosen]
    # The last opening before an event counts only if the contact then stayed open.
    undone = rule.which == "last" and rule.before is not None and rule.contact is not None
    undone = undone and any(
        c.contact == last.contact and c.closes != last.closes and last.time < c.time <= high
        for c in changes
    )
    return None if undone else chosen


def name_events(changes: Sequence[Change], rules: Mapping[str, NamedEvent]) -> dict[str, int]:
    """Index of the change that is each named event; events that did not happen are absent.

    A rule selects the first or last matching change, after and before other named events and within
    a time after the former. With ``unless``, it applies only if that event did not happen. If an
    event that the rule refers to with ``after`` or ``before`` did not happen, the event of the rule
    did not happen either.
    """
    found: dict[str, int] = {}
    visiting: set[str] = set()

    def resolve(name: str) -> int | None:
        if name in found:
            return found[name]
        rule = rules.get(name)
        if rule is None or name in visiting:
            return None
        visiting.add(name)
        if rule.unless is not None and resolve(rule.unless) is not None:
            return None
        low, high = float("-inf"), float("inf")
        if rule.after is not None:
            if (index := resolve(rule.after)) is None:
                return None
            low = changes[index].time
            high = high if rule.within is None else low + rule.within
        if rule.before is not None:
            if (index := resolve(rule.before)) is None:
                return None
            high = min(high, changes[index].time)
        chosen = _chosen(changes, name, rule, low, high)
        if chosen is not None:
            found[name] = chosen
        return chosen

    for name in rules:
        visiting.clear()
        resolve(name)
    return found


def list_changes(action: Action, events: Any, monitors: list[str]) -> list[Change]:
    """Events of the core, with contact numbers and names of monitored points."""
    numbers = action.mechanism.contact_numbers
    return [
        Change(
            time,
            numbers[contact] if contact >= 0 else None,
            monitors[monitor] if monitor >= 0 else None,
            direction > 0,
        )
        for time, contact, monitor, direction in events
    ]
