"""Converts channels of a record to displacements from rest, for any zero of the measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Record
from feltmb.data.smoothing import NEAR, start_of
from feltmb.fit.noise import rounding_error

__all__ = ["from_rest"]

#: Relative rounding error of an absolute coordinate in a file.
ROUNDED = 1e-3


def from_rest(
    record: Record, rest: Mapping[str, float], model: str
) -> tuple[Record, tuple[str, ...]]:
    """The record with displacements from rest, and a description of the changes.

    Parameters
    ----------
    rest
        Absolute coordinate at rest, for channels that have one [m].
    model
        Name of the model, for the notes.
    """
    starts = {n: _Start.of(record, n, rest[n]) for n in record.outputs if n in rest}
    clear = {s.kind for s in starts.values() if not s.told}
    frame = "absolute" if "absolute" in clear and "rest" not in clear else "rest"
    outputs, sensors = dict(record.outputs), dict(record.sensors)
    notes: list[str] = []
    absolute: dict[bool, list[str]] = {True: [], False: []}
    for name, start in starts.items():
        kind = frame if start.kind == "either" else start.kind
        if not kind:
            notes.append(
                f"{record.name}: {name} starts at {start.value:.6g} m: this is neither zero "
                f"nor the rest value of {model} ({start.rest:.6g} m); it is treated as a "
                f"displacement from rest (--origin {name}=start: its first value is rest; "
                f"--reference {name}=absolute; the same names are keys of the TOML)"
            )
        if kind != "absolute":
            continue
        absolute[start.told].append(name)
        zero = start.rest
        if abs(start.value - start.rest) > start.near:
            zero = start.value
            notes.append(
                f"{record.name}: {name} starts at {start.value:.6g} m, the rest value of {model} "
                f"is {start.rest:.6g} m: the first value of the record is used as rest value"
            )
        outputs[name] = record.outputs[name] - zero
        sensors[name] = replace(sensors[name], reference="rest")
    for told, names in absolute.items():
        if names:
            why = "as specified" if told else f"they start at the rest values of {model}"
            notes.insert(
                0,
                f"{record.name}: {', '.join(names)}: absolute coordinates ({why}); compared as "
                "displacements from rest",
            )
    if not any(absolute.values()):
        return record, tuple(notes)
    return replace(record, outputs=outputs, sensors=sensors), tuple(notes)


@dataclass(frozen=True)
class _Start:
    """Start value of a channel, and the zero that follows from it."""

    value: float
    rest: float
    near: float
    """Largest distance from the rest position of the model that counts as a start at rest [m]."""
    kind: str
    """"rest", "absolute", "either" (both are equal within the noise), or "" (neither)."""
    told: bool

    @classmethod
    def of(cls, record: Record, name: str, rest: float) -> _Start:
        sensor, values = record.sensors[name], record.outputs[name]
        sigma = math.hypot(sensor.sigma or 0.0, rounding_error(sensor.quantum))
        start = start_of(values, sigma)
        finite = np.abs(values[np.isfinite(values)])
        near = max(NEAR * sigma, ROUNDED * abs(rest))
        still = max(NEAR * sigma, ROUNDED * float(np.max(finite, initial=0.0)))
        at_zero, at_rest = abs(start) <= still, abs(start - rest) <= near
        kind = "rest" if at_zero or not math.isfinite(start) else "absolute" if at_rest else ""
        if at_zero and at_rest:
            kind = "either"
        return cls(start, rest, near, sensor.reference or kind, bool(sensor.reference))
