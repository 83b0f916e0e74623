"""Which stroke to measure next: a small plan, told as strokes that the page can play."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from feltmb.adapters import MechanismModel, finger_limits, planned_strokes
from feltmb.data import Record, Sensor
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.fit import Effect
from feltmb.gap import Belief, Design, design
from feltmb.gap.report import plain
from feltmb.live.states import Playing

__all__ = ["Abandoned", "propose"]

#: What a hand can repeat; a chirp needs a machine.
FAMILIES = ("press", "pulse", "slow press and release", "repeated note", "half press and press")
#: Profiles that are worked out in full, strokes that are proposed: an answer in seconds.
CANDIDATES, STROKES = 4, 3
#: Records that the plan counts.
MOST_RECORDS = 4


class Abandoned(FeltmbError):
    """Who asked does not want it any more."""


def propose(
    model: MechanismModel,
    effects: Sequence[Effect],
    records: Sequence[Record] = (),
    *,
    belief: Belief | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """Strokes that tell most, the best first, with their reasons.

    Parameters
    ----------
    records
        What was measured already; the first :data:`MOST_RECORDS` count.
    belief
        What a diagnosis of them believes.
    progress
        Told the stage, what is done and of how many; may raise :class:`Abandoned`.

    Raises
    ------
    InvalidParameter
        A mechanism that no finger plays, or that none of the profiles moves.
    """
    limits = finger_limits(model)
    if limits is None:
        raise InvalidParameter(
            f"{model.action.name}: no stroke can be proposed, because no finger plays it; "
            "hint: feltmb gap plan --limits takes any input"
        )
    counted = records[:MOST_RECORDS]
    found = design(
        model,
        effects,
        counted,
        limits=limits,
        sensors=_sensors(model, counted),
        budget=STROKES,
        belief=belief,
        families=FAMILIES,
        candidates=CANDIDATES,
        refinements=0,
        progress=progress,
    )
    return _told(found, len(records))


def _sensors(model: MechanismModel, records: Sequence[Record]) -> dict[str, Sensor]:
    """Those of the records; usual ones where there are none, or where these tell no noise."""
    usual = planned_strokes(model, ("forte",))[0].sensors
    seen = {n: s for r in records for n, s in r.sensors.items() if n in usual}
    return {
        n: s if s.sigma is not None else replace(s, sigma=usual[n].sigma) for n, s in seen.items()
    } or dict(usual)


def _told(found: Design, records: int) -> dict[str, Any]:
    notes = []
    if records > MOST_RECORDS:
        notes.append(f"Of {records} records the first {MOST_RECORDS} count.")
    if found.failed:
        notes.append(f"{found.failed} profiles could not be simulated and are left out.")
    notes += [f"None of these tells apart: {', '.join(group)}." for group in found.inseparable[:3]]
    rows = []
    for e in found.experiments:
        assert e.profile is not None
        time, value = e.profile.knots()
        playing = Playing(
            kind="planned",
            name=e.name,
            time=[float(f"{t:.9g}") for t in time],
            value=[float(f"{v:.9g}") for v in value],
            duration=e.profile.end,
        )
        keys = {"kind", "name", "drawn", "time", "value", "duration"}
        rows.append(
            {
                "name": e.name,
                "reasons": list(e.reasons),
                "before": plain(e.before),
                "after": plain(e.after),
                "playing": playing.model_dump(include=keys),
            }
        )
    return {
        "rows": rows,
        "before": plain(found.before),
        "after": plain(found.after),
        "reachable": plain(found.reachable),
        "notes": notes,
    }
