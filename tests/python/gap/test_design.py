"""Designed experiments against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from feltmb.gap.designs import _words
from feltmb.gap.information import Knowledge, information
from feltmb.gap.profiles import FAMILIES, Profile
from feltmb.gap.visibility import helpful_parts

from feltmb.adapters.resolve import resolve
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import (
    Belief,
    Effect,
    InputLimits,
    Limits,
    LinearModel,
    Measured,
    Parameter,
    PartTest,
    Record,
    Sensor,
    design,
    draw_experiment,
    measured_toml,
    read_limits,
    read_measured,
    with_measured,
)
from feltmb.gap.score import all_candidates

SENSORS = {"y": Sensor(name="y", sigma=1.0)}
SAMPLES = 2000


def line(sd=np.inf, columns=None):
    model = LinearModel(
        output="y",
        columns=columns or {"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name=n, value=1.0, sd=sd) for n in columns or ("slope",)],
    )
    model.inputs = ("u",)
    return model


def effect(name, column, scale=1.0):
    return Effect(
        name=name, component="c", scale=scale, regressor=lambda r, s: column(r.inputs["u"])
    )


def limits(least=0.0, most=1.0, **more):
    own = InputLimits(least=least, most=most)
    return Limits(inputs={"u": own}, duration=1.0, sample_rate=float(SAMPLES), lead=0.0, **more)


SQUARE = effect("square", lambda u: u**2)


def test_best_profile_is_the_t_optimal_design():
    """Line through the origin against a parabola on [0, 1]: sqrt(2) - 1 and 1, weights 1 / level.

    The closed form is the extremum of w (1 - w) x^2 (1 - x)^2 / (w x^2 + 1 - w).
    """
    found = design(
        line(), [SQUARE], limits=limits(), sensors=SENSORS, budget=1, aim="sizes",
        candidates=30, refinements=400,
    )  # fmt: skip
    x = np.sqrt(2.0) - 1.0
    w = 1.0 / (1.0 + x)
    best = SAMPLES * w * (1.0 - w) * x**2 * (1.0 - x) ** 2 / (w * x**2 + 1.0 - w)
    (one,) = found.experiments
    reached = np.exp(2.0 * one.after) - 1.0  # 1/2 log(1 + G), one effect
    assert reached == pytest.approx(best, rel=0.01)
    assert reached <= best * (1.0 + 2e-3)  # nothing is better than the best: 2001 samples
    assert one.profile.family == "two steps"
    levels = sorted([one.profile.numbers["level"], one.profile.numbers["then"]])
    assert levels == pytest.approx([x, 1.0], abs=0.02)


def test_best_profile_is_the_d_optimal_design():
    """Offset and slope on [-1, 1]: half of the samples at each end; det = n^2."""
    flat, slope = effect("flat", np.ones_like), effect("slope", lambda u: u)
    found = design(
        line(columns={"cube": lambda r: 0.0 * r.inputs["u"]}), [flat, slope],
        limits=limits(least=-1.0), sensors=SENSORS, budget=1, aim="sizes",
        candidates=30, refinements=400,
    )  # fmt: skip
    n = SAMPLES + 1
    assert found.experiments[0].after == pytest.approx(np.log(1.0 + n), rel=0.01)
    assert found.experiments[0].after <= np.log(1.0 + n) + 1e-9


def test_budget_is_spent_as_every_exchange_confirms():
    """No set of as many experiments from the same candidates tells more than the greedy one."""
    import itertools

    cube = effect("cube", lambda u: u**3)
    model, box = line(sd=1.0), limits()
    found = design(
        model, [SQUARE, cube], limits=box, sensors=SENSORS, budget=2, aim="sizes",
        candidates=8, refinements=0,
    )  # fmt: skip
    every = all_candidates([SQUARE, cube])
    start = Knowledge.start(model, every, Belief.even(every))
    from feltmb.gap.designs import _Work
    from feltmb.gap.further_sensors import Sensors

    work = _Work(model, box, Sensors(SENSORS), 0, every=every)
    options = work.options(list(FAMILIES), 8)
    best = max(
        start.plus(a.information).plus(b.information).sizes()
        for a, b in itertools.combinations_with_replacement(options, 2)
    )
    assert found.after == pytest.approx(best, rel=0.01)
    assert len(found.experiments) == 2


def test_expected_evidence_is_what_records_then_give():
    """Mean log evidence over noise, of the true effect against its rival, as predicted."""
    cube = effect("cube", lambda u: u**3)
    model = line(sd=0.5)
    every = all_candidates([SQUARE, cube])
    time = np.arange(400) / 400.0
    u = 0.5 + 0.5 * np.sin(7.0 * time)
    bare = Record(
        name="one", time=time, inputs={"u": u}, outputs={"y": np.zeros(400)},
        sensors={"y": Sensor(name="y", sigma=0.05)},
    )  # fmt: skip
    one = information(model, bare, every)
    start = Knowledge.start(model, every, Belief.even(every)).plus(one)
    expected = start.evidence()[0]
    generator = np.random.default_rng(3)
    prior, noise = 0.5**2 * np.outer(u, u), 0.05**2 * np.eye(400)
    known = np.linalg.inv(noise + prior)
    free = np.linalg.inv(noise + prior + np.outer(u**3, u**3))  # rival, its size N(0, 1)
    gains = []
    for _ in range(300):
        y = u * generator.normal(0.0, 0.5) + u**2 + 0.05 * generator.standard_normal(400)
        rest = y - u**2
        true = rest @ known @ rest
        gains.append([0.5 * (y @ free @ y - true), 0.5 * (y @ known @ y - true)])
    assert np.mean(gains, axis=0) == pytest.approx([expected[1], expected[2]], rel=0.05)


def test_twins_are_told_to_be_inseparable():
    alike = effect("alike", lambda u: -2.0 * u**2)
    cube = effect("cube", lambda u: u**3 - u)
    found = design(
        line(), [SQUARE, alike, cube], limits=limits(least=-1.0), sensors=SENSORS, budget=3,
        refinements=0,
    )  # fmt: skip
    assert found.inseparable == (("alike", "square"),)
    rows = {v.effect: v for v in found.effects}
    assert rows["square"].rival == "alike"
    assert rows["square"].right < 0.6 < rows["square"].pair
    assert rows["cube"].right > 0.95


ALIKE = effect("alike", lambda u: -2.0 * u**2, scale=0.5)


def alike_effects(parts=()):
    cube = effect("cube", lambda u: u**3 - u)
    return design(
        line(), [SQUARE, ALIKE, cube], limits=limits(least=-1.0, parts=parts), sensors=SENSORS,
        budget=3, refinements=0,
    )  # fmt: skip


def test_a_test_of_one_part_separates_equal_effects():
    """The plan gives the standard deviation; one percent more is not enough."""
    found = alike_effects()
    known = {t.effect: t.known_to for t in found.decisive}
    assert known == pytest.approx({"square": 0.390, "alike": 0.195}, rel=2e-3)  # scale / 2.563
    assert known["alike"] == pytest.approx(0.5 * known["square"], rel=1e-6)
    assert found.decisive[1].text == "square to 39.0%"
    enough, poor = (
        PartTest(parameter="alike", sd=f * known["alike"], cost=0.1) for f in (0.99, 1.01)
    )
    assert alike_effects([enough]).inseparable == ()
    assert alike_effects([enough]).decisive == ()
    assert alike_effects([poor]).inseparable == (("alike", "square"),)
    bought = alike_effects([enough]).experiments
    assert [e.part for e in bought if e.kind == "part"] == [enough]
    assert any("separates alike from square" in r for e in bought for r in e.reasons)


def test_the_fitted_magnitude_decides_how_exact_a_test_must_be():
    belief = Belief(weights={"square": 0.5, "alike": 0.5}, magnitudes={"square": 2.0, "alike": 1.0})
    found = design(
        line(), [SQUARE, ALIKE], limits=limits(least=-1.0), sensors=SENSORS, budget=1,
        refinements=0, belief=belief,
    )  # fmt: skip
    assert [t.known_to for t in found.decisive] == pytest.approx([0.390, 0.780], rel=2e-3)


def test_a_test_of_an_effect_is_one_more_measured_value():
    """Its information is that of a record with the magnitude as its only output."""
    every = all_candidates([SQUARE, ALIKE])
    start = Knowledge.start(line(sd=1.0), every, Belief.even(every))
    then = start.plus(start.part("alike", 0.1)).evidence()
    assert then[1, 2] == pytest.approx(0.5 * (0.5 / 0.1) ** 2)
    assert then[0] == pytest.approx(0.0)
    assert start.plus(start.part("slope", 0.1)).matrix[0, 0] == pytest.approx(1.0 + 100.0)


def test_the_test_of_a_parameter_measures_what_changes_the_same_number():
    """The variance of its tolerance is added to that of the test: 0.06^2 + 0.08^2 = 0.1^2."""
    steeper = effect("steeper", lambda u: u, scale=0.5)
    every = all_candidates([replace(steeper, tolerance_parameter="slope"), ALIKE])
    percent = replace(steeper, scale=50.0, tolerance_parameter="slope", tolerance_ratio=-0.01)
    scaled = Knowledge.start(
        line(sd=0.08), all_candidates([percent]), Belief.even(all_candidates([percent]))
    )
    assert scaled.plus(scaled.part("slope", 0.06)).evidence()[0, 1] == pytest.approx(12.5)
    start = Knowledge.start(line(sd=0.08), every, Belief.even(every))
    then = start.plus(start.part("slope", 0.06)).evidence()
    assert then[0, 2] == pytest.approx(0.5 * (0.5 / 0.1) ** 2)
    assert then[1, 2] == pytest.approx(0.0, abs=1e-9)
    both = [replace(steeper, tolerance_parameter="slope"), replace(steeper, name="look-alike")]
    found = design(line(sd=0.08), both, limits=limits(), sensors=SENSORS, budget=1, refinements=0)
    assert [(t.effect, t.measured) for t in found.decisive] == [
        ("look-alike", "look-alike"), ("steeper", "slope"),
    ]  # fmt: skip
    for test in found.decisive:
        for factor, groups in ((0.99, ()), (1.01, found.inseparable)):
            part = PartTest(parameter=test.measured, sd=factor * test.known_to, cost=0.1)
            then = design(
                line(sd=0.08), both, limits=limits(parts=(part,)), sensors=SENSORS, budget=1,
                refinements=0,
            )  # fmt: skip
            assert then.inseparable == groups
    same = [both[0], replace(both[0], name="steeper too")]
    found = design(line(sd=0.08), same, limits=limits(), sensors=SENSORS, budget=1, refinements=0)
    assert found.inseparable == (("steeper", "steeper too"),)
    assert found.decisive == ()  # both are the slope
    uneven = Belief(
        weights={"steeper": 0.5, "steeper too": 0.2, "look-alike": 0.3},
        magnitudes={"steeper": 0.5, "steeper too": 0.35, "look-alike": 0.5},
    )
    found = design(
        line(sd=0.08), [*same, both[1]], limits=limits(), sensors=SENSORS, budget=1,
        refinements=0, belief=uneven,
    )  # fmt: skip
    assert [t.measured for t in found.decisive if t.measured == "slope"] == []


def test_a_plan_after_a_test_keeps_the_promise_of_the_plan_before_it():
    """A test of the slope separates a steeper line from its look-alike."""
    steeper = effect("steeper", lambda u: u, scale=0.5)
    both = [replace(steeper, tolerance_parameter="slope"), replace(steeper, name="look-alike")]
    test = PartTest(parameter="slope", sd=0.06, cost=0.1)

    def planned(model, parts=()):
        return design(
            model, both, limits=limits(parts=parts), sensors=SENSORS, budget=1, refinements=0
        )

    assert planned(line(sd=0.08)).inseparable == (("look-alike", "steeper"),)
    assert planned(line(sd=0.08), [test]).inseparable == ()
    after = planned(with_measured(line(sd=0.08), [Measured(parameter="slope", value=1.0, sd=0.06)]))
    assert after.inseparable == ()
    assert [v.effect for v in after.effects] == ["look-alike"]


@pytest.mark.parametrize("same_number", [False, True])
def test_the_promise_of_a_test_of_a_part_is_kept(same_number):
    """The smallest detectable magnitude is what the plan computes with this test."""
    hidden = effect("hidden", lambda u: 2.0 * u + 1e-2 * u**2, scale=0.5)
    if same_number:
        hidden = replace(hidden, tolerance_parameter="slope", tolerance_ratio=2.0)
    every = all_candidates([hidden])
    time = np.arange(400) / 400.0
    bare = Record(
        name="one", time=time, inputs={"u": np.sin(7.0 * time)}, outputs={"y": np.zeros(400)},
        sensors={"y": Sensor(name="y", sigma=1.0)},
    )  # fmt: skip
    model = line(sd=0.3)
    start = Knowledge.start(model, every, Belief.even(every), [information(model, bare, every)])
    promised = helpful_parts(start)
    if same_number:  # the records know the sum of both, which the test measures again
        assert promised == ()
        again = start.plus(start.part("slope", 1e-3)).smallest()[0]
        assert again == pytest.approx(start.smallest()[0], rel=0.05)
        return
    (part,) = promised
    assert part.parameter == "slope"
    then = start.plus(start.part("slope", part.known_to))
    assert then.smallest()[0] == pytest.approx(part.smallest, rel=1e-9)
    assert part.smallest < 0.9 * start.smallest()[0]


def test_effects_of_sensors_have_no_test_of_a_part():
    shift = Effect(name="shift", component="camera", scale=1.0, observe=lambda _t, y, *_: y + 1.0)
    no_part = limits(parts=(PartTest(parameter="shift", sd=0.1),))
    no_part.check(line(), [replace(SQUARE, name="shift")])
    with pytest.raises(InvalidParameter, match="part shift: an effect of the records and not"):
        no_part.check(line(), [shift])


def test_belief_decides_what_is_worth_an_experiment():
    """A pair that is left wants another profile than the size of a third effect."""
    low = effect("low", lambda u: np.where(u < 0.3, u, 0.3))
    low_too = effect("low too", lambda u: np.where(u < 0.2, u, 0.2))
    found = design(
        line(), [low, low_too, SQUARE], limits=limits(), budget=1, refinements=0,
        sensors={"y": Sensor(name="y", sigma=0.3)},
        belief=Belief(
            weights={"low": 0.5, "low too": 0.5}, magnitudes={"low": 1.0, "low too": 1.0}
        ),
    )  # fmt: skip
    text = " ".join(found.experiments[0].reasons)
    assert "low" in text
    assert "low too" in text
    assert found.after > found.before


def test_test_of_a_part_is_bought_where_it_tells_more():
    """An effect that a tolerance imitates shows once the part is measured, and only then."""
    slope = effect("slope too", lambda u: u, scale=0.1)
    model = line(sd=1.0)
    part = PartTest(parameter="slope", sd=0.001, cost=1.0, how="weighing")
    without = design(model, [slope], limits=limits(), sensors=SENSORS, budget=2, refinements=0)
    assert without.parts[0].parameter == "slope"
    assert "slope known to 10.0%: slope too is detectable from" in without.parts[0].text
    found = design(
        model, [slope], limits=limits(parts=(part,)), sensors=SENSORS, budget=2, refinements=0
    )
    assert [e.kind for e in found.experiments].count("part") == 1
    bought = with_measured(model, [Measured(parameter="slope", value=1.0, sd=0.1)])
    shown = design(bought, [slope], limits=limits(), sensors=SENSORS, budget=2, refinements=0)
    assert shown.effects[0].smallest == pytest.approx(without.parts[0].smallest, rel=0.05)


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


def test_what_was_worked_out_of_a_mechanism_is_kept(tmp_path):
    settings = {"effects": "coulomb_friction.butt,felt_hardening.06", "tolerances": "felt.0*"}
    model, effects = resolve("steinway45", {**settings, "variation": "none"})
    own = InputLimits(most=25.0, rate=2000.0, unit="N")
    box = Limits(inputs={"force": own}, duration=0.15)
    given = {"limits": box, "budget": 2, "refinements": 0, "candidates": 1, "folder": tmp_path}
    given["families"] = ["pulse"]
    first = design(model, effects, **given)
    again = design(model, effects, **given)
    assert first.worked_out == 1
    assert again.worked_out == 0
    assert again.after == first.after
    other = design(model, [replace(effects[0], scale=2.0 * effects[0].scale)], **given)
    assert other.worked_out == 1


def test_functions_are_not_kept(tmp_path):
    """A user changes a function, and nothing of the old one may come back."""
    given = {"limits": limits(), "sensors": SENSORS, "budget": 1, "refinements": 0}
    first = design(line(), [SQUARE], folder=tmp_path, **given)
    wider = replace(SQUARE, regressor=lambda r, s: 2.0 * r.inputs["u"] ** 2)
    other = design(line(), [wider], folder=tmp_path, **given)
    assert other.worked_out == first.worked_out > 0
    assert other.effects[0].smallest == pytest.approx(0.5 * first.effects[0].smallest)


def test_records_are_counted():
    """With data the plan begins where they end, and believes what they say."""
    time = np.arange(300) / 300.0
    u = np.linspace(0.0, 1.0, 300)
    y = u + u**2 + 0.05 * np.random.default_rng(1).standard_normal(300)
    r = Record(name="a", time=time, inputs={"u": u}, outputs={"y": y},
               sensors={"y": Sensor(name="y", sigma=0.05)})  # fmt: skip
    wave = effect("wave", lambda u: np.sin(20.0 * u))
    found = design(line(sd=0.1), [SQUARE, wave], [r], limits=limits(), refinements=0)
    assert found.belief["square"] > 0.9
    assert found.before > 0.5


def test_drawn_experiments_are_allowed_and_repeatable():
    one = draw_experiment(line(), limits(), sensors=SENSORS, seed=4)
    same = draw_experiment(line(), limits(), sensors=SENSORS, seed=4)
    other = draw_experiment(line(), limits(), sensors=SENSORS, seed=5)
    assert one[1] == same[1] != other[1]
    assert one[2].inputs["u"].max() <= 1.0 + 1e-9
    some = [
        draw_experiment(line(), limits(), families=["chirp", "pulse"], seed=i)[1] for i in range(8)
    ]
    assert {p.family for p in some} == {"chirp", "pulse"}
    with pytest.raises(InvalidParameter, match="families: knock is none of step"):
        draw_experiment(line(), limits(), families=["knock"])


LIMITS = """
schema = 1
duration = "0.5 s"
[inputs.u]
unit = "N"
most = "20 N"
rate = "2 kN/s"
[[parts]]
parameter = "slope"
sd = "2 %"
[sensors.y]
sigma = 0.1
"""


def test_limits_are_read(tmp_path):
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS)
    found = read_limits(path, line())
    assert found.inputs["u"].most == 20.0
    assert found.inputs["u"].rate == pytest.approx(2000.0)
    assert found.parts[0].sd == pytest.approx(0.02)
    assert found.sensors == {"y": 0.1}


def test_limits_may_test_effects(tmp_path):
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS.replace('"slope"\nsd = "2 %"', '"gap"\nsd = "0.1 mm"\ncost = 0.5'))
    gap = replace(SQUARE, name="gap", unit="m")
    found = read_limits(path, line(), [gap])
    assert (found.parts[0].parameter, found.parts[0].sd) == ("gap", pytest.approx(1e-4))
    with pytest.raises(DataError, match="part gap: no parameter"):
        read_limits(path, line())
    with pytest.raises(DataError, match="part gap: it changes the same number as slope"):
        read_limits(path, line(), [replace(gap, tolerance_parameter="slope")])
    path.write_text(path.read_text().replace("0.1 mm", "0.1 N"))
    with pytest.raises(DataError, match=r"parts\.0\.sd"):
        read_limits(path, line(), [gap])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('most = "20 N"', 'most = "20 mm"', "inputs.u.most"),
        ('most = "20 N"', "most = -1", "least < most"),
        ('most = "20 N"', "most = true", "inputs.u.most: "),
        ("[inputs.u]", "[inputs.v]", "input v: no input"),
        ('"slope"', '"slop"', "part slop: no parameter"),
        ("[sensors.y]", "[sensors.z]", "sensor z: no output"),
        ('duration = "0.5 s"', "", "duration: is missing"),
        ("most =", "moste =", "moste"),
        ('"0.5 s"', '"1 us"', "samples"),
        ('[inputs.u]\nunit = "N"\nmost = "20 N"\nrate = "2 kN/s"', "[inputs]", "inputs is empty"),
    ],
)
def test_faults_of_limits_are_told(tmp_path, old, new, told):
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS.replace(old, new))
    with pytest.raises((DataError, InvalidParameter), match=told):
        read_limits(path, line())


def test_names_of_limits_are_checked_first_and_all_faults_told_at_once(tmp_path):
    """The unit of an entry whose name is wrong is not known: of it the name is told alone."""
    path = tmp_path / "limits.toml"
    path.write_text(
        """
