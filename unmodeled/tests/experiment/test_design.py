"""Designed experiments against closed forms."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, FunctionModel, Measured, Parameter, Record, Sensor, with_measured
from unmodeled.errors import InvalidParameter
from unmodeled.experiment import (
    Belief,
    InputLimits,
    Limits,
    PartTest,
    design,
    design_json,
    reasons,
    write_design,
)
from unmodeled.experiment.information import Knowledge, Study
from unmodeled.experiment.profiles import FAMILIES

from .models import CUBE, SAMPLES, SENSORS, SQUARE, effect, limits, line


def planned(model, effects, box=None, **more):
    given = {"limits": box or limits(), "sensors": SENSORS, "refinements": 0, **more}
    return design(model, effects, **given)


def test_best_profile_is_the_t_optimal_design():
    """Line through the origin against a parabola on [0, 1]: sqrt(2) - 1 and 1, weights 1 / level.

    The closed form is the extremum of w (1 - w) x^2 (1 - x)^2 / (w x^2 + 1 - w).
    """
    found = planned(
        line(), [SQUARE], budget=1, aim="sizes", candidates=30, refinements=400,
    )  # fmt: skip
    x = np.sqrt(2.0) - 1.0
    w = 1.0 / (1.0 + x)
    best = SAMPLES * w * (1.0 - w) * x**2 * (1.0 - x) ** 2 / (w * x**2 + 1.0 - w)
    (one,) = found.experiments
    reached = np.exp(2.0 * one.after) - 1.0  # 1/2 log(1 + G), one effect
    assert reached >= 0.95 * best
    assert reached <= best * (1.0 + 2e-3)  # nothing is better than the best: 2001 samples
    assert one.profile.family == "two steps"
    levels = sorted([one.profile.numbers["level"], one.profile.numbers["then"]])
    assert levels == pytest.approx([x, 1.0], abs=0.06)


def test_best_profile_is_the_d_optimal_design():
    """Offset and slope on [-1, 1]: half of the samples at each end; det = n^2."""
    flat, slope = effect("flat", np.ones_like), effect("slope", lambda u: u)
    model = line(columns={"cube": lambda r: 0.0 * r.inputs["u"]})
    found = planned(
        model, [flat, slope], limits(least=-1.0), budget=1, aim="sizes", candidates=30,
        refinements=400,
    )  # fmt: skip
    n = SAMPLES + 1
    assert found.experiments[0].after == pytest.approx(np.log(1.0 + n), rel=0.01)
    assert found.experiments[0].after <= np.log(1.0 + n) + 1e-9


def test_no_exchange_of_two_experiments_tells_more():
    model, effects = line(), [SQUARE, CUBE]
    found = planned(model, effects, budget=2, aim="sizes", candidates=8)
    study = Study.of(model, effects)
    start = Knowledge(study)
    every = [
        planned(model, effects, budget=1, aim="sizes", candidates=1, seed=k).experiments[0].record
        for k in range(8)
    ]
    every += [e.record for e in found.experiments]
    told = [study.linearized(r) for r in every]
    best = max(
        start.plus(a, b).sizes() for a, b in itertools.combinations_with_replacement(told, 2)
    )
    assert len(found.experiments) == 2
    assert found.after >= 0.98 * best


def hidden_by_its_tolerance():
    """An effect that the tolerance of a parameter imitates."""
    return line(sd=1.0), [effect("slope too", lambda u: u, scale=0.1)]


@pytest.mark.parametrize(("cost", "bought"), [(0.5, 1), (5.0, 0)])
def test_a_test_of_a_part_is_made_where_it_is_worth_its_cost(cost, bought):
    """Only the test of the part shows the effect, and a budget of 5 cannot pay both for 5."""
    part = PartTest(parameter="slope", sd=0.001, cost=cost, how="weighing")
    model, effects = hidden_by_its_tolerance()
    found = planned(model, effects, limits(parts=(part,)), budget=5)
    assert [e.part is not None for e in found.experiments].count(True) == bought
    assert sum(e.cost for e in found.experiments) <= 5.0
    assert (found.after > 0.9) is bool(bought)


ALIKE = effect("alike", lambda u: -2.0 * u**2, scale=0.5)


def alike_effects(parts=(), **more):
    cube = effect("cube", lambda u: u**3 - u)
    return planned(line(), [SQUARE, ALIKE, cube], limits(least=-1.0, parts=parts), budget=3, **more)


def test_effects_of_equal_signature_are_told_to_be_inseparable():
    found = alike_effects()
    assert found.inseparable == (("alike", "square"),)
    rows = {v.cause: v for v in found.effects}
    assert rows["square"].rival == "alike"
    assert rows["square"].confusion == pytest.approx(0.5, abs=0.01)
    assert rows["square"].right < 0.6
    assert rows["cube"].right > 0.95


def test_a_test_of_one_part_separates_equal_effects():
    """The plan gives the standard deviation m / sqrt(2 log 9); more is not enough."""
    known = {t.name: t.sd for t in alike_effects().tests}
    assert known == pytest.approx({"square": 0.477, "alike": 0.2385}, rel=2e-3)
    enough, poor = (
        PartTest(parameter="alike", sd=f * known["alike"], cost=0.1) for f in (0.9, 1.1)
    )
    assert alike_effects([enough]).inseparable == ()
    assert alike_effects([poor]).inseparable == (("alike", "square"),)
    bought = [e for e in alike_effects([enough]).experiments if e.part is not None]
    assert [e.part for e in bought] == [enough]
    assert {*bought[0].separated[:2]} == {"alike", "square"}
    (text,) = reasons(bought[0], 3)
    assert text.startswith("separates ")


def test_the_test_of_a_parameter_separates_what_changes_the_same_number():
    """The effect of this number itself has no test; the look-alike has one."""
    steeper = effect("steeper", lambda u: u, scale=0.5)
    both = [replace(steeper, tolerance_parameter="slope"), replace(steeper, name="look-alike")]
    found = planned(line(sd=0.08), both, budget=1)
    assert found.inseparable == (("look-alike", "steeper"),)
    assert {t.name for t in found.tests} == {"slope", "look-alike"}
    for test in found.tests:
        part = PartTest(parameter=test.name, sd=0.9 * test.sd, cost=0.1)
        assert planned(line(sd=0.08), both, limits(parts=(part,)), budget=1).inseparable == ()
    same = [both[0], replace(both[0], name="steeper too")]
    found = planned(line(sd=0.08), same, budget=1)
    assert found.inseparable == (("steeper", "steeper too"),)  # both are the slope
    part = PartTest(parameter="slope", sd=1e-3, cost=0.1)
    then = planned(line(sd=0.08), same, limits(parts=(part,)), budget=1)
    assert then.inseparable == found.inseparable


def test_a_plan_after_a_test_of_a_part_keeps_its_promise():
    """A tolerance hides an effect; the plan tells its test, and is right about the result."""
    slope = effect("slope too", lambda u: u + 0.01 * u**2, scale=0.3)
    without = planned(line(sd=0.3), [slope], budget=1)
    (test,) = without.tests
    assert test.name == "slope"
    bought = with_measured(line(sd=0.3), [Measured(parameter="slope", value=1.0, sd=test.sd)])
    then = planned(bought, [slope], budget=1)
    assert then.after > without.after + 0.02
    assert then.after == pytest.approx(test.after, abs=0.1)


def test_belief_decides_what_is_worth_an_experiment():
    """A pair that is left wants another profile than the size of a third effect."""
    low = effect("low", lambda u: np.where(u < 0.3, u, 0.3))
    low_too = effect("low too", lambda u: np.where(u < 0.2, u, 0.2))
    belief = Belief(weights={"low": 0.5, "low too": 0.5}, magnitudes={"low": 1.0, "low too": 1.0})
    found = planned(
        line(), [low, low_too, SQUARE], budget=1, belief=belief,
        sensors={"y": Sensor(name="y", sigma=0.3)},
    )  # fmt: skip
    assert {*found.experiments[0].separated[:2]} == {"low", "low too"}
    assert found.after > found.before + 0.2


def test_records_that_exist_count():
    """What records show already, an experiment needs not show again."""
    time = np.arange(300) / 300.0
    u = np.linspace(0.0, 1.0, 300)
    one = Record(name="a", time=time, inputs={"u": u}, outputs={"y": u},
                 sensors={"y": Sensor(name="y", sigma=1.0)})  # fmt: skip
    wave = effect("wave", lambda u: np.sin(20.0 * u))
    found = design(line(sd=0.1), [SQUARE, wave], [one], limits=limits(), refinements=0)
    none = design(line(sd=0.1), [SQUARE, wave], limits=limits(), sensors=SENSORS, refinements=0)
    assert found.before > none.before + 0.2
    assert found.effects[0].smallest < found.effects[0].smallest_before < np.inf


def two_outputs():
    """The second output shows which of two effects it is."""
    model = FunctionModel(
        name="two",
        parameters=[Parameter(name="a", value=1.0, sd=0.1)],
        outputs={"y": lambda r, p: p.a * r.inputs["u"], "z": lambda r, p: 0.0 * r.inputs["u"]},
    )

    def both(name, share):
        def columns(r, _):
            return np.column_stack([r.inputs["u"] ** 2, share * r.inputs["u"] ** 2])

        return Effect(name=name, component="c", regressor=columns)

    return model, [both("first", 0.0), both("second", 0.1)]


def test_a_further_sensor_is_worth_what_a_plan_with_it_is_worth():
    model, effects = two_outputs()
    given = {"budget": 1, "candidates": 4, "refinements": 0}
    sensors = {"y": Sensor(name="y", sigma=0.1)}
    offered = limits(further={"z": 0.01, "y": 0.05})
    found = design(model, effects, limits=offered, sensors=sensors, **given)
    assert found.inseparable == (("first", "second"),)
    assert [s.name for s in found.sensors] == ["z", "y"]
    assert set(found.experiments[0].record.outputs) == {"y"}
    both = {**sensors, "z": Sensor(name="z", sigma=0.01)}
    then = design(model, effects, limits=limits(), sensors=both, **given)
    assert then.inseparable == ()
    assert found.sensors[0].after == pytest.approx(then.after, abs=0.02)
    assert found.after < 0.6 < then.after
    better = {"y": Sensor(name="y", sigma=0.05)}
    less = design(model, effects, limits=limits(), sensors=better, **given)
    assert found.sensors[1].after == pytest.approx(less.after, abs=0.02)


def any_input(r):
    return next(iter(r.inputs.values()))


def test_inputs_of_two_modes_are_compared():
    """A record of one mode has not the input of the other one."""
    model = line(columns={"slope": any_input})
    model.inputs = ()
    model.input_modes = {"force": ("u",), "motion": ("x",)}
    square = Effect(name="s", component="c", regressor=lambda r, _: any_input(r) ** 2)
    own = InputLimits(most=1.0)
    box = Limits(inputs={"u": own, "x": own}, duration=1.0, sample_rate=200.0)
    found = design(model, [square], limits=box, budget=1, candidates=5, refinements=0)
    assert found.experiments[0].input in ("u", "x")


@pytest.mark.parametrize("name", list(FAMILIES))
def test_profiles_keep_to_their_limits(name):
    own = InputLimits(least=-1.0, most=3.0, rate=40.0, acceleration=3000.0)
    box = Limits(inputs={"u": own}, duration=0.5, sample_rate=1e5)
    generator = np.random.default_rng(1)
    made = 0
    for _ in range(40):
        profile = FAMILIES[name].make(generator.random(len(FAMILIES[name].knobs)), own, box)
        if profile is None:
            continue
        made += 1
        time = np.linspace(0.0, profile.end, 50_001)
        value = profile.at(time)
        rate = np.gradient(value, time)
        assert profile.end <= 0.5 + 1e-12
        assert value.min() >= -1.0 - 1e-9
        assert value.max() <= 3.0 + 1e-9
        assert np.abs(rate).max() <= 40.0 * 1.001
        assert np.abs(np.gradient(rate, time)).max() <= 3000.0 * 1.02
        assert value[0] == own.start
    assert made >= 20


def test_names_of_families_can_stand_in_a_list_with_commas():
    assert not any("," in name for name in FAMILIES)


def test_profiles_that_fail_are_left_out_and_counted():
    """The simulation fails above a level: the plan stays below it."""
    model = line(columns={"slope": lambda r: np.where(r.inputs["u"] > 0.5, np.nan, r.inputs["u"])})
    found = planned(model, [SQUARE], budget=1)
    assert 0 < found.failed < 40
    assert found.experiments[0].record.inputs["u"].max() <= 0.5
    dead = line(columns={"slope": lambda r: np.nan * r.inputs["u"]})
    with pytest.raises(InvalidParameter, match="none of the 40 profiles"):
        planned(dead, [SQUARE])


def test_all_faults_of_a_request_are_told_at_once():
    with pytest.raises(InvalidParameter) as failure:
        planned(line(), [SQUARE], budget=0.0, families=["jump"], candidates=20_000)
    for told in ("families: jump is none of", "budget = 0.0", "candidates = 20000"):
        assert told in str(failure.value)
    with pytest.raises(InvalidParameter, match="sensors: z is no output"):
        planned(line(), [SQUARE], sensors={"z": Sensor(name="z")})
    with pytest.raises(InvalidParameter, match="can simulate none"):
        planned(line(), [Effect(name="x", component="c")])


def test_hidden_effects_have_a_reason():
    """A free slope imitates one effect completely, and another one changes nothing."""
    slope, nothing = effect("steeper", lambda u: 2.0 * u), effect("nothing", lambda u: 0.0 * u)
    rows = {v.cause: v for v in planned(line(), [SQUARE, slope, nothing], budget=1).effects}
    assert [(rows[n].smallest, rows[n].imitated) for n in ("steeper", "nothing")] == [
        (np.inf, True), (np.inf, False),
    ]  # fmt: skip
    assert np.isfinite(rows["square"].smallest)


def test_files_of_a_plan(tmp_path):
    part = PartTest(parameter="slope", sd=0.001, cost=0.5, how="weighing")
    model, effects = hidden_by_its_tolerance()
    found = planned(model, effects, limits(parts=(part,)), budget=1.5)
    paths = write_design(found, tmp_path, units={"u": "N", "y": "m"})
    at = [e.part is None for e in found.experiments].index(True)
    assert {p.name for p in paths} == {f"{at + 1}.csv", f"{at + 1}.png", "plan.json"}
    head, *rows = (tmp_path / f"{at + 1}.csv").read_text().splitlines()
    assert head == "time [s],u [N]"
    table = np.array([r.split(",") for r in rows], dtype=float)
    assert table[:, 1] == pytest.approx(found.experiments[at].record.inputs["u"], abs=1e-8)
    plan = design_json(found)
    assert plan["after"] == pytest.approx(found.after)
    family = found.experiments[at].profile.family
    assert plan["experiments"][at]["profile"]["family"] == family
    assert plan["experiments"][1 - at]["part"]["how"] == "weighing"
