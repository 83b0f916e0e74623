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
    found: dict[tuple[str, str], list[tuple[str, float, str]]] = {}
    for record in records:
        groups = {"inputs": record.inputs, "outputs": record.outputs}
        forces = [
            (group, name)
            for group, signals in groups.items()
            for name in signals
            if np.isfinite(signals[name]).any() and _unit(record, name) in FORCES
        ]
        if not forces:
            continue
        signals = {**record.inputs, **record.outputs}
        still = min(still_samples(x, _noise(x)) for x in signals.values() if np.isfinite(x).any())
        if not LEAST_SAMPLES <= still < record.samples:
            continue
        for group, name in forces:
            level = start_of(signals[name][:still], _noise(signals[name]))
            change = np.nanmax(np.abs(signals[name] - level))
            if abs(level) > max(TARE * change, NEAR * _noise(signals[name])):
                row = record.name, level, _unit(record, name)
                found.setdefault((group, name), []).append(row)
    out = []
    for (group, name), rows in found.items():
        record_name, level, unit = max(rows, key=lambda row: abs(row[1]))
        where = f"{record_name}.{name}" if len(rows) == 1 else name
        more = "" if len(rows) == 1 else f", in {record_name} and {len(rows) - 1} other records"
        more = more.removesuffix("s") if len(rows) == 2 else more
        out.append(
            f"{where} is {level:.3g}{unit_suffix(unit)} before the motion{more}: if the load cell "
            f'shows this without a load, subtract it (--origin {name}=start, origin = "start" in '
            f"[{group}.{name}], in Python origins of ReadOptions)"
        )
    return out


def _unit(record: Record, name: str) -> str:
    """Unit of a signal; a force without one is in N."""
    sensor = record.sensors.get(name)
    unit = record.input_units.get(name, "") if sensor is None else sensor.unit
    return "N" if unit in ("", "1") and name == "force" else unit


def _noise(values: Array) -> float:
    """Noise of a signal, at least one step of a digitizer that flickers at the beginning."""
    finite = values[np.isfinite(values)]
    steps = np.abs(np.diff(finite[:LEAST_SAMPLES]))
    steps = steps[steps > 0.0]
    return max(noise_of_record(finite), float(np.min(steps)) if steps.size else 0.0)