schema = 1
duration = "1 us"
[inputs.v]
most = "20 N"
[inputs.u]
unit = "N"
most = "20 mm"
[[parts]]
parameter = "slop"
sd = "2 kg"
[[parts]]
parameter = "slope"
sd = 0
[sensors.z]
sigma = "1 N"
[sensors.y]
sigma = 0
"""
    )
    with pytest.raises(DataError, match="6 faults") as failure:
        read_limits(path, line())
    lines = str(failure.value).splitlines()[1:]
    for k, text in enumerate(("part slop: no", "sensor z: no", "input v: no", "inputs.u.most: ")):
        assert lines[k].strip().startswith(text), lines
    assert "parts.1: test of slope: sd = 0" in lines[4]
    assert "sensor y: sigma = 0" in "".join(lines)
    assert "parts.0" not in str(failure.value)


def test_keys_and_numbers_of_limits_are_told_together(tmp_path):
    """A wrong key hid the faults of all numbers, in the entry and in others."""
    path = tmp_path / "limits.toml"
    path.write_text(
        """
schema = 1
duration = "0.5 s"
lead = "1 s"
[inputs.v]
most = 1
[inputs.u]
unit = "N"
moste = "20 N"
rate = "2 m/s"
[[parts]]
parameter = "slope"
sd = "2 kg"
cost = -1
[[parts]]
parameter = "slope"
sd = 0
[sensors.y]
sigma = -1
"""
    )
    with pytest.raises(DataError, match="8 faults") as failure:
        read_limits(path, line())
    lines = [text.strip() for text in str(failure.value).splitlines()[1:]]
    starts = (
        "input v: no input",
        "inputs.u.most: is missing",
        "inputs.u.moste: unknown key",
        "parts.0.cost: got -1",
        "inputs.u.rate: ",
        "parts.0.sd: ",
        "parts.1: test of slope: sd = 0",
        "limits: lead = 1 s",
    )
    assert [t.startswith(s) for t, s in zip(lines, starts, strict=False)] == [True] * 8, lines
    assert "sensor y: sigma = -1" in "".join(lines)


def test_measured_parts_replace_the_tolerance(tmp_path):
    one = Measured(parameter="slope", value=1.1, sd=0.02, how="weighing")
    path = measured_toml([one], tmp_path / "measured.toml")
    (back,) = read_measured(path, line())
    assert back == one
    model = with_measured(line(), [back, back])
    assert model.parameters[0].value == pytest.approx(1.1)
    assert model.parameters[0].sd == pytest.approx(0.02 / np.sqrt(2.0))
    with pytest.raises(InvalidParameter, match="mass: no parameter"):
        with_measured(line(), [Measured(parameter="mass", value=1.0, sd=0.1)])
    path.write_text("[measured.mass]\nvalue = 1.0\nsd = 0.1\n")
    with pytest.raises(DataError, match=r"measured\.mass: no parameter"):
        read_measured(path, line())


@pytest.mark.parametrize("sd", [1e-300, 1e-160, 1e-3, 1e160, 1e300])
def test_tests_of_any_precision_count_together(sd):
    """Their squares are out of range: it gave Python's OverflowError and ZeroDivisionError."""
    tests = [Measured(parameter="slope", value=v, sd=sd) for v in (1.0, 1.2)]
    model = with_measured(line(), tests)
    assert model.parameters[0].value == pytest.approx(1.1)
    assert model.parameters[0].sd == pytest.approx(sd / np.sqrt(2.0))
    # One that is far better decides.
    model = with_measured(line(), [tests[0], replace(tests[1], sd=1e-9 * sd)])
    assert model.parameters[0].value == pytest.approx(1.2)


