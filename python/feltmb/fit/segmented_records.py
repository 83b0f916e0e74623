"""A record divided into segments, with the noise of its channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Integers, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.model import Model
from feltmb.fit.noise import Noise, innovations, rms_of_measured

__all__ = ["Noise", "SegmentedRecord", "choose_segments", "segment_record"]


@dataclass(frozen=True, eq=False)
class SegmentedRecord:
    """One record, prepared for a comparison by segment."""

    record: Record
    segments: Integers
    """First and last sample, (W, 2); a segment ends at the first sample of the next one."""
    measured: Array
    """(W, L, ny); NaN if not measured, or if the sample belongs to the next segment."""
    valid: NDArray[np.bool_]
    """(W, L, ny)"""
    before: Integers
    """Indices of the previous valid samples in the segment, the nearest first; -1: none. (W, L, ny,
    p)"""
    decay: Array
    """Prediction of the noise of a sample from those samples: a factor for each, (W, L, ny, p)."""
    weight: Array
    """1 / standard deviation of the innovation; 0 if not measured. (W, L, ny)"""
    noise: tuple[Noise, ...]
    sd: Array
    """Standard deviation of the noise of each sample of the record [units of the channels], (n,
    ny)."""
    nuisances: tuple[tuple[str, int, float], ...]
    """("gain" | "offset" | "delay", channel, prior standard deviation)."""

    @property
    def count(self) -> int:
        """Number of segments."""
        return len(self.segments)

    @cached_property
    def rms_noise(self) -> Array:
        """Root mean square of the noise of the measured samples, by channel [its unit], (ny,)."""
        return rms_of_measured(self.sd, self.joined(self.measured))

    @property
    def samples(self) -> Array:
        """Number of valid samples by segment and channel, (W, ny)."""
        return np.asarray(np.sum(self.valid, axis=1), dtype=np.float64)

    def only(self, w: int) -> SegmentedRecord:
        """The segmented record with only one of its segments."""
        own = slice(w, w + 1)
        return replace(
            self,
            segments=self.segments[own],
            measured=self.measured[own],
            valid=self.valid[own],
            before=self.before[own],
            decay=self.decay[own],
            weight=self.weight[own],
        )

    def until(self, samples: int) -> SegmentedRecord:
        """The segmented record without measurements after the given number of samples."""
        at = self.segments[:, :1] + np.arange(self.measured.shape[1])
        beyond = np.arange(self.record.samples) >= samples
        seen = (at < samples)[..., None]
        outputs = {k: np.where(beyond, np.nan, v) for k, v in self.record.outputs.items()}
        return replace(
            self,
            record=replace(self.record, outputs=outputs),
            valid=self.valid & seen,
            weight=self.weight * seen,
        )

    def joined(self, values: Array) -> Array:
        """Values by segment, (W, L, ny), in the order of the samples of the record, (n, ny)."""
        out = np.full((self.record.samples, values.shape[2]), np.nan)
        for (first, last), own in zip(self.segments, values, strict=True):
            out[first : last + 1] = own[: last - first + 1]  # the next segment has its first sample
        return out

    def whiten(self, columns: Array) -> Array:
        """Whiten arrays (W, L, ny) or (W, L, ny, c) to uncorrelated unit noise; 0 if missing."""
        own: tuple[None, ...] = (None,) * (columns.ndim - 3)
        clean = np.where(self.valid[(..., *own)], columns, 0.0)
        white = clean
        for k in range(self.before.shape[3]):
            decay, back = self.decay[..., k], k + 1
            if not decay.any():
                continue
            if white is clean:
                white = clean.copy()
            if self._without_holes[k]:
                white[:, back:] -= (
                    decay[(slice(None), slice(back, None), ..., *own)] * clean[:, :-back]
                )
            else:
                at = np.maximum(self.before[..., k], 0)
                white -= decay[(..., *own)] * np.take_along_axis(clean, at[(..., *own)], axis=1)
        return np.asarray(white * self.weight[(..., *own)])

    @cached_property
    def _without_holes(self) -> list[bool]:
        """Whether all predicting samples directly precede the predicted one, by distance."""
        position = np.arange(self.before.shape[1])[None, :, None]
        return [
            bool(np.all((self.decay[..., k] == 0.0) | (self.before[..., k] == position - 1 - k)))
            for k in range(self.before.shape[3])
        ]


#: Smallest length of a segment in time constants of a slow sensor: the influence of the previous
#: segment then decays to exp(-6).
TIME_CONSTANTS = 6.0
#: Largest number of segments of a record, and the number that a short record has at least.
MOST_SEGMENTS, LEAST_SEGMENTS = 200, 12


def choose_segments(record: Record, length: float | None, *, shortest: float = 0.0) -> Integers:
    """Segments of about ``length`` [s] with boundaries at which the outputs change slowly.

    None: a length that suits the number of samples, at least ``shortest`` [s].

    An impact at a boundary would make its start state very uncertain. Each boundary is therefore
    moved by up to a quarter of a segment to the sample with the smallest second difference of the
    outputs.
    """
    n = record.samples
    if length is None:
        # Segments are simulated as one batch: the longest one determines the time, not their
        # number.
        size = int(np.clip(n / 40, 16, max(16, min(n // LEAST_SEGMENTS, 200))))
        size = max(size, n // MOST_SEGMENTS, math.ceil(shortest / record.interval))
    else:
        if not (math.isfinite(length) and length > 0.0):
            raise InvalidParameter(f"segment = {length!r} s, expected a finite number > 0")
        if length < 2.0 * record.interval:
            raise InvalidParameter(
                f"segment = {length:g} s, expected at least two samples of record {record.name}, "
                f"{2.0 * record.interval:g} s"
            )
        size = max(2, round(length / record.interval))
    count = max(1, round((n - 1) / size))
    edges = np.round(np.linspace(0, n - 1, count + 1)).astype(int)
    if count > 1 and size >= 8:
        bend = np.zeros(n)
        for values in [*record.outputs.values(), *record.inputs.values()]:
            good = np.isfinite(values)
            if good.sum() < 3:
                continue
            filled = np.interp(np.arange(n), np.flatnonzero(good), values[good])
            second = np.zeros(n)
            second[1:-1] = np.abs(filled[2:] - 2.0 * filled[1:-1] + filled[:-2])
            spread = float(np.std(second))
            if spread > 0.0:
                bend += second / spread
        bend = np.convolve(bend, np.ones(3), mode="same")
        reach = size // 4
        for i in range(1, count):
            around = np.arange(edges[i] - reach, edges[i] + reach + 1)
            cost = bend[around] + 0.05 * np.abs(around - edges[i]) / reach
            edges[i] = int(around[np.argmin(cost)])
    edges = np.unique(edges)
    return np.column_stack([edges[:-1], edges[1:]]).astype(np.intp)


def segment_record(
    model: Model,
    record: Record,
    noise: Mapping[str, Noise],
    segment: float | None,
    segments: Integers | None = None,
) -> SegmentedRecord:
    """Divide a record into segments and prepare its whitening."""
    if segments is None:
        slowest = min((s.bandwidth for s in record.sensors.values()), default=math.inf)
        shortest = TIME_CONSTANTS / (2.0 * math.pi * slowest)
        if segment is None and model.segment is not None:
            segment = max(model.segment, shortest)
        segments = choose_segments(record, segment, shortest=shortest)
    longest = int(np.max(segments[:, 1] - segments[:, 0])) + 1
    all_measured = record.output_array(model.outputs)
    at = segments[:, :1] + np.arange(longest)
    inside = at < segments[:, 1:]
    inside[-1] |= at[-1] == segments[-1, 1]
    at = np.minimum(at, record.samples - 1)
    measured = np.where(inside[..., None], all_measured[at], np.nan)
    valid = np.isfinite(measured)
    position = np.where(valid, np.arange(longest)[None, :, None], -1)
    chosen = tuple(noise.get(name, Noise(1.0)) for name in model.outputs)
    columns = zip(chosen, all_measured.T, strict=True)
    own_sd = np.stack([n.sd_of_measured(record.time, y) for n, y in columns], axis=-1)
    before, decay, weight = innovations(chosen, position, record.time[at], own_sd[at])
    nuisances = []
    for c, name in enumerate(model.outputs):
        if name not in record.outputs or not valid[:, :, c].any():
            continue
        sensor = record.sensors[name]
        for kind, sd in (
            ("gain", sensor.gain_sd),
            ("offset", sensor.offset_sd),
            ("delay", sensor.delay_sd),
        ):
            if sd > 0.0:
                nuisances.append((kind, c, sd))
    return SegmentedRecord(
        record=record,
        segments=segments,
        measured=measured,
        valid=valid,
        before=before,
        decay=decay,
        weight=weight,
        noise=chosen,
        sd=own_sd,
        nuisances=tuple(nuisances),
    )
