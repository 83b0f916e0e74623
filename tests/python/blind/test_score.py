"""Scorer of the blind bench on made-up results whose scores are known."""

import math

import numpy as np
import pytest
from scipy.stats import binomtest

from blind.score import Scored, _ece, bootstrap, markdown, score, wilson


def part(name="a", nc=10.0, form="A", component="x", size=1.0):
    return {
        "name": name,
        "form": form,
        "target": nc,
        "component": component,
        "size": size,
        "onset": {"r": 0.010},
        "shows": {"r": 0.0125},
    }


def result(verdict="NAMED", ranking=(("a", 0.9),), named=None, one_of=(), onset=0.012):
    named = [ranking[0][0]] if named is None and verdict == "NAMED" else list(named or [])
    return {
        "verdict": verdict,
        "named": named,
        "one_of": list(one_of),
        "effects": [
            {
                "effect": n,
                "component": "x" if n == "a" else "y",
                "posterior": p,
                "low": 0.8,
                "high": 1.1,
                "confusable": [],
            }
            for n, p in ranking
        ],
        "sets": [{"effects": [ranking[0][0]], "posterior": 1.0}] if ranking else [],
        "onset": {"r": onset},
        "closed": 0.9,
        "oracle": {"closed": 0.95},
        "cpu_seconds": 2.0,
    }


def figures(cases):
    return {f.name: f for f in score([Scored(i, *c) for i, c in enumerate(cases)])}


def test_wilson_is_that_of_scipy():
    for hits, n in ((0, 10), (3, 10), (97, 100), (10, 10)):
        ci = binomtest(hits, n).proportion_ci(method="wilson")
        assert wilson(hits, n) == pytest.approx((100 * hits / n, 100 * ci.low, 100 * ci.high))
    assert all(math.isnan(v) for v in wilson(0, 0))


def test_bootstrap_of_a_mean_has_its_standard_error():
    values = np.random.default_rng(0).standard_normal(400)
    mean, low, high = bootstrap(values, lambda v: float(np.mean(v)))
    assert mean == pytest.approx(np.mean(values))
    assert high - low == pytest.approx(2 * 1.96 / 20.0, rel=0.15)


def test_perfect_engine():
    cases = [((part(),), result())] * 8
    cases += [((), result("NO GAP", (("a", 0.1),)))] * 4
    cases += [((part("strange", form="outside"),), result("UNKNOWN", (("a", 0.2),)))] * 3
    cases += [
        ((part("a"), part("b")), result(ranking=(("a", 0.9), ("b", 0.9)), named=["a", "b"]))
    ] * 2
    f = figures(cases)
    assert f["false alarm, no effect"].value == 0.0
    assert f["false alarm, no effect"].n == 4
    assert f["false alarm, no effect"].met
    assert f["top-1, one effect, nc >= 5"].value == 100.0
    assert f["unknown flagged, outside, nc >= 5"].value == 100.0
    assert f["confident and wrong, of all cases"].value == 0.0
    assert f["two effects, both named"].value == 100.0
    assert f["F1 of the named set, two or three effects"].value == 1.0
    assert f["onset, median error, nc >= 5"].value == pytest.approx(2.0)
    assert f["moment from which it shows, median error, nc >= 5"].value == pytest.approx(0.5)
    assert f["95 % interval covers, first right, form A"].value == 100.0
    assert f["closed / closed by the oracle, nc >= 5"].value == pytest.approx(0.9 / 0.95)


def test_a_cause_from_outside_that_no_record_shows_cannot_be_flagged():
    """The tolerances reproduce it up to less than 5, whatever it was drawn for."""
    cases = [((part("strange", form="outside", nc=7.0),), result("UNKNOWN", (("a", 0.2),)))]
    cases += [((part("strange", form="outside", nc=2.0),), result("NO GAP", (("a", 0.2),)))] * 3
    f = figures(cases)
    assert f["unknown flagged, outside, nc >= 5"].n == 1
    assert f["unknown flagged, outside, nc >= 5"].value == 100.0
    assert f["outside: silent (NO GAP, TOO WEAK)"].value == 75.0


