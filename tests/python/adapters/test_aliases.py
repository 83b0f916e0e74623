"""Effects that are more of a tolerance: found beyond it, told by their size alone."""

import re
from dataclasses import replace

import numpy as np
import pytest

import feltmb
from feltmb.adapters import load_library, mechanism_model, planned_strokes
from feltmb.adapters.changes import Change, changed_config, same_values
from feltmb.adapters.effects import user_unit_of
from feltmb.mechanism.numbers import read_entry
from unmodeled import Verdict, diagnose
from unmodeled.data import Record, Sensor
from unmodeled.fit import Effect, LinearModel, Parameter

ACTION = feltmb.load_action("steinway45")
LIBRARY = load_library(ACTION)


@pytest.mark.parametrize(
    ("effect", "tolerance"),
    [
        ("let_off_button", "let_off_button"),
        ("coulomb_friction.key", "joint_friction.key"),
        ("felt_stiffness.03", "felt.03"),
        ("spring_rate.jack_spring", "spring.jack_spring"),
        ("shank_compliance", "bending.shank"),
        ("string_impedance", "string_impedance"),
        ("felt_thickness.03", None),  # moves surfaces, no tolerance does
        ("felt_hysteresis.03", None),
        ("pivot_clearance.whippen", None),  # inserts parts
        ("stribeck_friction.key", None),  # has a shape
        ("felt_softening.03", None),  # counts by the condition of a record
        ("camera_skew", None),
    ],
)
def test_who_is_more_of_what(effect, tolerance):
    found = same_values(ACTION.config, LIBRARY.effect(effect), LIBRARY.tolerances)
    assert (None if found is None else found[0].name) == tolerance


def test_numbers_of_other_units_count_as_well():
    """Two entries that both move a stiffness, but only one its exponent, are two."""
    stiffness, exponent = "contacts.03.loading.a", "contacts.03.loading.b"
    both = (Change(path=stiffness, scale=1.0), Change(path=exponent, scale=1e-3))
    tolerance = LIBRARY.tolerances[0].model_copy(update={"changes": both})
    effect = LIBRARY.effect("felt_stiffness.03").model_copy(update={"changes": both})
    assert same_values(ACTION.config, effect, [tolerance]) == (tolerance, pytest.approx(1.0))
    other = (Change(path=stiffness, scale=1.0), Change(path=exponent, scale=2e-3))
    effect = effect.model_copy(update={"changes": other})
    assert same_values(ACTION.config, effect, [tolerance]) is None


@pytest.mark.parametrize("name", ["let_off_button", "coulomb_friction.key", "felt_stiffness.03",
                                  "shank_compliance", "wire_compliance"])  # fmt: skip
def test_the_ratio_is_that_of_the_changed_numbers(name):
    effect = LIBRARY.effect(name)
    tolerance, ratio = same_values(ACTION.config, effect, LIBRARY.tolerances)

    def number(entry, size):
        config = changed_config(ACTION.config, [(entry, size, None)])
        return float(read_entry(config, effect.changes[0].path))

    by_effect, by_tolerance = (
        (number(e, h) - number(e, -h)) / h
        for e, h in ((effect, 1e-6 * effect.magnitude), (tolerance, 1e-6 * tolerance.magnitude))
    )
    assert ratio == pytest.approx(by_effect / by_tolerance, rel=1e-6)


@pytest.fixture(scope="module")
def small():
    model, effects = mechanism_model(
        ACTION,
        channels=["key", "whippen", "hammer"],
        tolerances=["let_off_button", "felt.03", "mass.head"],
        effects=["let_off_button", "felt_thickness.03", "viscous_friction.butt", "camera_skew"],
        workers=1,
    )
    strokes = []
    generator = np.random.default_rng(3)
    wanted = {"let_off_button": -1.2e-3}
    theta = np.array([wanted.get(p.name, 0.0) for p in model.parameters])
    for r in planned_strokes(model):
        whole = model.simulator.whole(r, model.simulator.version(r, theta, (), np.zeros(0)))
        outputs = {
            o: whole[:, k] + 2e-5 * generator.standard_normal(r.samples)
            for k, o in enumerate(model.outputs)
        }
        strokes.append(replace(r, outputs=outputs))
    return model, effects, strokes


@pytest.mark.slow
def test_beyond_its_tolerance_a_parameter_is_a_cause(small):
    model, effects, strokes = small
    assert {e.name: e.tolerance_parameter for e in effects} == {
        "let_off_button": "let_off_button",
        "felt_thickness.03": "",
        "viscous_friction.butt": "",
        "camera_skew": "",
    }
    assert all(e.tolerance_ratio == 1.0 for e in effects)
    report = diagnose(model, effects, strokes, hold_out=["forte"])
    (found,) = report.named
    assert found.cause == "let_off_button"
    assert found.low < -1.2e-3 < found.high
    assert found.magnitude == pytest.approx(-1.2e-3, rel=0.1)
    assert report.worst.explained < 0.2 * report.worst.tabulated


