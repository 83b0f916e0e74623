"""Effects that are more of a tolerance: found beyond it, told by their size alone."""

from dataclasses import replace

import numpy as np
import pytest
from feltmb.fit.problem import Problem
from feltmb.fit.solve import fit_problem
from feltmb.gap.checks import check_against
from feltmb.gap.criteria import TOLERATED
from feltmb.gap.judged_data import prepare
from feltmb.gap.tolerance import beyond_prior

import feltmb
from feltmb.adapters import load_library, mechanism_model, planned_strokes
from feltmb.adapters.aliases import alias_of
from feltmb.adapters.changes import Change, read_entry
from feltmb.adapters.variants import changed_config
from feltmb.data import Record, Sensor
from feltmb.fit import Candidate, Effect, Parameter
from feltmb.fit.linear import LinearModel
from feltmb.gap import Verdict, diagnose
from feltmb.gap.score import all_candidates, score_fit

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
    found = alias_of(ACTION.config, LIBRARY.effect(effect), LIBRARY.tolerances)
    assert (None if found is None else found.tolerance.name) == tolerance


def test_numbers_of_other_units_count_as_well():
    """Two entries that both move a stiffness, but only one its exponent, are two."""
    stiffness, exponent = "contacts.03.loading.a", "contacts.03.loading.b"
    tolerance = replace(
        LIBRARY.tolerances[0],
        changes=(Change(path=stiffness, scale=1.0), Change(path=exponent, scale=1e-3)),
    )
    effect = replace(LIBRARY.effect("felt_stiffness.03"), changes=tolerance.changes)
    assert alias_of(ACTION.config, effect, [tolerance]).index == 0
    other = (Change(path=stiffness, scale=1.0), Change(path=exponent, scale=2e-3))
    assert alias_of(ACTION.config, replace(effect, changes=other), [tolerance]) is None


@pytest.mark.parametrize("name", ["let_off_button", "coulomb_friction.key", "felt_stiffness.03",
                                  "shank_compliance", "wire_compliance"])  # fmt: skip
def test_the_ratio_is_that_of_the_changed_numbers(name):
    effect = LIBRARY.effect(name)
    alias = alias_of(ACTION.config, effect, LIBRARY.tolerances)
    theta, size, h = 0.7 * alias.tolerance.magnitude, 0.4 * effect.magnitude, 1e-6

    def number(departure, amount):
        entries = [(alias.tolerance, departure, None), (effect, amount, None)]
        config = changed_config(ACTION.config, entries, {})
        return float(read_entry(config, effect.changes[0].path))

    by_effect = number(theta, size + h * effect.magnitude) - number(
        theta, size - h * effect.magnitude
    )
    by_tolerance = number(theta + h * alias.tolerance.magnitude, size)
    by_tolerance -= number(theta - h * alias.tolerance.magnitude, size)
    expected = by_effect / effect.magnitude / (by_tolerance / alias.tolerance.magnitude)
    assert alias.ratio(theta, size) == pytest.approx(expected, rel=1e-6)


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
    assert report.verdict is Verdict.NAMED
    assert report.named == ("let_off_button",)
    found = next(r for r in report.which.effects if r.effect == "let_off_button")
    assert found.low < -1.2e-3 < found.high
    assert found.statistic == pytest.approx((1.2e-3 / 2e-4) ** 2, rel=0.15)  # the prior alone
    assert report.how_far.closed > 0.8


def test_its_score_is_the_square_of_its_strain(small):
    model, effects, strokes = small
    ready = model.ready(strokes[1:])
    checks = check_against(ready.model, ready.records)
    segmented_records = prepare(ready.model, ready.records, checks, None)
    fit = fit_problem(Problem(ready.model, segmented_records))
    z = beyond_prior(fit)["let_off_button"]
    assert z == pytest.approx(-6.0, abs=0.3)
    scores = score_fit(fit, all_candidates(effects))
    at = [t.name for t in scores.candidates].index("let_off_button")
    assert scores.singles()[at] == pytest.approx(z**2, rel=0.05)


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


@pytest.mark.parametrize(("slope", "verdict"), [(1.3, Verdict.CALIBRATED), (2.0, Verdict.NAMED)])
def test_within_its_tolerance_it_is_none(slope, verdict):
    model, records = line(slope, 0.1)
    report = diagnose(model, [steeper("slope")], records, hold_out=["r2"])
    assert report.verdict is verdict
    if verdict is Verdict.NAMED:
        size = report.which.effects[0]
        assert size.low < 1.0 < size.high
        assert size.high - size.low > 0.3  # the tolerance is part of it
        assert report.how_far.closed > 0.9
        assert not report.checks.warnings  # with the effect it is where it should be


