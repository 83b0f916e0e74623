"""Parameters of the micromechanical contact: a felt layer under an indenter.

Force = pressure of the felt times the common area of both surfaces (thesis 4.1.5). The felt is
compressed uniformly, or column by column under a curved indenter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, ValidationError

from feltmb import _core
from feltmb.contact.tables import CORE_LAWS, with_fields
from feltmb.fiber.material import FeltMaterial, load_material
from feltmb.quantities import SI
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.units.quantity import Schema, fault_lines

Array = NDArray[np.float64]
Compression = Literal["even", "columns"]


class Area(Protocol):
    """Common area of two surfaces as a function of compression."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        ...

    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]; 0 for compression <= 0."""
        ...


class _FromCore:
    """Base of all areas; the core checks the numbers."""

    @property
    def core(self) -> Any:
        raise NotImplementedError

    def __post_init__(self) -> None:
        _ = self.core

    @checked
    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]; 0 for compression <= 0."""
        return np.asarray(self.core.area(np.asarray(compression, dtype=float)), dtype=float)


@checked
@dataclass(frozen=True)
class ConstantArea(_FromCore):
    """Flat surfaces: the area does not depend on the compression."""

    size: float
    """Area [m^2]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.ConstantArea(self.size)

    def __str__(self) -> str:
        return f"constant, {self.size * 1e6:.6g} mm^2"


@checked
@dataclass(frozen=True)
class CrossedCylinders(_FromCore):
    """Two perpendicular cylinders, for example a hammer's nose and a string.

    The projection of the overlap: points (x, y) where the sagittas of both cylinders sum to less
    than the compression. For small compression e, it is an ellipse of area 2 pi e sqrt(R_a R_b).
    Its width is limited by both cylinders.
    """

    radius_a: float
    """Radius of one cylinder [m]."""
    radius_b: float
    """Radius of the other cylinder [m]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.CrossedCylinders(self.radius_a, self.radius_b)

    def __str__(self) -> str:
        return f"crossed cylinders, {self.radius_a * 1e3:.6g} mm and {self.radius_b * 1e3:.6g} mm"


@checked
@dataclass(frozen=True)
class CircleOnLayer(_FromCore):
    """Cylinder pressed into a flat layer: the chord of the circle times the width.

    The area is 2 sqrt(2 r e - e^2) b. The chord is limited by the length of the felt and the
    diameter of the cylinder.
    """

    radius: float
    """Radius of the cylinder [m]."""
    width: float
    """Length of the contact perpendicular to the plane of motion [m]."""
    length: float = math.inf
    """Length of the felt in the plane of motion [m]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.CircleOnLayer(self.radius, self.width, self.length)

    def __str__(self) -> str:
        text = (
            f"circle on layer, radius {self.radius * 1e3:.6g} mm, width {self.width * 1e3:.6g} mm"
        )
        return text if self.length == math.inf else f"{text}, length {self.length * 1e3:.6g} mm"


@checked
@dataclass(frozen=True)
class SphereOnLayer(_FromCore):
    """Sphere pressed into a flat layer: area pi (2 r e - e^2), limited by the sphere.

    Examples
    --------
    A sphere of 5 mm, pressed into a felt of 5 mm; force [N] at the largest compression:

    >>> from feltmb import felt
    >>> material = felt.load_material("synthetic_hammer")
    >>> round(float(felt.envelope(material, 5e-3, felt.SphereOnLayer(5e-3)).loading[-1]), 1)
    173.7
    """

    radius: float
    """Radius of the sphere [m]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.SphereOnLayer(self.radius)

    def __str__(self) -> str:
        return f"sphere on layer, radius {self.radius * 1e3:.6g} mm"


#: name in a file or command -> (class, names and SI units of its numbers, number of required ones)
AREAS: dict[str, tuple[type[Any], tuple[tuple[str, str], ...], int]] = {
    "constant": (ConstantArea, (("size", "m^2"),), 1),
    "crossed_cylinders": (CrossedCylinders, (("radius_a", "m"), ("radius_b", "m")), 2),
    "circle_on_layer": (CircleOnLayer, (("radius", "m"), ("width", "m"), ("length", "m")), 2),
    "sphere_on_layer": (SphereOnLayer, (("radius", "m"),), 1),
}

