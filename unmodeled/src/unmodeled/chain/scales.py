"""Errors of the scale of a sensor or an input: values without memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unmodeled.chain import Array, Fault, Run, Signal, register


class Gain(Fault):
    """reading = (1 + size) y; a wrong sign is a size of -2."""

    name, place = "gain", 3.0
    sensor = ("The sensor has another gain.", "Calibrate the sensor.")
    input = ("The record of the input has another gain.", "Calibrate the input.")
    each = "gain", "Calibrate the sensor before each record."

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray((1.0 + size) * y)

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return reading / (1.0 + size)

    def noise(self, run: Run, size: float) -> float:
        return 1.0 / abs(1.0 + size)

    def fields(self, signal: Signal) -> dict[str, Any]:
        # A record without this input contains no information about it.
        return {"scale": 0.05, **({"lower": -0.999} if signal.is_input else {})}


class Offset(Fault):
    """reading = y + size."""

    name, unit, place, always = "offset", "", 4.0, True
    sensor = ("The sensor has an offset.", "Zero the sensor.")
    input = ("The record of the input has an offset.", "Zero the input.")
    each = "zero", "Zero the sensor before each record."

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y + size)

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return reading - size

    def fields(self, signal: Signal) -> dict[str, Any]:
        spread = float(np.nanstd(signal.values)) or 1.0
        return {"scale": 0.02 * signal.size if signal.is_input else 0.05 * spread}


@dataclass(frozen=True)
class Nonlinearity(Fault):
    """reading = y + size y^2 / level ("even"), or y + size y |y| / level ("odd")."""

    level: float = 1.0
    """Reading at which a size of 1 doubles it."""
    name, stated, drive = "nonlinearity", False, True
    sensor = ("The sensor is not linear.", "Calibrate the sensor over its range.")
    input = (
        "What arrives of the input is not in proportion to it.",
        "Calibrate the drive over its range.",
    )

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y + size * y * (np.abs(y) if shape == "odd" else y) / self.level)

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        return change * (1.0 + 2.0 * size * (np.abs(y) if shape == "odd" else y) / self.level)

    def fields(self, signal: Signal) -> dict[str, Any]:
        return {"scale": 0.05, "shapes": ("odd", "even")}

    def of(self, signal: Signal) -> Nonlinearity:
        most = float(np.nanmax(np.abs(signal.values))) or 1.0
        return Nonlinearity(signal.size if signal.is_input else most)


class _Lost(Fault):
    """reading = y - size part(y), where the part begins at a level, the shape."""

    stated, drive = False, True

    def part(self, y: Array, shape: Any) -> Array:
        """Part of the signal that is lost at size 1."""
        raise NotImplementedError

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray(y - size * self.part(y, shape))

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        # The part is linear between its kinks: its slope is 0 or 1.
        h = 1e-7 * float(np.max(np.abs(y[np.isfinite(y)]), initial=1e-300))
        slope = np.round((self.part(y + h, shape) - self.part(y - h, shape)) / (2.0 * h))
        return change * (1.0 - size * slope)

    def fields(self, signal: Signal) -> dict[str, Any]:
        named = f"level{'' if signal.unit == '1' else f' [{signal.unit}]'}"
        return {"scale": 0.3, "sign": 1, "upper": 1.0, "shape_names": (named,)}


class Saturation(_Lost):
    """A signal that grows less beyond a level: the share 1 - size of what is beyond it.

    The shape is a level of both signs, or ("highest", level) or ("lowest", level): a sensor at the
    end of its range.
    """

    name = "saturation"
    sensor = (
        "The sensor is at the end of its range.",
        "Move the sensor, or use one with a larger range.",
    )
    input = ("Large inputs do not arrive in full.", "Lower the drive, or model its limit.")

    def part(self, y: Array, shape: Any) -> Array:
        if not isinstance(shape, tuple):
            return np.asarray(y - np.clip(y, -shape, shape))
        end, level = shape
        return np.asarray((np.maximum if end == "highest" else np.minimum)(y - level, 0.0))

    def fields(self, signal: Signal) -> dict[str, Any]:
        own = super().fields(signal)
        if signal.is_input:
            return {**own, "shapes": tuple(signal.size * f for f in (0.5, 0.8))}
        low, high = float(np.nanmin(signal.values)), float(np.nanmax(signal.values))
        width = high - low or 1.0
        ends = [("highest", high - f * width) for f in (0.02, 0.25)]
        ends += [("lowest", low + f * width) for f in (0.02, 0.25)]
        levels = [level for _, level in ends]
        named = f"reading{'' if signal.unit == '1' else f' [{signal.unit}]'}"
        return {
            **own,
            "shapes": tuple(ends),
            "shape_names": ("end", named),
            "shape_zero": 0.5 * (max(levels) + min(levels)),
        }


#: Largest values of the other sign that the noise of a signal without a sign has [its size].
SIGNLESS = 0.1


def one_signed(values: Array) -> int:
    """Sign of values that never have the other one, but for noise; 0: they have both."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return (low > -SIGNLESS * high) - (high < -SIGNLESS * low)


