"""Generic effects: for any coordinate of a second-order system, any level, sensor and input.

Every function returns an :class:`~unmodeled.fit.Effect`. With magnitude zero, it changes nothing in
the model. The shape of an effect has lengths and speeds. Their values follow from typical values,
which the caller takes from the records (``travel`` [position unit], ``speed`` [position unit/s]). A
file of this folder with a tuple ``FOR_COORDINATE`` adds its effects to those of every coordinate:
docs/howto/add_an_effect.md.
"""

from __future__ import annotations

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
    dry_friction_each_way,
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
from unmodeled.library.levels import (
    constant_rate,
    exchange,
    leak,
    overflow,
    power_outflow,
    product_loss,
    second_store,
)
from unmodeled.library.readings import (
    clock_rate,
    for_all_inputs,
    for_all_sensors,
    for_input,
    for_sensor,
    input_fault,
    part_of,
    sensor_fault,
)

__all__ = [
    "backlash",
    "bouc_wen",
    "clock_rate",
    "constant_rate",
    "creep",
    "damper_clearance",
    "dry_friction",
    "dry_friction_along",
    "dry_friction_asymmetry",
    "dry_friction_each_way",
    "end_stop",
    "exchange",
    "for_all_inputs",
    "for_all_sensors",
    "for_coordinate",
    "for_force_balance",
    "for_input",
    "for_sensor",
    "hysteresis",
    "input_fault",
    "leak",
    "load_friction",
    "offset_force",
    "overflow",
    "part_of",
    "polynomial_stiffness",
    "power_outflow",
    "product_loss",
    "quadratic_friction",
    "second_store",
    "sensor_fault",
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
        Typical displacement [m or rad]; without meaning if the coordinate has no position.
    speed
        Typical speed [m/s or rad/s].
    time
        Typical duration of an event [s].

    Examples
    --------
    Laws on a slider that moves by 1 cm, with 0.1 m/s and about 10 N:

    >>> from unmodeled import Coordinate, library
    >>> slider = Coordinate(name="slider", position="x", speed="v", inertia=2.0)
    >>> effects = library.for_coordinate(slider, force=10.0, travel=0.01, speed=0.1)
    >>> [e.name for e in effects][:2]
    ['Bouc-Wen hysteresis slider', 'dry friction slider']
    """
    scales = Scales(force, travel, speed, time)
    whole = c.position or all(part.position for part in c.parts)
    return tuple(make(c, scales) for make in makers("FOR_COORDINATE" if whole else "FOR_SPEED"))
