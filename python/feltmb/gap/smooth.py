"""Whether the residual of a fit without gaps is smoother than noise: a gap that nothing explains.

A sum of squares weighs all frequencies alike, but what a model lacks moves slowly and noise does
not. The alternative to noise is an unknown smooth signal in every channel, a Gaussian process of
Matern 3/2 with one length for all, in units of the noise of its channel. With B its cosines,
whitened as the records are, A the whitened derivatives by all that was fitted, M the normal matrix
with the priors and r the residual,

    u = B'r,   G = B'B - B'A M^-1 A'B,
    log K = 1/2 s^2 v'(I + s^2 H)^-1 v - 1/2 log det(I + s^2 H),   v = L'u,   H = L'G L

is the log Bayes factor of the amplitude s, L the roots of the process' spectrum. Of it the largest
over a few lengths and amplitudes is taken. Where segments may leave gaps between them, these do the
same (see :func:`feltmb.gap.decide.misfit`).
"""

from __future__ import annotations

import functools

import numpy as np

from feltmb.data import Array
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import SLOW_COLOR

__all__ = ["smooth_discrepancy"]

#: Lengths that are tried, in shares of the record.
LENGTHS = (0.01, 0.03, 0.1, 0.3)
#: Most cosines of a channel in a segment, and of all.
MOST, IN_ALL = 40, 900
#: Share of a signal below which what the fit leaves of it is rounding.
ROUNDING = 1e-9


@functools.lru_cache(maxsize=8)
def smooth_discrepancy(fit: Fit) -> float:
    """Log Bayes factor of an unknown smooth signal against noise, at its best amplitude and length.

    Parameters
    ----------
    fit
        Any fit; with its parameters free to take the signal up.

    Returns
    -------
    float
        [1], at least 0. Under noise alone twice it is above x with half the chance of a chi-square
        of one degree of freedom, for each length. 0 too where there are more channels times
        segments than ``IN_ALL``.
    """
    problem = fit.problem
    normal = problem.normal(fit.point, fit.linears, fit.gap_sd, keep_rows=True)
    step = problem.newton(fit.point, normal)
    size = np.sqrt(np.maximum(np.diag(normal.matrix), 1e-300))
    values, vectors = np.linalg.eigh(normal.matrix / np.outer(size, size))
    root = (vectors / np.sqrt(np.maximum(values, 1e-11 * values[-1:]))) / size[:, None]
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
        return 0.0
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
    return max(_best(u, gram, whole, omega, share * span) for share in LENGTHS)


def _best(u: Array, gram: Array, whole: Array, omega: Array, length: float) -> float:
    """Largest log Bayes factor over amplitudes for one length [s].

    ``whole``: squares of the columns before anything fitted was taken out of them; what is left of
    a signal that the fit can take up altogether is rounding.
    """
    spread = 1.0 / (1.0 + (omega * length) ** 2 / 3.0)  # the root of the spectrum
    values, vectors = np.linalg.eigh(spread[:, None] * gram * spread)
    kept = values > ROUNDING * float(np.max(spread**2 * whole))
    if not kept.any():
        return 0.0
    values, along = values[kept], ((vectors.T @ (spread * u)) ** 2)[kept]
    best = 0.0
    for s2 in np.logspace(-6.0, 6.0, 61) / float(values[-1]):
        log_k = 0.5 * float(np.sum(s2 * along / (1.0 + s2 * values) - np.log1p(s2 * values)))
        best = max(best, log_k)
    return best


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
            column[0, : time.size, c] = np.cos(rate * time) * segmented.noise[c].sigma
            columns.append(column)
            omega.append(rate)
    if not columns:
        return np.zeros((length * ny, 0)), np.zeros(0)
    return segmented.whiten(np.stack(columns, axis=-1)).reshape(length * ny, -1), np.array(omega)
