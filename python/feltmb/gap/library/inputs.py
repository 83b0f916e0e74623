"""Inputs: the record of one may be wrong, or the drive that it feeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from feltmb.data import Array, Record
from feltmb.fit import Effect, EffectKind
from feltmb.gap.library.curve import curve


def _input(
    name: str,
    label: str,
    change: Callable[[Array, float, Any, Record], Array],
    kind: EffectKind = "input",
    **fields: Any,
) -> Effect:
    """``change(values, size, shape, record)`` of one input.

    The kind is "input" where the record may be wrong, "force" where the drive is.
    """

    def excite(record: Record, size: float, shape: Any) -> Mapping[str, Array]:
        return {name: change(record.inputs[name], size, shape, record)}

    return Effect(
        name=f"{label} {name}", component=f"input {name}", kind=kind, excite=excite, **fields
    )


def delay_input(name: str, *, scale: float) -> Effect:
    """The input acts later by the size [s]."""
    return _input(
        name,
        "delay of input",
        lambda u, size, shape, r: np.interp(r.time - size, r.time, u),
        unit="s",
        scale=scale,
        step=0.5,
        mechanism="The input acts later than the record says.",
        remedy="Synchronize the clocks, or model the delay.",
    )


def gain_input(name: str) -> Effect:
    """The input is larger by the factor 1 + size."""
    return _input(
        name,
        "gain of input",
        lambda u, size, shape, r: (1.0 + size) * u,
        scale=0.05,
        mechanism="The gain of the input is wrong.",
        remedy="Calibrate the input.",
    )


def bent_input(name: str, *, level: float) -> Effect:
    """The input is larger by size u^2 / level ("even") or size u |u| / level ("odd")."""
    return _input(
        name,
        "nonlinearity of input",
        lambda u, size, shape, r: u + size * u * curve(u, shape) / level,
        kind="force",
        scale=0.05,
        shapes=("odd", "even"),
        mechanism="What arrives of the input is not in proportion to it.",
        remedy="Calibrate the drive over its range.",
    )


def offset_input(name: str, *, unit: str, scale: float) -> Effect:
    """The input is larger by the size."""
    return _input(
        name,
        "offset of input",
        lambda u, size, shape, r: u + size,
        unit=unit,
        scale=scale,
        mechanism="The input has an offset.",
        remedy="Zero the input.",
    )


def saturation_input(name: str, *, levels: Sequence[float]) -> Effect:
    """Of the input beyond +-level only the share 1 - size arrives."""
    return _part_lost(
        name,
        "saturation of input",
        lambda u, level: u - np.clip(u, -level, level),
        levels,
        mechanism="Large inputs do not arrive in full.",
        remedy="Lower the drive, or model its limit.",
    )


def dead_zone_input(name: str, *, levels: Sequence[float]) -> Effect:
    """Of the input within +-level only the share 1 - size arrives."""
    return _part_lost(
        name,
        "dead zone of input",
        lambda u, level: np.clip(u, -level, level),
        levels,
        mechanism="Small inputs do not arrive in full.",
        remedy="Model the dead zone.",
    )


def _part_lost(
    name: str,
    label: str,
    part: Callable[[Array, float], Array],
    levels: Sequence[float],
    **fields: str,
) -> Effect:
    """A drive that loses the share ``size`` of a part of its input, split at a level."""
    return _input(
        name,
        label,
        lambda u, size, level, r: u - size * part(u, level),
        kind="force",
        scale=0.3,
        sign=1,
        upper=1.0,
        shapes=tuple(levels),
        shape_names=("level [input unit]",),
        **fields,
    )
