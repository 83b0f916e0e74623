"""The unknown rest: what the best set leaves, as noise that effects must beat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import predict
from feltmb.fit.nominal import Nominal
from feltmb.fit.shots import Noise, Shot, make_shot
from feltmb.fit.solve import Fit, FitSettings, polish
from feltmb.gap.refine import Search

__all__ = ["rest_of", "settled", "with_noise"]

#: Ratio of the sum of squares to its expectation beyond which there is an unknown rest.
MISFIT = 1.33**2


def rest_of(
    search: Search, sensed: tuple[Shot, ...], settings: FitSettings
) -> dict[str, Noise] | None:
    """Residual of the best set by channel, as noise with a correlation time; None: only noise.

    A library that explains the records needs nothing of this. Where it does not, sensor noise
    alone would make every effect significant that correlates with the rest.

    Parameters
    ----------
    sensed
        The shots with the noise of the sensors.
    """
    best = search.nominal if search.best is None else search.best.fit
    tight = best
    if best.gap_sd.size and not best.problem.nominal.chaotic:
        tight = polish(best.problem, best.point, settings.levels[-1], replace(settings, chain=True))
        if not np.isfinite(tight.cost):
            tight = best
    out = {}
    more = False
    parts = _residuals(tight)
    for c, name in enumerate(best.problem.nominal.outputs):
        values = [p[:, c] for p in parts if np.isfinite(p[:, c]).any()]
        if not values:
            continue
        total = np.concatenate([v[np.isfinite(v)] for v in values])
        given = float(np.sqrt(np.mean([s.noise[c].sigma ** 2 for s in sensed])))
        sigma = float(np.sqrt(np.mean(total**2)))
        more = more or sigma**2 > MISFIT * given**2
        interval = sensed[0].record.interval
        own = sensed[0].noise[c]
        if sigma**2 > MISFIT * given**2:
            own = Noise(sigma, _memory(values) * interval)
        out[name] = replace(own, sigma=max(sigma, given))
    return out if more else None


def settled(old: dict[str, Noise], new: dict[str, Noise]) -> bool:
    """Whether the rest has stopped to shrink."""
    return all(abs(new[n].sigma / old[n].sigma - 1.0) < 0.15 for n in old)


def with_noise(nominal: Nominal, shot: Shot, noise: dict[str, Noise]) -> Shot:
    """The same shot with other noise."""
    return make_shot(nominal, shot.record, noise, None, shot.windows)


def _residuals(fit: Fit) -> list[Array]:
    problem = fit.problem
    out = []
    for shot, place in zip(problem.shots, fit.point.places, strict=True):
        outputs, _, _ = predict(
            problem.nominal, shot, fit.point.theta, problem.terms, fit.point.sizes, place
        )
        joined = np.full((shot.record.samples, len(problem.nominal.outputs)), np.nan)
        for w, (first, last) in enumerate(shot.windows):
            stop = last + 1 if w == shot.count - 1 else last
            joined[first:stop] = (shot.measured - outputs)[w, : stop - first]
        out.append(joined)
    return out


def _memory(parts: list[Array], most: int = 200) -> float:
    """Correlation time in samples: where the autocorrelation falls below 1/e; 0 if white."""
    length = min(most, min(p.size for p in parts) // 4)
    sums = np.zeros(length + 1)
    for p in parts:
        clean = np.nan_to_num(p)
        for lag in range(length + 1):
            sums[lag] += float(clean[lag:] @ clean[: clean.size - lag])
    if sums[0] <= 0.0:
        return 0.0
    rho = sums / sums[0]
    if length >= 1 and rho[1] < 0.2:
        return 0.0
    below = np.flatnonzero(rho < np.exp(-1.0))
    return float(below[0]) if below.size else float(length)
