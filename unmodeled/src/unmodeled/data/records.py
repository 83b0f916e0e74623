"""Measured records: time series with sensors and inputs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from unmodeled.arguments import checked
from unmodeled.chain import fault_of, faults, true_value
from unmodeled.data.smoothing import noise_of_record
from unmodeled.errors import DataError, InvalidParameter, no_such
from unmodeled.lazy import lazy_import

Array = NDArray[np.float64]
V = TypeVar("V")
Integers = NDArray[np.intp]
InputMode = Literal["force", "motion"]
Role = Literal["fit", "held_out"]
Reference = Literal["", "absolute", "rest"]

#: Name of a record without a name.
UNNAMED = "record"
#: End of the name of a part of a record.
_PART = re.compile(r"(\[(\d+/\d+|fit|held-out)\])+$")
#: Properties of the sensor of an output that an input does not have.
NOT_OF_INPUTS = "relative_sigma", "gain_sd", "offset_sd", "delay_sd", "faults_sd"
LARGEST_VALUE = 1e100  # largest number of a record; larger values are not measurements


@checked
@dataclass(frozen=True, kw_only=True)
class Sensor:
    """Sensor between a quantity of the machine and a column of the record.

    The record shows ``gain * low_pass(y)(t - delay) + offset + noise``. Known properties are
    applied to the simulation before the comparison. The ``*_sd`` are prior standard deviations of
    unknown properties. Each becomes a nuisance parameter of every record, which is estimated with
    the fit and is never named as a cause.

    Examples
    --------
    A camera with a noise of 0.2 mm that may be 5 ms late:

    >>> from unmodeled import Sensor
    >>> camera = Sensor(name="x", unit="m", sigma=2e-4, delay_sd=5e-3)
    >>> camera.sigma, camera.gain
    (0.0002, 1.0)
    """

    name: str
    """Name of the output of the model, and of the column."""
    unit: str = "1"
    sigma: float | None = None
    """Standard deviation of the noise [unit]; None: estimated (rest, repeats, or differences)."""
    relative_sigma: float = 0.0
    """Standard deviation of noise that is proportional to the value [1], in addition to ``sigma``,
    the noise at the value zero. It counts beside the value without noise, which follows from the
    neighbors of a sample, and has the color of the other noise."""
    quantum: float = 0.0
    """Quantization step of the digitizer [unit]; adds quantum^2/12 to the variance."""
    delay: float = 0.0
    """Known delay [s]; positive: the record lags the machine."""
    bandwidth: float = math.inf
    """Corner frequency of a first-order low-pass [Hz]."""
    gain: float = 1.0
    """Known gain [1]."""
    offset: float = 0.0
    """Known offset [unit]."""
    correlation_time: float = 0.0
    """Time constant of exponentially correlated noise [s]; 0: white noise."""
    colored_sigma: float = 0.0
    """Standard deviation [unit] of noise with ``correlation_time``, in addition to white noise of
    ``sigma`` and the quantization, which is also white. 0: all noise has one color."""
    gain_sd: float = 0.0
    """Prior standard deviation of an unknown relative gain error [1]."""
    offset_sd: float = 0.0
    """Prior standard deviation of an unknown offset [unit]."""
    delay_sd: float = 0.0
    """Prior standard deviation of an unknown delay [s]. The channels of a record with the same
    value have one clock: they are late together."""
    faults: Mapping[str, float] = field(default_factory=dict)
    """Known errors of further kinds, by the name of the fault (:mod:`unmodeled.chain`), such as
    ``{"clock": 0.01}`` [unit of the fault]."""
    faults_sd: Mapping[str, float] = field(default_factory=dict)
    """Prior standard deviations of unknown errors of further kinds."""
    reference: Reference = ""
    """Zero of a coordinate: "absolute" is the zero of the frame of the model, "rest" the rest pose
    of the machine; "": determined from the start of the channel. For models that know their rest
    pose."""
    point: str = ""
    """Position of the sensor, as text for people and for the model."""
    axis: str = ""
    """Direction of the measurement, as text for people and for the model."""

    def __post_init__(self) -> None:
        faults = []
        for name in (
            "quantum", "correlation_time", "colored_sigma", "gain_sd", "offset_sd", "delay_sd",
        ):  # fmt: skip
            value = getattr(self, name)
            if not 0.0 <= value <= LARGEST_VALUE:
                faults.append(f"{name} = {value!r}, expected a finite number >= 0")
        if self.sigma is not None and not 0.0 < self.sigma <= LARGEST_VALUE:
            faults.append(f"sigma = {self.sigma!r}, expected a finite number > 0, or none")
        if not 0.0 <= self.relative_sigma <= 1.0:
            faults.append(
                f"relative_sigma = {self.relative_sigma!r}, expected from 0 to 1 (0.04 is 4 % of "
                "the value)"
            )
        elif self.relative_sigma > 0.0 and not self.sigma:
            faults.append(
                f"relative_sigma = {self.relative_sigma!r}, expected with it a sigma, the noise at "
                "the value zero"
            )
        if self.colored_sigma > 0.0 and not (self.correlation_time > 0.0 and self.sigma):
            faults.append(
                f"colored_sigma = {self.colored_sigma!r}, expected with it a correlation_time > 0 "
                "and a sigma, that of the white noise"
            )
        faults += self._faults_of_faults()
        if not self.bandwidth > 0.0:
            faults.append(f"bandwidth = {self.bandwidth!r}, expected > 0 [Hz]")
        if not 0.0 < abs(self.gain) <= LARGEST_VALUE:
            faults.append(f"gain = {self.gain!r}, expected a finite number that is not 0")
        for name in ("delay", "offset"):
            if not abs(getattr(self, name)) <= LARGEST_VALUE:
                faults.append(f"{name} = {getattr(self, name)!r}, expected a finite number")
        if faults:
            raise DataError(f"sensor {self.name}: " + "; ".join(faults))

    def _faults_of_faults(self) -> Iterator[str]:
        for key in ("faults", "faults_sd"):
            for name, value in getattr(self, key).items():
                if not (fault := fault_of(name)).stated or f"{name}_sd" in vars(self):
                    yield f"{key}: {fault.name} is not stated here"
                if not math.isfinite(value) or (key == "faults_sd" and value < 0.0):
                    yield f"{key}: {name} = {value!r}, expected a finite number"

    @property
    def known(self) -> dict[str, float]:
        """Known errors: size by name of the fault, without zeros, in the order of the chain."""
        lag = 1.0 / (2.0 * math.pi * self.bandwidth)
        sizes = {"lag": lag, "delay": self.delay, "gain": self.gain - 1.0, "offset": self.offset}
        return _in_chain({**sizes, **self.faults})

    @property
    def unknown(self) -> dict[str, float]:
        """Standard deviations of unknown errors, as :attr:`known`."""
        sizes = {"gain": self.gain_sd, "offset": self.offset_sd, "delay": self.delay_sd}
        return _in_chain({**sizes, **self.faults_sd})


def _in_chain(sizes: Mapping[str, float]) -> dict[str, float]:
    return {n: sizes[n] for n in faults() if sizes.get(n, 0.0) != 0.0}


@checked
@dataclass(frozen=True, kw_only=True)
class StartPrior:
    """Prior of the state at the first sample: mean and standard deviation for each state."""

    mean: Mapping[str, float] = field(default_factory=dict)
    sd: Mapping[str, float] = field(default_factory=dict)
    known: bool = True
    """False: the record starts during a motion, so that the start state of the model does not
    apply."""

    def __post_init__(self) -> None:
        faults = [f"{k} = {v!r}, expected a finite mean" for k, v in self.mean.items()
                  if not math.isfinite(v)]  # fmt: skip
        faults += [f"{k}: sd = {v!r}, expected >= 0" for k, v in self.sd.items() if not v >= 0.0]
        if faults:
            raise DataError("start: " + "; ".join(faults))


@checked
def evenly_spaced(time: Array) -> bool:
    """Whether all steps of a clock are equal to 1e-6 of the median step.

    Parameters
    ----------
    time
        Times [s], (n,), increasing.
    """
    steps = np.diff(time)
    middle = np.median(steps)
    return bool(np.all(np.abs(steps - middle) <= 1e-6 * abs(middle)))


def _missing(name: str, column: Array, time: Array) -> str:
    """Where an input has no number."""
    at = np.flatnonzero(~np.isfinite(column))
    where = f"at {time[at[0]]:.10g} s"
    if at.size > 1:
        where = f"at {at.size} samples from {time[at[0]]:.10g} s to {time[at[-1]]:.10g} s"
    return (
        f"input {name} has no number {where}; the model "
        "needs an input at every sample: fill or cut it"
    )


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """One measured run: one clock, complete inputs, and outputs in which NaN means missing.

    Raises
    ------
    DataError
        Arrays have different lengths, time does not increase, an input has NaN, a number exceeds
        1e100, or a sensor has no output; all faults are in one message.

    Examples
    --------
    A fall that was measured each 0.1 s with a noise of 0.01 m/s:

    >>> import numpy as np
    >>> from unmodeled import Record, Sensor
    >>> time = np.linspace(0.0, 1.0, 11)
    >>> speed = Sensor(name="v", unit="m/s", sigma=0.01)
    >>> fall = Record(
    ...     name="fall", time=time, inputs={}, outputs={"v": 9.81 * time}, sensors={"v": speed}
    ... )
    >>> round(float(fall.interval), 6), fall.sensors["v"].unit
    (0.1, 'm/s')
    """

    name: str
    time: Array
    """Time of the samples [s], strictly increasing, (n,)."""
    inputs: Mapping[str, Array]
    """Inputs of the model, each (n,), in SI units."""
    outputs: Mapping[str, Array]
    """Measured outputs, each (n,), in the unit of their sensor; NaN is missing."""
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    """Sensor of each output; an output without one gets ``Sensor(name=...)``."""
    input_mode: InputMode = "force"
    input_units: Mapping[str, str] = field(default_factory=dict)
    """SI units of the inputs, if the file states them; they are compared with the model."""
    input_sigma: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of the noise of an input [its unit]; it contributes to the covariance of
    the residuals."""
    input_correlation_time: Mapping[str, float] = field(default_factory=dict)
    """Correlation time of that noise [s]; 0: white from sample to sample."""
    conditions: Mapping[str, float | str] = field(default_factory=dict)
    """Humidity, temperature, cycle number, date, operator, ..."""
    role: Role = "fit"
    start: StartPrior | None = None
    repeats: str = ""
    """Common label of repeats of one run; their spread is the run-to-run variability."""
    source: str = ""
    """File and license, for the report."""
    notes: tuple[str, ...] = ()
    """Assumptions made when the record was read, for the data checks."""
    before: Record | None = None
    """The samples before the first one, if the record is the later part of a run: a late input
    depends on them. It has the same inputs, ends before the record, and has no earlier one."""

    def __post_init__(self) -> None:
        time = _column(self.time)
        inputs = {k: _column(v) for k, v in self.inputs.items()}
        outputs = {k: _column(v) for k, v in self.outputs.items()}
        faults = _faults_of_clock(time)
        for name, column in inputs.items():
            faults += _faults_of_column(f"input {name}", column, time)
            if column.size == time.size and not np.all(np.isfinite(column)):
                faults.append(_missing(name, column, time))
        for name, column in outputs.items():
            faults += _faults_of_column(f"output {name}", column, time)
            if np.any(np.isinf(column)):
                faults.append(f"output {name} holds an infinite number; NaN means missing")
        if not outputs:
            faults.append("there is no output to compare")
        for what, names, known in (
            ("input_units names {}, no input", self.input_units, inputs),
            ("input_sigma names {}, no input", self.input_sigma, inputs),
            ("sensor {} belongs to no output", self.sensors, outputs),
        ):
            there = ", ".join(known) or "none"
            faults += [f"{what.format(n)} ({there})" for n in names if n not in known]
        for name, sigma in self.input_sigma.items():
            if not 0.0 <= sigma <= LARGEST_VALUE:
                faults.append(f"input_sigma of {name} is {sigma!r}, expected a number >= 0")
        if self.before is not None and time.size:
            faults += _faults_before(self.before, inputs, time[0])
        if faults:
            raise DataError(f"record {self.name}: " + "; ".join(faults))
        sensors = {k: self.sensors.get(k, Sensor(name=k)) for k in outputs}
        for target, value in (
            ("time", time),
            ("inputs", inputs),
            ("outputs", outputs),
            ("sensors", sensors),
        ):
            object.__setattr__(self, target, value)

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        *,
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        sigma: Mapping[str, float] | None = None,
        units: Mapping[str, str] | None = None,
        time: str = "",
        name: str = UNNAMED,
        role: Role = "fit",
    ) -> Record:
        """Record from a table of pandas, polars or PyArrow, or from arrays by name.

        Parameters
        ----------
        frame
            Table with a column for each signal, named ``force`` or, with its unit, ``force [N]``.
            An index of times is the clock. Texts are read as the cells of a file.
        inputs
            Columns that are inputs of the model; a model finds its inputs among the outputs, too.
        outputs
            Columns that were measured; default: all others.
        sigma
            Standard deviation of the noise by column [SI unit].
        units
            Units of columns without one in their names.
        time
            Column of the clock; default: time or t, or the index.
        name
            Name of the record; several without one are numbered.
        role
            ``"held_out"``: it is predicted, not fitted.

        Raises
        ------
        DataError
            A column is missing, or has no numbers.
        """
        options: dict[str, Any] = {"inputs": inputs, "outputs": outputs, "time": time, "name": name}
        options |= {"sigma": sigma or {}, "units": units or {}}
        record: Record = lazy_import("unmodeled.data.frames:record_from_frame")(frame, **options)
        return replace(record, role=role)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.time.size)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel that states one, inputs and outputs."""
        return {n: s.unit for n, s in self.sensors.items()} | dict(self.input_units)

    @property
    def whole(self) -> str:
        """Name of the record of which this one is a numbered part; else its own name."""
        return _PART.sub("", self.name)

    @cached_property
    def interval(self) -> float:
        """Median time step [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def excitation(self) -> tuple[str, int]:
        """Name, and hash of clock, inputs and what was before: the key of a simulation in a cache.

        The start state is no part of it.
        """
        inputs = ((name, value.tobytes()) for name, value in self.inputs.items())
        before = None if self.before is None else self.before.excitation
        return self.name, hash((self.time.tobytes(), self.input_mode, before, *inputs))

    @cached_property
    def even(self) -> bool:
        """Whether all time steps are equal."""
        return evenly_spaced(self.time)

    def output_array(self, names: Iterable[str]) -> Array:
        """Outputs as (n, len(names)); an output that was not measured is NaN."""
        missing = np.full(self.samples, np.nan)
        columns = [self.outputs.get(k, missing) for k in names]
        return np.column_stack(columns) if columns else np.zeros((self.samples, 0))

    def cut(
        self, first: int, last: int, name: str | None = None, role: Role | None = None
    ) -> Record:
        """Samples ``first`` <= i < ``last`` as a separate record.

        If the first sample is removed, the start state of the new record is unknown.

        Parameters
        ----------
        first
            Index of the first sample.
        last
            Index after the last sample.
        name
            Name of the new record; default: the same name.
        role
            Role of the new record; default: the same role.
        """
        part = slice(first, last)
        return replace(
            self,
            name=name or self.name,
            time=self.time[part],
            inputs={k: v[part] for k, v in self.inputs.items()},
            outputs={k: v[part] for k, v in self.outputs.items()},
            role=role or self.role,
            start=self.start if first == 0 else StartPrior(known=False),
            before=self._up_to(first) if first else self.before,
        )

    def stretched(self, factor: float) -> Record:
        """Copy whose clock, also of the samples before it, is ``factor`` times as long."""
        before = None if self.before is None else self.before.stretched(factor)
        return replace(self, time=factor * self.time, before=before)

    def continued(self, share: float) -> Record:
        """Copy that goes on after its end: the inputs keep their values, outputs are missing.

        Parameters
        ----------
        share
            Number of further samples as a share of those that there are [1], rounded down.
        """
        if not (count := int(share * self.samples)):
            return self
        later = self.time[-1] + self.interval * np.arange(1, count + 1)
        nothing = np.full(count, np.nan)
        return replace(
            self,
            time=np.concatenate([self.time, later]),
            inputs={k: np.pad(v, (0, count), mode="edge") for k, v in self.inputs.items()},
            outputs={k: np.concatenate([v, nothing]) for k, v in self.outputs.items()},
        )

    def _up_to(self, first: int) -> Record | None:
        """The run from its start to a sample of this record; None if that is less than a step."""
        whole = self if self.before is None else _joined(self.before, self)
        end = whole.samples - self.samples + first
        return whole.cut(0, end) if end > 1 else None

    def with_sensed_input(
        self,
        name: str,
        *,
        delay: float = 0.0,
        bandwidth: float = math.inf,
        gain: float = 1.0,
        offset: float = 0.0,
        faults: Mapping[str, float] | None = None,
    ) -> Record:
        """Copy of the record, with an input converted from its sensor reading to the true value.

        See :func:`unmodeled.chain.true_value`. Inverting a low-pass increases the noise, and
        ``input_sigma`` is changed accordingly.

        Parameters
        ----------
        delay
            Delay [s]; positive: the reading is late.
        bandwidth
            Corner frequency of a first-order low-pass [Hz].
        gain, offset
            Gain [1] and offset [unit of the input].
        faults
            Errors of further kinds by the name of the fault (:attr:`Sensor.faults`).

        Raises
        ------
        DataError
            The input does not exist, or a number is invalid for a sensor.
        """
        errors: dict[str, Any] = {"delay": delay, "bandwidth": bandwidth, "gain": gain}
        errors |= {"offset": offset, "faults": faults or {}}
        return self._sensed(name, Sensor(name=name, **errors).known)

    def _sensed(self, name: str, known: Mapping[str, float]) -> Record:
        """Copy of the record, with an input without known errors."""
        if name not in self.inputs:
            raise DataError(
                f"record {self.name}: no input {name!r}; there are {', '.join(self.inputs)}"
            )
        if not known:
            return self
        sigma = self.input_sigma.get(name, 0.0)
        for fault, size in known.items():
            sigma *= fault_of(fault).noise(self, size)
        return replace(
            self.with_changed_inputs(lambda run: {name: true_value(run, run.inputs[name], known)}),
            input_sigma={**self.input_sigma, name: sigma} if sigma > 0.0 else self.input_sigma,
        )

    def with_output_as_input(
        self, output: str, name: str, *, mode: InputMode | None = None
    ) -> Record:
        """Copy of the record, in which a measured output is an input of the model.

        Known errors of its sensor (delay, bandwidth, gain, offset) are removed, see
        :meth:`with_sensed_input`. Its noise, with the rounding error of its steps, becomes that of
        the input. What an input does not have, such as ``gain_sd``, is omitted with a note.

        Parameters
        ----------
        output
            Output that becomes an input.
        name
            Name of the input.
        mode
            Input mode of the new record; default: the same mode.

        Raises
        ------
        InvalidParameter
            The output does not exist, or another channel has the name of the input.
        DataError
            The output has missing samples.
        """
        if output not in self.outputs:
            raise no_such("channel", output, self.outputs)
        if name in self.inputs or (name in self.outputs and name != output):
            raise InvalidParameter(f"record {self.name}: input {name} exists already")
        sensor = self.sensors[output]
        notes = list(self.notes)
        unused = [key for key in NOT_OF_INPUTS if getattr(sensor, key)]
        if unused:
            notes.append(f"{', '.join(unused)} of {output} has no influence: it is an input")
        sigma = _noise_as_input(sensor, self.outputs[output])
        color = {name: sensor.correlation_time} if sigma and sensor.correlation_time else {}
        unit = {name: sensor.unit} if sensor.unit != "1" else {}
        about: dict[str, Any] = {
            "input_mode": mode or self.input_mode,
            "input_units": {**self.input_units, **unit},
            "input_sigma": {**self.input_sigma, name: sigma} if sigma else self.input_sigma,
            "input_correlation_time": {**self.input_correlation_time, **color},
        }
        before = self.before
        if before is not None:
            read = before.outputs.get(output, np.array([np.nan]))
            if np.all(np.isfinite(read)):
                driven = {k: before.inputs[k] for k in self.inputs}
                before = replace(before, inputs={**driven, name: read}, **about)
            else:
                notes.append(
                    f"samples before the first one are not used: {output} is missing in them"
                )
                before = None
        made = replace(
            self,
            inputs={**self.inputs, name: self.outputs[output]},
            outputs=_without(self.outputs, output),
            sensors=_without(self.sensors, output),
            notes=tuple(notes),
            before=before,
            **about,
        )
        return made._sensed(name, sensor.known)

    def with_inputs(self, inputs: Mapping[str, Array]) -> Record:
        """Copy of the record, with some inputs replaced.

        The samples before it (:attr:`before`) keep their inputs.
        """
        return replace(self, inputs={**self.inputs, **inputs})

    def with_noise(self, sigma: Mapping[str, float]) -> Record:
        """Copy with the standard deviation of the noise of some columns.

        Parameters
        ----------
        sigma
            Standard deviation by input or output [its unit].

        Raises
        ------
        DataError
            There is no such column.
        """
        if missing := [n for n in sigma if n not in self.outputs and n not in self.inputs]:
            raise DataError(
                f"record {self.name}: sigma of {', '.join(missing)}, which is no column; there are "
                f"{', '.join({**self.inputs, **self.outputs})}"
            )
        sensors = {n: replace(s, sigma=sigma.get(n, s.sigma)) for n, s in self.sensors.items()}
        of_inputs = {n: v for n, v in sigma.items() if n in self.inputs}
        return replace(self, sensors=sensors, input_sigma={**self.input_sigma, **of_inputs})

    def with_columns_as_inputs(
        self, columns: Mapping[str, str], mode: InputMode | None = None
    ) -> Record:
        """Copy in which measured columns are inputs, as by :meth:`with_output_as_input`.

        Parameters
        ----------
        columns
            Input -> output of the record, or another input, whose values and noise it gets.
        mode
            Input mode of the copy; default: the same.

        Raises
        ------
        DataError
            There is no such column.
        InvalidParameter
            An output would become an input of a name that another channel has.
        """
        known = {**self.outputs, **self.inputs}
        if missing := [c for c in columns.values() if c not in known]:
            raise DataError(
                f"record {self.name}: no column {', '.join(missing)} for an input; there are "
                f"{', '.join(known)}"
            )
        record, moved = self, dict[str, str]()
        for name, column in columns.items():
            if column in self.inputs:
                record = record._with_input_of(self, column, name)
            elif column in moved:
                record = record._with_input_of(record, moved[column], name)
            else:
                record = record.with_output_as_input(column, name)
                moved[column] = name
        return replace(record, input_mode=mode or self.input_mode)

    def _with_input_of(self, other: Record, source: str, name: str) -> Record:
        """Copy with an input of another record, under a name that it may have already."""
        changed: dict[str, Any] = {}
        for key in ("inputs", "input_units", "input_sigma", "input_correlation_time"):
            values = getattr(other, key)
            stated = {name: values[source]} if source in values else {}
            changed[key] = {**_without(getattr(self, key), name), **stated}
        before = self.before
        if before is not None and other.before is not None:
            before = before._with_input_of(other.before, source, name)
        return replace(self, before=before, **changed)

    def with_changed_inputs(self, change: Callable[[Record], Mapping[str, Array]]) -> Record:
        """Copy of the record, with inputs changed by a function of the whole run.

        Parameters
        ----------
        change
            Gets the record together with the samples before it; returns the changed inputs.
        """
        if self.before is None:
            return self.with_inputs(change(self))
        whole = _joined(self.before, self)
        changed = whole.with_changed_inputs(change)
        parts = [
            {k: v[part] for k, v in changed.inputs.items()}
            for part in (slice(self.before.samples), slice(self.before.samples, None))
        ]
        before = replace(self.before, inputs=parts[0])
        return replace(self, inputs=parts[1], before=before)


def _faults_of_clock(time: Array) -> list[str]:
    if time.size < 2:
        return [f"time has {time.size} samples, expected at least 2"]
    if not np.all(np.isfinite(time)):
        return ["time holds a number that is not finite"]
    backward = np.flatnonzero(np.diff(time) <= 0.0)
    if backward.size:
        at = int(backward[0]) + 1
        return [
            f"time does not increase from {time[at - 1]:.10g} s to {time[at]:.10g} s, sample {at} "
            "counted from 0"
        ]
    return [f"time goes beyond {LARGEST_VALUE:g} s"] if np.any(np.abs(time) > LARGEST_VALUE) else []


def _faults_of_column(name: str, column: Array, time: Array) -> list[str]:
    if column.size != time.size:
        return [f"{name} has {column.size} samples, the clock {time.size}"]
    beyond = np.isfinite(column) & (np.abs(column) > LARGEST_VALUE)
    return [f"{name} holds a number beyond {LARGEST_VALUE:g}"] if np.any(beyond) else []


def _faults_before(before: Record, inputs: Iterable[str], start: float) -> list[str]:
    """Faults of the samples before a record, which starts at a time."""
    faults = []
    lacking = [k for k in inputs if k not in before.inputs]
    if lacking:
        faults.append(f"the record before it has no input {', '.join(lacking)}")
    if before.time[-1] >= start:
        faults.append(
            f"the record before it ends at {before.time[-1]:.10g} s, expected before {start:.10g} s"
        )
    if before.before is not None:
        faults.append("the record before it has an earlier one, expected one for all samples")
    return faults


def _noise_as_input(sensor: Sensor, read: Array) -> float:
    """Standard deviation of the noise of an output that becomes an input; 0: none is known."""
    sigma = math.hypot(sensor.sigma or 0.0, sensor.colored_sigma)
    if sensor.quantum <= 0.0:
        return sigma
    sigma = sigma or noise_of_record(read[np.isfinite(read)])
    return math.hypot(sigma, sensor.quantum / math.sqrt(12.0))


def _without(table: Mapping[str, V], *names: str) -> dict[str, V]:
    return {k: v for k, v in table.items() if k not in names}


def _joined(first: Record, after: Record) -> Record:
    """The samples of a record and of the one before it, with the channels of the later one."""
    missing = np.full(first.samples, np.nan)

    def both(kind: str) -> dict[str, Array]:
        one, other = getattr(first, kind), getattr(after, kind)
        return {k: np.concatenate([one.get(k, missing), v]) for k, v in other.items()}

    return replace(
        after,
        time=np.concatenate([first.time, after.time]),
        inputs=both("inputs"),
        outputs=both("outputs"),
        start=first.start,
        before=None,
    )


def _column(values: object) -> Array:
    column = np.array(values, dtype=np.float64).reshape(-1)
    column.flags.writeable = False
    return column
