"""Plans of proposed records against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, FunctionModel, Measured, Parameter, Sensor, with_measured
from unmodeled.errors import InvalidParameter
from unmodeled.experiment import Belief, plan

from .models import CUBE, RAMP, SAMPLES, SQUARE, effect, line, proposed


def two_levels(low, share):
    """A share of the samples at a low level, the others at 1."""
    return np.where(np.arange(SAMPLES) < share * SAMPLES, low, 1.0)


def test_the_record_of_the_t_optimal_design_comes_first():
    """Line through the origin against a parabola on [0, 1]: sqrt(2) - 1 and 1, weights 1 / level.

    The information of two levels is n w (1 - w) x^2 (1 - x)^2 / (w x^2 + 1 - w).
    """

    def information(x, w):
        return SAMPLES * w * (1.0 - w) * x**2 * (1.0 - x) ** 2 / (w * x**2 + 1.0 - w)

    x = np.sqrt(2.0) - 1.0
    best = x, 1.0 / (1.0 + x)
    pairs = [(0.2, 0.7), best, (0.6, 0.6), (0.4, 0.5)]
    records = [proposed(two_levels(*p), f"{p[0]:.2f}") for p in pairs]
    result = plan(line(), [SQUARE], records, aim="sizes")
    assert result.records[0].record.name == "0.41"
    reached = np.exp(2.0 * result.records[0].after) - 1.0  # 1/2 log(1 + G), one effect
    assert reached == pytest.approx(information(*best), rel=1e-3)
    assert len(result.records) == len(pairs)
    assert result.records[-1].after == result.after


def test_each_record_is_the_best_in_addition_to_those_before():
    """A second record of the same kind tells less than one of another kind."""
    slow, slow_too = (proposed(0.5 * RAMP, n) for n in ("slow", "slow too"))
    wave = proposed(0.3 * np.sin(20.0 * RAMP), "wave")
    result = plan(line(sd=0.1), [SQUARE, CUBE], [wave, slow_too, slow], aim="sizes")
    values = [result.before, *(r.after for r in result.records)]
    assert values == sorted(values)
    assert [r.before for r in result.records] == values[:-1]
    one, two = (plan(line(sd=0.1), [SQUARE, CUBE], [r], aim="sizes").after for r in (slow, wave))
    assert result.records[0].after == pytest.approx(max(one, two))


ALIKE = effect("alike", lambda u: -2.0 * u**2, scale=0.5)
BOTH_SIDES = proposed(2.0 * RAMP - 1.0)


def alike_effects(model=None):
    cube = effect("cube", lambda u: u**3 - u)
    effects = [e for e in (SQUARE, ALIKE, cube) if model is None or e.name != "alike"]
    return plan(model or line(), effects, [BOTH_SIDES])


def test_effects_of_equal_signature_are_inseparable():
    result = alike_effects()
    assert result.inseparable == (("alike", "square"),)
    rows = {v.cause: v for v in result.effects}
    assert rows["square"].rival == "alike"
    assert rows["square"].confusion == pytest.approx(0.5, abs=0.01)
    assert rows["square"].right < 0.6
    assert rows["cube"].right > 0.95


def test_a_test_of_one_part_separates_equal_effects():
    """The plan gives the standard deviation m / sqrt(2 log 9)."""
    known = {t.name: t.sd for t in alike_effects().tests}
    assert known == pytest.approx({"square": 0.477, "alike": 0.2385}, rel=2e-3)


def test_the_test_of_a_parameter_separates_what_changes_the_same_number():
    """The effect of this number itself has no test; the look-alike has one."""
    steeper = effect("steeper", lambda u: u, scale=0.5)
    both = [replace(steeper, tolerance_parameter="slope"), replace(steeper, name="look-alike")]
    result = plan(line(sd=0.08), both, [BOTH_SIDES])
    assert result.inseparable == (("look-alike", "steeper"),)
    assert {t.name for t in result.tests} == {"slope", "look-alike"}
    same = [both[0], replace(both[0], name="steeper too")]
    result = plan(line(sd=0.08), same, [BOTH_SIDES])
    assert result.inseparable == (("steeper", "steeper too"),)  # both are the slope


def test_a_plan_after_a_test_of_a_part_keeps_its_promise():
    """A tolerance hides an effect; the plan states its test, and is right about the result."""
    slope = effect("slope too", lambda u: u + 0.01 * u**2, scale=0.3)
    without = plan(line(sd=0.3), [slope], [proposed(RAMP)])
    (test,) = without.tests
    assert test.name == "slope"
    tested = with_measured(line(sd=0.3), [Measured(parameter="slope", value=1.0, sd=test.sd)])
    then = plan(tested, [slope], [proposed(RAMP)])
    assert then.after > without.after + 0.02
    assert then.after == pytest.approx(test.after, abs=0.1)


def test_belief_decides_which_record_is_best():
    """A pair that is left wants another record than the size of a third effect."""
    low = effect("low", lambda u: np.where(u < 0.3, u, 0.3))
    low_too = effect("low too", lambda u: np.where(u < 0.2, u, 0.2))
    belief = Belief(weights={"low": 0.5, "low too": 0.5}, magnitudes={"low": 1.0, "low too": 1.0})
    y = {"y": Sensor(name="y", sigma=0.3)}
    records = [proposed(0.4 + 0.6 * RAMP, "high", y), proposed(0.5 * RAMP, "low", y)]
    result = plan(line(), [low, low_too, SQUARE], records, belief=belief)
    first = result.records[0]
    assert first.record.name == "low"
    assert {*first.separated[:2]} == {"low", "low too"}
    (*_, text) = first.reasons(3)
    assert text.startswith("separates ")
    assert result.after > result.before + 0.2


def test_records_that_exist_count():
    """What records show already, a further record need not show again."""
    wave = effect("wave", lambda u: np.sin(20.0 * u))
    new = proposed(RAMP, "new")
    result = plan(line(sd=0.1), [SQUARE, wave], [new], [proposed(RAMP[::7])])
    none = plan(line(sd=0.1), [SQUARE, wave], [new])
    assert result.before > none.before + 0.2
    assert result.effects[0].smallest < result.effects[0].smallest_before < np.inf


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


def test_a_record_with_a_further_sensor_separates_more():
    model, effects = two_outputs()
    sensors = {"y": Sensor(name="y", sigma=0.1)}
    both = {**sensors, "z": Sensor(name="z", sigma=0.01)}
    less, more = (proposed(RAMP, sensors=s) for s in (sensors, both))
    assert plan(model, effects, [less]).inseparable == (("first", "second"),)
    result = plan(model, effects, [less, replace(more, name="with z")])
    assert result.records[0].record.name == "with z"
    assert result.inseparable == ()
    assert plan(model, effects, [less]).after < 0.6 < result.after


def test_records_that_fail_are_left_out_and_named():
    """The simulation fails above a level."""
    model = line(columns={"slope": lambda r: np.where(r.inputs["u"] > 0.5, np.nan, r.inputs["u"])})
    result = plan(model, [SQUARE], [proposed(RAMP, "full"), proposed(0.5 * RAMP, "half")])
    assert result.failed == ("full",)
    assert [r.record.name for r in result.records] == ["half"]
    with pytest.raises(InvalidParameter, match=r"none of the 1 proposed records \(full: "):
        plan(model, [SQUARE], [proposed(RAMP, "full")])


def test_requests_without_records_or_effects_are_refused():
    with pytest.raises(InvalidParameter, match="proposed is empty"):
        plan(line(), [SQUARE], [])
    with pytest.raises(InvalidParameter, match="can simulate none"):
        plan(line(), [Effect(name="x", component="c")], [proposed(RAMP)])


def test_hidden_effects_have_a_reason():
    """A free slope imitates one effect completely, and another one changes nothing."""
    slope, nothing = effect("steeper", lambda u: 2.0 * u), effect("nothing", lambda u: 0.0 * u)
    result = plan(line(), [SQUARE, slope, nothing], [proposed(RAMP)])
    rows = {v.cause: v for v in result.effects}
    assert [(rows[n].smallest, rows[n].imitated) for n in ("steeper", "nothing")] == [
        (np.inf, True), (np.inf, False),
    ]  # fmt: skip
    assert np.isfinite(rows["square"].smallest)


def test_a_plan_as_json():
    result = plan(line(sd=0.1), [SQUARE, CUBE], [proposed(RAMP)])
    found = result.as_dict()
    assert found["after"] == pytest.approx(result.after)
    assert found["records"][0]["record"] == "ramp"
    assert {e["cause"] for e in found["effects"]} == {v.cause for v in result.effects}