def test_all_faults_of_measured_parts_are_told(tmp_path):
    path = tmp_path / "measured.toml"
    path.write_text('[measured.slope]\nvalue = "1 kg"\nsd = "x"\n[measured.mass]\nvalue=1\nsd=1\n')
    with pytest.raises(DataError, match="3 faults") as failure:
        read_measured(path, line())
    for text in ("measured.slope.value: ", "measured.slope.sd: ", "measured.mass: no parameter"):
        assert text in str(failure.value)


def test_bad_requests_are_refused():
    given = {"limits": limits(), "sensors": SENSORS}
    with pytest.raises(InvalidParameter, match="budget"):
        design(line(), [SQUARE], budget=0.0, **given)
    with pytest.raises(InvalidParameter, match="families: jump is none of"):
        design(line(), [SQUARE], families=["jump"], **given)
    with pytest.raises(InvalidParameter, match="sensors: z is no output"):
        design(line(), [SQUARE], limits=limits(), sensors={"z": Sensor(name="z")})
    with pytest.raises(InvalidParameter, match="can simulate none"):
        design(line(), [Effect(name="x", component="c")], **given)


def test_names_of_families_can_stand_in_a_list_with_commas():
    assert not any("," in name for name in FAMILIES)


def test_the_name_of_a_profile_has_seconds_from_one_second_upward():
    numbers = {"level": 3.0, "rise": 56.5, "hold": 0.02}
    profile = Profile(family="step", numbers=numbers, start=0.0, moves=(), end=80.0)
    assert _words(profile, "u", "N") == "step of u: 3 N, rise 56.5 s, hold 20 ms"


