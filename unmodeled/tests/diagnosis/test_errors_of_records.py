"""Errors of sensors, inputs and clocks in one record or in all, as large as a wrong unit."""

from __future__ import annotations

import numpy as np
import pytest

from unmodeled import Equations, Record, Sensor, Simulator, diagnose
from unmodeled.data.smoothing import noise_of_samples
from unmodeled.search.result import Verdict


def record(name, time, outputs, inputs=None, sigma=None, unit="1"):
    sensors = {n: Sensor(name=n, sigma=sigma, unit=unit) for n in outputs}
    return Record(name=name, time=time, inputs=inputs or {}, outputs=outputs, sensors=sensors)


@pytest.mark.parametrize("factor", [0.3, 25.4])
def test_a_factor_far_from_one_is_a_class_of_all_places_that_it_can_have(factor):
    """A size of 500 expected ones is no argument for the place where it is 20 expected ones."""
    t, rng, records = np.arange(0.0, 8.0, 0.05), np.random.default_rng(1), []
    for k, a in enumerate((1.0, 1.6, 0.8)):
        u = 2.0 + np.sin(a * t)
        y = factor * 3.0 * u + 0.01 * rng.standard_normal(t.size)
        records.append(record(f"r{k}", t, {"y": y}, {"u": u}, unit="N"))
    model = Simulator(
        lambda time, inputs, p: {"y": p["k"] * inputs["u"]}, parameters={"k": (3.0, 0.03, "N/m")}
    )
    (group,) = model.diagnose(records).classes
    sizes = {n.cause: n.magnitude for n in group}
    assert {*sizes} == {"gain of input u", "gain of sensor y", "k"}
    assert sizes["gain of sensor y"] == pytest.approx(factor - 1.0, rel=0.02)
    assert sizes["gain of input u"] == pytest.approx(1.0 / factor - 1.0, rel=0.02)


