"""Rules of the verdict by themselves, with sets and probabilities that are given."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace as Given

import numpy as np
import pytest
from scipy.stats import norm

from unmodeled import Effect
from unmodeled.search import verdict
from unmodeled.search.evidence import _one_sided
from unmodeled.search.held_out import Predicted, compare
from unmodeled.search.linear import Point
from unmodeled.search.problem import Cause, Member
from unmodeled.search.result import Channel, Verdict


def sets(*causes):
    return [Given(causes=c) for c in causes]


@pytest.mark.parametrize(
    ("causes", "weight", "told", "classes"),
    [
        ([(0,), ()], [0.91, 0.09], [0], []),
        ([(0,), ()], [0.9, 0.1], [0], []),
        ([(0,), ()], [0.89, 0.11], [], []),
        ([(0, 1), ()], [0.95, 0.05], [0, 1], []),
        ([(0,), (1,), ()], [0.5, 0.45, 0.05], [], [[0, 1]]),
        ([(1,), (0,), ()], [0.5, 0.45, 0.05], [], [[1, 0]]),
        ([(0, 1), (0, 2), (3,)], [0.5, 0.45, 0.05], [0], [[1, 2]]),
        ([(0, 1), (0,), ()], [0.6, 0.35, 0.05], [0], []),
        # Seven causes that share the probability are no answer, six are one.
        ([(k,) for k in range(7)], [1.0 / 7.0] * 7, [], []),
        ([(k,) for k in range(6)], [1.0 / 6.0] * 6, [], [[0, 1, 2, 3, 4, 5]]),
    ],
)
def test_the_fewest_causes_that_are_probable_together_are_told(causes, weight, told, classes):
    assert verdict._told(sets(*causes), np.array(weight), 0.9) == (told, classes)


def test_the_reported_set_agrees_with_what_is_told():
    some = sets((), (0,), (0, 1), (0, 2))
    assert verdict._representative(some, [0], [[2, 3]]).causes == (0, 2)
    assert verdict._representative(some, [], [[1, 2]]).causes == (0, 1)
    assert verdict._representative(some[1:], [], []).causes == (0,)
    assert verdict._representative([*some[1:], some[0]], [], []).causes == ()
    assert verdict._representative(some, [4], []).causes == ()  # none agrees: the most probable


def channel(tabulated, explained):
    return Channel("y", "m", 1e-3, 1.0, tabulated, explained, explained, np.nan, np.nan, 0.01)


@pytest.mark.parametrize(
    ("told", "classes", "supported", "left", "expected"),
    [
        ([0], [[1, 2]], [3], 1.0, Verdict.NAMED),
        ([], [[1, 2]], [3], 1.0, Verdict.ONE_OF),
        ([], [], [3], 1.0, Verdict.SUPPORTED),
        ([], [], [], 1.0, Verdict.UNKNOWN),
        ([], [], [], 1e-3, Verdict.CALIBRATED),
    ],
)
def test_the_verdict_is_the_best_that_can_be_told(told, classes, supported, left, expected):
    assert verdict._verdict(told, classes, supported, [channel(2.0, left)]) is expected
    if expected is Verdict.CALIBRATED:
        assert verdict._verdict([], [], [], [channel(1e-3, 1e-3)]) is Verdict.NO_GAP


def predicted(*residuals):
    return Predicted(Point(np.zeros(0), ()), tuple(np.asarray(r) for r in residuals))


def test_predictions_are_compared_by_their_rms_in_units_of_the_noise():
    rng = np.random.default_rng(0)
    one, other = rng.standard_normal((400, 2)), rng.standard_normal((400, 2))
    noise = np.array([1.0, 2.0])
    exact = 0.5 * np.log(((one / noise) ** 2).sum() / ((3.0 * other / noise) ** 2).sum())
    value, low, high = compare(predicted(one), predicted(3.0 * other), noise, 1.0)
    assert value == pytest.approx(exact)
    assert low < value < high < 0.0
    # The variance of the logarithm of a rms of n white samples is 1 / (2 n); both are independent.
    sd = np.sqrt(0.5 * (17.0 / 25.0) / 400.0 * 2.0)
    assert high - low == pytest.approx(2.0 * 1.96 * sd, rel=0.15)


def test_correlated_residuals_are_compared_by_blocks():
    rng = np.random.default_rng(1)
    one, other = (np.repeat(rng.standard_normal((100, 1)), 25, axis=0) for _ in range(2))
    widths = []
    for share in (1.0, 0.04):
        _, low, high = compare(predicted(one), predicted(other), np.ones(1), share)
        widths.append(high - low)
    assert widths[1] == pytest.approx(5.0 * widths[0], rel=0.2)


def law(**what):
    return Effect(
        name="law", component="part", unit="N", scale=2.0, regressor=lambda r, _: r.time, **what
    )


def test_a_magnitude_at_its_limit_is_at_the_end_of_the_range(monkeypatch):
    monkeypatch.setattr(verdict, "index_of", lambda *_: 0)

    def at(x, **what):
        problem = Given(causes=[Cause("law", "part", law(**what))])
        fitted = Given(point=Given(x=np.array([x])), members=())
        return verdict._at_limit(problem, fitted, 0)

    assert at(-0.45, lower=-0.9, upper=5.0)
    assert at(2.5, lower=-0.9, upper=5.0)
    assert not at(0.3, lower=-0.9, upper=5.0)
    assert not at(0.5, lower=0.0, upper=1.0)  # a law ends at 1 by itself
    assert not verdict._at_limit(Given(causes=[Cause("p", "part", parameter=0)]), None, 0)


def test_a_prediction_worse_than_the_mean_is_none():
    t = np.linspace(0.0, 1.0, 101)[:, None]
    record = Given(samples=np.array([101.0]), measured=t, valid=t >= 0.0, sd=np.full_like(t, 0.01))
    problem = Given(held_out=(record,), noise=np.array([0.01]))
    for factor, worse in ((0.9, False), (1.1, True)):
        left = factor * np.std(t) / 0.01 * np.ones_like(t)
        assert verdict._worse_than_constant(problem, predicted(left)) is worse
    problem.noise = np.array([1.0])  # a record of noise
    assert not verdict._worse_than_constant(problem, predicted(left))


def test_a_cause_of_another_size_in_each_record_is_an_imitation(monkeypatch):
    causes = [Cause(n, "part", law()) for n in "abc"]
    p = {((0,), 0): 0.009, ((0, 1), 0): 0.009, ((0, 1), 1): 0.5, ((2,), 2): 0.009,
         ((1, 2), 2): 0.011, ((1, 2), 1): 0.5}  # fmt: skip
    monkeypatch.setattr(verdict, "_by_record", lambda _, s, i: (None, p[s.causes, i]))
    monkeypatch.setattr(verdict, "rank", lambda _, kept: (kept, np.ones(len(kept)) / len(kept)))
    every = sets((0, 1), (0,), (1, 2), (2,), ())
    kept, weight, imitations = verdict._consistent(Given(causes=causes), every, np.ones(5) / 5.0)
    # One fit with the same size in all records is enough.
    assert imitations == {0}
    assert [s.causes for s in kept] == [(1, 2), (2,), ()]
    assert len(weight) == 3


def test_a_cause_is_needed_if_the_set_without_it_was_fitted(monkeypatch):
    causes = [Cause(n, "part", law()) for n in "ab"]
    problem = Given(causes=causes)
    both, one, other, none = sets((0, 1), (0,), (1,), ())

    def needless(some, told, ratio=(-1.0, -1.2, -0.8), worse=False, lost=()):
        monkeypatch.setattr(verdict, "compare", lambda *_: ratio)
        monkeypatch.setattr(verdict, "_worse_than_constant", lambda *_: worse)
        for s in some:
            s.noise, s.effective = np.ones(1), 1.0
        known = {s.causes: s for s in some if s.causes not in lost}
        return verdict._not_needed(problem, problem, some, told, known)

    assert needless([both, one, other, none], [0, 1]) == []
    assert needless([both, other, none], [0, 1]) == [1]
    assert needless([both, one, none], [0, 1]) == [0]
    assert needless([both, one, other, none], []) == []
    # The held-out records refuse the set: surely worse than without it, or than the mean.
    assert needless([both, one, other, none], [0, 1], (0.2, 0.1, 0.3)) == [0, 1]
    assert needless([both, one, other, none], [0, 1], (0.2, -0.1, 0.5)) == []
    assert needless([both, one, other, none], [0, 1], worse=True) == [0, 1]
    # Records that one of the sets cannot follow tell nothing.
    for causes in ((0, 1), ()):
        assert needless([both, one, other, none], [0, 1], worse=True, lost=[causes]) == []


def test_what_explains_the_records_as_well_is_in_the_class(monkeypatch):
    """A pair that was fitted in each other's place; a law with a shape only without a plain one."""
    causes = [Cause(n, "part", law()) for n in "abcd"]
    problem, some = Given(causes=causes), sets((0,), (1,), (2,), (3,))
    left = {0: 0.0, 1: 0.9, 2: -0.9, 3: 1.1}
    monkeypatch.setattr(verdict, "_worse_by", lambda _, s, o: left[s.causes[0]] - left[o.causes[0]])
    monkeypatch.setattr(verdict, "_tested", lambda _, i: i in tested)
    monkeypatch.setattr(verdict, "_has_shape", lambda _, i: i in shaped)
    monkeypatch.setattr(verdict, "log_odds", lambda _, s, __: odds.get(s.causes[0], 0.0))
    monkeypatch.setattr(verdict, "_of_sizes", lambda *_: 0.0)
    pairs = [frozenset(p) for p in ((0, 1), (0, 2), (0, 3))]

    def found(alike=pairs, told=(0,), classes=()):
        return verdict._with_equivalents(problem, alike, some, [*told], classes)

    tested, shaped, odds = set(), set(), {}
    assert found() == ([], [[0, 1, 2]])
    assert found([]) == ([0], [])
    assert found(told=(), classes=[[0, 3]]) == ([], [[0, 3, 1, 2]])
    tested = {1}
    assert found() == ([], [[0, 2]])
    tested, odds = set(), {1: -6.9, 2: -7.1}
    assert found() == ([], [[0, 1]])
    odds, shaped = {}, {0, 2}
    assert found() == ([1], [])
    shaped = {0, 1, 2}
    assert found() == ([], [[0, 1, 2]])


