"""A felt layer under an indenter: the parameters of the micromechanical contact.

Force = pressure of the felt over the area that both surfaces share (thesis 4.1.5), the felt being
compressed evenly, or column by column under a curved indenter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, ValidationError

from feltmb import _core
from feltmb.arguments import checked
from feltmb.contact.tables import CORE_LAWS, with_fields
from feltmb.errors import InvalidParameter
from feltmb.fiber.material import FeltMaterial, load_material
from feltmb.units.quantity import SI, Schema, fault_lines

__all__ = [
    "AREAS",
    "Area",
    "AreaParameters",
    "CircleOnLayer",
    "Compression",
    "ConstantArea",
    "CrossedCylinders",
    "LayerParameters",
    "SphereOnLayer",
    "core_layer",
    "layer_parameters",
]

Array = NDArray[np.float64]
Compression = Literal["even", "columns"]


class Area(Protocol):
    """Area that two surfaces share, by compression."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        ...

    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]; 0 for compression <= 0."""
        ...


class _FromCore:
    """What all areas share; the numbers are checked by the core."""

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
    """Flat faces: the same area at every compression."""

    size: float
    """[m^2]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.ConstantArea(self.size)

    def __str__(self) -> str:
        return f"constant, {self.size * 1e6:.6g} mm^2"


@checked
@dataclass(frozen=True)
class CrossedCylinders(_FromCore):
    """Cylinder on cylinder at a right angle, such as a hammer's nose on a string.

    The projection of the overlap: points (x, y) where the sagittas of both cylinders sum to less
    than the compression. Small compression e: an ellipse of area 2 pi e sqrt(R_a R_b). No wider
    than either cylinder.
    """

    radius_a: float
    """[m]."""
    radius_b: float
    """[m]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.CrossedCylinders(self.radius_a, self.radius_b)

    def __str__(self) -> str:
        return f"crossed cylinders, {self.radius_a * 1e3:.6g} mm and {self.radius_b * 1e3:.6g} mm"


@checked
@dataclass(frozen=True)
class CircleOnLayer(_FromCore):
    """Cylinder pressed into a flat layer: chord of the circle times the width.

    Area 2 sqrt(2 r e - e^2) b; the chord is no longer than the felt or the cylinder is wide.
    """

    radius: float
    """[m]."""
    width: float
    """Length of the contact across the plane of motion [m]."""
    length: float = math.inf
    """Of the felt in the plane of motion [m]."""

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
    """Sphere pressed into a flat layer: area pi (2 r e - e^2), no wider than the sphere."""

    radius: float
    """[m]."""

    @property
    def core(self) -> Any:
        """The area as an object of the C++ core."""
        return _core.SphereOnLayer(self.radius)

    def __str__(self) -> str:
        return f"sphere on layer, radius {self.radius * 1e3:.6g} mm"


#: name in a file or command -> (class, names and SI units of its numbers, how many are needed)
AREAS: dict[str, tuple[type[Any], tuple[tuple[str, str], ...], int]] = {
    "constant": (ConstantArea, (("size", "m^2"),), 1),
    "crossed_cylinders": (CrossedCylinders, (("radius_a", "m"), ("radius_b", "m")), 2),
    "circle_on_layer": (CircleOnLayer, (("radius", "m"), ("width", "m"), ("length", "m")), 2),
    "sphere_on_layer": (SphereOnLayer, (("radius", "m"),), 1),
}

_Length = Annotated[float, SI("m"), Field(gt=0)] | None


class AreaParameters(Schema):
    """Area of a contact in a mechanism file; radii left out are those of the pair."""

    kind: Literal["constant", "crossed_cylinders", "circle_on_layer", "sphere_on_layer"]
    size: Annotated[float, SI("m^2"), Field(gt=0)] | None = None
    radius: _Length = None
    radius_a: _Length = None
    radius_b: _Length = None
    width: _Length = None
    length: _Length = None
    note: str = ""

    def faults(self) -> list[str]:
        """Numbers that the kind needs and lacks, or has and does not know."""
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
        """The area, once nothing is missing."""
        kind, fields, _ = AREAS[self.kind]
        numbers = {name: getattr(self, name) for name, _ in fields}
        made: Area = kind(**{k: v for k, v in numbers.items() if v is not None})
        return made


def _felt(node: object) -> object:
    """A felt by the name of a packaged one, by its file or as a table."""
    return load_material(node) if isinstance(node, str) else node


def _area(node: object) -> object:
    """An area by its parameters, or one of the classes above."""
    for kind, (made, fields, _) in AREAS.items():
        if isinstance(node, made):
            numbers = {name: getattr(node, name) for name, _ in fields}
            return {"kind": kind} | {k: v for k, v in numbers.items() if v != math.inf}
    return node


@with_fields("felt_memory")
class LayerParameters(Schema):
    """The micromechanical law: a felt of some thickness, the area, and the law's memory."""

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
        """Loop of the contact; made once for the same numbers.

        Raises
        ------
        InvalidParameter
            Naming what the area lacks, or a number out of range.
        """
        faults = self.area.faults()
        if faults:
            raise InvalidParameter("\n".join(faults))
        return _core.layer_envelope(
            core_layer(self.felt, self.thickness, self.area.make(), self.compression)
        )


def layer_parameters(**parameters: Any) -> LayerParameters:
    """Parameters of a layer, checked.

    Raises
    ------
    InvalidParameter
        Naming every fault.
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
    """A layer as the core knows it.

    Raises
    ------
    InvalidParameter
        Naming what the felt lacks, or a number out of range.
    """
    if compression not in ("even", "columns"):
        raise InvalidParameter(f"compression: got {compression!r}, expected even or columns")
    pressure = _core.pressure_envelope(felt.core())
    return _core.FeltLayer(pressure, float(thickness), area.core, compression == "columns")
