"""A report in the order in which a gap is read: as it is, calibration, missing, remains, next."""

import importlib.util
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import feltmb
from feltmb.adapters import action_with_effects, load_library, mechanism_model
from feltmb.adapters.synthetic import Sensors, make_record
from feltmb.adapters.writing import action_of_findings
from feltmb.cli.gap import floors
from feltmb.errors import InvalidParameter
from feltmb.gap import (
    Coordinate,
    Effect,
    Jobs,
    LinearModel,
    OdeModel,
    Options,
    Parameter,
    Record,
    Sensor,
    SimulatorModel,
    State,
    Verdict,
    diagnose,
    library,
)
from feltmb.gap.acceptance import Posterior
from feltmb.gap.decide import decide
from feltmb.gap.library.products import product
from feltmb.gap.page import page
from feltmb.gap.report import report_json

HERE = Path(__file__).parent
spec = importlib.util.spec_from_file_location("models", HERE / "models.py")
models = importlib.util.module_from_spec(spec)
spec.loader.exec_module(models)

QUICK = Options(bootstrap=0, restarts=0, advice=False)
NOISE = 1e-3


def line(slope=1.0, sd=0.1, **limits):
    return LinearModel(
        name="line",
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="slope", value=slope, sd=sd, component="lever", **limits)],
    )


def power(n):
    return Effect(
        name=f"power {n}",
        component="lever",
        unit="m",
        scale=0.1,
        regressor=lambda r, shape: r.inputs["u"] ** n,
    )


def record(i, law, role="fit", noise=NOISE):
    generator = np.random.default_rng(i)
    time = np.arange(300) * 1e-3
    u = sum(np.sin(w * time) for w in generator.uniform(10.0, 60.0, 3)) / 2.0
    y = law(u) + noise * generator.standard_normal(time.size)
    return Record(
        name=f"r{i}",
        time=time,
        inputs={"u": u},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", unit="m", sigma=noise)},
        role=role,
    )


def records(law, **what):
    roles = ("fit", "fit", "held_out", "held_out")
    return [record(i, law, role, **what) for i, role in enumerate(roles)]


def test_a_parameter_that_compensates_another_has_a_share():
    """Alone it makes the gap larger; with the other one, it removes a quarter of it."""
    model = SimulatorModel(
        lambda time, u, p: {"sum": (p["a"] + p["b"]) * u["u"], "one": p["a"] * u["u"]},
        parameters=[Parameter(name=n, value=1.0, sd=0.3) for n in "ab"],
        inputs={"u": "1"}, outputs={"sum": "m", "one": "m"},
    )  # fmt: skip
    data = []
    for i, role in enumerate(("fit", "fit", "held_out")):
        one = record(i, lambda u: 1.2 * u, role)
        two = record(10 + i, lambda u: 0.0 * u, role).outputs["y"] + 2.05 * one.inputs["u"]
        sensors = {n: replace(one.sensors["y"], name=n) for n in ("one", "sum")}
        data.append(replace(one, outputs={"one": one.outputs["y"], "sum": two}, sensors=sensors))
    report = diagnose(model, [], data, options=QUICK)
    shares = {r.name: r.share for r in report.calibrated}
    assert shares["b"] == pytest.approx(0.5 * 0.15**2 / (0.2**2 + 0.05**2), rel=0.1)
    assert shares["a"] > shares["b"]
    assert "b is 15" in report.statement


def test_what_calibration_moved_is_the_verdict():
    report = diagnose(line(), [power(3)], records(lambda u: 0.9 * u), options=QUICK)
    assert report.verdict is Verdict.CALIBRATED
    (row,) = report.calibrated
    assert (row.name, row.component, row.tabulated) == ("slope", "lever", 1.0)
    assert row.low < 0.9 < row.high
    assert row.prior_deviations == pytest.approx(-1.0, abs=0.05)
    assert row.share > 0.99
    assert row.sure
    # The last digit is a seventh of a standard deviation: where a fit ends.
    said = r"slope \(lever\) is 9\.99\d ± 0\.014 % lower than tabulated"
    assert re.search(said, report.statement)
    assert "Nothing is missing" in report.statement


def test_nothing_moved_and_nothing_is_missing():
    report = diagnose(line(), [power(3)], records(lambda u: u), options=QUICK)
    assert report.verdict is Verdict.NO_GAP
    assert not any(row.sure for row in report.calibrated)
    assert report.as_it_is[0].multiple == pytest.approx(1.0, abs=0.1)


