"""Errors of form of the laws of the model, which the library of effects does not have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem, polish
from feltmb.gap import (
    Effect,
    OdeModel,
    Options,
    Parameter,
    Record,
    Sensor,
    State,
    Verdict,
    diagnose,
)
from feltmb.gap.acceptance import posterior
from feltmb.gap.criteria import FORM_ERROR, NO_EFFECT, NOT_LISTED, OTHER_LAW
from feltmb.gap.law_errors import SHARES, law_errors
from feltmb.gap.misfit import allowance
from feltmb.gap.refine import tighten
from feltmb.gap.search import search

SIGMA, START, COUNT, SEGMENTS = 2e-3, 0.01, 101, 5
TIME = np.linspace(0.0, 1.0, COUNT)
EDGES = np.linspace(0, COUNT - 1, SEGMENTS + 1).astype(int)
RATE = Parameter(name="rate", value=1.0, sd=0.05, unit="1/s")
DRIFT = OdeModel(
    states=[State(name="x", start=0.0, start_sd=START, scale=0.1)],
    inputs=["u"],
    parameters=[RATE],
    rates=lambda t, x, u, p: (p["rate"] * u["u"],),
    outputs={"x": lambda t, x, u, p: x["x"]},
    name="drift",
)


def drift(seed, share):
    """A record of x' = rate u; the rate deviates between segments by a share of its tolerance."""
    generator = np.random.default_rng(seed)
    u = 1.0 + 0.5 * np.sin(9.0 * TIME)
    rate = 1.03 + share * RATE.sd * np.repeat(generator.standard_normal(SEGMENTS), 20)
    step = 0.5 * (u[1:] + u[:-1]) * np.diff(TIME)
    x = np.concatenate([[0.0], np.cumsum(rate * step)]) + START * generator.standard_normal()
    return Record(
        name=f"r{seed}",
        time=TIME,
        inputs={"u": u},
        outputs={"x": x + SIGMA * generator.standard_normal(COUNT)},
        sensors={"x": Sensor(name="x", sigma=SIGMA)},
    )


def fitted(records):
    segments = np.column_stack([EDGES[:-1], EDGES[1:]])
    made = tuple(segment_record(DRIFT, r, {"x": Noise(SIGMA)}, None, segments) for r in records)
    fit = fit_problem(Problem(DRIFT, made))
    return tighten(fit, FitSettings()) or fit


def steps(record):
    """Integral of the input between samples."""
    u = record.inputs["u"]
    return 0.5 * (u[1:] + u[:-1]) * np.diff(TIME)