class AbsoluteValue(_Lost):
    """The sign of the signal is lost: size 1 is its absolute value."""

    name, place = "absolute value", 6.0
    sensor = ("The sensor does not show the sign.", "Use a sensor that shows the direction.")

    def part(self, y: Array, shape: Any) -> Array:
        return np.asarray(y - np.abs(y))

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        return change * (1.0 - size * (1.0 - np.sign(y)))

    def fields(self, signal: Signal) -> dict[str, Any]:
        return {"scale": 0.3, "sign": 1, "upper": 1.0}

    def suits(self, signal: Signal) -> bool:
        return one_signed(signal.values) == 1


class DeadZone(_Lost):
    """A signal that acts less within a level of both signs: size 1 is a full dead zone.

    The shape is a level about zero, or (neutral, level) for a signal that never reaches zero, such
    as 4 to 20 mA.
    """

    name = "dead zone"
    input = ("Small inputs do not arrive in full.", "Model the dead zone.")

    def part(self, y: Array, shape: Any) -> Array:
        neutral, level = shape if isinstance(shape, tuple) else (0.0, shape)
        return np.asarray(np.clip(y - neutral, -level, level))

    def fields(self, signal: Signal) -> dict[str, Any]:
        own = super().fields(signal)
        low, high = float(np.nanmin(signal.values)), float(np.nanmax(signal.values))
        if not low * high > 0.0 or low == high:
            return {**own, "shapes": tuple(signal.size * f for f in (0.05, 0.2))}
        named = own["shape_names"][0]
        neutral = [low + f * (high - low) for f in (0.4, 0.6)]
        levels = [f * (high - low) for f in (0.03, 0.1)]
        return {
            **own,
            "shapes": tuple((n, v) for n in neutral for v in levels),
            "shape_names": (f"neutral{named.removeprefix('level')}", named),
        }


class Wrap(Fault):
    """A counter or an angle with a period, the size: the reading is in [-size/2, size/2)."""

    name, unit, place = "wrap", "", 9.0

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        return np.asarray((y + 0.5 * size) % size - 0.5 * size)

    def by_size(self, run: Run, y: Array, size: float, shape: Any = None) -> Array:
        return -np.floor(y / size + 0.5) if size else 0.0 * y

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        return change

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        return np.array([unwrapped(row, size) for row in reading])


def unwrapped(values: Array, period: float) -> Array:
    """Values in which a jump by more than half a period is a step in the other direction.

    NaN is a missing value.
    """
    known = np.isfinite(values)
    out = values.copy()
    out[known] = np.unwrap(values[known], period=period)
    return out


for _fault in (Gain(), Nonlinearity(), Offset(), Saturation(), AbsoluteValue(), DeadZone(), Wrap()):
    register(_fault)