def heated():
    """A model whose quantities are none of mechanics."""
    model = line(sd=1.0)
    model.parameters = (Parameter(name="C", value=100.0, sd=10.0, unit="J/K"),)
    model.units = {"u": "W", "y": "K"}
    return model


def test_limits_and_tests_have_units_outside_mechanics(tmp_path):
    path = tmp_path / "limits.toml"
    text = """schema = 1
duration = "10 s"
[inputs.u]
most = "200 W"
rate = "5 W/s"
[sensors.y]
sigma = "0.1 K"
[[parts]]
parameter = "C"
sd = "2 J/K"
"""
    path.write_text(text)
    found = read_limits(path, heated())
    assert (found.inputs["u"].most, found.inputs["u"].rate) == (200.0, 5.0)
    assert found.sensors == {"y": 0.1}
    assert found.parts[0].sd == 2.0
    path.write_text(text.replace("200 W", "200 N").replace("0.1 K", "0.1 kK"))
    with pytest.raises(DataError) as error:
        read_limits(path, heated())
    assert (
        "inputs.u.most: got '200 N'; unit 'N' does not measure this quantity; expected a unit of W"
    ) in str(error.value)
    assert "sensors.y.sigma: got '0.1 kK'; unit 'kK': unknown unit" in str(error.value)
    path.write_text('[measured.C]\nvalue = "104 J/K"\nsd = "1 J/K"\n')
    assert read_measured(path, heated())[0].value == 104.0


def test_all_faults_of_tests_of_parts_are_told_at_once(tmp_path):
    path = tmp_path / "measured.toml"
    path.write_text('[measured.CC]\nvalue = 1\nsd = 0.1\n[measured.C]\nvalue = "x"\n')
    with pytest.raises(DataError, match="3 faults") as error:
        read_measured(path, heated())
    _, *faults = str(error.value).splitlines()
    starts = ("measured.CC: no parameter", "measured.C.sd: is missing", "measured.C.value: got 'x'")
    assert [f.strip().startswith(s) for f, s in zip(faults, starts, strict=True)] == [True] * 3