def line(slope, sd):
    """y = slope * u + noise 0.1; an effect is more of the slope."""
    u = np.linspace(-1.0, 1.0, 80)
    records = [
        Record(
            name=f"r{k}",
            time=np.arange(80) * 0.01,
            inputs={"u": u * (1.0 + k)},
            outputs={
                "y": slope * u * (1.0 + k) + 0.1 * np.random.default_rng(k).standard_normal(80)
            },
            sensors={"y": Sensor(name="y", sigma=0.1)},
        )
        for k in range(3)
    ]
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=sd)],
    )
    return model, records


def steeper(beyond):
    return Effect(
        name="steeper",
        component="spring",
        regressor=lambda r, _: r.inputs["u"],
        tolerance_parameter=beyond,
    )


@pytest.mark.parametrize("slope", [1.15, 2.0])
def test_within_its_tolerance_it_is_none(slope):
    model, records = line(slope, 0.1)
    report = diagnose(model, [steeper("slope")], records, hold_out=["r2"])
    if slope < 1.3:
        assert report.verdict is Verdict.CALIBRATED
        return
    (found,) = report.named
    assert (found.cause, found.changes) == ("steeper", "slope")
    assert [c.name for c in report.changes] == ["steeper"]  # once
    assert found.low < slope - 1.0 < found.high
    assert report.worst.explained < 0.1 * report.worst.tabulated


def test_an_effect_may_change_its_parameter_backwards():
    model, records = line(2.0, 0.1)
    flatter = replace(steeper("slope"), name="flatter", tolerance_ratio=-2.0)
    report = diagnose(model, [flatter], records, hold_out=["r2"])
    (found,) = report.named
    assert found.cause == "flatter"
    assert found.low < -0.5 < found.high
    sizes = [dict(zip(s.causes, s.magnitudes, strict=True)) for s in report.sets]
    assert sizes[0] == {"flatter": found.magnitude}
    (change,) = report.changes  # its title is that of the parameter, and so is its number
    assert change.size == pytest.approx(-2.0 * found.magnitude)
    assert change.low < 1.0 < change.high


def test_without_such_an_effect_the_parameter_is_told():
    model, records = line(2.0, 0.1)
    report = diagnose(model, [], records, hold_out=["r2"])
    (found,) = report.named
    assert (found.cause, found.parameter) == ("slope", True)
    assert found.low < 2.0 < found.high
    assert report.sets[0].magnitudes == (found.magnitude,)
    model, records = line(1.15, 0.1)
    assert diagnose(model, [], records, hold_out=["r2"]).verdict is Verdict.CALIBRATED


def test_several_parameters_outside_their_tolerances_are_all_told():
    _, records = line(0.0, 0.1)
    u = records[0].inputs["u"]
    two = [
        replace(r, inputs={"u": u, "w": u**2}, outputs={"y": r.outputs["y"] + 2.0 * u - 1.0 * u**2})
        for r in records
    ]
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["u"], "bend": lambda r: r.inputs["w"]},
        parameters=[
            Parameter(name="slope", value=1.0, sd=0.1),
            Parameter(name="bend", value=0.0, sd=0.1),
        ],
    )
    report = diagnose(model, [], two, hold_out=["r2"])
    assert {n.cause: round(n.magnitude, 1) for n in report.named} == {"slope": 2.0, "bend": -1.0}


def test_beyond_its_tolerance_a_share_is_told_in_percent():
    model, records = line(2.0, 0.1)
    share = Parameter(name="slope", value=1.0, sd=0.1, relative=True)
    force = replace(steeper("slope"), unit="N", tolerance_ratio=0.5)
    report = diagnose(model.with_parameters({"slope": share}), [force], records, hold_out=["r2"])
    (change,) = report.changes
    told = re.search(r" N \(.*; \+([0-9.]+) %\)", report.summary())
    assert told is not None
    assert float(told[1]) == pytest.approx(50.0 * change.size, rel=1e-3)


def test_an_effect_may_be_a_share():
    model, records = line(2.0, 0.0)
    share = replace(steeper(""), label="the slope", relative=True)
    report = diagnose(model, [share], records, hold_out=["r2"])
    assert re.match(r"The slope differs from the model by \+[0-9.]+ % \(", report.summary())


def test_sizes_have_the_units_of_a_workshop():
    known = {e.name: e for e in (*LIBRARY.tolerances, *LIBRARY.effects)}

    def unit(name):
        found = user_unit_of(known[name], ACTION.config)
        return found and (found.unit, pytest.approx(found.per_unit))

    assert unit("let_off_button") == ("turn", 1.0 / 0.7e-3)
    assert unit("mass.head") == ("kg", ACTION.config.bodies["head"].mass)
    assert unit("backcheck_wire_angle") == ("deg", 180.0 / np.pi)
    assert unit("key_dip") is None
    _, effects = mechanism_model(ACTION, effects=["inertia.key", "let_off_button", "felt_*.03"])
    shares = {e.name for e in effects if e.relative}
    assert shares == {"inertia.key", "felt_stiffness.03", "felt_softening.03"}
