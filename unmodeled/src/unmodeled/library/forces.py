"""Force effects on a coordinate: friction, stiffness, backlash, hysteresis, creep, drift."""

from __future__ import annotations

import functools
import importlib
import pkgutil
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.fit import Coordinate, Coupling, Effect, Named, State
from unmodeled.models.subject import Subject, SubjectKind

#: Coordinate or coupling of two coordinates: the place of a force effect.
Part = Coordinate | Coupling
#: Sharpness with which a clearance is passed; the larger, the closer to a hard stop.
CLEARANCE_SHARPNESS = 10.0
Rate = Callable[[Any, Named, Named, Named, Any, Any], Mapping[str, Any]]


@dataclass(frozen=True)
class Scales:
    """Typical values of a coordinate, in its units."""

    force: float
    travel: float
    speed: float
    time: float
    """Typical duration of an event [s]."""


def force_law(c: Part, law: Callable[[Any, Any, Any], Any]) -> Rate:
    """Rate of an effect with the force ``-magnitude * law(position, speed, shape)``."""

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        return c.push(-size * law(*c.motion(x), shape), t, x, u, p)

    return rate


def rate_of_all(rates: Sequence[Rate]) -> Rate:
    """Rate of one law at several coordinates, each with the whole magnitude."""

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        found: dict[str, Any] = {}
        for own in rates:
            for state, value in own(t, x, u, p, size, shape).items():
                found[state] = found[state] + value if state in found else value
        return found

    return rate


def on(c: Part, law: str, label: str = "", **fields: Any) -> Effect:
    """Effect of a law on a coordinate or a coupling.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    law
        Name of the law.
    label
        What is added, with its article; default: the name of the law.
    fields
        Other fields of the effect.
    """
    kind: SubjectKind = "between" if isinstance(c, Coupling) and c.found else "coordinate"
    about = Subject(kind, law, component=c.name, label=label or law)
    return Effect(name=f"{law} {c.name}", component=c.name, label=label, subject=about, **fields)


def dry_friction(c: Part, *, scale: float, speed: float) -> Effect:
    """Coulomb friction F = F_c tanh(v / v_0), v_0 a hundredth of the typical speed or less.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Friction force that one would expect [N or N m].
    speed
        Typical speed, from which values of the threshold speed follow.

    Examples
    --------
    Dry friction of a guide, about 0.5 N, full from 1 mm/s on:

    >>> from unmodeled import Coordinate, library
    >>> guide = Coordinate(name="guide", speed="v", inertia=2.0)
    >>> effect = library.dry_friction(guide, scale=0.5, speed=1e-3)
    >>> effect.name, effect.unit
    ('dry friction guide', 'N')
    """
    return on(
        c,
        "dry friction",
        unit=c.unit,
        scale=scale,
        sign=1,
        mechanism="A force of constant magnitude acts against the motion.",
        shapes=(0.003 * speed, 0.03 * speed),
        shape_names=(f"threshold speed [{c.travel_unit}/s]",),
        remedy="Add the friction, or clean and lubricate the guide.",
        rate=force_law(c, lambda q, v, v0: np.tanh(v / v0)),
    )


def dry_friction_asymmetry(c: Part, *, scale: float, speed: float) -> Effect:
    """Coulomb friction that differs between the directions: ``F = F_a |tanh(v / v_0)|``.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Difference of the friction forces that one would expect [N or N m].
    speed
        Typical speed, from which values of the threshold speed follow.
    """
    return on(
        c,
        "one-sided friction",
        unit=c.unit,
        scale=scale,
        mechanism="Dry friction is stronger in one direction than in the other.",
        shapes=(0.003 * speed, 0.03 * speed),
        shape_names=(f"threshold speed [{c.travel_unit}/s]",),
        remedy="Use two levels of dry friction.",
        rate=force_law(c, lambda q, v, v0: np.abs(np.tanh(v / v0))),
    )