def test_one_side_of_a_magnitude_has_half_of_the_prior():
    """The share of the posterior on the permitted side, over that of the prior."""
    for sign in (1, -1, 0):
        problem = Given(causes=[Cause("law", "part", law(sign=sign))], free=[0])
        point, hessian = Point(np.array([7.0, 0.6]), ()), np.diag([4.0, 2.25])
        expected = np.log(2.0 * norm.cdf(sign * 0.6 * 1.5)) if sign else 0.0
        assert _one_sided(problem, (Member(0),), point, hessian) == pytest.approx(expected)


def test_only_effects_of_a_part_act_inside_the_model():
    problem = Given(fit=[Given(record=Given(inputs={"u": None}))])
    inside, driven = Cause("law", "part", law()), Cause("gain", "input u", law())
    sensor = Cause("gain", "sensor y", law(kind="sensor"))
    found = [verdict._inside(problem, c)
             for c in (inside, driven, sensor, Cause("k", "part", parameter=0))]  # fmt: skip
    assert found == [True, False, False, False]


def test_what_would_be_told_with_another_trust_in_the_model_is_a_note(monkeypatch):
    @dataclass
    class Trusted:
        causes: tuple
        discrepancy_samples: float = 20.0

    problem = Trusted(tuple(Given(name=n) for n in "abc"))
    told = {10.0: ([], []), 20.0: ([0], []), 40.0: ([0], [[1, 2]])}
    monkeypatch.setattr(verdict, "rank", lambda p, _: (p.discrepancy_samples, None))
    monkeypatch.setattr(verdict, "_told", lambda count, *_: told[count])
    less, more = verdict._by_trust(problem, [], Given(credibility=0.9))
    assert "as 10 samples instead of 20, nothing would be told" in less
    assert "as 40 samples instead of 20, a and one of b, c would be told" in more
    told[40.0] = [0], []
    assert len(verdict._by_trust(problem, [], Given(credibility=0.9))) == 1


def test_a_member_of_a_class_has_the_size_with_which_it_stands_for_the_others():
    one, both, other = sets((0, 2), (0, 1, 2), (1, 2))
    assert verdict._where([one, both, other], 1) is both
    assert verdict._where([one, both, other], 1, (0, 1)) is other
    assert verdict._where([both], 1, (0, 1)) is both


@pytest.mark.parametrize(
    ("gain", "odds", "preferred"),
    [(0.3, -9.0, True), (0.1, -9.0, False), (-0.1, 9.0, True), (-0.3, 9.0, False)],
)
def test_of_sets_that_predict_equally_well_the_most_probable_one_is_supported(
    gain, odds, preferred
):
    """The leg of a robot: friction and a delay predict by 0.1 better, and are less probable."""
    assert verdict._preferred(gain, odds) is preferred
