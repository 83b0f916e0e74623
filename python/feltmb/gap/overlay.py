"""Compares model and records before any fit, channel by channel."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit.linearize import RUNAWAY
from feltmb.fit.model import Model
from feltmb.fit.noise import rms_of_measured
from feltmb.fit.observe import observe_whole
from feltmb.fit.problem import Problem
from feltmb.fit.runner import untold_trials
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import estimate_states
from feltmb.gap.by_record import grouped
from feltmb.gap.checks import DataChecks, check_against, not_compared, with_sigma
from feltmb.gap.common_delay import common_delay
from feltmb.gap.criteria import (
    ALIKE,
    ANY_FACTOR,
    EXPLAINS_MOST,
    NEAR_UNIT,
    OTHER_SCALE,
    SAME_DELAY,
    WRONG_CLOCK,
)
from feltmb.gap.missing_rows import divided
from feltmb.gap.smoke_test import divergence
from feltmb.gap.tabulated import unknown_starts
from feltmb.style import (
    BLUE,
    GRAY,
    ORANGE,
    head_line,
    new_figure,
    plain_text,
    reader_unit,
    style_axes,
)
from feltmb.units import (
    TEMPERATURE_SCALES,
    readable_unit,
    spelled_unit,
    unit_suffix,
    zero_and_factor,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "GapBefore",
    "GapBeforeRow",
    "check",
    "exchanged_channels",
    "expected_outputs",
    "wrong_input",
    "wrong_units",
]

#: Longest time shift that is tried, as a share of the record.
LONGEST_SHIFT = 0.25
#: Level of continuity defects above which states are estimated, for the start of a record.
LOOSE = 0.1
#: Number of channels in one figure.
MOST_PANELS = 24


@dataclass(frozen=True, kw_only=True)
class GapBeforeRow:
    """Comparison of one channel of one record with the tabulated model."""

    record: str
    channel: str
    unit: str
    samples: int
    """Number of samples that the record and the model both have [1]."""
    rms: float
    """Root mean square of record minus model [unit]."""
    largest: float
    """Largest difference, with its sign [unit]."""
    at: float
    """Time of the largest difference [s]."""
    noise: float
    """Standard deviation of the noise [unit]."""
    correlation: float
    """Correlation of record and model [1]; NaN if one of them is constant."""
    delay: float
    """Delay of the record, if a delay alone explains at least half of the squared difference [s];
    else NaN."""
    factor: float
    """Ratio of record to model, if a factor alone explains at least half of the squared difference
    [1]; else NaN."""

    @property
    def in_noise(self) -> float:
        """Root mean square of the difference in standard deviations of the noise [1]."""
        return self.rms / self.noise if self.noise > 0.0 else float("nan")

    @property
    def largest_in_noise(self) -> float:
        """The largest difference in standard deviations of the noise [1]."""
        return self.largest / self.noise if self.noise > 0.0 else float("nan")


@dataclass(frozen=True, kw_only=True, eq=False)
class GapBefore:
    """Records and the tabulated model, simulated with the inputs of the records."""

    model: str
    rows: tuple[GapBeforeRow, ...]
    checks: DataChecks
    records: tuple[Record, ...]
    """Records in the coordinates of the model."""
    simulated: Mapping[str, Mapping[str, Array]]
    """Outputs of the model by record and channel, at the times of the record."""
    notes: tuple[str, ...]
    """Notes about changes to the records, and hints about the differences."""

    @property
    def told(self) -> list[str]:
        """Notes and warnings; those that say the same of several records are one."""
        return grouped((*self.notes, *self.checks.warnings), self.checks.records)

    @checked
    def plot(self) -> Figure:
        """Plot record and model over time, and their difference; one row of panels per channel."""
        return _figure(self)


@checked
def check(model: Model, records: Sequence[Record] | Record) -> GapBefore:
    """Simulate the inputs of records with the tabulated parameters and compare the outputs.

    No parameter is fitted. A start state that is not known is the one that fits the beginning of
    the record best, and a note tells it. For a mechanism, the derivatives at the beginning of the
    motion are computed as well.

    Raises
    ------
    DataError
        The records are invalid for this model.
    """
    if isinstance(records, Record):
        records = [records]
    records, told = model.driven(divided(model, records))
    notes = [*told, *not_compared(model, records)]
    checks = check_against(model, records)
    clock = wrong_clock(model, records)
    rows: list[GapBeforeRow] = []
    shown: list[Record] = []
    simulated: dict[str, dict[str, Array]] = {}
    for record in records:
        if clock and np.ptp(record.time) > model.longest_run:
            # A simulation with a wrong clock may take very long, and shows nothing.
            notes.append(f"{record.name}: not simulated with this clock")
            continue
        noise = checks.noise(record.name)
        record, said = model.referred(with_sigma(record, noise))
        sigma = {
            n: float(rms_of_measured(x.sd_of_measured(record.time, y), y))
            for n, x in noise.items()
            for y in [record.outputs[n]]
        }
        notes += said
        values = expected_outputs(model, record)
        if not clock:
            values, start = _from_start_of_record(model, record, noise, values)
            notes += start
        text = divergence(record, model.outputs, values)
        if text:
            notes += [text] * (not clock)
            with np.errstate(invalid="ignore"):
                values = np.where(np.abs(values) < RUNAWAY, values, np.nan)
        outputs = {name: values[:, i] for i, name in enumerate(model.outputs)}
        shown.append(record)
        simulated[record.name] = outputs
        for name in record.outputs:
            if name in outputs:
                rows.append(_row(record, name, outputs[name], sigma[name]))
        if not clock:
            notes += _undefined(model, record, outputs, text)
        for cycle in _exchanged(record, outputs, sigma):
            channels = [channel for channel, _ in cycle]
            own = [r for r in rows if r.record == record.name and r.channel in channels]
            if all(_unit_of(r) and abs(r.correlation) > ALIKE for r in own):
                continue  # wrong units are as good an explanation
            rows = [replace(r, factor=float("nan")) if r in own else r for r in rows]
            notes.append(f"{record.name}: {_looks_like(cycle)}: are the columns exchanged?")
    if clock:
        nan = float("nan")
        rows = [replace(r, factor=nan, delay=nan) for r in rows]
        notes.append(f"the unit of {clock}")
    else:
        notes += _hints(rows)
        notes += _of_prepared(model, records, checks)
    return GapBefore(
        model=model.name,
        rows=tuple(rows),
        checks=checks,
        records=tuple(shown),
        simulated=simulated,
        notes=tuple(notes),
    )


def _of_prepared(model: Model, records: Sequence[Record], checks: DataChecks) -> list[str]:
    """What no record reaches, and a delay; see :func:`~feltmb.gap.common_delay.common_delay`."""
    if not math.isfinite(model.longest_run):
        return []
    found = model.ready([with_sigma(r, checks.noise(r.name)) for r in records])
    delay = common_delay(
        found.model,
        [segment_record(found.model, r, checks.noise(r.name), None) for r in found.records],
    )
    return [text for text in (delay, found.unreached) if text]


def _undefined(model: Model, record: Record, outputs: Mapping[str, Array], why: str) -> list[str]:
    """Notes about samples for which the model gives no numbers.

    ``why``: what is known about the reason.

    Raises
    ------
    InvalidParameter
        It gives no output after the first sample.
    """
    missing = {
        name: np.flatnonzero(~np.isfinite(values))
        for name, values in outputs.items()
        if name in record.outputs
    }
    if missing and all(at.size >= record.samples - 1 for at in missing.values()):
        raise InvalidParameter(
            f"model {model.name}, record {record.name}: it gives no finite values of "
            f"{', '.join(missing)}, with the parameters at their priors{why and f' ({why})'}"
        )
    return [
        f"{record.name}: the model gives no numbers for {name} at {at.size} of {record.samples} "
        f"samples, from {record.time[at[0]]:.4g} to {record.time[at[-1]]:.4g} s"
        for name, at in missing.items()
        if at.size
    ]


def expected_outputs(model: Model, record: Record) -> Array:
    """Outputs (n, ny) over the whole record, from the expected start state of the model."""
    theta = np.array([p.value for p in model.parameters])
    start = model.guess([record], [np.array([[0, record.samples - 1]])])[0][0]
    values = observe_whole(model, record, theta, start)
    if not values.shape[0] >= record.samples:
        raise DataError(
            f"record {record.name}: the model {model.name} gives {values.shape[0]} samples, "
            f"expected {record.samples}"
        )
    return values[: record.samples]


def _from_start_of_record(
    model: Model, record: Record, noise: Mapping[str, Noise], expected: Array
) -> tuple[Array, list[str]]:
    """Outputs from the start state that fits the first segment of the record best, with a note.

    If the start is known, or the model diverges, the outputs are those from the expected one.
    """
    if not model.states():
        return expected, []
    problem = Problem(model, (segment_record(model, record, noise, None),), frozen=True)
    unknown = unknown_starts(problem)
    if not unknown.any():
        return expected, []
    theta = np.array([p.value for p in model.parameters])
    # With loose continuity defects, later segments of a poor model hardly move the start.
    point = estimate_states(problem, problem.start(theta=theta), LOOSE)
    start = point.places[0].starts[0]
    values = observe_whole(model, record, theta, start)[: record.samples]
    if not np.all(np.isfinite(values)):
        return expected, []
    states = ", ".join(
        f"{s.name} = {value:.4g}{unit_suffix(s.unit)}"
        for s, value, at in zip(model.states(), start, unknown, strict=True)
        if at
    )
    return values, [
        f"{record.name}: the start is not known; the one that fits its beginning best is {states}"
    ]


def _row(record: Record, name: str, model: Array, sigma: float) -> GapBeforeRow:
    measured = record.outputs[name]
    gap = measured - model
    both = np.isfinite(gap)
    count = int(both.sum())
    nan = float("nan")
    rms, largest, at, correlation, delay, factor = (nan,) * 6
    if count:
        rms = float(np.sqrt(np.mean(gap[both] ** 2)))
        worst = int(np.argmax(np.where(both, np.abs(gap), -1.0)))
        largest, at = float(gap[worst]), float(record.time[worst])
        x, y = measured[both], model[both]
        spread = float(np.std(x) * np.std(y))
        if count > 2 and spread > 0.0:
            correlation = float(np.mean((x - x.mean()) * (y - y.mean())) / spread)
        if rms > sigma:
            factor = _factor(x, y)
            delay = _delay(record.time, measured, model)
    return GapBeforeRow(
        record=record.name,
        channel=name,
        unit=record.sensors[name].unit,
        samples=count,
        rms=rms,
        largest=largest,
        at=at,
        noise=sigma,
        correlation=correlation,
        delay=delay,
        factor=factor,
    )


def _factor(x: Array, y: Array) -> float:
    """Factor with which the model explains most; NaN if less than half of the gap."""
    size = float(y @ y)
    if not size > 0.0:
        return float("nan")
    factor = float(x @ y) / size
    left, whole = float(np.sum((x - factor * y) ** 2)), float(np.sum((x - y) ** 2))
    return factor if left < (1.0 - EXPLAINS_MOST) * whole else float("nan")


def _delay(time: Array, measured: Array, model: Array) -> float:
    """Time shift with which the model explains most [s]; NaN if less than half of the gap."""
    both = np.isfinite(measured) & np.isfinite(model)
    count = int(min(time.size, 4096))
    if both.sum() < 8:
        return float("nan")
    clock = np.linspace(time[0], time[-1], count)
    step = float(clock[1] - clock[0])
    x = np.interp(clock, time[both], measured[both])
    y = np.interp(clock, time[both], model[both])
    most = int(LONGEST_SHIFT * count)
    padded = np.concatenate([np.full(most, y[0]), y, np.full(most, y[-1])])
    # Sums of squares of all shifts at once: x^2 - 2 x y + y^2, with the product by convolution.
    from scipy.signal import fftconvolve

    product = fftconvolve(padded, x[::-1], mode="valid")
    squares = np.concatenate([[0.0], np.cumsum(padded**2)])
    cost = float(x @ x) - 2.0 * product + squares[count:] - squares[:-count]
    best = int(np.argmin(cost))
    if best in (0, 2 * most) or not cost[best] < (1.0 - EXPLAINS_MOST) * cost[most]:
        return float("nan")
    a, b, c = cost[best - 1 : best + 2]
    bend = a - 2.0 * b + c
    fine = 0.5 * (a - c) / bend if bend > 0.0 else 0.0
    return float((most - best - fine) * step)


#: Units that are used with the prefix milli.
_PREFIXED = ("m", "N", "s", "V", "A", "Pa", "rad")
#: Factors caused by wrong units, their description, and the unit for which it holds ("": all).
_UNITS: tuple[tuple[float, str, str], ...] = (
    *((1e3, f"m{unit} labeled as {unit}", unit) for unit in _PREFIXED),
    *((1e-3, f"{unit} labeled as m{unit}", unit) for unit in _PREFIXED),
    (1e3, "a thousand times too large", ""),
    (1e-3, "a thousand times too small", ""),
    (10.0, "mm labeled as cm", "m"),
    (0.1, "cm labeled as mm", "m"),
    (25.4, "mm labeled as inches", "m"),
    (1.0 / 25.4, "inches labeled as mm", "m"),
    (9.80665, "N labeled as kgf", "N"),
    (1.0 / 9.80665, "kgf labeled as N", "N"),
    (180.0 / math.pi, "degrees labeled as rad", "rad"),
    (math.pi / 180.0, "rad labeled as degrees", "rad"),
    (-1.0, "the other direction", ""),
)


def _unit_of(row: GapBeforeRow) -> str:
    """Description of the wrong unit that would produce a factor; empty: none.

    The factor may differ from that of the unit by what the model lacks: by ``NEAR_UNIT`` of the
    distance between the factor of the unit and 1, in logarithms, or of that between 10 and 1.
    """
    near = [
        (off, not of, text)
        for unit, text, of in _UNITS
        if of in ("", row.unit) and (off := _distance(row.factor, unit)) < NEAR_UNIT
    ]
    return min(near)[2] if near else ""


def _distance(factor: float, unit: float) -> float:
    """Distance of a factor from that of a unit, relative to the latter, in logarithms."""
    ratio = factor / unit
    if not ratio > 0.0:
        return math.inf
    return abs(math.log(ratio)) / max(abs(math.log(abs(unit))), math.log(10.0))


def wrong_units(model: Model, runs: Sequence[tuple[Record, Array, Mapping[str, float]]]) -> str:
    """Description of wrong units in one sentence; empty if there are none.

    Reported only if every parameter of the machine has a finite tolerance below a factor. All
    records of a channel have the wrong unit, or some have it and the others agree with the model.

    Parameters
    ----------
    runs
        Record, residual of the model (n, ny) and noise by channel.
    """
    if not _is_tabulated(model):
        return ""
    found: dict[tuple[str, float, tuple[str, ...]], list[str]] = {}
    for i, name in enumerate(model.outputs):
        rows = [
            _row(r, name, r.outputs[name] - rest[:, i], noise[name])
            for r, rest, noise in runs
            if name in r.outputs
        ]
        rows = [r for r in rows if r.samples > 2 and r.correlation == r.correlation]
        told = [_unit_of(r) for r in rows]
        wrong = [r for r, text in zip(rows, told, strict=True) if text]
        texts = {text for text in told if text}
        # The others agree with the model, or no factor explains their difference (NaN).
        agree = all(
            math.isnan(r.factor) or _distance(r.factor, 1.0) < NEAR_UNIT
            for r, text in zip(rows, told, strict=True)
            if not text
        )
        if len(texts) == 1 and agree and min(abs(r.correlation) for r in rows) > ALIKE:
            factor = float(np.median([r.factor for r in wrong]))
            some = () if len(wrong) == len(rows) else tuple(r.record for r in wrong)
            key = (texts.pop(), round(factor, 0 if factor > 2.0 else 3), some)
            found.setdefault(key, []).append(name)
    inputs = sorted({name for r, _, _ in runs for name in r.inputs})
    sentences = []
    for (text, factor, some), names in found.items():
        where = f"record {', '.join(some)}" if some else "all records"
        # A factor of all outputs may be a factor of what drives them.
        driven = inputs and len(names) == len(model.outputs)
        other = f" Or {' or '.join(inputs)} is in another unit." if driven else ""
        sentences.append(
            f"{', '.join(names)}: {factor:.3g} times the model in {where} ({text}?{other})"
        )
    return "; ".join([*sentences, *_scales_of_temperature(model, runs)])


def _pairs(
    runs: Sequence[tuple[Record, Array, Mapping[str, float]]], i: int, name: str
) -> list[tuple[Array, Array]]:
    """Measured and simulated values of an output by record."""
    out = []
    for record, rest, _ in runs:
        if name not in record.outputs:
            continue
        x, gap = record.outputs[name], rest[:, i]
        both = np.isfinite(x) & np.isfinite(gap)
        if both.sum() > 2:
            out.append((x[both], (x - gap)[both]))
    return out


def _scales_of_temperature(
    model: Model, runs: Sequence[tuple[Record, Array, Mapping[str, float]]]
) -> list[str]:
    """Channels whose temperatures are on another scale than that of their label in all records.

    The label may differ from the unit of the model, to which the file was converted.
    """
    out = []
    scales = {true for true, _ in TEMPERATURE_SCALES}
    for i, name in enumerate(model.outputs):
        own = model.units.get(name, "")
        own = spelled_unit(own) or own
        pairs = _pairs(runs, i, name) if own in scales else []
        gap = [np.mean((x - y) ** 2) for x, y in pairs]
        most, best = OTHER_SCALE**2, ""
        for true, labeled in TEMPERATURE_SCALES:
            left = [
                np.mean((x - _reading(_reading(y, own, true), labeled, own)) ** 2) for x, y in pairs
            ]
            share = max(
                (float(a / b) for a, b in zip(left, gap, strict=True) if b > 0.0), default=1.0
            )
            if share < most:
                names = [n.replace("degF", "degrees Fahrenheit") for n in (true, labeled)]
                most, best = share, f"{names[0]} labeled as {names[1]}"
        if best:
            out.append(f"{name}: another scale in all records ({best}?)")
    return out


def _reading(values: Array, scale: str, other: str) -> Array:
    """Temperatures on another scale."""
    zero, factor = zero_and_factor(scale, other)
    return (values - zero) * factor


#: Factors of a clock in a wrong unit, and their description.
_CLOCKS = (
    (60.0, "minutes labeled as s"),
    (1.0 / 60.0, "s labeled as minutes"),
    (1e-3, "ms labeled as s"),
    (1e3, "s labeled as ms"),
    (3600.0, "hours labeled as s"),
    (1.0 / 3600.0, "s labeled as hours"),
)
#: Longest clock of a model without states, which may need a time in proportion to it.
LONGEST_OF_FUNCTION = 1e3
#: What else explains a clock: the unit of time of the model is shorter, or longer, than a second.
_OF_MODEL = {1e3: "ms", 1.0 / 60.0: "minute", 1.0 / 3600.0: "hour"}


def wrong_clock(model: Model, records: Sequence[Record]) -> str:
    """Description of a clock in a wrong unit, in one sentence; empty if it is right.

    The model follows all records with another clock far better than with the recorded one. A clock
    with which a record exceeds ``model.longest_run`` does not explain it. The unit of time of the
    equations of a user may be the wrong one.
    """
    own = "" if math.isfinite(model.longest_run) else "? Or are the rates of the model per {}"
    return _follows_other(
        model,
        records,
        [
            (
                f"time: the model follows all records with a clock {factor:.4g} times as long "
                f"({text}{own.format(_OF_MODEL[factor]) if factor in _OF_MODEL else ''}?)",
                partial(Record.stretched, factor=factor),
            )
            for factor, text in _CLOCKS
            if factor <= LONGEST_OF_FUNCTION or model.states()
        ],
    )


def wrong_input(model: Model, records: Sequence[Record]) -> str:
    """Description of an input in a wrong unit, in one sentence; empty if there is none.

    Beside a constant, such as the temperature of the room, the outputs do not have the factor of
    the input. A mechanism, whose time steps follow the motion, is not tested.
    """
    if math.isfinite(model.longest_run):
        return ""
    shared = set.intersection(*(set(r.inputs) for r in records))
    return _follows_other(
        model,
        records,
        [
            (
                f"{name}: the model follows all records with {factor:g} times the values of this "
                "input (is its unit another one than its label?)",
                partial(_scaled, name=name, factor=factor),
            )
            for name in sorted(shared)
            for factor in (1e3, 1e-3)
        ],
    )


def _scaled(record: Record, name: str, factor: float) -> Record:
    return record.with_changed_inputs(lambda whole: {name: factor * whole.inputs[name]})


def _follows_other(
    model: Model,
    records: Sequence[Record],
    others: Sequence[tuple[str, Callable[[Record], Record]]],
) -> str:
    """Description of the change of the records with which the model follows all of them best.

    The parameters have their tabulated values, and the zeros of the outputs do not count. Chaotic
    models and records that start during a motion are not tested.
    """

    def gap(record: Record) -> float:
        """Mean over the outputs of the variance of the gap, each over that of the output."""
        if np.ptp(record.time) > model.longest_run:
            return 1.0
        with untold_trials():
            values = expected_outputs(model, record)
        shares = []
        for i, name in enumerate(model.outputs):
            measured = record.outputs.get(name, np.zeros(0))
            there = np.isfinite(measured)
            variance = float(np.var(measured[there])) if there.any() else 0.0
            if variance > 0.0:
                with np.errstate(over="ignore", invalid="ignore"):
                    off = float(np.var(measured[there] - values[there, i]))
                shares.append(off / variance if math.isfinite(off) else math.inf)
        return float(np.mean(shares)) if shares else 0.0

    records = [r for r in records if r.start is None or r.start.known]
    if not records or model.chaotic or not _is_tabulated(model):
        return ""
    most = []
    for record in records:
        own = gap(record)
        if own < WRONG_CLOCK:
            return ""
        most.append(min(OTHER_SCALE**2 * own, EXPLAINS_MOST))
    best = ""
    for text, changed in others:
        left = []
        for record, limit in zip(records, most, strict=True):
            left.append(gap(changed(record)))
            if not left[-1] < limit:
                break
        else:
            best, most = text, left
    return best


def exchanged_channels(
    model: Model, runs: Sequence[tuple[Record, Array, Mapping[str, float]]]
) -> str:
    """Channels that the model explains better in another order, in one sentence; empty if none.

    Reported only if every parameter of the machine has a finite tolerance below a factor, and if
    all records that have these channels show the same.

    Parameters
    ----------
    runs
        Record, residual of the model (n, ny) and noise by channel.
    """
    if not _is_tabulated(model):
        return ""
    found = []
    for record, rest, noise in runs:
        simulated = {
            name: record.outputs[name] - rest[:, i]
            for i, name in enumerate(model.outputs)
            if name in record.outputs
        }
        found.append((record, _exchanged(record, simulated, noise)))
    cycles = dict.fromkeys(cycle for _, own in found for cycle in own)
    return "; ".join(
        _looks_like(cycle)
        for cycle in cycles
        if all(
            cycle in own
            for record, own in found
            if all(channel in record.outputs for channel, _ in cycle)
        )
    )


def _is_tabulated(model: Model) -> bool:
    """Whether every parameter of the machine has a finite tolerance below a factor."""
    own = [p for p in model.parameters if p.of_the_machine]
    return not any(p.sd == np.inf or p.sd > ANY_FACTOR * abs(p.value) > 0.0 for p in own)


def _looks_like(cycle: Sequence[tuple[str, str]]) -> str:
    return ", ".join(f"{name} looks like {other}" for name, other in cycle)


def _exchanged(
    record: Record, simulated: Mapping[str, Array], noise: Mapping[str, float]
) -> list[tuple[tuple[str, str], ...]]:
    """Cycles of channels, each with the one that it looks like.

    The other output must leave less than half of the squared difference that each channel has to
    its own one, which must be more than noise. Of the variance of all channels of the cycle, the
    other outputs must explain at least half, and their own ones less, or the others leave far less
    than their own ones: channels that are nearly equal explain each other.
    """
    from scipy.optimize import linear_sum_assignment

    cycles = []
    names = [n for n in simulated if n in record.outputs]
    names = [n for n in names if np.isfinite(record.outputs[n] - simulated[n]).any()]
    for unit in dict.fromkeys(record.sensors[n].unit for n in names):
        own = [n for n in names if record.sensors[n].unit == unit]
        noises = np.array([noise[n] for n in own])
        measured = np.stack([record.outputs[n] for n in own]) / noises[:, None]
        found = np.stack([simulated[n] for n in own])
        cost = np.zeros((len(own), len(own)))
        for i, j in np.ndindex(cost.shape):
            gap = measured[i] - found[j] / noises[i]
            # Far from everything without a common sample.
            cost[i, j] = np.nanmean(gap**2) if np.isfinite(gap).any() else np.inf
        worst = np.max(cost, where=np.isfinite(cost), initial=1.0)
        order = linear_sum_assignment(np.minimum(cost, 1e3 * worst))[1].tolist()
        spread, as_it_is = np.nanvar(measured, axis=1), np.diag(cost)
        left = cost[np.arange(len(own)), order]
        share = 1.0 - EXPLAINS_MOST
        cycles += [
            tuple((own[i], own[order[i]]) for i in cycle)
            for cycle in _cycles(order)
            if np.all(as_it_is[cycle] > 1.0)
            and np.all(left[cycle] < share * as_it_is[cycle])
            and np.sum(left[cycle]) < share * np.sum(spread[cycle])
            and _is_far(np.sum(as_it_is[cycle]), np.sum(left[cycle]), np.sum(spread[cycle]))
        ]
    return cycles


def _is_far(own: float, other: float, spread: float) -> bool:
    """Whether own outputs leave most of a variance, or much of it and far more than the others."""
    far = own > (1.0 - EXPLAINS_MOST) * spread
    return far or (own > WRONG_CLOCK * spread and other < OTHER_SCALE**2 * own)


def _cycles(order: Sequence[int]) -> list[list[int]]:
    """Cycles of a permutation that move something."""
    found: list[list[int]] = []
    left = set(range(len(order)))
    while left:
        cycle = [min(left)]
        while (after := order[cycle[-1]]) != cycle[0]:
            cycle.append(after)
        left -= set(cycle)
        if len(cycle) > 1:
            found.append(cycle)
    return found


def _hints(rows: Sequence[GapBeforeRow]) -> list[str]:
    """Hints about the likely cause of time shifts and factors."""
    notes = []
    for r in rows:
        if text := _unit_of(r):
            notes.append(f"{r.record}: {r.channel} is {r.factor:.4g} times the model: {text}?")
    # A reversed oscillation is also its own half period later.
    late = [r for r in rows if np.isfinite(r.delay) and not _unit_of(r)]
    by_record: dict[str, list[GapBeforeRow]] = {}
    for r in late:
        by_record.setdefault(r.record, []).append(r)
    for name, own in by_record.items():
        all_of = [r for r in rows if r.record == name]
        delays = np.array([r.delay for r in own])
        if len(own) == len(all_of) > 1 and np.ptp(delays) < SAME_DELAY * abs(np.mean(delays)):
            mean = float(np.mean(delays))
            factor, unit = readable_unit(mean, "s")
            notes.append(
                f"{name}: every channel is about {factor * mean:.3g} {unit} late: is the input on "
                "the same clock?"
            )
    return notes


def _figure(gap: GapBefore) -> Figure:
    rows = [r for r in gap.rows if r.samples][:MOST_PANELS]
    count = max(len(rows), 1)
    figure = new_figure(9.0, 0.6 + 2.1 * count)
    axes = figure.subplots(count, 2, squeeze=False, width_ratios=(3, 2))
    by_name = {r.name: r for r in gap.records}
    clock, shown = readable_unit(max((r.time[-1] for r in gap.records), default=0.0), "s")
    for (left, right), r in zip(axes, rows, strict=False):
        record = by_name[r.record]
        factor, unit = reader_unit(r.unit)
        unit = "" if unit == "1" else f" [{unit}]"
        time = clock * record.time
        model = gap.simulated[r.record][r.channel]
        measured = record.outputs[r.channel]
        style_axes(left, y=plain_text(f"{r.channel}{unit}"))
        left.plot(time, factor * measured, color=BLUE, lw=1.4, label="record")
        left.plot(time, factor * model, color=ORANGE, lw=1.1, ls="--", label="model")
        title = r.record if len(gap.records) > 1 or r is rows[0] else ""
        left.set_title(plain_text(title), fontsize=8.5, loc="left")
        sd = gap.checks.noise(r.record)[r.channel].sd_of_measured(record.time, measured)
        band = 2.0 * factor * sd
        style_axes(right, y=plain_text(f"record - model{unit}"))
        right.fill_between(time, -band, band, color=GRAY, alpha=0.25, lw=0)
        right.plot(time, factor * (measured - model), color=BLUE, lw=1.0)
        right.set_title(
            f"rms {factor * r.rms:.3g}{unit.strip(' []') and ' ' + unit.strip(' []')}"
            f", {r.in_noise:.3g} x noise",
            fontsize=8.5,
            loc="left",
        )
    if rows:
        axes[0, 0].legend(frameon=False, fontsize=8, loc="best")
    for ax in axes[-1]:
        ax.set_xlabel(f"time [{shown}]", fontsize=8.5)
    head_line(
        figure, plain_text(f"{gap.model}: the gap before anything is fitted"), weight="normal"
    )
    return figure