def dry_friction_each_way(c: Part, *, scale: float, speed: float) -> Effect:
    """Coulomb friction with another size in each direction, as one law.

    The shape is (side, share, v_0): a motion of the sign of the side meets the magnitude, and one
    of the other sign this share of it.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Larger friction force that one would expect [N or N m].
    speed
        Typical speed, from which the threshold speed follows.
    """

    def law(q: Any, v: Any, shape: Any) -> Any:
        side, share, v0 = shape
        slip = np.tanh(v / v0)
        return np.where(side * v > 0.0, slip, share * slip)

    return on(
        c,
        "dry friction of each direction",
        unit=c.unit,
        scale=scale,
        sign=1,
        mechanism="Dry friction has another size in each direction.",
        shapes=tuple(
            (side, share, slow * speed)
            for side in (1.0, -1.0)
            for share, slow in ((0.2, 0.03), (0.5, 0.003))
        ),
        shape_names=(
            "side",
            "share in the other direction",
            f"threshold speed [{c.travel_unit}/s]",
        ),
        remedy="Use two levels of dry friction.",
        rate=force_law(c, law),
    )


def dry_friction_along(c: Part, *, scale: float, speed: float) -> Effect:
    """Coulomb friction that changes along the travel: F = f q tanh(v / v_0).

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Change of the friction force with the position that one would expect [N/m or N m/rad].
    speed
        Typical speed, from which the threshold speed follows.
    """
    return on(
        c,
        "friction along the travel",
        unit=product((c.unit, 1), (c.travel_unit, -1)),
        scale=scale,
        mechanism="Dry friction changes along the guide.",
        shapes=(0.01 * speed,),
        shape_names=(f"threshold speed [{c.travel_unit}/s]",),
        remedy="Use a friction that depends on the position, or clean and align the guide.",
        rate=force_law(c, lambda q, v, v0: q * np.tanh(v / v0)),
    )


