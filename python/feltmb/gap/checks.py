"""Data checks before any fit: clocks, missing values, resolution and noise of records."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import DataError, near_names
from feltmb.fit import Model
from feltmb.fit.noise import Noise, noise_of, rounding_error
from feltmb.gap import outliers
from feltmb.gap.by_record import grouped
from feltmb.gap.color import averaged_noise, color_at_rest, still_blocks
from feltmb.gap.criteria import (
    ALPHA,
    AWAY_FROM_REST,
    CLOCK_JUMP,
    COARSE,
    FINE_DIGITS,
    MOST_CLIPPED,
    MOST_MISSING,
    QUIET_BLOCKS,
    UNEVEN_STEP,
    WHOLE_STEPS,
)
from feltmb.gap.scatter import grows_with_value
from feltmb.gap.tare import forces_before_motion
from feltmb.units import same_unit, unit_suffix, weight_hint

__all__ = ["ChannelCheck", "DataChecks", "check_records"]

#: Number of equal samples from which two records count as copies. Shorter sequences of readings
#: with few digits may be equal by chance.
LEAST_COPY = 8
#: Largest relative difference between the steps of clocks that count as the same.
SAME_CLOCK = 1e-3
#: Largest rms difference of the inputs of two repeats, as a share of their spread: the outputs of
#: other inputs differ, and the difference is no noise.
SAME_INPUT = 0.1
#: Four times the relative error of a noise estimate from n samples, 2 / sqrt(n), times sqrt(n).
QUIET_RECORDS = 8.0
#: Differences of values below this share of their spread are errors of arithmetic.
LEAST_STEP = 1e-9
#: Methods that estimate the noise from one record.
ESTIMATED = ("rest", "differences", "prediction", "spread")


@dataclass(frozen=True, kw_only=True)
class ChannelCheck:
    """Results of the data checks for one channel of one record."""

    record: str
    channel: str
    unit: str
    samples: int
    missing: float
    """Share of samples without a value [1]."""
    spread: float
    """Standard deviation of the signal [unit]."""
    sigma: float
    """Standard deviation of the noise that is used, resolution included [unit]; if ``relative`` >
    0, at the value zero."""
    method: str
    """Source of sigma: "sensor", "repeats", "rest", "differences", "prediction",
    "spread"."""
    correlation_time: float
    """Correlation time of the noise [s]."""
    averaged: int
    """Number of samples of the moving average that the noise resembles [1]; 1: the noise is white
    or has an exponential correlation."""
    quantum: float
    """Smallest step between values, i.e. the resolution [unit]; 0: not found."""
    clipped: float
    """Share of samples at the largest or smallest value of the channel [1]."""
    drift: float
    """Low-frequency drift of the segment at rest, in sigma."""
    white: float = 0.0
    """Share of the noise variance that is white, if the sensor states colored noise [1]."""
    relative: float = 0.0
    """Standard deviation of the noise that is proportional to the value [1]."""

    @property
    def noise(self) -> Noise:
        """The noise that is used."""
        return Noise(self.sigma, self.correlation_time, self.averaged, self.white, self.relative)

    @checked
    def with_noise_times(self, factor: float) -> ChannelCheck:
        """The check with larger noise."""
        new = self.noise.scaled(factor)
        return replace(self, sigma=new.sigma, relative=new.relative)


@dataclass(frozen=True, kw_only=True)
class DataChecks:
    """Result of the data checks of all records."""

    channels: tuple[ChannelCheck, ...]
    problems: tuple[str, ...]
    """Faults because of which the records cannot be used."""
    warnings: tuple[str, ...]
    repeatability: tuple[tuple[str, str, float], ...]
    """(label, channel, standard deviation between repeats [unit])."""
    estimated: bool
    """Whether sigma of a channel was estimated from the data."""
    spiky: tuple[str, ...] = ()
    """Outputs with single samples far from the samples before and after."""

    @property
    def told(self) -> list[str]:
        """The warnings; those that say the same of several records are one."""
        return grouped(self.warnings, self.records)

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(dict.fromkeys(c.record for c in self.channels))

    @checked
    def noise(self, record: str) -> dict[str, Noise]:
        """Noise of each channel of a record."""
        return {c.channel: c.noise for c in self.channels if c.record == record}


@checked
def check_records(records: Sequence[Record], outputs: Sequence[str] | None = None) -> DataChecks:
    """Check records without a model.

    Parameters
    ----------
    records
        All records; repeats are recognized by their label.
    outputs
        Channels that are checked; default: all.
    """
    if not records:
        raise DataError("no records: expected at least one")
    names = [r.name for r in records]
    doubled = sorted({n for n in names if names.count(n) > 1})
    if doubled:
        raise DataError(
            f"records: the name {', '.join(doubled)} is used twice (a file given twice, or "
            "two files of one name)"
        )
    problems, strange, spiky = outliers.told(records, outputs)
    warnings = [*without_copies(records)[1], *strange]
    repeats = _repeatability(records, warnings)
    channels = []
    for record in records:
        warnings += [f"{record.name}: {note}" for note in record.notes]
        _clock(record, problems, warnings)
        numbers = all(np.isfinite(v).sum() <= 1 for v in record.outputs.values())
        for name, values in record.outputs.items():
            if outputs is not None and name not in outputs:
                continue
            check = _channel(record, name, values, repeats)
            where = f"{record.name}.{name}"
            if check.samples < 8 and check.method != "sensor":
                problems.append(f"{where}: {check.samples} values, expected at least 8")
            elif check.samples > 1 and check.spread == 0.0:
                warnings.append(f"{where}: never changes")
            elif 0 < check.samples < 8 and not numbers:
                warnings.append(
                    f"{where}: {check.samples} values: enough for a model of single numbers, not "
                    "for one that moves"
                )
            if check.missing > MOST_MISSING:
                warnings.append(f"{where}: {check.missing:.0%} of the values are missing")
            if check.clipped > MOST_CLIPPED:
                warnings.append(
                    f"{where}: {check.clipped:.0%} of the values sit at the end of the range; "
                    "is the sensor saturated?"
                )
            channels.append(check)
        if outputs is not None and not set(outputs) & set(record.outputs):
            problems.append(
                f"{record.name}: none of its outputs ({', '.join(record.outputs)}) is one of the "
                f"model ({', '.join(outputs)})"
            )
    warnings += forces_before_motion(records)
    warnings += _rounded(channels, records)
    channels = _pooled(channels)
    channels = _colored(channels, records, warnings)
    warnings += _growing(channels, records)
    flat = tuple((label, channel, sd) for (label, channel), sd in sorted(repeats.items()))
    return DataChecks(
        channels=tuple(channels),
        problems=tuple(problems),
        warnings=tuple(warnings),
        repeatability=flat,
        estimated=any(c.method != "sensor" for c in channels),
        spiky=tuple(spiky),
    )


def _rounded(channels: Sequence[ChannelCheck], records: Sequence[Record]) -> list[str]:
    """One warning for each sensor whose given noise is less than its rounding error."""
    given = {(r.name, n): s for r in records for n, s in r.sensors.items()}
    found: dict[tuple[str, str], list[str]] = {}
    for c in channels:
        sensor, error = given[c.record, c.channel], rounding_error(c.quantum)
        if sensor.quantum == 0.0 and sensor.sigma is not None and error > sensor.sigma:
            own = unit_suffix(c.unit)
            text = (
                f"all values are multiples of {c.quantum:.3g}{own}; their rounding error of "
                f"{error:.3g}{own} exceeds the given noise of {sensor.sigma:.3g}{own}, and is used "
                "instead"
            )
            found.setdefault((c.channel, text), []).append(c.record)
    return [
        f"{channel if len(names) > 1 else names[0] + '.' + channel}: {text}"
        + (f" ({len(names)} records)" if len(names) > 1 else "")
        for (channel, text), names in found.items()
    ]


def _growing(channels: Sequence[ChannelCheck], records: Sequence[Record]) -> list[str]:
    """One warning for each sensor whose scatter grows with its value more than its noise does."""
    by_name = {r.name: r for r in records}
    sensors: dict[tuple[str, str], list[ChannelCheck]] = {}
    for c in channels:
        if by_name[c.record].even:
            sensors.setdefault((c.channel, c.unit), []).append(c)
    out = []
    for (name, unit), group in sensors.items():
        samples = [by_name[c.record].outputs[name] for c in group]
        found = grows_with_value(samples, [c.noise for c in group], ALPHA)
        if found:
            out.append(
                f"{name}: the scatter of its samples grows with its value, from "
                f"{found[0]:.2g}{unit_suffix(unit)} at zero: state sigma = {found[0]:.2g} and "
                f"relative_sigma = {found[1]:.2g} of its sensor (in [outputs.{name}])"
            )
    return out


def without_constant(
    records: Sequence[Record], outputs: Sequence[str]
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Remove channels without a stated noise that change in no record, and explain each.

    Their noise cannot be estimated, and a channel that does not move says nothing without it.
    ``outputs``: those of the model; other channels are not compared and stay as they are.

    Raises
    ------
    DataError
        A record has no other channel.
    """
    moves: dict[str, bool] = {}
    for r in records:
        for name, values in r.outputs.items():
            if name not in outputs:
                continue
            seen = values[np.isfinite(values)]
            known = r.sensors[name].sigma is not None or seen.size == 0
            moves[name] = moves.get(name, False) or known or bool(np.ptp(seen) > 0.0)
    constant = [name for name, moving in moves.items() if not moving]
    if not constant:
        return tuple(records), ()
    compared = {r.name: r.outputs.keys() & {*outputs} for r in records}
    empty = [name for name, own in compared.items() if own and own <= {*constant}]
    if empty:
        where = "records" if len(empty) == len(records) else "record " + ", ".join(empty)
        raise DataError(
            f"{where}: {', '.join(constant)}: never changes, so that its noise cannot be "
            "estimated; expected sigma of its sensor, or a channel that changes"
        )
    kept = tuple(
        replace(
            r,
            outputs={n: v for n, v in r.outputs.items() if n not in constant},
            sensors={n: s for n, s in r.sensors.items() if n not in constant},
        )
        for r in records
    )
    return kept, tuple(
        f"{name}: never changes, so that its noise cannot be estimated: it is not used; specify "
        "sigma of its sensor to use it"
        for name in constant
    )


