"""Joins two records of one experiment that were measured with two clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data.records import Array, InputMode, Record
from unmodeled.errors import DataError, InvalidParameter

#: Steps of the median size above which samples are missing.
MOST_STEPS = 5.0
#: Samples of the rest before a motion; multiple of their noise, and shares of the range, that the
#: begin of a motion passes [1].
REST, NOISE_MULTIPLE, BEGIN = 10, 6.0, (0.03, 0.06, 0.1)
#: Time by which a motion may begin after the force that causes it [s].
LAG = 0.01


@dataclass(frozen=True)
class Clocks:
    """Time on a second clock as a function of that on the first one: offset + rate * time."""

    offset: float
    """Time on the second clock at zero of the first one [s]."""
    rate: float
    """Seconds of the second clock in a second of the first one [1]."""
    residual: float
    """Largest distance of a common event from the line [s]; 0 for one or two events."""

    def second(self, first: Array) -> Array:
        """Times on the second clock for times on the first one [s]."""
        return self.offset + self.rate * first

    def __str__(self) -> str:
        text = f"zero of the first clock is {1e3 * self.offset:.6g} ms on the second one"
        if self.rate != 1.0:
            ppm = 1e6 * (self.rate - 1.0)
            text += f", which is {abs(ppm):.4g} ppm {'faster' if ppm > 0.0 else 'slower'}"
        if self.residual > 0.0:
            text += f"; the events agree within {1e3 * self.residual:.3g} ms"
        return text


@checked
def fit_clocks(same: Sequence[tuple[float, float]]) -> Clocks:
    """Relation of two clocks from events that both have seen.

    Parameters
    ----------
    same
        Times of each common event on the first and on the second clock [s]. None: the clocks are
        equal. One: they differ by an offset. More: also by their rate (least squares).

    Returns
    -------
    Clocks
        Offset and rate.

    Raises
    ------
    InvalidParameter
        Events have the same time on a clock, or the rates differ by more than 10 %.
    """
    if not same:
        return Clocks(0.0, 1.0, 0.0)
    first, second = np.asarray(same, dtype=float).T
    if first.size == 1:
        return Clocks(float(second[0] - first[0]), 1.0, 0.0)
    if np.unique(first).size < first.size or np.unique(second).size < second.size:
        raise InvalidParameter("same: two events have the same time, expected different events")
    rate, offset = np.polyfit(first, second, 1)
    if not 0.9 <= rate <= 1.1:
        raise InvalidParameter(
            f"same: the second clock would run {rate:.4g} times as fast as the first one, expected "
            "0.9 to 1.1; check the events, and the unit or frame rate of the clocks"
        )
    residual = float(np.abs(offset + rate * first - second).max()) if first.size > 2 else 0.0
    return Clocks(float(offset), float(rate), residual)


@checked
def align_clocks(first: Record, second: Record) -> tuple[Clocks, float]:
    """Relation of two clocks by the begin of the motion that both records saw.

    Both records must begin at rest. The begin is the time at which a channel passes its noise, and
    3, 6 and 10 % of its range; the offset is the mean of those of the levels.

    Returns
    -------
    tuple
        Clocks of the same rate, and the standard deviation of their offset [s]: the time from the
        first to the last level of either record, and 10 ms at least, because a force begins before
        a motion.

    Raises
    ------
    DataError
        A record does not begin at rest, or nothing moves in it.
    """
    one, two = _begins(first), _begins(second)
    offsets = two - one
    sd = max(float(np.ptp(one)), float(np.ptp(two)), LAG, first.interval, second.interval)
    return Clocks(float(np.mean(offsets)), 1.0, 0.0), sd


def _begins(record: Record) -> Array:
    """Times at which the first channel of a record passes each level [s]."""
    times = []
    for values in (*record.inputs.values(), *record.outputs.values()):
        good = np.isfinite(values)
        time, y = record.time[good], np.abs(values[good] - np.median(values[good][:REST]))
        if y.size <= 2 * REST or not y.max() > 0.0:
            continue
        noise = NOISE_MULTIPLE * float(np.std(y[:REST])) + 1e-12 * float(y.max())
        rows = [_stays_above(y, max(level * float(y.max()), noise)) for level in (0.0, *BEGIN)]
        if min(rows) > 2 * REST:  # sooner, it moved in the rest already
            times.append([float(time[row]) for row in rows])
    if not times:
        raise DataError(
            f"join: {record.name} does not begin at rest, or nothing moves in it, so that it "
            "cannot be aligned; tell one event that both have seen (same, --same TIME=TIME)"
        )
    return np.asarray(np.min(times, axis=0))


def _stays_above(y: Array, level: float) -> int:
    """First row from which three values in a row are above a level; 0: none."""
    above = y > level
    rows = np.flatnonzero(above[:-2] & above[1:-1] & above[2:])
    return int(rows[0]) if rows.size else 0


@checked
def join_records(
    first: Record,
    second: Record,
    *,
    same: Sequence[tuple[float, float]] = (),
    inputs: Mapping[str, str] | None = None,
    same_sd: float = 0.0,
) -> Record:
    """One record of two that were measured with two clocks, such as a camera and a load cell.

    The clock and the samples of the first record are kept. The channels of the second one are
    interpolated linearly at these times. The record covers the time that both have. Notes of the
    record tell what was done.

    Parameters
    ----------
    first
        Record whose clock is kept: the one with the outputs to compare.
    second
        The other record.
    same
        Times of common events on both clocks [s]; see :func:`fit_clocks` and
        :func:`align_clocks`.
    inputs
        Input -> channel that becomes this input, such as ``{"force": "Load"}``. Default: if neither
        record has an input, the only channel in N becomes the input ``force``. Known errors of its
        sensor (delay, bandwidth, gain, offset) are removed; its noise becomes that of the input.
    same_sd
        Standard deviation of the offset of the clocks [s]: that of an unknown delay of the outputs
        of the first record, unless their sensors state one.

    Returns
    -------
    Record
        Inputs, outputs and sensors of both, with name, role and conditions of the first.

    Raises
    ------
    DataError
        Both have a channel of the same name, they have no time in common, or samples of the second
        one are missing.
    InvalidParameter
        The events or the names of inputs are invalid.

    Examples
    --------
    A force and a displacement with two clocks; 0.5 s of the first is 1.5 s of the second:

    >>> import numpy as np
    >>> from unmodeled import Record
    >>> from unmodeled.data import join_records
    >>> time = np.linspace(0.0, 2.0, 201)
    >>> first = Record(name="camera", time=time, inputs={}, outputs={"x": np.sin(time)})
    >>> second = Record(name="cell", time=time + 1.0, inputs={}, outputs={"F": np.cos(time)})
    >>> joined = join_records(first, second, same=[(0.5, 1.5)])
    >>> sorted(joined.outputs), joined.samples
    (['F', 'x'], 201)
    """
    clocks = fit_clocks(same)
    if same_sd:
        sensors = {n: replace(s, delay_sd=s.delay_sd or same_sd) for n, s in first.sensors.items()}
        first = replace(first, sensors=sensors)
    doubled = sorted({*first.inputs, *first.outputs} & {*second.inputs, *second.outputs})
    if doubled:
        raise DataError(
            f"join: {first.name} and {second.name} both have {', '.join(doubled)}; expected "
            "different names (TOML files beside the data name their channels)"
        )
    moments = clocks.second(first.time)
    slack = 1e-6 * second.interval  # rounding of the clocks
    within = (moments >= second.time[0] - slack) & (moments <= second.time[-1] + slack)
    if np.count_nonzero(within) < 2:
        raise DataError(
            f"join: {first.name} is from {moments[0]:.6g} to {moments[-1]:.6g} s on the clock of "
            f"{second.name}, which has {second.time[0]:.6g} to {second.time[-1]:.6g} s; expected a "
            "time in common: which event have both seen? (same, --same TIME=TIME; --same auto "
            "finds it)"
        )
    at = moments[within]
    _refuse_gaps(second, at)
    steps = np.diff(second.time)
    ratio = first.interval * clocks.rate / float(np.median(steps))
    notes = [
        f"{second.name} was interpolated linearly at the times of {first.name}: {clocks}",
        f"{np.count_nonzero(within)} of {first.samples} samples of {first.name} are in both",
    ]
    if same_sd:
        notes.append(f"the offset of the clocks is known to {1e3 * same_sd:.2g} ms (delay_sd)")
    if ratio < 0.99:
        notes.append(
            f"{second.name} has fewer samples than {first.name} ({ratio:.2g} for one): values "
            "between its samples are no measurements; join in the other order"
        )

    def taken(values: Array) -> Array:
        return np.asarray(np.interp(at, second.time, values))

    both = replace(
        first,
        time=first.time[within],
        inputs={k: v[within] for k, v in first.inputs.items()}
        | {k: taken(v) for k, v in second.inputs.items()},
        outputs={k: v[within] for k, v in first.outputs.items()}
        | {k: taken(v) for k, v in second.outputs.items()},
        sensors={**first.sensors, **second.sensors},
        input_mode=first.input_mode if first.inputs or not second.inputs else second.input_mode,
        input_units={**first.input_units, **second.input_units},
        input_sigma={**first.input_sigma, **second.input_sigma},
        input_correlation_time={**first.input_correlation_time, **second.input_correlation_time},
        source="; ".join(
            dict.fromkeys(
                text
                for text in (first.source, second.source, f"{first.name} and {notes[0]}")
                if text
            )
        ),
        notes=(*first.notes, *second.notes, *notes),
        before=None,
    )
    return _with_inputs(both, inputs)


def _refuse_gaps(record: Record, at: Array) -> None:
    """Refuse missing samples of a record between times at which it is needed."""
    steps = np.diff(record.time)
    wide = np.flatnonzero(steps > MOST_STEPS * float(np.median(steps)))
    for i in wide:
        if np.any((at > record.time[i]) & (at < record.time[i + 1])):
            raise DataError(
                f"join: {record.name} has no samples from {record.time[i]:.6g} to "
                f"{record.time[i + 1]:.6g} s, {steps[i] / np.median(steps):.3g} of its steps; "
                f"expected at most {MOST_STEPS:g}"
            )


def _with_inputs(record: Record, inputs: Mapping[str, str] | None) -> Record:
    """The record with channels that become inputs."""
    if inputs is None:
        forces = [n for n, s in record.sensors.items() if s.unit == "N"]
        alone = not record.inputs and len(forces) == 1 < len(record.outputs)
        inputs = {"force": forces[0]} if alone else {}
        notes = tuple(f"{channel} is the input {name}" for name, channel in inputs.items())
        record = replace(record, notes=(*record.notes, *notes))
    free = not record.inputs
    for name, channel in inputs.items():
        mode: InputMode | None = None
        if free and channel in record.sensors:
            mode = "motion" if record.sensors[channel].unit in ("m", "rad") else "force"
        record = record.with_output_as_input(channel, name, mode=mode)
    return record
