"""Forces that are not zero before the motion: perhaps the zero of a load cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feltmb.data import Array, Record
from feltmb.data.smoothing import LEAST_SAMPLES, NEAR, noise_of_record, start_of, still_samples
from feltmb.gap.criteria import TARE
from feltmb.units import unit_suffix

__all__ = ["forces_before_motion"]

FORCES = ("N", "N m")


def forces_before_motion(records: Sequence[Record]) -> list[str]:
    """One warning for each force that is not zero while all channels of a record are still."""
    found: dict[str, list[tuple[Record, float]]] = {}
    for record in records:
        signals = {**record.inputs, **record.outputs}
        noise = {n: _noise(x) for n, x in signals.items() if np.isfinite(x).any()}
        forces = [n for n in noise if _unit(record, n) in FORCES]
        if not forces:
            continue
        still = min(still_samples(signals[n], sigma) for n, sigma in noise.items())
        if not LEAST_SAMPLES <= still < record.samples:
            continue
        for name in forces:
            level = start_of(signals[name][:still], noise[name])
            change = np.nanmax(np.abs(signals[name] - level))
            if abs(level) > max(TARE * change, NEAR * noise[name]):
                found.setdefault(name, []).append((record, level))
    return [_sentence(name, rows) for name, rows in found.items()]


def _sentence(name: str, rows: Sequence[tuple[Record, float]]) -> str:
    """What is told about a force in the records in which it is not zero before the motion."""
    record, level = max(rows, key=lambda row: abs(row[1]))
    where, more, others = f"{record.name}.{name}", "", len(rows) - 1
    if others:
        where = name
        more = f", in {record.name} and {others} other record{'s' if others > 1 else ''}"
    table = "inputs" if name in record.inputs else "outputs"
    return (
        f"{where} is {level:.3g}{unit_suffix(_unit(record, name))} before the motion{more}: if the "
        f"load cell shows this without a load, subtract it (--origin {name}=start, "
        f'origin = "start" in [{table}.{name}], in Python origins of ReadOptions)'
    )


def _unit(record: Record, name: str) -> str:
    """Unit of a signal; a force without one is in N."""
    unit = record.units.get(name, "")
    return "N" if unit in ("", "1") and name == "force" else unit


def _noise(values: Array) -> float:
    """Noise of a signal, at least one step of a digitizer that flickers at the beginning."""
    finite = values[np.isfinite(values)]
    steps = np.abs(np.diff(finite[:LEAST_SAMPLES]))
    steps = steps[steps > 0.0]
    return max(noise_of_record(finite), float(np.min(steps)) if steps.size else 0.0)
