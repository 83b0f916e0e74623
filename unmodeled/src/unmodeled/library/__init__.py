"""Generic effects: for any coordinate of a second-order system, any level, sensor and input.

Every function returns an :class:`~unmodeled.fit.Effect`. With magnitude zero, it changes nothing in
the model. The shape of an effect has lengths and speeds. Their values follow from typical values,
which the caller takes from the records (``travel`` [position unit], ``speed`` [position unit/s]). A
file of this folder with a tuple ``FOR_COORDINATE`` adds its effects to those of every coordinate:
docs/howto/add_an_effect.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unmodeled.data import Record
from unmodeled.fit import Effect
from unmodeled.library.balance import for_force_balance, speed_of
from unmodeled.library.bouc_wen import bouc_wen
from unmodeled.library.forces import (
    Part,
    Scales,
    backlash,
    creep,
    damper_clearance,
    dry_friction,
    dry_friction_along,
    dry_friction_asymmetry,
    end_stop,
    hysteresis,
    load_friction,
    makers,
    offset_force,
    polynomial_stiffness,
    quadratic_friction,
    static_friction,
    viscous_friction,
)
from unmodeled.library.inputs import (
    bent_input,
    dead_zone_input,
    delay_input,
    gain_input,
    lag_input,
    offset_input,
    saturation_input,
)
from unmodeled.library.levels import (
    constant_rate,
    exchange,
    leak,
    overflow,
    power_outflow,
    second_store,
)
from unmodeled.library.sensors import (
    clock_rate,
    sensor_bend,
    sensor_delay,
    sensor_gain,
    sensor_lag,
    sensor_offset,
    sensor_saturation,
)

__all__ = [
    "backlash",
    "bent_input",
    "bouc_wen",
    "clock_rate",
    "constant_rate",
    "creep",
    "damper_clearance",
    "dead_zone_input",
    "delay_input",
    "dry_friction",
    "dry_friction_along",
    "dry_friction_asymmetry",
    "end_stop",
    "exchange",
    "for_coordinate",
    "for_force_balance",
    "for_input",
    "for_sensor",
    "gain_input",
    "hysteresis",
    "lag_input",
    "leak",
    "load_friction",
    "offset_force",
    "offset_input",
    "overflow",
    "polynomial_stiffness",
    "power_outflow",
    "quadratic_friction",
    "saturation_input",
    "second_store",
    "sensor_bend",
    "sensor_delay",
    "sensor_gain",
    "sensor_lag",
    "sensor_offset",
    "sensor_saturation",
    "speed_of",
    "static_friction",
    "viscous_friction",
]


def for_coordinate(
    c: Part, *, force: float, travel: float, speed: float, time: float = 0.1
) -> tuple[Effect, ...]:
    """All force effects of a coordinate, scaled by its typical force, travel and speed.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    force
        Typical force on it [N or N m].
    travel
        Typical displacement [m or rad].
    speed
        Typical speed [m/s or rad/s].
    time
        Typical duration of an event [s].
    """
    scales = Scales(force, travel, speed, time)
    return tuple(make(c, scales) for make in makers())


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
    u, unit = record.inputs[name], unit or record.input_units.get(name) or "1"
    size = float(np.quantile(np.abs(u), 0.98)) or 1.0
    return (
        delay_input(name, scale=record.interval),
        lag_input(name, scale=3.0 * record.interval),
        gain_input(name),
        bent_input(name, level=size),
        offset_input(name, unit=unit, scale=0.02 * size),
        saturation_input(name, levels=tuple(size * f for f in (0.5, 0.8)), unit=unit),
        dead_zone_input(name, levels=tuple(size * f for f in (0.05, 0.2)), unit=unit),
    )


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
    """
    y = record.outputs[name]
    spread = float(np.nanstd(y)) or 1.0
    range_ = float(np.nanmax(y) - np.nanmin(y)) or 1.0
    unit = record.sensors[name].unit
    return (
        sensor_gain(outputs, name),
        sensor_bend(outputs, name, level=float(np.nanmax(np.abs(y))) or 1.0),
        sensor_offset(outputs, name, unit=unit, scale=0.05 * spread),
        sensor_delay(outputs, name, scale=record.interval),
        sensor_lag(outputs, name, scale=3.0 * record.interval),
        sensor_saturation(
            outputs,
            name,
            highest=tuple(float(np.nanmax(y) - f * range_) for f in (0.02, 0.25)),
            lowest=tuple(float(np.nanmin(y) + f * range_) for f in (0.02, 0.25)),
            unit=unit,
        ),
    )
