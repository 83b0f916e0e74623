"""Data of a run for a page: moving mechanism, curves, values; small enough for each change."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from feltmb.graphics.film import Film
from feltmb.graphics.plot.readings import busy_window, contact_numbers, named_events
from feltmb.graphics.viewer.content import (
    default_panels_of,
    describe_look,
    describe_motion,
    output_label,
    outputs_of,
)
from feltmb.graphics.viewer.packing import pack_columns, pack_times
from feltmb.live.knobs import Bench
from feltmb.live.states import Playing
from feltmb.mechanism import Action
from feltmb.params import names
from feltmb.run.results import Run
from feltmb.run.simulate import simulate
from unmodeled.style import reader_unit

Array = npt.NDArray[np.float64]

#: Numbers of frames of the mechanism, and of samples of a curve and of the string, in quick and
#: full quality.
FRAMES, SAMPLES, STRING = {"quick": 120, "full": 500}, {"quick": 900, "full": 4000}, 300
#: Number of frames of the first run that determine how much of each surface is drawn.
LOOK_FRAMES = 40


def describe_live(
    run: Run, action: Action, original: Action, shown: list[str], quality: str
) -> dict[str, Any]:
    """A run for the page, in practical units.

    Parameters
    ----------
    original
        The mechanism without changes, to which the look in the greeting belongs.
    shown
        Outputs whose curves are shown; unknown ones are omitted.
    quality
        ``quick`` during changes: only what moves, and how far the surfaces are shifted. ``full``
        afterwards: also the look of the changed mechanism.
    """
    low, high = busy_window(run)
    time = run.time
    some = _every(len(time), SAMPLES[quality])
    known = outputs_of(run, action.config.reading)
    outputs = {name: known[name] for name in shown if name in known}
    units = [reader_unit(o.unit) for o in outputs.values()]
    curves = [o.values[some] * f for o, (f, _) in zip(outputs.values(), units, strict=True)]
    table = np.column_stack(curves or [np.zeros((len(some), 0))])
    first, last = float(time[0]), float(time[-1])
    film = Film(run, action, _frames(run, low, high, FRAMES[quality]))
    shifted = shifts(action, original)
    stage = {**describe_motion(film, string_samples=STRING), "shifts": shifted}
    if quality == "full":
        stage["look"] = {**describe_look(film), "shifts": shifted}
    return {
        "quality": quality,
        "first": 1e3 * first,
        "last": 1e3 * last,
        "busy": [1e3 * low, 1e3 * high],
        "events": [[round(1e3 * t, 4), name.replace("_", " ")] for t, name in named_events(run)],
        "time": pack_times(1e3 * time[some]),
        "values": pack_columns(table),
        "outputs": [
            {"name": n, "unit": u, "label": output_label(n, o.text), "text": o.text}
            for (n, o), (_, u) in zip(outputs.items(), units, strict=True)
        ],
        "stage": stage,
        "summary": summary_of(run),
        "energy": {k: v for k, v in run.energy.items() if isinstance(v, float)},
        "warnings": [str(w) for w in run.stats["warnings"]],
    }


def shifts(action: Action, original: Action) -> dict[str, list[float]]:
    """Shifts x, y [mm] of the surfaces that are not where they were, in the frame of their body."""
    before = original.config.surfaces
    return {
        name: [1e3 * (a - b) for a, b in zip(surface.point, before[name].point, strict=True)]
        for name, surface in action.config.surfaces.items()
        if name in before and surface.point != before[name].point
    }


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
    # Forces change before things move: the ends of the motion are exact.
    ends = [*np.searchsorted(time, (low, high)), len(time) - 1]
    some = np.unique(np.append(np.searchsorted(way, wanted[:-1]), ends))
    return np.asarray(time[some])


def summary_of(run: Run) -> dict[str, float]:
    """Values of a run, SI units, as in ``feltmb stroke --json``."""
    return {k: float(v) for k, v in run.summary.items() if math.isfinite(float(v))}


def listed_outputs(run: Run, action: Action) -> list[list[str]]:
    """Name, label and practical unit of every output."""
    known = outputs_of(run, action.config.reading)
    return [[n, output_label(n, o.text), reader_unit(o.unit)[1]] for n, o in known.items()]


def default_shown(run: Run, action: Action) -> list[dict[str, Any]]:
    """Initial panels of curves."""
    panels = default_panels_of(run, action.config.reading)
    if len(contact_numbers(run)) > 0 and "energy.kinetic" in run:
        panels.append({"title": "energy", "outputs": ["energy.kinetic"], "change": False})
    return panels[:6]


def playable(action: Action) -> bool:
    """Whether a finger plays the mechanism."""
    return action.config.finger is not None and action.config.motor is None


def first_run(action: Action) -> Run:
    """The run of which a page knows the outputs before it asks for any."""
    playing = Playing() if playable(action) else Playing(kind="free")
    return simulate(action, playing.stroke(), ledger=False, output_rate=1000.0, max_wall=20.0)


def greeting(bench: Bench, run: Run | None = None) -> dict[str, Any]:
    """Data of a mechanism for the page; ``run``: its first run, where it was made before."""
    action = bench.action
    found = first_run(action) if run is None else run
    return {
        "name": action.name,
        "look": describe_look(
            Film(found, action, found.time[:: max(1, len(found.time) // LOOK_FRAMES)])
        ),
        "about": str(action.raw.get("about", "")),
        "knobs": [knob.as_dict(bench.numbers) for knob in bench.knobs.values()],
        "numbers": [[path, *rest] for path, rest in bench.numbers.items()],
        "strokes": names("strokes") if playable(action) else [],
        "outputs": listed_outputs(found, action),
        "panels": default_shown(found, action),
        "contacts": [
            [int(key), contact.label or f"contact {key}"]
            for key, contact in action.config.contacts.items()
            if contact.enabled
        ],
        "targets": bench.targets.name if bench.targets else "",
        "notes": list(bench.notes),
    }
