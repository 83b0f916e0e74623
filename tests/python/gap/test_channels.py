"""Ranges and units of channels: a sensor at the end of its range, percent, units of inputs."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.cli import main
from feltmb.data import Sensor, read_record
from feltmb.errors import DataError
from feltmb.gap import OdeModel, Options, Parameter, State, Verdict, diagnose, library
from feltmb.gap.shape import movable, moved_shape

_spec = importlib.util.spec_from_file_location("gap_models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)


# ---------------------------------------------------------------- a sensor at the end of its range


def saturation():
    return library.sensor_saturation(["q"], "q", highest=[0.02, 0.01], lowest=[-0.02], unit="m")


@pytest.mark.parametrize(
    ("shape", "expected"),
    [(("highest", 0.01), lambda y: np.minimum(y, 0.01)),
     (("lowest", -0.02), lambda y: np.maximum(y, -0.02))],
)  # fmt: skip
def test_a_full_saturation_is_a_hard_limit(shape, expected):
    record = models.record("r", 1.0, 1)
    y = np.linspace(-0.05, 0.05, 11)[None, :, None]
    effect = saturation()
    segments = np.array([[0, 10]])
    seen = effect.observe(record, y, segments, np.array([1.0]), shape)
    assert seen == pytest.approx(expected(y))
    half = effect.observe(record, y, segments, np.array([0.5]), shape)
    assert half == pytest.approx(0.5 * (y + expected(y)))


def test_the_end_of_a_range_is_found_with_its_reading():
    roles = ("fit", "fit", "held_out")
    clean = [models.record(f"run {k}", 1.0, k, role=r, noise=1e-12) for k, r in enumerate(roles)]
    limit = 0.6 * max(float(np.max(r.outputs["q"])) for r in clean)
    sensors = {"q": Sensor(name="q", unit="m", sigma=1e-4)}
    runs = [
        replace(
            r,
            outputs={
                "q": np.minimum(r.outputs["q"], limit)
                + 1e-4 * np.random.default_rng(k).standard_normal(r.samples)
            },
            sensors=sensors,
        )
        for k, r in enumerate(clean)
    ]
    effects = [*models.EFFECTS, *library.for_sensor(["q"], "q", runs[0])]
    report = diagnose(models.NOMINAL, effects, runs, options=Options(bootstrap=0))
    assert report.verdict is Verdict.DATA_PROBLEM, report.statement
    assert report.named == ("saturation of sensor q",)
    (found,) = report.model.included
    assert found.shape == ("highest", pytest.approx(limit, rel=0.01))


def test_the_reading_of_a_saturation_may_lie_between_those_of_the_list():
    assert movable(saturation()) == (1,)
    # Sides and numbers of both signs are not fitted.
    stop = library.end_stop(models.MASS, stiffness=100.0, travel=0.1)
    assert 0 not in movable(stop)
    # The zero of the readings does not matter.
    for zero in (-0.015, -0.01, 0.005, 293.0):
        highest, lowest = [0.02 + zero, 0.01 + zero], [zero - 0.02]
        effect = library.sensor_saturation(["q"], "q", highest=highest, lowest=lowest)
        assert movable(effect) == (1,)
        assert moved_shape(effect, ("highest", 0.02 + zero), 1, 0.01) == (
            "highest",
            pytest.approx(zero + 0.01),
        )
    both = library.sensor_saturation(["q"], "q", highest=[0.02, 0.01], lowest=[0.02])
    assert movable(both) == ()


# ---------------------------------------------------------------- a sensor that differs once


def one_wrong(change, which, **what):
    """Three records with noise of 1e-4 m, one of which is changed."""
    runs = [models.record(f"run {k}", 1.0, 7 + k, **what) for k in range(3)]
    q = runs[which].outputs["q"]
    runs[which] = replace(runs[which], outputs={"q": change(q)})
    return runs


@pytest.mark.parametrize(
    ("which", "change", "kind", "size", "told"),
    [
        (0, lambda q: 1.06 * q, "gain", 0.06, "% too large in the record run 0 alone"),
        (0, lambda q: q - 4e-3, "offset", -4e-3, "shifted by -4"),
        (2, lambda q: q - 4e-3, "offset", -4e-3, "shifted by -4"),
    ],
)
def test_a_sensor_that_differs_in_one_record_is_told(which, change, kind, size, told):
    """Whether the record is fitted or held out."""
    quick = Options(bootstrap=0, advice=False)
    report = diagnose(
        models.NOMINAL, [], one_wrong(change, which), hold_out=["run 2"], options=quick
    )
    assert report.verdict is Verdict.UNKNOWN
    found = report.where.one_record
    assert found is not None
    assert (found.record, found.channel, found.kind) == (f"run {which}", "q", kind)
    assert found.size == pytest.approx(size, rel=0.05)
    assert told in report.statement


def test_a_cause_in_all_records_is_no_error_of_one():
    quick = Options(bootstrap=0, advice=False)
    unknown = diagnose(models.NOMINAL, [], one_wrong(lambda q: q, 0, dry=8.0), options=quick)
    assert unknown.verdict is Verdict.UNKNOWN
    assert unknown.where.one_record is None
    two = diagnose(models.NOMINAL, [], one_wrong(lambda q: 1.06 * q, 0)[:2], options=quick)
    assert two.where.one_record is None


# ---------------------------------------------------------------- percent and units of inputs


def valve(**options):
    return OdeModel(
        name="tank",
        states=[State(name="h", unit="m", scale=0.1, start=0.1)],
        parameters=[Parameter(name="a", value=1.0, sd=0.1)],
        rates=lambda t, x, u, p: (-p.a * u.valve * x.h,),
        outputs={"level": "h"},
        **options,
    )


@pytest.fixture
def percent(tmp_path):
    path = tmp_path / "run.csv"
    rows = "\n".join(f"{0.1 * k:.1f},{40 + k % 7},{100 - k % 5}" for k in range(60))
    path.write_text(f"time [s],valve [%],level [mm]\n{rows}\n", encoding="utf-8")
    return path


def read(path, model):
    return read_record(path, inputs=model.inputs, outputs=model.outputs, units=model.units)


def test_percent_become_fractions_which_is_told(percent):
    record = read(percent, valve(inputs=["valve"]))
    assert record.inputs["valve"][0] == pytest.approx(0.40)
    assert record.input_units["valve"] == "1"
    assert any("valve: percent in the file become fractions" in note for note in record.notes)
    with pytest.raises(DataError, match=r"unit of input valve: got '%', .* has it in '1'"):
        library.for_input("valve", record, unit="%")
    assert library.for_input("valve", record)
    torque = replace(record, input_units={"valve": "N m"})
    assert library.for_input("valve", torque, unit="N*m")


@pytest.mark.parametrize("unit", ["%", "1"])
def test_a_model_gets_its_inputs_in_its_units(percent, unit):
    model = valve(inputs={"valve": unit})
    record = read(percent, model)
    assert record.inputs["valve"][0] == pytest.approx(40.0 if unit == "%" else 0.4)
    offset = next(e for e in library.for_input("valve", record) if "offset" in e.name)
    assert offset.unit == unit
    assert model.inputs == ("valve",)


def test_a_column_without_a_unit_is_not_converted(percent):
    text = percent.read_text(encoding="utf-8")
    percent.write_text(text.replace("valve [%]", "valve"), encoding="utf-8")
    model = valve(inputs={"valve": "%"})
    with pytest.raises(DataError, match=r"column valve has no unit in the header, .* \[%\]"):
        read(percent, model)
    sheet = "[inputs.valve]\n[outputs.level]\n"
    percent.with_suffix(".toml").write_text(sheet, encoding="utf-8")
    assert read(percent, model).inputs["valve"][0] == 40.0


def test_the_command_shows_the_inputs_as_the_model_gets_them(percent, tmp_path, capsys):
    model = tmp_path / "tank.py"
    model.write_text(
        "from feltmb.gap import OdeModel, Parameter, State\n"
        "model = OdeModel(name='tank', states=[State(name='h', unit='m', scale=0.1, start=0.1)],\n"
        "    parameters=[Parameter(name='a', value=0.02, sd=0.01)], inputs=['valve'],\n"
        "    rates=lambda t, x, u, p: (-p.a * u.valve * x.h,), outputs={'level': 'h'})\n"
        "effects = []\n",
        encoding="utf-8",
    )
    with pytest.raises(SystemExit) as stop:
        main(["gap", "check", str(model), str(percent)])
    assert not stop.value.code
    out = capsys.readouterr()
    row = next(line for line in out.out.splitlines() if " valve " in line)
    assert row.split() == ["run", "valve", "1", "0.4", "0.46"]
    assert "percent in the file become fractions" in out.out + out.err
