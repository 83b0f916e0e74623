"""Tests of single parts as data, for example the weight or the stiffness of one part.

::

    [measured."felt.04"]
    value = "3 %"
    sd = "2 %"
    how = "compression test of 2026-11-20"
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.files import write_text
from feltmb.fit.model import Model
from feltmb.gap.tables import TableReader
from feltmb.units.quantity import Schema

__all__ = ["Measured", "measured_toml", "read_measured", "with_measured"]

M = TypeVar("M", bound=Model)


@checked
@dataclass(frozen=True, kw_only=True)
class Measured:
    """Result of a separate test of a part for one parameter; it replaces the tolerance."""

    parameter: str
    value: float
    """[unit of the parameter]"""
    sd: float
    """Standard deviation [unit of the parameter]."""
    how: str = ""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise InvalidParameter(
                f"measured {self.parameter}: value = {self.value!r}, expected a finite number"
            )
        if not 0.0 < self.sd < math.inf:
            raise InvalidParameter(
                f"measured {self.parameter}: sd = {self.sd!r}, expected finite, > 0"
            )


class _Entry(Schema):
    value: float | str
    sd: float | str
    how: str = ""


class _MeasuredFile(Schema):
    measured: dict[str, _Entry]


@checked
def read_measured(path: str | Path, model: Model) -> tuple[Measured, ...]:
    """Read ``[measured.PARAMETER]`` tables with ``value``, ``sd`` and ``how``.

    Numbers are in the unit of the parameter, or texts with a unit; a share may be ``"3 %"``.

    Raises
    ------
    DataError
        All faults of the file in one message: unknown names, then keys and types, then numbers. The
        numbers of an unknown name are not checked, because their unit is unknown.
    """
    read = TableReader(path, _MeasuredFile)
    units = {p.name: p.unit for p in model.parameters}
    table = read.raw.get("measured")
    read.check(
        f"measured.{name}: no parameter of {model.name}; there are {', '.join(units)}"
        for name in (table if isinstance(table, dict) else {})
        if name not in units
    )
    out = []
    for name, where, entry in read.entries("measured"):
        if name not in units:
            continue
        value, sd = (read.number(where, entry, key, units[name]) for key in ("value", "sd"))
        how = {"how": entry["how"]} if "how" in entry else {}
        out.append(
            read.made(
                ("measured", name),
                f"{where}: ",
                Measured,
                parameter=name,
                value=value,
                sd=sd,
                **how,
            )
        )
    read.finish()
    return tuple(m for m in out if m is not None)


@checked
def with_measured(model: Model, measured: Sequence[Measured]) -> Model:
    """Copy of the model with the values and uncertainties of tests of parts.

    Several tests of one parameter are combined.

    Raises
    ------
    InvalidParameter
        A parameter that the model does not have, or a value beyond its limits.
    """
    parameters = {p.name: p for p in model.parameters}
    faults: list[str] = []
    by_parameter: dict[str, list[Measured]] = {}
    for m in measured:
        if m.parameter not in parameters:
            faults.append(
                f"{m.parameter}: no parameter of {model.name}; there are {', '.join(parameters)}"
            )
            continue
        by_parameter.setdefault(m.parameter, []).append(m)
    for name, tests in by_parameter.items():
        p, best = parameters[name], min(m.sd for m in tests)
        weights = [(best / m.sd) ** 2 for m in tests]  # at most 1, so that no square overflows
        value = sum(w * m.value for w, m in zip(weights, tests, strict=True)) / sum(weights)
        if not p.lower <= value <= p.upper:
            faults.append(
                f"{name}: got {value:g} {p.unit}, expected a value in [{p.lower:g}, {p.upper:g}]"
            )
            continue
        parameters[name] = replace(p, value=value, sd=best / math.sqrt(sum(weights)))
    if faults:
        raise InvalidParameter("measured: " + "; ".join(faults))
    if not by_parameter:
        return model
    out = copy.copy(model)
    out.parameters = tuple(parameters.values())
    return out


@checked
def measured_toml(measured: Sequence[Measured], path: str | Path, *, force: bool = False) -> Path:
    """Write tests of parts to a file that :func:`read_measured` can read.

    Parameters
    ----------
    measured
        Tests of parts.
    path
        File to be written.
    force
        Replace a file that exists.

    Returns
    -------
    pathlib.Path
        The file.
    """
    import tomlkit

    tables = {
        m.parameter: {k: getattr(m, k) for k in ("value", "sd", "how") if getattr(m, k) != ""}
        for m in measured
    }
    return write_text(Path(path), tomlkit.dumps({"measured": tables}), force=force)
