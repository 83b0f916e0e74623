"""Codes for missing values, and single samples far from the samples before and after."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Integers, Record
from feltmb.gap.criteria import AGREE, FAR_CERTAIN, FAR_CODE, SPIKE, SPIKE_RANGE
from feltmb.units import unit_suffix

__all__ = ["Outlier", "outliers", "told"]

#: Digits of codes of loggers for "no value", apart from the decimal point: the unit of the record
#: may be a power of ten of that of the file. Numbers of this size are codes, too.
CODE, HUGE = re.compile(r"9{3,}|999[89]|32767|32768|65535|21474836\d\d"), 1e15
#: The same where no measurement can be meant.
CERTAIN = re.compile(r"9{4,}")
#: Largest share of the samples with one code, and of those that count as spikes; smallest number
#: of samples; largest number of different values of a channel that switches between levels.
MOST_CODES, MOST_SPIKES, LEAST, LEVELS = 0.5, 0.01, 12, 5


@dataclass(frozen=True)
class Outlier:
    """Values of a channel that lie far outside of all others, or far from their neighbors."""

    channel: str
    unit: str
    value: float
    """The value, or the farthest of several spikes [unit]."""
    count: int
    at: float
    """Time of the first one [s]."""
    low: float
    high: float
    """Range of the other values [unit]."""
    code: bool
    """Whether the values are equal, and a number that loggers write for "no value"."""
    of_input: bool = False
    """Whether the channel is an input, which needs a number at every sample."""
    levels: int = LEVELS + 1
    """Number of different other values."""

    @property
    def certain(self) -> bool:
        """Whether the number can have no other meaning."""
        away = max(self.low - self.value, self.value - self.high)
        known = abs(self.value) >= HUGE or bool(CERTAIN.fullmatch(_digits(self.value)))
        known = known and (self.levels > LEVELS or _is_no_level(self.value))
        far = away > max(FAR_CERTAIN * (self.high - self.low), 0.5 * abs(self.value))
        return self.code and known and far


def told(
    records: Sequence[Record], outputs: Sequence[str] | None = None
) -> tuple[list[str], list[str], list[str]]:
    """Faults and warnings about the outliers of records, and the channels with spikes.

    A sentence is about one code, or all spikes, of a channel. ``outputs``: those that are used;
    None: all.
    """
    groups: dict[tuple[object, ...], list[tuple[str, Outlier]]] = {}
    for record in records:
        for own in outliers(record):
            unused = outputs is not None and own.channel not in outputs
            if unused and own.channel not in record.inputs:
                continue
            value = own.value if own.code else None
            groups.setdefault((own.channel, value, own.certain), []).append((record.name, own))
    faults: list[str] = []
    warnings: list[str] = []
    for (*_, certain), found in groups.items():
        (faults if certain else warnings).append(_sentence(found))
    spiky = [own.channel for ((_, own), *_) in groups.values() if not own.code]
    return faults, warnings, spiky


def _sentence(found: Sequence[tuple[str, Outlier]]) -> str:
    """What is told about the outliers of one channel in all records."""
    record, first = found[0]
    count = sum(own.count for _, own in found)
    suffix = unit_suffix(first.unit) if first.unit != "1" else ""
    low, high = min(own.low for _, own in found), max(own.high for _, own in found)
    what = "one value of"
    if count > 1:
        what = f"{count} values of" if first.code else f"{count} values, one of them"
    where, when = f"{record}.{first.channel}", f"at {first.at:.6g} s"
    if len(found) > 1:
        where, when = first.channel, f"in {len(found)} records, {when} of {record}"
    text = f"{where}: {what} {first.value:.6g}{suffix}, {when}{' first' if count > 1 else ''}, "
    if not first.code:
        return (
            f"{text}far from the samples before and after: a fault of the sensor, or a pulse "
            "shorter than the time between two samples. If it is a fault, leave these cells empty "
            "in the file (in Python NaN): empty cells are not compared"
        )
    text += f"far outside of all others ({low:.4g} to {high:.4g}{suffix}): "
    if first.of_input:
        return (
            f"{text}if this number stands for a missing value, replace it or cut the record, "
            "because an input needs a number at every sample"
        )
    return (
        f"{text}if this number stands for a missing value, leave the cells empty, or state "
        "missing = [NUMBER] with the number of the file (--missing NUMBER, in Python missing "
        "of ReadOptions)"
    )


def outliers(record: Record) -> list[Outlier]:
    """Codes in the inputs and outputs of a record, and single spikes of its outputs.

    A code is the smallest or the largest value, and its distance from all others is ``FAR_CODE`` of
    their range. A spike is one sample that is far from the samples before and after, which agree.
    Inputs may be single pulses.
    """
    found = []
    units = record.units
    for name, values in (*record.inputs.items(), *record.outputs.items()):
        unit = units.get(name) or "1"
        left = np.flatnonzero(np.isfinite(values))
        while (code := _code(values[left])) is not None:
            same = values[left] == code
            found.append(_of(record, name, unit, left[same], left[~same], code=True))
            left = left[~same]
        if name in record.outputs and (far := _spikes(values[left])).any():
            found.append(_of(record, name, unit, left[far], left[~far], code=False))
    return found


def _of(
    record: Record, name: str, unit: str, far: Integers, others: Integers, *, code: bool
) -> Outlier:
    values = record.outputs[name] if name in record.outputs else record.inputs[name]
    rest = values[others]
    farthest = values[far][np.argmax(np.abs(values[far] - np.median(rest)))]
    at = float(record.time[far[0]])
    low, high = float(np.min(rest)), float(np.max(rest))
    of_input = name not in record.outputs
    levels = np.unique(rest).size
    return Outlier(name, unit, float(farthest), far.size, at, low, high, code, of_input, levels)


def _digits(value: float) -> str:
    """Digits of a number without zeros at its ends."""
    return f"{abs(value):.9e}".partition("e")[0].replace(".", "").strip("0")


def _is_no_level(value: float) -> bool:
    """Whether a number is a code even in a channel that switches between levels, such as 99.99."""
    return abs(value) >= HUGE or (value < 0.0 and value.is_integer())


def _code(values: Array) -> float | None:
    """The smallest or largest value, if it is a code."""
    if values.size < LEAST:
        return None
    for extreme in (float(np.max(values)), float(np.min(values))):
        same = values == extreme
        if np.sum(same) > MOST_CODES * values.size:
            continue
        if not (abs(extreme) >= HUGE or CODE.fullmatch(_digits(extreme))):
            continue
        rest = values[~same]
        if np.ptp(rest) == 0.0 and not _is_no_level(extreme):
            continue
        away = np.min(np.abs(rest - extreme))
        if away > FAR_CODE * np.ptp(rest):
            return extreme
    return None


def _spikes(values: Array) -> NDArray[np.bool_]:
    """Which values are single samples far from the samples before and after."""
    found = np.zeros(values.size, dtype=bool)
    most = max(2, int(MOST_SPIKES * values.size))
    if values.size < max(LEAST, 4 * most):
        return found
    before, after = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    away = np.where(before * after > 0.0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    # The scatter of all samples, and near this one: the beginning of a vibration is no spike.
    bend = np.abs(before + after) / 2.0
    padded = np.pad(bend, 3)
    near = [padded[3 + k : 3 + k + bend.size] for k in (-3, -2, 2, 3)]
    steps = np.abs(before)
    least = np.min(steps[steps > 0.0], initial=np.inf)
    scatter = np.maximum(np.max(near, axis=0), max(float(np.median(bend)), float(least)))
    low, high = np.sort(values)[[most, -1 - most]]
    far = (away > SPIKE * scatter) & (away > SPIKE_RANGE * (high - low))
    far &= np.abs(before - after) <= AGREE * away
    if np.sum(far) <= most:
        found[1:-1] = far
    return found
