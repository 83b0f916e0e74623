"""Rules decide differently on the two sides of their thresholds."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit import Candidate, Effect
from feltmb.fit.linear import LinearModel
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, finish, fit_problem
from feltmb.gap import diagnose
from feltmb.gap.acceptance import _Attempt, posterior
from feltmb.gap.checks import _estimate, _fine, _grid, check_records
from feltmb.gap.components import _likeness
from feltmb.gap.confusion import confused_groups
from feltmb.gap.decide import _moved
from feltmb.gap.discrepancy import Discrepancy, _memory, converged
from feltmb.gap.evidence import full_evidence
from feltmb.gap.further_sensors import FurtherSensor, offered
from feltmb.gap.misfit import form_of
from feltmb.gap.outliers import outliers
from feltmb.gap.overlay import _hints
from feltmb.gap.refine import CandidateSet, refit
from feltmb.gap.score import prior_of
from feltmb.gap.search import search
from feltmb.gap.smooth import smooth_discrepancy
from feltmb.gap.tare import forces_before_motion
from feltmb.gap.where import first_act
from feltmb.gap.withholding import Withheld, WithheldCase

sys.path.insert(0, str(Path(__file__).parent))
import models

#: A model whose output is zero.
NOTHING = LinearModel(output="y", columns={}, parameters=[], name="nothing")


@pytest.mark.parametrize(("second", "one_clock"), [(4.6e-3, True), (6.5e-3, False)])
def test_delays_that_are_nearly_equal_are_one_delay_of_the_clock(second, one_clock):
    rows = [
        SimpleNamespace(record="a", channel=c, delay=d, factor=np.nan, unit="m")
        for c, d in (("p", 4e-3), ("q", second))
    ]
    told = _hints(rows)
    assert any("every channel is about 4.3 ms late" in text for text in told) is one_clock
    assert len(told) <= 1


def test_an_error_of_form_leaves_a_tenth_of_its_amplitude():
    # The gain is a square: 3 % of the force of an effect that gains 1e6 units leave 9 units.
    assert form_of(1e6, 0.03) == pytest.approx(9.0)


@pytest.mark.parametrize(("rest", "done"), [(0.8, False), (0.9, True), (1.2, True)])
def test_a_residual_that_hardly_decreases_has_converged(rest, done):
    old, new = ({"q": Discrepancy(s, 0.01, s)} for s in (1.0, rest))
    assert converged(old, new) is done


@pytest.mark.parametrize(("pole", "white"), [(0.1, True), (0.35, False)])
def test_a_weakly_correlated_residual_counts_as_white(pole, white):
    draws = np.random.default_rng(3).normal(size=20_000)
    values = np.zeros_like(draws)
    for i in range(1, draws.size):
        values[i] = pole * values[i - 1] + draws[i]
    assert (_memory([values]) == 0.0) is white


def test_the_steps_of_a_fine_sensor_are_a_fifth_of_its_variance_at_most():
    edge = np.sqrt(12.0 * 0.2)
    assert _fine(0.95 * edge, 1.0)
    assert not _fine(1.05 * edge, 1.0)


@pytest.mark.parametrize(
    ("off", "between", "step"),
    [(0.002, 0.0, 0.5), (0.05, 0.0, 0.0), (0.0, 0.03, 0.5), (0.0, 0.2, 0.0)],
)
def test_a_grid_of_values(off, between, step):
    """``off``: error of all steps; ``between``: share of the steps that end between two lines."""
    generator = np.random.default_rng(1)
    steps = generator.choice([1.0, 2.0], size=400)
    steps[:: round(2.0 / between) if between else 401][: round(between * 200)] = 1.4
    steps = 0.5 * (steps + off * generator.uniform(0.0, 1.0, size=400))
    found = _grid(np.cumsum(steps), 100.0)
    assert found == pytest.approx(step, rel=0.01) if step else found == 0.0


@pytest.mark.parametrize(("quantum", "clipped"), [(0.002, True), (0.1, False)])
def test_values_at_the_end_of_a_coarse_range_are_not_clipped(quantum, clipped):
    """A coarse digitizer repeats its largest value at each maximum."""
    time = np.linspace(0.0, 10.0, 2001)
    value = np.minimum(np.sin(2.0 * time), 0.9 if clipped else 2.0)
    value = quantum * np.round(value / quantum)
    record = Record(
        name="a",
        time=time,
        inputs={},
        outputs={"q": value},
        sensors={"q": Sensor(name="q", unit="m", sigma=1e-3, quantum=quantum)},
    )
    (found,) = check_records([record]).channels
    assert (found.clipped > 0.02) is clipped


def spikes(values):
    record = Record(
        name="r", time=np.arange(values.size, dtype=float), inputs={}, outputs={"y": values}
    )
    return sum(own.count for own in outliers(record))


@pytest.mark.parametrize(
    ("height", "after", "near", "wide", "told"),
    [
        (15.5, 0.0, 0.0, 0.0, 1),
        (14.5, 0.0, 0.0, 0.0, 0),  # less than 15 times the scatter
        (22.0, 3.0, 0.0, 0.0, 1),
        (22.0, 4.0, 0.0, 0.0, 0),  # the neighbors differ by more than a fifth: a step
        (16.5, 0.0, 0.05, 0.0, 1),
        (16.5, 0.0, 0.15, 0.0, 0),  # more scatter near it: a vibration
        (16.0, 0.0, 0.0, 150.0, 1),
        (16.0, 0.0, 0.0, 175.0, 0),  # less than a tenth of the range
    ],
)
def test_a_spike_is_far_from_both_neighbors(height, after, near, wide, told):
    """Each sample is 1 from the mean of its neighbors."""
    values = np.tile([0.0, 1.0], 3000)
    assert spikes(values) == 0
    values[[3001, 3002, 3004]] = height, after, -near
    assert spikes(values + np.linspace(0.0, wide, values.size)) == told


def test_more_than_a_hundredth_of_the_samples_are_no_spikes():
    noise = np.random.default_rng(1).normal(size=2000)
    at = np.arange(50, 1950, 90)
    assert spikes(np.where(np.isin(np.arange(2000), at[:20]), 100.0, noise)) == 20
    assert spikes(np.where(np.isin(np.arange(2000), at), 100.0, noise)) == 0


@pytest.mark.parametrize(("low", "certain"), [(-1900.0, True), (-2100.0, False)])
def test_a_certain_code_is_far_outside(low, certain):
    values = np.random.default_rng(1).uniform(low, 0.0, 2000)
    values[7] = 9999.0
    own = Record(name="r", time=np.arange(2000.0), inputs={}, outputs={"y": values})
    (found,) = outliers(own)
    assert found.certain is certain


@pytest.mark.parametrize(
    ("level", "still", "told"),
    [
        (0.12, 40, True),
        (0.08, 40, False),  # a fiftieth of the largest change
        (-0.12, 40, True),
        (0.12, 5, False),  # it does not rest
        (0.12, 500, False),  # nothing moves
    ],
)
def test_a_force_before_the_motion(level, still, told):
    generator = np.random.default_rng(1)
    moves = np.maximum(0.0, np.arange(500.0) - still) / 400.0
    pressed = 5.0 * np.minimum(1.0, moves * 20.0)
    record = Record(
        name="r",
        time=np.arange(500.0),
        inputs={"force": level + pressed + generator.normal(0.0, 1e-3, 500)},
        outputs={"x": moves + generator.normal(0.0, 1e-3, 500)},
    )
    found = forces_before_motion([record])
    assert bool(found) is told
    if told:
        assert f"r.force is {level:.3g} N before the motion" in found[0]
        assert "--origin force=start" in found[0]


@pytest.mark.parametrize(("loud", "method"), [(1.5, "differences"), (4.0, "rest")])
def test_noise_is_that_of_the_rest_if_the_other_parts_have_much_more(loud, method):
    generator = np.random.default_rng(5)
    size = np.where(np.arange(4800) < 1200, 1.0, loud)
    _, found, _ = _estimate(size * generator.normal(size=4800), 1.0)
    assert found == method


def test_a_fitted_shape_costs_three_units():
    effect = Effect(
        name="drag",
        component="c",
        unit="N",
        scale=1.0,
        shapes=(1.0, 2.0),
        rate=lambda t, x, u, p, size, shape: {"v": size * shape},
    )
    listed, fitted = (prior_of([Candidate(effect, s)], 1.0) for s in (2.0, 1.3))
    assert fitted - listed == pytest.approx(-3.0)


def test_the_prior_probabilities_are_a_half_a_tenth_and_four_tenths():
    """Records of noise: neither an unknown signal nor the effect is probable, but both possible."""
    x = np.linspace(-1.0, 1.0, 101)
    record = Record(
        name="run",
        time=0.01 * np.arange(101),
        inputs={"x": x},
        outputs={"y": x + 0.01 * np.random.default_rng(1).standard_normal(101)},
        sensors={"y": Sensor(name="y", sigma=0.01)},
    )
    line = models.line(0.2)
    segmented = segment_record(line, record, {"y": Noise(0.01)}, None, np.array([[0, 100]]))
    found = search(fit_problem(Problem(line, (segmented,))), [], FitSettings())
    even = Effect(name="even", component="c", scale=0.5, regressor=lambda r, s: x**2)
    fit = refit(found.model_fit, (Candidate(even),), np.array([0.1]), FitSettings())
    one = CandidateSet(fit, full_evidence(fit, 1.0))
    belief = posterior(replace(found, sets=(one,)), FitSettings())
    signal, beside = (np.exp(smooth_discrepancy(f).mean) for f in (found.model_fit, fit))
    assert max(signal, beside) < 1.0
    assert belief.inflation == 1.0
    assert belief.other / belief.none == pytest.approx(0.1 / 0.5 * signal)
    ratio = np.exp(one.evidence - found.tight_evidence)
    # An unknown signal may also be beside the effect.
    own = 0.4 / 0.5 * ratio * (1.0 + 0.1 / 0.5 * beside)
    assert belief.sets[0] / belief.none == pytest.approx(own)


@pytest.mark.parametrize(("behind", "rival"), [(2.9, True), (3.1, False)])
@pytest.mark.parametrize("later", [False, True], ids=["fitted records", "held-out records"])
def test_a_rival_is_behind_by_odds_of_twenty_at_most(behind, rival, later):
    """``later``: only held-out records, which the best set explains, prefer it."""
    best, other = (SimpleNamespace(key=n, names=(n,), fit=n, evidence=0.0) for n in "ab")
    lost = 2.0 * behind  # an inflation of 2
    other.evidence = 0.0 if later else -lost
    attempt = SimpleNamespace(
        search=SimpleNamespace(sets=[best, other]),
        inflation=2.0,
        outcome=lambda fit: SimpleNamespace(explains=later),
        _contradicted=lambda outcome: False,
        _total=lambda c: -behind if later and c is other else 0.0,
    )
    assert bool(_Attempt.rivals(attempt, best)) is rival


@pytest.mark.parametrize(
    ("speed", "noise", "expected"),
    [
        (0.0, 2.0, "most like the position (2"),  # a fifth of the variance
        (0.0, 3.0, "no simple form"),  # a tenth
        (0.9, 0.1, " or the speed (4"),
        (0.7, 0.1, "most like the position (6"),
    ],
)
def test_the_form_of_a_force(speed, noise, expected):
    time = np.linspace(0.0, 20.0 * np.pi, 4000)
    q, v = np.sqrt(2.0) * np.sin(time), np.sqrt(2.0) * np.cos(time)
    force = q + speed * v + noise * np.random.default_rng(1).standard_normal(time.size)
    found = _likeness(np.column_stack([force, np.full(time.size, 0.1), q, v]))
    assert expected in found
    assert (" or " in found) is (speed == 0.9)


def moved(*shares, beyond=()):
    """Sentences about parameters a, b, ... with these shares of the gap."""
    rows = [
        SimpleNamespace(
            text=f"{name} moved", notes="", share=s, sure=True, beyond=name in beyond,
            prior_deviations=5.0,
        )
        for name, s in zip("abcdef", shares, strict=False)
    ]  # fmt: skip
    return _moved(SimpleNamespace(calibrated=rows, apart=True))


def test_only_parameters_that_explain_a_tenth_of_the_gap_are_listed():
    said = moved(0.6, 0.11, 0.09, 0.01)
    assert said == "a moved; b moved. 2 more parameters moved, by less of the gap."
    # What exceeds its tolerance is always listed.
    said = moved(0.6, 0.09, 0.01, beyond="c")
    assert said == "c moved; a moved. 1 more parameter moved."


@pytest.mark.parametrize(("deviations", "told"), [(1.8, False), (2.2, True)])
def test_a_parameter_has_changed_from_two_standard_deviations(deviations, told):
    line = models.line(10.0)
    x = np.sin(np.linspace(0.0, 40.0, 400))
    sd = 0.01 / np.sqrt(2.0 * x @ x)
    records = []
    for k, role in enumerate(("fit", "fit", "held_out")):
        noise = 0.01 * np.random.default_rng(k).standard_normal(x.size)
        noise -= x * (x @ noise) / (x @ x)  # without influence on the slope
        record = Record(
            name=f"run {k}",
            time=0.01 * np.arange(x.size),
            inputs={"x": x},
            outputs={"y": (1.0 + deviations * sd) * x + noise},
            sensors={"y": Sensor(name="y", sigma=0.01)},
            role=role,
        )
        records.append(record)
    assert bool(diagnose(line, [], records).calibrated) is told


@pytest.mark.parametrize(("chance", "groups"), [(0.09, ()), (0.11, (("a", "b"),))])
def test_effects_that_a_tenth_of_the_records_confuse_are_one_class(chance, groups):
    assert confused_groups(["a", "b"], np.array([[0.0, chance], [chance, 0.0]])) == groups


@pytest.mark.parametrize(("signal", "counted"), [(4.9, 0), (5.1, 1)])
def test_only_effects_that_stand_out_are_scored(signal, counted):
    case = WithheldCase(
        number=1, effect="drag", magnitude=1.0, unit="N", signal_to_noise=signal, outcome="right",
        verdict="NAMED", named=("drag",), one_of=(), first="drag", confidence=0.99, seconds=1.0,
    )  # fmt: skip
    assert Withheld(cases=(case,)).share("right")[-1] == counted


def test_a_better_sensor_has_a_third_of_the_noise():
    now = {"y": Sensor(name="y", unit="m", sigma=3e-5)}
    (offer,) = offered([FurtherSensor(output="y")], now, NOTHING)
    assert offer.sigma == pytest.approx(1e-5)


def test_an_effect_is_visible_from_a_tenth_of_its_largest_change():
    ramp = np.linspace(0.0, 1.0, 101)
    growing = Effect(name="growing", component="spring", regressor=lambda r, s: ramp)
    record = Record(
        name="run",
        time=0.01 * np.arange(101),
        inputs={},
        outputs={"y": 1.0 * ramp},
        sensors={"y": Sensor(name="y", sigma=0.01)},
    )
    segmented = segment_record(NOTHING, record, {"y": Noise(0.01)}, None)
    problem = Problem(NOTHING, (segmented,)).with_candidates((Candidate(growing),))
    fit = finish(problem, problem.start(np.array([1.0])), 1.0, np.zeros(0))
    assert first_act(fit)["run"] == pytest.approx(0.11)
