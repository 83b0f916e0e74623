"""Interpretation of a run according to ``[reading]`` of its mechanism file."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from feltmb.mechanism import Action, Reading
from unmodeled.errors import InvalidParameter
from unmodeled.files import parse_toml

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.run.results import Run


def reading_of(run: Run | Action) -> Reading:
    """``[reading]`` of a mechanism or that of a run; empty if the run does not contain it."""
    try:
        return Reading.model_validate(_tables(run).get("reading", {}))
    except ValidationError:
        return Reading()


@lru_cache(maxsize=8)
def _parsed(text: str) -> dict[str, Any]:
    try:
        return parse_toml(text, "run")
    except InvalidParameter:
        return {}


def _tables(run: Run | Action) -> dict[str, Any]:
    """Tables of a mechanism or that of a run, not to be changed; none if the run holds none."""
    text = run.to_toml() if isinstance(run, Action) else run.provenance.get("toml", "")
    return _parsed(str(text))


def _entry(node: Any, *path: str) -> Any:
    """Entry of nested tables, which a saved run may hold in any form; None if there is none."""
    for key in path:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node


def contact_parties(run: Run | Action, number: int | None) -> tuple[str, str] | None:
    """What meets in a contact: by its label ("hammer - string"), else its surfaces."""
    contact = _entry(_tables(run), "contacts", f"{number or 0:02d}")
    one, mark, other = str(_entry(contact, "label") or "").partition(" - ")
    surfaces = _entry(contact, "surfaces")
    if not mark and isinstance(surfaces, list) and len(surfaces) == 2:
        one, other = (str(s) for s in surfaces)
    return (one, other) if one and other else None


def strike_words(run: Run | Action) -> dict[str, str]:
    """Texts of the numbers of a strike, by their name in ``run.summary``.

    They name what the roles in ``[reading]`` name: the parties of the strike contact and of the
    first check contact, and the body of the key point.
    """
    reading = reading_of(run)
    parties = contact_parties(run, reading.strike_contact)
    key = _entry(_tables(run), "points", str(reading.key_point), "body") or "key"
    checks = contact_parties(run, next(iter(reading.check_contacts), None))
    words = {
        "impact_time": "impact",
        "max_impact_force": "largest force of the impact",
        "impact_duration": "contact of the impact lasts",
        "let_off_gap": "distance at let-off",
        "key_travel": f"{key} travel",
        "key_return_time": f"{key} is back",
        "check_end_time": f"{checks[1].partition(',')[0] if checks else 'check'} releases",
    }
    if parties is not None:
        one, other = parties
        labeled = _entry(_tables(run), "contacts", f"{reading.strike_contact:02d}", "label")
        the = "the " if " - " in str(labeled or "") else ""
        words |= {
            "impact_time": f"{one} meets {the}{other}",
            "max_impact_force": f"largest {other} force",
            "impact_duration": f"{other} contact lasts",
            "let_off_gap": f"{one} - {other} distance at let-off",
        }
    return words


#: Texts and SI units of numbers of a strike whose text is no matter of the mechanism.
_STRIKE = {
    "impact_time": ("", "s"),
    "impact_speed": ("impact speed (of the contact)", "m/s"),
    "max_impact_force": ("", "N"),
    "impact_duration": ("", "s"),
    "rebound_speed": ("rebound speed (of the contact)", "m/s"),
}
#: Numbers that follow the time of an event of the mechanism file, by its role or name.
_BEHIND = {
    "let_off": {"let_off_gap": ("", "m")},
    "landing": {"key_travel": ("", "m")},
    "check": {"check_gap": ("distance in check", "m")},
}


def strike_events(run: Run | Action) -> dict[str, str]:
    """Named events of the strike contact alone: name -> its change, ``opens`` or ``closes``."""
    number, events = reading_of(run).strike_contact, _entry(_tables(run), "events")
    if number is None or not isinstance(events, Mapping):
        return {}
    found = {n: (_entry(e, "contact"), str(_entry(e, "change"))) for n, e in events.items()}
    return {n: change for n, (own, change) in found.items() if own in (number, [number])}


def summary_rows(run: Run | Action) -> dict[str, tuple[str, str]]:
    """Text and SI unit of the numbers of a summary, by name and in the order of a table.

    The times of all events that the mechanism file names, the numbers of a strike, and what the
    roles in ``[reading]`` add; without ``[reading.rows]``.
    """
    words, reading = strike_words(run), reading_of(run)
    events = _entry(_tables(run), "events")
    same = strike_events(run)  # the numbers of a strike tell these
    rows: dict[str, tuple[str, str]] = {}
    for name, event in events.items() if isinstance(events, Mapping) else ():
        if name not in same:
            rows[f"{name}_time"] = (str(_entry(event, "label") or name.replace("_", " ")), "s")
            rows |= _BEHIND.get("landing" if name == reading.touch.landing else name, {})
    rows = _STRIKE | rows
    for more in _BEHIND.values():
        rows |= {key: row for key, row in more.items() if key not in rows}
    return {key: (words.get(key, text), unit) for key, (text, unit) in rows.items()}


def row_unit(run: Run, name: str) -> str:
    """SI unit of a row of ``[reading.rows]``."""
    output = reading_of(run).rows[name].output
    return "s" if output is None else run.unit(output)


def striker_speed(run: Run, reading: Reading | None = None) -> npt.NDArray[np.float64] | None:
    """Speed of the striking point along its direction [m/s]; None if there is none.

    ``reading``: that of the mechanism, if it is at hand: to read it from the run takes time.
    """
    striker = (reading_of(run) if reading is None else reading).striker
    if striker is None or f"{striker.point}.vx" not in run:
        return None
    length = (striker.direction[0] ** 2 + striker.direction[1] ** 2) ** 0.5
    x, y = (part / length for part in striker.direction)
    speed: npt.NDArray[np.float64] = x * run[f"{striker.point}.vx"] + y * run[f"{striker.point}.vy"]
    return speed
