"""What the pictures of a diagnosis show: motions, and laws with the points that support them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array

#: Largest number of points of a curve.
POINTS = 600


@dataclass(frozen=True)
class Axis:
    """What an axis shows."""

    label: str
    """At most three words."""
    unit: str


@dataclass(frozen=True, eq=False)
class Points:
    """What the records leave for a law."""

    label: str
    """Record."""
    x: Array
    y: Array
    sd: Array
    """Standard deviation of y; 0: it is not known."""


@dataclass(frozen=True, eq=False)
class Line:
    """A law, and the ends of its interval."""

    label: str
    x: Array
    y: Array
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Law:
    """The evidence of one change in the coordinates of its law."""

    name: str
    """Name of the cause or of the parameter."""
    title: str
    """Name for people."""
    kind: Literal["law", "loop", "step", "likelihood", "records"]
    """``law``: one curve; ``loop``: one in each direction of the motion; ``step``: a signal over
    time with and without the change; ``likelihood``: of a number, with the values of the records
    by themselves; ``records``: sizes by record."""
    x: Axis
    y: Axis
    points: tuple[Points, ...]
    lines: tuple[Line, ...]


@dataclass(frozen=True, eq=False)
class Motion:
    """One channel of a record: measured, and in the model as it is and with the changes."""

    record: str
    channel: str
    unit: str
    held_out: bool
    motion: float
    """Rms of the channel about its mean in all records [unit]."""
    time: Array
    """[s]"""
    measured: Array
    """NaN: not measured."""
    tabulated: Array
    """The model as it is; NaN: its simulation fails."""
    changed: Array
    """The model with the changes."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """The model with some of the changes, at their sizes: not fitted again."""

    kept: tuple[bool, ...]
    """Whether each change is in it."""
    left: Mapping[str, float]
    """Rms residual by channel [its unit]; NaN: the simulation fails."""
    curves: tuple[Array, ...]
    """The model at the times of the chosen part and of each motion."""


@dataclass(frozen=True, eq=False)
class Motions:
    """The motions of all records, and how they are with some of the changes."""

    chosen: Motion
    """The part of a record in which the changes take away most."""
    whole: tuple[Motion, ...]
    """Records by channel."""
    changes: tuple[str, ...] = ()
    """Names of the changes that may be left out."""
    labels: tuple[str, ...] = ()
    """These names for people."""
    alternatives: tuple[Alternative, ...] = ()


def thinned(curves: Sequence[Array], points: int = POINTS) -> NDArray[np.intp]:
    """Indices that keep the smallest and largest value of each curve in each part of a record.

    Parameters
    ----------
    curves
        Values at the same times, each (n,).
    points
        Largest number of indices.
    """
    n = len(curves[0])
    if n <= points:
        return np.arange(n)
    parts = max((points - 2) // (2 * len(curves)), 1)
    edges = np.linspace(0, n, parts + 1).astype(np.intp)
    kept = {0, n - 1}
    for y in curves:
        for first, last in itertools.pairwise(edges):
            part = y[first:last]
            if np.isfinite(part).any():
                kept |= {first + int(np.nanargmin(part)), first + int(np.nanargmax(part))}
    return np.array(sorted(kept), dtype=np.intp)