def load_friction(
    c: Part, load: str, *, speed: float, force: Callable[..., Any] | None = None
) -> Effect:
    """Coulomb friction in proportion to a transmitted load: ``F = mu |load| tanh(v / v_0)``.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    load
        Input of the model in the unit of the coordinate: the force or torque that a gear transmits.
    speed
        Typical speed, from which values of the threshold speed follow.
    force
        The load as a function (t, x, u, p) of the model; None: it is the input.
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, v0: Any) -> Mapping[str, Array]:
        _, v = c.motion(x)
        carried = force(t, x, u, p) if force else u[load]
        return c.push(-size * np.abs(carried) * np.tanh(v / v0), t, x, u, p)

    return on(
        c,
        f"friction by {load}",
        scale=0.05,
        sign=1,
        mechanism=f"Friction grows with the load {load} that is transmitted.",
        shapes=(0.003 * speed, 0.03 * speed),
        shape_names=(f"threshold speed [{c.travel_unit}/s]",),
        remedy="Use a friction in proportion to the load (the efficiency of a gear).",
        rate=rate,
    )


def static_friction(c: Part, *, scale: float, speed: float) -> Effect:
    """Stribeck excess at low speed: F = F_s exp(-(v / v_s)^2) tanh(v / v_0).

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Excess of the static friction that one would expect [N or N m].
    speed
        Typical speed, from which values of the Stribeck speed follow.
    """
    return on(
        c,
        "Stribeck friction",
        unit=c.unit,
        scale=scale,
        sign=1,
        mechanism="Friction is larger at low speed than in full motion.",
        shapes=((0.05 * speed, 0.003 * speed), (0.3 * speed, 0.01 * speed)),
        shape_names=(
            f"Stribeck speed [{c.travel_unit}/s]",
            f"threshold speed [{c.travel_unit}/s]",
        ),
        remedy="Add the Stribeck term, or change the lubricant.",
        rate=force_law(c, lambda q, v, s: np.exp(-((v / s[0]) ** 2)) * np.tanh(v / s[1])),
    )


def viscous_friction(c: Part, *, scale: float) -> Effect:
    """F = d v."""
    return on(
        c,
        "viscous friction",
        unit=product((c.unit, 1), ("s", 1), (c.travel_unit, -1)),
        scale=scale,
        mechanism="A force in proportion to the speed acts against the motion.",
        remedy="Add the damping.",
        rate=force_law(c, lambda q, v, s: v),
    )


def quadratic_friction(c: Part, *, scale: float) -> Effect:
    """``F = c v |v|``: drag of air or of a turbulent fluid."""
    return on(
        c,
        "quadratic friction",
        unit=product((c.unit, 1), ("s", 2), (c.travel_unit, -2)),
        scale=scale,
        sign=1,
        mechanism="Drag grows with the square of the speed.",
        remedy="Add the drag.",
        rate=force_law(c, lambda q, v, s: v * np.abs(v)),
    )


def polynomial_stiffness(c: Part, power: int, *, scale: float) -> Effect:
    """F = k_n q^n; n = 2: asymmetric spring; n = 3: hardening (k_n > 0) or softening spring.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    power
        Power of the displacement.
    scale
        Coefficient that one would expect.

    Examples
    --------
    A spring that hardens with the cube of its deflection:

    >>> from unmodeled import Coordinate, library
    >>> spring = Coordinate(name="spring", position="x", speed="v", inertia=2.0)
    >>> effect = library.polynomial_stiffness(spring, 3, scale=1e4)
    >>> effect.name, effect.unit
    ('cubic stiffness spring', 'N/m^3')
    """
    name = {1: "linear", 2: "quadratic", 3: "cubic", 5: "quintic"}.get(power, f"power-{power}")
    return on(
        c,
        f"{name} stiffness",
        unit=product((c.unit, 1), (c.travel_unit, -power)),
        scale=scale,
        mechanism=f"The spring has a part that grows with the power {power} of the displacement.",
        remedy="Use the nonlinear characteristic of the spring.",
        rate=force_law(c, lambda q, v, s: q**power),
    )


def backlash(c: Part, *, stiffness: float, travel: float) -> Effect:
    """F = -k q within +-b, -k b beyond: a stiffness k of the model that is missing within +-b.

    The magnitude is k, the shape b.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    stiffness
        Stiffness of the model outside the dead zone, of which a part may be missing within it
        [N/m or N m/rad].
    travel
        Typical displacement, from which values of b follow.

    Examples
    --------
    Play of a linkage of 100 N/m that moves by about 2 mm:

    >>> from unmodeled import Coordinate, library
    >>> rod = Coordinate(name="rod", position="x", speed="v", inertia=2.0)
    >>> library.backlash(rod, stiffness=100.0, travel=2e-3).shape_names
    ('half width [m]',)
    """
    return on(
        c,
        "dead zone",
        "backlash" if isinstance(c, Coupling) else "a dead zone",
        unit=product((c.unit, 1), (c.travel_unit, -1)),
        scale=0.3 * stiffness,
        sign=1,
        mechanism="Within a clearance this stiffness of the model does not act.",
        shapes=tuple(travel * f for f in (0.03, 0.1, 0.3)),
        shape_names=(f"half width [{c.travel_unit}]",),
        remedy="Model the clearance, or close it.",
        rate=force_law(c, lambda q, v, b: -np.clip(q, -b, b)),
    )


def end_stop(c: Part, *, stiffness: float, travel: float) -> Effect:
    """A stop at one end of the travel: F = k max(q - b, 0), or its mirror image.

    The shape is (side, b): +1 is a stop at q = b, -1 a stop at q = -b.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    stiffness
        Stiffness of the stop that one would expect [N/m or N m/rad].
    travel
        Typical displacement, from which positions of the stop follow.
    """

    def law(q: Any, v: Any, shape: Any) -> Any:
        side, level = shape
        return side * np.maximum(side * q - level, 0.0)

    return on(
        c,
        "end stop",
        "an end stop",
        unit=product((c.unit, 1), (c.travel_unit, -1)),
        scale=stiffness,
        sign=1,
        mechanism="At one end of the travel a further spring is met.",
        shapes=tuple((side, travel * f) for side in (1.0, -1.0) for f in (0.3, 0.7)),
        shape_names=("side", f"level [{c.travel_unit}]"),
        remedy="Model the stop.",
        rate=force_law(c, law),
    )


#: Largest deflection of a slip, in that of full slip: above 1, where rounding takes it, the slip
#: is faster than the motion and brings it back, so that the law is smooth there.
BEYOND = 1.2


def hysteresis(c: Part, *, scale: float, travel: float) -> Effect:
    """Rate-independent hysteresis: a spring in series with a slip z (hidden state).

    The force is F = F_h (q - z) / b. While the deflection ``|q - z|`` grows, the slip takes the
    share ``|(q - z) / b|^n`` of the motion. While it shrinks, z is constant. This is the law of
    Bouc (1967) and Wen (1976) with beta = gamma. The shape is (b, n): the deflection [position
    unit] of full slip, and the sharpness of its onset. n = 10 is nearly elastic-plastic (Jenkins),
    n = 2 is round; n = 1 with a small b approximates pre-sliding friction (Dahl 1968).

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Hysteretic force that one would expect [N or N m].
    travel
        Typical displacement, from which values of the yield displacement follow.
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        b, n = shape
        q, v = c.motion(x)
        deflection = (q - x["hysteresis.slip"]) / b
        force = -size * np.clip(deflection, -BEYOND, BEYOND)
        return {
            **c.push(force, t, x, u, p),
            "hysteresis.slip": _slip_rate(deflection, v, n),
        }

    return on(
        c,
        "hysteresis",
        unit=c.unit,
        scale=scale,
        sign=1,
        kind="state",
        mechanism="Force depends on the direction of the last reversal, not on the speed.",
        shapes=tuple((travel * f, n) for f in (0.03, 0.2) for n in (2.0, 10.0)),
        shape_names=(f"stretch [{c.travel_unit}]", "sharpness"),
        remedy="Use a law with memory.",
        hidden=(State(name="hysteresis.slip", hidden=True, scale=travel, start_sd=0.3 * travel),),
        rate=rate,
    )


