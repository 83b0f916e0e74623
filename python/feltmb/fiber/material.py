"""Felt as a material: fibers, elastic laws of both branches, friction (thesis 3.3.2)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, model_validator

from feltmb import _core as _all
from feltmb import params
from feltmb._core import fiber as _core
from feltmb.fiber.ranges import unusual
from feltmb.quantities import SI
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import read_toml
from unmodeled.units.quantity import Schema, is_quantity, validated

Array = NDArray[np.float64]
BranchName = Literal["loading", "unloading"]


def _plain(node: object) -> object:
    """The tables of a branch without notes."""
    if isinstance(node, Mapping) and not is_quantity(node):
        return {k: v for k, v in node.items() if k not in ("note", "source", "status")}
    return node


class Fiber(Schema):
    """Data of the fibers and of the contacts between them."""

    diameter: Annotated[float, SI("m"), Field(gt=0)]
    """Fiber diameter d_f [m]."""
    friction: Annotated[float, SI("1"), Field(ge=0)]
    """Friction coefficient between fibers mu [-]."""
    withdrawal_force: Annotated[float, SI("N/m"), Field(gt=0)]
    """Withdrawal force per length of fiber without load Wf0 [N/m]."""
    young_modulus: Annotated[float, SI("Pa"), Field(gt=0)] | None = None
    """Young's modulus E [Pa]; not used by the two-step procedure."""
    Q: Annotated[float, SI("1"), Field(gt=0)] = 2.0
    """Constant of eq. 3.15 [-]; 2 for random directions in space."""

    def unusual(self) -> list[str]:
        """Sentences about numbers outside of their usual range; see :func:`feltmb.fiber.unusual`.

        Returns
        -------
        list of str
            Empty if all numbers are usual.
        """
        given = {"d_f": self.diameter, "mu": self.friction, "Wf0": self.withdrawal_force}
        if self.young_modulus is not None:
            given["E"] = self.young_modulus
        return unusual(**given)


class Branch(Schema):
    """Elastic law of one branch: eq. 3.64 minus its value at v_f0."""

    K_p: Annotated[float, SI("Pa"), Field(gt=0)]
    """Coefficient of the law [Pa]."""
    gamma: Annotated[float, SI("1"), Field(gt=0)]
    """Blocked length per contact divided by the fiber diameter [-]."""


class CriticalAngles(Schema):
    """Critical angles of an identification, for documentation only."""

    v_f: tuple[float, ...]
    loading: tuple[float, ...]
    unloading: tuple[float, ...]
    unit: Literal["rad"] = "rad"


@dataclass(frozen=True)
class BranchCurve:
    """One branch of a material at given volume fractions; all arrays have the same shape."""

    v_f: Array
    """Volume fraction [-]."""
    elastic: Array
    """Stress of the sticking contacts [Pa]."""
    friction: Array
    """Stress of the sliding contacts, >= 0 [Pa]; added in loading and subtracted in unloading."""
    theta_cr: Array
    """Critical angle [rad]."""
    r_sc: Array
    """Proportion of sliding contacts [-]."""
    pressure: Array
    """Pressure, >= 0 [Pa]."""


