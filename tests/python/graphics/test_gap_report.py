"""The page of a gap diagnosis in a real browser."""

from pathlib import Path

import pytest

from feltmb.cli import main

GAP = Path(__file__).parents[3] / "unmodeled" / "examples"


def test_the_report_loads_nothing_and_shows_verdict_and_pictures(browser, tmp_path):
    files = sorted((GAP / "data").glob("emps_*.csv"))
    out = tmp_path / "report"
    with pytest.raises(SystemExit) as stop:
        main(["gap", "diagnose", str(GAP / "emps.py"), *map(str, files), "-o", str(out)])
    assert stop.value.code == 0
    path = out / "report.html"
    browser.open(path)
    assert browser.complaints() == []
    loaded = [r for r in browser.requests() if not r.startswith("data:")]
    assert loaded == [path.resolve().as_uri()]
    assert "dry friction" in browser.run("document.body.innerText")
    sizes = browser.run(
        "[...document.querySelectorAll('svg')].map(s => s.getBoundingClientRect().width)"
        ".filter(w => w > 0)"  # others are in details
    )
    assert len(sizes) > 3
    assert min(sizes) > 100
