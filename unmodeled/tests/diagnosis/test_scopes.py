"""Causes of some records: a law acts in one record, in the first ones, or in the last ones."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unmodeled import (
    Equations,
    InvalidParameter,
    Options,
    Record,
    Sensor,
    State,
    Verdict,
    diagnose,
)
from unmodeled.cli import main
from unmodeled.search.scopes import scopes_of, starts_of

EFFECTS = ["constant force x", "dry friction x", "* of input F", "gain of sensor x",
           "offset of sensor x"]  # fmt: skip


def driven(count=3, *, force=None, gain=None, mass=None, seed=8):
    """Records of a mass on a spring, 2 kg, 90 N/m, 3 N s/m; the arguments are by record."""
    force, gain, mass = force or [0.0] * 9, gain or [1.0] * 9, mass or [2.0] * 9
    rng, time, records = np.random.default_rng(seed), np.arange(0.0, 2.0, 0.01), []
    for k in range(count):
        drive = 4.0 * np.sin(2 * np.pi * (0.7 + 0.3 * k) * time) + np.sign(np.sin(3.0 * time))
        step, x, out = 5e-4, np.zeros(2), []
        for u in drive:
            out.append(x[0])
            for _ in range(20):
                middle = x + 0.5 * step * _rates(x, u, force[k], gain[k], mass[k])
                x = x + step * _rates(middle, u, force[k], gain[k], mass[k])
        seen = np.array(out) + 5e-5 * rng.standard_normal(time.size)
        sensors = {"x": Sensor(name="x", unit="m", sigma=5e-5)}
        records.append(
            Record(
                name=f"rec{k}", time=time, inputs={"F": drive}, outputs={"x": seen}, sensors=sensors
            )
        )
    return records


def _rates(x, drive, force, gain, mass):
    return np.array([x[1], (gain * drive + force - 90.0 * x[0] - 3.0 * x[1]) / mass])


def model():
    return Equations(
        lambda t, x, u, p: (x.v, (u.F - p.k * x.x - p.d * x.v) / p.m),
        states={"x": (0.0, 1e-4, "m"), "v": (0.0, 1e-3, "m/s")},
        parameters={"m": (2.0, 0.06, "kg"), "k": (90.0, 3.0, "N/m"), "d": (3.0, 0.4, "N s/m")},
        hold="zero",
        inputs={"F": "N"},
        outputs={"x": "x"},
    )


def diagnosed(records, **given):
    return model().diagnose(records, effects=EFFECTS, **given)


def told(report):
    return [n for group in (report.named, *report.classes) for n in group]


def test_a_force_in_one_record_is_told_there():
    report = diagnosed(driven(force=[0.0, 1.0, 0.0]))
    found = {n.subject.fault: n for n in told(report)}
    assert found["constant force"].magnitude == pytest.approx(1.0, abs=0.01)
    assert {n.subject.scope.records for n in found.values()} == {("rec1",)}
    assert "in rec1" in report.summary()


def test_the_model_of_the_answer_has_what_acts_in_some_records():
    for given in ({"force": [0.0, 1.0, 0.0]}, {"mass": [2.0, 2.6, 2.0]}):
        records = driven(**given)
        report = diagnosed(records)
        assert [c.records for c in report.model.in_records] == [("rec1",)]
        assert report.model.in_records[0].name in report.model.left_out
        for r in records:
            left = report.model.simulate(r)["x"] - r.outputs["x"]
            assert np.sqrt(np.mean(left**2)) < 1.3 * report.channels[0].explained


def test_a_gain_of_the_input_in_one_record_is_a_class_with_that_of_the_sensor():
    report = diagnosed(driven(gain=[1.0, 1.25, 1.0]))
    found = {n.subject.component: n for n in told(report)}
    assert found["input F"].magnitude == pytest.approx(-0.2, abs=0.005)
    assert found["sensor x"].magnitude == pytest.approx(0.25, abs=0.005)
    assert {n.subject.scope.records for n in found.values()} == {("rec1",)}


def test_a_mass_in_one_record_is_a_parameter_that_differs_from_the_others():
    report = diagnosed(driven(mass=[2.0, 2.6, 2.0]))
    (cause,) = report.named
    assert (cause.cause, cause.subject.kind) == ("m in rec1", "parameter")
    assert cause.magnitude == pytest.approx(0.6, abs=0.01)
    said = report.summary()
    assert said.startswith("The parameter m differs from the other records by +0.")
    assert " kg (+0.59" in said
    assert ") in rec1: with this" in said
    assert report.changes[0].by_record == ()


def test_a_change_between_two_series_is_told_with_records_that_were_not_fitted():
    report = diagnosed(driven(6, mass=[2.0] * 3 + [2.3] * 3))
    (cause,) = report.named
    assert cause.subject.scope.records == ("rec3", "rec4", "rec5")
    assert "in rec3 to rec5" in report.summary()
    assert cause.magnitude == pytest.approx(0.3, abs=0.01)
    assert report.channels[0].held_out_explained < 2.0 * report.channels[0].noise


def test_what_changed_between_two_series_is_told():
    before, after = (driven(3, mass=[m] * 3) for m in (2.0, 2.3))
    report = diagnosed(before, then=after)
    (cause,) = report.named
    assert cause.cause == "m in rec0 after to rec2 after"
    assert cause.magnitude == pytest.approx(0.3, abs=0.01)
    same = diagnosed(before, then=driven(3, seed=9))
    assert not told(same)
    with pytest.raises(InvalidParameter, match="then: got rec9, expected some of the records"):
        diagnosed(before, options=Options(then=("rec9",)))


def test_files_after_a_change_follow_their_option(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, mass in (("a", 2.0), ("b", 2.3)):
        for record in driven(2, mass=[mass] * 2):
            table = [record.time, record.inputs["F"], record.outputs["x"]]
            np.savetxt(f"{name}-{record.name}.csv", np.transpose(table), delimiter=",",
                       header="t [s],F [N],x [m]", comments="")  # fmt: skip
    Path("cart.py").write_text(
        "import unmodeled\nmodel = unmodeled.Equations("
        "lambda t, x, u, p: (x.v, (u.F - 90.0 * x.x - 3.0 * x.v) / p.m), hold='zero', "
        "states={'x': (0.0, 1e-4, 'm'), 'v': (0.0, 1e-3, 'm/s')}, inputs={'F': 'N'}, "
        "parameters={'m': (2.0, 0.06, 'kg')}, outputs={'x': 'x'})\neffects = ()\n"
    )
    files = sorted(map(str, tmp_path.glob("*.csv")))
    for given, code in (((*files[2:], "--json"), 0), ((), 2)):
        with pytest.raises(SystemExit) as stop:
            main(["diagnose", "cart.py", *files[:2], "--then", *given])
        assert stop.value.code == code
        told = capsys.readouterr()
        if code:
            assert "--then" in told.err
            continue
        (cause,) = json.loads(told.out)["named"]
        assert cause["cause"] == "m in b-rec0 and b-rec1"
        assert cause["magnitude"] == pytest.approx(0.3, abs=0.02)


def test_records_of_one_machine_differ_in_nothing():
    report = diagnosed(driven())
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)
    assert not told(report)


def test_scopes_are_single_records_and_runs_from_an_end():
    assert scopes_of([0.0]) == []
    assert scopes_of([0.0, 1.0]) == [(1.0, 0.0), (0.0, 1.0)]
    *runs, grows = scopes_of([5.0, 6.0, 7.0, 9.0])
    found = [{k for k, share in enumerate(shares) if share == 1.0} for shares in runs]
    assert found == [{0}, {1}, {2}, {3}, {0, 1}, {0, 1, 2}, {1, 2, 3}, {2, 3}]
    assert grows == (0.0, 0.25, 0.5, 1.0)


def test_the_start_of_records_is_what_all_of_them_state():
    one, other = driven(2)
    assert starts_of([one, other]) == [0.0, 1.0]
    stated = [replace(r, conditions={"start": 60.0 * k}) for r, k in ((one, 3), (other, 8))]
    assert starts_of(stated) == [180.0, 480.0]
    assert starts_of([stated[0], other]) == [0.0, 1.0]


def test_a_parameter_of_each_record_is_told_by_its_scatter(tmp_path):
    masses = [2.0, 2.5, 1.7, 2.2, 1.9]
    report = diagnosed(driven(5, mass=masses))
    (cause,) = report.named
    assert (cause.cause, cause.subject.scope.each) == ("m in each record", True)
    fitted = dict(zip(report.records, cause.by_record, strict=True))
    assert fitted == pytest.approx({n: masses[int(n[3])] for n in fitted}, abs=0.01)
    assert "differs by 0.2" in report.summary()
    again = driven(5, mass=masses, seed=9)[int(report.records[0][3])]
    left = report.model.simulate(again)["x"] - again.outputs["x"]
    assert np.std(left) < 1.2e-4
    written = report.model.write(tmp_path / "fixed.toml").read_text()
    assert f"m in each record: {report.records[0]} {cause.by_record[0]:.4f}"[:-2] in written


def test_a_force_of_each_record_is_told_by_its_values():
    forces = [0.4, -0.5, 0.2, 1.0, -0.1]
    report = diagnosed(driven(5, force=forces))
    (cause,) = told(report)
    assert cause.cause == "constant force x in each record"
    fitted = dict(zip(report.records, cause.by_record, strict=True))
    assert fitted == pytest.approx({n: forces[int(n[3])] for n in fitted}, abs=0.05)


def test_subjects_differ_in_two_rates_at_once():
    """Twelve courses of a drug by mouth: each rate by itself takes little, both take it all."""
    rng, time = (
        np.random.default_rng(3),
        np.array([0.0, 0.25, 0.5, 1, 1.5, 2, 3.5, 5, 7, 9, 12, 24]),
    )
    given, volume, records, rates = 4.6, 0.45, [], []
    for k in range(12):
        ka, ke = (
            1.5 * np.exp(0.3 * rng.standard_normal()),
            0.09 * np.exp(0.3 * rng.standard_normal()),
        )
        curve = given / volume * ka / (ka - ke) * (np.exp(-ke * time) - np.exp(-ka * time))
        seen = curve + 0.2 * rng.standard_normal(time.size)
        sensor = Sensor(name="level", unit="mg/L", sigma=0.2)
        records.append(
            Record(
                name=f"subject {k}",
                time=time,
                inputs={},
                outputs={"level": seen},
                sensors={"level": sensor},
            )
        )
        rates.append((ka, ke))
    subject = Equations(
        lambda t, x, u, p: (-p.ka * x.gut, p.ka * x.gut / volume - p.ke * x.level),
        states=[
            State(name="gut", unit="mg/kg", start=given, start_sd=0.0),
            State(name="level", unit="mg/L", start_sd=0.0),
        ],
        parameters={"ka": (1.5, 0.5, "1/s"), "ke": (0.09, 0.03, "1/s")},
        outputs={"level": "level"},
    )
    report = diagnose(subject, None, records)
    own = {c.cause: c for c in told(report)}
    assert set(own) >= {"ka in each record", "ke in each record"}
    for name, values in zip(("ka", "ke"), np.transpose(rates), strict=True):
        (found,) = (c for n, c in own.items() if n == f"{name} in each record")
        spread = np.std(found.by_record)
        assert spread == pytest.approx(np.std(values), rel=0.15)
    assert report.summary().endswith("Nothing but the noise of the sensor remains.")


def test_two_laws_of_all_records_take_the_place_of_one_that_each_has_by_itself():
    """A friction that rises at low speed, seen in five parts of one swing of a pendulum."""
    h, q, v, seen = 0.0005, -2.2, 0.0, []

    def rate(q, v):
        friction = (0.125 + 0.075 * np.exp(-((v / 2.8) ** 2))) * np.tanh(v / 0.02)
        return -30.9 * np.sin(q) - 0.026 * v - friction

    for _ in range(120000):
        seen.append(q)
        slope = rate(q, v)
        half = rate(q + 0.5 * h * v, v + 0.5 * h * slope)
        q, v = q + h * (v + 0.5 * h * slope), v + h * half
    grid = 2.0 * np.pi / 1000.0
    seen = np.round(np.array(seen)[::40] / grid) * grid
    records = [
        Record(
            name=f"part {k}",
            time=0.02 * np.arange(600),
            inputs={},
            outputs={"q": seen[600 * k : 600 * (k + 1)]},
            sensors={"q": Sensor(name="q", unit="rad")},
            role="held_out" if k in (1, 3) else "fit",
        )
        for k in range(5)
    ]
    pendulum = Equations(
        lambda t, x, u, p: (x.w, -p.w2 * np.sin(x.q) - p.d * x.w),
        states={"q": "rad", "w": "rad/s"},
        parameters={"w2": (31.0, 3.0, "1/s^2"), "d": (0.02, 0.02, "1/s")},
        bounds={"d": (0, 10), "w2": (1, 1e3)},
        outputs={"q": "q"},
    )
    report = pendulum.diagnose(
        records, effects=("dry friction q", "Stribeck friction q", "creep q")
    )
    assert {n.cause for n in report.named} == {"dry friction q", "Stribeck friction q"}


def test_a_gain_that_falls_over_the_records_is_told_by_that_of_the_last_one():
    report = diagnosed(driven(5, force=[0.0, 0.25, 0.5, 0.75, 1.0]))
    (cause,) = [n for n in told(report) if n.cause.startswith("constant force")]
    assert cause.cause == "constant force x over the records"
    assert cause.magnitude == pytest.approx(1.0, abs=0.02)
    assert "in rec4, to which it grows from zero in the first record" in report.summary()


def two_joints(late_inputs=0, late_sensors=0):
    """Two first-order drives with an input each; the arguments are in samples."""
    rng, time, records = np.random.default_rng(3), np.arange(0.0, 2.0, 0.01), []
    for k in range(3):
        drive = np.sin(np.outer([5.0 + k, 7.0 - k], time))
        drive = drive if late_sensors else np.sign(drive)
        held = np.concatenate(
            [np.repeat(drive[:, :1], late_inputs, 1), drive[:, : time.size - late_inputs]], axis=1
        )
        x, path = np.zeros(2), []
        for u in held.T:
            path.append(x)
            x = u + (x - u) * np.exp(-0.01 / 0.1)
        seen = np.array(path)
        seen = np.concatenate([np.zeros((late_sensors, 2)), seen[: time.size - late_sensors]])
        seen = seen + 1e-3 * rng.standard_normal(seen.shape)
        sensors = {n: Sensor(name=n, unit="V", sigma=1e-3) for n in ("a", "b")}
        inputs = dict(zip(("u", "w"), drive, strict=True))
        outputs = dict(zip(("a", "b"), seen.T, strict=True))
        records.append(
            Record(name=f"r{k}", time=time, inputs=inputs, outputs=outputs, sensors=sensors)
        )
    drives = Equations(
        lambda t, x, u, p: ((u.u - x.a) / p.tau, (u.w - x.b) / p.tau),
        states={"a": (0.0, 1e-3, "V"), "b": (0.0, 1e-3, "V")},
        parameters={"tau": (0.1, 0.003, "s")},
        hold="zero",
        inputs={"u": "V", "w": "V"},
        outputs={"a": "a", "b": "b"},
    )
    return drives.diagnose(records, effects=["delay of *", "gain of *"])


def test_one_delay_of_all_inputs_is_one_number():
    report = two_joints(late_inputs=3)
    (cause,) = [n for n in told(report) if n.subject.kind == "input"]
    assert cause.subject.scope.channels == ("u", "w")
    assert cause.magnitude == pytest.approx(-0.03, abs=1e-3)
    assert "ll inputs act " in report.summary()
    assert "later than recorded" in report.summary()


def test_one_delay_of_all_sensors_is_one_number():
    report = two_joints(late_sensors=3)
    cause = next(n for n in told(report) if n.subject.kind == "sensor")
    assert cause.cause == "delay of all sensors"
    assert cause.magnitude == pytest.approx(0.03, abs=1e-3)
    assert "ll sensors are " in report.summary() + report.text(300)


def test_drives_that_are_right_are_not_late():
    assert not told(two_joints())


def first_order(drive, seen_of=lambda u, x, t: x, effects=(), offset=0.0):
    """A first-order store, 0.3 s and 1 V per unit of its input, of three motions.

    ``drive``: what arrives of an input at a time; ``seen_of``: the readings.
    """
    rng, time, records = np.random.default_rng(6), np.arange(0.0, 6.0, 0.02), []
    for k in range(3):
        u = offset + 5.0 * np.sin((1.3 + 0.6 * k) * time) + np.sign(np.sin(2.1 * time))
        x, path = offset, []
        for v, t in zip(u, time, strict=True):
            path.append(x)
            arrived = drive(v, t)
            x = arrived + (x - arrived) * np.exp(-0.02 / 0.3)
        seen = seen_of(u, np.array(path), time) + 2e-3 * rng.standard_normal(time.size)
        sensors = {"x": Sensor(name="x", unit="V", sigma=2e-3)}
        records.append(
            Record(name=f"r{k}", time=time, inputs={"u": u}, outputs={"x": seen}, sensors=sensors)
        )
    store = Equations(
        lambda t, x, u, p: ((p.gain * (u.u - offset) + offset - x.x) / p.tau,),
        states={"x": (offset, 1e-3, "V")},
        parameters={"tau": (0.3, 0.01, "s"), "gain": (1.0, 0.02, "1")},
        hold="zero",
        inputs={"u": "V"},
        outputs={"x": "x"},
    )
    return store.diagnose(records, effects=effects)


SIGNAL = ("* of input u", "* of sensor x", "* in sensor x")


def test_a_dead_zone_about_a_signal_that_never_reaches_zero_has_its_neutral():
    def valve(u, t):
        return 12.0 + np.sign(u - 12.0) * max(abs(u - 12.0) - 0.9, 0.0)

    report = first_order(valve, effects=SIGNAL, offset=12.0)
    (cause,) = report.named
    assert (cause.subject.kind, cause.subject.fault) == ("input", "dead zone")
    assert cause.shape == pytest.approx((12.0, 0.9), rel=0.02)
    assert "a dead zone of ±0.9" in report.summary()
    assert " about 12" in report.summary()


def test_a_gain_that_fades_is_told_by_its_rate():
    report = first_order(lambda u, t: (1.0 - 0.03 * t) * u, effects=SIGNAL)
    cause = next(n for n in told(report) if n.subject.kind == "input")
    assert cause.subject.fault == "gain drift"
    assert cause.magnitude == pytest.approx(-0.03, abs=1e-3)
    assert report.summary().startswith("The gain of input u drifts by -0.0")


def test_a_zero_that_drifts_is_told_by_its_rate():
    report = first_order(lambda u, t: u, lambda u, x, t: x + 0.05 * t, effects=SIGNAL)
    cause = next(n for n in told(report) if n.subject.fault == "zero drift")
    assert (cause.unit, cause.magnitude) == ("V/s", pytest.approx(0.05, abs=2e-3))


def test_a_slow_part_of_an_input_in_a_reading_is_a_store_at_the_output():
    def seen(u, x, t):
        slow, out = 0.0, []
        for v in u:
            out.append(slow)
            slow = v + (slow - v) * np.exp(-0.02 / 1.2)
        return x - 0.1 * np.array(out)

    report = first_order(lambda u, t: u, seen, effects=SIGNAL)
    (cause,) = report.named
    assert cause.cause == "slow part of u in sensor x"
    assert cause.magnitude == pytest.approx(-0.1, abs=0.01)
    assert cause.shape == pytest.approx(1.2, rel=0.1)


def test_a_store_that_is_right_has_no_part_and_no_drift():
    assert not told(first_order(lambda u, t: u, effects=SIGNAL))


def test_what_acts_in_a_held_out_record_only_is_told_there():
    report = model().diagnose(driven(force=[0.0, 0.0, 1.0]), effects=EFFECTS, hold_out=["rec2"])
    found = {n.subject.fault: n for n in told(report)}
    assert found["constant force"].magnitude == pytest.approx(1.0, abs=0.01)
    assert {n.subject.scope.records for n in found.values()} == {("rec2",)}


def test_a_lag_of_all_inputs_is_one_of_two_also_beside_a_delay():
    """Each held step of a lagged drive is late by half a sample: there is a lag, and a delay."""
    rng, time, records = np.random.default_rng(4), np.arange(0.0, 6.0, 0.01), []
    flow = np.array([[-0.8, 0.3], [0.2, -1.3]])
    for k in range(3):
        since = time - 0.3
        waves = np.sin((1.5 + 0.7 * k) * since), np.sign(np.sin((1.1 + 0.5 * k) * since))
        drive, x, late, path = (since > 0.0) * np.array(waves), np.zeros(2), np.zeros(2), []
        for u in drive.T:
            path.append(x)
            for _ in range(20):
                x = x + 5e-4 * (flow @ x + np.array([1.0, 0.5]) * late)
            late = u + (late - u) * np.exp(-0.01 / 0.08)
        seen = np.array(path) + 1e-3 * rng.standard_normal((time.size, 2))
        sensors = {n: Sensor(name=n, unit="m", sigma=1e-3) for n in ("x", "y")}
        inputs = dict(zip(("a", "b"), drive, strict=True))
        outputs = dict(zip(("x", "y"), seen.T, strict=True))
        records.append(
            Record(name=f"r{k}", time=time, inputs=inputs, outputs=outputs, sensors=sensors)
        )
    stores = Equations(
        lambda t, x, u, p: (-p.ka * x.x + 0.3 * x.y + u.a, -p.kb * x.y + 0.2 * x.x + 0.5 * u.b),
        states={"x": (0.0, 1e-3, "m"), "y": (0.0, 1e-3, "m")},
        parameters={"ka": (0.8, 0.03, "1/s"), "kb": (1.3, 0.05, "1/s")},
        hold="zero",
        inputs={"a": "m/s", "b": "m/s"},
        outputs={"x": "x", "y": "y"},
    )
    report = stores.diagnose(records)
    alike = [{c.cause for c in one} for one in report.classes]
    assert any({"lag of all inputs", "lag of all sensors"} <= names for names in alike)