def lagging(late, unknown=False):
    """A first-order lag from rest, read late in two of four records (samples of 1 ms)."""
    rng, h, n, records = np.random.default_rng(9), 1e-3, 250, []
    for k in range(4):
        u, x, path = np.repeat(rng.uniform(-1.0, 1.0, n // 10 + 1), 10)[:n], 0.0, []
        for v in u:
            path.append(x)
            x += (1.0 - np.exp(-h / 5e-3)) * (v - x)
        own = late if k >= 2 else 0
        y = np.r_[np.zeros(own), np.array(path)[: n - own]] + 1e-3 * rng.standard_normal(n)
        records.append(record(f"rec{k}", np.arange(n) * h, {"x": y}, {"u": u}, unit="V"))
    model = Equations(
        lambda t, x, u, p: ((u.u - x.x) / p.tau,),
        states={"x": "V" if unknown else (0.0, 0.01, "V")},
        parameters={"tau": (5e-3, 2.5e-4, "s")},
        hold="zero",
        inputs={"u": "V"},
    )
    return model, records


@pytest.mark.parametrize("unknown", [False, True])
def test_records_that_are_late_by_three_samples_are_told_by_name(unknown):
    """What a late sensor shows first is the rest before the record, and no motion."""
    model, records = lagging(3, unknown)
    report = model.diagnose(records)
    (cause,) = report.named
    assert cause.cause == "delay of sensor x in each record"
    assert dict(zip(report.records, cause.by_record, strict=True)) == pytest.approx(
        {"rec0": 0.0, "rec1": 0.0, "rec2": 3e-3, "rec3": 3e-3}, abs=1e-4
    )
    said = report.summary()
    assert said.startswith("The delay of sensor x differs between the records: ")
    assert " ms in rec2 and " in said
    assert " ms in rec3, at most " in said


def swinging(offset=(0.0,) * 4, clock=(0.0,) * 4):
    """A mass on a spring, 20 N/m and 0.8 N s/m, with the model of it; no noise is stated."""
    t, rng, records = np.arange(0.0, 5.0, 0.02), np.random.default_rng(8), []
    w = np.sqrt(20.0 - 0.16)
    for k, start in enumerate((0.34, -0.22, 0.56, -0.38)):
        own = (1.0 + clock[k]) * t
        x = start * np.exp(-0.4 * own) * np.cos(w * own) + offset[k]
        y = x + 1e-3 * rng.standard_normal(t.size)
        records.append(record(f"run{k}", t, {"x": y}, unit="m"))
    model = Equations(
        lambda t, x, u, p: (x.v, (-p.k * x.x - p.c * x.v) / p.m),
        states={"x": "m", "v": "m/s"},
        parameters={"m": (1.0, 0.0, "kg"), "k": (20.0, 0.02, "N/m"), "c": (0.8, 0.1, "N s/m")},
    )
    return model, records


def test_a_held_out_record_with_an_error_that_the_others_do_not_have_is_fitted():
    """Nothing that is fitted shows the offset of run2."""
    model, records = swinging(offset=(0.0, 0.0, 0.05, 0.0))
    report = model.diagnose(records)
    ((cause, force),) = report.classes  # without an input, a constant force is the same
    assert (cause.cause, force.cause) == ("offset of sensor x in run2", "constant force x in run2")
    assert cause.magnitude == pytest.approx(0.05, abs=1e-3)
    assert not any(n.startswith("held out: run2") for n in report.notes)
    stated = model.diagnose(records, hold_out=["run2"])
    assert stated.classes[0][0].cause == "offset of sensor x in run2"


@pytest.mark.parametrize("clock", [(0.05,) * 4, (0.0, 0.02, 0.0, 0.0)])
def test_a_fast_clock_is_told_for_all_records_or_for_one(clock):
    """Also one by 5 %, which shows what happens after the end of the record by the model."""
    model, records = swinging(clock=clock)
    report = model.diagnose(records)
    if len({*clock}) == 1:  # of a free swing, it is a class with the stiffness
        (cause, *_) = report.classes[0]
        assert cause.cause == "clock of the sensors"
        assert cause.magnitude == pytest.approx(0.05, abs=1e-3)
        return
    (cause,) = report.named
    assert cause.cause == "clock of the sensors in run1"
    assert cause.magnitude == pytest.approx(0.02, abs=1e-3)
    assert report.summary().startswith("The clock of the sensors is off by 2.0")


def test_a_drive_with_a_play_is_told_by_its_half_width():
    t, rng, records = np.arange(0.0, 100.0, 0.5), np.random.default_rng(4), []
    for k in range(3):
        u = 50.0 + 15.0 * np.sin(2 * np.pi * t / (40 + 15 * k)) + 6.0 * np.sin(0.37 * t + k)
        now, x, path = u[0], u[0], []
        for v in u:
            now = np.clip(now, v - 2.0, v + 2.0)
            path.append(x)
            x += (1.0 - np.exp(-0.5 / 0.8)) * (now - x)
        y = np.array(path) + 0.1 * rng.standard_normal(t.size)
        records.append(record(f"loop{k}", t, {"stem": y}, {"command": u}, unit="%"))
    model = Equations(
        lambda t, x, u, p: ((u.command - x.stem) / p.tau,),
        states={"stem": "%"},
        parameters={"tau": (1.0, 0.3, "s")},
        inputs={"command": "%"},
        hold="zero",
    )
    (cause,) = model.diagnose(records).named
    assert cause.cause == "backlash of input command"
    assert cause.magnitude == pytest.approx(2.0, abs=0.1)


def test_few_samples_have_a_noise():
    """Also where none is stated: a parameter is fitted to six samples."""
    t = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.8])
    rng, y = np.random.default_rng(1), 2.0 * np.exp(-2.6 * t)
    y[1:] += 0.01 * rng.standard_normal(5)
    assert noise_of_samples(t, y) < 0.1 * np.std(y)
    assert noise_of_samples(t, 2.0 + 3.0 * t) < 1e-12
    assert noise_of_samples(t[:2], y[:2]) == pytest.approx(np.std(y[:2]))
    model = Equations(
        lambda t, x, u, p: (-p.k * x.c,),
        states={"c": (2.0, 0.0, "mol/l")},
        parameters={"k": (1.3, 1.0, "1/s")},
        bounds={"k": (0.0, 100.0)},
    )
    report = diagnose(model, None, [record("r", t, {"c": y}, unit="mol/l")])
    assert report.verdict is Verdict.CALIBRATED
    assert report.model.parameters["k"] == pytest.approx(2.6, abs=0.2)
