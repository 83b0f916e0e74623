"""Numbers for a page, short: 16 bit integers and 32 bit floats as bytes, in a text or beside it."""

from __future__ import annotations

import base64
import json
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
    which is 1/65534 of the range of the column. A constant column has ``step`` 0 and no integers.
    The data are ``low`` and then ``step`` of all columns as 64 bit floats, and then the integers of
    column after column, all little-endian.
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
    step[(step <= 0) & ~constant] = 1.0
    scaled = np.zeros((n, m))
    np.divide(table - low, step, out=scaled, where=good & (step > 0))
    whole = np.where(good, np.clip(np.round(scaled), 0, _STEPS) - 32767, MISSING)
    kept = whole[:, ~constant].T.astype("<i2")
    scale = np.concatenate([low, np.where(constant, 0.0, step)]).astype("<f8")
    return {"n": n, "m": m, "data": scale.tobytes() + kept.tobytes()}


def pack_times(time: npt.ArrayLike) -> dict[str, Any]:
    """Times: the first one exactly, and the others as 32 bit floats relative to it."""
    t = np.asarray(time, dtype=float)
    first = float(t[0]) if t.size else 0.0
    return {"first": first, "data": (t - first).astype("<f4").tobytes()}


def pack_points(lines: Sequence[Array]) -> dict[str, Any]:
    """Plane lines (n, 2) one after the other as 32 bit floats, and how many points each has."""
    every = np.concatenate([np.zeros((0, 2)), *lines]).astype("<f4")
    return {"counts": [len(line) for line in lines], "data": every.tobytes()}


def json_text(data: Any) -> str:
    """JSON in which packed numbers are base64."""
    return json.dumps(
        data,
        separators=(",", ":"),
        allow_nan=False,
        default=lambda packed: base64.b64encode(packed).decode("ascii"),
    )


def binary_message(data: Any) -> bytes:
    """Length of a JSON text (32 bit, little-endian), the text, and the packed numbers.

    In the text, packed numbers are their start after the text and their length [bytes].
    """
    parts: list[bytes] = []

    def put(packed: bytes) -> list[int]:
        start = sum(map(len, parts))
        parts.append(packed)
        return [start, len(packed)]

    text = json.dumps(data, separators=(",", ":"), default=put).encode()
    return b"".join([len(text).to_bytes(4, "little"), text, *parts])
