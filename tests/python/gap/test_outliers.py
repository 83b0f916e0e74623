"""Codes for missing values, and single spikes: told, never removed unasked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.data import ReadOptions, Record, Sensor, read_record, read_records
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import LinearModel, Parameter, check, check_records, diagnose
from feltmb.gap.outliers import outliers

ROOT = Path(__file__).parents[3]
TIME = np.linspace(0.0, 10.0, 400)
LINE = LinearModel(
    output="y",
    columns={"gain": lambda r: r.inputs["u"]},
    parameters=[Parameter(name="gain", value=1.0, sd=0.1)],
)


def record(name="r", *, at=(), value=0.0, seed=1, role="fit", **inputs):
    wave = np.sin(TIME)
    y = 20.0 + wave + 0.01 * np.random.default_rng(seed).standard_normal(TIME.size)
    y[list(at)] = value
    return Record(
        name=name,
        time=TIME,
        inputs={"u": 20.0 + wave, **inputs},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", unit="mm")},
        role=role,
    )


def changed(own, values):
    """The record with other values of its output, by sample."""
    y = own.outputs["y"].copy()
    y[list(values)] = list(values.values())
    return replace(own, outputs={"y": y})


@pytest.mark.parametrize("code", [-9999.0, -99999.0, 9999.0, 999.9, 1e30, -1e38, -9.999])
def test_a_certain_code_is_a_fault(code):
    """-9999 mm are -9.999 m."""
    own = record(at=[50, 51, 300], value=code)
    with pytest.raises(DataError) as error:
        check(LINE, own)
    text = str(error.value)
    assert f"r.y: 3 values of {code:.6g} mm, at {TIME[50]:.6g} s first" in text
    assert "missing = [NUMBER]" in text
    assert "--missing NUMBER" in text
    with pytest.raises(DataError, match="3 values"):
        diagnose(LINE, [], [own, record("other", seed=2)])


@pytest.mark.parametrize("code", [-999.0, 32767.0])
def test_another_code_is_a_question(code):
    (told,) = [w for w in check_records([record(at=[7], value=code)]).warnings if "far" in w]
    assert f"r.y: one value of {code:.6g} mm, at {TIME[7]:.6g} s, far outside" in told
    assert "(18.98 to 21.0" in told


def test_several_codes_and_records_are_told_together():
    first = record("first", at=[3, 4], value=-9999.0)
    first = changed(first, dict.fromkeys(range(100, 103), 1e30))
    second = record("second", at=[9], value=-9999.0, seed=2)
    problems = check_records([first, second]).problems
    assert len(problems) == 2
    assert "y: 3 values of -9999 mm, in 2 records, at" in "".join(problems)
    assert "first.y: 3 values of 1e+30 mm" in "".join(problems)


def test_a_code_in_an_input_is_a_fault_and_a_pulse_is_none():
    pulse = np.where(TIME[30] == TIME, 5.0, 0.01 * np.cos(TIME))
    assert not outliers(record(push=pulse))
    coded = np.where(TIME[30] == TIME, -9999.0, 0.0)
    (told,) = check_records([record(push=coded)]).problems
    assert "r.push: one value of -9999, at" in told
    assert "replace it or cut the record" in told  # an empty cell of an input is a fault, too
    assert "--missing" not in told


def test_a_channel_that_the_model_does_not_have_is_no_fault():
    own = record(at=[50], value=-9999.0)
    both = Record(
        name="r",
        time=TIME,
        inputs=own.inputs,
        outputs={"y": own.inputs["u"], "z": own.outputs["y"]},
    )
    assert not check_records([both], ["y"]).problems
    assert check_records([both]).problems


def test_single_spikes_are_told():
    own = changed(record(), {100: 60.0, 200: -40.0})
    checks = check_records([own])
    (told,) = [w for w in checks.warnings if "far" in w]
    assert "r.y: 2 values, one of them -40 mm" in told
    assert f"at {TIME[100]:.6g} s first, far from the samples before and after" in told
    assert "leave these cells empty" in told
    assert not checks.problems
    assert checks.spiky == ("y",)
    assert check_records([record(at=[7], value=-999.0)]).spiky == ()


def test_spikes_inside_the_range_are_told_by_a_diagnosis_and_empty_cells_help():
    """The range of y is 2 mm, its noise 0.01 mm."""
    records = [record("a"), record("b", seed=2), record("c", seed=3, role="held_out")]
    y = [own.outputs["y"] for own in records]
    spiky = [
        changed(own, {90: v[90] + 0.8, 250: v[250] - 0.8})
        for own, v in zip(records, y, strict=True)
    ]
    report = diagnose(LINE, [], spiky)
    (told,) = [w for w in report.checks.warnings if "samples before and after" in w]
    assert "y: 6 values, one of them" in told
    assert f"in 3 records, at {TIME[90]:.6g} s of a first" in told
    assert "Leave out the samples of y" in report.next[0].text
    emptied = [changed(own, {90: np.nan, 250: np.nan}) for own in records]
    report = diagnose(LINE, [], emptied)
    assert report.verdict == "NO GAP"
    assert not [w for w in report.checks.warnings if "before and after" in w]
    assert not [a for a in report.next if "Leave out" in a.text]


@pytest.mark.parametrize("level", [99.99, 0.9999, 9999.0])
def test_a_level_of_an_input_is_no_code(level):
    valve = np.where((TIME > 2.0) & (TIME < 5.0), level, 0.0)
    own = record(valve=valve)
    assert not outliers(own)
    stairs = np.where(TIME > 8.0, 0.1 * level, valve)  # a third level: a question
    assert not check_records([record(valve=stairs)]).problems
    measured = np.where(valve == level, level, 0.001 * level * np.cos(TIME))
    (found,) = outliers(record(valve=measured))
    assert found.certain


def test_an_impact_a_step_and_a_full_scale_are_no_spikes():
    impact = np.exp(-(((TIME - 5.0) / 0.05) ** 2)) + 1e-4 * np.sin(TIME)
    for values in (
        impact,
        np.where(TIME > 5.0, 100.0, 0.0) + 0.01 * np.sin(50.0 * TIME),
        np.minimum(999.0, 120.0 * TIME),
        np.full(TIME.size, 9999.0),
        np.where(TIME > 8.0, 9999.0, 9000.0 + TIME),
    ):
        found = Record(name="r", time=TIME, inputs={}, outputs={"y": values})
        told = outliers(found)
        assert not [o for o in told if o.certain or not o.code]
    for path in sorted((ROOT / "examples").glob("gap_action/*/*.csv")):
        for own in read_records([path]):
            assert not outliers(own), path


FILE = "time [s],u [mm],y [mm]\n" + "".join(
    f"{t:.3f},{u:.4f},{-9999 if i in (5, 6) else 2.0 * u:.4f}\n"
    for i, (t, u) in enumerate(zip(TIME, np.sin(TIME), strict=True))
)


def test_a_stated_code_is_missing(tmp_path):
    path = tmp_path / "logger.csv"
    path.write_text(FILE)
    with pytest.raises(DataError, match=r"2 values of -9.999 m, at 0.125 s first"):
        check(LINE, read_record(path, inputs=["u"], outputs=["y"]))
    own = read_record(path, inputs=["u"], outputs=["y"], options=ReadOptions(missing=[-9999]))
    assert np.flatnonzero(np.isnan(own.outputs["y"])).tolist() == [5, 6]
    path.with_suffix(".toml").write_text("missing = [-9999]\n[inputs.u]\n[outputs.y]\n")
    own = read_record(path)
    assert np.flatnonzero(np.isnan(own.outputs["y"])).tolist() == [5, 6]
    assert not check_records([own]).problems


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ('["none"]', "missing"),
        ("-9999", "missing: got -9999, expected a list"),
        ("[nan]", "missing"),
    ],
)
def test_a_wrong_code_is_told(tmp_path, value, told):
    path = tmp_path / "logger.csv"
    path.write_text(FILE)
    path.with_suffix(".toml").write_text(f"missing = {value}\n[inputs.u]\n[outputs.y]\n")
    with pytest.raises(DataError, match=told):
        read_record(path)


def test_the_options_are_numbers():
    with pytest.raises(InvalidParameter, match="missing"):
        ReadOptions(missing=["none"])
