"""Schema of mechanism files: permitted entries with their units and ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from feltmb import _core
from feltmb.contact.layer import LayerParameters
from feltmb.contact.tables import to_core, with_fields, with_laws, with_numbers
from feltmb.quantities import SI, SIVector
from unmodeled.units.quantity import Schema, parse_scalar


def _drop_meta(node: object) -> object:
    """Remove the source, status and note of a table."""
    if not isinstance(node, Mapping):
        return node
    return {k: v for k, v in node.items() if k not in ("source", "status", "note", "printed")}


class _FromCore(Schema):
    """A table with the numbers of a structure of the core, see :func:`with_numbers`."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """The numbers of the structure."""


@with_numbers(_core.Friction)
class FrictionParameters(_FromCore):
    """Friction of a joint or a contact: the terms of ``contact/friction.hpp``."""

    @property
    def core(self) -> _core.Friction:
        """The friction as an object of the core."""
        return to_core(_core.Friction, self)


Friction = Annotated[FrictionParameters, BeforeValidator(_drop_meta)]


class Body(Schema):
    """A rigid body or a uniform beam, and the joint to its parent."""

    label: str = ""
    note: str = ""
    kind: Literal["rigid", "beam"] = "rigid"
    parent: str = "ground"
    joint: Literal["revolute", "prismatic", "weld"] = "revolute"
    coordinate: str = ""
    position: Annotated[tuple[float, float], SIVector("m")] = (0.0, 0.0)
    axis: Annotated[tuple[float, float], SIVector("1")] = (0.0, 1.0)
    angle: Annotated[float, SI("rad")] = 0.0
    friction: Friction = FrictionParameters()
    mass: Annotated[float, SI("kg"), Field(ge=0)] = 0.0
    center_of_mass: Annotated[tuple[float, float], SIVector("m")] = (0.0, 0.0)
    inertia: Annotated[float, SI("kg m^2"), Field(ge=0)] = 0.0
    rigid: bool = True
    length: Annotated[float, SI("m"), Field(gt=0)] | None = None
    density: Annotated[float, SI("kg/m^3"), Field(gt=0)] | None = None
    area: Annotated[float, SI("m^2"), Field(gt=0)] | None = None
    young_modulus: Annotated[float, SI("Pa"), Field(gt=0)] | None = None
    second_moment: Annotated[float, SI("m^4"), Field(gt=0)] | None = None
    shapes: Literal["polynomial", "clamped_free", "craig_bampton"] = "polynomial"
    axial_shapes: Annotated[int, Field(ge=0, le=12)] = 1
    lateral_shapes: Annotated[int, Field(ge=1, le=12)] = 2
    damping_time: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    condense_axial: bool = True


class Lead(Schema):
    """A small mass in a body, such as a lead in a key; the body then has both masses."""

    label: str = ""
    note: str = ""
    body: str = ""
    """Default: the body that the finger presses."""
    mass: Annotated[float, SI("kg"), Field(gt=0)]
    position: Annotated[float, SI("m")]
    """Along the x axis of the body: for a key, from the balance rail toward the player."""
    height: Annotated[float, SI("m")] | None = None
    """Along the y axis; default: that of the center of mass of the body."""


class Bushing(Schema):
    """Cloth or wood around the pin that guides a body: dry friction by what presses on the pin.

    Two sides hold the pin, each with half of the tightness. A side force loads one side and unloads
    the other, so that the friction only grows when it exceeds the tightness. It adds to the
    amplitude of the joint's friction, which has the bushing as it is fitted.
    """

    label: str = ""
    note: str = ""
    body: str
    arm: Annotated[float, SI("m"), Field(gt=0)] | None = None
    """Distance of the pin from a revolute joint; none: the joint is prismatic."""
    coefficient: Annotated[float, SI("1"), Field(ge=0)] = 0.2
    tightness: Annotated[float, SI("N"), Field(ge=0)] = 0.0
    side_force: Annotated[float, SI("N")] = 0.0
    swollen: Annotated[float, SI("N"), Field(gt=0)] = 1.0
    """Tightness that one expects to meet in damp air; ``feltmb wear`` changes it by this much."""

    @property
    def friction(self) -> float:
        """Friction at the joint [N m or N]."""
        return self.coefficient * max(self.tightness, abs(self.side_force)) * (self.arm or 1.0)


class Screw(Schema):
    """A screw, spring or wire that a technician turns or bends: a value of the file by its name."""

    label: str = ""
    note: str = ""
    path: str
    direction: Annotated[tuple[float, float], SIVector("1")] | None = None
    """Direction in which a point moves; none: the value is a number, such as an angle."""
    pitch: Annotated[float, SI("m"), Field(gt=0)] | None = None
    """Travel of a full turn; none: not a thread."""
    words: tuple[str, str] = ("more", "less")
    """What + and - are called, such as up and down."""


class Surface(Schema):
    """A contact surface fixed to a body."""

    label: str = ""
    body: str
    kind: Literal["line", "circle", "concave", "hybrid", "segment", "concave_arc"]
    point: Annotated[tuple[float, float], SIVector("m")]
    end: Annotated[tuple[float, float], SIVector("m")] | None = None
    normal: Annotated[tuple[float, float], SIVector("1")] | None = None
    radius: Annotated[float, SI("m"), Field(ge=0)] | None = None
    arc: Annotated[tuple[float, float], SIVector("rad")] | None = None
    note: str = ""


@with_laws(micromechanical=(LayerParameters | None, None))
class LawChoice(Schema):
    """A contact law with the parameters of all available laws."""

    if TYPE_CHECKING:
        law: str

        def __getattr__(self, name: str) -> Any:
            """The entries of the laws: see :mod:`feltmb.contact.tables`."""


class Contact(LawChoice):
    """Two surfaces, a law and friction."""

    label: str = ""
    note: str = ""
    surfaces: tuple[str, str]
    enabled: bool = True
    friction: Friction = FrictionParameters()


@with_numbers(_core.TorsionSpringDescription, needed=("stiffness", "rest_angle"))
class Spring(_FromCore):
    """Spring on the coordinate of a joint, with optional damping and play."""

    label: str = ""
    coordinate: str
    enabled: bool = True


@with_numbers(_core.DashpotDescription, needed=("coefficient",))
class Dashpot(_FromCore):
    """Dashpot on a joint's coordinate, optionally for one direction of motion only."""

    label: str = ""
    coordinate: str
    side: Literal["both", "positive", "negative"] = "both"
    enabled: bool = True


