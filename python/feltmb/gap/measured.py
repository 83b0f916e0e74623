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

from pydantic import ValidationError

from feltmb.arguments import checked
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import read_toml, write_text
from feltmb.fit.model import Model
from feltmb.gap.limits import in_unit
from feltmb.units.quantity import Schema, fault_lines, fault_text

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
        All faults of the file in one message; unknown names come first.
    """
    path = Path(path)
    raw = read_toml(path)
    table = raw.get("measured")
    entries = table if isinstance(table, dict) else {}
    units = {p.name: p.unit for p in model.parameters}
    faults = [
        f"measured.{name}: no parameter of {model.name}; there are {', '.join(units)}"
        for name in entries
        if name not in units
    ]
    # The numbers are converted before the schema is checked, so that all faults are reported.
    numbers: dict[str, dict[str, float]] = {}
    for name, entry in entries.items():
        if name not in units or not isinstance(entry, dict):
            continue
        numbers[name] = {}
        for key in ("value", "sd"):
            given = entry.get(key)
            if isinstance(given, bool) or not isinstance(given, (int, float, str)):
                continue  # the schema check reports this fault
            try:
                numbers[name][key] = in_unit(given, units[name])
            except ValueError as error:
                faults.append(f"measured.{name}.{key}: {error}")
    try:
        file = _MeasuredFile.model_validate(raw)
    except ValidationError as error:
        faults += fault_lines(error, _MeasuredFile)
        raise DataError(fault_text(path.name, faults)) from None
    out = []
    for name, values in numbers.items():
        if len(values) < 2:
            continue
        try:
            out.append(Measured(parameter=name, how=file.measured[name].how, **values))
        except InvalidParameter as error:
            faults.append(f"measured.{name}: {error}")
    if faults:
        raise DataError(fault_text(path.name, faults))
    return tuple(out)


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
