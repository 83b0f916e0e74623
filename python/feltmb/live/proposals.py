"""Proposes the next strokes to measure: a small plan of strokes that the page can simulate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from feltmb.adapters import MechanismModel, finger_limits, planned_strokes
from feltmb.live.states import Playing
from unmodeled.data import Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.experiment import Belief, Design, design, reasons
from unmodeled.experiment.designs import sensors_of
from unmodeled.fit import Effect

__all__ = ["Abandoned", "propose"]

#: Profiles that a person can repeat; a chirp needs a machine.
FAMILIES = ("step", "pulse", "repeated pulse", "two steps")
#: Numbers of evaluated profiles and of proposed strokes, for an answer within seconds.
CANDIDATES, STROKES = 4, 3
#: Number of records that the plan uses.
MOST_RECORDS = 4


class Abandoned(Error):
    """The request was canceled."""


def propose(
    model: MechanismModel,
    effects: Sequence[Effect],
    records: Sequence[Record] = (),
    *,
    belief: Belief | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """The most informative strokes, best first, with reasons.

    Parameters
    ----------
    records
        Existing records; the first :data:`MOST_RECORDS` are used.
    belief
        What a diagnosis of the records found; None: the records count by their inputs and sensors
        only.
    progress
        Function of the stage, the completed number and the total; it may raise :class:`Abandoned`.

    Raises
    ------
    InvalidParameter
        The mechanism has no finger, or none of the profiles moves it.
    """
    limits = finger_limits(model)
    if limits is None:
        raise InvalidParameter(
            f"{model.action.name}: no stroke can be proposed, because no finger plays it; "
            "hint: feltmb gap plan --limits takes any input"
        )
    counted = records[:MOST_RECORDS]
    usual = dict(planned_strokes(model, ("forte",))[0].sensors)
    found = design(
        model,
        effects,
        counted,
        limits=limits,
        sensors=sensors_of(counted, usual, usual) or usual,
        budget=STROKES,
        belief=belief,
        families=FAMILIES,
        candidates=CANDIDATES,
        refinements=0,
        progress=progress,
    )
    return _told(found, len(records))


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
                "reasons": reasons(e, len(found.effects)),
                "before": e.before,
                "after": e.after,
                "playing": playing.model_dump(include=keys),
            }
        )
    return {
        "rows": rows,
        "before": found.before,
        "after": found.after,
        "reachable": found.reachable,
        "notes": notes,
    }