def _slip_rate(deflection: Any, v: Any, n: float) -> Any:
    """Rate of a slip: the share ``|deflection|^n`` of the speed while the deflection grows."""
    share = np.minimum(np.abs(deflection), BEYOND) ** n
    return np.where(deflection * v > 0.0, share, 0.0) * v


def damper_clearance(c: Part, *, damping: float, travel: float) -> Effect:
    """A clearance in the mount of a damper: its force d v acts only after the clearance is passed.

    The damper moves with the speed dz/dt of the slip z of :func:`hysteresis` with a sharp onset, so
    that the share s of d (v - dz/dt) is missing; s = 1 is a damper that is mounted with this
    clearance alone. The shapes are half the clearance b.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    damping
        Damping d that the model has [N s/m or N m s/rad].
    travel
        Typical displacement, from which values of b follow.
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, b: Any) -> Mapping[str, Array]:
        q, v = c.motion(x)
        slip = _slip_rate((q - x["clearance.slip"]) / b, v, CLEARANCE_SHARPNESS)
        return {**c.push(size * damping * (v - slip), t, x, u, p), "clearance.slip": slip}

    return on(
        c,
        "clearance of damper",
        "a clearance of the damper",
        unit="1",
        scale=0.5,
        sign=1,
        upper=2.0,  # the damping of the model may be wrong as well
        kind="state",
        mechanism="After each reversal the damper acts only once its clearance is passed.",
        shapes=tuple(travel * f for f in (0.03, 0.2)),
        shape_names=(f"half clearance [{c.travel_unit}]",),
        remedy="Close the clearance of the mount, or model it.",
        hidden=(State(name="clearance.slip", hidden=True, scale=travel, start_sd=0.3 * travel),),
        rate=rate,
    )


def creep(c: Part, *, scale: float, travel: float, times: Sequence[float]) -> Effect:
    """A Maxwell branch: F = k (q - z), dz/dt = (q - z) / tau.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Stiffness of the branch that one would expect [N/m or N m/rad].
    travel
        Travel [m or rad] of the coordinate, within which the branch begins a record.
    times
        Relaxation times that are tried [s].
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, tau: Any) -> Mapping[str, Array]:
        stretch = c.motion(x)[0] - x["creep.stretch"]
        return {**c.push(-size * stretch, t, x, u, p), "creep.stretch": stretch / tau}

    return on(
        c,
        "creep",
        unit=product((c.unit, 1), (c.travel_unit, -1)),
        scale=scale,
        sign=1,
        kind="state",
        mechanism="The spring relaxes with time.",
        shapes=tuple(times),
        shape_names=("time [s]",),
        remedy="Add a relaxing branch.",
        hidden=(State(name="creep.stretch", hidden=True, scale=travel, start_sd=travel),),
        rate=rate,
    )


