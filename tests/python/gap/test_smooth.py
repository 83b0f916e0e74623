"""The unknown smooth rest of fits without gaps: against dense covariances, and its null law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Array, Record, Sensor
from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.model import Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import Fit, fit_problem
from feltmb.gap import smooth
from feltmb.gap.criteria import ALPHA, FORM, FORM_LEFT, unknown_gain
from feltmb.gap.misfit import allowance, form_of, misfit

TIME = np.linspace(0.0, 1.0, 201)
SIGMA = 0.02
COLUMNS = {
    "offset": lambda r: np.ones(r.samples),
    "slope": lambda r: r.time,
    "wave": lambda r: np.sin(9.0 * r.time),
}
NOMINAL = LinearModel(
    output="y",
    columns=COLUMNS,
    parameters=[Parameter(name="offset", value=0.0, sd=0.1), Parameter(name="slope", value=0.0)],
    segment=10.0,
)


def noise(generator: np.random.Generator, tau: float) -> Array:
    white = generator.standard_normal(TIME.size)
    if tau == 0.0:
        return SIGMA * white
    decay = np.exp(-(TIME[1] - TIME[0]) / tau)
    out = np.empty_like(white)
    out[0] = white[0]
    for i in range(1, white.size):
        out[i] = decay * out[i - 1] + np.sqrt(1.0 - decay**2) * white[i]
    return SIGMA * out


def fitted(seed: int, *, tau: float = 0.0, extra: float = 0.0) -> Fit:
    generator = np.random.default_rng(seed)
    segmented_records = []
    for name in ("one", "two"):
        y = 0.05 + 0.3 * TIME + 0.2 * np.sin(9.0 * TIME) + noise(generator, tau)
        y = y + extra * SIGMA * np.cos(22.0 * TIME)
        sensor = Sensor(name="y", sigma=SIGMA, correlation_time=tau)
        record = Record(name=name, time=TIME, inputs={}, outputs={"y": y}, sensors={"y": sensor})
        segmented_records.append(segment_record(NOMINAL, record, {"y": Noise(SIGMA, tau)}, None))
    return fit_problem(Problem(NOMINAL, tuple(segmented_records)))


@pytest.mark.parametrize("tau", [0.0, 0.004])
def test_it_is_the_ratio_of_two_likelihoods(tau: float) -> None:
    """Two dense covariances of all samples, without a word of cosines that are whitened."""
    fit = fitted(1, tau=tau, extra=0.8)
    n = TIME.size
    near = np.abs(TIME[:, None] - TIME[None, :])
    one = SIGMA**2 * (np.exp(-near / tau) if tau else np.eye(n))
    zero = np.zeros_like(one)
    # A wide prior stands for none: it adds the same to both.
    sd = np.array([0.1, 1e3, 1e3])
    record = fit.problem.segmented_records[0].record
    design = np.column_stack([f(record) for f in COLUMNS.values()]) * sd
    both = np.vstack([design, design])
    noisy = np.block([[one, zero], [zero, one]]) + both @ both.T
    measured = np.concatenate([s.record.outputs["y"] for s in fit.problem.segmented_records])
    best = 0.0
    for share in smooth.LENGTHS:
        k = np.arange(smooth.MOST)
        rate = np.pi * k[np.pi * k * tau <= smooth.SLOW_COLOR]
        basis = np.cos(rate * TIME[:, None]) / (1.0 + (rate * share) ** 2 / 3.0) * SIGMA
        kernel = basis @ basis.T
        signal = np.block([[kernel, zero], [zero, kernel]])
        base = -0.5 * measured @ np.linalg.solve(noisy, measured)
        base -= 0.5 * np.linalg.slogdet(noisy)[1]
        for s2 in np.logspace(-4.0, 1.0, 21):
            total = noisy + s2 * signal
            value = -0.5 * measured @ np.linalg.solve(total, measured)
            value -= 0.5 * np.linalg.slogdet(total)[1]
            best = max(best, value - base)
    assert best > 5.0
    found = smooth.smooth_discrepancy(fit)
    assert found.largest == pytest.approx(best, rel=0.02, abs=0.1)
    # The peak is a part of the mean, and no mean exceeds its largest part.
    assert best - np.log(4.0 * smooth.AMPLITUDES.size) - 0.1 < found.mean < best


def test_noise_alone_is_no_smooth_rest() -> None:
    found = np.array([smooth.smooth_discrepancy(fitted(s)).largest for s in range(60)])
    # Half a chi-square of one degree of freedom, the largest of four lengths that see alike.
    assert np.mean(found > 1.92) < 0.12
    assert found.max() < unknown_gain(ALPHA)


def test_a_smooth_gap_is_seen_that_the_sum_of_squares_cannot_see() -> None:
    fit = fitted(3, extra=0.45)
    gap = misfit(fit, None, alpha=ALPHA, estimated=False)
    least = max(unknown_gain(ALPHA), allowance(fit))
    assert fit.chi2 - fit.dof < 4.0 * np.sqrt(2.0 * fit.dof)
    assert gap.other > least
    assert gap.left
    calm = fitted(3)
    assert not misfit(calm, None, alpha=ALPHA, estimated=False).left
    # Beside what named effects explain it may be their form: 0.3 % of the motion at 3 %.
    enough = (gap.other - least) / (FORM_LEFT * FORM) ** 2
    for share, left in ((1.01, False), (0.99, True)):
        allowed = form_of(share * enough, FORM)
        assert misfit(fit, None, alpha=ALPHA, estimated=False, allowed=allowed).left is left
    assert form_of(enough, 0.0) == 0.0


def test_a_residual_far_below_the_noise_is_no_gap_however_long_the_record(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A wave with an rms of 0.08 of the noise gains n 0.0064 / 2 = 26 units of log evidence."""
    long = np.linspace(0.0, 1.0, 4001)
    monkeypatch.setitem(globals(), "TIME", long)
    seen = [fitted(3, extra=np.sqrt(2.0) * share) for share in (0.08, 0.14)]
    small, large = (misfit(f, None, alpha=ALPHA, estimated=False) for f in seen)
    assert unknown_gain(ALPHA) < small.other < allowance(seen[0])
    assert allowance(seen[0]) == pytest.approx(0.005 * 8000)
    assert not small.left
    assert large.left


