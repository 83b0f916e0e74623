"""Numbers as short text for the page: 16 bit integers and 32 bit floats in base64."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Integer that means a missing value (NaN or infinite).
MISSING = -32768
_STEPS = 65534  # from -32767 to 32767


def pack_columns(values: npt.ArrayLike) -> dict[str, Any]:
    """Columns of an array (n, m) as integers between the smallest and largest value of each.

    The decoded value is ``low + step * (integer + 32767)``. Its error is at most half of ``step``,
    which is 1/65534 of the range of the column. A constant column has ``step`` 0 and needs no data.
    Integers are little-endian, column after column.
    """
    table = np.asarray(values, dtype=float)
    n, m = table.shape
    good = np.isfinite(table)
    low = np.where(good, table, np.inf).min(axis=0, initial=np.inf)
    high = np.where(good, table, -np.inf).max(axis=0, initial=-np.inf)
    empty = low > high
    low, high = np.where(empty, 0.0, low), np.where(empty, 0.0, high)
    step = high / _STEPS - low / _STEPS
    constant = (step <= 0) & good.all(axis=0)
    scaled = np.zeros((n, m))
    np.divide(table - low, step, out=scaled, where=good & (step > 0))
    whole = np.where(good, np.clip(np.round(scaled), 0, _STEPS) - 32767, MISSING)
    kept = whole[:, ~constant].T.astype("<i2")
    return {
        "n": n,
        "m": m,
        "low": [float(f"{x:.9g}") for x in low],
        "step": [0.0 if c else float(f"{x:.9g}") for x, c in zip(step, constant, strict=True)],
        "fixed": [int(c) for c in constant],
        "data": base64.b64encode(kept.tobytes()).decode("ascii"),
    }


def pack_times(time: npt.ArrayLike) -> dict[str, Any]:
    """Times: the first one exactly, and the others as 32 bit floats relative to it."""
    t = np.asarray(time, dtype=float)
    first = float(t[0]) if t.size else 0.0
    data = base64.b64encode((t - first).astype("<f4").tobytes()).decode("ascii")
    return {"first": first, "data": data}


def pack_points(lines: Sequence[Array]) -> dict[str, Any]:
    """Plane lines (n, 2) one after the other as 32 bit floats, and how many points each has."""
    every = np.concatenate([np.zeros((0, 2)), *lines]).astype("<f4")
    return {
        "counts": [len(line) for line in lines],
        "data": base64.b64encode(every.tobytes()).decode("ascii"),
    }
