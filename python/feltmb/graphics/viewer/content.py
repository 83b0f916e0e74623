"""Content of the page from runs: curves, the moving mechanism, the string, events."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb.graphics.film import Film
from feltmb.graphics.plot.outlines import spiral
from feltmb.graphics.plot.poses import (
    bent_beams,
    moving_joints,
    poses_along,
    spring_bodies,
    string_line,
    string_reach,
)
from feltmb.graphics.plot.readings import (
    busy_window,
    contact_numbers,
    loaded_contacts,
    named_events,
    run_action,
)
from feltmb.graphics.plot.shapes import Shape, scene, station_of
from feltmb.graphics.viewer.curves import Curves
from feltmb.graphics.viewer.packing import pack_columns, pack_points, pack_times
from feltmb.graphics.viewer.thinning import extremes, knots, thin_outline
from feltmb.run.reading import reading_of, striker_speed
from unmodeled.errors import InvalidParameter
from unmodeled.style import body_fill, reader_unit

if TYPE_CHECKING:
    from feltmb.mechanism import Action, Reading
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]
Progress = Callable[[float], object]

MOST_RUNS = 6
MOST_FRAMES = 2000
MOST_SAMPLES = 3000  # number of samples of one curve
MOST_STRING_SAMPLES = 4000
STRING_POINTS = 121
#: Largest error of a curve by omitted samples, relative to its range.
CURVE_TOLERANCE = 2e-4


def describe(
    run: Run | Curves, name: str, window: tuple[float, float] | None, progress: Progress | None
) -> dict[str, Any]:
    """All content of the page for a run, in practical units, ready for JSON.

    Parameters
    ----------
    run
        A run with at least two samples, or measured curves.
    name
        Name for people.
    window
        Interval [s] that is used; None: all times.
    """
    time = run.time
    outputs = outputs_of(run)
    events = [] if isinstance(run, Curves) else named_events(run)
    keep = _kept(time, window, name)
    out: dict[str, Any] = {
        "name": name,
        "first": 1e3 * float(time[keep][0]),
        "last": 1e3 * float(time[keep][-1]),
        "events": [
            [round(1e3 * t, 4), text.replace("_", " ")]
            for t, text in events
            if time[keep][0] <= t <= time[keep][-1]
        ],
        "outputs": [
            _curve(key, time[keep], o.values[keep], o.unit, o.text) for key, o in outputs.items()
        ],
        "stage": None,
        "note": "",
    }
    if isinstance(run, Curves):
        out["busy"] = [out["first"], out["last"]]
        out["note"] = "curves only"
        return out
    low, high = busy_window(run)
    out["busy"] = [max(1e3 * low, out["first"]), min(1e3 * high, out["last"])]
    if out["busy"][1] <= out["busy"][0]:
        out["busy"] = [out["first"], out["last"]]
    try:
        action = run_action(run)
        frames = _frames(run, action, run.time[keep], keep)
        out["stage"] = describe_stage(run, action, frames, keep, progress=progress)
    except InvalidParameter as error:
        out["note"] = f"no mechanism to show: {error}"
    return out


@dataclass(frozen=True)
class Output:
    """A curve of a page."""

    values: Array
    """Samples [SI unit]."""
    unit: str
    text: str
    """What it is, in words."""


def outputs_of(run: Run | Curves, reading: Reading | None = None) -> dict[str, Output]:
    """Curves by name: the outputs of a run and the speed of its striker, or measured curves.

    The sign of that speed is that of the impact speed, whatever the axes of the mechanism are.
    ``reading``: that of the mechanism of the run, if it is at hand.
    """
    if isinstance(run, Curves):
        return {k: Output(v, run.units.get(k, "1"), "") for k, v in run.values.items()}
    described = zip(run.names, run.values.T, run.units, run.long_names, strict=True)
    found = {name: Output(values, unit, text) for name, values, unit, text in described}
    reading = reading or reading_of(run)
    speed = striker_speed(run, reading)
    if speed is not None and reading.striker is not None:
        found[_striker(reading)] = Output(speed, "m/s", "speed toward what is struck")
    return found


def _striker(reading: Reading) -> str:
    """Name of the speed of the striker."""
    return f"{reading.striker.point}.speed" if reading.striker is not None else ""


def _kept(time: Array, window: tuple[float, float] | None, name: str) -> slice:
    if len(time) < 2:
        raise InvalidParameter(f"view: {name} has {len(time)} samples, expected 2 or more")
    if not np.all(np.isfinite(time)) or not np.all(np.diff(time) > 0):
        raise InvalidParameter(f"view: the times of {name} do not grow")
    if window is None:
        return slice(None)
    first = int(np.searchsorted(time, window[0]))
    last = int(np.searchsorted(time, window[1], side="right"))
    if last - first < 2:
        raise InvalidParameter(
            f"view: window {window[0]:g} to {window[1]:g} s holds nothing of {name}, which goes "
            f"from {time[0]:g} to {time[-1]:g} s"
        )
    return slice(first, last)


def output_label(name: str, text: str) -> str:
    """Name of an output for people; contacts have a number and a name of their own."""
    match = re.fullmatch(r"contact(\d+)\.(\w+)", name)
    where = text.partition(": ")[2]
    if match is None or not where:
        return name
    what = "" if match[2] == "force" else f", {match[2]}"
    return f"{int(match[1])} {where}{what}"


def _curve(name: str, time: Array, values: Array, unit: str, text: str) -> dict[str, Any]:
    factor, reader = reader_unit(unit)
    out: dict[str, Any] = {
        "name": name,
        "label": output_label(name, text),
        "unit": reader,
        "text": text,
    }
    v = factor * np.asarray(values, dtype=float)
    v = np.where(np.isfinite(v), v, np.nan)
    kept = extremes(v, 8 * MOST_SAMPLES)
    if np.all(np.isfinite(v)):
        span = float(np.ptp(v))
        kept = kept[
            knots(time[kept], v[kept][:, None], CURVE_TOLERANCE * span, MOST_SAMPLES)
            if span > 0
            else [0, -1]
        ]
    out["time"] = pack_times(1e3 * time[kept])
    out["value"] = pack_columns(v[kept][:, None])
    return out


def _frames(run: Run, action: Action, time: Array, keep: slice) -> Array:
    """Times [s] of frames between which everything moves almost linearly."""
    missing = [name for name in action.coordinates if name not in run]
    if missing:
        raise InvalidParameter(f"the run lacks the coordinates {', '.join(missing)}")
    unit = scene(action).unit
    columns = []
    for name in action.coordinates:
        lever = 500.0 * unit if run.unit(name) == "rad" else 1.0
        columns.append(run[name][keep] * lever / (0.03 * unit))
    numbers = loaded_contacts(run)
    largest = max((float(np.max(run[f"contact{n:02d}.force"])) for n in numbers), default=0.0)
    for n in numbers:
        share = np.clip(run[f"contact{n:02d}.force"][keep] / largest, 0.0, None)
        columns.append(np.sqrt(share) / 0.03)  # square root, as in the drawn arrows
    if "finger.force" in run:
        force = np.abs(run["finger.force"][keep])
        columns.append(np.sqrt(force / max(float(force.max()), 1e-30)) / 0.03)
    values = np.column_stack(columns)
    if not np.all(np.isfinite(values)):
        raise InvalidParameter("the run holds coordinates that are no finite numbers")
    stride = max(1, len(time) // 20000)
    some = np.unique(np.append(np.arange(0, len(time), stride), len(time) - 1))
    return np.asarray(time[some[knots(time[some], values[some], 1.0, MOST_FRAMES)]])


def _rounded(values: Any, digits: int) -> Any:
    return np.round(np.asarray(values, dtype=float), digits).tolist()


def describe_stage(
    run: Run,
    action: Action,
    times: Array,
    keep: slice = slice(None),
    *,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """The moving mechanism in mm, N and ms: how it looks, and its motion at ``times`` [s].

    ``keep``: samples of the run from which the motion of the string is taken.
    """
    film = Film(run, action, times)
    motion = describe_motion(film, keep)
    if progress is not None:
        progress(1.0)
    return {"look": describe_look(film), **motion}


def describe_look(film: Film) -> dict[str, Any]:
    """What does not move in the drawing of a mechanism, in mm."""
    action, drawn = film.action, film.scene
    names = _numbered(action)
    unit = 1e3 * drawn.unit
    finger = action.config.finger
    return {
        "unit": round(unit, 4),
        "view": _rounded(1e3 * np.array(film.limits), 2),
        "bodies": [{"fill": body_fill(drawn.group[b]), "name": _part(action, b)} for b in names],
        **_shapes(action, drawn.shapes, names, bent_beams(action, film.q[0])),
        "beams": [
            {"body": names[body], "length": 1e3 * (action.config.bodies[body].length or 1.0)}
            for body in bent_beams(action, film.q[0])
        ],
        "contacts": [
            {
                "number": n,
                "label": action.config.contacts[f"{n:02d}"].label or f"contact {n}",
                "sides": sides,
            }
            for n, sides in film.sides.items()
        ],
        **_links(action, names, unit),
        "finger": finger
        and {
            "body": names[finger.body],
            "at": _rounded(1e3 * np.array(finger.point), 3),
            "along": _rounded(np.array(finger.direction) / np.hypot(*finger.direction), 5),
        },
        "string": _string(film),
    }


def describe_motion(
    film: Film, keep: slice = slice(None), string_samples: int = MOST_STRING_SAMPLES
) -> dict[str, Any]:
    """What moves, at the times of a film, in mm, N and ms.

    Parameters
    ----------
    keep
        Samples of the run from which the motion of the string is taken, at most ``string_samples``.
    """
    names, count = _numbered(film.action), len(film.time)
    through = poses_along(film.action, film.q)
    moved = np.zeros((count, len(names), 3))
    for name, pose in through.bodies.items():
        moved[:, names[name]] = pose * (1e3, 1e3, 1.0)
    places = np.zeros((count, len(film.contacts), 4))
    for k, n in enumerate(film.contacts):
        places[:, k] = through.contacts[n] * (1e3, 1e3, 1.0, 1.0)
    return {
        "time": pack_times(1e3 * film.time),
        "poses": pack_columns(moved.reshape(count, -1)),
        "lines": [
            pack_columns(1e3 * line[:, ::3].reshape(count, -1)) for line in through.beams.values()
        ],
        "numbers": film.contacts,
        "places": pack_columns(places.reshape(count, -1)),
        "forces": pack_columns(np.reshape([film.forces[n] for n in film.contacts], (-1, count)).T),
        "finger": None if film.finger is None else pack_columns(film.finger[:, None]),
        "largest": film.largest,
        "modes": _modes(film, keep, string_samples),
    }


def _numbered(action: Action) -> dict[str, int]:
    """Bodies with their places in a drawing."""
    return {body: i for i, body in enumerate(["ground", *action.config.bodies])}


def _shapes(
    action: Action, shapes: Sequence[Shape], names: Mapping[str, int], flexible: Container[str]
) -> dict[str, Any]:
    """Shapes and their outlines; only those that do not bend can be thinned."""

    def station(shape: Shape) -> float | None:
        x = station_of(action, shape)
        return None if x is None else round(1e3 * x, 3)

    return {
        "shapes": [
            {
                "body": names[s.body],
                "role": s.role,
                "station": station(s),
                "surface": s.name if s.role in ("pad", "surface", "mark") else "",
            }
            for s in shapes
        ],
        "outlines": pack_points(
            [
                1e3
                * (
                    s.points
                    if s.body in flexible and station(s) is None
                    else thin_outline(s.points, 2e-5)
                )
                for s in shapes
            ]
        ),
    }


def _links(action: Action, names: Mapping[str, int], unit: float) -> dict[str, Any]:
    """Joints, springs and straps. ``unit``: that of the drawing [mm]."""
    return {
        "joints": [
            {"body": names[parent], "at": _rounded(1e3 * place, 3), "ground": parent == "ground"}
            for _, kind, parent, place in moving_joints(action)
            if kind == "revolute"
        ],
        "springs": [
            {"body": names[body], "points": _rounded(spiral(4.6 * unit), 3)}
            for body in spring_bodies(action)
        ],
        "straps": [
            {
                "a": [names[s.body_a], *_rounded(1e3 * np.array(s.point_a), 3)],
                "b": [names[s.body_b], *_rounded(1e3 * np.array(s.point_b), 3)],
                "free": 1e3 * s.free_length,
            }
            for s in action.config.straps.values()
            if s.enabled
        ],
    }


def _part(action: Action, body: str) -> str:
    """Name of a body for people."""
    known = action.config.bodies.get(body)
    return (known.label if known else "") or body.replace("_", " ")


def _string(film: Film) -> dict[str, Any] | None:
    """Line of the string, and the shapes of its modes."""
    line = string_line(film.action)
    if line is None:
        return None
    start, along, normal, length = line
    run = film.run
    moves = bool(run.provenance.get("string")) and run.eta.ndim == 2 and run.eta.shape[1] > 0
    return {
        "start": _rounded(1e3 * start, 3),
        "along": _rounded(along, 6),
        "normal": _rounded(normal, 6),
        "length": 1e3 * length,
        "reach": 1e3 * string_reach(line, film.limits),
        "shapes": pack_columns(_mode_shapes(run, length)) if moves else None,
    }


def _mode_shapes(run: Run, length: float) -> Array:
    return run.string_shapes(np.linspace(0.0, length, STRING_POINTS))


def _modes(film: Film, keep: slice, samples: int) -> dict[str, Any] | None:
    """Modal coordinates [mm] of the modes ``which`` that can be seen; None: no string moves."""
    run, line = film.run, string_line(film.action)
    eta = run.eta[keep]
    if line is None or not run.provenance.get("string") or eta.ndim != 2 or eta.shape[1] == 0:
        return None
    shapes = _mode_shapes(run, line[3])
    if not np.all(np.isfinite(eta)) or shapes.shape[1] != eta.shape[1]:
        raise InvalidParameter("the run holds motions of the string that are no finite numbers")
    peak = np.maximum(eta.max(axis=0), -eta.min(axis=0))
    size = peak * np.abs(shapes).max(axis=0)
    seen = np.flatnonzero(size > 1e-4 * max(float(size.max()), 1e-30))
    if len(seen) == 0:
        return None
    eta, peak = eta[:, seen], peak[seen]
    # Exact before the strike: the string is at rest until the first sample that moves.
    moving = np.any((eta > 1e-6 * peak) | (eta < -1e-6 * peak), axis=1)
    first = max(int(np.argmax(moving)) - 1, 0)
    stride = -(-(len(eta) - first) // samples)
    some = np.unique(np.concatenate([[0], np.arange(first, len(eta), stride), [len(eta) - 1]]))
    time = 1e3 * run.time[keep]
    return {
        "time": pack_times(time[some]),
        "eta": pack_columns(1e3 * eta[some]),
        "which": seen.tolist(),
        "largest": float(np.abs(1e3 * eta[some] @ shapes[:, seen].T).max()),
        "step": float(np.median(np.diff(time))) * stride,
    }


def default_panels(runs: Sequence[Run | Curves]) -> list[dict[str, Any]]:
    """Initial panels: outputs that all runs have, then outputs of the first run."""
    first = runs[0]
    names = tuple(first.values) if isinstance(first, Curves) else first.names
    panels: list[dict[str, Any]] = []
    if isinstance(first, Curves):
        panels += [{"title": "", "outputs": [n], "change": False} for n in names[:4]]
    else:
        panels += default_panels_of(first, reading_of(first))
    # Measured outputs come first, because the user asked for a comparison.
    for other in runs[1:]:
        if isinstance(other, Curves):
            shared = [n for n in other.values if n in names]
            shown = {n for p in panels for n in p["outputs"] if len(p["outputs"]) == 1}
            fresh = [n for n in shared if n not in shown][:6]
            panels = [{"title": "", "outputs": [n], "change": False} for n in fresh] + panels
    return [p for p in panels if p["outputs"]]


def default_panels_of(run: Run, reading: Reading) -> list[dict[str, Any]]:
    """Initial panels of a simulated run."""
    panels = list(_view_panels(run, reading))
    if not panels:
        points = [n for n in run.names if re.fullmatch(r".+\.[xy]", n)]
        panels.append(_panel("motion from the start", points[:4], change=True))
    if reading.striker is not None:
        title = reading.striker.label or reading.striker.point
        panels.append(_panel(title, {_striker(reading)}.intersection(outputs_of(run, reading))))
    peaks = {n: float(np.max(run[f"contact{n:02d}.force"])) for n in contact_numbers(run)}
    strongest = sorted((n for n, p in peaks.items() if p > 1e-6), key=lambda n: -peaks[n])
    panels.append(_panel("contact forces", [f"contact{n:02d}.force" for n in strongest[:5]]))
    panels.append(_panel("finger", {"finger.force"}.intersection(run.names)))
    panels.append(_panel("string", {"string.strike"}.intersection(run.names)))
    panels = [p for p in panels if p["outputs"]]
    moving = [n for n in run.coordinates if n in run] or list(run.names)
    return panels or [_panel("", [n]) for n in moving[:4]]


def _view_panels(run: Run, reading: Reading) -> Iterator[dict[str, Any]]:
    """Panels of the views of a mechanism: a panel has one axis, of one unit."""
    for view in reading.views.values():
        names = [r.output for r in view.rows if r.factor == 1.0 and r.output in run]
        for unit in dict.fromkeys(map(run.unit, names)):
            own = [n for n in names if run.unit(n) == unit]
            yield _panel(view.title, own, change=view.change)


def _panel(title: str, outputs: Iterable[str], *, change: bool = False) -> dict[str, Any]:
    return {"title": title, "outputs": list(outputs), "change": change}