class Strap(Schema):
    """One-sided cubic strap, thesis eq. 4.5."""

    label: str = ""
    body_a: str
    point_a: Annotated[tuple[float, float], SIVector("m")]
    body_b: str
    point_b: Annotated[tuple[float, float], SIVector("m")]
    free_length: Annotated[float, SI("m"), Field(gt=0)]
    k1: Annotated[float, SI("N/m")] = 0.0
    k2: Annotated[float, SI("N/m^2")] = 0.0
    k3: Annotated[float, SI("N/m^3")] = 0.0
    enabled: bool = True


def _strike_point(node: object) -> object:
    return node if node == "moving" else parse_scalar(node, "m")


@with_numbers(_core.StringParameters)
class String(_FromCore):
    """Stiff string of thesis Table 4.1, or several equal ones (unisons) that are struck together.

    ``diameter``, ``tension``, ``linear_density`` and ``young_modulus`` are values of one string.
    ``count`` strings share the contact force equally and move alike: the striker acts against
    ``count`` times the impedance of one string, at the same frequencies and mode shapes. The law of
    the contact, the largest string force, the force on the bridge and the energy are totals of all
    strings. Every contact with ``surface`` or one of ``other_surfaces`` touches the string, each at
    its own position.
    """

    kind: Literal["modal", "rigid_stop"] = "modal"
    surface: str
    other_surfaces: list[str] = []
    anchor: Annotated[float, SI("m"), Field(ge=0)] = 0.0
    direction: Annotated[tuple[float, float], SIVector("1")] = (0.0, -1.0)
    strike_point: Annotated[Literal["moving"] | float, BeforeValidator(_strike_point)] = "moving"
    note: str = ""


@with_fields("hunt_crossley")
class Pad(Schema):
    """Finger pad between a prescribed finger motion and the key."""

    law: Literal["hunt_crossley"] = "hunt_crossley"

    @property
    def hunt_crossley(self) -> Pad:
        """The pad as a table of its law."""
        return self


class Finger(Schema):
    """Point at which the player's finger acts on the mechanism."""

    body: str
    point: Annotated[tuple[float, float], SIVector("m")]
    direction: Annotated[tuple[float, float], SIVector("1")] = (0.0, -1.0)
    pad: Pad = Pad.model_validate({"stiffness": 1.1e5, "exponent": 1.5, "damping": 1.0})


class Motor(Schema):
    """A motor on a revolute joint, which drives the mechanism instead of a finger."""

    coordinate: str
    contact: int | None = None
    note: str = ""


