"""Converts a validated mechanism file to the plain description that the core assembles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from feltmb import _core
from feltmb.contact import Law
from feltmb.contact.tables import make_core, to_core
from feltmb.mechanism.schema import (
    Body,
    Contact,
    Dashpot,
    LawChoice,
    MechanismFile,
    Pad,
    Point,
    Spring,
    Strap,
    String,
    Surface,
)
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter


def with_leads(config: MechanismFile, name: str) -> Body:
    """A body with the mass that its leads, and the friction that its bushings give it."""
    body = config.bodies[name]
    friction = sum(b.friction for b in config.bushings.values() if b.body == name)
    if friction:
        own = body.friction
        own = own.model_copy(update={"amplitude": own.amplitude + friction})
        body = body.model_copy(update={"friction": own})
    default = config.finger.body if config.finger is not None else ""
    leads = [lead for lead in config.leads.values() if (lead.body or default) == name]
    if not leads or body.kind == "beam":
        return body
    y = body.center_of_mass[1]
    parts = [(body.mass, body.center_of_mass)]
    parts += [(i.mass, (i.position, y if i.height is None else i.height)) for i in leads]
    mass = sum(m for m, _ in parts)
    center = (sum(m * at[0] for m, at in parts) / mass, sum(m * at[1] for m, at in parts) / mass)
    inertia = body.inertia + sum(m * math.dist(at, center) ** 2 for m, at in parts)
    return body.model_copy(update={"mass": mass, "center_of_mass": center, "inertia": inertia})


@checked
def core_law(contact: LawChoice | Pad | Law | _core.ContactLaw) -> _core.ContactLaw:
    """Law of a contact for the core; one that is made already as it is."""
    if isinstance(contact, Law):
        return contact.core
    if isinstance(contact, _core.ContactLaw):
        return contact
    if isinstance(contact, Pad) or contact.law != "micromechanical":
        return make_core(contact.law, contact)
    layer = contact.micromechanical
    return _core.ContactLaw("felt_memory", envelope=layer.envelope, **layer.numbers)


def _core_body(name: str, b: Body) -> _core.BodyDescription:
    known: dict[str, Any] = {"name": name, "friction": b.friction.core}
    if b.kind == "beam":
        # A rigid uniform rod: slender, without the rotary inertia of its section.
        assert b.length is not None
        assert b.density is not None
        assert b.area is not None
        linear_density = b.density * b.area
        if b.rigid:
            mass = linear_density * b.length
            inertia = mass * b.length**2 / 12.0
            known |= {"mass": mass, "center_of_mass": (0.5 * b.length, 0.0), "inertia": inertia}
        else:
            assert b.young_modulus is not None
            assert b.second_moment is not None
            known["beam"] = to_core(
                _core.BeamDescription,
                b,
                linear_density=linear_density,
                axial_stiffness=b.young_modulus * b.area,
                bending_stiffness=b.young_modulus * b.second_moment,
            )
    return to_core(_core.BodyDescription, b, **known)


def _core_string(s: String) -> _core.StringDescription:
    moving = s.strike_point == "moving"
    return to_core(
        _core.StringDescription,
        s,
        rigid=s.kind == "rigid_stop",
        parameters=to_core(_core.StringParameters, s),
        moving_strike_point=moving,
        **({} if moving else {"strike_position": s.strike_point}),
    )


def _core_surface(name: str, s: Surface) -> _core.SurfaceDescription:
    return to_core(_core.SurfaceDescription, s, name=name)


def _core_contact(key: str, c: Contact) -> _core.ContactDescription:
    a, b = c.surfaces
    return to_core(
        _core.ContactDescription,
        c,
        number=int(key),
        surface_a=a,
        surface_b=b,
        law=core_law(c),
        friction=c.friction.core,
    )


def _core_spring(name: str, s: Spring) -> _core.TorsionSpringDescription:
    return to_core(_core.TorsionSpringDescription, s, name=name)


def _core_dashpot(name: str, s: Dashpot) -> _core.DashpotDescription:
    side = {"both": 0, "positive": 1, "negative": -1}[s.side]
    return to_core(_core.DashpotDescription, s, name=name, side=side)


def _core_strap(name: str, s: Strap) -> _core.StrapDescription:
    return to_core(_core.StrapDescription, s, name=name, coefficients=(s.k1, s.k2, s.k3))


def _core_point(name: str, p: Point) -> _core.TrackingPointDescription:
    return to_core(_core.TrackingPointDescription, p, name=name)


@checked
def describe(
    config: MechanismFile, known: dict[Any, Any] | None = None
) -> _core.MechanismDescription:
    """Plain description of a validated file for the core.

    Parameters
    ----------
    known
        Cache of parts by the identity of the part of the file from which they were made; missing
        parts are added. Files with common parts are then described in a fraction of the time.
    """
    description, faults = describe_with_faults(config, known)
    if faults:
        raise InvalidParameter("\n".join(faults))
    return description


def _made(
    table: Mapping[str, Any],
    make: Callable[[str, Any], Any],
    known: dict[int, tuple[Any, Any]] | None,
) -> Iterator[Any]:
    """What is made from each item of a table; ``known``: what was made from the same item."""
    for name, node in table.items():
        made = None if known is None else known.get(id(node), (None, None))[1]
        if made is None:
            made = make(name, node)
            if known is not None and made is not None:
                known[id(node)] = (node, made)
        yield made


def describe_with_faults(
    config: MechanismFile, known: dict[int, tuple[Any, Any]] | None = None
) -> tuple[_core.MechanismDescription, list[str]]:
    """Description without the contacts with invalid laws, and the faults of these laws."""

    def each(table: Mapping[str, Any], make: Callable[[str, Any], Any]) -> list[Any]:
        return [made for made in _made(table, make, known) if made is not None]

    def enabled(table: Mapping[str, Any]) -> dict[str, Any]:
        return {name: node for name, node in table.items() if node.enabled}

    d = _core.MechanismDescription(name=config.name, gravity=config.gravity)
    loaded = {name: with_leads(config, name) for name in config.bodies}
    plain = {name: body for name, body in config.bodies.items() if loaded.get(name, body) is body}
    made = dict(zip(plain, each(plain, _core_body), strict=True))
    d.bodies = [made.get(name) or _core_body(name, loaded[name]) for name in config.bodies]
    d.surfaces = each(config.surfaces, _core_surface)
    faults: list[str] = []

    def contact(key: str, c: Contact) -> Any:
        try:
            return _core_contact(key, c)
        except InvalidParameter as error:
            faults.append(f"contacts.{key}: {error}")
            return None

    d.contacts = each(config.contacts, contact)
    d.springs = each(enabled(config.springs), _core_spring)
    d.dashpots = each(enabled(config.dashpots), _core_dashpot)
    d.straps = each(enabled(config.straps), _core_strap)
    if config.string is not None:
        d.strings = [_core_string(config.string)]
    d.points = each(config.points, _core_point)
    if config.finger is not None:
        d.finger = to_core(_core.FingerDescription, config.finger, pad=core_law(config.finger.pad))
    if config.motor is not None:
        d.motor = to_core(_core.MotorDescription, config.motor)
    d.start_pose = list(config.start_pose.items())
    return d, faults
