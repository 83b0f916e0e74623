"""Generic effects: for any coordinate of a second-order system, any level, sensor and input.

Every function returns an :class:`~feltmb.fit.Effect` that is exactly the nominal at size zero.
Lengths and speeds that give an effect its shape are taken from ranges that the caller knows from
the records (``travel`` [position unit], ``speed`` [position unit/s]).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from feltmb.data import Array, Record
from feltmb.fit import Coordinate, Coupling, Effect, EffectKind, Named, State
from feltmb.fit.shift import shifted

__all__ = [
    "backlash",
    "bent_input",
    "dead_zone_input",
    "delay_input",
    "drifting_stiffness",
    "dry_friction",
    "end_stop",
    "for_coordinate",
    "for_force_balance",
    "for_input",
    "for_sensor",
    "gain_input",
    "hysteresis",
    "leak",
    "offset_force",
    "offset_input",
    "overflow",
    "polynomial_stiffness",
    "power_outflow",
    "quadratic_friction",
    "saturation_input",
    "sensor_bend",
    "sensor_delay",
    "sensor_gain",
    "sensor_offset",
    "standard_effects",
    "static_friction",
    "viscous_friction",
]

#: What an effect may act on.
Part = Coordinate | Coupling
Rate = Callable[[Any, Named, Named, Named, Any, Any], Mapping[str, Any]]


def _force(c: Part, law: Callable[[Any, Any, Any], Any]) -> Rate:
    """Rate of a force law f(position, speed, shape) per unit of size, against the motion."""

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        return c.push(-size * law(*c.motion(x), shape), t, x, u, p)

    return rate


def dry_friction(c: Part, *, scale: float, speed: float) -> Effect:
    """Coulomb friction F = F_c tanh(v / v_0), v_0 a hundredth of the typical speed or less."""
    return Effect(
        name=f"dry friction {c.name}",
        component=c.name,
        unit=c.unit,
        scale=scale,
        sign=1,
        mechanism="A force of constant size acts against the motion.",
        shapes=(0.003 * speed, 0.03 * speed),
        shape_names=("v_0 [position unit/s]",),
        remedy="Add the friction, or clean and lubricate the guide.",
        rate=_force(c, lambda q, v, v0: np.tanh(v / v0)),
    )


def dry_friction_asymmetry(c: Part, *, scale: float, speed: float) -> Effect:
    """Coulomb friction that differs between the directions: F = F_a |tanh(v / v_0)|."""
    return Effect(
        name=f"one-sided friction {c.name}",
        component=c.name,
        unit=c.unit,
        scale=scale,
        mechanism="Dry friction is stronger in one direction than in the other.",
        shapes=(0.01 * speed,),
        shape_names=("v_0 [position unit/s]",),
        remedy="Use two levels of dry friction.",
        rate=_force(c, lambda q, v, v0: np.abs(np.tanh(v / v0))),
    )


def static_friction(c: Part, *, scale: float, speed: float) -> Effect:
    """Stribeck excess at low speed: F = F_s exp(-(v / v_s)^2) tanh(v / v_0)."""
    return Effect(
        name=f"Stribeck friction {c.name}",
        component=c.name,
        unit=c.unit,
        scale=scale,
        sign=1,
        mechanism="Friction is larger at low speed than in full motion.",
        shapes=((0.05 * speed, 0.003 * speed), (0.3 * speed, 0.01 * speed)),
        shape_names=("v_s [position unit/s]", "v_0 [position unit/s]"),
        remedy="Add the Stribeck term, or change the lubricant.",
        rate=_force(c, lambda q, v, s: np.exp(-((v / s[0]) ** 2)) * np.tanh(v / s[1])),
    )


def viscous_friction(c: Part, *, scale: float) -> Effect:
    """F = d v."""
    return Effect(
        name=f"viscous friction {c.name}",
        component=c.name,
        unit=f"{c.unit} s/m",
        scale=scale,
        mechanism="A force in proportion to the speed acts against the motion.",
        remedy="Add the damping.",
        rate=_force(c, lambda q, v, s: v),
    )


def quadratic_friction(c: Part, *, scale: float) -> Effect:
    """F = c v |v|: drag of air or of a turbulent fluid."""
    return Effect(
        name=f"quadratic friction {c.name}",
        component=c.name,
        unit=f"{c.unit} s^2/m^2",
        scale=scale,
        sign=1,
        mechanism="Drag grows with the square of the speed.",
        remedy="Add the drag.",
        rate=_force(c, lambda q, v, s: v * np.abs(v)),
    )


def polynomial_stiffness(c: Part, power: int, *, scale: float) -> Effect:
    """F = k_n q^n; n = 2 makes a spring asymmetric, n = 3 hardens (> 0) or softens it."""
    name = {1: "linear", 2: "quadratic", 3: "cubic", 5: "quintic"}.get(power, f"power-{power}")
    return Effect(
        name=f"{name} stiffness {c.name}",
        component=c.name,
        unit=f"{c.unit}/m^{power}",
        scale=scale,
        mechanism=f"The spring has a part that grows with the power {power} of the displacement.",
        remedy="Use the nonlinear characteristic of the spring.",
        rate=_force(c, lambda q, v, s: q**power),
    )


def backlash(c: Part, *, stiffness: float, travel: float) -> Effect:
    """Dead zone of a stiffness: a share s of k q is missing within +-b (b: the shapes)."""
    return Effect(
        name=f"dead zone {c.name}",
        component=c.name,
        unit="1",
        scale=0.3,
        sign=1,
        mechanism="Within a clearance the spring does not act.",
        shapes=tuple(travel * f for f in (0.03, 0.1, 0.3)),
        shape_names=("half width [position unit]",),
        remedy="Model the clearance, or close it.",
        rate=_force(c, lambda q, v, b: -stiffness * np.clip(q, -b, b)),
    )


def end_stop(c: Part, *, stiffness: float, travel: float) -> Effect:
    """A spring that is met at one end of the travel: F = k max(q - b, 0), or its mirror image.

    The shape is (side, b): +1 the stop at q = b, -1 the one at q = -b.
    """

    def law(q: Any, v: Any, shape: Any) -> Any:
        side, level = shape
        return side * np.maximum(side * q - level, 0.0)

    return Effect(
        name=f"end stop {c.name}",
        component=c.name,
        unit=f"{c.unit}/m",
        scale=stiffness,
        sign=1,
        mechanism="At one end of the travel a further spring is met.",
        shapes=tuple((side, travel * f) for side in (1.0, -1.0) for f in (0.3, 0.7)),
        shape_names=("side", "level [position unit]"),
        remedy="Model the stop.",
        rate=_force(c, law),
    )


def hysteresis(c: Part, *, scale: float, travel: float) -> Effect:
    """Rate-independent hysteresis: a spring behind a slip z (hidden state), F = F_h (q - z) / b.

    While the spring is strained further the slip takes the share |(q - z) / b|^n of the motion, and
    none when it turns back: the law of Bouc (1967) and Wen (1976) with beta = gamma. The shape is
    (b, n): the stretch [position unit] at which all slips, and how sharply it begins. n = 10 is
    nearly elastic-plastic (Jenkins), n = 2 round; n = 1 with a small b nears pre-sliding friction
    (Dahl 1968).
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        b, n = shape
        q, v = c.motion(x)
        gap = q - x["slip"]
        share = np.minimum(np.abs(gap) / b, 1.0) ** n
        forward = np.where(gap * v > 0.0, share, 0.0)
        force = -size * np.clip(gap / b, -1.0, 1.0)
        return {**c.push(force, t, x, u, p), "slip": forward * v}

    return Effect(
        name=f"hysteresis {c.name}",
        component=c.name,
        unit=c.unit,
        scale=scale,
        sign=1,
        kind="state",
        mechanism="Force depends on the direction of the last reversal, not on the speed.",
        shapes=tuple((travel * f, n) for f in (0.03, 0.2) for n in (2.0, 10.0)),
        shape_names=("stretch [position unit]", "sharpness"),
        remedy="Use a law with memory.",
        hidden=(State(name="slip", hidden=True, scale=travel, start_sd=0.3 * travel),),
        rate=rate,
    )