def without_copies(
    records: Sequence[Record], hold_out: Sequence[str] = ()
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Remove records that are copies of another record, and describe what was removed.

    A copy is not a second measurement; as a held-out record it would confirm what was fitted to it.
    Of equal records, a held-out one is kept, else the first one.
    """
    kept: dict[int, Record] = {}  # by index, because the same record may be given twice
    notes = []
    held = [r.name in hold_out or r.role == "held_out" for r in records]
    for i in sorted(range(len(records)), key=lambda i: not held[i]):
        record = records[i]
        same = next((r.name for r in kept.values() if _same_numbers(r, record)), None)
        if same is None:
            kept[i] = record
        else:
            what = "given twice" if same == record.name else f"holds the same numbers as {same}"
            notes.append(f"{record.name}: {what}; the copy is not used")
    return tuple(kept[i] for i in sorted(kept)), tuple(notes)


def _same_numbers(one: Record, other: Record) -> bool:
    """Whether two records have equal inputs and outputs over a sufficient length with motion."""
    same = one.outputs.keys() == other.outputs.keys() and one.inputs.keys() == other.inputs.keys()
    if not same or one.samples < LEAST_COPY:
        return False
    pairs = [(y, other.outputs[n]) for n, y in one.outputs.items()]
    moves = any(np.unique(y[np.isfinite(y)]).size > 2 for y, _ in pairs)
    pairs += [(u, other.inputs[n]) for n, u in one.inputs.items()]
    return moves and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def check_against(model: Model, records: Sequence[Record]) -> DataChecks:
    """Check records against a model: units, array lengths, and the checks without a model.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    checks = check_records(records, model.outputs)
    problems = [*checks.problems, *faults_against(model, records)]
    if problems:
        raise DataError("records: " + "; ".join(problems))
    return checks


def not_compared(model: Model, records: Sequence[Record]) -> tuple[str, ...]:
    """Sentences about outputs that only the model or only the records have."""
    recorded = list(dict.fromkeys(name for r in records for name in r.outputs))
    absent = [n for n in model.outputs if n not in recorded]
    told = []
    if absent and not model.many_outputs:
        told.append(
            f"{', '.join(absent)}: not compared, because no record has this output of the model"
        )
    told += [
        f"{name}: not compared, because the model has no such output"
        f"{near_names(name, model.outputs)}"
        for name in recorded
        if name not in model.outputs
    ]
    return tuple(told)


def with_sigma(record: Record, noise: Mapping[str, Noise]) -> Record:
    """Copy of a record; sensors without a stated noise get the noise that was found."""
    sensors = {
        name: replace(s, sigma=noise[name].sigma) if s.sigma is None and name in noise else s
        for name, s in record.sensors.items()
    }
    return replace(record, sensors=sensors)


def faults_against(model: Model, records: Sequence[Record]) -> list[str]:
    """Faults of records whose units, array lengths or start states do not match the model."""
    problems = []
    states = [s.name for s in model.states()]
    for record in records:
        known = record.start
        unknown = (
            [] if known is None else [n for n in {**known.mean, **known.sd} if n not in states]
        )
        if states and unknown:
            problems.append(
                f"{record.name}: start of {', '.join(unknown)}, no state of the model "
                f"{model.name} ({', '.join(states)})"
            )
        if known is not None and not known.known and model.from_rest:
            problems.append(
                f"{record.name}: its start is unknown (start_known), but the model {model.name} "
                "simulates every record from a start of its own; expected a record that begins "
                "before the motion"
            )
        if record.samples < model.least_samples:
            problems.append(
                f"{record.name}: {record.samples} samples; the model {model.name} needs at least "
                f"{model.least_samples}"
            )
        for name, unit in record.units.items():
            wanted = model.units.get(name) or "1"
            if "1" not in (unit, wanted) and not same_unit(unit, wanted):
                problems.append(
                    f"{record.name}: {name} is in {unit}, in the model {model.name} in {wanted}"
                    f"{weight_hint(unit, wanted)}"
                )
    return problems


def _pooled(channels: list[ChannelCheck]) -> list[ChannelCheck]:
    """One noise per sensor: the median of the estimates that are as small as the smallest one.

    Motion can only increase an estimate, so the quietest records show the noise. Estimates that
    exceed the smallest one by no more than its sampling error are of quiet records too. (The
    smallest one alone would be too small by chance, the more so the more records there are.)
    A record in which the channel never changes says nothing about its noise: if no other one shows
    it, the largest noise that is stated for the channel is used. A record that moves over a few
    steps of a grid does not show the grid: the noise is at least the rounding error of the finest
    grid that another record shows.
    """
    sensors: dict[tuple[str, str], list[ChannelCheck]] = {}
    for c in channels:
        if c.method in ESTIMATED:
            sensors.setdefault((c.channel, c.unit), []).append(c)
    found: dict[tuple[str, str], tuple[float, str]] = {}
    for sensor, same in sensors.items():
        moving = [c for c in same if c.spread > 0.0]
        stated = [
            c for c in channels if (c.channel, c.unit) == sensor and c.method not in ESTIMATED
        ]
        if not moving and stated:
            most_noise = max(stated, key=lambda c: c.sigma)
            found[sensor] = most_noise.sigma, most_noise.method
        if moving:
            best = min(moving, key=lambda c: c.sigma)
            most = best.sigma * (1.0 + QUIET_RECORDS / math.sqrt(best.samples))
            sigma = float(np.median([c.sigma for c in moving if c.sigma <= most]))
            step = min((c.quantum for c in same if c.quantum > 0.0), default=0.0)
            found[sensor] = max(sigma, rounding_error(step)), best.method
    out = []
    for c in channels:
        if c.method in ESTIMATED and (c.channel, c.unit) in found:
            sigma, method = found[c.channel, c.unit]
            c = replace(c, sigma=sigma, method=method)
        out.append(c)
    return out


def _colored(
    channels: list[ChannelCheck], records: Sequence[Record], warnings: list[str]
) -> list[ChannelCheck]:
    """Correct the noise color of sensors where the records at rest contradict it.

    An estimate from differences is too small if the noise is correlated. So without a data sheet,
    the standard deviation is corrected too.
    """
    by_name = {r.name: r for r in records}
    sensors: dict[tuple[object, ...], list[ChannelCheck]] = {}
    for c in channels:
        steps = np.diff(by_name[c.record].time)
        interval = float(np.median(steps))
        even = np.allclose(steps, interval, rtol=SAME_CLOCK, atol=0.0)
        # Only sensors without a stated white or relative share: otherwise the parts of the noise
        # are specified.
        known = c.method == "sensor" and _fine(c.quantum, c.sigma)
        if even and not c.white and not c.relative and (known or c.method in ESTIMATED):
            # The clocks of one camera may differ in the last digit.
            sheet = (c.channel, c.method in ESTIMATED, c.sigma, c.correlation_time)
            sensors.setdefault((*sheet, f"{interval:.6g}"), []).append(c)
    found: dict[int, Noise] = {}
    for group in sensors.values():
        first = group[0]
        every = len(group) == sum(c.channel == first.channel for c in channels)
        at = "" if every else f" ({', '.join(c.record for c in group)})"
        before = Noise(first.sigma, first.correlation_time)
        interval = by_name[first.record].interval
        values = [by_name[c.record].outputs[c.channel] for c in group]
        if first.method == "sensor":
            noise = color_at_rest([still_blocks(v, before.sigma) for v in values], interval, before)
            if noise == before:
                continue
            told = (
                f"samples, not of the correlation time of its data sheet, "
                f"{before.correlation_time:.3g} s; the former is used"
            )
        else:
            average = averaged_noise(values, interval, before)
            if average is None or not average.sigma > first.sigma:
                continue
            if not all(_fine(c.quantum, average.sigma) for c in group):
                continue
            noise, unit = average, unit_suffix(first.unit)
            told = (
                f"samples with a standard deviation of {noise.sigma:.3g}{unit}, which is used "
                f"instead of {first.sigma:.3g}{unit}. Specify sigma if you know it"
            )
        found |= {id(c): noise for c in group}
        # Other records of the sensor have no less noise, also where its correlation is not seen.
        same = [c for c in channels if (c.channel, c.unit) == (first.channel, first.unit)]
        found |= {
            id(c): Noise(noise.sigma, c.correlation_time)
            for c in same
            if c.method in ESTIMATED and c.sigma < noise.sigma and id(c) not in found
        }
        warnings.append(
            f"{first.channel}{at}: at rest its noise is that of a mean over {noise.averaged} {told}"
        )
    return [
        replace(
            c,
            sigma=found[id(c)].sigma,
            correlation_time=found[id(c)].correlation_time,
            averaged=found[id(c)].averaged,
            method="sensor" if c.method == "sensor" else "rest",
        )
        if id(c) in found
        else c
        for c in channels
    ]


def _fine(quantum: float, sigma: float) -> bool:
    """Whether the steps of a sensor are small beside its noise."""
    return quantum**2 / 12.0 < COARSE * sigma**2


def _clock(record: Record, problems: list[str], warnings: list[str]) -> None:
    steps = np.diff(record.time)
    middle = float(np.median(steps))
    shortest, longest = UNEVEN_STEP
    if steps.max() > CLOCK_JUMP * middle:
        at = int(np.argmax(steps))
        problems.append(
            f"{record.name}: the clock jumps by {steps[at]:g} s at {record.time[at]:g} s "
            f"(median step {middle:g} s); split the record there"
        )
    elif steps.max() > longest * middle or steps.min() < shortest * middle:
        lost = int(np.sum(steps > longest * middle))
        warnings.append(
            f"{record.name}: uneven clock, {lost} steps are longer than {longest:g} medians"
        )


def _same_inputs(record: Record, other: Record) -> bool:
    """Whether two records on one clock have the same inputs, within the spread of repeats."""
    if record.inputs.keys() != other.inputs.keys():
        return False
    for name, value in record.inputs.items():
        spread = max(float(np.std(value)), float(np.std(other.inputs[name])))
        apart = float(np.sqrt(np.mean((value - other.inputs[name]) ** 2)))
        if apart > SAME_INPUT * spread + 1e-12 * float(np.max(np.abs(value), initial=0.0)):
            return False
    return True


def _repeatability(records: Sequence[Record], warnings: list[str]) -> dict[tuple[str, str], float]:
    """Standard deviation between repeats of one run, for each label and channel."""
    groups: dict[str, list[Record]] = {}
    for r in records:
        if r.repeats:
            groups.setdefault(r.repeats, []).append(r)
    out = {}
    for label, group in groups.items():
        same = [
            r
            for r in group
            if r.samples == group[0].samples
            and np.allclose(np.diff(r.time), np.diff(group[0].time), rtol=SAME_CLOCK)
        ]
        if len(same) < len(group):
            warnings.append(f"repeats {label}: clocks differ; only {len(same)} are compared")
        alike = [r for r in same if _same_inputs(r, same[0])]
        if len(alike) < len(same):
            others = [r.name for r in same if r not in alike]
            warnings.append(
                f"repeats {label}: {', '.join(others[:4])}{' and others' * (len(others) > 4)} "
                f"{'has' if len(others) == 1 else 'have'} other inputs than {same[0].name}: they "
                "are other experiments, and their differences are not taken for noise"
            )
        same = alike
        if len(same) < 2:
            continue
        for channel in same[0].outputs:
            if all(channel in r.outputs for r in same):
                stack = np.array([r.outputs[channel] for r in same])
                stack = stack[:, np.isfinite(stack).sum(axis=0) > 1]
                if stack.size:
                    variance = np.nanvar(stack, axis=0, ddof=1)
                    out[label, channel] = float(np.sqrt(np.mean(variance)))
    return out


def _channel(
    record: Record, name: str, values: Array, repeats: dict[tuple[str, str], float]
) -> ChannelCheck:
    sensor = record.sensors[name]
    good = values[np.isfinite(values)]
    n = good.size
    spread = float(np.std(good)) if n else 0.0
    grid = 0.0 if sensor.quantum else _grid(good, spread)
    quantum = sensor.quantum or grid
    clipped = 0.0
    if n > 50 and spread > 0.0:
        for extreme in (good.max(), good.min()):
            same = (good[1:] == extreme) & (good[:-1] == extreme)
            rest = abs(extreme - np.median(good)) < AWAY_FROM_REST * spread
            if not rest and quantum < FINE_DIGITS * spread:
                clipped = max(clipped, float(np.mean(same)))
    tau, drift = sensor.correlation_time, 0.0
    if sensor.sigma is not None:
        sigma, method = sensor.sigma, "sensor"
    else:
        repeat = repeats.get((record.repeats, name))
        if repeat is not None and repeat > 0.0:
            sigma, method = repeat, "repeats"
        else:
            sigma, method, drift = _estimate(good, spread)
            predicted = _predicted(values, record.inputs)
            if predicted is not None and predicted < sigma:
                sigma, method = predicted, "prediction"
    # A stated sigma is without the rounding error of a stated quantum. Any other sigma contains the
    # rounding error, and is at least that.
    added = sensor.quantum if method == "sensor" else 0.0
    least = grid if method == "sensor" else quantum
    noise = noise_of(sensor, max(sigma, rounding_error(least)), added)
    return ChannelCheck(
        record=record.name,
        channel=name,
        unit=sensor.unit,
        samples=int(n),
        missing=1.0 - n / max(values.size, 1),
        spread=spread,
        sigma=float(max(noise.sigma, 1e-9 * max(spread, 1e-12))),
        method=method,
        correlation_time=tau,
        averaged=1,
        quantum=quantum,
        clipped=clipped,
        drift=drift,
        white=noise.white,
        relative=noise.relative,
    )


def _grid(values: Array, spread: float) -> float:
    """Step of the grid on which all values lie; 0: there is none, or too few values differ."""
    steps = np.diff(np.unique(values))
    steps = steps[steps > LEAST_STEP * spread]
    if steps.size < 8:
        return 0.0
    step = float(np.min(steps))
    ratio = steps / step
    if steps.size == values.size - 1 and np.max(ratio) < 1.5:
        return 0.0  # a straight line: each value occurs once, at equal distances
    off, most = WHOLE_STEPS
    return step if np.mean(np.abs(ratio - np.round(ratio)) < off) > most else 0.0


def _predicted(values: Array, inputs: Mapping[str, Array], reach: int = 4) -> float | None:
    """Error of the best linear prediction of a sample from its neighbors and the inputs.

    The noise of a sample is independent of all other samples, so that no prediction can have a
    smaller error. The value is therefore an upper bound of the noise. It is close where the signal
    is too fast for the method of differences.
    """
    n = values.size
    columns = [np.roll(values, k) for k in range(-reach, reach + 1) if k != 0]
    for u in list(inputs.values())[:4]:
        columns += [np.roll(u, k) for k in range(-reach, reach + 1)]
    part = slice(reach, n - reach)
    table = np.column_stack([np.ones(n), *columns])[part]
    wanted = values[part]
    good = np.isfinite(wanted) & np.all(np.isfinite(table), axis=1)
    if good.sum() < 5 * table.shape[1]:
        return None
    table, wanted = table[good], wanted[good]
    size = np.maximum(np.sqrt(np.mean(table**2, axis=0)), 1e-300)
    found = np.linalg.lstsq(table / size, wanted, rcond=1e-10)[0]
    left = wanted - (table / size) @ found
    return float(np.sqrt(np.sum(left**2) / (wanted.size - table.shape[1])))


def _estimate(values: Array, spread: float) -> tuple[float, str, float]:
    """Estimate the noise from the parts of a signal that move least.

    Third differences remove a local parabola; white noise of variance s^2 leaves 20 s^2. The lower
    tenth of all blocks is used, because the machine contributes least there.
    """
    n = values.size
    if n < 12 or spread == 0.0:
        return max(spread, 1e-12), "spread", 0.0
    third = np.diff(values, 3)
    block = int(np.clip(third.size // 12, 6, 48))
    count = third.size // block
    parts = np.sqrt(np.mean(third[: count * block].reshape(count, block) ** 2, axis=1) / 20.0)
    everywhere = float(np.median(parts))
    low_noise = float(np.quantile(parts, 0.1))
    if (
        low_noise < QUIET_BLOCKS * everywhere
    ):  # the noise is uniform: larger values come from the motion of the machine
        method, sigma = "rest", low_noise * (1.0 + 1.0 / np.sqrt(block))
    else:
        method, sigma = "differences", everywhere
    first = int(np.argmin(parts)) * block
    segment = values[first : first + block]
    drift = float(np.std(segment) / sigma) if sigma > 0.0 else 0.0
    return float(max(sigma, 1e-6 * spread)), method, drift
