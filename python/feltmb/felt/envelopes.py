"""From a felt to the force of a contact: thickness, contact area, table of the loop.

Force = pressure of the felt times the area that both surfaces share (thesis 4.1.5), the felt being
compressed evenly: v_f = v_f0 / (1 - e / thickness) at compression e (eq. 2.2).
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb import _core
from feltmb.errors import InvalidParameter
from feltmb.felt.material import FeltMaterial
from feltmb.files import read_toml
from feltmb.quantity import parse_scalar
from feltmb.units import conversion_factor

__all__ = [
    "AREAS",
    "Area",
    "CircleOnLayer",
    "ConstantArea",
    "CrossedCylinders",
    "FeltEnvelope",
    "envelope",
    "load_envelope",
    "parse_area",
]

Array = NDArray[np.float64]


def _positive(where: str, **values: float) -> None:
    faults = [
        f"{where}: {name} = {value:.6g}, must be finite and > 0"
        for name, value in values.items()
        if not (value > 0 and math.isfinite(value))
    ]
    if faults:
        raise InvalidParameter("\n".join(faults))


class Area(Protocol):
    """Area that two surfaces share, by compression."""

    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]; 0 for compression <= 0."""
        ...


@dataclass(frozen=True)
class ConstantArea:
    """Flat faces: the same area at every compression."""

    size: float
    """[m^2]."""

    def __post_init__(self) -> None:
        _positive("constant area", size=self.size)

    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]."""
        e = np.asarray(compression, dtype=float)
        return np.where(e > 0, self.size, 0.0)

    def __str__(self) -> str:
        return f"constant, {self.size * 1e6:.6g} mm^2"


@dataclass(frozen=True)
class CrossedCylinders:
    """Cylinder on cylinder at a right angle, such as a hammer's nose on a string.

    The projection of the overlap: points (x, y) where the sagittas of both cylinders sum to less
    than the compression. Small compression e: an ellipse of area 2 pi e sqrt(R_a R_b). No wider
    than either cylinder.
    """

    radius_a: float
    """[m]."""
    radius_b: float
    """[m]."""

    def __post_init__(self) -> None:
        _positive("crossed cylinders", radius_a=self.radius_a, radius_b=self.radius_b)

    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]."""
        e = np.atleast_1d(np.asarray(compression, dtype=float))
        small, large = sorted((self.radius_a, self.radius_b))
        node, weight = np.polynomial.legendre.leggauss(64)
        # y = small sin(phi), phi = end sin(psi): the root at the rim becomes smooth.
        psi = 0.25 * np.pi * (node + 1.0)
        end = np.arccos(np.clip(1.0 - np.maximum(e, 0.0) / small, 0.0, 1.0))[:, None]
        phi = end * np.sin(psi)
        gap = np.clip(e[:, None] - 2.0 * small * np.sin(0.5 * phi) ** 2, 0.0, large)
        half = np.sqrt(gap * (2.0 * large - gap))
        step = small * np.cos(phi) * end * np.cos(psi)
        out = 4.0 * 0.25 * np.pi * (half * step) @ weight
        return np.where(e > 0, out, 0.0).reshape(np.shape(compression))

    def __str__(self) -> str:
        return f"crossed cylinders, {self.radius_a * 1e3:.6g} mm and {self.radius_b * 1e3:.6g} mm"


@dataclass(frozen=True)
class CircleOnLayer:
    """Cylinder pressed into a flat layer: chord of the circle times the width.

    Area 2 sqrt(2 r e - e^2) b, no wider than the cylinder.
    """

    radius: float
    """[m]."""
    width: float
    """Length of the contact across the plane of motion [m]."""

    def __post_init__(self) -> None:
        _positive("circle on layer", radius=self.radius, width=self.width)

    def area(self, compression: ArrayLike) -> Array:
        """Area [m^2] at compression [m]."""
        e = np.clip(np.asarray(compression, dtype=float), 0.0, self.radius)
        return np.asarray(2.0 * self.width * np.sqrt(e * (2.0 * self.radius - e)))

    def __str__(self) -> str:
        return (
            f"circle on layer, radius {self.radius * 1e3:.6g} mm, width {self.width * 1e3:.6g} mm"
        )


