"""Input effects: errors in the record of an input, or errors of the drive.

Gain, offset and delay are errors of the record, with the sign convention of a sensor
(:mod:`unmodeled.data.readings`). Nonlinearity, saturation and dead zone belong to the drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.data.readings import ReadingError, acting, true_input
from unmodeled.fit import Effect, EffectKind
from unmodeled.fit.observe import low_passed
from unmodeled.library.sensors import curve

#: Shapes of a late input: what acted before the record.
BEFORE = ("constant", "zero")


def _input(
    name: str,
    label: str,
    change: Callable[[Array, float, Any, Record], Array],
    kind: EffectKind = "input",
    **fields: Any,
) -> Effect:
    """Effect on one input; ``change(values, magnitude, shape, record)`` changes its values.

    The kind is "input" if the record may be wrong, and "force" if the drive may be.
    """

    def excite(record: Record, size: float, shape: Any) -> Mapping[str, Array]:
        return {name: change(record.inputs[name], size, shape, record)}

    return Effect(
        name=f"{label} {name}", component=f"input {name}", kind=kind, excite=excite, **fields
    )


def delay_input(name: str, *, scale: float) -> Effect:
    """The record of the input is late by the magnitude [s]; a negative value means early.

    If the input acts later, a record does not contain what acts at its begin. Two shapes are
    tried: the input had the value of the first sample, or it was zero, as with a machine at rest
    that is switched on at the first sample. A record that starts during a motion has the first one.
    """

    def change(values: Array, delay: float, before: str, record: Record) -> Array:
        zero = _starts_from_zero(record, before)
        return true_input(record.time, values, delay=delay, before=0.0 if zero else None)

    return _input(
        name,
        "delay of input",
        change,
        unit="s",
        scale=scale,
        step=0.5,
        shapes=BEFORE,
        shape_names=("input before the record",),
        mechanism="The input acts later or earlier than recorded: the clocks differ, or the drive "
        "is slow to act.",
        remedy="Synchronize the clocks, or model the delay of the drive.",
    )


def _starts_from_zero(record: Record, before: str) -> bool:
    """Whether the input was zero before the record, by the shape of the effect."""
    return before == "zero" and (record.start is None or record.start.known)


def lag_input(name: str, *, scale: float) -> Effect:
    """The input acts with the time constant ``magnitude`` [s]: a first-order low-pass.

    magnitude * d(acting)/dt = recorded - acting. The shapes are those of :func:`delay_input`: at
    the first sample, the first value of the record acts, or nothing does.
    """

    def change(values: Array, constant: float, before: str, record: Record) -> Array:
        if constant <= 0.0:
            return values
        first = 0.0 if _starts_from_zero(record, before) else values[0]
        time = np.concatenate([[2.0 * record.time[0] - record.time[1]], record.time])
        signal = np.concatenate([[first], values])[None]
        return low_passed(time, signal, np.array([constant]), signal[:, 0])[0, 1:]

    return _input(
        name,
        "lag of input",
        change,
        kind="force",
        unit="s",
        scale=scale,
        sign=1,
        step=0.5,
        shapes=BEFORE,
        shape_names=("input before the record",),
        mechanism="The drive follows its input slowly.",
        remedy="Measure what acts on the machine, or model the drive.",
    )


def gain_input(name: str) -> Effect:
    """The record shows (1 + magnitude) times the true input."""
    return _misread(
        name,
        "gain",
        scale=0.05,
        lower=-0.9,  # a record without this input contains no information about it
        mechanism="The record of the input has another gain.",
        remedy="Calibrate the input.",
    )


def bent_input(name: str, *, level: float) -> Effect:
    """The true input is larger by ``magnitude u^2 / level`` or ``magnitude u |u| / level``."""
    return _input(
        name,
        "nonlinearity of input",
        lambda u, size, shape, r: u + size * u * curve(u, shape) / level,
        kind="force",
        scale=0.05,
        shapes=("odd", "even"),
        mechanism="What arrives of the input is not in proportion to it.",
        remedy="Calibrate the drive over its range.",
    )


def offset_input(name: str, *, unit: str, scale: float) -> Effect:
    """The record shows the true input plus the magnitude.

    Parameters
    ----------
    name
        Name of the input.
    unit
        Unit of the input.
    scale
        Offset that one would expect [unit].
    """
    return _misread(
        name,
        "offset",
        unit=unit,
        scale=scale,
        mechanism="The record of the input has an offset.",
        remedy="Zero the input.",
    )


def _misread(name: str, error: ReadingError, **fields: Any) -> Effect:
    """Error of the sensor of an input, in the convention of :mod:`readings`."""
    return _input(
        name,
        f"{error} of input",
        lambda u, size, shape, r: acting(r.time, u, error, size),
        **fields,
    )


def saturation_input(name: str, *, levels: Sequence[float], unit: str = "1") -> Effect:
    """An input that grows less beyond +-level: a drive that saturates.

    With the magnitude m in [0, 1] and the clipped input c = clip(u, -level, level), the model is
    driven by c + (1 - m) (u - c). m = 1 is a hard limit.

    Parameters
    ----------
    name
        Name of the input.
    levels
        Values of the level that are tried, > 0 [unit].
    unit
        Unit of the input.
    """
    return _part_lost(
        name,
        "saturation of input",
        lambda u, level: u - np.clip(u, -level, level),
        levels,
        unit,
        mechanism="Large inputs do not arrive in full.",
        remedy="Lower the drive, or model its limit.",
    )


def dead_zone_input(name: str, *, levels: Sequence[float], unit: str = "1") -> Effect:
    """An input that acts less within +-level: a drive with a dead zone.

    With the magnitude m in [0, 1] and the clipped input c = clip(u, -level, level), the model is
    driven by u - m c: the share 1 - m of small inputs arrives, and large ones lose m level. m = 1
    is a full dead zone.

    Parameters
    ----------
    name
        Name of the input.
    levels
        Values of the level that are tried, > 0 [unit].
    unit
        Unit of the input.
    """
    return _part_lost(
        name,
        "dead zone of input",
        lambda u, level: np.clip(u, -level, level),
        levels,
        unit,
        mechanism="Small inputs do not arrive in full.",
        remedy="Model the dead zone.",
    )


def _part_lost(
    name: str,
    label: str,
    part: Callable[[Array, float], Array],
    levels: Sequence[float],
    unit: str,
    **fields: str,
) -> Effect:
    """A drive that loses the share ``size`` of a part of its input, split at a level."""
    return _input(
        name,
        label,
        lambda u, size, level, r: u - size * part(u, level),
        kind="force",
        scale=0.3,
        sign=1,
        upper=1.0,
        shapes=tuple(levels),
        shape_names=("level" if unit == "1" else f"level [{unit}]",),
        **fields,
    )