def test_the_gap_as_it_is_does_not_hang_on_the_library():
    data = records(lambda u: 0.9 * u + 0.2 * u**3)
    found = [
        diagnose(line(), effects, data, options=QUICK)
        for effects in ([], [power(3)], [power(2), power(5)])
    ]
    rows = [r.as_it_is for r in found]
    assert rows[0] == rows[1] == rows[2]
    by_hand = np.concatenate([r.outputs["y"] - r.inputs["u"] for r in data])
    assert rows[0][0].gap == pytest.approx(float(np.sqrt(np.mean(by_hand**2))), rel=1e-9)
    assert rows[0][0].multiple == pytest.approx(rows[0][0].gap / NOISE)
    # One waterfall from there to the noise.
    far = found[1].how_far
    names = [n for n, _ in far.waterfall]
    assert names == ["as tabulated", "calibration", "power 3", "unexplained", "noise"]
    held = np.concatenate([r.outputs["y"] - r.inputs["u"] for r in data[2:]])
    assert far.tabulated == pytest.approx(float(np.sqrt(np.mean(held**2))) / NOISE, rel=1e-6)
    steps = dict(far.waterfall)
    fallen = sum(steps[n] for n in names[:3])
    assert fallen == pytest.approx(steps["unexplained"] + steps["noise"], rel=1e-6)


def test_page_terminal_and_json_have_one_order():
    data = records(lambda u: 0.9 * u + 0.2 * u**3)
    report = diagnose(line(), [power(3)], data, options=QUICK)
    heads = [
        "as it is",
        "What calibration explains",
        "What is missing",
        "What remains",
        "to do next",
    ]
    shown = report.text()
    assert str(report) == shown
    assert max(len(text) for text in shown.splitlines()) <= 80
    assert max(len(text) for text in report.text(width=120).splitlines()) > 80
    with pytest.raises(InvalidParameter, match="width = 20, expected at least 40"):
        report.text(width=20)
    for text in (shown, page(report)):
        places = [text.index(h) for h in heads]
        assert places == sorted(places)
    keys = list(report_json(report))
    wanted = ["verdict", "as_it_is", "calibrated", "named", "how_far", "where", "next"]
    assert [k for k in keys if k in wanted] == wanted
    json.dumps(report_json(report), allow_nan=False)


def test_a_gap_is_not_believed_to_be_nothing():
    """UNKNOWN with a large sum of squares stood beside "nothing is missing 84 %"."""
    data = records(lambda u: u + 0.3 * np.sign(u))
    report = diagnose(line(), [], data, options=QUICK)
    assert report.verdict is Verdict.UNKNOWN
    assert report.which.none == 0.0
    assert report.confidence == report.which.other


def test_a_limit_and_a_useless_model_are_told():
    data = records(lambda u: -0.5 * u)
    report = diagnose(line(lower=0.5), [power(3)], data, options=QUICK)
    shown = " ".join(str(report).split())
    assert "further from the records than a constant is" in shown
    assert "At a limit of its range: slope" in shown
    assert report.as_it_is[0].worse_than_constant
    assert any("is at its limit" in a.text for a in report.next)
    silent = replace(report, next=(), verdict=Verdict.ONE_OF)
    assert silent.no_step == "No step is known that would tell more."
    assert "the model explains" in replace(silent, verdict=Verdict.CALIBRATED).no_step
    assert "further from the records than a constant is" in page(report)


def test_what_surely_shrinks_the_gap_is_named_though_something_is_left():
    """A true effect, and a foreign structure that no effect explains: named, with the rest."""
    data = records(lambda u: u + 0.3 * u**3 + 0.02 * np.sin(25.0 * u))
    report = diagnose(line(), [power(3)], data, options=QUICK)
    assert report.verdict is Verdict.NAMED_RESIDUAL
    assert report.named == ("power 3",)
    assert 0.5 < report.how_far.closed < 1.0
    assert report.which["power 3"].magnitude == pytest.approx(0.3, rel=0.1)


