"""Let-off, strike and check that no record reaches are told, and only then."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb.adapters import mechanism_model
from unmodeled.data import read_records

CASES = Path(__file__).parents[3] / "examples" / "gap_action"


@pytest.fixture(scope="module")
def model():
    return mechanism_model(feltmb.load_action("steinway45"), channels=["key", "hammer_tip"])[0]


@pytest.fixture(scope="module")
def strokes(model):
    return read_records(
        sorted((CASES / "none").glob("*.csv")), inputs=("force",), outputs=model.outputs
    )


def pressed(model, record, force):
    """The record with a smaller force, and the motion of the tabulated mechanism under it."""
    soft = replace(
        record,
        name=f"soft {record.name}",
        inputs={"force": np.minimum(record.inputs["force"], force)},
    )
    motion = model.simulator.whole(soft, model.simulator.base)
    outputs = {n: motion[:, i] for i, n in enumerate(model.outputs) if n in record.outputs}
    sensors = {n: record.sensors[n] for n in outputs}
    return replace(soft, outputs=outputs, sensors=sensors)


def told(model, records):
    return [n for n in model.ready(records).notes if "no record reaches" in n]


def test_strokes_to_the_string_have_no_note(model, strokes):
    assert told(model, strokes) == []


def test_soft_strokes_are_told_what_they_do_not_reach(model, strokes):
    soft = [pressed(model, r, 0.45) for r in strokes[:2]]
    (note,) = told(model, soft)
    assert "no record reaches the let-off (contact 05 stays " in note
    assert " mm open) and the strike (contact 06 stays " in note
    assert " mm open) and the check (contact 08 stays " in note
    # One complete stroke is sufficient.
    assert told(model, [soft[0], strokes[1]]) == []


def test_a_stroke_that_is_not_held_does_not_reach_the_check(model, strokes):
    (staccato,) = (r for r in strokes if r.name == "staccato")
    (note,) = told(model, [staccato])
    assert note.startswith("no record reaches the check (contact 08 stays 0.95 mm open), by")
    assert note.endswith("add a stroke that goes further and is held there")
