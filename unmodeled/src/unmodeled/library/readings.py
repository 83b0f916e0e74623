"""Effects of sensors and inputs: the faults of :mod:`unmodeled.chain` with sizes from a record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.chain import Fault, Link, Signal, fault_of, faults
from unmodeled.chain.drifts import Part
from unmodeled.data import Array, Record
from unmodeled.fit import Effect
from unmodeled.library.forces import product
from unmodeled.models.subject import Scope, Subject, SubjectKind


@checked
def sensor_fault(
    outputs: Sequence[str],
    name: str,
    fault: str,
    *,
    record: Record | None = None,
    unit: str = "",
    **fields: Any,
) -> Effect:
    """An error of a sensor, which changes a channel of the simulated outputs.

    ``gain``: reading = (1 + m) y; ``offset``: y + m; ``nonlinearity``: y + m y^2 / Y ("even") or
    y + m y abs(y) / Y ("odd"), where Y is the largest reading; ``delay``: y(t - m); ``lag``:
    m dr/dt + r = y; ``saturation``: the share 1 - m of what is beyond a highest or lowest reading.
    m is the magnitude.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    fault
        Name of the fault.
    record
        Record from whose values the expected magnitude follows; None: values of size 1, sampled
        once a second.
    unit
        Unit of the channel; default: that of the record, or 1.
    fields
        Fields of :class:`~unmodeled.Effect` that differ, such as ``scale``, ``shapes``.

    Raises
    ------
    InvalidParameter
        There is no such fault.

    Examples
    --------
    The gain of the sensor x, one of the outputs x and y:

    >>> from unmodeled import library
    >>> library.sensor_fault(["x", "y"], "x", "gain").name
    'gain of sensor x'
    """
    signal = Signal(name, np.array([-1.0, 1.0]), unit=unit or "1")
    if record is not None:
        unit = unit or record.sensors[name].unit
        signal = Signal(name, record.outputs[name], record.interval, unit)
    own = fault_of(fault)
    link = Link(own.of(signal), [list(outputs).index(name)])
    return _effect(own, signal, {"kind": "sensor", "observe": link, **fields})


@checked
def input_fault(
    name: str, fault: str, *, record: Record | None = None, unit: str = "", **fields: Any
) -> Effect:
    """An error of a recorded input, or of a drive, which changes the input of the model.

    ``gain``, ``offset``, ``delay``: errors of the record, as those of a sensor; the true input
    drives the model. ``nonlinearity``, ``lag``, ``saturation``, ``dead zone``: what the drive makes
    of the recorded input. If an input acts later, a record does not contain what acts at its begin.
    Two shapes are tried: the input had the value of the first sample, or it was zero. A record that
    starts during a motion has the first one.

    Parameters
    ----------
    name
        Name of the input.
    fault, record, unit, fields
        As for :func:`sensor_fault`.

    Raises
    ------
    InvalidParameter
        There is no such fault.

    Examples
    --------
    The force acts later, or earlier, than it was recorded:

    >>> from unmodeled import library
    >>> effect = library.input_fault("force", "delay", scale=1e-3)
    >>> effect.name, effect.unit
    ('delay of input force', 's')
    """
    signal = Signal(name, np.array([-1.0, 1.0]), unit=unit or "1", is_input=True)
    if record is not None:
        unit = unit or record.input_units.get(name) or "1"
        signal = Signal(name, record.inputs[name], record.interval, unit, is_input=True)
    own = fault_of(fault).of(signal)

    def excite(run: Record, size: float, shape: Any) -> Mapping[str, Array]:
        values = run.inputs[name]
        if size == 0.0:
            return {name: values}
        return {name: (own.act if own.drive else own.undo)(run, values[None], size, shape)[0]}

    kind = "force" if own.drive else "input"
    return _effect(own, signal, {"kind": kind, "excite": excite, **fields})


#: Faults that several signals may have in one: of a bus or a clock, of equal drives or filters.
TOGETHER = ("delay", "lag", "gain")


def for_all_inputs(
    names: Sequence[str], record: Record, units: Mapping[str, str] | None = None
) -> tuple[Effect, ...]:
    """Errors that all inputs have with one size, scaled by a record; none of a single input.

    A gain is that of all inputs with one unit.

    Parameters
    ----------
    names
        Names of the inputs.
    record
        Record from which typical magnitudes are taken.
    units
        Unit of each input; default: that of the record, or 1.
    """
    found = []
    for fault, place, some in _of_one_unit(
        "inputs", names, {**record.input_units, **(units or {})}
    ):
        own = [input_fault(n, fault, record=record) for n in some]
        found.append(together(own, place, excite=_excite_all(own)))
    return tuple(found)


def _of_one_unit(
    what: str, names: Sequence[str], units: Mapping[str, str]
) -> Iterator[tuple[str, str, list[str]]]:
    """Faults, and the signals that may have them together: a gain those of one unit."""
    for fault in TOGETHER:
        groups: dict[str, list[str]] = {}
        for n in names:
            groups.setdefault(units.get(n, "1") if fault == "gain" else "", []).append(n)
        for unit, some in groups.items():
            if len(some) > 1:
                yield fault, f"all {what}" + f" in {unit}" * (len(groups) > 1), some


def for_all_sensors(
    outputs: Sequence[str], names: Sequence[str], record: Record
) -> tuple[Effect, ...]:
    """Errors that all sensors have with one size, scaled by a record; none of a single sensor.

    A gain is that of all sensors with one unit.

    Parameters
    ----------
    outputs
        Outputs of the model.
    names
        Channels of the sensors.
    record
        Record from which typical magnitudes are taken.
    """
    found = []
    for fault, place, some in _of_one_unit("sensors", names, record.units):
        own = [sensor_fault(outputs, n, fault, record=record) for n in some]
        each = [e.observe.fault for e in own if isinstance(e.observe, Link)]
        link = Link(each[0], [list(outputs).index(n) for n in some], each)
        found.append(together(own, place, observe=link))
    return tuple(found)


def _excite_all(effects: Sequence[Effect]) -> Callable[..., Mapping[str, Array]]:
    def excite(run: Record, size: float, shape: Any) -> Mapping[str, Array]:
        found: dict[str, Array] = {}
        for e in effects:
            assert e.excite is not None
            found |= e.excite(run, size, shape)
        return found

    return excite


def together(effects: Sequence[Effect], place: str, **fields: Any) -> Effect:
    """One effect for the same law of several signals or coordinates."""
    about = effects[0].about
    channels = tuple(e.about.channel or e.component for e in effects)
    return replace(
        effects[0],
        name=f"{about.fault} of {place}",
        component=place,
        subject=replace(about, channel="", component=place, scope=Scope(channels=channels)),
        **fields,
    )


def _effect(fault: Fault, signal: Signal, fields: Mapping[str, Any]) -> Effect:
    what: SubjectKind = "input" if signal.is_input else "sensor"
    place = f"{what} {signal.name}"
    texts = fault.input if signal.is_input else fault.sensor
    about = dict(zip(("mechanism", "remedy"), texts or (), strict=False))
    own: dict[str, Any] = {
        "name": f"{fault.name} of {place}",
        "component": place,
        "subject": Subject(what, fault.name, signal.name, place),
        "unit": fault.unit or signal.unit,
    }
    return Effect(**{**own, **about, **fault.fields(signal), **fields})


@checked
def part_of(
    outputs: Sequence[str],
    name: str,
    other: str,
    record: Record,
    times: Sequence[float] = (),
    *,
    unit: str = "",
) -> Effect:
    """A part of another signal in a reading: cross-talk, or with ``times`` a store at an output.

    reading = y + m w, where w is the other signal, as it was measured, or after a first-order lag.
    It is less than the reading itself: else the gain of the model would be another one.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    other
        Another channel, or an input.
    record
        Record from whose values the expected magnitude follows.
    times
        Time constants of the lag that are tried [s]; (): there is none.
    unit
        Unit of the other signal; default: that of the record, or 1.
    """
    signal = record.inputs if other in record.inputs else record.outputs
    unit = unit or record.input_units.get(other) or record.units.get(other) or "1"
    sizes = [float(np.nanstd(v)) or 1.0 for v in (record.outputs[name], signal[other])]
    law = "slow part" if times else "part"
    label = f"a {law} of {other}"
    return Effect(
        name=f"{law} of {other} in sensor {name}",
        component=f"sensor {name}",
        label=label,
        subject=Subject("sensor", law, name, f"sensor {name}", label),
        unit=product((record.sensors[name].unit, 1), (unit, -1)),
        scale=0.05 * sizes[0] / sizes[1],
        lower=-sizes[0] / sizes[1],
        upper=sizes[0] / sizes[1],
        kind="sensor",
        observe=Link(Part(other), [list(outputs).index(name)]),
        shapes=tuple(times) or (None,),
        shape_names=("time [s]",) * bool(times),
        mechanism=f"The reading also shows {other}" + (", after a while." if times else "."),
        remedy="Look for cross-talk, or add a store at this output.",
    )


def clock_rate() -> Effect:
    """The clock of all channels runs by another rate than that of the model and its inputs.

    At the time t of a record, counted from its first sample, the channels show the outputs at the
    time (1 + magnitude) t.
    """
    return Effect(
        name="clock of the sensors",
        component="clock",
        subject=Subject("clock", "clock", component="clock"),
        kind="sensor",
        observe=Link(fault_of("clock")),
        scale=0.01,
        mechanism="The clock of the records runs by another rate than the time of the model.",
        remedy="Compare the clock with another one over a long time.",
    )


def for_input(name: str, record: Record, *, unit: str | None = None) -> tuple[Effect, ...]:
    """All input effects, scaled by a record.

    Parameters
    ----------
    name
        Name of the input.
    record
        Record from which typical magnitudes are taken.
    unit
        Unit of the input; default: that of the record, or 1.
    """
    chosen = [n for n, fault in faults().items() if fault.input is not None]
    return tuple(input_fault(name, n, record=record, unit=unit or "") for n in chosen)


def for_sensor(outputs: Sequence[str], name: str, record: Record) -> tuple[Effect, ...]:
    """All sensor effects, scaled by a record.

    Parameters
    ----------
    outputs
        Outputs of the model.
    name
        Channel of the sensor.
    record
        Record from which typical magnitudes are taken.

    Examples
    --------
    Errors that a sensor of a sine may have:

    >>> import numpy as np
    >>> from unmodeled import Record, library
    >>> time = np.linspace(0.0, 1.0, 50)
    >>> record = Record(name="r", time=time, inputs={}, outputs={"x": np.sin(9.0 * time)})
    >>> [e.name for e in library.for_sensor(["x"], "x", record)][:3]
    ['lag of sensor x', 'delay of sensor x', 'gain of sensor x']
    """
    signal = Signal(name, record.outputs[name], record.interval)
    chosen = [n for n, f in faults().items() if f.sensor is not None and f.suits(signal)]
    return tuple(sensor_fault(outputs, name, n, record=record) for n in chosen)
