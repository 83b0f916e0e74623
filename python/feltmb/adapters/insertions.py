"""Parts that an effect adds to a mechanism: compliant pivots, hinges, masses.

At magnitude zero nothing is added, so that the mechanism is exactly the old one. As the magnitude
approaches zero, the stiffness of the added joint becomes infinite, and the motion approaches the
old one linearly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from feltmb.errors import InvalidParameter
from feltmb.mechanism import Body, FrictionParameters, MechanismFile, Spring

__all__ = ["Insertion", "insert"]

Kind = Literal["clearance", "compliance", "hinge", "mass", "bending"]


@dataclass(frozen=True, kw_only=True)
class Insertion:
    """Type and place of an added part."""

    kind: Kind
    """Type of the part; ``size`` is its magnitude. ``clearance``: the pivot of a body moves in a
    hole with the clearance ``size`` [m]. ``compliance``: the pivot has the compliance ``size``
    [m/N] in both directions. ``hinge``: the body bends at a point with the compliance ``size``
    [rad/(N m)]. ``mass``: a mass ``size`` [kg] at a point of the body. ``bending``: a rigid beam
    becomes elastic, with ``size`` times the compliance of its tabulated section and modulus [1]."""
    body: str
    damping: float = 20.0
    """Damping of the pivot [N s/m] or hinge [N m s/rad]."""
    seating: float = 0.2
    """Load with which the pin of a clearance is pressed against its wall [N]."""
    point: tuple[float, float] = (0.0, 0.0)
    """Position of the mass or the hinge in the frame of the body [m]."""
    part: str = ""
    """Hinge: name of the part beyond the hinge."""
    carries: tuple[str, ...] = ()
    """Hinge: surfaces and points on the part beyond the hinge; ``finger`` for the finger."""
    share: float = 0.5
    """Hinge: share of the mass beyond it, a uniform slender rod from the hinge to ``end``."""
    end: tuple[float, float] = (0.0, 0.0)
    """Hinge: far end of that rod in the frame of the body [m]."""


_AXIS: dict[str, tuple[float, float]] = {"x": (1.0, 0.0), "y": (0.0, 1.0)}


def insert(config: MechanismFile, insertion: Insertion, magnitude: float) -> MechanismFile:
    """Mechanism with the added part; the old mechanism at magnitude zero.

    Raises
    ------
    InvalidParameter
        The magnitude is negative, or the body is missing or unsuitable.
    """
    if magnitude == 0.0:
        return config
    if magnitude < 0.0 or not math.isfinite(magnitude):
        raise InvalidParameter(
            f"{insertion.kind} of {insertion.body}: magnitude = {magnitude!r}, "
            "expected a finite number >= 0"
        )
    if insertion.body not in config.bodies:
        raise InvalidParameter(f"{insertion.kind}: body {insertion.body!r} is missing")
    if insertion.kind == "mass":
        return _added_mass(config, insertion, magnitude)
    if insertion.kind == "hinge":
        return _hinged(config, insertion, magnitude)
    if insertion.kind == "bending":
        return _bending(config, insertion, magnitude)
    return _loose_pivot(config, insertion, magnitude)


def _bending(config: MechanismFile, insertion: Insertion, magnitude: float) -> MechanismFile:
    name = insertion.body
    body = config.bodies[name]
    if not body.rigid or body.young_modulus is None or body.second_moment is None:
        raise InvalidParameter(
            f"bending of {name}: expected a rigid beam with young_modulus and second_moment"
        )
    bends = {"rigid": False, "young_modulus": body.young_modulus / magnitude}
    bodies = dict(config.bodies) | {name: body.model_copy(update=bends)}
    return config.model_copy(update={"bodies": bodies})


def _loose_pivot(config: MechanismFile, insertion: Insertion, magnitude: float) -> MechanismFile:
    name = insertion.body
    body = config.bodies[name]
    if body.joint != "revolute":
        raise InvalidParameter(f"{insertion.kind} of {name}: its joint is {body.joint}, no pivot")
    bodies: dict[str, Body] = {}
    for key, value in config.bodies.items():
        if key != name:
            bodies[key] = value
            continue
        parent, position = body.parent, body.position
        for axis, direction in _AXIS.items():
            bodies[f"{name}_pin_{axis}"] = Body(
                parent=parent,
                joint="prismatic",
                coordinate=f"{name}.pin.{axis}",
                position=position,
                axis=direction,
                friction=FrictionParameters(threshold_speed=1e-3),
            )
            parent, position = f"{name}_pin_{axis}", (0.0, 0.0)
        bodies[name] = body.model_copy(update={"parent": parent, "position": position})
    springs = dict(config.springs)
    for axis in _AXIS:
        spring: dict[str, Any] = {
            "coordinate": f"{name}.pin.{axis}",
            "rest_angle": 0.0,
            "damping": insertion.damping,
        }
        if insertion.kind == "clearance":
            spring |= {"stiffness": 0.0, "clearance": magnitude, "seating": insertion.seating}
        else:
            spring |= {"stiffness": 1.0 / magnitude}
        springs[f"{name}_pin_{axis}"] = Spring(**spring)
    return config.model_copy(update={"bodies": bodies, "springs": springs})


def _added_mass(config: MechanismFile, insertion: Insertion, magnitude: float) -> MechanismFile:
    rider = Body(parent=insertion.body, joint="weld", position=insertion.point, mass=magnitude)
    return config.model_copy(update={"bodies": {**config.bodies, f"{insertion.body}_rider": rider}})


def _hinged(config: MechanismFile, insertion: Insertion, magnitude: float) -> MechanismFile:
    """Split a body at a point: a stiff, damped hinge connects the two parts."""
    body = config.bodies[insertion.body]
    hinge, end = insertion.point, insertion.end
    mass = insertion.share * body.mass
    center = (0.5 * (hinge[0] + end[0]), 0.5 * (hinge[1] + end[1]))
    length = math.dist(hinge, end)
    inertia = mass * length**2 / 12.0
    rest = body.mass - mass
    if rest <= 0.0:
        raise InvalidParameter(f"hinge of {insertion.body}: nothing is left before it")
    old = body.center_of_mass
    rest_center = (
        (body.mass * old[0] - mass * center[0]) / rest,
        (body.mass * old[1] - mass * center[1]) / rest,
    )
    rest_inertia = (
        body.inertia
        - inertia
        - mass * math.dist(center, old) ** 2
        - rest * math.dist(rest_center, old) ** 2
    )
    if rest_inertia <= 0.0:
        raise InvalidParameter(
            f"hinge of {insertion.body}: the part beyond it takes more than the moment of inertia"
        )
    bodies = dict(config.bodies)
    bodies[insertion.body] = body.model_copy(
        update={"mass": rest, "center_of_mass": rest_center, "inertia": rest_inertia}
    )
    bodies[insertion.part] = Body(
        parent=insertion.body,
        joint="revolute",
        coordinate=f"{insertion.part}.bend",
        position=hinge,
        friction=FrictionParameters(threshold_speed=1e-3),
        mass=mass,
        center_of_mass=(center[0] - hinge[0], center[1] - hinge[1]),
        inertia=inertia,
    )

    def moved(node: Any) -> Any:
        point = (node.point[0] - hinge[0], node.point[1] - hinge[1])
        return node.model_copy(update={"body": insertion.part, "point": point})

    update: dict[str, Any] = {"bodies": bodies}
    for table in ("surfaces", "points"):
        entries = getattr(config, table)
        update[table] = {
            name: moved(node) if name in insertion.carries and node.body == insertion.body else node
            for name, node in entries.items()
        }
    if "finger" in insertion.carries and config.finger is not None:
        update["finger"] = moved(config.finger)
    update["springs"] = {
        **config.springs,
        f"{insertion.part}_bend": Spring(
            coordinate=f"{insertion.part}.bend",
            rest_angle=0.0,
            stiffness=1.0 / magnitude,
            damping=insertion.damping,
        ),
    }
    return config.model_copy(update=update)
