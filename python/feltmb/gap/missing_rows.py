"""Records with missing rows: the input between is unknown, so that they are divided there."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Record
from feltmb.fit.model import Model
from feltmb.gap.criteria import BRIDGED, CLOCK_JUMP, REGULAR_CLOCK, UNEVEN_STEP

__all__ = ["divided", "with_parts"]


def divided(model: Model, records: Sequence[Record]) -> tuple[Record, ...]:
    """Divide records where rows are missing and the inputs there cannot be interpolated.

    The parts start in an unknown state. Parts that are too short for the model are left out. If
    all of them are, the record stays whole, with a note. A record with an irregular clock is not
    divided: there, no row is missing. Neither are the records of a model whose runs start from
    rest.
    """
    if model.from_rest:
        return tuple(records)
    return tuple(part for record in records for part in _parts(record, model.least_samples))


def with_parts(names: Sequence[str], records: Sequence[Record]) -> list[str]:
    """Names of records, where the name of a divided one stands for all of its parts."""
    out = []
    for name in names:
        parts = [r.name for r in records if r.whole == name != r.name]
        known = any(r.name == name for r in records)
        out += [name] if known or not parts else parts
    return out


def _parts(record: Record, least: int) -> list[Record]:
    steps = np.diff(record.time)
    middle = record.interval
    long = (steps > UNEVEN_STEP[1] * middle) & (steps <= CLOCK_JUMP * middle)
    near, share = REGULAR_CLOCK
    if not long.any() or np.mean(np.abs(steps[~long] - middle) < near * middle) < share:
        return [record]
    at = [
        i
        for i in map(int, np.flatnonzero(long))
        if not (_bridged(record, count := round(steps[i] / middle)) and _smooth(record, i, count))
    ]
    edges = [0, *(int(i) + 1 for i in at), record.samples]
    spans = [(a, b) for a, b in itertools.pairwise(edges) if b - a >= least]
    if not at:
        return [record]
    lost = sum(round(steps[i] / middle) - 1 for i in at)
    note = (
        f"{lost} rows are missing, the first after {record.time[at[0]]:.6g} s, and the input there "
        "cannot be interpolated: "
    )
    if not spans:
        note += (
            f"the parts between them are shorter than {least} samples, so that the record is not "
            "divided and the input is a line over the missing rows"
        )
        return [replace(record, notes=(*record.notes, note))]
    left_out = record.samples - sum(b - a for a, b in spans)
    note += f"the record is divided there (parts: {len(spans)})"
    if spans[-1][0] > 0:
        note += "; a part that begins there has an unknown start state"
    if left_out:
        note += f"; {left_out} samples of shorter parts are left out"
    parts = [
        record.cut(a, b, f"{record.name}[{k}/{len(spans)}]") for k, (a, b) in enumerate(spans, 1)
    ]
    parts = [replace(p, repeats="") for p in parts]
    return [replace(parts[0], notes=(*record.notes, note)), *parts[1:]]


def _smooth(record: Record, at: int, count: int) -> bool:
    """Whether the inputs change over the missing rows as they do before and after them."""
    for u in record.inputs.values():
        slopes = np.diff(u)[[max(at - 1, 0), min(at + 1, u.size - 2)]]
        jump = float(u[at + 1] - u[at] - count * np.mean(slopes))
        if at > 0 and abs(jump) > BRIDGED * float(np.std(u)):
            return False
    return True


def _bridged(record: Record, count: int) -> bool:
    """Whether a line over this number of steps follows the inputs elsewhere in the record."""
    half = count // 2
    for u in record.inputs.values():
        if u.size <= count:
            return False
        line = u[:-count] + (u[count:] - u[:-count]) * (half / count)
        error = float(np.sqrt(np.mean((u[half : half + line.size] - line) ** 2)))
        if error > BRIDGED * float(np.std(u)):
            return False
    return True
