"""Residual of the best set as noise: another noise color, or an unexplained residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.model import Model
from feltmb.fit.segmented_records import Noise, SegmentedRecord, segment_record
from feltmb.fit.solve import Fit, FitSettings, polish
from feltmb.gap.criteria import (
    COLORED,
    GIVEN_SIGMA,
    NOISE_ERROR,
    STILL_SHRINKS,
    squares_of_noise,
)
from feltmb.gap.proof import residuals_by_segment
from feltmb.gap.search import Search

__all__ = [
    "Discrepancy",
    "color_of_discrepancy",
    "converged",
    "discrepancy_of",
    "larger_than_noise",
    "noise_factors",
    "only_white",
    "with_color",
    "with_factor",
    "with_noise",
]

#: Largest lag of the autocorrelation of a residual, in samples.
MOST_LAGS = 200


@dataclass(frozen=True)
class Discrepancy:
    """Residual of a channel, described as noise."""

    sigma: float
    """Standard deviation [unit], at the value zero if the noise of the sensor grows with it."""
    correlation_time: float | None
    """Correlation time [s]; None: only noise is left, with the color of each record's sensor."""
    factor: float
    """Residual over the noise of the sensors [1]."""


def discrepancy_of(
    search: Search, sensed: tuple[SegmentedRecord, ...], settings: FitSettings, alpha: float
) -> dict[str, Discrepancy] | None:
    """Describe the residual of the best set by channel, as correlated noise; None: only noise.

    If the library explains the records, this is not needed. If it does not, every effect that
    correlates with the residual would be significant against the noise of the sensors alone.

    Parameters
    ----------
    sensed
        The segmented records with the noise of the sensors.
    alpha
        Rate of false alarms (``Options.alpha``) [1].
    """
    best = search.model_fit if search.best is None else search.best.fit
    tight = best
    if best.defect_sd.size and not best.problem.model.chaotic:
        tight = polish(best.problem, best.point, settings.levels[-1], replace(settings, chain=True))
        if not np.isfinite(tight.cost):
            tight = best
    out = _described(tight, sensed, alpha)
    return out if any(d.correlation_time is not None for d in out.values()) else None


def larger_than_noise(fit: Fit, alpha: float) -> dict[str, Discrepancy]:
    """Residuals of a fit that are larger than the noise of the sensors, by channel.

    ``alpha``: rate of false alarms (``Options.alpha``) [1].
    """
    found = _described(fit, fit.problem.segmented_records, alpha)
    return {n: d for n, d in found.items() if d.correlation_time is not None}


def only_white(larger: Mapping[str, Discrepancy]) -> bool:
    """Whether more than the noise of the sensors is left, but nothing correlated in time.

    No effect can explain such a residual: the noise is larger than stated, or the time stamps have
    errors.

    Parameters
    ----------
    larger
        Result of :func:`larger_than_noise`.
    """
    return bool(larger) and all(d.correlation_time == 0.0 for d in larger.values())


def _sigma(segmented_records: Sequence[SegmentedRecord], channel: int, name: str) -> float:
    """Noise of a channel over the records that have it [unit]."""
    own = [s.noise[channel].sigma ** 2 for s in segmented_records if name in s.record.outputs]
    return float(np.sqrt(np.mean(own))) if own else 1.0


def _described(
    fit: Fit, sensed: tuple[SegmentedRecord, ...], alpha: float
) -> dict[str, Discrepancy]:
    """The residual of a fit by channel, compared with the noise of segmented records."""
    out = {}
    parts = residuals_by_segment(fit)
    for c, name in enumerate(fit.problem.model.outputs):
        # Noise that grows with the value is compared as if it were that at the value zero.
        values = [
            p[:, c] * (s.noise[c].sigma / s.sd[:, c])
            for p, s in zip(parts, sensed, strict=True)
            if np.isfinite(p[:, c]).any()
        ]
        if not values:
            continue
        total = np.concatenate([v[np.isfinite(v)] for v in values])
        given = _sigma(sensed, c, name)
        sigma = float(np.sqrt(np.mean(total**2)))
        memory = None
        # A few numbers often exceed their noise by chance.
        chance = squares_of_noise(alpha, total.size) / total.size
        if sigma**2 > max(NOISE_ERROR**2, chance) * given**2:
            memory = _memory(values) * sensed[0].record.interval
        out[name] = Discrepancy(max(sigma, given), memory, sigma / given)
    return out


def color_of_discrepancy(
    search: Search, sensed: tuple[SegmentedRecord, ...]
) -> dict[str, float] | None:
    """Correlation time [s] of the residual by channel; None: the residual is white or is no noise.

    Applies only if the sensors state white noise and the residual is not larger than stated. Then
    the color is in question, and first-order noise with the correlation of neighboring samples is
    assumed.
    """
    fit = search.tightest
    parts = residuals_by_segment(fit)
    out = {}
    for c, name in enumerate(fit.problem.model.outputs):
        rest = [
            (p[:, c] / s.sd[:, c], np.diff(s.record.time))
            for p, s in zip(parts, sensed, strict=True)
            if np.isfinite(p[:, c]).any()
        ]
        own = [s.noise[c] for s in sensed if name in s.record.outputs]
        if not rest or any(n.correlation_time > 0.0 or n.averaged > 1 for n in own):
            continue
        if np.nanmean(np.concatenate([v for v, _ in rest]) ** 2) > (1.0 + GIVEN_SIGMA) ** 2:
            return None
        # Pairs of neighboring measured samples, and their distance in time.
        pairs = np.concatenate([np.column_stack([v[1:], v[:-1], dt]) for v, dt in rest])
        late, early, lag = pairs[np.isfinite(pairs).all(axis=1)].T
        power = 0.5 * float(late @ late + early @ early)
        rho = float(late @ early) / power if power > 0.0 else 0.0
        if rho > COLORED:
            out[name] = -float(np.median(lag)) / float(np.log(min(rho, 0.999)))
    return out or None


