"""Columns of compression tests: files of testing machines, with units in the header."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.data.columns import read_columns
from feltmb.data.mapping import values_in
from feltmb.data.series import Columns, plain_name
from feltmb.errors import DataError
from feltmb.units.quantity import fault_text, shortened

__all__ = ["COMPRESSIONS", "LOADS", "CompressionColumns", "read_test"]

Array = NDArray[np.float64]

#: Quantity -> SI unit, in the order in which they are preferred.
COMPRESSIONS = {"v_f": "1", "strain": "1", "thickness": "m", "displacement": "m"}
LOADS = {"pressure": "Pa", "force": "N"}
#: Quantities that decrease under load.
_DECREASING = ("thickness",)


@dataclass(frozen=True)
class CompressionColumns:
    """Compression and load of a test, in the order of the file."""

    compression: str
    """v_f, strain, thickness or displacement."""
    load: str
    """pressure or force."""
    x: Array
    """Values of the compression [1 or m]."""
    loads: Array
    """Values of the load [Pa or N], compression positive."""
    branches: list[str]
    """Words loading and unloading; empty if the file has no column for them."""
    notes: tuple[str, ...]
    """Columns of the same kind that are not used."""


def read_test(
    path: Path, compressions: Sequence[str] = (*COMPRESSIONS,), loads: Sequence[str] = (*LOADS,)
) -> CompressionColumns:
    """Read compression and load of a test.

    Parameters
    ----------
    path
        File in any format of measured records.
    compressions, loads
        Quantities that may be used; of several in the file, the first one here.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message.
    """
    columns = read_columns(path, strict=False)
    faults: list[str] = []
    notes: list[str] = []
    found = []
    for units, wanted in ((COMPRESSIONS, compressions), (LOADS, loads)):
        quantity, column = _choose(columns, units, wanted, faults, notes)
        values = values_in(columns, column, units[quantity], faults) if column else np.zeros(0)
        found.append((quantity, column, values))
    (quantity, column, x), (load, load_column, p) = found
    words = next((c for c in (*columns.texts, *columns.values) if plain_name(c) == "branch"), "")
    branches = [w.strip().lower() for w in columns.texts.get(words, [])]
    faults += columns.faults([column, load_column], complete=True)
    if words and not branches:
        faults.append("column branch has numbers, expected the words loading and unloading")
    faults += [
        f'{columns.place(i)}: branch = "{shortened(word)}", expected loading or unloading'
        for i, word in enumerate(branches)
        if word not in ("loading", "unloading")
    ]
    if not faults and x.size < 3:
        faults = [f"{x.size} samples, expected at least 3"]
    if not faults:
        x, p = _positive(quantity, x, load, p, faults, notes)
    if faults:
        raise DataError(fault_text(str(path), faults, most=20))
    return CompressionColumns(quantity, load, x, p, branches, tuple(notes))


def _choose(
    columns: Columns,
    units: dict[str, str],
    wanted: Sequence[str],
    faults: list[str],
    notes: list[str],
) -> tuple[str, str]:
    """Quantity and its column; empty with a fault if there is none."""
    named = {q: columns.called(q) for q in units}
    quantity = next((q for q in wanted if named[q]), "")
    if not quantity:
        faults.append(f"expected a column {' or '.join(wanted)}; there are {columns}")
        return "", ""
    headings = [columns.headings.get(c, c) for c in named[quantity]]
    if len(headings) > 1:
        faults.append(
            f"columns {shortened(', '.join(headings), 300)} are each a {quantity}, expected one: "
            "rename or remove the others"
        )
    others = [columns.headings.get(c, c) for q in units if q != quantity for c in named[q]]
    if others:
        notes.append(f"{headings[0]} is used, not {shortened(', '.join(others), 300)}")
    return quantity, named[quantity][0]


def _positive(
    quantity: str, x: Array, load: str, p: Array, faults: list[str], notes: list[str]
) -> tuple[Array, Array]:
    """Compression and load with positive signs; machines for tension have both negative."""
    turned = []
    if not np.max(p) > -np.min(p):
        turned, p = [load], -p
    along = float(np.sum((x - np.mean(x)) * p))
    decreasing = quantity in _DECREASING
    if along < 0.0 and turned and not decreasing:
        turned, x = [quantity, *turned], -x
    elif (along > 0.0) == decreasing and along:
        does, sign = ("increases", "decrease") if decreasing else ("decreases", "increase")
        faults.append(f"{quantity} {does} with the load, expected it to {sign} in compression")
    if not np.max(p) > 0.0:
        faults.append(f"{load} is 0, expected a load")
    if turned:
        notes.append(
            f"{' and '.join(turned)} decrease{'s' if len(turned) == 1 else ''} in compression: the "
            "sign is reversed"
        )
    return x, p