def test_segments_and_missing_samples_are_allowed() -> None:
    fit = fitted(3, extra=0.45)
    record = fit.problem.segmented_records[0].record
    y = record.outputs["y"].copy()
    y[40:60] = np.nan
    cut = replace(record, outputs={"y": y})
    segmented = segment_record(NOMINAL, cut, {"y": Noise(SIGMA, 0.0)}, 0.25)
    assert segmented.count > 1
    assert smooth.smooth_discrepancy(fit_problem(Problem(NOMINAL, (segmented,)))).largest >= 0.0


def test_what_the_fit_can_take_up_altogether_is_no_signal() -> None:
    """One cosine, the constant, beside a free offset: nothing is left but rounding."""
    fit = fitted(5, tau=0.3)
    assert smooth.smooth_discrepancy(fit).largest == 0.0


def test_nothing_free_is_no_fault() -> None:
    fit = fitted(5)
    fixed = LinearModel(
        output="y",
        columns=COLUMNS,
        parameters=[Parameter(name=n, value=0.1, sd=0.0) for n in COLUMNS],
        segment=10.0,
    )
    segmented_records = tuple(
        segment_record(fixed, s.record, {"y": Noise(SIGMA)}, None)
        for s in fit.problem.segmented_records
    )
    assert smooth.smooth_discrepancy(
        fit_problem(Problem(fixed, segmented_records))
    ).largest > unknown_gain(ALPHA)


@pytest.mark.parametrize(
    "late", [lambda t: np.exp(8.0 * (t - 1.0)), lambda t: np.exp(-(((t - 0.8) / 0.05) ** 2))]
)
def test_parameters_that_the_beginning_does_not_show_are_found(late) -> None:
    """A model that is not linear, exact, without priors, whose last effect comes late."""
    model = FunctionModel(
        outputs={"y": lambda r, p: p.a * np.ones(r.samples) + np.sinh(p.b) * late(r.time)},
        parameters=[Parameter(name="a", value=0.0), Parameter(name="b", value=0.1)],
        segment=10.0,
    )
    y = 0.5 + np.sinh(1.5) * late(TIME) + noise(np.random.default_rng(2), 0.0)
    sensor = Sensor(name="y", sigma=SIGMA)
    record = Record(name="one", time=TIME, inputs={}, outputs={"y": y}, sensors={"y": sensor})
    segmented = segment_record(model, record, {"y": Noise(SIGMA)}, None)
    assert fit_problem(Problem(model, (segmented,))).explains


def test_a_parameter_at_its_limit_cannot_make_a_signal_without_bound() -> None:
    """A limit stops the slope at 0.1 of 0.3: the residual is a signal of this slope, no more.

    The residual was that of a slope that is stopped, and the signals that a free slope leaves.
    """
    fit = fitted(3)
    slope = Parameter(name="slope", value=0.0, upper=0.1)
    offset = NOMINAL.parameters[0]
    stopped = LinearModel(
        output="y", columns=COLUMNS, parameters=[offset, slope, Parameter(name="wave", value=0.2)],
        segment=10.0,
    )  # fmt: skip
    records = [s.record for s in fit.problem.segmented_records]
    parts = tuple(segment_record(stopped, r, {"y": Noise(SIGMA)}, None) for r in records)
    held = fit_problem(Problem(stopped, parts))
    assert held.point.theta[1] == pytest.approx(0.1)
    found = smooth.smooth_discrepancy(held).largest
    assert found > 100.0
    assert found < 0.5 * held.chi2
