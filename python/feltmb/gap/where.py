"""Locates the gap: residuals by channel and segment, events, time and amplitude."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import stats

from feltmb.data import Array
from feltmb.fit.observe import observe_whole
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import ONSET_SHARE, refuted
from feltmb.gap.findings import EventRow, LedgerCell
from feltmb.gap.proof import outputs_by_segment

__all__ = ["event_ledger", "first_act", "ledger", "onset_of", "split_gap"]


def ledger(fit: Fit, alpha: float) -> tuple[tuple[LedgerCell, ...], dict[str, float]]:
    """Residual by channel and segment compared with noise, and the onset by record [s].

    Each cell is tested with the chi-square of the whitened residual and re-estimated states, with
    Benjamini-Yekutieli control of the false discovery rate at ``alpha``. The degrees of freedom of
    the states are subtracted according to their leverage.
    """
    problem = fit.problem
    normal = problem.normal(fit.point, fit.linears, fit.defect_sd, keep_rows=True)
    rows = []
    for segmented, chain in zip(problem.segmented_records, normal.chains, strict=True):
        assert chain.rows is not None
        assert chain.leverage is not None
        ny = len(problem.model.outputs)
        for w in range(segmented.count):
            residual = chain.rows[w][:, -1].reshape(-1, ny)
            taken = chain.leverage[w].reshape(-1, ny)
            for c, channel in enumerate(problem.model.outputs):
                valid = segmented.valid[w, :, c]
                n = int(valid.sum())
                if n < 2:
                    continue
                values = residual[valid, c]
                dof = max(n - float(taken[valid, c].sum()), 1.0)
                chi2 = float(values @ values)
                p = float(stats.chi2.sf(chi2, dof))
                first, last = segmented.segments[w]
                sd = segmented.sd[first : last + 1, c]
                sigma = float(np.sqrt(np.mean(sd[valid[: sd.size]] ** 2)))
                rms = float(np.sqrt(np.mean(values**2))) * sigma
                lag = _lag1(values)
                rows.append((segmented, w, channel, c, values, rms, sigma, chi2, dof, p, lag))
    ps = np.array([r[9] for r in rows])
    flags = _shows(ps, alpha)
    cells = []
    onset: dict[str, float] = {}
    for (segmented, w, channel, c, values, rms, sigma, chi2, dof, p, lag), flag in zip(
        rows, flags, strict=True
    ):
        first, last = segmented.segments[w]
        cells.append(
            LedgerCell(
                record=segmented.record.name,
                channel=channel,
                start=float(segmented.record.time[first]),
                end=float(segmented.record.time[last]),
                samples=values.size,
                rms=rms,
                sigma=sigma,
                z=float((chi2 - dof) / np.sqrt(2.0 * dof)),
                p=p,
                significant=bool(flag),
                lag1=lag,
            )
        )
        if flag:
            at = first + int(np.flatnonzero(segmented.valid[w, :, c])[onset_of(values, alpha)])
            name = segmented.record.name
            onset[name] = min(onset.get(name, np.inf), float(segmented.record.time[at]))
    return tuple(cells), onset


def onset_of(residual: Array, alpha: float) -> int:
    """Index from which a significant residual, in units of its noise, is larger than the noise.

    Up to the sample n at which the sum of squares exceeds its expectation by most standard
    deviations, the onset k is the most likely place of a step of the variance from 1 to an unknown
    s^2 > 1. It maximizes the log likelihood ratio ``(n - k) (s^2 - 1 - log s^2) / 2``, where s^2 is
    the mean square from k to n. If the samples before k are more than noise too, the search is
    repeated with them.
    """
    square = residual**2
    number = np.arange(1, square.size + 1)
    total = np.cumsum(square)
    significant = stats.chi2.sf(total, number) < refuted(alpha)
    onset: int = square.size
    while onset == square.size or np.any(significant[:onset]):
        last = int(np.argmax((total[:onset] - number[:onset]) / np.sqrt(number[:onset])))
        count = number[last::-1]
        mean = np.maximum(np.cumsum(square[last::-1])[::-1] / count, 1.0)
        onset = int(np.argmax(count * (mean - 1.0 - np.log(mean))))  # less than before
    return onset


def first_act(fit: Fit) -> dict[str, float]:
    """First time in each record at which the effects of a fit are visible [s].

    The fit is simulated with and without its effects, with the same parameters and start states. An
    effect is visible when an output changes by ``ONSET_SHARE`` of its noise and of its largest
    change. This is earlier than the sum of squares shows it, because that needs many samples.
    Records without such a change are omitted.
    """
    problem = fit.problem
    found = {}
    for segmented, place in zip(problem.segmented_records, fit.point.places, strict=True):
        record = segmented.record
        runs = [
            observe_whole(
                problem.model,
                record,
                fit.point.theta,
                place.starts[0],
                problem.included,
                magnitudes,
            )
            for magnitudes in (fit.point.magnitudes, np.zeros_like(fit.point.magnitudes))
        ]
        seen = np.nan_to_num(np.abs(runs[0] - runs[1]) / segmented.sd)
        seen = seen[:, segmented.valid.any(axis=(0, 1))]
        most = np.max(seen, axis=1, initial=0.0)
        shows = np.flatnonzero(most > ONSET_SHARE * max(1.0, float(np.max(most))))
        if shows.size:
            found[record.name] = float(record.time[shows[0]])
    return found


def _lag1(values: Array, bins: int = 12) -> float:
    """Autocorrelation at a lag of one bin; a segment has about a dozen bins."""
    size = max(1, values.size // bins)
    count = values.size // size
    if count < 3:
        return 0.0
    means = values[: count * size].reshape(count, size).mean(axis=1)
    power = float(means @ means)
    return float(means[1:] @ means[:-1] / power) if power > 0.0 else 0.0


def _shows(p: Array, alpha: float) -> Array:
    """Significant p values according to Benjamini-Yekutieli."""
    from scipy import stats

    if p.size == 0:
        return np.zeros(0, dtype=bool)
    return np.asarray(stats.false_discovery_control(p, method="by") <= alpha)


def split_gap(fit: Fit) -> Mapping[str, Mapping[str, float]]:
    """Shares of the squared gap by channel that a time shift or a factor would explain.

    e(t) = -tau dy/dt + a y + rest, where tau and a are fitted for each segment.
    """
    problem = fit.problem
    sums = {name: np.zeros(4) for name in problem.model.outputs}
    for segmented, joined in zip(problem.segmented_records, outputs_by_segment(fit), strict=True):
        measured = segmented.record.output_array(problem.model.outputs)
        for c, name in enumerate(problem.model.outputs):
            y = joined[:, c]
            slope = np.gradient(y, segmented.record.time)
            for first, last in segmented.segments:
                part = slice(first, last + 1)
                e = measured[part, c] - y[part]
                good = np.isfinite(e) & np.isfinite(slope[part])
                if good.sum() < 4:
                    continue
                e, s, a = e[good], -slope[part][good], y[part][good]
                total = float(e @ e)
                noise = float(np.sum(segmented.sd[part, c][good] ** 2))
                if total <= noise:
                    continue
                by_time = _explained(e, [s])
                by_both = _explained(e, [s, a])
                by_size = by_both - by_time
                sums[name] += (total, by_time, by_size, total - by_both)
    return {
        name: {
            "time": float(v[1] / v[0]),
            "amplitude": float(v[2] / v[0]),
            "rest": float(v[3] / v[0]),
        }
        for name, v in sums.items()
        if v[0] > 0.0
    }


def _explained(e: Array, columns: list[Array]) -> float:
    basis = np.column_stack(columns)
    found = np.linalg.lstsq(basis, e, rcond=1e-10)[0]
    left = e - basis @ found
    return float(e @ e - left @ left)


def event_ledger(fit: Fit, alpha: float) -> tuple[EventRow, ...]:
    """Compare the events of the model; without events, the steepest changes of each channel."""
    problem = fit.problem
    rows = []
    for segmented, joined in zip(problem.segmented_records, outputs_by_segment(fit), strict=True):
        record = segmented.record
        names = problem.model.outputs
        measured = record.output_array(names)
        known = problem.model.events(record, {n: measured[:, c] for c, n in enumerate(names)})
        if known:
            moments = [(e, t, c) for e, t in known for c in range(len(names))]
        else:
            moments = _steepest(record.time, joined, segmented)
        for event, time, c in moments:
            row = _local_shift(segmented, joined[:, c], measured[:, c], time, c)
            if row is None:
                continue
            delay, delay_se, speed, change, change_se = row
            z = max(abs(delay) / delay_se, abs(change) / change_se)
            rows.append(
                (record.name, event, names[c], time, delay, delay_se, speed, change, change_se, z)
            )
    if not rows:
        return ()
    ps = 2.0 * 2.0 * stats.norm.sf(np.array([r[-1] for r in rows]))
    flags = _shows(np.minimum(ps, 1.0), alpha)
    return tuple(
        EventRow(
            record=r[0],
            event=r[1],
            channel=r[2],
            time=float(r[3]),
            delay=float(r[4]),
            delay_se=float(r[5]),
            speed=float(r[6]),
            speed_error=float(r[7]),
            speed_error_se=float(r[8]),
            significant=bool(flag),
        )
        for r, flag in zip(rows, flags, strict=True)
    )


def _steepest(
    time: Array, joined: Array, segmented: SegmentedRecord, most: int = 4
) -> list[tuple[str, float, int]]:
    """Largest second derivatives of each channel, at least one segment apart."""
    out = []
    apart = float(
        np.median(
            segmented.record.time[segmented.segments[:, 1]]
            - segmented.record.time[segmented.segments[:, 0]]
        )
    )
    for c in range(joined.shape[1]):
        if not segmented.valid[:, :, c].any():
            continue
        bend = np.abs(np.gradient(np.gradient(joined[:, c], time), time))
        for first in segmented.segments[1:, 0]:  # joints between segments are not events
            bend[max(first - 2, 0) : first + 3] = 0.0
        bend = np.nan_to_num(bend)
        taken: list[float] = []
        for i in np.argsort(-bend, kind="stable"):
            if all(abs(time[i] - t) > apart for t in taken):
                taken.append(float(time[i]))
            if len(taken) == most:
                break
        out += [(f"bend {k + 1}", t, c) for k, t in enumerate(sorted(taken))]
    return out


def _local_shift(
    segmented: SegmentedRecord, model: Array, measured: Array, time: float, c: int
) -> tuple[float, float, float, float, float] | None:
    """Time shift and speed change near a time, by local regression, with standard errors."""
    clock = segmented.record.time
    reach = max(6, int(segmented.measured.shape[1] // 4))
    at = int(np.argmin(np.abs(clock - time)))
    part = slice(max(0, at - reach), min(clock.size, at + reach + 1))
    t, y, m = clock[part] - time, model[part], measured[part]
    good = np.isfinite(y) & np.isfinite(m)
    if good.sum() < 6:
        return None
    t, y, m = t[good], y[good], m[good]
    slope = np.gradient(y, t)
    e = m - y
    sigma = float(np.sqrt(np.mean(segmented.sd[part, c][good] ** 2)))
    power = float(slope @ slope)
    if power <= 0.0:
        return None
    delay = -float(e @ slope) / power
    delay_se = sigma / np.sqrt(power)
    basis = np.column_stack([np.ones_like(t), t])
    found = np.linalg.lstsq(basis, e, rcond=None)[0]
    change = float(found[1])
    change_se = sigma / float(np.sqrt(np.sum((t - t.mean()) ** 2)))
    speed = float(np.linalg.lstsq(basis, m, rcond=None)[0][1])
    return delay, delay_se, speed, change, change_se
