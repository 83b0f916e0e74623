"""Checks records before anything is simulated: clocks, codes for missing values, spikes, units."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Record
from feltmb.errors import DataError, near_names
from feltmb.fit.model import Model
from feltmb.units import same_unit, weight_hint

__all__ = ["check_records"]

#: Step of a clock above which the clock jumps, in median steps [1].
JUMP = 20.0
#: Share of the values at the end of the range from which a sensor may be saturated [1].
SATURATED = 0.05
#: Samples in a row at the end of the range from which it is no rounding of a rest [1].
PLATEAU = 8
#: Digits of the numbers that loggers write for "no value", and their smallest distance from all
#: other values, in ranges of these.
CODE, FAR = re.compile(r"9{3,}|999[89]|32767|32768|65535|21474836\d\d"), 0.5
#: The same where no measurement can be meant, and the size of numbers that are codes, too.
CERTAIN, CERTAINLY_FAR, HUGE = re.compile(r"9{4,}"), 5.0, 1e15
#: Distance of a spike from the samples before and after, in scatters of the samples and as a share
#: of the range [1].
SPIKE = 15.0, 0.1


def check_records(records: Sequence[Record], model: Model | None = None) -> list[str]:
    """Check the clocks and the numbers of records; returns notes.

    Parameters
    ----------
    records
        Measured runs; at least one.
    model
        Model with which they are compared; None: only the records are checked.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    names = [r.name for r in records]
    faults = [
        f"the name {n} is used twice (a file given twice, or two files of one name)"
        for n in sorted({n for n in names if names.count(n) > 1})
    ]
    if not records:
        faults.append("there are none, expected at least one")
    outputs = None if model is None else model.outputs
    notes: list[str] = []
    for k, r in enumerate(records):
        notes += [f"{r.name}: {note}" for note in r.notes]
        faults += [
            f"{r.name} holds the same numbers as {o.name}; give one of them"
            for o in records[:k]
            if o.name != r.name and _same_numbers(o, r)
        ]
        faults += [] if model is None else _against(model, r)
        if (steps := np.diff(r.time)).max() > JUMP * (middle := float(np.median(steps))):
            at = int(np.argmax(steps))
            faults.append(
                f"{r.name}: the clock jumps by {steps[at]:g} s at {r.time[at]:g} s (median step "
                f"{middle:g} s); split the record there"
            )
        elif lost := int(np.sum(steps > 1.5 * middle)):
            notes.append(f"{r.name}: uneven clock, {lost} steps are longer than 1.5 medians")
        for name, values in r.outputs.items():
            if outputs is None or name in outputs:
                for fault, text in _numbers(values[np.isfinite(values)]):
                    (faults if fault else notes).append(f"{r.name}.{name}: {text}")
    if faults:
        raise DataError("records: " + "; ".join(faults))
    if outputs is not None and model is not None:
        recorded = dict.fromkeys(n for r in records for n in r.outputs)
        absent = [n for n in outputs if n not in recorded]
        if 0 < len(absent) <= len(recorded):  # a model may offer far more than one measures
            notes.append(f"{', '.join(absent)}: not compared, because no record has this output")
        notes += [
            f"{n}: not compared, because the model has no such output{near_names(n, outputs)}"
            for n in recorded
            if n not in outputs
        ]
    return notes


def _against(model: Model, record: Record) -> Iterator[str]:
    """Faults of a record with which the model cannot simulate it."""
    states = [s.name for s in model.states()]
    known = record.start
    unknown = [] if known is None else [n for n in {**known.mean, **known.sd} if n not in states]
    if states and unknown:
        yield (
            f"{record.name}: start of {', '.join(unknown)}, no state of the model {model.name} "
            f"({', '.join(states)})"
        )
    if not set(model.outputs) & set(record.outputs):
        yield (
            f"{record.name}: none of its outputs ({', '.join(record.outputs)}) is one of the model "
            f"({', '.join(model.outputs)})"
        )
    for name, unit in record.units.items():
        wanted = model.units.get(name) or "1"
        if "1" not in (unit, wanted) and not same_unit(unit, wanted):
            yield (
                f"{record.name}: {name} is in {unit}, in the model {model.name} in {wanted}"
                f"{weight_hint(unit, wanted)}"
            )


def _same_numbers(one: Record, other: Record) -> bool:
    """Whether a record is a copy, which would confirm what was fitted to the other one."""
    if one.samples < 8 or one.inputs.keys() != other.inputs.keys():
        return False
    if one.outputs.keys() != other.outputs.keys():
        return False
    pairs = [(y, other.outputs[n]) for n, y in one.outputs.items()]
    moves = any(np.unique(y[np.isfinite(y)]).size > 2 for y, _ in pairs)
    pairs += [(u, other.inputs[n]) for n, u in one.inputs.items()]
    return moves and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def _numbers(values: Array) -> Iterator[tuple[bool, str]]:
    """What is strange about the values of a channel, and whether they cannot be used."""
    if not values.size:
        yield False, "it has no values"
        return
    if np.ptp(values) == 0.0:
        if values.size > 1:
            yield False, "it never changes"
        return
    for extreme in (float(values.max()), float(values.min())):
        same = values == extreme
        rest = values[~same]
        away, width = float(np.min(np.abs(rest - extreme))), float(np.ptp(rest))
        digits = f"{abs(extreme):.9e}".partition("e")[0].replace(".", "").strip("0")
        code = abs(extreme) >= HUGE or CODE.fullmatch(digits)
        if code and values.size >= 12 and 2 * same.sum() <= values.size and away > FAR * width:
            values = rest
            sure = abs(extreme) >= HUGE or bool(CERTAIN.fullmatch(digits))
            yield (
                sure and np.unique(rest).size > 5 and away > CERTAINLY_FAR * width,
                f"{same.sum()} values of {extreme:.6g}, far outside of all others "
                f"({rest.min():.4g} to {rest.max():.4g}): if this stands for a missing value, "
                "leave the cells empty, or state missing = [NUMBER] with the number of the file "
                "(--missing NUMBER, in Python missing of ReadOptions)",
            )
        elif (
            same.sum() > SATURATED * values.size
            and not (same[0] or same[-1])
            and max(len(run) for run in "".join(map(str, same.astype(int))).split("0")) > PLATEAU
        ):
            yield False, f"{same.mean():.0%} of the values are at the end of the range: saturated?"
    if (count := int(_spikes(values).sum())) and count <= max(2, 0.01 * values.size):
        yield (
            False,
            f"{count} single values are far from the samples before and after; if they are faults "
            "of the sensor, leave these cells empty in the file (in Python NaN)",
        )


def _spikes(values: Array) -> NDArray[np.bool_]:
    """Which values are single samples far from the samples before and after, which agree."""
    if values.size < 12:
        return np.zeros(0, dtype=bool)
    before, after = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    away = np.where(before * after > 0.0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    bend = np.abs(before + after) / 2.0
    padded = np.pad(bend, 3)
    near = np.max([padded[3 + k : 3 + k + bend.size] for k in (-3, -2, 2, 3)], axis=0)
    scatter = np.maximum(near, float(np.median(bend)) or 1e-300)
    range_ = float(np.ptp(np.sort(values)[2:-2]))
    far = (away > SPIKE[0] * scatter) & (away > SPIKE[1] * range_)
    return np.asarray(far & (np.abs(before - after) <= 0.2 * away))