def test_an_unknown_says_what_comes_closest():
    """A small true effect beside a large structure that no effect explains."""
    data = records(lambda u: u + 0.1 * np.sin(6.0 * u) + 0.05 * u**2)
    report = diagnose(line(), [power(2)], data, options=QUICK)
    assert report.verdict is Verdict.UNKNOWN
    closest = report.closest
    assert closest.effects == ("power 2",)
    assert 0.0 < closest.closed < 0.3
    assert closest.low <= closest.closed <= closest.high
    assert closest.why
    assert f"The closest is power 2 of {1e3 * closest.magnitudes[0]:.3g} mm" in report.statement
    assert f"it would close {closest.closed:.0%} of the held-out gap" in report.statement
    assert f"not proven: {closest.why}" in report.statement
    assert any("power 2" in a.text for a in report.next)
    # Where a tested effect takes the model no nearer, that is said.
    bare = diagnose(line(), [], data, options=QUICK)
    assert bare.closest is None


@pytest.mark.parametrize(("floor", "verdict"), [(0.05, Verdict.CALIBRATED), (1e-4, None)])
def test_good_enough_is_a_floor(floor, verdict):
    data = records(lambda u: 0.9 * u + 0.02 * np.sin(25.0 * u))
    options = replace(QUICK, good_enough={"m": floor})
    report = diagnose(line(), [power(3)], data, options=options)
    if verdict is None:
        assert report.verdict not in (Verdict.NO_GAP, Verdict.CALIBRATED)
    else:
        assert report.verdict is verdict
        assert "less than the specified good_enough" in report.statement
    assert report.as_it_is[0].noise == pytest.approx(math.hypot(NOISE, floor))


def test_good_enough_of_the_command_line():
    units = {"y": "m", "level": "V", "bare": ""}
    assert floors(("0.2mm", "y=3 mm"), units) == {
        "m": pytest.approx(2e-4),
        "y": pytest.approx(3e-3),
    }
    assert floors(("0.1 N", "y=2"), units) == {"N": pytest.approx(0.1), "y": 2.0}
    assert floors(("level=5V", "bare=3 mm"), units) == {"level": 5.0, "bare": pytest.approx(3e-3)}
    for text in ("0.2", "mm", "-1mm"):
        with pytest.raises(InvalidParameter, match="expected a size with its unit"):
            floors((text,), units)
    for text in ("y=1kg", "level=1mm"):
        with pytest.raises(InvalidParameter, match="does not measure this quantity"):
            floors((text,), units)
    with pytest.raises(InvalidParameter, match="unit 'xyz' is not known"):
        floors(("bare=3 xyz",), units)
    with pytest.raises(InvalidParameter, match="good_enough: got V, expected an output"):
        diagnose(line(), [], records(lambda u: u), options=replace(QUICK, good_enough={"V": 1.0}))


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.0003, 0.003, 0.009, 0.02])
def test_motion_that_never_reverses_cannot_tell_dry_from_one_sided_friction(width):
    def run(seed):
        rng = np.random.default_rng(seed)
        t = np.arange(0, 0.6, 0.002)
        v = 0.3 * (1 - np.cos(2 * np.pi * t / 0.6)) * (1 + 0.3 * np.sin(40 * t + seed))
        v = np.maximum(v, 0.0)
        a, x = np.gradient(v, t), np.cumsum(v) * 0.002
        force = 25 * a + 60 * v + 15.0 * np.tanh(v / width) + 0.5 * rng.standard_normal(t.size)
        return Record(
            name=f"r{seed}",
            time=t,
            inputs={"x": x, "v": v, "a": a},
            outputs={"force": force},
            sensors={"force": Sensor(name="force", unit="N", sigma=0.5)},
            input_mode="motion",
        )

    model = LinearModel(
        name="slide",
        output="force",
        columns={"mass": lambda r: r.inputs["a"], "viscous": lambda r: r.inputs["v"]},
        parameters=[
            Parameter(name="mass", value=25.0, sd=1.0, unit="kg"),
            Parameter(name="viscous", value=60.0, sd=60.0, unit="N s/m", lower=0.0),
        ],
    )
    effects = library.for_force_balance("x", "v", force=50.0, travel=0.15, pace=0.3)
    report = diagnose(model, effects, [run(i) for i in range(4)], hold_out=["r3"])
    assert report.verdict is Verdict.ONE_OF
    assert set(report.one_of) == {"dry friction", "one-sided friction"}


