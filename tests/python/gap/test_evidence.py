"""Errors of form of the laws of effects."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp

from feltmb.fit.model import Candidate
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, finish, fit_problem, polish
from feltmb.gap import Options, Verdict, diagnose
from feltmb.gap.criteria import FORM_ERROR, OTHER_LAW
from feltmb.gap.evidence import forms_of, other_laws
from feltmb.gap.proof import HELD_OUT_LEVEL, HeldOut, evaluate
from feltmb.gap.refine import refit

sys.path.insert(0, str(Path(__file__).parent))
from test_law_errors import (
    COUNT,
    DRIFT,
    EDGES,
    RAMP,
    SEGMENTS,
    SIGMA,
    TIME,
    drift,
    fitted,
    with_ramp,
)

SEGMENT = np.column_stack([EDGES[:-1], EDGES[1:]])


def ramps(seed, size, spread):
    """A record of x' = rate u + s t; s deviates between segments by a share of its size."""
    plain = drift(seed, 0.0)
    generator = np.random.default_rng(1000 + seed)
    own = size * (1.0 + spread * np.repeat(generator.standard_normal(SEGMENTS), COUNT // SEGMENTS))
    added = np.concatenate([[0.0], np.cumsum(own * 0.5 * np.diff(TIME**2))])
    return replace(plain, outputs={"x": plain.outputs["x"] + added})


def density(records, fit, share):
    """Log density of the readings if the ramp deviates by a share of its magnitude.

    The prior of the magnitude is N(fitted, width^2): only the volume of its prior counts here.
    """
    (defect,), (size,) = fit.defect_sd, fit.point.magnitudes
    prior = (size, max(RAMP.scale, abs(size)))
    return with_ramp(records, 0.0, defect, share * abs(size), prior)


def ramp_fit(records, size=0.3):
    fit = fitted(records)
    return refit(fit, (Candidate(RAMP),), np.array([size]), FitSettings())


@pytest.mark.parametrize(("spread", "inexact"), [(0.0, False), (0.1, True)])
def test_the_gain_is_the_ratio_of_the_marginal_likelihoods(spread, inexact):
    records = [ramps(seed, 0.3, spread) for seed in range(3)]
    fit = ramp_fit(records)
    forms = forms_of(fit)
    expected = density(records, fit, FORM_ERROR) - density(records, fit, 0.0)
    assert forms.gains == pytest.approx([0.0, expected], abs=0.02)
    assert forms.gain == pytest.approx(logsumexp([0.0, expected]) - np.log(2.0), abs=0.02)
    assert np.sum(np.exp(forms.log_weights)) == pytest.approx(1.0)
    assert bool(expected > 3.0) is inexact
    assert bool(expected < 0.0) is not inexact


def test_another_law_in_the_place_of_an_effect_deviates_more():
    """Deviations of the whole magnitude are no error of form; small ones are no other cause."""
    odds = []
    for spread in (0.02, 0.2):
        records = [ramps(seed, 0.3, spread) for seed in range(3)]
        fit = ramp_fit(records)
        exact = density(records, fit, 0.0)
        like = logsumexp([density(records, fit, q) for q in OTHER_LAW]) - np.log(len(OTHER_LAW))
        own = logsumexp([exact, density(records, fit, FORM_ERROR)]) - np.log(2.0)
        odds.append(other_laws(fit)[0])
        assert odds[-1] == pytest.approx(like - own, abs=0.05)
    assert odds[0] < -2.0
    assert odds[1] > odds[0] + 1.0


def test_an_effect_of_no_size_has_no_error_of_form():
    records = [drift(seed, 0.0) for seed in range(2)]
    fit = ramp_fit(records)
    none = finish(
        fit.problem,
        fit.problem.carry(fit.point, fit.included, np.zeros(1)),
        fit.level,
        fit.defect_sd,
    )
    assert forms_of(none).gain == pytest.approx(0.0, abs=1e-9)
    assert forms_of(fitted(records)).gain == 0.0


def test_one_segment_shows_no_error_of_form():
    record = ramps(0, 0.3, 0.3)
    whole = segment_record(DRIFT, record, {"x": Noise(SIGMA)}, None, np.array([[0, COUNT - 1]]))
    fit = fit_problem(Problem(DRIFT, (whole,)))
    fit = refit(fit, (Candidate(RAMP),), np.array([0.3]), FitSettings())
    assert forms_of(fit).inexact[0].size == 0
    assert len(forms_of(fit).gains) == 1
    assert other_laws(fit) == [-np.inf]


def test_held_out_records_are_predicted_with_the_errors_of_form():
    """An effect with an inexact law is not refuted by records where it has another magnitude."""
    records = [ramps(seed, 0.3, 0.04) for seed in range(4)]
    others = [ramps(seed, 0.3, 0.04) for seed in (20, 21)]
    tight = ramp_fit(records)
    fit = polish(tight.problem, tight.point, HELD_OUT_LEVEL, FitSettings())
    seen = tuple(segment_record(DRIFT, r, {"x": Noise(SIGMA)}, None, SEGMENT) for r in others)
    found = evaluate(HeldOut(seen, fit.defect_sd / fit.level, seen), fit, FitSettings())
    both = [*records, *others]
    whole, old = (
        np.array([density(several, fit, q) for q in (0.0, FORM_ERROR)])
        for several in (both, records)
    )
    samples = sum(s.samples.sum() for s in seen)
    constant = samples * np.log(np.sqrt(2.0 * np.pi) * SIGMA)
    assert found.total == pytest.approx(logsumexp(whole) - logsumexp(old) + constant, abs=0.2)
    assert found.total > whole[0] - old[0] + constant + 1.0
    assert found.explains


@pytest.mark.parametrize(("spread", "told"), [(0.5, True), (0.2, False)])
def test_a_cause_that_acts_like_an_effect_is_told(spread, told):
    records = [ramps(seed, 0.3, spread) for seed in range(6)]
    report = diagnose(DRIFT, [RAMP], records, options=Options(bootstrap=0, advice=False))
    text = "A cause that acts like ramp, but with another law"
    assert (report.verdict is Verdict.UNKNOWN) is told
    assert (text in report.statement) is told
