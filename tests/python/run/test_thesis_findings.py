"""``bench/thesis_studies``: what the thesis found, and what comes out here."""

import math
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from thesis_studies import actuator
from thesis_studies.findings import NAMES, Absent, Study, statistic

#: Outcomes of the claims of the thesis and of the study's own findings, each in the order of the
#: file: agrees (A), holds in part of the cases (P), disagrees (D), not tested (N).
OUTCOMES = {
    "wire": ("AAAADDA", "AP"),
    "wire_vibration": ("AA", "A"),
    "shank": ("DPAADP", ""),
    "string": ("AAAAAAAAADAAAD", "DDA"),
    "hysteresis": ("AADA", "AA"),
    "staccato": ("PPNPPPAPA", ""),
    "shapes": ("", "AAAAA"),
    "axial": ("", "AAAAAAAAA"),
    "letoff": ("", "AAAAA"),
    "input": ("AA", "AAD"),
    "contact-law": ("AAAADD", "ADDA"),
}
SLOW = ("staccato", "shapes", "axial", "input")
LETTER = {"agrees": "A", "depends": "P", "disagrees": "D", "not tested": "N"}


@cache
def study_of(name):
    return Study(name).run()


def test_every_file_is_tested(root):
    files = {path.stem for path in (root / "bench" / "thesis_studies").glob("*.toml")}
    assert files == set(NAMES) == set(OUTCOMES)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in OUTCOMES]
)
def test_findings(name):
    study = study_of(name)
    for claim, wanted in zip(("thesis", "own"), OUTCOMES[name], strict=True):
        group = [f for f in study.findings() if f.claim == claim]
        found = "".join(LETTER[f.outcome] for f in group)
        assert found == wanted, "\n".join(f"{f.outcome}: {f.says}" for f in group)
    failed = {(c.variant, c.stroke) for c, o in study.outcomes.items() if o.error}
    assert failed == ({("stop_printed_rigid", "forte")} if name == "string" else set())


def test_wire_numbers():
    study = study_of("wire")
    assert study.number("check_gap", "flexible", "piano", 1.0) == pytest.approx(
        14.65e-3, abs=0.3e-3
    )
    assert list(dict.fromkeys(study.table()["variant"])) == ["flexible", "rigid"]
    assert study.table()["check_gap"].notna().all()
    # Judged at every stiffness of the shank that the assumption leaves open.
    closer = next(f for f in study.findings() if "closer" in f.says and "forte" in f.says)
    assert (closer.held, closer.of, closer.outcome) == (6, 6, "agrees")


def test_rigid_members_do_not_bend():
    study = study_of("wire_vibration")
    assert study.number("swing", "rigid", "forte") < 1e-12
    assert study.number("frequency", "flexible", "piano") == pytest.approx(114, abs=15)
    with pytest.raises(Absent):  # of round-off
        study.number("frequency", "rigid", "piano")
    assert study_of("shank").number("vibration", "rigid", "forte", 1.0) < 1e-12


def test_printed_law_on_rigid_stop_reaches_the_force_of_the_thesis():
    study = study_of("string")
    assert study.number("max_impact_force", "stop_printed", "forte") == pytest.approx(370, rel=0.02)
    assert study.number("max_impact_force", "stop", "forte") == pytest.approx(162, rel=0.02)


@pytest.mark.parametrize(("name", "figure"), [("wire", "hammer"), ("wire", "stiffness"),
                                              ("string", "force")])  # fmt: skip
def test_figures_have_a_line_or_bar_for_each_variant(name, figure):
    axes = study_of(name).figure(figure).axes
    assert all(len(ax.lines) + len(ax.patches) >= 2 for ax in axes)


def test_statistics():
    time = np.linspace(0.0, 1.0, 1001)
    wave = np.sin(2 * np.pi * 20 * time)
    assert statistic("frequency", time, wave + 3 * time) == pytest.approx(20, abs=0.2)
    assert math.isnan(statistic("frequency", time, 0 * time))
    assert statistic("span", time, wave) == pytest.approx(2, rel=1e-2)
    assert statistic("rms", time, wave) == pytest.approx(2**-0.5, rel=1e-3)
    assert statistic("variation", time, wave) == pytest.approx(80, rel=1e-2)
    assert statistic("pulses", time, np.sin(2 * np.pi * 5 * time), 0.5) == 5
    assert statistic("pulses", time, wave * 0, 0.5) == 0
    assert statistic("time_above", time, wave, 0.0) == pytest.approx(0.5, abs=0.02)
    assert statistic("settles", time, np.exp(-10 * time), 0.1) == pytest.approx(0.23, abs=0.01)
    # Comes back to where it began, or does not; to settle elsewhere is no return.
    gone = np.where(time < 0.3, 0.0, np.where(time < 0.6, 1.0, 0.05))
    assert statistic("returns", time, gone, 0.1) == pytest.approx(0.6)
    assert math.isnan(statistic("returns", time, np.where(time < 0.3, 0.0, 1.0), 0.1))
    hump = np.where(time < 0.5, time, 1.0 - time)
    assert statistic("swing_back", time, hump) == pytest.approx(0.5)


def test_documentation_counts_the_findings():
    docs = Path(__file__).parents[3] / "docs"
    text = (docs / "validation" / "studies.md").read_text(encoding="utf-8")
    for name, (thesis, own) in OUTCOMES.items():
        row = re.search(rf"^\| `{name}` \|.*$", text, re.MULTILINE)
        assert row is not None, name
        cells = [c.strip() for c in row.group().split("|")[3:10]]
        wanted = [*(thesis.count(letter) for letter in "APDN"), *(own.count(c) for c in "APD")]
        assert [int(c or 0) for c in cells] == wanted, name
    validation = (docs / "validation" / "thesis.md").read_text("utf-8")
    thesis, own = ("".join(pair[i] for pair in OUTCOMES.values()) for i in (0, 1))
    for letters in (thesis, own):
        counts = [letters.count(letter) for letter in "APD"]
        words = "{} agree, {} hold in part of the cases, {} disagree".format(*counts)
        assert f"Of {len(letters)} " in validation
        assert words in " ".join(validation.split())


def test_findings_of_the_actuator():
    runs = actuator.simulate(0.12)
    outcomes = [f.agrees for f in actuator.findings(runs)]
    assert outcomes == [None] + 9 * [True]
    for number in actuator.FIGURES:
        assert len(actuator.figure(runs, number).axes) == len(actuator.FIGURES[number][2])
