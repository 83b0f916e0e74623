"""Effective samples and log evidence against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from unmodeled import LinearModel, Parameter
from unmodeled.search.evidence import DISCREPANCY, effective_share, log_evidence, precision, weights
from unmodeled.search.fit import Start, empty_point, fit_sets
from unmodeled.search.options import Options
from unmodeled.search.records import prepare, ready_records

from .conftest import SIGMA, spring_record


def test_share_of_white_noise_is_one():
    series = [np.random.default_rng(k).standard_normal(4000) for k in range(3)]
    assert effective_share(series) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("phi", [0.5, 0.9])
def test_share_of_a_first_order_process(phi):
    rng, x = np.random.default_rng(1), np.zeros(200_000)
    e = rng.standard_normal(x.size)
    for i in range(1, x.size):
        x[i] = phi * x[i - 1] + e[i]
    # 1 + 2 sum phi^k = (1 + phi) / (1 - phi)
    assert effective_share([x]) == pytest.approx((1.0 - phi) / (1.0 + phi), rel=0.15)


def test_a_repeated_residual_counts_once():
    period = np.random.default_rng(0).standard_normal(50)
    few, many = effective_share([np.tile(period, 4)]), effective_share([np.tile(period, 16)])
    # Four times as many repeats tell nothing more: the number of effective samples stays.
    assert many * 16 == pytest.approx(few * 4, rel=0.35)


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
        fitted = type(fitted)(
            fitted.members, fitted.point, fitted.linears, np.ones(1), fitted.share
        )
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
    assert counts[1] <= 1.2 * DISCREPANCY


def test_the_channels_of_a_record_share_one_discrepancy():
    """One law that is wrong moves all channels: two of them are no more evidence than one."""
    random = np.full(2, 1e-6)
    for square in (np.array([26.0]), np.array([26.0, 26.0]), np.array([26.0, 1.0])):
        samples = (square - 1.0) * precision(square, random[: square.size])
        assert samples.sum() == pytest.approx(DISCREPANCY, rel=0.01)
    alone = precision(np.array([26.0, 1.0]), random)  # the other channel has noise only
    assert alone[1] == pytest.approx(1e6)
    white = precision(np.ones(2), random)  # noise alone is independent
    assert white == pytest.approx(1.0 / random)