def covariance(records, share, defect):
    """Covariance of the readings; every unknown number is normal, and the model is linear."""
    total = np.concatenate([np.concatenate([[0.0], np.cumsum(s)]) for s in map(steps, records)])
    cover = SIGMA**2 * np.eye(total.size) + RATE.sd**2 * np.outer(total, total)
    for k, step in enumerate(map(steps, records)):
        own = cover[k * COUNT : (k + 1) * COUNT, k * COUNT : (k + 1) * COUNT]
        own += START**2
        for w in range(SEGMENTS):
            inside = np.where(np.arange(COUNT - 1) // 20 == w, step, 0.0)
            column = np.concatenate([[0.0], np.cumsum(inside)])
            own += (share * RATE.sd) ** 2 * np.outer(column, column)
            after = (np.arange(COUNT) > EDGES[w]) * (defect if w else 0.0)
            own += np.outer(after, after)
    return cover


def exact(records, share, defect):
    """Log marginal likelihood of the model whose law has an error of form."""
    total = np.concatenate([np.concatenate([[0.0], np.cumsum(s)]) for s in map(steps, records)])
    seen = np.concatenate([r.outputs["x"] for r in records])
    cover = covariance(records, share, defect)
    return multivariate_normal(total * RATE.value, cover).logpdf(seen)


def mean(values):
    return logsumexp(values) - np.log(len(values))


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_gain_is_the_ratio_of_the_marginal_likelihoods(share):
    records = [drift(seed, share) for seed in range(3)]
    fit = fitted(records)
    found = law_errors(fit, FitSettings())
    (defect,) = fit.defect_sd
    gains = [exact(records, s, defect) - exact(records, 0.0, defect) for s in SHARES]
    assert found.tested
    assert found.gain == pytest.approx(mean(gains), abs=0.02)
    if share == 0.0:
        assert found.gain < 0.0
        assert not found.laws
        assert found.fit is None
    else:
        (law,) = found.laws
        assert law.parameter == "rate"
        assert law.sd == pytest.approx(share * RATE.sd)


def ramp(t, *others):
    return {"x": others[3] * t}


RAMP = Effect(name="ramp", component="x", unit="1/s^2", scale=0.5, rate=ramp)


def with_ramp(records, share, defect, deviation=0.0, prior=(0.0, RAMP.scale)):
    """As :func:`exact`, with the effect, whose magnitude has a normal prior (mean, sd).

    ``deviation``: standard deviation of the magnitude between segments.
    """
    column = np.concatenate([0.5 * TIME**2 for _ in records])
    total = np.concatenate([np.concatenate([[0.0], np.cumsum(s)]) for s in map(steps, records)])
    cover = covariance(records, share, defect) + prior[1] ** 2 * np.outer(column, column)
    for k in range(len(records)):
        own = cover[k * COUNT : (k + 1) * COUNT, k * COUNT : (k + 1) * COUNT]
        for first, last in zip(TIME[EDGES[:-1]], TIME[EDGES[1:]], strict=True):
            part = 0.5 * (np.clip(TIME, first, last) ** 2 - first**2)
            own += deviation**2 * np.outer(part, part)
    seen = np.concatenate([r.outputs["x"] for r in records])
    return multivariate_normal(total * RATE.value + prior[0] * column, cover).logpdf(seen)


@pytest.mark.parametrize("seed", [4, 9, 14])
def test_the_posterior_contains_the_errors_of_form(seed):
    records = [drift(seed + k, 0.2) for k in range(2)]
    settings = FitSettings(restarts=0)
    found = search(fitted(records), [RAMP], settings, most=1)
    (defect,) = found.model_fit.defect_sd
    assert found.tight_fit is None
    # There are no free defects, but they have a third of the probability of an unknown cause.
    listed, unknown = 1.0 - NO_EFFECT - NOT_LISTED, NOT_LISTED / 3.0
    without = [exact(records, s, defect) for s in (0.0, *SHARES)]
    # The law of the effect may have an error of form, too.
    size = abs(float(found.sets[0].fit.point.magnitudes[0]))
    beside = [
        mean([with_ramp(records, s, defect, q * size) for q in (0.0, FORM_ERROR)])
        for s in (0.0, *SHARES)
    ]
    # An unknown cause may act like the effect, with another law.
    like = mean([with_ramp(records, 0.0, defect, q * size) for q in OTHER_LAW])
    belief = posterior(found, settings)
    least = allowance(found.model_fit)
    gains = [mean(x[1:]) - x[0] for x in (without, beside)]
    small = np.clip(gains, 0.0, least)  # is no gap
    values = [without[0] + small[0], mean(without[1:]), beside[0] + small[1], mean(beside[1:])]
    values.append(like)
    prior = np.array([NO_EFFECT, unknown, listed, listed * unknown / NO_EFFECT, unknown])
    weights = np.exp((np.array(values) - np.max(values)) / belief.inflation) * prior
    none, other, named, both, like = weights / np.sum(weights)
    assert belief.other / belief.none == pytest.approx((other + like) / none, rel=0.05)
    # The average over the laws beside the effect is computed with an exact law of the effect.
    assert (belief.none, belief.other) == pytest.approx((none, other + like), abs=0.03)
    assert sum(belief.sets) == pytest.approx(named + both, abs=0.03)


def test_a_law_that_is_not_exact_is_told():
    records = [drift(seed, 1.0) for seed in range(4)]
    report = diagnose(DRIFT, [RAMP], records, options=Options(bootstrap=0, advice=False))
    assert report.verdict == Verdict.UNKNOWN
    assert [law.parameter for law in report.where.varying] == ["rate"]
    text = "If rate (±0.05 1/s) varied within the records"
    assert text in report.statement
    assert text in str(report)
    assert "acts like" not in report.statement
    assert report.which.other > 0.4  # a ramp whose law is not exact is as probable


def early(t, *others):
    return {"x": others[3] * (t < 0.4)}


EARLY = Effect(name="early", component="x", unit="1/s", scale=0.05, rate=early)


def test_a_second_effect_must_be_better_than_a_law_that_is_not_exact():
    found = []
    for seed in (2, 3, 4, 5):
        records = [
            replace(r, outputs={"x": r.outputs["x"] + 0.25 * r.time**2})
            for r in (drift(10 * seed + k, 0.5) for k in range(2))
        ]
        settings = FitSettings(restarts=0)
        sets = search(fitted(records), [RAMP, EARLY], settings, most=2)
        belief = posterior(sets, settings)
        found.append(
            sum(w for c, w in zip(sets.sets, belief.sets, strict=True) if "early" in c.names)
        )
    assert max(found) < 0.9


def test_errors_that_cannot_be_told_from_rounding_are_not_tested():
    fit = fitted([drift(1, 1.0)])
    far = tuple(replace(s, weight=1e9 * s.weight) for s in fit.problem.segmented_records)
    again = polish(replace(fit.problem, segmented_records=far), fit.point, fit.level, FitSettings())
    assert again.chi2 > 1e8 * again.dof
    assert not law_errors(again, FitSettings()).tested
