"""Let-off, strike and check that no record reaches are told, and only then."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb.adapters import mechanism_model
from unmodeled.data import read_records
from unmodeled.errors import DataError

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


def test_a_stroke_with_an_unknown_zero_is_told_that_alone(model, strokes):
    lost = pressed(model, strokes[0], 0.45)
    lost = replace(lost, outputs={n: v - 0.13 for n, v in lost.outputs.items()})
    notes = model.ready([lost]).notes
    assert not [n for n in notes if "no record reaches" in n]
    (note,) = [n for n in notes if "starts neither at zero nor at the rest values" in n]
    assert all(f"{n} at " in note for n in lost.outputs if n.endswith((".x", ".y")))
    assert "--origin CHANNEL=start" in note


def test_a_motion_of_the_finger_without_its_zero_is_refused(model, strokes):
    motion = 0.128 + 0.01 * np.linspace(0.0, 1.0, strokes[0].samples)
    moved = replace(
        strokes[0],
        inputs={"displacement": motion},
        input_mode="motion",
        input_units={},
        input_sigma={},
    )
    with pytest.raises(DataError, match=r"displacement starts at 0\.128 m and moves by 0\.01 m"):
        model.ready([moved])
