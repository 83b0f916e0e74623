"""Proposes the next strokes to measure: the packaged strokes, ordered by what they would tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from feltmb.adapters import MechanismModel, planned_strokes
from feltmb.live.states import Playing
from unmodeled.data import Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.experiment import Belief, plan
from unmodeled.fit import Effect

#: Packaged strokes that a person can play.
CANDIDATES = ("forte", "piano", "staccato", "press_release", "repeated")
#: Number of records that the plan uses, for an answer within seconds, and of proposed strokes.
MOST_RECORDS, STROKES = 4, 3


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
        The mechanism has no finger, or none of the strokes can be simulated.
    """
    strokes = planned_strokes(model, CANDIDATES)
    if not strokes:
        raise InvalidParameter(
            f"{model.action.name}: no stroke can be proposed, because no finger plays it; "
            "hint: feltmb gap plan takes files with any input"
        )
    counted = records[:MOST_RECORDS]
    sensors = {n: s for r in counted for n, s in r.sensors.items()}
    if sensors:
        usual = strokes[0].sensors
        known = {n: usual[n] if s.sigma is None and n in usual else s for n, s in sensors.items()}
        strokes = tuple(
            replace(r, sensors=known, outputs=dict.fromkeys(known, 0.0 * r.time)) for r in strokes
        )
    result = plan(model, effects, strokes, counted, belief=belief, progress=progress)
    notes = []
    if len(records) > MOST_RECORDS:
        notes.append(f"Of {len(records)} records the first {MOST_RECORDS} count.")
    if result.failed:
        notes.append(f"The model cannot simulate {', '.join(result.failed)}.")
    notes += [f"None of these tells apart: {', '.join(group)}." for group in result.inseparable[:3]]
    shown = result.records[:STROKES]
    rows = [
        {
            "name": r.record.name,
            "reasons": r.reasons(len(result.effects)),
            "before": r.before,
            "after": r.after,
            "playing": Playing(name=r.record.name).model_dump(include={"kind", "name"}),
        }
        for r in shown
    ]
    return {"rows": rows, "before": result.before, "after": shown[-1].after, "notes": notes}