#: name in a command -> (class, names and SI units of its numbers)
AREAS: dict[str, tuple[type[Any], tuple[tuple[str, str], ...]]] = {
    "constant": (ConstantArea, (("size", "m^2"),)),
    "crossed_cylinders": (CrossedCylinders, (("radius_a", "m"), ("radius_b", "m"))),
    "circle_on_layer": (CircleOnLayer, (("radius", "m"), ("width", "m"))),
}


def parse_area(text: str) -> Area:
    """Area law from text: ``constant:100mm^2``, ``crossed_cylinders:9mm,0.5mm`` or so.

    Raises
    ------
    InvalidParameter
        Naming every fault and the way to write it.
    """
    name, _, rest = text.partition(":")
    usage = "; ".join(f"{k}:{','.join(n.upper() for n, _ in v[1])}" for k, v in AREAS.items())
    if name.strip() not in AREAS:
        raise InvalidParameter(f"area {text!r}: expected {usage} (lengths such as 9mm)")
    kind, fields = AREAS[name.strip()]
    parts = [p.strip() for p in rest.split(",")] if rest.strip() else []
    if len(parts) != len(fields):
        raise InvalidParameter(
            f"area {text!r}: {len(parts)} numbers, expected {len(fields)}: "
            f"{name}:{','.join(n.upper() for n, _ in fields)}"
        )
    values, faults = [], []
    for part, (field, unit) in zip(parts, fields, strict=True):
        try:
            values.append(parse_scalar(part, unit))
        except ValueError as error:
            faults.append(f"area {text!r}: {field}: {error}")
    if faults:
        raise InvalidParameter("\n".join(faults))
    made: Area = kind(*values)
    return made


@dataclass(frozen=True)
class FeltEnvelope:
    """Loop of one contact as a table; the envelope of the law with memory."""

    compression: Array
    """[m], from 0 to the end of the loop."""
    loading: Array
    """[N]."""
    unloading: Array
    """[N]; 0 <= unloading <= loading, equal at the end."""
    name: str
    about: str = ""

    @property
    def closing(self) -> float:
        """Compression at the end of the loop [m]."""
        return float(self.compression[-1])

    @property
    def loss(self) -> float:
        """Part of the loading work lost in the whole loop [-]."""

        def work(force: Array) -> float:
            return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(self.compression)))

        return 1.0 - work(self.unloading) / work(self.loading)

    @cached_property
    def core(self) -> _core.Envelope:
        """The envelope as the integrator uses it."""
        return _core.Envelope.from_table(
            self.compression.tolist(), self.loading.tolist(), self.unloading.tolist()
        )

    def law(self, **options: float) -> _core.ContactLaw:
        """Law with memory on this envelope; options ``kappa``, ``recovery_time`` and so on."""
        return _core.ContactLaw(_core.FeltMemory(envelope=self.core, **options))

    def table(self) -> dict[str, Any]:
        """Value of ``contacts.NN.memory.envelope`` in a mechanism file."""
        return {
            "unit": ["mm", "N"],
            "compression": [float(f"{x * 1e3:.9g}") for x in self.compression],
            "loading": [float(f"{x:.9g}") for x in self.loading],
            "unloading": [float(f"{x:.9g}") for x in self.unloading],
        }

    def to_toml(self, action: str | None = None, contact: str | None = None) -> str:
        """Text of a file.

        Parameters
        ----------
        action, contact
            With both: a mechanism that extends ``action`` and gives ``contact`` the law with
            memory on this envelope. Without: the table alone, ``[memory.envelope]``, to be copied
            below a contact.
        """
        import tomlkit

        if (action is None) != (contact is None):
            raise InvalidParameter("envelope: give action and contact together, or neither")
        doc = tomlkit.document()
        if "synthetic" in self.about.lower():
            doc.add(tomlkit.comment("From a SYNTHETIC felt: plausible numbers, not a measurement."))
        doc["schema"] = 1
        doc["name"] = self.name if contact is None else f"{action}_{self.name}_{contact}"
        doc["about"] = self.about
        memory = {"envelope": self.table()}
        if contact is None:
            doc["memory"] = memory
        else:
            doc["extends"] = action
            doc["values"] = {
                f"contacts.{contact}.law": "felt_memory",
                f"contacts.{contact}.memory": memory,
            }
        return tomlkit.dumps(doc)


_CACHE: OrderedDict[tuple[Any, ...], FeltEnvelope] = OrderedDict()
_CACHE_SIZE = 256
_LOCK = threading.Lock()


