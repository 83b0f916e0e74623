"""Effects and parameters of :mod:`unmodeled.fit` from entries of a library.

An error of a sensor or an input has its own function. Signs: a channel shows (1 + gain) times the
true value plus the offset, late by the delay. This also holds for the channel of the input
(:mod:`unmodeled.chain`). At magnitude zero, the values are unchanged, bit by bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from feltmb.adapters.changes import Entry, InputError, SensorError
from feltmb.mechanism import MechanismFile
from feltmb.mechanism.numbers import read_entry
from unmodeled.arguments import checked
from unmodeled.chain import Link, fault_of, faults, true_value
from unmodeled.data import Array, Record
from unmodeled.fit import Effect, Parameter
from unmodeled.models.model import UserUnit
from unmodeled.models.subject import Subject


@checked
def effect_of(
    entry: Entry, outputs: Sequence[str], channels: Mapping[str, Sequence[str]]
) -> Effect:
    """Make an effect from an entry of a library.

    Parameters
    ----------
    outputs
        Outputs of the model, on which sensor effects act.
    channels
        Outputs by channel name.
    """
    observe: Any = None
    excite: Any = None
    data: Any = entry
    subject: Subject | None = None
    if entry.sensor is not None:
        observe, data = observe_by(entry.sensor, outputs, channels), None
        if entry.sensor.kind in faults():
            subject = Subject("sensor", entry.sensor.kind, entry.sensor.channels, entry.component)
    elif entry.input is not None:
        excite, data = excite_by(entry.input), None
        subject = Subject("input", entry.input.kind, component=entry.component)
    return Effect(
        name=entry.name,
        component=entry.component,
        label=entry.part,
        subject=subject,
        unit=entry.unit,
        scale=entry.magnitude,
        sign=entry.sign,
        mechanism=entry.mechanism,
        kind=entry.kind,
        shapes=entry.shapes,
        remedy=entry.remedy,
        lower=entry.lower,
        upper=entry.upper,
        relative=bool(entry.changes) and all(c.scale for c in entry.changes),
        step=entry.step,
        observe=observe,
        excite=excite,
        data=data,
    )


def parameter_of(entry: Entry) -> Parameter:
    """Make a parameter from a tolerance of a library; zero is the tabulated value."""
    return Parameter(
        name=entry.name,
        value=0.0,
        sd=entry.magnitude,
        unit=entry.unit,
        lower=max(entry.lower, -0.9 if entry.unit == "1" else -math.inf),
        upper=entry.upper,
        component=entry.component,
    )


def user_unit_of(entry: Entry, config: MechanismFile) -> UserUnit | None:
    """Turns of the screw that an entry moves, grams of a mass, degrees of an angle; None: neither.

    Parameters
    ----------
    entry
        Entry of a library.
    config
        Mechanism, whose screws and masses count.
    """
    change, *others = entry.changes or [None]
    if change is None:
        return None
    if change.path.endswith(".mass") and change.scale:
        return UserUnit("kg", change.scale * float(read_entry(config, change.path)))
    point, _, axis = change.path.rpartition(".")
    for screw in config.screws.values():
        along = dict(zip("xy", screw.direction or (), strict=False)).get(axis, 0.0)
        if screw.path == point and screw.pitch and not others and abs(along) > 0.99:
            return UserUnit("turn", change.add / (along * screw.pitch), screw.words)
    return UserUnit("deg", math.degrees(1.0)) if entry.unit == "rad" else None


def columns_of(
    signal: SensorError, outputs: Sequence[str], channels: Mapping[str, Sequence[str]]
) -> list[int]:
    """Columns on which a sensor effect acts; ``camera`` means every tracking point."""
    if signal.channels == "camera":
        return [i for i, name in enumerate(outputs) if not name.startswith("finger.")]
    named = set(channels.get(signal.channels, (signal.channels,)))
    return [i for i, name in enumerate(outputs) if name in named]


def _other_axis(name: str) -> str:
    """The other coordinate of a tracking point; "" for other outputs."""
    point, _, axis = name.rpartition(".")
    return {"x": f"{point}.y", "y": f"{point}.x"}.get(axis, "")


def partners(
    signals: Sequence[SensorError], outputs: Sequence[str], channels: Mapping[str, Sequence[str]]
) -> tuple[str, ...]:
    """Outputs that are not recorded but which a rotated camera mixes into recorded ones."""
    tilts = [signal for signal in signals if signal.kind == "tilt"]
    seen = [outputs[i] for signal in tilts for i in columns_of(signal, outputs, channels)]
    return tuple(dict.fromkeys(o for o in map(_other_axis, seen) if o and o not in outputs))


def observe_by(
    signal: SensorError, outputs: Sequence[str], channels: Mapping[str, Sequence[str]]
) -> Callable[..., Array]:
    """Make the ``observe`` callable of a sensor effect."""
    columns = columns_of(signal, outputs, channels)
    if signal.kind != "tilt":
        return Link(fault_of(signal.kind), columns)
    others = [_other_axis(outputs[i]) for i in columns]

    def observe(record: Record, y: Array, magnitudes: Array, shape: object = None) -> Array:
        del record, shape
        out, rows = y.copy(), np.flatnonzero(magnitudes)
        for i, other in zip(columns, others, strict=True):
            if other in outputs:
                turn = magnitudes[rows, None] * (1.0 if outputs[i].endswith(".x") else -1.0)
                beside = y[rows, :, outputs.index(other)]
                out[rows, :, i] = np.cos(turn) * y[rows, :, i] + np.sin(turn) * beside
        return out

    return observe


def excite_by(signal: InputError) -> Callable[..., Mapping[str, Array]]:
    """Make the ``excite`` callable of an input effect: the true input from the recorded one."""

    def excite(record: Record, magnitude: float, shape: object = None) -> Mapping[str, Array]:
        del shape
        known = {signal.kind: magnitude}
        return {n: true_value(record, v, known, "smooth") for n, v in record.inputs.items()}

    return excite
