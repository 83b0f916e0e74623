"""Tolerances that records refute, on Gaussian posteriors whose closed forms are known.

Parameter j moves a block of samples of its own: with n samples of noise SIGMA, a prior N(0, SD^2)
and the mean m of the block, its fitted value is m k / (k + 1) with k = n SD^2 / SIGMA^2.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from feltmb.fit.noise import Noise
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Candidate, Effect, LinearModel, Parameter, Record, Sensor
from feltmb.gap.acceptance import refutes
from feltmb.gap.criteria import ALPHA, RIVAL, SURE, TOLERATED, least_odds
from feltmb.gap.evidence import full_evidence
from feltmb.gap.investigate import Task, _search
from feltmb.gap.options import Options
from feltmb.gap.proof import HeldOut, evaluate
from feltmb.gap.refine import CandidateSet, refit
from feltmb.gap.score import score_fit
from feltmb.gap.search import Search
from feltmb.gap.tolerance import (
    beyond_prior,
    by_few_numbers,
    evidence_of_release,
    refuted_tolerances,
    released,
    without_several,
)

SIGMA, SD, N = 0.5, 1.0, 40
SETTINGS = FitSettings(restarts=0)
#: Residuals of a block: no mean, no trend, and the sum of squares of noise.
QUIET = SIGMA * np.tile([1.0, -1.0, -1.0, 1.0], N // 4)


def blocks(count, sd=SD):
    def column(j):
        return lambda r: (r.inputs["block"] == j).astype(float)

    return LinearModel(
        output="y",
        columns={f"p{j}": column(j) for j in range(count)},
        parameters=[Parameter(name=f"p{j}", value=0.0, sd=sd) for j in range(count)],
    )


def measured(means, rest=QUIET, name="a"):
    u = np.repeat(np.arange(len(means)), N).astype(float)
    y = np.repeat(np.asarray(means, dtype=float), N) + np.tile(rest, len(means))
    return Record(
        name=name, time=np.arange(u.size) * 1e-2, inputs={"block": u}, outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=SIGMA)},
    )  # fmt: skip


def fitted(means, sd=SD, rest=QUIET):
    model = blocks(len(means), sd)
    segmented = segment_record(model, measured(means, rest), {"y": Noise(SIGMA)}, None)
    return fit_problem(Problem(model, (segmented,)), SETTINGS)


def shrunk(mean, sd=SD):
    k = N * sd**2 / SIGMA**2
    return mean * k / (k + 1.0)


def more_of(name, tolerance="", scale=1.0):
    j = float(name[1:])
    return Candidate(
        Effect(
            name=f"more of {name}", component="c", scale=scale, tolerance_parameter=tolerance,
            regressor=lambda r, s: (r.inputs["block"] == j).astype(float),
        )
    )  # fmt: skip


def searched(fit, candidates=(), sets=()):
    return Search(
        model_fit=fit,
        scores=score_fit(fit, tuple(candidates)),
        tight=None,
        tight_fit=None,
        sets=tuple(sets),
        model_evidence=full_evidence(fit, 1.0),
        failed=(),
        total=1.0,
    )


# ---------------------------------------------------------------- by few numbers


def test_few_numbers_are_those_beyond_their_tolerance():
    """One of ten, and as many as are allowed."""
    one, two = fitted([10.0] + [0.0] * 9), fitted([10.0, -10.0] + [0.0] * 8)
    assert beyond_prior(one) == pytest.approx({"p0": shrunk(10.0)})
    assert [by_few_numbers(one, most) for most in (0, 1, 2)] == [False, True, True]
    assert [by_few_numbers(two, most) for most in (1, 2)] == [False, True]
    assert not by_few_numbers(fitted([0.0] * 10), 5)  # none is beyond


@pytest.mark.parametrize("side", [-1, 1])
def test_a_parameter_is_beyond_at_a_multiple_of_what_its_tolerance_allows(side):
    """The change has the variance SD^2 k / (k + 1)."""
    k = N * SD**2 / SIGMA**2
    limit = TOLERATED * math.sqrt(k / (k + 1.0))  # of the fitted value
    mean = side * limit * (k + 1.0) / k
    assert not by_few_numbers(fitted([0.999 * mean] + [0.0] * 9), 1)
    assert by_few_numbers(fitted([1.001 * mean] + [0.0] * 9), 1)


def test_the_others_are_where_their_priors_allow_as_a_whole():
    """Nine of them: sum of z^2 below 9 + 4 sqrt(18), each far from its own limit."""
    limit = math.sqrt((9 + 4.0 * math.sqrt(18.0)) / 9.0)
    per = limit / shrunk(1.0)
    assert limit < TOLERATED
    assert by_few_numbers(fitted([10.0] + [0.999 * per] * 9), 1)
    assert not by_few_numbers(fitted([10.0] + [1.001 * per] * 9), 1)


def test_few_numbers_must_explain_the_records():
    loud = fitted([10.0] + [0.0] * 9, rest=1.3 * QUIET)
    assert not loud.explains
    assert len(beyond_prior(loud)) == 1
    assert not by_few_numbers(loud, 1)


# ---------------------------------------------------------------- without several


#: A prior as narrow as the information of its block: the fit goes half of the way.
NARROW = SIGMA / math.sqrt(N)


def test_several_refuted_tolerances_are_not_used():
    """The two are at the means of their blocks, the third stays where its prior holds it."""
    means = [8.0 * NARROW, -8.0 * NARROW, NARROW]
    fit = fitted(means, NARROW)
    assert fit.point.theta == pytest.approx(0.5 * np.array(means))
    assert sorted(beyond_prior(fit)) == ["p0", "p1"]
    freed = without_several(fit, SETTINGS)
    assert freed.point.theta == pytest.approx([means[0], means[1], 0.5 * means[2]])
    assert [i.sd for i in freed.intervals()] == pytest.approx(
        [NARROW, NARROW, NARROW / math.sqrt(2.0)]
    )
    assert refuted_tolerances(freed) == [
        "the records refute the tolerance of p0, p1: the fit does not use it"
    ]


def test_one_refuted_tolerance_is_a_cause_and_stays():
    fit = fitted([8.0 * NARROW, 0.0, 0.0], NARROW)
    assert len(beyond_prior(fit)) == 1
    assert without_several(fit, SETTINGS) is fit


def test_tolerances_stay_where_the_fit_explains_nothing_or_is_torn():
    means = [8.0 * NARROW, -8.0 * NARROW, 0.0]
    loud = fitted(means, NARROW, rest=1.6 * QUIET)
    assert len(beyond_prior(loud)) == 2
    assert without_several(loud, SETTINGS) is loud
    # Explained without the priors alone: it is the search that has to say so.
    strained = fitted([20.0 * NARROW, -20.0 * NARROW, 0.0], NARROW)
    assert not strained.explains
    assert without_several(strained, SETTINGS) is strained
    fit = fitted(means, NARROW)
    loose = 2.0 * SETTINGS.levels[-1]
    torn = replace(fit, defect_sd=np.ones(1), level=loose)
    assert without_several(torn, SETTINGS) is torn


def both():
    """An effect that moves the first block up and the second one down."""
    return Effect(
        name="both", component="c", scale=1.0,
        regressor=lambda r, s: (r.inputs["block"] == 0.0) * 1.0 - (r.inputs["block"] == 1.0) * 1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("means", "named"),
    [
        ((8.0, -8.0, 0.0), True),  # what one effect does, two tolerances imitate
        ((8.0, 0.0, -8.0), False),  # no effect does this
    ],
)
def test_an_effect_competes_with_several_refuted_tolerances(means, named):
    """Log evidence of both in closed form; the better one is searched from."""
    means = NARROW * np.array(means)
    model = blocks(3, NARROW)
    segmented = (segment_record(model, measured(means), {"y": Noise(SIGMA)}, None),)
    task = Task([both()], Options(), SETTINGS, None, None)
    found = _search(model, segmented, task)
    fit = fitted(means, NARROW)
    freed = without_several(fit, SETTINGS)
    assert freed is not fit
    assert bool(refuted_tolerances(found.model_fit)) is not named
    # Released, nothing of the refuted ones is left. Each is charged as an effect.
    far = [m / NARROW for m in means if abs(m) / NARROW > 5.0]
    charged = sum(0.5 + math.log(abs(z)) + math.log(3) for z in far)
    assert evidence_of_release(fit, freed) == pytest.approx(
        full_evidence(freed, 1.0) - charged, abs=1e-6
    )
    assert (found.best is not None and found.best.names == ("both",)) is named
    if named:
        assert found.best.evidence > evidence_of_release(fit, freed)


# ---------------------------------------------------------------- released


def test_a_refuted_tolerance_does_not_bias_what_is_reported():
    """The posterior without the prior: the mean of the block, SIGMA / sqrt(N)."""
    mean = 8.0 * NARROW
    fit = fitted([mean, NARROW], NARROW)
    lookalike, other = more_of("p0", "p0"), more_of("p1")
    found = released(searched(fit, [lookalike, other]), SETTINGS, alpha=ALPHA, estimated=False)
    assert fit.point.theta[0] == pytest.approx(0.5 * mean)
    assert found.model_fit.point.theta == pytest.approx([mean, 0.5 * NARROW])
    assert found.model_fit.intervals()[0].sd == pytest.approx(NARROW)
    assert refuted_tolerances(found.model_fit) == [
        "the records refute the tolerance of p0: the fit does not use it"
    ]
    # An effect that is more of this parameter says nothing beside it.
    assert [t.name for t in found.scores.candidates] == ["more of p1"]
    assert found.model_evidence == pytest.approx(full_evidence(found.model_fit, 1.0))
    # -1/2 chi^2 - 1/2 log det, without what the prior took: z^2 / 4 of both, and log 2 of p0.
    z = mean / NARROW
    assert found.model_evidence - full_evidence(fit, 1.0) == pytest.approx(
        0.25 * z**2 + 0.5 * math.log(2.0)
    )


def test_tolerances_within_their_limits_are_kept():
    fit = fitted([2.0 * NARROW, 0.0], NARROW)
    assert released(searched(fit), SETTINGS, alpha=ALPHA, estimated=False) is None


def test_nothing_is_released_where_the_records_are_not_explained():
    loud = fitted([8.0 * NARROW, 0.0], NARROW, rest=1.6 * QUIET)
    assert beyond_prior(loud)
    assert released(searched(loud), SETTINGS, alpha=ALPHA, estimated=False) is None
    # Noise as it should be in sum, but a slow signal: the model explains it, something is left.
    slow = 0.65 * np.sin(2.0 * np.pi * np.arange(N) / N)
    rest = math.sqrt(1.0 - 0.5 * (0.65 / SIGMA) ** 2) * QUIET + slow
    signal = fitted([8.0 * NARROW, 0.0], NARROW, rest=rest)
    assert signal.explains
    assert released(searched(signal), SETTINGS, alpha=ALPHA, estimated=False) is None


def level_of(fit, means):
    """Evidence of the released fit, its departure counted as the magnitude of an effect."""
    free = released(searched(fit), SETTINGS, alpha=ALPHA, estimated=False)
    z = max(1.0, abs(means[0]) / NARROW)
    return free.model_evidence - 0.5 - math.log(z) - math.log(len(means)), free.model_evidence


@pytest.mark.parametrize(
    ("tolerance", "distance"), [("", RIVAL), ("p0", 0.0)], ids=["beside it", "more of it"]
)
def test_other_sets_that_explain_the_records_keep_the_tolerance(tolerance, distance):
    """A rival within odds of twenty; more of the same parameter where it is better."""
    means = [8.0 * NARROW, 0.0]
    fit = fitted(means, NARROW)
    level, own = level_of(fit, means)
    candidate = more_of("p1" if not tolerance else "p0", tolerance)
    other = replace(fit, problem=fit.problem.with_candidates((candidate,)))

    def found(evidence):
        near = replace(searched(fit, sets=[CandidateSet(other, evidence)]), model_evidence=1e9)
        return released(near, SETTINGS, alpha=ALPHA, estimated=False)

    assert found(level - distance + 0.01) is None
    kept = found(level - distance - 0.01)
    assert kept.model_fit.point.theta[0] == pytest.approx(means[0])
    if tolerance:  # the same explanation in other words
        assert kept.sets == ()
    else:  # as far behind as before
        assert kept.sets[0].evidence == pytest.approx(own - distance - 0.01)


def test_the_best_set_that_is_more_of_a_parameter_is_the_same_explanation():
    """Others are compared with its evidence, where that is more than that of the released fit."""
    fit = fitted([8.0 * NARROW, 0.0], NARROW)
    best = refit(fit, (more_of("p0", "p0"),), np.zeros(1), SETTINGS)
    beside = replace(fit, problem=fit.problem.with_candidates((more_of("p1"),)))
    evidence = full_evidence(fit, 1.0) + 500.0

    def found(distance):
        sets = [CandidateSet(best, evidence), CandidateSet(beside, evidence - distance)]
        return released(searched(fit, sets=sets), SETTINGS, alpha=ALPHA, estimated=False)

    assert found(RIVAL - 0.01) is None
    kept = found(RIVAL + 0.01)
    assert kept.model_fit.point.theta[0] == pytest.approx(8.0 * NARROW)
    (other,) = kept.sets
    assert other.evidence == pytest.approx(kept.model_evidence - RIVAL - 0.01)


# ---------------------------------------------------------------- refutes


def normal_log(y, mean, covariance):
    rest = y - mean
    return -0.5 * (rest @ np.linalg.solve(covariance, rest) + np.linalg.slogdet(covariance)[1])


def test_held_out_records_refute_at_ten_to_one():
    """Predictive densities N(x m, SIGMA^2 I + v x x') of the two posteriors of one parameter."""
    free, tied = fitted([8.0 * NARROW], np.inf), fitted([8.0 * NARROW], NARROW)
    rest = np.zeros(N)

    def gain(mean):
        y = np.full(N, mean) + rest
        out = []
        for fit, part in ((free, 1.0), (tied, 0.5)):
            own = SIGMA**2 * np.eye(N) + part * NARROW**2 * np.ones((N, N))
            assert fit.point.theta[0] == pytest.approx(part * 8.0 * NARROW)
            out.append(normal_log(y, np.full(N, part * 8.0 * NARROW), own))
        return out[0] - out[1]

    def outcome(fit, mean):
        record = measured([mean], rest, name="held")
        segmented = segment_record(fit.problem.model, record, {"y": Noise(SIGMA)}, None)
        held = HeldOut((segmented,), np.zeros(0), (segmented,))
        return evaluate(held, fit, SETTINGS)

    def refuted(mean):
        old, new = outcome(tied, mean), outcome(free, mean)
        found = float(np.sum(new.density - old.density))
        assert found == pytest.approx(gain(mean), rel=1e-6, abs=1e-6)
        return refutes(SimpleNamespace(after=old), SimpleNamespace(before=new), SURE)

    from scipy.optimize import brentq

    edge = brentq(lambda m: gain(m) + least_odds(SURE), 4.0 * NARROW, 8.0 * NARROW)
    assert refuted(edge - 0.01 * NARROW)  # where the tolerance held, and the free fit did not
    assert not refuted(edge + 0.01 * NARROW)
    assert not refuted(8.0 * NARROW)
