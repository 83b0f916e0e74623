"""Errors of records that would explain a difference better than the model and the labels do.

Units, signs, scales of temperature, clocks, exchanged columns, delays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from feltmb.data import Array, Record
from feltmb.fit.model import Model
from feltmb.gap.beside import Compared, simulated
from feltmb.units import TEMPERATURE_SCALES, readable_unit, spelled_unit, zero_and_factor

__all__ = ["Hint", "hints"]

#: Records, each with the outputs of the tabulated model.
Runs = Sequence[tuple[Record, Mapping[str, Array]]]

#: Correlation of record and model from which a factor is told, and is certainly a unit if it is
#: about this large [1].
ALIKE, SURE, LARGE = 0.9, 0.99, 9.0
#: Largest distance of a factor from that of a unit, as a share of their logarithms [1].
NEAR = 0.15
#: Share of the squared difference that an explanation must take away; shares that another clock,
#: input, or scale may leave to be told, and to be certain; smallest share of the variance for which
#: these are tried [1].
MOST, SOME, LEFT, TRIED = 0.5, 0.1, 0.04, 0.1
#: Largest spread of the delays of all channels that are one delay [1].
SAME = 0.3
#: Prior standard deviation, as a share of the value, from which a parameter may have any size [1].
ANY_SIZE = 0.5
#: Units that are used with the prefix milli.
_MILLI = ("m", "N", "s", "V", "A", "Pa", "rad")
#: Factor of record over model, what would cause it, and the unit for which it holds ("": all).
_FACTORS: tuple[tuple[float, str, str], ...] = (
    *((1e3, f"m{unit} labeled as {unit}", unit) for unit in _MILLI),
    *((1e-3, f"{unit} labeled as m{unit}", unit) for unit in _MILLI),
    (1e3, "a thousand times too large", ""),
    (1e-3, "a thousand times too small", ""),
    (10.0, "mm labeled as cm", "m"),
    (0.1, "cm labeled as mm", "m"),
    (100.0, "cm labeled as m", "m"),
    (0.01, "m labeled as cm", "m"),
    (25.4, "mm labeled as inches", "m"),
    (1.0 / 25.4, "inches labeled as mm", "m"),
    (9.80665, "N labeled as kgf", "N"),
    (1.0 / 9.80665, "kgf labeled as N", "N"),
    (180.0 / math.pi, "degrees labeled as rad", "rad"),
    (math.pi / 180.0, "rad labeled as degrees", "rad"),
    (-1.0, "the other direction", ""),
)
#: Factors of a clock in a wrong unit.
_CLOCKS = (
    (60.0, "minutes labeled as s"),
    (1.0 / 60.0, "s labeled as minutes, or rates of the model per minute"),
    (1e-3, "ms labeled as s"),
    (1e3, "s labeled as ms, or rates of the model per ms"),
    (3600.0, "hours labeled as s"),
    (1.0 / 3600.0, "s labeled as hours, or rates of the model per hour"),
)


@dataclass(frozen=True)
class Hint:
    """An error of the records that would explain a difference."""

    kind: Literal["unit", "sign", "scale", "clock", "input", "exchange", "delay"]
    channels: tuple[str, ...]
    text: str
    sure: bool = False
    """Whether nothing else explains it; a diagnosis refuses such records."""


def hints(model: Model, runs: Runs, rows: Sequence[Compared]) -> tuple[Hint, ...]:
    """Hints about the differences; a certain one rests on parameters with small tolerances.

    Parameters
    ----------
    model
        Model of the machine.
    runs
        Records, each with the outputs of the tabulated model.
    rows
        Channels of the records beside the model.
    """
    size = _size_of_tolerances(model)
    found: list[Hint] = []
    if math.isfinite(size):
        found += _clock(model, runs)
        if not found:
            units = [*_units(rows)]
            known = {n for h in units for n in h.channels}  # as good an explanation as an exchange
            found += [h for h in _exchanged(runs, rows) if not known >= {*h.channels}]
            taken = {n for h in found for n in h.channels}
            found += [h for h in units if not taken & {*h.channels}] + [*_scales(model, runs)]
        if not found:
            found += _input(model, runs)
    if size > ANY_SIZE:
        found = [replace(h, sure=False) for h in found]
    return tuple(found or _delays(rows))


def _size_of_tolerances(model: Model) -> float:
    """Largest tolerance of a parameter of the machine, as a share of its value [1]."""
    own = [p for p in model.parameters if p.of_the_machine]
    return max(
        (p.sd / abs(p.value or 1.0) for p in own if p.value or math.isinf(p.sd)), default=0.0
    )


def _known_factor(row: Compared) -> tuple[float, str] | None:
    """The factor of a wrong unit or sign that is near to that of a row, and its description."""
    if not (abs(row.correlation) > ALIKE and abs(row.offset) <= row.motion):
        return None
    found = []
    for factor, text, unit in _FACTORS:
        ratio = row.factor / factor
        if unit not in ("", row.unit) or not ratio > 0.0:
            continue
        off = abs(math.log(ratio)) / max(abs(math.log(abs(factor))), math.log(10.0))
        if off < NEAR:
            found.append((off, not unit, factor, text))
    return min(found)[2:] if found else None


def _units(rows: Sequence[Compared]) -> Iterator[Hint]:
    """Channels whose factor is that of a wrong unit in all records, or in some of them."""
    groups: dict[tuple[float, str, tuple[str, ...]], list[list[Compared]]] = {}
    for name in dict.fromkeys(r.channel for r in rows):
        own = [r for r in rows if r.channel == name and math.isfinite(r.correlation)]
        known = [_known_factor(r) for r in own]
        wrong = [r for r, k in zip(own, known, strict=True) if k]
        if not wrong or len({k for k in known if k}) > 1:
            continue
        if all(k or abs(r.factor - 1.0) < MOST for r, k in zip(own, known, strict=True)):
            where = () if len(wrong) == len(own) else tuple(r.record for r in wrong)
            key = (*next(k for k in known if k), where)
            groups.setdefault(key, []).append(wrong)
    for (factor, text, where), found in groups.items():
        wrong = [r for g in found for r in g]
        sign = factor < 0.0
        large = sign or abs(math.log(abs(factor))) > math.log(LARGE)
        value = float(np.median([r.factor for r in wrong]))
        names = tuple(g[0].channel for g in found)
        yield Hint(
            "sign" if sign else "unit",
            names,
            f"{', '.join(names)} is {value:.4g} times the model in "
            f"{'record ' + ', '.join(where) if where else 'all records'}: {text}?"
            f"{_reversed(wrong) if sign else ''}",
            large and all(abs(r.correlation) > SURE for r in wrong),
        )


def _reversed(wrong: Sequence[Compared]) -> str:
    """The option that reverses a channel of a camera; "" for other channels."""
    names = [n for n, unit in dict.fromkeys((r.channel, r.unit) for r in wrong) if unit == "m"]
    options = ",".join(f"{n}=-LENGTH" for n in names)
    return f" (mirrored picture: --scale {options} with the length of a pixel)" if names else ""


def _scales(model: Model, runs: Runs) -> Iterator[Hint]:
    """Temperatures on another scale than that of their label in all records."""
    scales = {true for true, _ in TEMPERATURE_SCALES}
    for name in model.outputs:
        own = spelled_unit(model.units.get(name, "")) or model.units.get(name, "")
        pairs = [(r.outputs[name], y[name]) for r, y in runs if name in r.outputs]
        if own not in scales or not pairs:
            continue
        best, most = "", LEFT
        for true, label in TEMPERATURE_SCALES:
            shares = []
            for x, y in pairs:
                other = _reading(_reading(y, own, true), label, own)
                with np.errstate(all="ignore"):
                    shares.append(float(np.nanmean((x - other) ** 2) / np.nanmean((x - y) ** 2)))
            if max(shares) < most:
                best, most = f"{true} labeled as {label}", max(shares)
        if best:
            yield Hint("scale", (name,), f"{name} is on another scale in all records: {best}?",
                       sure=True)  # fmt: skip


def _reading(values: Array, scale: str, other: str) -> Array:
    zero, factor = zero_and_factor(scale, other)
    return np.asarray((values - zero) * factor)


def _left(record: Record, outputs: Mapping[str, Array]) -> float:
    """Mean over the channels of the variance of the difference over that of the record."""
    shares = []
    for name, measured in record.outputs.items():
        if name in outputs:
            variance = float(np.nanvar(measured)) if np.isfinite(measured).any() else 0.0
            if variance > 0.0:
                with np.errstate(all="ignore"):
                    off = float(np.var((measured - outputs[name])[np.isfinite(measured)]))
                shares.append(off / variance if math.isfinite(off) else math.inf)
    return float(np.mean(shares)) if shares else 0.0


def _follows(
    model: Model,
    runs: Runs,
    others: Sequence[tuple[Hint, Callable[[Record], Record]]],
) -> list[Hint]:
    """The change of the records with which the model follows all of them far better, if any."""
    runs = [(r, y) for r, y in runs if r.start is None or r.start.known]
    now = [_left(*run) for run in runs]
    if not runs or min(now) < TRIED:
        return []
    most = [min(SOME * v, MOST) for v in now]
    best: list[Hint] = []
    for hint, changed in others:
        left: list[float] = []
        for (record, _), limit in zip(runs, most, strict=True):
            other = changed(record)
            left.append(_left(record, simulated(model, other)))
            if not left[-1] < limit:
                break
        else:
            sure = all(a < LEFT * b for a, b in zip(left, now, strict=True))
            best, most = [replace(hint, sure=sure)], left
    return best


def _clock(model: Model, runs: Runs) -> list[Hint]:
    others = [
        (
            Hint("clock", ("time",), f"the model follows all records with a clock {factor:.4g} "
                 f"times as long: is the unit of time another one ({text})?"),
            partial(Record.stretched, factor=factor),
        )
        for factor, text in _CLOCKS
        if factor < 1.0 or model.states()  # without states, a long record may need very long
    ]  # fmt: skip
    return _follows(model, runs, others)


def _input(model: Model, runs: Runs) -> list[Hint]:
    """An input in another unit: beside a constant, the outputs do not have its factor."""
    if not model.states():  # a mechanism, whose steps follow the motion, may need very long
        return []

    def scaled(record: Record, name: str, factor: float) -> Record:
        return record.with_changed_inputs(lambda whole: {name: factor * whole.inputs[name]})

    shared = set.intersection(*(set(r.inputs) for r, _ in runs))
    others = [
        (
            Hint("input", (name,), f"the model follows all records with {factor:g} times the "
                 f"values of {name}: is its unit another one than its label?"),
            partial(scaled, name=name, factor=factor),
        )
        for name in sorted(shared)
        for factor in (1e3, 1e-3)
    ]  # fmt: skip
    return _follows(model, runs, others)


def _exchanged(runs: Runs, rows: Sequence[Compared]) -> list[Hint]:
    """Channels that the model explains far better in another order, in all records."""
    from scipy.optimize import linear_sum_assignment

    found: dict[tuple[tuple[str, str], ...], int] = {}
    having: list[set[str]] = []
    for record, outputs in runs:
        own = [r for r in rows if r.record == record.name and r.samples > 2 and r.motion > 0.0]
        having.append({r.channel for r in own})
        for unit in dict.fromkeys(r.unit for r in own):
            same = [r for r in own if r.unit == unit]
            cost = np.full((len(same), len(same)), 1e9)  # share of the motion that is left
            for i, j in np.ndindex(cost.shape):
                gap = record.outputs[same[i].channel] - outputs[same[j].channel]
                if np.isfinite(gap).any():
                    with np.errstate(all="ignore"):
                        cost[i, j] = min(np.nanmean(gap**2) / same[i].motion ** 2, 1e9)
            order = linear_sum_assignment(cost)[1].tolist()
            for cycle in _cycles(order):
                cycle = sorted(cycle, key=lambda k: same[k].channel)
                now, left = cost[cycle, cycle], cost[cycle, [order[k] for k in cycle]]
                noise = np.array([(same[k].noise / same[k].motion) ** 2 for k in cycle])
                far = now.sum() > MOST * len(cycle) or (
                    now.sum() > TRIED * len(cycle) and left.sum() < LEFT * now.sum()
                )
                if far and np.all(now > noise) and np.all(left < MOST * np.minimum(now, 1.0)):
                    key = tuple((same[k].channel, same[order[k]].channel) for k in cycle)
                    found[key] = found.get(key, 0) + 1
    hints = []
    for key, count in found.items():
        names = tuple(a for a, _ in key)
        of = sum(set(names) <= h for h in having)
        text = ", ".join(f"{a} looks like {b}" for a, b in key)
        several = count == of
        hints.append(Hint("exchange", names, f"{text}: are the columns exchanged?", several))
    return hints


def _cycles(order: Sequence[int]) -> Iterator[list[int]]:
    """Cycles of a permutation that move something."""
    left = set(range(len(order)))
    while left:
        cycle = [min(left)]
        while (after := order[cycle[-1]]) != cycle[0]:
            cycle.append(after)
        left -= set(cycle)
        if len(cycle) > 1:
            yield cycle


def _delays(rows: Sequence[Compared]) -> list[Hint]:
    """About the same delay of every channel in every record, and nothing else.

    A lighter or an easier part is early, too. Then the difference is no pure delay, and a hint to
    shift the records would spoil them.
    """
    delays = np.array([r.delay for r in rows])
    mean = float(np.mean(delays))
    if len(rows) < 2 or not np.ptp(delays) <= SAME * abs(mean):
        return []
    if max(r.delayed for r in rows) > LEFT:
        return []
    factor, unit = readable_unit(mean, "s")
    text = f"every channel is {abs(factor * mean):.3g} {unit} {'late' if mean > 0.0 else 'early'}"
    names = tuple(dict.fromkeys(r.channel for r in rows))
    return [Hint("delay", names, f"{text}: is the input on the same clock?")]
