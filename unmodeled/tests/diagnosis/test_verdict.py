"""Rules of the verdict by themselves, with sets and probabilities that are given."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace as Given

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from unmodeled import Effect
from unmodeled.search import verdict
from unmodeled.search.evidence import _one_sided
from unmodeled.search.held_out import MANY, SHARED, Predicted, compare
from unmodeled.search.ledger import Mark
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
    assert verdict._told(causes, np.array(weight), 0.9) == (told, classes)


def channel(tabulated, explained):
    return Channel("y", "m", 1e-3, 1.0, tabulated, explained, explained, np.nan, np.nan, 0.01)


@pytest.mark.parametrize(
    ("marks", "left", "expected"),
    [
        ([Mark.NAMED, Mark.ONE_OF, Mark.SUPPORTED, Mark.UNSURE], 1.0, Verdict.NAMED),
        ([Mark.ONE_OF, Mark.SUPPORTED, Mark.SMALL], 1.0, Verdict.ONE_OF),
        ([Mark.SUPPORTED, Mark.UNSURE], 1.0, Verdict.SUPPORTED),
        ([], 1.0, Verdict.UNKNOWN),
        ([Mark.SMALL], 1.0, Verdict.UNKNOWN),
        ([Mark.UNSURE], 1.0, Verdict.UNKNOWN),
        # What is small is no cause that matters.
        ([Mark.SMALL], 1e-3, Verdict.CALIBRATED),
        ([], 1e-3, Verdict.CALIBRATED),
    ],
)
def test_the_verdict_is_the_best_that_can_be_told(marks, left, expected):
    told = {m: [()] * (m in marks) for m in Mark}
    assert verdict._verdict(told, [channel(2.0, left)]) is expected


def test_without_a_gap_there_is_none():
    none = {m: [] for m in Mark}
    assert verdict._verdict(none, [channel(1e-3, 1e-3)]) is Verdict.NO_GAP


def test_what_is_not_sure_is_no_explanation_of_a_gap():
    """All that the calibrated model misses is explained by something that may not be there."""
    unsure = {m: [()] * (m is Mark.UNSURE) for m in Mark}
    c = replace(channel(2.0, 1e-3), calibrated=1.0)
    assert verdict._verdict(unsure, [c]) is Verdict.UNKNOWN
    assert verdict._verdict(unsure, [replace(c, calibrated=1e-3)]) is Verdict.CALIBRATED


def predicted(*residuals):
    return Predicted(Point(np.zeros(0), ()), tuple(np.asarray(r) for r in residuals))


def test_predictions_are_compared_by_their_rms_in_units_of_the_noise():
    rng = np.random.default_rng(0)
    one, other = rng.standard_normal((400, 2)), rng.standard_normal((400, 2))
    noise = np.array([1.0, 2.0])
    exact = 0.5 * np.log(((one / noise) ** 2).sum() / ((3.0 * other / noise) ** 2).sum())
    found = compare(predicted(one), predicted(3.0 * other), noise, 1.0)
    assert found.value == pytest.approx(exact)
    assert found.low < found.value < found.high < 0.0
    assert (found.smaller, found.records) == (1, 1)
    # The variance of the logarithm of a rms of n white samples is 1 / (2 n); both are independent.
    # One record shows one example of its discrepancy: the interval is wider.
    sd = np.sqrt(0.5 * (17.0 / 25.0) / 400.0 * 2.0)
    half = (1.0 + SHARED) * 1.96 * sd
    assert found.high - found.low == pytest.approx(2.0 * half, rel=0.15)


def test_correlated_residuals_are_compared_by_blocks():
    rng = np.random.default_rng(1)
    one, other = (np.repeat(rng.standard_normal((100, 1)), 25, axis=0) for _ in range(2))
    widths = []
    for share in (1.0, 0.04):
        found = compare(predicted(one), predicted(other), np.ones(1), share)
        widths.append(found.high - found.low)
    assert widths[1] == pytest.approx(5.0 * widths[0], rel=0.2)


def test_each_held_out_record_counts_as_much_as_another():
    """Two that nobody explains do not decide for six that are better by a fifth."""
    rng = np.random.default_rng(2)
    better = [rng.standard_normal((200, 1)) for _ in range(6)]
    odd = [50.0 * rng.standard_normal((200, 1)) for _ in range(2)]
    found = compare(
        predicted(*(0.8 * b for b in better), *odd), predicted(*better, *odd), np.ones(1), 1.0
    )
    ratios = np.array([np.log(0.8)] * 6 + [0.0] * 2)
    assert found.value == pytest.approx(ratios.mean(), abs=1e-6)
    assert (found.smaller, found.records) == (6, 8)
    # The interval is that of Student's t over the records.
    low, high = student.interval(0.95, 7, ratios.mean(), ratios.std(ddof=1) / np.sqrt(8.0))
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-5)
    assert found.high < 0.0


def test_few_records_say_less_than_many():
    rng = np.random.default_rng(3)
    one, other = ([rng.standard_normal((200, 1)) for _ in range(MANY - 1)] for _ in range(2))
    widths = {}
    for n in (1, 2, MANY - 1):
        found = compare(predicted(*one[:n]), predicted(*other[:n]), np.ones(1), 1.0)
        widths[n] = (found.high - found.low) * np.sqrt(n)
    # Beyond the number of samples: each record shows one example of its discrepancy.
    expected = [(1.0 + SHARED) / (1.0 + SHARED / n) for n in widths]
    assert [widths[1] / v for v in widths.values()] == pytest.approx(expected, rel=0.15)


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

    def found(alike=pairs, group=(0,)):
        return verdict._with_equivalents(problem, alike, some, [*group])

    tested, shaped, odds = set(), set(), {}
    assert found() == [0, 1, 2]
    assert found([]) == [0]
    assert found(group=(0, 3)) == [0, 3, 1, 2]
    tested = {1}
    assert found() == [0, 2]
    tested, odds = set(), {1: -6.9, 2: -7.1}
    assert found() == [0, 1]
    odds, shaped = {}, {1, 2}
    assert found() == [0]
    shaped = {0, 1, 2}
    assert found() == [0, 1, 2]


@pytest.mark.parametrize(
    ("causes", "weight", "found"),
    [
        # One member is exchanged for another cause beside each of the others.
        ([(0, 1), (0, 2), (1, 3), (0, 4)], [0.44, 0.15, 0.3, 0.11], {0: [3], 1: [2, 4]}),
        ([(0, 1), (0, 2), (0,)], [0.6, 0.35, 0.05], {1: [2]}),
        ([(0, 1), (0,)], [0.95, 0.05], {}),
        # Both are exchanged together: what else is probable is told with each.
        ([(0, 1), (2, 3)], [0.55, 0.45], {0: [2], 1: [3]}),
    ],
)
def test_an_equivalent_stands_for_one_member_beside_the_others(causes, weight, found, monkeypatch):
    monkeypatch.setattr(verdict, "_with_equivalents", lambda _, __, ___, group: group)
    some = sets(*causes)
    chosen = Given(best=some[0], problem=None, searched=Given(alike=[]))
    assert verdict._equivalents(chosen, some, np.array(weight), 0.9) == found


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


def test_a_member_of_a_class_has_the_size_with_which_it_stands_for_the_others():
    one, both, other = sets((0, 2), (0, 1, 2), (1, 2))
    assert verdict._where([one, both, other], 1) is both
    assert verdict._where([one, both, other], 1, (0, 1)) is other
    assert verdict._where([both], 1, (0, 1)) is both