@checked
class FeltMaterial(Schema):
    """A felt: data of its fibers, and its pressure as a function of volume fraction.

    Pressure of loading: ``sigma_L + r_sc n C_sL``; of unloading: ``sigma_U - r_sc n C_sU``, at
    least 0. sigma is eq. 3.64 minus its value at ``v_f0``. The contact force follows from
    ``sigma = (1 - r_sc) n C``, and the critical angle and the friction follow from the contact
    force (docs/explanation/felt.md).
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    name: str
    about: str = ""
    source: dict[str, str] = Field(default_factory=dict)
    v_f0: Annotated[float, SI("1"), Field(gt=0, lt=1)]
    """Volume fraction without load, random orientation [-]."""
    v_f_max: Annotated[float, SI("1"), Field(gt=0, lt=1)] | None = None
    """Largest volume fraction of the loop, where both branches meet [-]."""
    fiber: Fiber
    loading: Annotated[Branch, BeforeValidator(_plain)] | None = None
    unloading: Annotated[Branch, BeforeValidator(_plain)] | None = None
    critical_angles: CriticalAngles | None = None

    @model_validator(mode="after")
    def _check(self) -> FeltMaterial:
        if self.v_f_max is not None and not self.v_f_max > self.v_f0:
            raise ValueError(
                f"v_f_max: got {self.v_f_max:g}, must be > v_f0 = {self.v_f0:g} (the largest "
                "volume fraction of the loop)"
            )
        return self

    @property
    def synthetic(self) -> bool:
        """Whether the values are invented instead of measured."""
        return "synthetic" in (self.about + self.name).lower()

    @property
    def hash(self) -> str:
        """SHA-256 of all parameters in SI units."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def _branch(self, which: BranchName) -> Branch:
        branch = self.loading if which == "loading" else self.unloading
        if branch is None:
            raise InvalidParameter(
                f'felt "{self.name}": {which} is missing, expected K_p and gamma '
                "(feltmb felt identify finds them from a test)"
            )
        return branch

    def with_branches(self, loading: Branch, unloading: Branch, v_f_max: float) -> FeltMaterial:
        """Copy with other elastic laws and another end of the loop.

        Parameters
        ----------
        loading
            Elastic law of loading.
        unloading
            Elastic law of unloading.
        v_f_max
            Volume fraction at the end of the loop [1].
        """
        return self.model_copy(
            update={"loading": loading, "unloading": unloading, "v_f_max": v_f_max}
        )

    def branch(self, which: BranchName, v_f: ArrayLike) -> BranchCurve:
        """Stresses and critical angle of ``"loading"`` or ``"unloading"``.

        Parameters
        ----------
        which
            Branch; each has its own ``K_p``, ``gamma`` and friction.
        v_f
            Volume fractions [-], below 1; the pressure is zero below ``v_f0``.

        Raises
        ------
        InvalidParameter
            The branch has no data, or a volume fraction is out of range.
        """
        if which not in ("loading", "unloading"):
            raise InvalidParameter(f'branch: got "{which}", must be loading or unloading')
        branch = self._branch(which)
        v = np.atleast_1d(np.asarray(v_f, dtype=float))
        if not np.all((v > 0) & (v < 1)):
            raise InvalidParameter(
                f'felt "{self.name}": v_f from {v.min():.6g} to {v.max():.6g}, must be > 0 and < 1'
            )
        law = _core.CompressionLaw(
            "binomial",
            {"K_p": branch.K_p, "gamma": branch.gamma, "v_f0": self.v_f0, "Q": self.fiber.Q},
        )
        elastic = np.asarray(law.pressure(v, 1), dtype=float)
        # Below v_f0, stress and friction are zero, and the orientation is random.
        rows = sliding_at_pressure(self, np.maximum(v, self.v_f0), elastic, "elastic", branch.gamma)
        friction = rows[:, 6] if which == "loading" else rows[:, 7]
        sign = 1.0 if which == "loading" else -1.0
        return BranchCurve(
            v_f=v,
            elastic=elastic,
            friction=friction,
            theta_cr=rows[:, 1],
            r_sc=rows[:, 2],
            pressure=np.maximum(elastic + sign * friction, 0.0),
        )

    def pressure(self, which: BranchName, v_f: ArrayLike) -> Array:
        """Pressure of a branch [Pa]; see :meth:`branch`."""
        return self.branch(which, v_f).pressure

    def loss(self, points: int = 1001) -> float:
        """Share of the loading work that is lost in the loop up to ``v_f_max`` [-].

        ``points``: number of points of the sums over the loop, at least 2.
        """
        if points < 2:
            raise InvalidParameter(f"loss: points = {points}, expected at least 2")
        v = np.linspace(self.v_f0, self.end, points)
        load = self.pressure("loading", v) / v**2
        back = np.minimum(self.pressure("unloading", v) / v**2, load)
        return 1.0 - float(np.sum(back[1:] + back[:-1]) / np.sum(load[1:] + load[:-1]))

    def core(self) -> _all.FeltMaterial:
        """The felt as an object of the C++ core.

        Raises
        ------
        InvalidParameter
            A branch or the end of the loop is missing, or a number is out of range.
        """
        loading, unloading = self._branch("loading"), self._branch("unloading")
        return _all.FeltMaterial(
            mu=self.fiber.friction,
            Wf0=self.fiber.withdrawal_force,
            d_f=self.fiber.diameter,
            v_f0=self.v_f0,
            v_f_max=self.end,
            loading=(loading.K_p, loading.gamma),
            unloading=(unloading.K_p, unloading.gamma),
            Q=self.fiber.Q,
        )

    @property
    def end(self) -> float:
        """Volume fraction at the end of the loop [-]."""
        if self.v_f_max is None:
            raise InvalidParameter(
                f'felt "{self.name}": v_f_max is missing, expected the largest volume fraction '
                "of the loop"
            )
        return self.v_f_max

    def to_toml(self) -> str:
        """Text of a file that :func:`load_material` can read."""
        import tomlkit

        doc = tomlkit.document()
        if self.synthetic:
            doc.add(tomlkit.comment("SYNTHETIC: chosen to be plausible, not measured."))
        doc["schema"] = 1
        doc["name"] = self.name
        doc["about"] = self.about
        doc["v_f0"] = self.v_f0
        if self.v_f_max is not None:
            doc["v_f_max"] = self.v_f_max
        if self.source:
            doc["source"] = dict(self.source)
        units = {
            "diameter": (1e-6, "um"),
            "withdrawal_force": (1.0, "N/m"),
            "young_modulus": (1.0, "Pa"),
        }
        table = tomlkit.table()
        for key, value in self.fiber.model_dump(exclude_none=True).items():
            if key in units:
                scale, unit = units[key]
                table[key] = _quantity(float(f"{value / scale:.12g}"), unit)
            else:
                table[key] = value
        doc["fiber"] = table
        for which, branch in (("loading", self.loading), ("unloading", self.unloading)):
            if branch is not None:
                table = tomlkit.table()
                table["K_p"] = _quantity(branch.K_p, "Pa")
                table["gamma"] = branch.gamma
                doc[which] = table
        if self.critical_angles is not None:
            table = tomlkit.table()
            table["unit"] = "rad"
            for key in ("v_f", "loading", "unloading"):
                table[key] = [float(f"{x:.8g}") for x in getattr(self.critical_angles, key)]
            doc["critical_angles"] = table
        return tomlkit.dumps(doc)


