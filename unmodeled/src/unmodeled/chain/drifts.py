"""Errors that grow with the time of a record, and parts of other signals in a reading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unmodeled.chain import Array, Fault, Run, Signal, register
from unmodeled.chain.times import low_passed

#: Change that one would expect over a record, as a share of the gain or of the size [1].
OVER_A_RECORD = 0.05


def _since(run: Run, y: Array) -> Array:
    """Time since the first sample [s], (n,)."""
    return np.asarray(run.time[: y.shape[1]] - run.time[0])


class GainDrift(Fault):
    """reading(t) = (1 + size (t - t_0)) y, with the time counted from the first sample."""

    name, unit, place, stated, drive = "gain drift", "1/s", 3.5, False, True
    sensor = "The gain of the sensor drifts.", "Calibrate the sensor before and after a record."
    input = (
        "What arrives of the input grows or fades during a record, as with a battery that sags.",
        "Measure what acts on the machine, or model the supply.",
    )

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y * (1.0 + size * _since(run, y)))

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return np.asarray(reading / (1.0 + size * _since(run, reading)))

    def fields(self, signal: Signal) -> dict[str, Any]:
        return {"scale": OVER_A_RECORD / (signal.values.size * signal.interval)}


class GainFade(Fault):
    """reading(t) = (1 + size (1 - exp(-(t - t_0) / shape))) y: a gain that settles at another one.

    The shape is its time constant. It is a candidate of inputs only: with a share and a time that
    are free, the gain of a sensor imitates what acts on the machine, such as the drag of a fall.
    """

    name, place, stated, drive = "gain fade", 3.6, False, True
    input = (
        "What arrives of the input settles at another share, as with a motor that warms up.",
        "Measure what acts on the machine, or model the warming.",
    )

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y * (1.0 - size * np.expm1(-_since(run, y) / shape)))

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return np.asarray(reading / (1.0 - size * np.expm1(-_since(run, reading) / shape)))

    def fields(self, signal: Signal) -> dict[str, Any]:
        span = signal.values.size * signal.interval
        return {
            "scale": OVER_A_RECORD,
            "shapes": (0.1 * span, 0.4 * span),
            "shape_names": ("time [s]",),
        }


class ZeroDrift(Fault):
    """reading(t) = y + size (t - t_0), with the time counted from the first sample."""

    name, unit, place, stated = "zero drift", "", 4.5, False
    sensor = "The zero of the sensor drifts.", "Zero the sensor, and let it warm up."

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y + size * _since(run, y))

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return np.asarray(reading - size * _since(run, reading))

    def fields(self, signal: Signal) -> dict[str, Any]:
        span = signal.values.size * signal.interval
        spread = float(np.nanstd(signal.values)) or 1.0
        unit = "1/s" if signal.unit == "1" else f"{signal.unit}/s"
        return {"scale": OVER_A_RECORD * spread / span, "unit": unit}


@dataclass(frozen=True)
class Part(Fault):
    """reading = y + size w, where w is another signal of the record; of a shape: after a lag."""

    other: str = ""
    name, unit, place, stated = "part", "", 3.2, False

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y + size * self._other(run, y, shape))

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        return change

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return np.asarray(reading - size * self._other(run, reading, shape))

    def _other(self, run: Run, y: Array, shape: Any) -> Array:
        """The other signal, (n,): as measured, between its samples and after its end linear."""
        values = run.inputs[self.other] if self.other in run.inputs else run.outputs.get(self.other)
        time = run.time[: y.shape[1]]
        if values is None or not (known := np.isfinite(values)).any():
            return np.zeros(y.shape[1])
        out = np.interp(time, run.time[: values.size][known], values[known])
        return np.asarray(out if shape is None else low_passed(time, out[None], shape, out[:1])[0])


for _fault in (GainDrift(), GainFade(), ZeroDrift()):
    register(_fault)