def noise_factors(search: Search) -> dict[str, float]:
    """Factor by which the noise of a channel exceeds the given sigma, by channel.

    The prior standard deviation of a given sigma is ``criteria.GIVEN_SIGMA``. The factor follows
    from the differences of neighboring samples. Slow deviations do not influence these differences,
    so that an unknown cause is not mistaken for noise. The factor is at most that of the whole
    residual, and the prior pulls it toward one. Factors that are not significant, or larger than
    the prior permits, are omitted.
    """
    best = search.best
    fit = search.tightest if best is None else best.fit
    out = {}
    shapes = [s.measured.shape for s in fit.problem.segmented_records]
    white = [x.residual.reshape(shape) for x, shape in zip(fit.linears, shapes, strict=True)]
    for c, name in enumerate(fit.problem.model.outputs):
        left, steps = [], []
        for s, r in zip(fit.problem.segmented_records, white, strict=True):
            seen = s.weight[..., c] > 0.0
            left.append(r[..., c][seen])
            steps.append(np.diff(r[..., c], axis=1)[seen[:, 1:] & seen[:, :-1]])
        all_left, all_steps = np.concatenate(left), np.concatenate(steps)
        if all_steps.size < 2:
            continue
        noise = min(float(np.mean(all_left**2)), 0.5 * float(np.mean(all_steps**2)))
        # The variance of half the mean square of differences of n normal numbers is 3 / n.
        weight = all_steps.size / 0.75
        share = weight / (weight + GIVEN_SIGMA**-2.0)
        factor = 0.5 * share * float(np.log(max(noise, 1e-300)))
        if 2.0 / np.sqrt(weight) < factor < 2.0 * GIVEN_SIGMA:
            out[name] = float(np.exp(factor))
    return out


def with_factor(
    model: Model, segmented: SegmentedRecord, factor: dict[str, float]
) -> SegmentedRecord:
    """The segmented record with the noise of some of its sensors larger by a factor [1]."""
    noise = dict(zip(model.outputs, segmented.noise, strict=True))
    new = {n: noise[n].scaled(f) for n, f in factor.items()}
    return _renoised(model, segmented, new)


def with_color(
    model: Model, segmented: SegmentedRecord, color: dict[str, float]
) -> SegmentedRecord:
    """Copy of the segmented record; the noise of some sensors has a correlation time [s]."""
    noise = dict(zip(model.outputs, segmented.noise, strict=True))
    return _renoised(
        model, segmented, {n: replace(noise[n], correlation_time=t) for n, t in color.items()}
    )


def _renoised(model: Model, segmented: SegmentedRecord, new: dict[str, Noise]) -> SegmentedRecord:
    """The segmented record with the noise of some channels replaced, on the same segments."""
    noise = dict(zip(model.outputs, segmented.noise, strict=True)) | new
    return segment_record(model, segmented.record, noise, None, segmented.segments)


def converged(old: dict[str, Discrepancy], new: dict[str, Discrepancy]) -> bool:
    """Whether the unexplained residual no longer shrinks.

    A growing residual counts as converged as well. With more noise, a smaller set is found, which
    leaves a larger residual, and so on until the model explains nothing.
    """
    return all(new[n].sigma > STILL_SHRINKS * old[n].sigma for n in old)


def with_noise(
    model: Model, segmented: SegmentedRecord, rest: dict[str, Discrepancy]
) -> SegmentedRecord:
    """The segmented record with the noise of its sensors replaced by an unexplained residual."""
    noise = dict(zip(model.outputs, segmented.noise, strict=True))
    new = {}
    for name, own in rest.items():
        relative = noise[name].relative * (own.sigma / noise[name].sigma)
        if own.correlation_time is None:
            new[name] = replace(noise[name], sigma=own.sigma, relative=relative)
        else:
            new[name] = Noise(own.sigma, own.correlation_time, relative=relative)
    return _renoised(model, segmented, new)


def _memory(parts: list[Array]) -> float:
    """Correlation time in samples: where the autocorrelation falls below 1/e; 0 if white."""
    length = min(MOST_LAGS, min(p.size for p in parts) // 4)
    sums = np.zeros(length + 1)
    for p in parts:
        clean = np.nan_to_num(p)
        for lag in range(length + 1):
            sums[lag] += float(clean[lag:] @ clean[: clean.size - lag])
    if sums[0] <= 0.0:
        return 0.0
    rho = sums / sums[0]
    if length >= 1 and rho[1] < COLORED:
        return 0.0
    below = np.flatnonzero(rho < np.exp(-1.0))
    return float(below[0]) if below.size else float(length)