def creep(c: Part, *, scale: float, times: Sequence[float]) -> Effect:
    """A Maxwell branch: F = k (q - z), dz/dt = (q - z) / tau."""

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, tau: Any) -> Mapping[str, Array]:
        stretch = c.motion(x)[0] - x["creep"]
        return {**c.push(-size * stretch, t, x, u, p), "creep": stretch / tau}

    return Effect(
        name=f"creep {c.name}",
        component=c.name,
        unit=f"{c.unit}/m",
        scale=scale,
        sign=1,
        kind="state",
        mechanism="The spring relaxes with time.",
        shapes=tuple(times),
        shape_names=("time [s]",),
        remedy="Add a relaxing branch.",
        hidden=(State(name="creep", hidden=True),),
        rate=rate,
    )


def drifting_stiffness(c: Part, *, scale: float, times: Sequence[float]) -> Effect:
    """A stiffness that comes within a record: F = k (1 - exp(-t / tau)) q; warming, settling.

    The time [s] is that of the record, which should begin with the drift; the shapes are tau [s].
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, tau: Any) -> Mapping[str, Array]:
        q, _ = c.motion(x)
        return c.push(size * np.expm1(-t / tau) * q, t, x, u, p)

    return Effect(
        name=f"drifting stiffness {c.name}",
        component=c.name,
        unit=f"{c.unit}/m",
        scale=scale,
        kind="drift",
        mechanism="The spring changes while the record runs.",
        shapes=tuple(float(v) for v in times),
        shape_names=("time [s]",),
        remedy="Warm up before measuring, or model the change.",
        rate=rate,
    )


def offset_force(c: Part, *, scale: float) -> Effect:
    """A constant force: gravity, preload, an offset of the drive."""
    return Effect(
        name=f"constant force {c.name}",
        component=c.name,
        unit=c.unit,
        scale=scale,
        mechanism="A constant force acts that the model lacks.",
        remedy="Add the force; look for gravity, preload or an offset of the drive.",
        rate=_force(c, lambda q, v, s: -np.ones_like(q)),
    )


# ------------------------------------------------------------------ first order: levels


def overflow(state: str, *, levels: Sequence[float], rate_scale: float, into: str = "") -> Effect:
    """Overflow above a level: the state loses size * max(0, x - level) a second.

    The level is a shape; with ``into`` a share of the loss (second number of the shape) arrives in
    another state. A size far above the rates of the system holds the level.
    """
    shares = (0.0, 0.5, 1.0) if into else (0.0,)

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        level, share = shape
        loss = size * np.maximum(x[state] - level, 0.0)
        change = {state: -loss}
        if into:
            change[into] = share * loss
        return change

    return Effect(
        name=f"overflow {state}",
        component=state,
        unit="1/s",
        scale=rate_scale,
        sign=1,
        upper=100.0 * rate_scale,
        mechanism="Above a level the store spills.",
        shapes=tuple((float(level), share) for level in levels for share in shares),
        shape_names=("level [state unit]", "share"),
        remedy="Limit the level, or model the overflow.",
        rate=rate,
    )


def leak(state: str, *, scale: float) -> Effect:
    """A loss in proportion to the state."""
    return Effect(
        name=f"leak {state}",
        component=state,
        unit="1/s",
        scale=scale,
        mechanism="The store loses in proportion to its level.",
        remedy="Add the loss.",
        rate=lambda t, x, u, p, size, shape: {state: -size * x[state]},
    )


def power_outflow(state: str, power: float, *, scale: float) -> Effect:
    """A loss with another power of the state than the model has."""
    return Effect(
        name=f"loss ~ {state}^{power:g}",
        component=state,
        scale=scale,
        mechanism=f"The store loses with the power {power:g} of its level.",
        remedy="Use another law of outflow.",
        rate=lambda t, x, u, p, size, shape: {state: -size * np.maximum(x[state], 0.0) ** power},
    )


def constant_rate(state: str, *, scale: float) -> Effect:
    """A constant inflow."""
    return Effect(
        name=f"constant inflow {state}",
        component=state,
        scale=scale,
        mechanism="Something flows in (or out) all the time.",
        remedy="Add the constant flow.",
        rate=lambda t, x, u, p, size, shape: {state: size + 0.0 * x[state]},
    )


# ------------------------------------------------------------------ inputs


def _input(
    name: str,
    label: str,
    change: Callable[[Array, float, Any, Record], Array],
    kind: EffectKind = "input",
    **fields: Any,
) -> Effect:
    """``change(values, size, shape, record)`` of one input.

    The kind is "input" where the record may be wrong, "force" where the drive is.
    """

    def excite(record: Record, size: float, shape: Any) -> Mapping[str, Array]:
        return {name: change(record.inputs[name], size, shape, record)}

    return Effect(
        name=f"{label} {name}", component=f"input {name}", kind=kind, excite=excite, **fields
    )


def delay_input(name: str, *, scale: float) -> Effect:
    """The input acts later by the size [s]."""
    return _input(
        name,
        "delay of input",
        lambda u, size, shape, r: np.interp(r.time - size, r.time, u),
        unit="s",
        scale=scale,
        step=0.5,
        mechanism="The input acts later than the record says.",
        remedy="Synchronize the clocks, or model the delay.",
    )


def gain_input(name: str) -> Effect:
    """The input is larger by the factor 1 + size."""
    return _input(
        name,
        "gain of input",
        lambda u, size, shape, r: (1.0 + size) * u,
        scale=0.05,
        mechanism="The gain of the input is wrong.",
        remedy="Calibrate the input.",
    )


def bent_input(name: str, *, level: float) -> Effect:
    """The input is larger by size u^2 / level ("even") or size u |u| / level ("odd")."""
    return _input(
        name,
        "nonlinearity of input",
        lambda u, size, shape, r: u + size * u * _curve(u, shape) / level,
        kind="force",
        scale=0.05,
        shapes=("odd", "even"),
        mechanism="What arrives of the input is not in proportion to it.",
        remedy="Calibrate the drive over its range.",
    )


def _curve(values: Array, shape: str) -> Array:
    return np.abs(values) if shape == "odd" else values


def offset_input(name: str, *, unit: str, scale: float) -> Effect:
    """The input is larger by the size."""
    return _input(
        name,
        "offset of input",
        lambda u, size, shape, r: u + size,
        unit=unit,
        scale=scale,
        mechanism="The input has an offset.",
        remedy="Zero the input.",
    )


def saturation_input(name: str, *, levels: Sequence[float]) -> Effect:
    """Of the input beyond +-level only the share 1 - size arrives."""
    return _input(
        name,
        "saturation of input",
        lambda u, size, level, r: u - size * (u - np.clip(u, -level, level)),
        kind="force",
        scale=0.3,
        sign=1,
        upper=1.0,
        shapes=tuple(levels),
        shape_names=("level [input unit]",),
        mechanism="Large inputs do not arrive in full.",
        remedy="Lower the drive, or model its limit.",
    )


def dead_zone_input(name: str, *, levels: Sequence[float]) -> Effect:
    """Of the input within +-level only the share 1 - size arrives."""
    return _input(
        name,
        "dead zone of input",
        lambda u, size, level, r: u - size * np.clip(u, -level, level),
        kind="force",
        scale=0.3,
        sign=1,
        upper=1.0,
        shapes=tuple(levels),
        shape_names=("level [input unit]",),
        mechanism="Small inputs do not arrive in full.",
        remedy="Model the dead zone.",
    )


# ------------------------------------------------------------------ sensors


def _sensor(
    outputs: Sequence[str],
    name: str,
    label: str,
    change: Callable[[Array, Array, Record, Array, Any], Array],
    **fields: Any,
) -> Effect:
    """``change(values (B, L), sizes (B,), record, windows (B, 2), shape)`` of one channel."""
    channel = list(outputs).index(name)

    def observe(record: Record, values: Array, windows: Array, sizes: Array, shape: Any) -> Array:
        out = values.copy()
        out[:, :, channel] = change(values[:, :, channel], sizes, record, windows, shape)
        return out

    return Effect(
        name=f"{label} {name}", component=f"sensor {name}", kind="sensor", observe=observe, **fields
    )


def sensor_gain(outputs: Sequence[str], name: str) -> Effect:
    """The channel shows (1 + size) times the output."""
    return _sensor(
        outputs,
        name,
        "gain of sensor",
        lambda y, size, r, w, shape: (1.0 + size[:, None]) * y,
        scale=0.05,
        mechanism="The sensor has another gain.",
        remedy="Calibrate the sensor.",
    )


def sensor_bend(outputs: Sequence[str], name: str, *, level: float) -> Effect:
    """The channel shows y + size y^2 / level ("even") or y + size y |y| / level ("odd")."""
    return _sensor(
        outputs,
        name,
        "nonlinearity of sensor",
        lambda y, size, r, w, shape: y + size[:, None] * y * _curve(y, shape) / level,
        scale=0.05,
        shapes=("odd", "even"),
        mechanism="The sensor is not linear.",
        remedy="Calibrate the sensor over its range.",
    )


def sensor_offset(outputs: Sequence[str], name: str, *, unit: str, scale: float) -> Effect:
    """The channel shows the output plus the size."""
    return _sensor(
        outputs,
        name,
        "offset of sensor",
        lambda y, size, r, w, shape: y + size[:, None],
        unit=unit,
        scale=scale,
        mechanism="The sensor has an offset.",
        remedy="Zero the sensor.",
    )


def sensor_delay(outputs: Sequence[str], name: str, *, scale: float) -> Effect:
    """The channel lags the output by the size [s]."""
    return _sensor(
        outputs,
        name,
        "delay of sensor",
        lambda y, size, r, w, shape: shifted(r, y, w, size),
        unit="s",
        scale=scale,
        mechanism="The sensor lags.",
        remedy="Synchronize the clocks.",
    )


# ------------------------------------------------------------------ bundles


def for_coordinate(
    c: Part, *, force: float, travel: float, speed: float, time: float = 0.1
) -> tuple[Effect, ...]:
    """All force effects of a coordinate, scaled by its typical force, travel and speed."""
    return (
        dry_friction(c, scale=0.1 * force, speed=speed),
        dry_friction_asymmetry(c, scale=0.1 * force, speed=speed),
        static_friction(c, scale=0.1 * force, speed=speed),
        viscous_friction(c, scale=0.1 * force / speed),
        quadratic_friction(c, scale=0.1 * force / speed**2),
        polynomial_stiffness(c, 1, scale=0.1 * force / travel),
        polynomial_stiffness(c, 2, scale=0.1 * force / travel**2),
        polynomial_stiffness(c, 3, scale=0.1 * force / travel**3),
        backlash(c, stiffness=force / travel, travel=travel),
        end_stop(c, stiffness=0.3 * force / travel, travel=travel),
        hysteresis(c, scale=0.1 * force, travel=travel),
        creep(c, scale=0.1 * force / travel, times=(0.3 * time, 3.0 * time)),
        offset_force(c, scale=0.1 * force),
    )


def for_input(name: str, record: Record, *, unit: str = "1") -> tuple[Effect, ...]:
    """All input effects, scaled by a record."""
    u = record.inputs[name]
    size = float(np.quantile(np.abs(u), 0.98)) or 1.0
    return (
        delay_input(name, scale=record.interval),
        gain_input(name),
        bent_input(name, level=size),
        offset_input(name, unit=unit, scale=0.02 * size),
        saturation_input(name, levels=tuple(size * f for f in (0.5, 0.8))),
        dead_zone_input(name, levels=tuple(size * f for f in (0.05, 0.2))),
    )


def for_sensor(outputs: Sequence[str], name: str, record: Record) -> tuple[Effect, ...]:
    """All sensor effects, scaled by a record."""
    y = record.outputs[name]
    spread = float(np.nanstd(y)) or 1.0
    unit = record.sensors[name].unit
    return (
        sensor_gain(outputs, name),
        sensor_bend(outputs, name, level=float(np.nanmax(np.abs(y))) or 1.0),
        sensor_offset(outputs, name, unit=unit, scale=0.05 * spread),
        sensor_delay(outputs, name, scale=record.interval),
    )


def standard_effects(
    outputs: Sequence[str],
    inputs: Sequence[str],
    coordinates: Sequence[Part],
    record: Record,
    *,
    force: float,
    travel: float,
    speed: float,
    time: float = 0.1,
) -> tuple[Effect, ...]:
    """Generic effects of a whole second-order model, scaled by a record."""
    out: list[Effect] = []
    for c in coordinates:
        out.extend(for_coordinate(c, force=force, travel=travel, speed=speed, time=time))
    for name in inputs:
        out.extend(for_input(name, record))
    for name in outputs:
        if name in record.outputs:
            out.extend(for_sensor(outputs, name, record))
    return tuple(out)


def for_force_balance(
    position: str, speed: str, *, force: float, travel: float, pace: float, unit: str = "N"
) -> tuple[Effect, ...]:
    """Terms of a measured force balance that is linear in its parameters.

    For :class:`~feltmb.fit.LinearNominal` with ``position`` and ``speed`` among the inputs of the
    records; ``force``, ``travel`` and ``pace`` are their typical sizes.
    """

    def effect(
        name: str,
        mechanism: str,
        column: Callable[[Array, Array, Any], Array],
        scale: float,
        unit_of: str,
        sign: int = 0,
        shapes: tuple[Any, ...] = (None,),
    ) -> Effect:
        return Effect(
            name=name,
            component="guide" if "friction" in name else "drive",
            unit=unit_of,
            scale=scale,
            sign=sign,  # type: ignore[arg-type]
            shapes=shapes,
            mechanism=mechanism,
            regressor=lambda r, s: column(r.inputs[position], r.inputs[speed], s),
        )

    part = 0.1 * force
    return (
        effect(
            "dry friction",
            "A force of constant size acts against the motion.",
            lambda q, v, v0: np.tanh(v / v0),
            part,
            unit,
            1,
            (0.003 * pace, 0.03 * pace),
        ),
        effect(
            "one-sided friction",
            "Dry friction differs between the directions.",
            lambda q, v, v0: np.abs(np.tanh(v / v0)),
            part,
            unit,
            0,
            (0.01 * pace,),
        ),
        effect(
            "Stribeck friction",
            "Friction is larger at low speed than in full motion.",
            lambda q, v, s: np.exp(-((v / s[0]) ** 2)) * np.tanh(v / s[1]),
            part,
            unit,
            1,
            ((0.05 * pace, 0.003 * pace), (0.3 * pace, 0.01 * pace)),
        ),
        effect(
            "quadratic friction",
            "Drag grows with the square of the speed.",
            lambda q, v, s: v * np.abs(v),
            part / pace**2,
            f"{unit} s^2/m^2",
            1,
        ),
        effect(
            "constant force",
            "A constant force acts that the model lacks.",
            lambda q, v, s: np.ones_like(q),
            part,
            unit,
        ),
        effect(
            "linear stiffness",
            "A spring acts that the model lacks.",
            lambda q, v, s: q,
            part / travel,
            f"{unit}/m",
        ),
        effect(
            "cubic stiffness",
            "A hardening spring acts that the model lacks.",
            lambda q, v, s: q**3,
            part / travel**3,
            f"{unit}/m^3",
        ),
        effect(
            "friction along the travel",
            "Dry friction changes along the guide.",
            lambda q, v, v0: q * np.tanh(v / v0),
            part / travel,
            f"{unit}/m",
            0,
            (0.01 * pace,),
        ),
    )
