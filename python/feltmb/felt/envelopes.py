"""Force of a contact from its felt: thickness, contact area, table of the loop.

Force = pressure of the felt times the common area of both surfaces (thesis 4.1.5). The felt is
compressed uniformly, v_f = v_f0 / (1 - e / thickness) at compression e (eq. 2.2), or by columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.contact.layer import (
    AREAS,
    Area,
    Compression,
    core_layer,
)
from feltmb.fiber.material import FeltMaterial
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import read_toml
from unmodeled.units import conversion_factor, split_quantity
from unmodeled.units.quantity import parse_scalar

Array = NDArray[np.float64]

#: Laws with a loop as envelope.
FeltLaw = Literal["felt_memory", "felt_return_point"]

#: Largest dimensions of a felt under a contact, by unit; larger ones would overflow.
LIMITS = {"m": (1e-6, 10.0), "m^2": (1e-10, 1.0)}


@checked
def parse_area(text: str) -> Area:
    """Area law from text, for example ``constant:100mm^2`` or ``crossed_cylinders:9mm,0.5mm``.

    Raises
    ------
    InvalidParameter
        The text has faults; the message has all of them and the correct form.

    Examples
    --------
    The area of contact of a sphere of 5 mm, as the command line takes it:

    >>> from feltmb import felt
    >>> felt.parse_area("sphere_on_layer:5mm").radius
    0.005
    """
    name, _, rest = text.partition(":")

    def usage_of(kind: str) -> str:
        _, fields, needed = AREAS[kind]
        words = [n.upper() for n, _ in fields]
        more = "".join(f"[,{w}]" for w in words[needed:])
        return f"{kind}:{','.join(words[:needed])}{more}"

    usage = "; ".join(usage_of(kind) for kind in AREAS)
    if name.strip() not in AREAS:
        plain = split_quantity(text.strip())
        hint = f"; an area that does not change is constant:{text.strip()}" if plain else ""
        raise InvalidParameter(f"area {text!r}: expected {usage} (lengths such as 9mm){hint}")
    kind, fields, needed = AREAS[name.strip()]
    parts = [p.strip() for p in rest.split(",")] if rest.strip() else []
    if not needed <= len(parts) <= len(fields):
        raise InvalidParameter(
            f"area {text!r}: {len(parts)} numbers, expected {needed}: {usage_of(name.strip())}"
        )
    values, faults = [], []
    for part, (number, unit) in zip(parts, fields, strict=False):
        try:
            value = parse_scalar(part, unit)
        except ValueError as error:
            faults.append(f"area {text!r}: {number}: {error}")
            continue
        low, high = LIMITS[unit]
        if not low <= value <= high:
            faults.append(
                f"area {text!r}: {number} = {value:.6g} {unit}, expected {low:g} to {high:g}"
            )
        values.append(value)
    if faults:
        raise InvalidParameter("\n".join(faults))
    made: Area = kind(*values)
    return made


@checked
@dataclass(frozen=True)
class FeltEnvelope:
    """Loop of one contact as a table, which the law with memory uses as envelope."""

    compression: Array
    """Compression [m], from 0 to the end of the loop."""
    loading: Array
    """Force of loading [N]."""
    unloading: Array
    """Force of unloading [N]; 0 <= unloading <= loading, equal at the end."""
    name: str
    about: str = ""
    memory: Mapping[str, float] = field(default_factory=dict)
    """Further numbers of the memory, such as ``kappa``."""
    open_loss: float = math.nan
    """Loss of the branches before they were closed [-]; NaN if it is not known."""
    law_name: FeltLaw = "felt_memory"
    """Law that has this envelope: ``felt_return_point`` for small vibrations."""
    made: _core.Envelope | None = field(default=None, repr=False, compare=False)
    """The envelope from which the table was sampled, if there is one."""

    @property
    def closing(self) -> float:
        """Compression at the end of the loop [m]."""
        return float(self.compression[-1])

    @property
    def loss(self) -> float:
        """Share of the loading work that is lost in the complete loop [-]."""

        def work(force: Array) -> float:
            return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(self.compression)))

        return 1.0 - work(self.unloading) / work(self.loading)

    @cached_property
    def core(self) -> _core.Envelope:
        """The envelope as an object of the core."""
        if self.made is not None:
            return self.made
        return _core.Envelope.from_table(
            self.compression.tolist(), self.loading.tolist(), self.unloading.tolist()
        )

    def law(self, **options: float) -> _core.ContactLaw:
        """Law with memory and this envelope; ``options`` replace numbers of ``memory``."""
        return _core.ContactLaw(self.law_name, envelope=self.core, **{**self.memory, **options})

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
            If both are given: a mechanism that extends ``action`` and in which ``contact`` has the
            law with memory and this envelope. Otherwise: only the table ``[memory.envelope]``,
            which can be copied to a contact.
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
        entry = {**self.memory, "envelope": self.table()}
        if contact is None:
            doc["memory"] = entry
        else:
            doc["extends"] = action
            doc["values"] = {
                f"contacts.{contact}.law": self.law_name,
                f"contacts.{contact}.memory": entry,
            }
        return tomlkit.dumps(doc)


@checked
def envelope(
    material: FeltMaterial,
    thickness: float,
    area: Area,
    *,
    compression: Compression = "even",
    largest: float | None = None,
    points: int = 193,
    name: str | None = None,
) -> FeltEnvelope:
    """Loop of a contact from its felt; equal arguments reuse its tables.

    Parameters
    ----------
    material
        Felt with both branches.
    thickness
        Thickness of the felt without load [m].
    area
        Area law: :class:`ConstantArea`, :class:`CrossedCylinders`, :class:`CircleOnLayer`,
        :class:`SphereOnLayer`.
    compression
        ``"even"``: the whole area is compressed by e, as in the thesis; ``"columns"``: each column
        of the felt is compressed by the shape of the indenter, with its own memory.
    largest
        End of the loop [m]; default: where the felt reaches its ``v_f_max``. A smaller value cuts
        the measured loop, and its unloading is lower than in a loop measured to this end. Prefer
        the default: the law with memory scales the loop itself.
    points
        Number of rows of the table, at least 5; the rows are denser at small compression.
    name
        Name of the envelope; default: the name of the felt.

    Returns
    -------
    FeltEnvelope
        The loop. Unloading is limited to values between 0 and loading. It is raised by its distance
        to loading at the end times (e / e_end)^8, so that the branches meet there, and its share of
        loading never decreases. ``open_loss`` is the loss without these changes.

    Raises
    ------
    InvalidParameter
        Arguments are out of range; all of them are in the message.

    Examples
    --------
    Force [N] of a felt of 5 mm under 1 cm^2 at a compression of 1 mm:

    >>> from feltmb import felt
    >>> material = felt.load_material("synthetic_hammer")
    >>> made = felt.envelope(material, 5e-3, felt.ConstantArea(1e-4))
    >>> len(made.loading)
    193
    """
    faults = []
    if not LIMITS["m"][0] <= thickness <= 1.0:
        faults.append(
            f"envelope: thickness = {thickness:.6g} m, expected {LIMITS['m'][0]:g} to 1 "
            "(give the unit: 3mm)"
        )
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
    if largest is not None:
        material = material.model_copy(update={"v_f_max": material.v_f0 / (1.0 - end / thickness)})
    core = _core.layer_envelope(core_layer(material, thickness, area, compression))
    e = core.closing * np.linspace(0.0, 1.0, points) ** 2
    load = np.asarray(core.loading(e), dtype=float)
    back = np.minimum(np.asarray(core.unloading(e, core.closing), dtype=float), load)
    for column in (e, load, back):
        column.setflags(write=False)
    about = f"{material.name}, {thickness * 1e3:.6g} mm thick, area: {area}"
    if compression == "columns":
        about += ", by columns"
    if material.synthetic:
        about += "; SYNTHETIC felt"
    apart = math.nan
    if compression == "even":  # both branches of the felt as they are, under the same area
        v = material.v_f0 / (1.0 - e / thickness)
        work = [
            float(np.trapezoid(area.area(e) * material.pressure(side, v), e))
            for side in ("loading", "unloading")
        ]
        apart = 1.0 - work[1] / work[0]
    return FeltEnvelope(e, load, back, name or material.name, about, open_loss=apart, made=core)


@checked
def load_envelope(path: str | Path) -> FeltEnvelope:
    """Read a table written by :meth:`FeltEnvelope.to_toml` without a contact.

    Raises
    ------
    InvalidParameter
        An entry is missing or invalid.
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
    numbers = {k: v for k, v in raw["memory"].items() if k != "envelope"}
    faults += [
        f"{path}: memory.{key}: got {value!r}, expected a number"
        for key, value in numbers.items()
        if not isinstance(value, int | float) or isinstance(value, bool)
    ]
    if faults:
        raise InvalidParameter("\n".join(faults))
    length, force = conversion_factor(unit[0], "m"), conversion_factor(unit[1], "N")
    made = FeltEnvelope(
        columns["compression"] * length,
        columns["loading"] * force,
        columns["unloading"] * force,
        str(raw.get("name", path.stem)),
        str(raw.get("about", "")),
        {k: float(v) for k, v in numbers.items()},
    )
    try:
        made.law()
    except InvalidParameter as error:
        raise InvalidParameter(f"{path}: memory.envelope: {error}") from None
    return made