class Point(Schema):
    """Tracking point."""

    body: str
    point: Annotated[tuple[float, float], SIVector("m")]
    label: str = ""


def _way(direction: tuple[float, float]) -> tuple[float, float]:
    """A direction as a vector of any length > 0, which is normalized."""
    length = math.hypot(*direction)
    if not 1e-6 <= length <= 1e6:
        raise ValueError(
            f"got {list(direction)!r} of length {length:g}, expected a length of 1e-6 to 1e6"
        )
    return direction


class NamedEvent(Schema):
    """A named event: a contact change, or a tracking point that reaches a travel."""

    label: str = ""
    contact: int | list[int] | None = None
    change: Literal["opens", "closes"] | None = None
    point: str | None = None
    direction: Annotated[tuple[float, float], SIVector("1"), AfterValidator(_way)] = (0.0, 1.0)
    travel: Annotated[float, SI("m"), Field(gt=0)] | None = None
    which: Literal["first", "last"] = "first"
    before: str | None = None
    after: str | None = None
    unless: str | None = None
    within: Annotated[float, SI("s"), Field(gt=0)] | None = None


class SummaryRow(Schema):
    """A value of ``run.summary``: from an output, or a time.

    A value of an output is its value ``at`` an event, or the ``largest``, ``smallest``, ``mean`` or
    ``range`` of its samples between the events ``after`` and ``before``, or of all samples. A time
    is the time of the event ``at``, or the time ``between`` two events. If a required event did not
    happen, the run does not have the value.
    """

    text: str = ""
    output: str | None = None
    take: Literal["largest", "smallest", "mean", "range"] | None = None
    at: str | None = None
    after: str | None = None
    before: str | None = None
    between: tuple[str, str] | None = None


class ViewCurve(Schema):
    """An output in a view, multiplied by ``factor``."""

    output: str
    label: str = ""
    factor: float = 1.0


class View(Schema):
    """A panel of plots and of the viewer; ``change``: relative to the start of the run."""

    title: str = ""
    change: bool = False
    curves: list[str | ViewCurve]

    @property
    def rows(self) -> list[ViewCurve]:
        """The curves; a curve given by a name alone has only an output."""
        return [ViewCurve(output=c) if isinstance(c, str) else c for c in self.curves]


class Striker(Schema):
    """Point that strikes, and its direction."""

    point: str
    direction: Annotated[tuple[float, float], SIVector("1"), AfterValidator(_way)]
    label: str = ""

    @property
    def axis(self) -> str:
        """The coordinate with the largest share of the motion, ``x`` or ``y``."""
        x, y = self.direction
        return "x" if abs(x) >= abs(y) else "y"


class TouchEvents(Schema):
    """Names of the events by which the touch of an action is measured."""

    start: str | None = None
    """The key starts to move."""
    landing: str | None = None
    """The key reaches its end of travel."""
    toe: str | None = None
    """The jack meets the part that causes the let-off."""
    damper: str | None = None
    """The key meets the damper."""


class WeighedParts(Schema):
    """Parts of which a technician weighs the effect on the key."""

    hammer: str
    """Body that the hammer turns with."""
    whippen: str
    capstan: str
    """Surface of the key that lifts the whippen."""


class Reading(Schema):
    """Interpretation of a run: roles of contacts, points and events; values; views."""

    strike_contact: int | None = None
    let_off_contact: int | None = None
    check_contacts: list[int] = []
    key_point: str | None = None
    touch: TouchEvents = TouchEvents()
    striker: Striker | None = None
    weights: WeighedParts | None = None
    rows: dict[str, SummaryRow] = {}
    views: dict[str, View] = {}


class Source(Schema):
    """Source of a data set."""

    cite: str = ""
    status: str = ""
    note: str = ""


class MechanismFile(Schema):
    """A mechanism file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    about: str = ""
    source: Source = Source()
    gravity: Annotated[tuple[float, float], SIVector("m/s^2")] = (0.0, -9.81)
    bodies: dict[str, Body]
    leads: dict[str, Lead] = {}
    bushings: dict[str, Bushing] = {}
    surfaces: dict[str, Surface] = {}
    contacts: dict[str, Contact] = {}
    springs: dict[str, Spring] = {}
    dashpots: dict[str, Dashpot] = {}
    straps: dict[str, Strap] = {}
    string: String | None = None
    finger: Finger | None = None
    motor: Motor | None = None
    points: dict[str, Point] = {}
    screws: dict[str, Screw] = {}
    start_pose: dict[str, float] = {}
    events: dict[str, NamedEvent] = {}
    reading: Reading = Reading()
