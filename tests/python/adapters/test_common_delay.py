"""A common delay of all cameras is told before any fit, and not without one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb.adapters import mechanism_model
from feltmb.data import read_records
from feltmb.gap import check

CASES = Path(__file__).parents[3] / "examples" / "gap_action"
CHANNELS = ["key", "whippen", "hammer_tip"]


@pytest.fixture(scope="module")
def model():
    return mechanism_model(feltmb.load_action("steinway45"), channels=CHANNELS)[0]


def records_of(case, model, delay=0.0):
    """Records of a case of machines with drawn tolerances, with late cameras [s]."""
    signals = {"inputs": model.inputs or ("force",), "outputs": model.outputs}
    found = read_records(sorted((CASES / case).glob("*.csv")), **signals)

    def late(r):
        shifted = {n: np.interp(r.time - delay, r.time, y) for n, y in r.outputs.items()}
        return replace(r, outputs=shifted) if delay else r

    return [late(r) for r in found]


def told(model, records):
    return [h for h in check(model, records).hints if h.kind == "delay"]


@pytest.mark.parametrize("delay", [4e-3, -3e-3])
def test_a_delay_of_all_cameras_is_told(model, delay):
    records = records_of("none", model, delay)
    (hint,) = told(model, records)
    assert set(hint.channels) == set(model.outputs)
    rows = [r.delay for r in check(model, records).rows if np.isfinite(r.delay)]
    assert np.median(rows) == pytest.approx(delay, abs=1e-3)


@pytest.mark.parametrize(
    "case", ["none", "two", "butt_friction", "load_cell", "shank", "whippen_clearance"]
)
def test_no_delay_is_told_without_one(model, case):
    assert told(model, records_of(case, model)) == []
