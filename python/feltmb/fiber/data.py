"""Measured compression curves: CSV with units in the header."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.errors import DataError
from feltmb.files import is_file, plain_text
from feltmb.units.quantity import shortened

Array = NDArray[np.float64]

_UNITS: dict[str, dict[str, float]] = {
    "v_f": {"-": 1.0, "1": 1.0, "": 1.0, "%": 0.01},
    "strain": {"-": 1.0, "1": 1.0, "": 1.0, "%": 0.01},
    "thickness": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6},
    "pressure": {
        "Pa": 1.0,
        "kPa": 1e3,
        "MPa": 1e6,
        "N/m^2": 1.0,
        "N/mm^2": 1e6,
        "N/cm^2": 1e4,
        "bar": 1e5,
    },
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "branch": {"": 1.0, "-": 1.0},
}
_FRACTIONS = ("v_f", "strain", "thickness")
_LOADS = ("pressure", "force")


@dataclass(frozen=True)
class CompressionData:
    """One compression test."""

    v_f: Array
    """Volume fraction [-]."""
    pressure: Array
    """Pressure [Pa], compression positive."""
    loading: NDArray[np.bool_]
    """True on the loading branch, False while unloading."""
    v_f0: float
    """Volume fraction of zero pressure [-]."""
    name: str = "data"

    def branch(self, which: str) -> CompressionData:
        """Return only ``"loading"`` or ``"unloading"`` samples (``"both"``: everything)."""
        if which not in ("loading", "unloading", "both"):
            raise DataError(f'{self.name}: branch = "{which}", expected loading, unloading or both')
        if which == "both":
            return self
        keep = self.loading if which == "loading" else ~self.loading
        if not keep.any():
            raise DataError(f"{self.name}: no samples on the {which} branch, expected at least 1")
        return CompressionData(
            self.v_f[keep], self.pressure[keep], self.loading[keep], self.v_f0, self.name
        )


def _listed(faults: list[str], most: int = 20) -> str:
    more = [f"... and {len(faults) - most} more"] if len(faults) > most else []
    return "\n".join([*(plain_text(shortened(f, 1000)) for f in faults[:most]), *more])


def read_compression(
    path: str | Path,
    *,
    v_f0: float | None = None,
    thickness0: float | None = None,
    area: float | None = None,
) -> CompressionData:
    """Read a compression test from CSV.

    The header names quantity and unit: one of ``v_f [-]``, ``strain [-]`` or ``[%]`` (engineering,
    compression positive), ``thickness [mm]``; one of ``pressure [kPa]`` (Pa, MPa, N/mm^2, bar) or
    ``force [N]``; optionally ``branch`` with the words loading and unloading. Without ``branch``
    the samples up to the largest volume fraction are loading, the rest unloading. Lines starting
    with ``#`` are comments. Other columns are ignored.

    Parameters
    ----------
    path
        CSV file, comma, semicolon or tab separated, decimal point.
    v_f0
        Volume fraction of zero pressure [-]; needed with strain or thickness. With ``v_f``
        data the smallest value of the file when not given.
    thickness0
        Thickness at ``v_f0`` [m]; the largest of the file when not given.
    area
        Sample area [m^2]; needed with force.

    Raises
    ------
    DataError
        Naming every fault of the file with its line.
    """
    file = Path(path)
    if not is_file(file):
        raise DataError(f"{file}: there is no such file, expected a CSV file")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{file}: cannot be read as UTF-8 text ({error})") from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    faults: list[str] = []

    def fault(message: str) -> None:
        faults.append(f"{file}: {message}")

    if not lines:
        raise DataError(f"{file}: is empty, expected a header line with units and data")
    number, header_line = lines[0]
    separator = max(",;\t", key=header_line.count)
    header = [h.strip() for h in header_line.split(separator)]
    columns: dict[str, tuple[int, float]] = {}
    for position, title in enumerate(header):
        match = re.fullmatch(r"([^\[\(]*?)\s*(?:[\[\(]\s*(.*?)\s*[\]\)])?", title)
        key = match.group(1).strip().lower().replace(" ", "_") if match else title
        unit = (match.group(2) or "") if match else ""
        if key not in _UNITS:
            continue
        if key in columns:
            fault(f'line {number}: column "{key}" appears twice, expected once')
        if unit not in _UNITS[key]:
            expected = ", ".join(u for u in _UNITS[key] if u)
            fault(
                f'line {number}: column "{title}" has unit "{unit}", expected one of {expected} '
                f'(write it as "{key} [{expected.split(", ")[0]}]")'
            )
            continue
        columns[key] = (position, _UNITS[key][unit])
    fractions = [c for c in _FRACTIONS if c in columns]
    loads = [c for c in _LOADS if c in columns]
    seen = ", ".join(f'"{h}"' for h in header)
    if len(fractions) != 1 and not faults:
        fault(f"line {number}: columns {seen}, expected exactly one of v_f, strain, thickness")
    if len(loads) != 1 and not faults:
        fault(f"line {number}: columns {seen}, expected exactly one of pressure, force")
    if faults:
        raise DataError(_listed(faults))

    fraction, load = fractions[0], loads[0]
    rows: list[tuple[float, float]] = []
    branches: list[str] = []
    for number, line in lines[1:]:
        try:
            cells = next(csv.reader([line], delimiter=separator))
        except csv.Error as error:  # such as a cell of more than 131 072 letters
            fault(f"line {number}: {error}")
            continue
        values = []
        for key in (fraction, load):
            position, scale = columns[key]
            cell = cells[position].strip() if position < len(cells) else ""
            try:
                value = float(cell) * scale
            except ValueError:
                hint = " (decimal point expected)" if re.fullmatch(r"-?\d+,\d+", cell) else ""
                fault(f'line {number}: {key} = "{cell}", expected a number{hint}')
                continue
            if not math.isfinite(value):
                fault(f"line {number}: {key} = {cell}, expected a finite number")
                continue
            values.append(value)
        if "branch" in columns:
            position = columns["branch"][0]
            word = cells[position].strip().lower() if position < len(cells) else ""
            if word not in ("loading", "unloading"):
                fault(f'line {number}: branch = "{word}", expected loading or unloading')
            branches.append(word)
        if len(values) == 2:
            rows.append((values[0], values[1]))
    if len(rows) < 3 and not faults:
        fault(f"{len(rows)} samples, expected at least 3")
    if load == "force" and area is None:
        fault("force without a sample area, expected area in m^2 (--area)")
    if area is not None and not 1e-10 <= area <= 100.0:
        fault(f"area = {area:.6g} m^2, expected 1e-10 to 100")
    if fraction != "v_f" and v_f0 is None:
        fault(f"{fraction} without a reference, expected v_f0 (--v-f0)")
    if v_f0 is not None and not 0 < v_f0 < 1:
        fault(f"v_f0 = {v_f0:.6g}, expected > 0 and < 1")
    if faults:
        raise DataError(_listed(faults))

    table = np.array(rows)
    x, p = table[:, 0], table[:, 1]
    if load == "force":
        assert area is not None
        p = p / area
    if fraction == "v_f":
        v = x
        reference = float(np.min(v)) if v_f0 is None else v_f0
    else:
        assert v_f0 is not None
        reference = v_f0
        if fraction == "strain":
            if not np.all(x < 1):
                fault(f"strain up to {np.max(x):.6g}, expected < 1 (compression positive)")
            v = v_f0 / np.where(x < 1, 1 - x, np.nan)
        else:
            h0 = float(np.max(x)) if thickness0 is None else thickness0
            if not (h0 > 0 and np.all(x > 0)):
                fault(f"thickness down to {np.min(x):.6g} m, expected > 0")
            with np.errstate(over="ignore"):  # told below
                v = v_f0 * h0 / np.where(x > 0, x, np.nan)
    if not faults and not np.all((v > 0) & (v <= 1)):
        fault(f"v_f from {np.min(v):.6g} to {np.max(v):.6g}, expected > 0 and <= 1")
    if not faults and np.all(p <= 0):
        fault("no positive pressure, expected compression to be positive")
    if faults:
        raise DataError(_listed(faults))
    if branches:
        loading = np.array([word == "loading" for word in branches])
    else:
        loading = np.arange(len(v)) <= int(np.argmax(v))
    return CompressionData(v, p, loading, reference, file.stem)
