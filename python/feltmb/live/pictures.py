"""Data of a run for a page: moving mechanism, curves, values; small enough for each change."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from feltmb.graphics.plot.readings import busy_window, contact_numbers, named_events
from feltmb.graphics.viewer.content import (
    STRIKER,
    default_panels_of,
    describe_stage,
    output_label,
    striker_outputs,
)
from feltmb.graphics.viewer.packing import pack_columns, pack_times
from feltmb.mechanism import Action
from feltmb.run.results import Run
from feltmb.style import reader_unit

Array = npt.NDArray[np.float64]

__all__ = ["SAMPLES", "default_shown", "describe_live", "outputs_of", "summary_of"]

#: Numbers of frames of the mechanism, and of samples of a curve and of the string, in quick and
#: full quality.
FRAMES, SAMPLES, STRING = {"quick": 120, "full": 500}, {"quick": 900, "full": 4000}, 300
#: Number of frames that determine how much of each surface is drawn.
POSES = {"quick": 5, "full": 13}


def describe_live(run: Run, action: Action, shown: list[str], quality: str) -> dict[str, Any]:
    """A run for the page, in practical units, ready for JSON.

    Parameters
    ----------
    shown
        Outputs whose curves are shown; unknown ones are omitted.
    quality
        ``quick`` during changes, ``full`` afterwards.
    """
    low, high = busy_window(run)
    time = run.time
    some = _every(len(time), SAMPLES[quality])
    strikers = striker_outputs(run, action.config.reading)
    outputs = [name for name in dict.fromkeys(shown) if name in run or name in strikers]
    factors = [reader_unit("m/s" if n in strikers else run.unit(n)) for n in outputs]
    table = np.column_stack(
        [
            (strikers[n] if n in strikers else run[n])[some] * f
            for n, (f, _) in zip(outputs, factors, strict=True)
        ]
        or [np.zeros((len(some), 0))]
    )
    first, last = float(time[0]), float(time[-1])
    return {
        "quality": quality,
        "first": 1e3 * first,
        "last": 1e3 * last,
        "busy": [1e3 * low, 1e3 * high],
        "events": [[round(1e3 * t, 4), name.replace("_", " ")] for t, name in named_events(run)],
        "time": pack_times(1e3 * time[some]),
        "values": pack_columns(table),
        "outputs": [
            {"name": n, "unit": u, "label": output_label(n, _text(run, n)), "text": _text(run, n)}
            for n, (_, u) in zip(outputs, factors, strict=True)
        ],
        "stage": describe_stage(
            run,
            action,
            _frames(run, low, high, FRAMES[quality]),
            string_samples=STRING,
            poses=POSES[quality],
        ),
        "summary": summary_of(run),
        "energy": {k: v for k, v in run.energy.items() if isinstance(v, float)},
        "warnings": [str(w) for w in run.stats["warnings"]],
    }


def _text(run: Run, name: str) -> str:
    return run.long_names[run.names.index(name)] if name in run.names else STRIKER


def _every(count: int, most: int) -> npt.NDArray[np.int64]:
    stride = max(1, -(-count // most))
    return np.unique(np.append(np.arange(0, count, stride), count - 1))


def _frames(run: Run, low: float, high: float, count: int) -> Array:
    """Times [s] of frames, closer together during fast motion."""
    time = run.time
    moved = np.zeros(len(time))
    for name in run.coordinates:
        values = run[name]
        span = float(np.ptp(values))
        if span > 0.0:
            moved[1:] += np.abs(np.diff(values)) / span
    inside = (time >= low) & (time <= high)
    moved[1:] += 4.0 * np.where(inside[1:], np.diff(time) / max(high - low, 1e-6), 0.0)
    moved[1:] += 0.2 * np.diff(time) / max(float(time[-1] - time[0]), 1e-6)
    way = np.cumsum(moved)
    wanted = np.linspace(way[0], way[-1], min(count, len(time)))
    return np.asarray(time[np.unique(np.append(np.searchsorted(way, wanted[:-1]), len(time) - 1))])


def summary_of(run: Run) -> dict[str, float]:
    """Values of a run, SI units, as in ``feltmb stroke --json``."""
    return {k: float(v) for k, v in run.summary.items() if math.isfinite(float(v))}


def outputs_of(run: Run, action: Action) -> list[list[str]]:
    """Name, label and practical unit of every output."""
    return [
        [n, output_label(n, text), reader_unit(unit)[1]]
        for n, unit, text in zip(run.names, run.units, run.long_names, strict=True)
    ] + [[n, n, "m/s"] for n in striker_outputs(run, action.config.reading)]


def default_shown(run: Run, action: Action) -> list[dict[str, Any]]:
    """Initial panels of curves."""
    panels = default_panels_of(run, action.config.reading)
    if len(contact_numbers(run)) > 0 and "energy.kinetic" in run:
        panels.append({"title": "energy", "outputs": ["energy.kinetic"], "change": False})
    return panels[:6]
