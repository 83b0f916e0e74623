"""Effective samples and log evidence against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from unmodeled import LinearModel, Parameter
from unmodeled.search.evidence import (
    OWN_SCALE,
    Prior,
    effective_share,
    local_penalty,
    log_evidence,
    misfit,
    penalty_of_records,
    precision,
    system,
    weights,
)
from unmodeled.search.fit import Start, empty_point, fit_sets
from unmodeled.search.linear import EvaluationRequest, Linear, Point, evaluate
from unmodeled.search.options import Options
from unmodeled.search.problem import STRICT, TRUSTED, Local, Member
from unmodeled.search.records import prepare, ready_records

from .conftest import SIGMA, spring_record


def share_of(series):
    """Share of residuals of one channel by record."""
    none = np.zeros((0, 1, 0))
    return effective_share([Linear(x[:, None], none, none, none) for x in series], np.ones(1))


def test_share_of_white_noise_is_one():
    series = [np.random.default_rng(k).standard_normal(4000) for k in range(3)]
    assert share_of(series) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("phi", [0.5, 0.9])
def test_share_of_a_first_order_process(phi):
    rng, x = np.random.default_rng(1), np.zeros(200_000)
    e = rng.standard_normal(x.size)
    for i in range(1, x.size):
        x[i] = phi * x[i - 1] + e[i]
    # 1 + 2 sum phi^k = (1 + phi) / (1 - phi)
    assert share_of([x]) == pytest.approx((1.0 - phi) / (1.0 + phi), rel=0.15)


def test_a_repeated_residual_counts_once():
    period = np.random.default_rng(0).standard_normal(50)
    few, many = share_of([np.tile(period, 4)]), share_of([np.tile(period, 16)])
    # Four times as many repeats tell nothing more: the number of effective samples stays.
    assert many * 16 == pytest.approx(few * 4, rel=0.35)


def test_the_fewest_samples_that_tell_a_share():
    assert share_of([np.ones(3)]) == 1.0
    # One lag with the autocorrelation 3/4, of which 1/4 is chance.
    assert share_of([np.ones(4)]) == pytest.approx(1.0 / (1.0 + 2.0 * (0.75**2 - 0.25)))


def test_a_comparison_that_is_made_again_costs_nothing(monkeypatch):
    problem, fitted = _fitted(95.0, 10.0, spring_record("fit", 2))
    weight = np.array([0.5])
    found = log_evidence(problem, fitted, weight)
    assert log_evidence(problem, fitted, 2.0 * weight) != found
    monkeypatch.setattr("unmodeled.search.evidence.system", None)
    assert log_evidence(problem, fitted, weight.copy()) == found


def _fitted(value, sd, record):
    model = LinearModel(
        name="spring",
        output="force",
        columns={"k": lambda r: r.inputs["x"], "f0": lambda r: np.ones_like(r.time)},
        parameters=[
            Parameter(name="k", value=value, sd=sd, unit="N/m"),
            Parameter(name="f0", value=0.0, sd=0.2, unit="N"),
        ],
    )
    held_out = spring_record("held out", 3, role="held_out")
    problem = prepare(ready_records(model, [record, held_out]), (), None, Options())
    (fitted,) = fit_sets(problem, [Start((), (empty_point(problem, (), problem.fit),))])
    return problem, fitted


def test_evidence_of_a_linear_model_is_the_marginal_likelihood():
    record = spring_record("fit", 2, seed=5)
    found, exact = [], []
    for value, sd in ((95.0, 10.0), (80.0, 3.0)):
        problem, fitted = _fitted(value, sd, record)
        fitted = replace(fitted, noise=np.ones(1))
        found.append(log_evidence(problem, fitted, np.ones(1)))
        x = np.column_stack([record.inputs["x"], np.ones(record.samples)])
        covariance = SIGMA**2 * np.eye(record.samples) + x @ np.diag([sd**2, 0.2**2]) @ x.T
        mean = x @ np.array([value, 0.0])
        exact.append(multivariate_normal(mean, covariance).logpdf(record.outputs["force"]))
    # The optimum depends on the noise that the fit left, which is nearly 1: second order.
    assert found[1] - found[0] == pytest.approx(exact[1] - exact[0], abs=0.05)


def test_a_discrepancy_counts_as_a_few_samples():
    counts = []
    for foreign in (0.0, 5.0):
        problem, fitted = _fitted(95.0, 10.0, spring_record("fit", 2, foreign=foreign, seed=5))
        counts.append(float((weights(problem, fitted, fitted) * problem.samples)[0]))
    assert counts[0] > 100.0
    assert 40.0 < counts[1] < 75.0  # as 60 in the search, and as 20 for a name
    assert (STRICT, TRUSTED) == (20.0, 60.0)


def test_the_channels_of_a_record_share_one_discrepancy():
    """One law that is wrong moves all channels: two of them are no more evidence than one."""
    random = np.full(2, 1e-6)
    for square in (np.array([26.0]), np.array([26.0, 26.0]), np.array([26.0, 1.0])):
        samples = (square - 1.0) * precision(square, random[: square.size], STRICT)
        assert samples.sum() == pytest.approx(STRICT, rel=0.01)
    alone = precision(np.array([26.0, 1.0]), random, STRICT)  # the other channel has noise only
    assert alone[1] == pytest.approx(1e6)
    white = precision(np.ones(2), random, STRICT)  # noise alone is independent
    assert white == pytest.approx(1.0 / random)


def test_a_start_that_is_not_known_takes_up_one_sample():
    problem, _ = _fitted(95.0, 10.0, spring_record("fit", 2))
    known, unknown = (Local("start", 0, 0.0, 1.0, weight) for weight in (1.0, 1e-6))
    fit = (replace(problem.fit[0], local=(known, unknown, unknown)),)
    assert (
        replace(problem, fit=fit, discrepancy_samples=20.0).discrepancy_samples_with_starts == 22.0
    )


def test_a_discrepancy_that_the_records_cannot_exclude_counts():
    """With white noise alone, small differences of many samples decide less than they seem to."""
    random = np.full(1, 1e-4)
    plain, careful = (precision(np.ones(1), random, STRICT, c)[0] for c in (0.0, 0.1))
    assert plain == pytest.approx(1e4)
    assert 0.3 * plain < careful < 0.5 * plain


def test_the_misfit_is_that_of_the_noise_that_is_left():
    samples = np.full(3, 100.0)
    left = misfit(samples, np.array([50.0, 100.0, 400.0]))
    # Below the noise of the sensor a square, above it the logarithm of the rms.
    assert left == pytest.approx([25.0, 50.0, 100.0 * np.log(2.0) + 50.0])


def test_sizes_by_record_have_a_common_variance_that_is_not_known():
    """Against the integral over the standard deviation, which is OWN_SCALE over a normal number."""
    for values in (np.array([0.3, -0.1, 0.2, 0.25]), np.full(12, 1.5), np.zeros(2)):

        def weighted(z, values=values):
            sd = OWN_SCALE / z
            ratio = values.size * np.log(sd) + 0.5 * (values**2).sum() / sd**2
            return 2.0 * norm.pdf(z) * np.exp(-ratio)

        density = quad(weighted, 0.0, 40.0, points=(0.01, 0.1, 1.0), limit=500)[0]
        found = penalty_of_records(float((values**2).sum()), values.size)
        assert found == pytest.approx(-2.0 * np.log(density), rel=1e-5)


def test_the_penalty_of_errors_of_each_record_has_its_slope_in_the_normal_equations(spring):
    records = [spring_record(f"r{k}", k, seed=k) for k in range(3)]
    problem = prepare(ready_records(spring, records), (), (), Options())
    (which,) = [i for i, c in enumerate(problem.causes) if c.name.startswith("offset of sensor")]
    members, values = (Member(which),), np.array([3.0, -4.0, 0.5])

    def at(x):
        point = empty_point(problem, members, problem.fit)
        return Point(point.x, tuple(np.array([v]) for v in x))

    def penalty(x):
        return local_penalty(problem, problem.fit, members, at(x))

    n = values.size
    assert penalty(values) == pytest.approx(penalty_of_records(25.25, n))
    nothing = [
        replace(x, residual=0.0 * x.residual)
        for x in evaluate(problem, [EvaluationRequest(members, at(values), problem.fit)])[0]
    ]
    own = system(problem, problem.fit, members, at(values), nothing, np.ones(1), 1.0)
    for k, (_, _, target) in enumerate(own.locals):
        step = 1e-5 * np.eye(n)[k]
        slope = (penalty(values + step) - penalty(values - step)) / 2e-5
        assert target == pytest.approx([-0.5 * slope])


def test_the_weights_of_a_prior_are_the_slope_of_its_penalty():
    prior = Prior(np.array([1.0, 4.0, 0.25]), np.array([True, False, True]))
    x, step = np.array([2.0, -0.7, 5.0]), 1e-5
    for k, moved in enumerate(step * np.eye(3)):
        slope = (prior.penalty(x + moved) - prior.penalty(x - moved)) / (2.0 * step)
        assert prior.weights(x)[k] * x[k] == pytest.approx(0.5 * slope, rel=1e-6)
