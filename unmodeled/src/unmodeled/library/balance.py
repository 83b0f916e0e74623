"""Candidates of a measured force balance: motion in, force out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from unmodeled.chain.times import low_passed
from unmodeled.data import Array, Record
from unmodeled.data.smoothing import noise_of_record, smooth_record
from unmodeled.errors import InvalidParameter, no_such
from unmodeled.fit import Coordinate, Effect, Named
from unmodeled.library.forces import (
    CLEARANCE_SHARPNESS,
    Scales,
    backlash,
    damper_clearance,
    dry_friction_along,
    makers,
    offset_force,
)

#: Speeds by record and position, as long as the record exists.
_speeds: WeakKeyDictionary[Record, dict[str, Array]] = WeakKeyDictionary()


def for_force_balance(
    position: str,
    speed: str | None = None,
    *,
    force: float,
    travel: float,
    pace: float,
    unit: str = "N",
    stiffness: float | None = None,
    damping: float | None = None,
) -> tuple[Effect, ...]:
    """Candidates of a force that is measured together with the motion that causes it.

    The model is an :class:`~unmodeled.fit.LinearModel` or an :class:`~unmodeled.fit.FunctionModel`
    whose output is the force, and the position is among the inputs of the records. The candidates
    are those of a coordinate (:func:`~unmodeled.library.for_coordinate`), and dry friction that
    changes along the travel. A positive magnitude adds to the measured force what moves the
    coordinate forward against the effect. Effects with memory (hysteresis, creep, clearance of a
    damper) start relaxed at the first sample of a record; an effect of your own with another memory
    is left out. Creep is tried with 0.3 and 3 times the time of the travel, ``travel / pace``.

    Parameters
    ----------
    position
        Input that is the position.
    speed
        Input that is the speed; None: :func:`speed_of` the position.
    force
        Typical force [N or N m].
    travel
        Typical displacement [m or rad].
    pace
        Typical speed [m/s or rad/s].
    unit
        Unit of the force; with a unit of a torque, positions are in rad.
    stiffness
        Stiffness of the spring that the model has [N/m or N m/rad]. Only with it, a dead zone of
        this spring is among the candidates.
    damping
        Damping that the model has [N s/m or N m s/rad]. Only with it, a clearance of this damper is
        among the candidates.

    Raises
    ------
    InvalidParameter
        A number is not finite or not above zero.
    """
    numbers = {"force": force, "travel": travel, "pace": pace}
    numbers |= {} if stiffness is None else {"stiffness": stiffness}
    numbers |= {} if damping is None else {"damping": damping}
    faults = [
        f"{n} = {v!r}, expected a finite number > 0"
        for n, v in numbers.items()
        if not 0.0 < v < np.inf
    ]
    if faults:
        raise InvalidParameter("for_force_balance: " + "; ".join(faults))
    place = Coordinate(name="drive", position=position, speed=speed or "", unit=unit)
    scales = Scales(force, travel, pace, travel / pace)
    effects = [make(place, scales) for make in makers()]
    effects = [e for e in effects if all(s.name in MEMORY for s in e.hidden)]
    effects.append(dry_friction_along(place, scale=0.1 * force / travel, speed=pace))
    constant = offset_force(place, scale=0.1 * force).name
    zone = backlash(place, stiffness=stiffness or 1.0, travel=travel)
    effects = [e for e in effects if e.name != zone.name]
    if stiffness is not None:
        effects.append(zone)
    if damping is not None:
        effects.append(damper_clearance(place, damping=damping, travel=travel))
    return tuple(_in_balance(e, place, -1.0 if e.name == constant else 1.0) for e in effects)


def speed_of(record: Record, position: str) -> Array:
    """Speed from the differences of a position without its noise, (n,) [m/s or rad/s].

    The noise is estimated and removed (:func:`unmodeled.data.smoothing.smooth_record`). Differences
    of a noisy position are a speed with large noise. In a balance of forces, such a column makes
    the damping too small, and effects that smooth it seem to act.

    Parameters
    ----------
    record
        Record with the position among its inputs.
    position
        Name of this input.
    """
    known = _speeds.setdefault(record, {})
    if position not in known:
        if position not in record.inputs:
            raise no_such("input", position, record.inputs)
        q = record.inputs[position]
        noise = noise_of_record(q)
        smooth = smooth_record(record.time, q, noise) if noise > 0.0 else q
        known[position] = np.gradient(smooth, record.time)
        known[position].setflags(write=False)
    return known[position]


def _in_balance(effect: Effect, place: Coordinate, sign: float) -> Effect:
    """An effect on a coordinate as a part of the force that moves this coordinate."""
    rate = effect.rate
    assert rate is not None

    def regressor(record: Record, shape: Any) -> Array:
        for name in filter(None, (place.position, place.speed)):
            if name not in record.inputs:
                raise no_such("input", name, record.inputs)
        q = record.inputs[place.position]
        v = record.inputs[place.speed] if place.speed else speed_of(record, place.position)
        x = {place.position: q, place.speed: v}
        x |= {s.name: MEMORY[s.name](record.time, q, shape) for s in effect.hidden}
        force = rate(record.time, Named(x), Named({}), Named({}), 1.0, shape)[place.speed]
        return -sign * np.asarray(force)

    return replace(
        effect,
        name=effect.about.fault or effect.name,
        rate=None,
        hidden=(),
        regressor=regressor,
    )


# --------------------------------------------------------------------------- memory along a record


#: Grid of deflections, as shares of the yield deflection; it ends where the slip is complete.
DEFLECTIONS = np.concatenate([np.linspace(0.0, 0.9, 181), 1.0 - np.geomspace(0.1, 1e-9, 400)[1:]])


def slip_along(position: Array, stretch: float, sharpness: float) -> Array:
    """Slip z of a spring in series with a slip, for a measured position q, (n,).

    With the deflection g = (q - z) / b, the motion makes ``dg = dq / b`` while ``|g|`` shrinks, and
    ``dg = (1 - |g|^n) dq / b`` while it grows (see :func:`~unmodeled.library.hysteresis`). Both
    are one function G of the path length: ``G(g) + dq / b`` is the new G. The slip starts relaxed,
    z = q.

    Parameters
    ----------
    position
        Measured position q, (n,) [m or rad].
    stretch
        Deflection b of full slip [m or rad], > 0.
    sharpness
        Sharpness n of its onset, > 0.
    """
    if position.size < 2:
        return np.array(position, dtype=np.float64)
    from scipy.special import hyp2f1

    table = DEFLECTIONS * hyp2f1(
        1.0, 1.0 / sharpness, 1.0 + 1.0 / sharpness, DEFLECTIONS**sharpness
    )
    steps = np.diff(position) / stretch
    sign = np.where(steps < 0.0, -1.0, 1.0)
    # One run from each reversal of the motion to the next.
    starts = np.flatnonzero(np.diff(sign, prepend=0.0))
    deflection = np.zeros(position.size)
    for first, last in zip(starts, [*starts[1:], steps.size], strict=True):
        ahead = sign[first] * deflection[first]
        length = ahead if ahead <= 0.0 else float(np.interp(ahead, DEFLECTIONS, table))
        length = length + np.cumsum(np.abs(steps[first:last]))
        grown = np.interp(length, table, DEFLECTIONS)
        deflection[first + 1 : last + 1] = sign[first] * np.where(length < 0.0, length, grown)
    return np.asarray(position - stretch * deflection)


#: Memory of an effect along a record: hidden state -> function of time, position and shape.
MEMORY: Mapping[str, Callable[[Array, Array, Any], Array]] = {
    "hysteresis.slip": lambda t, q, shape: slip_along(q, *shape),
    "clearance.slip": lambda t, q, b: slip_along(q, b, CLEARANCE_SHARPNESS),
    "creep.stretch": lambda t, q, tau: low_passed(t, q[None], tau, q[:1])[0],
}
