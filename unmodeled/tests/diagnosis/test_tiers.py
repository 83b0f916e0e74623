"""What is named, what is supported, and causes that explain the records equally well."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from unmodeled import Equations, Options, Record, Sensor, Simulator, diagnose
from unmodeled.library import bouc_wen, second_store
from unmodeled.search.ledger import Mark
from unmodeled.search.progress import Stop
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.result import Reason, Verdict
from unmodeled.search.search import search

from .conftest import spring_record


@pytest.mark.parametrize("late", [False, True])
def test_a_factor_is_a_class_of_all_places_that_it_can_have(late, monkeypatch):
    """Also if the time is up before causes are exchanged."""

    def without_exchange(problem, options, stage, step, **given):
        def tell(name):
            stage(name)
            if name == "exchange":
                raise Stop

        return search(problem, options, tell, step, **given)

    if late:
        monkeypatch.setattr("unmodeled.diagnosis.search", without_exchange)
    t, rng, records = np.arange(0.0, 5.0, 0.05), np.random.default_rng(1), []
    for k, a in enumerate((1.0, 1.6, 0.8)):
        u = 2.0 + np.sin(a * t)
        y = 0.5 * 3.0 * u + 0.01 * rng.standard_normal(t.size)
        sensors = {"y": Sensor(name="y", sigma=0.01, unit="N")}
        records.append(
            Record(name=f"r{k}", time=t, inputs={"u": u}, outputs={"y": y}, sensors=sensors)
        )
    model = Simulator(
        lambda time, inputs, p: {"y": p["k"] * inputs["u"]}, parameters={"k": (3.0, 0.03, "N/m")}
    )
    result = diagnose(model, None, records)
    assert (Reason.NOT_COMPLETE in result.reasons) is late
    assert result.verdict is Verdict.ONE_OF
    (group,) = result.classes
    assert {n.cause for n in group} == {"gain of input u", "gain of sensor y", "k"}
    sizes = {n.cause: n.magnitude for n in group}
    assert sizes["gain of sensor y"] == pytest.approx(-0.5, abs=0.01)
    assert sizes["gain of input u"] == pytest.approx(1.0, abs=0.04)
    assert sizes["k"] == pytest.approx(1.5, abs=0.03)


def test_one_sensor_has_one_noise(spring):
    quiet, loud = (spring_record(n, 2, seed=k) for k, n in enumerate(("quiet", "loud")))
    rng = np.random.default_rng(0)
    records = []
    for r, sigma in ((quiet, 1e-6), (loud, 0.05)):
        force = 100.0 * r.inputs["x"] + sigma * rng.standard_normal(r.samples)
        records.append(
            Record(name=r.name, time=r.time, inputs=r.inputs, outputs={"force": force},
                   sensors={"force": Sensor(name="force", unit="N")})
        )  # fmt: skip
    problem = prepare(ready_records(spring, records), (), (), Options())
    sizes = [float(o.sd[0, 0]) for o in problem.fit]
    assert sizes[0] == sizes[1] == pytest.approx(0.05 / np.sqrt(2.0), rel=0.2)


@pytest.mark.parametrize(("ratio", "widens"), [(3.0, False), (0.7, True)])
def test_bouc_wen_follows_its_own_slopes(ratio, widens):
    """Loading has the slope 1 - (beta + gamma) |z|, unloading 1 + (beta - gamma) |z|."""
    part = SimpleNamespace(
        name="mass", unit="N", travel_unit="m",
        motion=lambda x: (x["q"], x["v"]), push=lambda f, *_: {"v": f},
    )  # fmt: skip
    effect = bouc_wen(part, scale=1.0, travel=1e-3)
    beta = 400.0
    gamma = beta * (ratio - 2.0)

    def slope(z, v):
        x = {"q": 0.0, "v": np.array([v]), "bouc_wen.stretch": np.array([z])}
        out = effect.rate(0.0, x, None, None, 5e4, (beta, ratio))
        assert out["v"][0] == pytest.approx(-5e4 * z)
        return out["bouc_wen.stretch"][0] / v

    z = 2e-4
    assert slope(z, 0.1) == pytest.approx(1.0 - (beta + gamma) * z)
    assert slope(z, -0.1) == pytest.approx(1.0 + (beta - gamma) * z)
    assert slope(-z, -0.1) == pytest.approx(slope(z, 0.1))
    assert (slope(z, 0.1) > 1.0) == (gamma < -beta)
    assert widens == (slope(z, -0.1) > slope(z, 0.1) and gamma < 0.0)


def test_a_second_store_keeps_what_it_takes():
    effect = second_store("T", scale=1e-4, size=20.0, times=(1e3, 1e4))
    x = {"T": np.array([22.0]), "store.level": np.array([20.0])}
    out = effect.rate(0.0, x, None, None, 2e-4, 1e4)
    assert out["T"][0] == pytest.approx(-2e-4 * 2.0)
    assert out["store.level"][0] == pytest.approx(2.0 / 1e4)


def test_a_delay_of_two_records_is_told_for_these():
    rng, h, n, records = np.random.default_rng(9), 1e-3, 250, []
    for name, late in (("good 1", 0), ("good 2", 0), ("late 1", 1), ("late 2", 1)):
        u, x, path = np.repeat(rng.uniform(-1.0, 1.0, n // 10 + 1), 10)[:n], 0.0, []
        for v in u:
            path.append(x)
            x += (1.0 - np.exp(-h / 5e-3)) * (v - x)
        y = np.r_[np.zeros(late), np.array(path)[: n - late]] + 1e-3 * rng.standard_normal(n)
        sensors = {"x": Sensor(name="x", sigma=1e-3, unit="V")}
        records.append(
            Record(name=name, time=np.arange(n) * h, inputs={"u": u}, outputs={"x": y},
                   sensors=sensors)
        )  # fmt: skip
    model = Equations(
        lambda t, x, u, p: ((u.u - x.x) / p.tau,),
        states={"x": (0.0, 0.01, "V")},
        parameters={"tau": (5e-3, 2.5e-4, "s")},
        hold="zero",
        inputs={"u": "V"},
        outputs={"x": "x"},
    )
    result = diagnose(model, ["delay of sensor x", "gain of input u"], records, hold_out=())
    (cause,) = result.named
    assert cause.subject.scope.records == ("late 1", "late 2")
    assert cause.unit == "s"
    assert cause.magnitude == pytest.approx(h, abs=0.15 * h)


def test_what_is_less_probable_than_nothing_is_not_supported():
    """A pendulum with dry friction that no effect of its function can be.

    A delay in each record predicts the held-out record better, because it has a phase.
    """

    def angles(time, torque, p, friction=0.0):
        x, v, out, step = 0.0, 0.0, [], float(0.25 * (time[1] - time[0]))
        for f in torque.tolist():
            out.append(x)
            for _ in range(4):
                resistance = p["damping"] * v + friction * math.tanh(v / 0.02)
                v += step * (f - p["stiffness"] * math.sin(x) - resistance)
                x += step * v
        return np.array(out)

    time, records = np.arange(500) * 0.02, []
    for k, (w, size) in enumerate([(4.0, 8.0), (4.6, 8.0), (5.2, 9.0)]):
        torque = size * np.sin(w * time) * (time < 5.0)
        angle = angles(time, torque, {"stiffness": 30.0, "damping": 0.3}, friction=2.0)
        angle += np.random.default_rng(k).normal(0.0, 1e-3, time.size)
        records.append(
            Record(name=f"run {k}", time=time, inputs={"torque": torque},
                   outputs={"angle": angle}, sensors={"angle": Sensor(name="angle", unit="rad")})
        )  # fmt: skip
    model = Simulator(
        lambda t, inputs, p: {"angle": angles(t, inputs["torque"], p)},
        parameters={"stiffness": (30.0, 0.9, ""), "damping": (0.3, 0.15, "")},
    )
    report = model.diagnose(records)
    probability = {s.causes: s.probability for s in report.sets}
    assert max(probability, key=lambda s: probability[s]) == ()
    assert (report.verdict, report.supported) == (Verdict.UNKNOWN, ())
    assert Reason.NOTHING_INSIDE in report.reasons
    assert "Name what may act inside the model" in " ".join(str(report).split())


def four(spring, causes, **machine):
    cycles = {"a": 1, "b": 2, "c": 3, "d": 5}
    records = [
        spring_record(n, k, role="held_out" if n == "d" else "fit", **machine)
        for n, k in cycles.items()
    ]
    return diagnose(spring, causes, records)


def test_a_probable_cause_that_takes_away_less_than_what_matters_is_small(spring, causes):
    """Its offset is 1.2 times the noise of a sample, and a part of the answer all the same."""
    report = four(spring, causes, preload=0.06)
    assert report.sets[0].causes == report.reported == ("preload",)
    assert (report.verdict, report.named) == (Verdict.CALIBRATED, ())
    ((small,),) = report.small
    assert small.cause == "preload"
    assert small.low < 0.06 < small.high
    assert report.finding("preload").mark is Mark.SMALL
    assert report.finding("preload").takes < 1.0
    # What remains is what remains with it, and the model that is handed out has it.
    (channel,) = report.channels
    nothing = next(s for s in report.sets if not s.causes)
    assert channel.explained == report.sets[0].residual[0] < nothing.residual[0]
    assert report.model.effects["preload"] == pytest.approx(small.magnitude)
    said = report.summary()
    assert said.startswith("The parameter k is ")
    assert "he effect preload has a size of 0.0" in said
    assert "this is small" in said
    as_before = replace(report.without[0], before=report.without[0].after)
    taken_up = replace(report, without=(as_before, *report.without[1:]))
    assert "as little is left without it" in taken_up.summary()
    found = four(spring, causes, preload=0.2)
    assert [n.cause for n in found.named] == ["preload"]
    assert [c.name for c in found.changes] == ["preload", "k"]