def test_curves_start_where_the_fit_starts():
    """A free swing: the mean of the prior is at rest, and drew a flat line."""
    arm = Coordinate(name="arm", position="q", speed="v", unit="rad/s^2")
    model = OdeModel(
        name="free swing",
        states=[
            State(name="q", unit="rad", scale=1.0, start_sd=2.0),
            State(name="v", unit="rad/s", scale=8.0, start_sd=15.0),
        ],
        parameters=[
            Parameter(name="w2", value=64.0, sd=10.0, unit="1/s^2"),
            Parameter(name="d", value=0.1, sd=0.1, unit="1/s"),
        ],
        inputs=[],
        rates=lambda t, x, u, p: (x.v, -p.w2 * np.sin(x.q) - p.d * x.v),
        outputs={"q": "q"},
        coordinates=[arm],
    )
    t = np.arange(0.0, 3.0, 0.02)
    rng = np.random.default_rng(0)
    data = []
    for i in range(3):
        jobs = Jobs(
            theta=np.array([[64.0, 0.1]]),
            segments=np.array([[0, t.size - 1]]),
            starts=np.array([[1.0 - 0.2 * i, 0.0]]),
        )
        empty = Record(name=f"r{i}", time=t, inputs={}, outputs={"q": 0.0 * t})
        q = model.simulate(empty, jobs).outputs[0, :, 0] + 1e-3 * rng.standard_normal(t.size)
        sensor = Sensor(name="q", unit="rad", sigma=1e-3)
        data.append(replace(empty, outputs={"q": q}, sensors={"q": sensor}))
    friction = library.dry_friction(arm, scale=1.0, speed=5.0)
    report = diagnose(model, [friction], data, hold_out=["r2"], options=QUICK)
    for found in (report.model, report.fitted, report.tabulated):
        for r in data:
            assert np.std(found.simulate(r)["q"] - r.outputs["q"]) < 2e-3


def test_units_of_effects_are_written_once():
    assert product(("rad/s^2", 1), ("s", 2), ("rad", -2)) == "1/rad"
    assert product(("N", 1), ("s", 2), ("m", -2)) == "N s^2/m^2"
    arm = Coordinate(name="arm", position="q", speed="v", unit="rad/s^2")
    slide = Coordinate(name="slide", position="q", speed="v", unit="N")
    wheel = Coordinate(name="wheel", position="q", speed="v", unit="V", position_unit="turn")
    assert library.quadratic_friction(arm, scale=1.0).unit == "1/rad"
    assert library.viscous_friction(slide, scale=1.0).unit == "N s/m"
    assert library.viscous_friction(wheel, scale=1.0).unit == "V s/turn"
    assert library.dry_friction(arm, scale=1.0, speed=1.0).shape_names == (
        "threshold speed [rad/s]",
    )


# ---------------------------------------------------------------- mechanisms


def test_a_finding_is_written_with_its_provenance(tmp_path):
    action = feltmb.load_action("steinway45")
    lib = load_library(action)
    head = next(e for e in lib.tolerances if e.name == "mass.head")
    felt = next(e for e in lib.tolerances if e.name == "felt.06")
    button = next(e for e in lib.tolerances if e.name == "let_off_button")
    friction = lib.effect("coulomb_friction.butt")
    play = lib.effect("pivot_clearance.butt")
    found = [
        (head, -0.1, None),
        (felt, 0.05, None),
        (button, 1e-4, None),
        (friction, friction.magnitude, friction.shapes[0]),
        (play, play.magnitude, play.shapes[0]),
    ]
    told = "diagnosis of steinway45 with records forte"
    written = action_of_findings(action, found, provenance=told)
    # The same machine as the one that was fitted.
    assert written.hash == action_with_effects(action, found).hash
    mass = written.raw["bodies"]["head"]["mass"]
    assert mass["value"] == pytest.approx(0.9 * 0.0078)
    assert (mass["unit"], mass["source"]) == ("kg", told)
    assert mass["note"].startswith("before 0.0078 kg (Table A.1)")
    curve = written.raw["contacts"]["06"]["loading"]
    assert curve["note"].startswith("a before 23500 (Table A.12); c before")
    assert "pivot_clearance.butt" in written.raw["about"]
    path = tmp_path / "found.toml"
    path.write_text(written.to_toml())
    again = feltmb.load_action(path)
    assert again.hash == written.hash
    drift = next(e for e in lib.effects if e.condition is not None)
    with pytest.raises(InvalidParameter, match="condition of the record"):
        action_of_findings(action, [(drift, 1.0, None)], provenance=told)