def envelope(
    material: FeltMaterial,
    thickness: float,
    area: Area,
    *,
    largest: float | None = None,
    points: int = 193,
    name: str | None = None,
) -> FeltEnvelope:
    """Loop of a contact from its felt; made once for the same arguments.

    Parameters
    ----------
    material
        Felt with both branches.
    thickness
        Thickness of the felt without load [m].
    area
        Area law: :class:`ConstantArea`, :class:`CrossedCylinders`, :class:`CircleOnLayer`.
    largest
        End of the loop [m]; default where the felt reaches its ``v_f_max``. A smaller one cuts the
        measured loop, whose unloading is then lower than that of a loop to this end: prefer the
        default, the law with memory scales the loop by itself.
    points
        Rows of the table, at least 5; finer where the compression is small.
    name
        Of the envelope; default that of the felt.

    Returns
    -------
    FeltEnvelope
        Unloading is held between 0 and loading and raised to meet it at the end, by the gap there
        times (e / e_end)^8.

    Raises
    ------
    InvalidParameter
        Naming every argument out of range.
    """
    faults = []
    if not (thickness > 0 and math.isfinite(thickness)):
        faults.append(f"envelope: thickness = {thickness:.6g} m, must be finite and > 0")
    if points < 5:
        faults.append(f"envelope: points = {points}, must be >= 5")
    if faults:
        raise InvalidParameter("\n".join(faults))
    natural = thickness * (1.0 - material.v_f0 / material.end)
    end = natural if largest is None else largest
    if not 0 < end <= natural * (1 + 1e-12):
        raise InvalidParameter(
            f"envelope: largest = {end:.6g} m, must be > 0 and <= {natural:.6g} m, where "
            f'felt "{material.name}" of {thickness:.6g} m reaches its v_f_max = {material.end:.6g}'
        )
    key = (material.hash, thickness, area, end, points, name)
    with _LOCK:
        if key in _CACHE:
            _CACHE.move_to_end(key)
            return _CACHE[key]
    x = np.linspace(0.0, 1.0, points) ** 2
    e = end * x
    v = material.v_f0 / (1.0 - e / thickness)
    surface = area.area(e)
    load = surface * material.pressure("loading", v)
    load = np.maximum.accumulate(load)
    back = np.clip(surface * material.pressure("unloading", v), 0.0, load)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(load > 0, back / load, 1.0)
    back = load * np.minimum(ratio + (1.0 - ratio[-1]) * x**8, 1.0)
    for column in (e, load, back):
        column.setflags(write=False)
    about = f"{material.name}, {thickness * 1e3:.6g} mm thick, area: {area}"
    if material.synthetic:
        about += "; SYNTHETIC felt"
    made = FeltEnvelope(e, load, back, name or material.name, about)
    with _LOCK:
        _CACHE[key] = made
        while len(_CACHE) > _CACHE_SIZE:
            _CACHE.popitem(last=False)
    return made


def load_envelope(path: str | Path) -> FeltEnvelope:
    """Read a table written by :meth:`FeltEnvelope.to_toml` without a contact.

    Raises
    ------
    InvalidParameter
        What is missing or cannot be used.
    """
    path = Path(path)
    raw = read_toml(path)
    table = raw.get("memory", {}).get("envelope")
    if not isinstance(table, dict):
        raise InvalidParameter(
            f"{path}: memory.envelope is missing, expected unit, compression, loading, unloading"
        )
    faults, columns = [], {}
    for key in ("compression", "loading", "unloading"):
        try:
            columns[key] = np.array(table[key], dtype=float)
        except (KeyError, TypeError, ValueError):
            faults.append(f"{path}: memory.envelope.{key}: expected a list of numbers")
    unit = table.get("unit", ["m", "N"])
    if not (isinstance(unit, list) and len(unit) == 2):
        faults.append(
            f"{path}: memory.envelope.unit: got {unit!r}, expected two, such as ['mm', 'N']"
        )
    if faults:
        raise InvalidParameter("\n".join(faults))
    length, force = conversion_factor(unit[0], "m"), conversion_factor(unit[1], "N")
    made = FeltEnvelope(
        columns["compression"] * length,
        columns["loading"] * force,
        columns["unloading"] * force,
        str(raw.get("name", path.stem)),
        str(raw.get("about", "")),
    )
    try:
        _ = made.core
    except InvalidParameter as error:
        raise InvalidParameter(f"{path}: memory.envelope: {error}") from None
    return made
