"""Tests whether the residual of a fit without continuity defects is smoother than noise.

A sum of squares gives all frequencies the same weight, but a missing cause changes slowly and noise
does not. The alternative to noise is an unknown smooth signal in every channel: a Gaussian process
of type Matern 3/2 with one length for all channels, in units of the noise of its channel. Let B be
its cosines, whitened as the records are, A the whitened derivatives by all fitted quantities, M the
normal matrix with the priors, and r the residual. Then

    u = B'r,   G = B'B - B'A M^-1 A'B,
    log K = 1/2 s^2 v'(I + s^2 H)^-1 v - 1/2 log det(I + s^2 H),   v = L'u,   H = L'G L

is the log Bayes factor of the amplitude s, where L contains the square roots of the spectrum of the
process. The largest one over a few lengths and amplitudes tests for a gap, and the mean over them
is the evidence of an unknown cause. In a fit with continuity defects, the defects have the same
function (see :func:`feltmb.gap.misfit.misfit`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import logsumexp

from feltmb.data import Array
from feltmb.fit.latest import cached_for_first
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import SLOW_COLOR

__all__ = ["SmoothDiscrepancy", "smooth_discrepancy"]

#: Lengths that are tried, as shares of the record.
LENGTHS = (0.01, 0.03, 0.1, 0.3)
#: Amplitudes that are tried, relative to the one that noise determines.
AMPLITUDES = np.logspace(-6.0, 6.0, 61)
#: Largest number of cosines of a channel in a segment, and of all channels and segments.
MOST, IN_ALL = 40, 900
#: If a fit leaves less than this share of a signal, the remainder is rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class SmoothDiscrepancy:
    """Log Bayes factors of an unknown smooth signal against noise alone."""

    largest: float
    """Maximum over amplitudes and lengths [1], at least 0. Under noise alone, for each length,
    twice this value exceeds x with half the probability of a chi-square variable with one degree of
    freedom."""
    mean: float
    """Log of the mean Bayes factor over the amplitudes and lengths, which are equally probable
    [1]."""


@cached_for_first
def smooth_discrepancy(fit: Fit) -> SmoothDiscrepancy:
    """Log Bayes factors of an unknown smooth signal against noise.

    Parameters
    ----------
    fit
        A fit; its parameters can absorb a part of the signal.

    Returns
    -------
    SmoothDiscrepancy
        Zeros if the number of channels times segments exceeds ``IN_ALL``, or if the records could
        not be simulated.
    """
    if not np.isfinite(fit.cost):
        return SmoothDiscrepancy(0.0, 0.0)
    problem = fit.problem
    normal = problem.normal(fit.point, fit.linears, fit.defect_sd, keep_rows=True)
    # What a limit stops cannot absorb a signal. The same quantities must be free in the residual
    # and in G: a residual that they could still reduce would look like a signal without bound.
    step, free = problem.newton_within(fit.point, normal)
    matrix = normal.matrix[np.ix_(free, free)]
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    root = np.zeros((free.size, size.size))
    if size.size:
        values, vectors = eigh(matrix / np.outer(size, size))
        root[free] = (vectors / np.sqrt(np.maximum(values, 1e-11 * values[-1]))) / size[:, None]
    cells = sum(s.count for s in problem.segmented_records) * len(problem.model.outputs)
    most = min(MOST, IN_ALL // max(cells, 1))
    pulls, grams, crosses, periods = [], [], [], []
    for segmented, chain, own in zip(
        problem.segmented_records, normal.chains, normal.columns, strict=True
    ):
        assert chain.rows is not None
        for w in range(segmented.count):
            basis, omega = _cosines(segmented.only(w), most)
            if not basis.shape[1]:
                continue
            rows = chain.rows[w]
            left = rows[:, -1] - rows[:, :-1] @ step[own]
            pulls.append(basis.T @ left)
            grams.append(basis.T @ basis)
            crosses.append((basis.T @ rows[:, :-1]) @ root[own])
            periods.append(omega)
    if not pulls:
        return SmoothDiscrepancy(0.0, 0.0)
    u, omega = np.concatenate(pulls), np.concatenate(periods)
    gram = np.zeros((u.size, u.size))
    at = 0
    for g in grams:
        gram[at : at + len(g), at : at + len(g)] = g
        at += len(g)
    whole = np.diag(gram).copy()
    cross = np.vstack(crosses)
    gram -= cross @ cross.T
    span = max(float(s.record.time[-1] - s.record.time[0]) for s in problem.segmented_records)
    factors = np.concatenate(
        [_log_factors(u, gram, whole, omega, share * span) for share in LENGTHS]
    )
    mean = float(logsumexp(factors)) - float(np.log(factors.size))
    return SmoothDiscrepancy(max(0.0, float(np.max(factors))), mean)


def _log_factors(u: Array, gram: Array, whole: Array, omega: Array, length: float) -> Array:
    """Log Bayes factors of the amplitudes for one length [s].

    ``whole``: squares of the columns before the fitted quantities were projected out. If the fit
    can absorb a signal completely, the remainder is rounding.
    """
    spread = 1.0 / (1.0 + (omega * length) ** 2 / 3.0)  # square root of the spectrum
    # NumPy's driver (divide and conquer) failed to converge on such a matrix of 396 rows.
    values, vectors = eigh(spread[:, None] * gram * spread)
    kept = values > ROUNDING * float(np.max(spread**2 * whole))
    if not kept.any():
        return np.zeros(AMPLITUDES.size)
    values, along = values[kept], ((vectors.T @ (spread * u)) ** 2)[kept]
    s2 = AMPLITUDES[:, None] / float(values[-1])
    return np.asarray(
        0.5 * np.sum(s2 * along / (1.0 + s2 * values) - np.log1p(s2 * values), axis=1)
    )


def _cosines(segmented: SegmentedRecord, most: int) -> tuple[Array, Array]:
    """Whitened cosines of all channels of one segment, (L ny, k), and their frequencies [rad/s]."""
    first, last = (int(i) for i in segmented.segments[0])
    length, ny = segmented.measured.shape[1:]
    time = segmented.record.time[first : last + 1] - segmented.record.time[first]
    duration = float(time[-1])
    columns, omega = [], []
    for c in range(ny):
        samples = int(segmented.valid[0, :, c].sum())
        tau = segmented.noise[c].correlation_time
        for k in range(min(most, samples // 4)):
            rate = np.pi * k / duration
            if rate * tau > SLOW_COLOR:
                break
            column = np.zeros((1, length, ny))
            column[0, : time.size, c] = np.cos(rate * time) * segmented.sd[first : last + 1, c]
            columns.append(column)
            omega.append(rate)
    if not columns:
        return np.zeros((length * ny, 0)), np.zeros(0)
    return segmented.whiten(np.stack(columns, axis=-1)).reshape(length * ny, -1), np.array(omega)
