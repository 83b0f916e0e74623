"""The page of a gap diagnosis in a real browser: its viewers show the records beside the models."""

from pathlib import Path

import numpy as np
import pytest

from feltmb.cli import main
from feltmb.data import read_records

GAP = Path(__file__).parents[3] / "examples" / "gap"


@pytest.fixture(scope="module")
def emps(tmp_path_factory):
    """Report of the measured guide, and its records."""
    files = sorted((GAP / "data").glob("emps_*.csv"))
    out = tmp_path_factory.mktemp("emps") / "report"
    with pytest.raises(SystemExit) as stop:
        main(["gap", "diagnose", str(GAP / "emps.py"), *map(str, files), "-o", str(out)])
    assert stop.value.code == 0
    return out / "report.html", read_records(files)


def test_the_report_shows_every_record_beside_the_models(browser, emps):
    path, records = emps
    browser.open(path)
    assert browser.complaints() == []
    assert browser.requests() == [path.resolve().as_uri()]
    names = browser.run(
        "[...document.querySelectorAll('.feltmb-view')].map(v => v.viewer.runs.map(r => r.name))"
    )
    assert names == [
        ["measured", "model as tabulated", "model, calibrated", "model with effects"]
    ] * len(records)
    channel = next(iter(records[0].outputs))
    for k, record in enumerate(records):
        values = record.outputs[channel]
        t = float(record.time[record.samples // 3])
        # The page counts in milliseconds.
        seen = browser.run(
            f"document.querySelectorAll('.feltmb-view')[{k}].viewer.runs.map("
            f"r => r.curves.get({channel!r}).at({1e3 * t}))"
        )
        want = float(np.interp(t, record.time, values))
        assert seen[0] == pytest.approx(want, abs=2e-3 * float(np.ptp(values)))
        # The model with effects is nearer to the whole record than the calibrated one.
        errors = browser.run(
            "(v => v.viewer.runs.slice(1).map(r => {"
            f"  let sum = 0; const m = v.viewer.runs[0].curves.get({channel!r});"
            f"  for (let i = 1; i < 200; i++) {{ const t = {1e3 * record.time[-1]} * i / 200;"
            f"    sum += (r.curves.get({channel!r}).at(t) - m.at(t)) ** 2; }}"
            f"  return sum; }}))(document.querySelectorAll('.feltmb-view')[{k}])"
        )
        assert errors[2] < 0.5 * errors[1]