def test_without_such_an_effect_the_strain_is_told():
    model, records = line(2.0, 0.1)
    report = diagnose(model, [], records, hold_out=["r2"])
    assert report.verdict is Verdict.CALIBRATED
    assert "10.0 times its tolerance" in report.statement
    assert any("refute the tolerance of slope" in w for w in report.checks.warnings)
    model, records = line(1.0 + 0.9 * TOLERATED * 0.1, 0.1)
    assert diagnose(model, [], records, hold_out=["r2"]).statement.endswith(").")


def friction(size, *, quiet=False):
    """Records that see a friction about as well as its tolerance of 0.2 does; r2 does not."""
    u = np.linspace(-1.0, 1.0, 80)
    records = []
    for k in range(3):
        noise = 2.0 * np.random.default_rng(k).standard_normal(80)
        drive = u * (0.05 if k == 2 and quiet else 1.0)
        noise -= drive * (noise @ drive) / (drive @ drive)  # what they say is the truth
        records.append(
            Record(
                name=f"r{k}",
                time=np.arange(80) * 0.01,
                inputs={"u": drive},
                outputs={"y": size * drive + noise},
                sensors={"y": Sensor(name="y", sigma=2.0)},
            )
        )
    model = LinearModel(
        output="y",
        columns={"friction": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="friction", value=0.0, sd=0.2)],
    )
    return model, records


@pytest.mark.parametrize("with_effect", [True, False])
def test_a_tolerance_that_records_refute_holds_no_number_back(with_effect):
    """Held-out records that hardly feel it cannot confirm it; they were asked to."""
    model, records = friction(2.0, quiet=True)
    effects = [steeper("friction")] if with_effect else []
    segmented_records = prepare(model, records, check_against(model, records), None)
    fit = fit_problem(Problem(model, segmented_records[:2]))
    assert abs(fit.point.theta[0]) < 1.6  # the tolerance pulls
    report = diagnose(model, effects, records, hold_out=["r2"])
    assert report.verdict is Verdict.CALIBRATED
    (row,) = report.calibrated
    assert row.value == pytest.approx(2.0, abs=1e-3)
    assert row.prior_deviations == pytest.approx(10.0, abs=0.1)
    assert report.fitted.parameters["friction"] == row.value


def test_between_two_and_four_the_records_alone_are_told_beside():
    model, records = friction(1.2, quiet=True)
    (row,) = diagnose(model, [], records, hold_out=["r2"]).calibrated
    assert row.high < 1.2
    assert row.alone == pytest.approx(1.2, abs=1e-3)
    assert row.alone_sd == pytest.approx(0.27, abs=0.01)
    assert "the records alone say" in row.text


def test_another_cause_that_does_as_well_keeps_the_tolerance():
    """Then it is not known that it is this number which is off."""
    model, records = friction(2.0, quiet=True)
    other = Effect(name="alike", component="other", regressor=lambda r, _: r.inputs["u"])
    report = diagnose(model, [steeper("friction"), other], records, hold_out=["r2"])
    assert report.verdict is not Verdict.CALIBRATED


def test_several_tolerances_refuted_at_once_are_another_machine():
    """No effect is named for what several numbers do together; what to do is told."""
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
    other = Effect(name="alike", component="other", regressor=lambda r, _: np.abs(r.inputs["u"]))
    report = diagnose(model, [steeper("slope"), other], two, hold_out=["r2"])
    assert report.verdict is Verdict.CALIBRATED
    assert {r.name: round(r.value, 1) for r in report.calibrated} == {"slope": 2.0, "bend": -1.0}
    assert report.statement.startswith("The model as a whole is not the machine")
    assert report.next[0].text.startswith("Make sure that the model is of the machine")
    assert any("refute the tolerance of bend, slope" in w for w in report.checks.warnings)


def test_what_is_pressed_against_its_limit_takes_up_nothing():
    _, records = line(2.0, 0.1)
    limited = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1, upper=1.2)],
    )
    segmented_records = prepare(limited, records, check_against(limited, records), None)
    fit = fit_problem(Problem(limited, segmented_records))
    candidate = Candidate(steeper(""), None)
    scores = score_fit(fit, (candidate,))
    # As if the parameter were known: 0.8 u over noise of 0.1.
    u = np.concatenate([r.inputs["u"] for r in records])
    assert scores.strength[0] == pytest.approx(np.sqrt(u @ u) / 0.1, rel=1e-6)
    assert scores.one_step()[0] == pytest.approx(0.8, abs=0.03)
