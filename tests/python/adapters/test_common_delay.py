"""A common delay of all cameras is told before any fit of an action, and not without one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb.adapters import mechanism_model
from feltmb.data import read_records
from feltmb.gap import Options, check, diagnose

CASES = Path(__file__).parents[3] / "examples" / "gap_action"
CHANNELS = ["key", "whippen", "hammer_tip"]


@pytest.fixture(scope="module")
def model():
    return mechanism_model(feltmb.load_action("steinway45"), channels=CHANNELS)


def records_of(case, model, delay=0.0):
    """Records of a case of machines with drawn tolerances, with late cameras [s]."""
    signals = {"inputs": model.inputs or ("force",), "outputs": model.outputs}
    found = read_records(sorted((CASES / case).glob("*.csv")), **signals)

    def late(r):
        shifted = {n: np.interp(r.time - delay, r.time, y) for n, y in r.outputs.items()}
        return replace(r, outputs=shifted) if delay else r

    return [late(r) for r in found]


def told(found):
    return [n for n in found.notes if n.startswith("all outputs are about")]


@pytest.mark.parametrize(("delay", "text"), [(4e-3, "4 ms late"), (-3e-3, "3 ms early")])
def test_a_delay_of_all_cameras_is_told(model, delay, text):
    (note,) = told(check(model[0], records_of("none", model[0], delay)))
    assert note.startswith(f"all outputs are about {text} against force where the motion")


@pytest.mark.parametrize(
    "case", ["none", "two", "butt_friction", "load_cell", "shank", "whippen_clearance"]
)
def test_no_delay_is_told_without_one(model, case):
    assert told(check(model[0], records_of(case, model[0]))) == []


def test_the_diagnosis_tells_it_before_its_fits(model):
    seen = []
    report = diagnose(
        model[0],
        model[1][:3],
        records_of("none", model[0], 4e-3),
        None,
        Options(advice=False, bootstrap=0),
        seen.append,
        stop=lambda: any(p.stage == "fit of the model" for p in seen),
    )
    first = next(p for p in seen if p.notice)
    assert first.stage == "checks of the data"
    assert first.notice.startswith("all outputs are about 4 ms late against force")
    assert first.notice in report.checks.warnings
