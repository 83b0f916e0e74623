"""Errors of form of the laws of effects."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from feltmb.data import Record, Sensor
from feltmb.fit.linear import LinearModel
from feltmb.fit.model import Candidate, Effect, Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, finish, fit_problem, polish
from feltmb.gap import Options, Verdict, acceptance, diagnose, evidence
from feltmb.gap.criteria import FORM_ERROR, OTHER_LAW
from feltmb.gap.evidence import forms_of, full_evidence, other_laws
from feltmb.gap.proof import HELD_OUT_LEVEL, HeldOut, evaluate
from feltmb.gap.refine import refit
from feltmb.gap.search import search

sys.path.insert(0, str(Path(__file__).parent))
from test_law_errors import (
    COUNT,
    DRIFT,
    EARLY,
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


def test_errors_of_form_are_compared_once_for_a_fit(monkeypatch):
    fit, asked, known = ramp_fit([ramps(0, 0.3, 0.0)]), [], evidence.linear_evidence

    def counted(*given):
        asked.append(given)
        return known(*given)

    monkeypatch.setattr(evidence, "linear_evidence", counted)
    forms = [forms_of(fit) for _ in range(3)]
    full_evidence(fit, 1.0)
    assert len(asked) == len(forms[0].gains) == 2
    assert all(f is forms[0] for f in forms)
    forms_of(replace(fit, level=fit.level))
    assert len(asked) == 4


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


def test_a_fit_that_failed_has_exact_laws():
    fit = ramp_fit([drift(seed, 0.0) for seed in range(2)])
    failed = replace(fit, log_evidence=-np.inf)
    assert len(forms_of(failed).gains) == 1
    assert other_laws(failed) == [-np.inf]


def test_one_segment_shows_no_error_of_form():
    record = ramps(0, 0.3, 0.3)
    whole = segment_record(DRIFT, record, {"x": Noise(SIGMA)}, None, np.array([[0, COUNT - 1]]))
    fit = fit_problem(Problem(DRIFT, (whole,)))
    fit = refit(fit, (Candidate(RAMP),), np.array([0.3]), FitSettings())
    assert forms_of(fit).inexact[0].size == 0
    assert len(forms_of(fit).gains) == 1
    assert other_laws(fit) == [-np.inf]


def held_out(size, spread, of_others):
    """A fit with its result on held-out records, and their exact densities by the two laws."""
    records = [ramps(seed, size, spread) for seed in range(4)]
    others = [ramps(seed, size, of_others) for seed in (20, 21)]
    tight = ramp_fit(records, size)
    fit = polish(tight.problem, tight.point, HELD_OUT_LEVEL, FitSettings())
    seen = tuple(segment_record(DRIFT, r, {"x": Noise(SIGMA)}, None, SEGMENT) for r in others)
    found = evaluate(HeldOut(seen, fit.defect_sd / fit.level, seen), fit, FitSettings())
    whole, old = (
        np.array([density(several, fit, q) for q in (0.0, FORM_ERROR)])
        for several in ([*records, *others], records)
    )
    constant = sum(s.samples.sum() for s in seen) * np.log(np.sqrt(2.0 * np.pi) * SIGMA)
    return found, whole - old + constant, old - logsumexp(old)


def test_held_out_records_are_predicted_with_the_errors_of_form():
    """An effect with an inexact law is not refuted by records where it has another magnitude."""
    found, laws, weights = held_out(0.3, 0.04, 0.04)
    assert found.total == pytest.approx(logsumexp(laws + weights), abs=0.2)
    assert found.total > laws[0] + 1.0
    assert found.explains


def test_the_fitted_records_give_the_weights_of_exact_and_inexact_laws():
    found, laws, weights = held_out(0.05, 0.0, 0.3)
    assert -6.0 < weights[1] < -5.0
    # Deviations are relative to the magnitude that is likeliest with the held-out records.
    assert found.total == pytest.approx(logsumexp(laws + weights), abs=2.0)
    assert laws[0] + 10.0 < found.total < laws[1] - 4.0


@pytest.mark.parametrize(("spread", "told"), [(0.5, True), (0.2, False)])
def test_a_cause_that_acts_like_an_effect_is_told(spread, told):
    records = [ramps(seed, 0.3, spread) for seed in range(6)]
    report = diagnose(DRIFT, [RAMP], records, options=Options(bootstrap=0, advice=False))
    text = "A cause that acts like ramp, but with another law"
    assert (report.verdict is Verdict.UNKNOWN) is told
    assert (text in report.statement) is told


def two_effects(seed=1):
    records = [
        replace(r, outputs={"x": r.outputs["x"] + 0.05 * np.minimum(r.time, 0.4)})
        for r in (ramps(10 * seed + k, 0.3, 0.0) for k in range(2))
    ]
    return search(fitted(records), [RAMP, EARLY], FitSettings(restarts=0), most=2)


@pytest.mark.parametrize(
    ("where", "odds", "like"),
    [
        (("early", "ramp"), 90.0, "early"),  # the set without the effect, and an unknown cause
        (("early",), 500.0, "early"),  # an unknown cause alone
        (("ramp",), -0.5, ""),  # less probable than the effect
    ],
)
def test_another_law_belongs_to_the_set_without_its_effect(monkeypatch, where, odds, like):
    found = two_effects()
    asked = []

    def laws(fit):
        names = [t.name for t in fit.included]
        asked.append(tuple(sorted(names)))
        wanted = asked[-1] == where
        return np.array([odds if wanted and n == (like or "ramp") else -np.inf for n in names])

    monkeypatch.setattr(acceptance, "other_laws", laws)
    monkeypatch.setattr(acceptance, "NEAR_BEST", np.inf)
    belief = acceptance.posterior(found, FitSettings())
    sets = dict(zip([c.key for c in found.sets], belief.sets, strict=True))
    assert set(asked) == set(sets) == {("early",), ("ramp",), ("early", "ramp")}
    assert belief.like == like
    if where == ("early", "ramp"):
        assert sets["ramp",] > 0.99
    elif odds > 0.0:
        assert belief.other > 0.99
    asked.clear()
    monkeypatch.setattr(acceptance, "NEAR_BEST", 1e-9)
    acceptance.posterior(found, FitSettings())
    assert asked == [found.sets[0].key]  # the others are no alternative


LINE = LinearModel(
    output="y",
    columns={"slope": lambda record: record.inputs["u"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    name="line",
)
CUBE = Effect(
    name="cube",
    component="spring",
    unit="1",
    scale=0.1,
    regressor=lambda record, shape: record.inputs["u"] ** 3,
)


def cubes(seed, size, count=60):
    u = np.sin(np.linspace(0.0, 9.0, count) + seed)
    noise = SIGMA * np.random.default_rng(seed).standard_normal(count)
    return Record(
        name=f"r{seed}",
        time=np.arange(count) * 1e-3,
        inputs={"u": u},
        outputs={"y": 1.02 * u + size * u**3 + noise},
        sensors={"y": Sensor(name="y", unit="1", sigma=SIGMA)},
    )


def density_of_cubes(records, size, share):
    """As :func:`density`, of the model without states."""
    u = np.concatenate([r.inputs["u"] for r in records])
    width = max(CUBE.scale, abs(size))
    cover = SIGMA**2 * np.eye(u.size) + 0.1**2 * np.outer(u, u) + width**2 * np.outer(u**3, u**3)
    which = np.repeat(np.arange(len(records)), [r.samples for r in records])
    cover += (share * size) ** 2 * np.outer(u**3, u**3) * (which[:, None] == which)
    seen = np.concatenate([r.outputs["y"] for r in records])
    return multivariate_normal(u + size * u**3, cover).logpdf(seen)


@pytest.mark.parametrize("spread", [0.0, 0.02])
def test_without_states_the_magnitude_deviates_between_records(spread):
    sizes = 0.3 * (1.0 + spread * np.array([1.0, -1.5, 0.5, -0.2, 1.2, -1.0]))
    records = [cubes(seed, size) for seed, size in enumerate(sizes)]
    whole = np.array([[0, records[0].samples - 1]])

    def segmented(several):
        return tuple(segment_record(LINE, r, {"y": Noise(SIGMA)}, None, whole) for r in several)

    fitted_ones, others = records[:4], records[4:]
    fit = fit_problem(Problem(LINE, segmented(fitted_ones)))
    fit = refit(fit, (Candidate(CUBE),), np.array([0.3]), FitSettings())
    size = float(fit.point.magnitudes[0])
    old, both = (
        np.array([density_of_cubes(several, size, q) for q in (0.0, FORM_ERROR)])
        for several in (fitted_ones, records)
    )
    assert forms_of(fit).gains == pytest.approx(old - old[0], abs=0.02)
    assert (forms_of(fit).gain > 1.0) is (spread > 0.0)
    held = HeldOut(segmented(others), np.zeros(0), segmented(others))
    found = evaluate(held, fit, FitSettings())
    constant = 120 * np.log(np.sqrt(2.0 * np.pi) * SIGMA)
    assert found.total == pytest.approx(logsumexp(both) - logsumexp(old) + constant, abs=0.2)
    assert found.explains