def offset_force(c: Part, *, scale: float) -> Effect:
    """A constant force: gravity, preload, offset of the drive."""
    return on(
        c,
        "constant force",
        "a constant force",
        unit=c.unit,
        scale=scale,
        mechanism="A constant force acts that the model lacks.",
        remedy="Add the force; look for gravity, preload or an offset of the drive.",
        rate=force_law(c, lambda q, v, s: -np.ones_like(v)),
    )


Maker = Callable[[Part, Scales], Effect]
#: Force effects of a speed whose position the model does not have, such as that of a motor.
FOR_SPEED: tuple[Maker, ...] = (
    lambda c, s: dry_friction(c, scale=0.1 * s.force, speed=s.speed),
    lambda c, s: dry_friction_asymmetry(c, scale=0.1 * s.force, speed=s.speed),
    lambda c, s: static_friction(c, scale=0.1 * s.force, speed=s.speed),
    lambda c, s: viscous_friction(c, scale=0.1 * s.force / s.speed),
    lambda c, s: quadratic_friction(c, scale=0.1 * s.force / s.speed**2),
    lambda c, s: offset_force(c, scale=0.1 * s.force),
)
#: Force effects of a coordinate, made from its typical force, travel, speed and time.
FOR_COORDINATE: tuple[Maker, ...] = (
    *FOR_SPEED,
    lambda c, s: polynomial_stiffness(c, 1, scale=0.1 * s.force / s.travel),
    lambda c, s: polynomial_stiffness(c, 2, scale=0.1 * s.force / s.travel**2),
    lambda c, s: polynomial_stiffness(c, 3, scale=0.1 * s.force / s.travel**3),
    lambda c, s: backlash(c, stiffness=s.force / s.travel, travel=s.travel),
    lambda c, s: end_stop(c, stiffness=0.3 * s.force / s.travel, travel=s.travel),
    lambda c, s: hysteresis(c, scale=0.1 * s.force, travel=s.travel),
    lambda c, s: creep(
        c, scale=0.1 * s.force / s.travel, travel=s.travel, times=(0.3 * s.time, 3.0 * s.time)
    ),
)


# ------------------------------------------------------------------------------- units of products


_TOKEN = re.compile(r"^([^\d^][^^]*?)(?:\^?(-?\d+(?:\.\d+)?))?$")


def product(*powers: tuple[str, float]) -> str:
    """Unit of a product of units with powers, for example ``s/rad`` -> 1/s.

    Each base unit appears once.

    A text that is not a unit is kept unchanged.
    """
    exponents: dict[str, float] = {}
    for unit, power in powers:
        for sign, part in zip((1.0, -1.0), unit.split("/", 1), strict=False):
            for token in part.replace("/", " ").replace("*", " ").split():
                if token == "1":
                    continue
                match = _TOKEN.match(token)
                name, own = (match[1], float(match[2] or 1.0)) if match else (token, 1.0)
                exponents[name] = exponents.get(name, 0.0) + sign * power * own
    above = [_raised(n, e) for n, e in exponents.items() if e > 0.0]
    below = [_raised(n, -e) for n, e in exponents.items() if e < 0.0]
    text = " ".join(above) or "1"
    return f"{text}/{' '.join(below)}" if below else text


def _raised(name: str, exponent: float) -> str:
    return name if exponent == 1.0 else f"{name}^{exponent:g}"


@functools.cache
def makers(table: str = "FOR_COORDINATE") -> tuple[Maker, ...]:
    """Functions that make the effects of a coordinate: every such table of this folder."""
    found: list[Maker] = []
    for module in sorted(info.name for info in pkgutil.iter_modules([str(Path(__file__).parent)])):
        found += getattr(importlib.import_module(f"{__package__}.{module}"), table, ())
    return tuple(found)
