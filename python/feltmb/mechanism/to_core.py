"""From a validated mechanism file to the plain description that the core assembles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from feltmb import _core
from feltmb.contact.tables import make_core
from feltmb.errors import InvalidParameter
from feltmb.mechanism.schema import (
    Body,
    Contact,
    Dashpot,
    FrictionParameters,
    LawChoice,
    MechanismFile,
    Pad,
    Point,
    Spring,
    Strap,
    String,
    Surface,
)

__all__ = ["core_friction", "core_law", "describe", "describe_with_faults"]


def core_friction(f: FrictionParameters) -> _core.Friction:
    """Friction of a joint or a contact for the core."""
    return _core.Friction(
        amplitude=f.amplitude,
        b1=f.b1,
        b2=f.b2,
        threshold_speed=f.threshold_speed,
        viscous=f.viscous,
        quadratic=f.quadratic,
        stribeck=f.stribeck,
        stribeck_speed=f.stribeck_speed,
    )


def core_law(contact: LawChoice | Pad) -> _core.ContactLaw:
    """Law of a contact for the core."""
    if isinstance(contact, Pad) or contact.law != "micromechanical":
        return make_core(contact.law, contact)
    layer = contact.micromechanical
    return _core.ContactLaw("felt_memory", envelope=layer.envelope, **layer.numbers)


def _core_body(name: str, b: Body) -> _core.BodyDescription:
    d = _core.BodyDescription()
    d.name = name
    d.parent = b.parent
    d.joint = getattr(_core.JointKind, b.joint)
    d.position = b.position
    d.axis = b.axis
    d.angle = b.angle
    d.coordinate = b.coordinate
    d.friction = core_friction(b.friction)
    d.mass = b.mass
    d.center_of_mass = b.center_of_mass
    d.inertia = b.inertia
    if b.kind == "beam":
        # A rigid uniform rod: slender, the rotary inertia of its section neglected.
        assert b.length is not None
        assert b.density is not None
        assert b.area is not None
        if not b.rigid:
            assert b.young_modulus is not None
            assert b.second_moment is not None
            beam = _core.BeamDescription()
            beam.length = b.length
            beam.linear_density = b.density * b.area
            beam.axial_stiffness = b.young_modulus * b.area
            beam.bending_stiffness = b.young_modulus * b.second_moment
            beam.shapes = getattr(_core.ShapeSet, b.shapes)
            beam.axial_shapes = b.axial_shapes
            beam.lateral_shapes = b.lateral_shapes
            beam.damping_time = b.damping_time
            beam.condense_axial = b.condense_axial
            d.beam = beam
            return d
        d.mass = b.density * b.area * b.length
        d.center_of_mass = (0.5 * b.length, 0.0)
        d.inertia = d.mass * b.length**2 / 12.0
    return d


def _core_string(s: String) -> _core.StringDescription:
    d = _core.StringDescription()
    d.name = "string"
    d.surface = s.surface
    d.other_surfaces = s.other_surfaces
    d.rigid = s.kind == "rigid_stop"
    d.parameters = _core.StringParameters(
        diameter=s.diameter,
        tension=s.tension,
        length=s.length,
        linear_density=s.linear_density,
        young_modulus=s.young_modulus,
        damping_ratio=s.damping_ratio,
        modes=s.modes,
        count=s.count,
    )
    d.anchor = s.anchor
    d.direction = s.direction
    d.moving_strike_point = s.strike_point == "moving"
    if s.strike_point != "moving":
        d.strike_position = float(s.strike_point)
    return d


def _core_surface(name: str, s: Surface) -> _core.SurfaceDescription:
    d = _core.SurfaceDescription()
    d.name = name
    d.body = s.body
    d.kind = getattr(_core.SurfaceKind, s.kind)
    d.point = s.point
    if s.normal is not None:
        d.normal = s.normal
    if s.radius is not None:
        d.radius = s.radius
    if s.arc is not None:
        d.arc = s.arc
    return d


def _core_contact(key: str, c: Contact) -> _core.ContactDescription:
    d = _core.ContactDescription()
    d.number = int(key)
    d.label = c.label
    d.surface_a, d.surface_b = c.surfaces
    d.law = core_law(c)
    d.friction = core_friction(c.friction)
    d.enabled = c.enabled
    return d


def _core_spring(name: str, s: Spring) -> _core.TorsionSpringDescription:
    d = _core.TorsionSpringDescription()
    d.name = name
    d.coordinate = s.coordinate
    d.stiffness = s.stiffness
    d.rest_angle = s.rest_angle
    d.damping = s.damping
    d.clearance = s.clearance
    d.seating = s.seating
    return d


def _core_dashpot(name: str, s: Dashpot) -> _core.DashpotDescription:
    d = _core.DashpotDescription()
    d.name = name
    d.coordinate = s.coordinate
    d.coefficient = s.coefficient
    d.side = {"both": 0, "positive": 1, "negative": -1}[s.side]
    return d


def _core_strap(name: str, s: Strap) -> _core.StrapDescription:
    d = _core.StrapDescription()
    d.name = name
    d.body_a, d.point_a = s.body_a, s.point_a
    d.body_b, d.point_b = s.body_b, s.point_b
    d.free_length = s.free_length
    d.coefficients = (s.k1, s.k2, s.k3)
    return d


def _core_point(name: str, p: Point) -> _core.TrackingPointDescription:
    d = _core.TrackingPointDescription()
    d.name = name
    d.body = p.body
    d.point = p.point
    return d


def describe(
    config: MechanismFile, known: dict[int, tuple[Any, Any]] | None = None
) -> _core.MechanismDescription:
    """Plain description of a validated file for the core.

    Parameters
    ----------
    known
        Parts made before, by the identity of the part of the file that they came from; what is
        missing is added. Files that share parts are then described in a fraction of the time.
    """
    description, faults = describe_with_faults(config, known)
    if faults:
        raise InvalidParameter("\n".join(faults))
    return description


def describe_with_faults(
    config: MechanismFile, known: dict[int, tuple[Any, Any]] | None = None
) -> tuple[_core.MechanismDescription, list[str]]:
    """Description without the contacts whose laws cannot be made, and why they cannot."""

    def each(table: Mapping[str, Any], make: Callable[[str, Any], Any]) -> list[Any]:
        if known is None:
            return [make(name, node) for name, node in table.items()]
        out = []
        for name, node in table.items():
            if id(node) not in known:
                made = make(name, node)
                if made is None:
                    continue
                known[id(node)] = (node, made)
            out.append(known[id(node)][1])
        return out

    d = _core.MechanismDescription()
    d.name = config.name
    d.gravity = config.gravity
    d.bodies = each(config.bodies, _core_body)
    d.surfaces = each(config.surfaces, _core_surface)
    faults: list[str] = []

    def contact(key: str, c: Contact) -> Any:
        try:
            return _core_contact(key, c)
        except InvalidParameter as error:
            faults.append(f"contacts.{key}: {error}")
            return None

    d.contacts = [c for c in each(config.contacts, contact) if c is not None]
    d.springs = each({k: s for k, s in config.springs.items() if s.enabled}, _core_spring)
    d.dashpots = each({k: s for k, s in config.dashpots.items() if s.enabled}, _core_dashpot)
    d.straps = each({k: s for k, s in config.straps.items() if s.enabled}, _core_strap)
    if config.string is not None:
        d.strings = [_core_string(config.string)]
    d.points = each(config.points, _core_point)
    if config.finger is not None:
        fd = _core.FingerDescription()
        fd.body = config.finger.body
        fd.point = config.finger.point
        fd.direction = config.finger.direction
        fd.pad = core_law(config.finger.pad)
        d.finger = fd
    if config.motor is not None:
        md = _core.MotorDescription()
        md.coordinate = config.motor.coordinate
        md.contact = config.motor.contact or 0
        d.motor = md
    d.start_pose = list(config.start_pose.items())
    return d, faults