def _quantity(value: float, unit: str) -> Any:
    import tomlkit

    table = tomlkit.inline_table()
    table["value"] = value
    table["unit"] = unit
    return table


def sliding_at_pressure(
    material: FeltMaterial, v_f: Array, pressure: Array, kind: str, gamma: float
) -> Array:
    """Columns of ``_core.sliding_at_pressure`` for a material and one value of gamma."""
    f = material.fiber
    return np.asarray(
        _core.sliding_at_pressure(
            v_f, pressure, kind, f.friction, f.withdrawal_force, f.diameter, material.v_f0, gamma,
            f.Q,
        )
    )  # fmt: skip


def packaged_materials() -> tuple[str, ...]:
    """Names of the packaged materials."""
    return tuple(params.names("felts"))


@checked
def load_material(name_or_path: str | Path) -> FeltMaterial:
    """Read a felt: the name of a packaged one, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        The file has faults, all in one message, or the name is unknown.

    Examples
    --------
    The pressure [Pa] of a packaged felt at a volume fraction of 50 %:

    >>> from feltmb import felt
    >>> material = felt.load_material("synthetic_hammer")
    >>> round(float(material.pressure("loading", [0.5])[0]))
    1210843
    """
    path = params.find(name_or_path, "felts", "felt")
    material = validated(FeltMaterial, read_toml(path), path.name)
    if material.fiber.friction == 0.0 and material.loading is not None:
        raise InvalidParameter(
            f"{path.name}: fiber.friction: got 0, must be > 0 (without friction between the "
            "fibers the stress of the sticking contacts is bounded)"
        )
    return material