_Length = Annotated[float, SI("m"), Field(gt=0)] | None


class AreaParameters(Schema):
    """Area of a contact in a mechanism file; missing radii are taken from the pair."""

    kind: Literal["constant", "crossed_cylinders", "circle_on_layer", "sphere_on_layer"]
    size: Annotated[float, SI("m^2"), Field(gt=0)] | None = None
    radius: _Length = None
    radius_a: _Length = None
    radius_b: _Length = None
    width: _Length = None
    length: _Length = None
    note: str = ""

    def faults(self) -> list[str]:
        """Numbers that the area lacks, or that it does not have."""
        fields = [name for name, _ in AREAS[self.kind][1]]
        given = {
            name
            for name in ("size", "radius", "radius_a", "radius_b", "width", "length")
            if getattr(self, name) is not None
        }
        out = [
            f"area.{name}: is missing; kind {self.kind!r} needs it"
            for name in fields[: AREAS[self.kind][2]]
            if name not in given
        ]
        return out + [
            f"area.{name}: unknown for kind {self.kind!r}, known are {', '.join(fields)}"
            for name in sorted(given - set(fields))
        ]

    def make(self) -> Area:
        """The area from complete parameters."""
        kind, fields, _ = AREAS[self.kind]
        numbers = {name: getattr(self, name) for name, _ in fields}
        made: Area = kind(**{k: v for k, v in numbers.items() if v is not None})
        return made


def _felt(node: object) -> object:
    """A felt by its packaged name, by its file, or as a table."""
    return load_material(node) if isinstance(node, str) else node


def _area(node: object) -> object:
    """An area by its parameters, or as an object of the classes above."""
    for kind, (made, fields, _) in AREAS.items():
        if isinstance(node, made):
            numbers = {name: getattr(node, name) for name, _ in fields}
            return {"kind": kind} | {k: v for k, v in numbers.items() if v != math.inf}
    return node


@with_fields("felt_memory")
class LayerParameters(Schema):
    """The micromechanical law: a felt with a thickness, the area, and the memory of the law."""

    felt: Annotated[FeltMaterial, BeforeValidator(_felt)]
    thickness: Annotated[float, SI("m"), Field(gt=0)]
    area: Annotated[AreaParameters, BeforeValidator(_area)]
    compression: Compression = "even"
    note: str = ""

    @property
    def numbers(self) -> dict[str, float]:
        """Numbers of the law with memory, by name."""
        law = CORE_LAWS["felt_memory"]
        return {f.name: getattr(self, f.name) for f in law.fields if f.kind == "number"}

    @property
    def envelope(self) -> _core.Envelope:
        """Loop of the contact; equal numbers reuse it.

        Raises
        ------
        InvalidParameter
            Numbers of the area are missing, or a number is out of range.
        """
        faults = self.area.faults()
        if faults:
            raise InvalidParameter("\n".join(faults))
        return _core.layer_envelope(
            core_layer(self.felt, self.thickness, self.area.make(), self.compression)
        )


def layer_parameters(**parameters: Any) -> LayerParameters:
    """Checked parameters of a layer.

    Raises
    ------
    InvalidParameter
        The parameters have faults; all of them are in the message.
    """
    try:
        made = LayerParameters.model_validate(parameters)
    except ValidationError as error:
        lines = fault_lines(error, LayerParameters)
        raise InvalidParameter("\n".join(f"micromechanical: {line}" for line in lines)) from None
    faults = made.area.faults()
    if faults:
        raise InvalidParameter("\n".join(f"micromechanical: {line}" for line in faults))
    return made


def core_layer(
    felt: FeltMaterial, thickness: float, area: Area, compression: Compression = "even"
) -> _core.FeltLayer:
    """A layer as an object of the core.

    Raises
    ------
    InvalidParameter
        Data of the felt are missing, or a number is out of range.
    """
    if compression not in ("even", "columns"):
        raise InvalidParameter(f"compression: got {compression!r}, expected even or columns")
    pressure = _core.pressure_envelope(felt.core())
    return _core.FeltLayer(pressure, float(thickness), area.core, compression == "columns")