def test_a_model_of_ones_own_cannot_be_written(tmp_path):
    report = diagnose(line(), [], records(lambda u: u), options=QUICK)
    with pytest.raises(InvalidParameter, match=r"the model line \(LinearModel\) is made from no"):
        report.model.write(tmp_path / "found.toml")
    assert not (tmp_path / "found.toml").exists()


@pytest.mark.slow
def test_a_lighter_head_is_the_first_answer(tmp_path):
    """The hammer head weighs 10 % less than its table; three strokes, all tolerances."""
    action = feltmb.load_action("steinway45")
    light = action.with_values({"bodies.head.mass": 0.9 * 0.0078, "head.inertia": 0.9 * 3.1e-6})
    lib = load_library(action)
    outputs = lib.outputs(["key", "hammer_tip"])
    rng = np.random.default_rng(3)
    strokes = (("piano", "fit", 0.32), ("staccato", "fit", 0.26), ("forte", "held_out", 0.18))
    data = [
        make_record(
            light,
            feltmb.load_stroke(name),
            outputs,
            duration=duration,
            sensors=Sensors(),
            rng=rng,
            name=name,
            role=role,
        )
        for name, role, duration in strokes
    ]
    model, effects = mechanism_model(
        action,
        channels=["key", "hammer_tip"],
        library=lib,
        effects=["coulomb_friction.butt", "viscous_friction.butt", "camera_scale"],
    )
    report = diagnose(model, effects, data, options=Options(bootstrap=0))
    assert report.verdict is Verdict.CALIBRATED
    assert report.statement.startswith("the hammer head is ")
    assert "% lighter than tabulated" in report.statement
    row = report.calibrated[0]
    assert row.name == "mass.head"
    assert row.low < -0.1 < row.high
    assert row.share > 0.9
    assert all(a.multiple > 5.0 for a in report.as_it_is)
    path = report.model.write(tmp_path / "light.toml")
    found = feltmb.load_action(path)
    assert found.config.bodies["head"].mass == pytest.approx(0.9 * 0.0078, rel=0.01)
    run = feltmb.simulate(found, feltmb.load_stroke("forte"), ledger=False)
    truth = feltmb.simulate(light, feltmb.load_stroke("forte"), ledger=False)
    assert run.summary["impact_time"] == pytest.approx(truth.summary["impact_time"], abs=1e-4)


def test_a_weak_hint_does_not_hide_what_calibration_moved():
    """A hammer head 15 % too heavy, five tolerances, was told as: TOO WEAK, p = 0.007."""
    row = diagnose(line(), [power(3)], records(lambda u: 0.5 * u), options=QUICK).calibrated[0]
    belief = Posterior(none=0.3, other=0.7, sets=(), inflation=1.0)
    facts = SimpleNamespace(
        search=SimpleNamespace(best=None, sets=()),
        accepted=SimpleNamespace(best=None, rejected=(), p=1.0),
        p=0.005,
        options=Options(),
        enough=False,
        beyond=None,
        misfit=SimpleNamespace(left=False),
        belief=belief,
        apart=True,
        calibrated=(row,),
    )
    told = decide(facts)
    assert told.verdict is Verdict.TOO_WEAK
    assert told.statement.startswith("Parameter slope (lever) is")
    assert "times its tolerance" in told.statement
    assert "There may be something more, but these records cannot prove it" in told.statement
    # What exceeds its tolerance comes first, the farthest first; then what closes the gap.
    rows = [
        replace(row, share=share, beyond=beyond, prior_deviations=far, text=text)
        for share, beyond, far, text in (
            (0.6, False, 0.9, "A"), (0.3, True, 2.3, "B"), (0.0, True, -9.9, "C"),
            (0.01, False, 0.5, "D"), (0.2, False, 0.4, "E"),
        )
    ]  # fmt: skip
    facts.calibrated = tuple(rows)
    told = decide(facts).statement
    assert [told.index(f"{t} (") for t in "CBAE"] == sorted(told.index(f"{t} (") for t in "CBAE")
    assert "D (" not in told
    assert "1 more parameter moved" in told
    facts.calibrated, facts.apart = (), False
    assert decide(facts).statement.startswith("There may be something, but")
