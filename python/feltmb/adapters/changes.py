"""Entries of a library: what an effect or a tolerance changes in a mechanism file.

An entry changes values by dotted path, in SI units, without copies of the rest: a value is
multiplied by ``1 + scale * magnitude`` or ``exp(exp * magnitude)``, or ``add * magnitude`` is
added. Several changes of one value are combined: factors are multiplied first, then the summands
are added. Or an entry adds a part, such as a compliant pivot. At magnitude zero, the mechanism is
exactly the old one. As the magnitude approaches zero, the stiffness of an added joint becomes
infinite, and the motion approaches the old one linearly.
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from feltmb.mechanism import Body, FrictionParameters, MechanismFile, Spring
from feltmb.mechanism.numbers import read_entry, replace_entry
from feltmb.quantities import SI, SIVector
from unmodeled.chain import fault_of
from unmodeled.errors import InvalidParameter
from unmodeled.units.quantity import Schema

__all__ = [
    "Change",
    "Chosen",
    "Condition",
    "Configurations",
    "Entry",
    "EntryKeys",
    "InputError",
    "Insertion",
    "Kind",
    "SensorError",
    "Shape",
    "Values",
    "applied",
    "changed_config",
    "insert",
    "same_values",
]

Kind = Literal["force", "kinematic", "state", "parameter", "sensor", "input", "drift"]

#: Directions of the translations of a pivot.
_DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0)}


class Change(Schema):
    """Change of one value of a mechanism file by a magnitude."""

    path: str
    """Dotted path, ``surfaces.Gp10.point.y``; the name of a body stands for ``bodies.NAME``."""
    scale: float = 0.0
    """The value is multiplied by 1 + scale * magnitude [1 / unit of the magnitude]."""
    exp: float = 0.0
    """The value is multiplied by exp(exp * magnitude) [1 / unit of the magnitude]."""
    add: float = 0.0
    """add * magnitude is added to the value [its SI unit / unit of the magnitude]."""

    def factor(self, magnitude: float) -> float:
        """Factor of the value; infinite beyond the largest number."""
        power = self.exp * magnitude
        growth = math.exp(power) if power < math.log(sys.float_info.max) else math.inf
        return (1.0 + self.scale * magnitude) * growth


class Insertion(Schema):
    """Type and place of an added part."""

    kind: Literal["clearance", "compliance", "hinge", "mass", "bending"]
    """Type of the part; ``size`` is its magnitude. ``clearance``: the pivot of a body moves in a
    hole with the clearance ``size`` [m]. ``compliance``: the pivot has the compliance ``size``
    [m/N] in both directions. ``hinge``: the body bends at a point with the compliance ``size``
    [rad/(N m)]. ``mass``: a mass ``size`` [kg] at a point of the body. ``bending``: a rigid beam
    becomes elastic, with ``size`` times the compliance of its tabulated section and modulus [1]."""
    body: str
    damping: float = 20.0
    """Damping of the pivot [N s/m] or hinge [N m s/rad]."""
    seating: Annotated[float, SI("N")] = 0.2
    """Load with which the pin of a clearance is pressed against its wall [N]."""
    point: Annotated[tuple[float, float], SIVector("m")] | Literal["finger"] = (0.0, 0.0)
    """Position of the mass or the hinge in the frame of the body [m], or that of the finger."""
    part: str = ""
    """Hinge: name of the part beyond the hinge."""
    carries: tuple[str, ...] = ()
    """Hinge: surfaces and points on the part beyond the hinge; ``finger`` for the finger."""
    share: float = 0.5
    """Hinge: share of the mass beyond it, a uniform slender rod from the hinge to ``end``."""
    end: Annotated[tuple[float, float], SIVector("m")] = (0.0, 0.0)
    """Hinge: far end of that rod in the frame of the body [m]."""

    def place(self, config: MechanismFile) -> tuple[float, float]:
        """Position of the mass or the hinge in the frame of the body [m]."""
        if self.point != "finger":
            return self.point
        assert config.finger is not None
        return config.finger.point


def _fault(name: str) -> str:
    return name if name == "tilt" else fault_of(name).name


class SensorError(Schema):
    """An error of measured channels."""

    kind: Annotated[str, AfterValidator(_fault)]
    """Fault of a sensor, or "tilt"."""
    channels: str = ""


class InputError(Schema):
    """An error of the recorded input."""

    kind: Annotated[str, AfterValidator(lambda name: fault_of(name).name)]


class Condition(Schema):
    """A drift: a condition of the record determines a factor of the magnitude."""

    name: str
    reference: float
    per: Annotated[float, Field(gt=0)] = 1.0
    logarithmic: bool = False

    def factor(self, conditions: Mapping[str, float | str]) -> float:
        """Factor of the magnitude in a record; 0 if the record does not state the condition."""
        value = conditions.get(self.name)
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            return 0.0
        if not self.logarithmic:
            return (value - self.reference) / self.per
        if value <= 0.0 or self.reference <= 0.0:
            return 0.0
        return math.log10(value / self.reference) / self.per


class Shape(Schema):
    """A number of the mechanism without influence at magnitude zero, and its values to be tried."""

    path: str
    values: Annotated[tuple[float, ...], Field(min_length=1)]
    unit: str = "1"


class EntryKeys(Schema):
    """Keys that an entry has in a file and in a library."""

    component: str = ""
    mechanism: str = ""
    kind: Kind = "parameter"
    unit: str = "1"
    sign: Literal[-1, 0, 1] = 0
    lower: float = -math.inf
    upper: float = math.inf
    step: Annotated[float, Field(gt=0, le=1)] = 0.05
    changes: tuple[Change, ...] = ()
    insert: Insertion | None = None
    sensor: SensorError | None = None
    input: InputError | None = None
    condition: Condition | None = None
    shape: Shape | None = None
    remedy: str = ""
    source: str = ""
    part: str = ""
    """Name in a report: the subject of "... is 10 % lighter than tabulated"."""


class Entry(EntryKeys):
    """One effect or tolerance of a mechanism: changes per unit of magnitude, and texts."""

    name: str
    magnitude: float
    """Effect: expected magnitude; tolerance: standard deviation [unit]."""

    @property
    def shapes(self) -> tuple[float | None, ...]:
        """Values of the number of its shape; (None,) without one."""
        return self.shape.values if self.shape else (None,)

    def in_record(self, magnitude: float, conditions: Mapping[str, float | str]) -> float:
        """Magnitude under the conditions of a record."""
        return magnitude * self.condition.factor(conditions) if self.condition else magnitude


#: Entries with their magnitudes and shapes.
Chosen = Sequence[tuple[Entry, float, float | None]]


def applied(changes: Iterable[tuple[Change, float]], old: Mapping[str, Any]) -> dict[str, float]:
    """New values of the changed paths.

    Parameters
    ----------
    changes
        Changes with their magnitudes.
    old
        Old values by path.
    """
    factors: dict[str, float] = {}
    sums: dict[str, float] = {}
    for change, magnitude in changes:
        factors[change.path] = factors.get(change.path, 1.0) * change.factor(magnitude)
        sums[change.path] = sums.get(change.path, 0.0) + change.add * magnitude
    out = {}
    for path, factor in factors.items():
        if factor != 1.0 or sums[path] != 0.0:
            if isinstance(old[path], bool) or not isinstance(old[path], (int, float)):
                raise InvalidParameter(f"path {path!r} is {old[path]!r}, expected a number")
            out[path] = old[path] * factor + sums[path]
    return out


class Values(dict[str, Any]):
    """Values of a mechanism file by path, read when they are needed."""

    def __init__(self, config: MechanismFile):
        self._config = config

    def __missing__(self, path: str) -> Any:
        return self.setdefault(path, read_entry(self._config, path))


class Configurations:
    """Mechanisms with entries of given magnitudes, one after the other.

    A derivative changes one entry of fifty: only values that differ from those of the last
    mechanism are set. Several threads may use it.
    """

    def __init__(self, config: MechanismFile):
        self._file = self._config = config
        self._old = Values(config)
        self._new: dict[str, Any] = {}
        self._lock = threading.Lock()

    def of(
        self, entries: Chosen, conditions: Mapping[str, float | str] | None = None
    ) -> MechanismFile:
        """The mechanism with entries of given magnitudes and shapes; unchanged if all are zero.

        Raises
        ------
        InvalidParameter
            A path is not a number.
        """
        sizes = [(e, e.in_record(m, conditions or {}), shape) for e, m, shape in entries]
        sizes = [one for one in sizes if one[1] != 0.0]
        new: dict[str, Any] = {
            e.shape.path: shape for e, _, shape in sizes if e.shape and shape is not None
        }
        with self._lock:
            old = self._old
            if new:
                old = Values(self._file)
                old.update(new)
            new |= applied(((c, m) for e, m, _ in sizes for c in e.changes), old)
            config = self._config
            for path in {*new, *self._new}:
                value = new[path] if path in new else self._old[path]
                if value != self._new.get(path, self._old[path]):
                    config = replace_entry(config, path, value)
            config = config if new else self._file
            self._new, self._config = new, config
        for e, magnitude, _ in sizes:
            if e.insert is not None:
                config = insert(config, e.insert, magnitude)
        return config


def changed_config(
    config: MechanismFile,
    entries: Chosen,
    conditions: Mapping[str, float | str] | None = None,
) -> MechanismFile:
    """Mechanism with entries of given magnitudes and shapes; unchanged if all are zero."""
    return Configurations(config).of(entries, conditions)


# ------------------------------------------------------------------------------- added parts


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
    kinds = {"mass": _added_mass, "hinge": _hinged, "bending": _bending}
    return kinds.get(insertion.kind, _loose_pivot)(config, insertion, magnitude)


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
        for axis, direction in _DIRECTIONS.items():
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
    for axis in _DIRECTIONS:
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
    rider = Body(
        parent=insertion.body, joint="weld", position=insertion.place(config), mass=magnitude
    )
    return config.model_copy(update={"bodies": {**config.bodies, f"{insertion.body}_rider": rider}})


def _hinged(config: MechanismFile, insertion: Insertion, magnitude: float) -> MechanismFile:
    """Split a body at a point: a stiff, damped hinge connects the two parts."""
    body = config.bodies[insertion.body]
    hinge, end = insertion.place(config), insertion.end
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


# ------------------------------------------------------------- effects that equal a tolerance

#: Largest relative difference of the ratios of two equal directions.
SAME = 1e-9


def same_values(
    config: MechanismFile, effect: Entry, tolerances: Sequence[Entry]
) -> tuple[Entry, float] | None:
    """Tolerance that changes the same values as an effect, and by how much; None: there is none.

    Example: a let-off button that is 0.2 mm from its tabulated position is within the regulation;
    at 1.5 mm it is a cause. To first order, only the magnitude separates them.

    Parameters
    ----------
    config
        The mechanism.
    effect
        An entry of its library.
    tolerances
        Tolerances that are estimated.

    Returns
    -------
    tuple of Entry and float, or None
        The tolerance, and the change of it that acts as a magnitude of 1 of the effect does.
    """
    if not _plain(effect):
        return None
    ours = _slopes(config, effect)
    for tolerance in filter(_plain, tolerances):
        if {c.path for c in tolerance.changes} != ours.keys():
            continue
        theirs = _slopes(config, tolerance)
        moved = [p for p in ours if ours[p] != 0.0 or theirs[p] != 0.0]
        if not moved or any(theirs[p] == 0.0 for p in moved):
            continue
        ratios = [ours[p] / theirs[p] for p in moved]
        if max(ratios) - min(ratios) <= SAME * max(abs(r) for r in ratios) and ratios[0] != 0.0:
            return tolerance, ratios[0]
    return None


def _plain(entry: Entry) -> bool:
    """Whether an entry only changes values, equally in every record."""
    others = (entry.insert, entry.sensor, entry.input, entry.condition, entry.shape)
    return bool(entry.changes) and not any(others)


def _slopes(config: MechanismFile, entry: Entry) -> dict[str, float]:
    """Derivatives of the changed values by the magnitude of an entry, at zero."""
    out: dict[str, float] = {}
    for c in entry.changes:
        value = float(read_entry(config, c.path))
        out[c.path] = out.get(c.path, 0.0) + value * (c.scale + c.exp) + c.add
    return out