def test_an_effect_may_take_the_place_of_an_outside_cause():
    """It is wrong of all cases, and right of those that no diagnosis can tell apart."""
    strange = part("strange", form="outside")
    hidden = {**strange, "alike": [{"effect": "a", "left": 3.0}, {"effect": "b", "left": 6.0}]}
    told = {**strange, "alike": [{"effect": "a", "left": 7.0}]}
    cases = [((hidden,), result())] * 2  # named is a
    cases += [((hidden,), result(ranking=(("b", 0.9),)))]
    cases += [((hidden,), result("DATA PROBLEM", named=["a"]))]
    cases += [((told,), result("UNKNOWN", (("a", 0.2),)))] * 3
    cases += [((told,), result())]
    f = figures(cases)
    beside = f["unknown flagged, outside, nc >= 5 beside every effect of the library"]
    assert (beside.value, beside.n) == (75.0, 4)
    place = f["outside, an effect leaves nc < 5: it is named or in the class"]
    assert (place.value, place.n) == (75.0, 4)
    assert f["confident and wrong, of all cases"].value == 100.0 * 5 / 8
    fair = f["confident and wrong, effects that leave nc < 5 of an outside cause are right"]
    assert fair.value == 100.0 * 2 / 8


def test_bad_engine():
    wrong = result(ranking=(("b", 0.95), ("a", 0.02)))
    cases = [((part(),), wrong)] * 6
    cases += [((), result("UNKNOWN", (("a", 0.1),)))] * 3
    cases += [((), result("TOO WEAK", (("a", 0.1),)))]
    cases += [((part("strange", form="outside"),), wrong)] * 2
    cases += [((part(),), {"error": "ModelError: no", "cpu_seconds": 1.0})]
    f = figures(cases)
    assert f["false alarm, no effect"].value == 75.0
    assert not f["false alarm, no effect"].met
    assert f["top-1, one effect, nc >= 5"].value == 0.0
    assert f["top-2, one effect, nc >= 5"].value == pytest.approx(100.0 * 6 / 7)
    assert f["unknown flagged, outside, nc >= 5"].value == 0.0
    assert f["confident and wrong, of all cases"].value == pytest.approx(100.0 * 8 / 13)
    assert f["selective risk: wrong, of those that commit"].value == 100.0
    assert f["diagnosis failed with an error"].value == pytest.approx(100.0 / 13)
    assert f["component of the first, nc >= 5"].value == 0.0


def test_class_and_data_problem():
    def wrong(parts, said):
        return Scored(0, parts, said).wrong()

    assert not wrong((part("a"),), result("ONE OF", (("b", 0.5),), one_of=["a", "b"]))
    assert wrong((part("c"),), result("ONE OF", (("b", 0.5),), one_of=["a", "b"]))
    assert wrong((part("c"),), result("DATA PROBLEM", (("b", 0.5),)))
    sensor = part("c", component="input")
    assert not wrong((sensor,), result("DATA PROBLEM", (("b", 0.5),)))
    assert wrong((sensor,), result("DATA PROBLEM", (("b", 0.5),), named=["b"]))
    assert not wrong((part("c"),), result("NO GAP", (("b", 0.5),)))
    assert wrong((part("a"),), result(ranking=(("a", 0.9), ("b", 0.9)), named=["a", "b"]))


def test_calibration_error():
    p = np.repeat([0.05, 0.55, 0.95], 100)
    hit = np.concatenate([np.zeros(100), np.repeat([0, 1], 50), np.ones(100)])
    assert _ece(np.column_stack([p, hit])) == pytest.approx((0.05 + 0.05 + 0.05) / 3)


def test_markdown_of_nothing():
    assert "| - | - | 0 |" in markdown(score([]))
