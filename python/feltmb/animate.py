"""Moving pictures of a run: GIF, or one HTML file that needs nothing but a browser.

The mechanism is made again from the parameters that the run holds, and drawn as
:func:`feltmb.plot.mechanism` draws it.
"""

from __future__ import annotations

import html
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb.errors import InvalidParameter
from feltmb.files import check_writable, write_file, write_text
from feltmb.plot.axes import set_window
from feltmb.plot.drawing import draw_bodies, draw_fixed, draw_joints
from feltmb.plot.outlines import spiral
from feltmb.plot.poses import (
    Pose,
    bent_beams,
    body_poses,
    contact_rows,
    moving_joints,
    spring_bodies,
    strap_curve,
    strap_ends,
    string_line,
    string_reach,
    to_ground,
)
from feltmb.plot.readings import busy_window, loaded_contacts, named_events, run_action, run_name
from feltmb.plot.shapes import Shape, scene, shape_points, station_of, upper_right_is_free, view_box
from feltmb.style import (
    BLACK,
    FELT,
    INK,
    NORMAL,
    PURPLE,
    RED,
    SMALL,
    SURFACE,
    body_fill,
    new_figure,
    style_axes,
)

if TYPE_CHECKING:
    from feltmb.config import Action
    from feltmb.results import Run

Array = npt.NDArray[np.float64]
Progress = Callable[[float], object]

__all__ = ["animate"]

MOST_FRAMES = 5000
STRING_POINTS = 48


def animate(
    run: Run,
    path: str | Path,
    *,
    fps: float = 30,
    slowness: float = 20,
    window: tuple[float, float] | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write the motion of a run as GIF, or as one self-contained HTML file.

    Parameters
    ----------
    run
        Must hold all coordinates and its parameters.
    path
        Ends in ``.gif`` or ``.html``.
    fps
        Pictures a second, 1 to 50. A GIF times its pictures in steps of 10 ms; the nearest is used
        and the motion sampled accordingly, so that ``slowness`` holds.
    slowness
        How many times slower than the machine; in the HTML file it can be changed.
    window
        First and last time [s]; default: from the first to the last motion.
    force
        Replace an existing file.
    progress
        Called with the finished fraction, 0 to 1.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InvalidParameter
        An argument is out of range, the name ends otherwise, or the run lacks coordinates.
    FileExists
        The file exists and ``force`` is not given.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".gif", ".html"):
        raise InvalidParameter(f"animate: got {path.name!r}, expected a name in .gif or .html")
    if not (math.isfinite(fps) and 1 <= fps <= 50):
        raise InvalidParameter(f"animate: fps = {fps:g}, must lie in [1, 50]")
    if not (math.isfinite(slowness) and slowness > 0):
        raise InvalidParameter(f"animate: slowness = {slowness:g}, must be > 0")
    start, end = _window(run, window)
    check_writable(path, force=force)
    action = run_action(run)
    if kind == ".gif":
        delay = max(2, round(100.0 / fps))  # hundredths of a second
        step = 0.01 * delay / slowness
        film = _Film(run, action, _times(start, end, step))
        return _write_gif(film, path, delay, slowness, force, progress)
    # The browser interpolates between samples: enough for a slowness of 10 times the one asked.
    step = max(0.1 / (fps * slowness), (end - start) / 800.0)
    film = _Film(run, action, _times(start, end, step))
    return write_text(path, _html(film, slowness, progress), force=force)


def _window(run: Run, window: tuple[float, float] | None) -> tuple[float, float]:
    if len(run.time) < 2:
        raise InvalidParameter(f"animate: the run has {len(run.time)} samples, expected 2 or more")
    if window is None:
        return busy_window(run)
    first, last = float(run.time[0]), float(run.time[-1])
    start, end = max(first, float(window[0])), min(last, float(window[1]))
    if not end > start:
        raise InvalidParameter(
            f"animate: window {window[0]:g} to {window[1]:g} s holds nothing of the run, which "
            f"goes from {first:g} to {last:g} s"
        )
    return start, end


def _times(start: float, end: float, step: float) -> Array:
    count = math.floor((end - start) / step + 1e-9) + 1
    if count > MOST_FRAMES:
        raise InvalidParameter(
            f"animate: {count} pictures, the limit is {MOST_FRAMES}; choose a shorter window or a "
            "smaller slowness"
        )
    out: Array = start + step * np.arange(max(count, 2), dtype=np.float64)
    return out


class _Film:
    """Everything that moves, at the times of the pictures."""

    def __init__(self, run: Run, action: Action, times: Array):
        missing = [name for name in action.coordinates if name not in run]
        if missing:
            raise InvalidParameter(f"animate: the run lacks the coordinates {', '.join(missing)}")
        self.run = run
        self.action = action
        self.time = times
        self.q = np.column_stack([self.sample(name) for name in action.coordinates])
        # A few poses tell how far the contacts travel along their surfaces.
        some = np.unique(np.linspace(0, len(times) - 1, 13).astype(int))
        self.some = [self.q[i] for i in some]
        self.scene = scene(action, self.some)
        self.limits = view_box(action, self.scene, self.some)
        enabled = {int(k) for k, c in action.config.contacts.items() if c.enabled}
        self.contacts = [n for n in loaded_contacts(run) if n in enabled]
        self.forces = {
            n: np.maximum(self.sample(f"contact{n:02d}.force"), 0) for n in self.contacts
        }
        self.finger = self.sample("finger.force") if "finger.force" in run else None
        self.sides = {n: self._sides(n) for n in self.contacts}
        peaks = [float(np.max(f)) for f in self.forces.values()]
        if self.finger is not None and action.config.finger is not None:
            peaks.append(float(np.max(np.abs(self.finger))))
        self.largest = max(peaks, default=0.0)
        self.speed = -run["hammer_tip.vx"] if "hammer_tip.vx" in run else None
        self.string = self._string_shapes()

    def sample(self, name: str) -> Array:
        return np.asarray(np.interp(self.time, self.run.time, self.run[name]))

    def poses(self, i: int) -> dict[str, Pose]:
        return body_poses(self.action, self.q[i])

    def _sides(self, number: int) -> tuple[float, ...]:
        """Signs along the contact's normal of the forces on those of its bodies that can move."""
        config = self.action.config
        pair = [config.surfaces[n] for n in config.contacts[f"{number:02d}"].surfaces]
        x, y, nx, ny, _ = contact_rows(self.action, self.q[0])[number]
        poses = self.poses(0)

        def depth(k: int) -> float:
            """How far the center of a circle lies on the side that the normal points to."""
            if pair[k].kind != "circle":
                return -math.inf
            center = to_ground(poses[pair[k].body], np.array([pair[k].point]))[0]
            return float((center[0] - x) * nx + (center[1] - y) * ny)

        # The normal of the core points into the body of the circle.
        circle = 0 if depth(0) > depth(1) else 1
        signs = []
        if self.scene.group[pair[circle].body] >= 0:
            signs.append(1.0)
        if self.scene.group[pair[1 - circle].body] >= 0:
            signs.append(-1.0)
        return tuple(signs)

    def arrow_length(self, force: float) -> float:
        """Length [m] of an arrow; the root keeps small forces visible."""
        if self.largest <= 0 or force <= 1e-3 * self.largest:
            return 0.0
        return 45.0 * self.scene.unit * math.sqrt(force / self.largest)

    def arrows(self, i: int, poses: dict[str, Pose]) -> list[tuple[Array, Array]]:
        """Tail and head [m] of the forces on bodies that move, at picture ``i``."""
        out: list[tuple[Array, Array]] = []
        rows = contact_rows(self.action, self.q[i])
        for number in self.contacts:
            length = self.arrow_length(float(self.forces[number][i]))
            if length <= 0:
                continue
            x, y, nx, ny, _ = rows[number]
            at, along = np.array([x, y]), np.array([nx, ny])
            out += [(at, at + sign * length * along) for sign in self.sides[number]]
        finger = self.action.config.finger
        if finger is not None and self.finger is not None:
            length = self.arrow_length(abs(float(self.finger[i])))
            if length > 0:
                at = to_ground(poses[finger.body], np.array([finger.point]))[0]
                along = np.array(finger.direction) / np.hypot(*finger.direction)
                along = along * math.copysign(1.0, float(self.finger[i]))
                out.append((at - length * along, at))
        return out

    def straps(self, i: int, poses: dict[str, Pose]) -> list[Array]:
        bent = bent_beams(self.action, self.q[i])
        return [strap_curve(a, b, free) for _, a, b, free in strap_ends(self.action, poses, bent)]

    def _string_shapes(self) -> Array | None:
        """Points of the string in the view (n_pictures, STRING_POINTS, 2) [m], or None."""
        line = string_line(self.action)
        if line is None:
            return None
        start, along, normal, _ = line
        y = np.linspace(0.0, string_reach(line, self.limits), STRING_POINTS)
        at_rest = start + y[:, None] * along
        out = np.repeat(at_rest[None], len(self.time), axis=0)
        if self.run.provenance.get("string") and self.run.eta.shape[1] > 0:
            w = self.run.string_displacement(y)
            moved = np.array(
                [np.interp(self.time, self.run.time, w[:, j]) for j in range(len(y))]
            ).T
            out = out - moved[:, :, None] * normal
        return np.asarray(out)


# --- GIF -----------------------------------------------------------------------------------------


def _write_gif(
    film: _Film,
    path: Path,
    delay: int,
    slowness: float,
    force: bool,
    progress: Progress | None,
) -> Path:
    from PIL import Image

    pictures: list[Any] = []
    palette: Any = None
    for i, pixels in enumerate(_pictures(film, slowness)):
        image = Image.fromarray(pixels)
        if palette is None:
            palette = _palette(image)
        # One palette for all, no dither: unchanged parts stay unchanged and cost nothing.
        pictures.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
        if progress is not None:
            progress((i + 1) / len(film.time))

    def write(target: Path) -> None:
        pictures[0].save(
            target,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=10 * delay,
            loop=0,
            optimize=False,
            disposal=1,
        )

    return write_file(path, write, force=force)


def _palette(image: Any) -> Any:
    """Colors of the first picture, and those that it may lack or have only nearly."""
    from matplotlib.colors import to_rgb
    from PIL import Image

    found = image.quantize(colors=112, dither=Image.Dither.NONE).getpalette()[: 3 * 112]
    # Almost white is white: the background must be one color.
    for i in range(0, len(found), 3):
        if min(found[i : i + 3]) > 247:
            found[i : i + 3] = [255, 255, 255]
    for color in ("#FFFFFF", RED, PURPLE, INK, BLACK, SURFACE, FELT):
        rgb = np.array(to_rgb(color))
        # Also half-way to white, for smooth edges.
        for share in (1.0, 0.5):
            found += [int(v) for v in np.round(255.0 * (share * rgb + (1.0 - share)))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(found)
    return palette


def _pictures(film: _Film, slowness: float) -> Any:
    """Yield RGB pictures (height, width, 3); what does not move is drawn once."""
    from matplotlib.collections import LineCollection
    from matplotlib.transforms import Affine2D

    action, drawn = film.action, film.scene
    low, high = film.limits
    width = 7.6
    height = float(np.clip(width * (high[1] - low[1]) / (high[0] - low[0]), 3.0, 8.0)) + 0.3
    figure = new_figure(width, height)
    figure.set_layout_engine("none")
    figure.set_dpi(100)
    canvas: Any = figure.canvas
    ax = figure.add_axes((0.0, 0.0, 1.0, (height - 0.3) / height))
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_axis_off()
    # Text and lines of the pictures are those of a small figure.
    name = run_name(film.run)
    figure.text(0.01, 1.0 - 0.07 / height, name, fontsize=NORMAL, va="top", fontweight="bold")
    draw_fixed(ax, action, drawn, film.limits, with_string=False)
    marker = _speed_inset(film, figure, ax)

    poses = film.poses(0)
    bent = bent_beams(action, film.q[0])
    bodies = draw_bodies(ax, action, drawn, poses, bent)
    moving: list[tuple[str, Any]] = [
        (body, artist) for body, own in bodies.items() for artist, _ in own if body != "ground"
    ]
    moving += [(body, artist) for body, artist in draw_joints(ax, action, drawn, poses)]
    straps = [
        ax.plot(*curve.T, color=PURPLE, linewidth=1.2, zorder=5.3)[0]
        for curve in film.straps(0, poses)
    ]
    strings = (
        [ax.plot(*film.string[0].T, color=INK, linewidth=1.4, zorder=1.5)[0]]
        if film.string is not None
        else []
    )
    arrows = LineCollection([], colors=RED, linewidths=1.8, zorder=7)
    ax.add_collection(arrows, autolim=False)
    clock = figure.text(
        0.99,
        1.0 - 0.07 / height,
        "",
        fontsize=NORMAL,
        va="top",
        ha="right",
        family="monospace",
    )
    changing = [artist for _, artist in moving] + straps + strings + [arrows]
    changing.sort(key=lambda artist: float(artist.get_zorder()))
    changing += [clock] + ([marker] if marker is not None else [])
    for artist in changing:
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    frames: dict[str, Any] = {}
    for body, artist in moving:
        if body not in frames:
            frames[body] = Affine2D()
        artist.set_transform(frames[body] + ax.transData)
    for i in range(len(film.time)):
        poses = film.poses(i)
        for body, frame in frames.items():
            x, y, angle = poses[body]
            frame.clear().rotate(angle).translate(x, y)
        bent = bent_beams(action, film.q[i])
        for body in bent:
            for artist, shapes in bodies[body]:
                artist.set_verts([shape_points(action, s, bent) for s in shapes])
        for line, curve in zip(straps, film.straps(i, poses), strict=True):
            line.set_data(curve[:, 0], curve[:, 1])
        if film.string is not None:
            strings[0].set_data(film.string[i, :, 0], film.string[i, :, 1])
        arrows.set_segments(_arrow_lines(film.arrows(i, poses), drawn.unit))
        clock.set_text(f"{1e3 * film.time[i]:7.2f} ms, {slowness:g} times slower")
        if marker is not None and film.speed is not None:
            marker.set_data(
                [1e3 * film.time[i]], [np.interp(film.time[i], film.run.time, film.speed)]
            )
        canvas.restore_region(background)
        for artist in changing:
            (artist.axes or figure).draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _arrow_lines(arrows: list[tuple[Array, Array]], unit: float) -> list[Array]:
    lines = []
    for tail, head in arrows:
        d = head - tail
        length = float(np.hypot(*d))
        barb = min(4.0 * unit, 0.5 * length) / length
        side = np.array([-d[1], d[0]])
        lines.append(np.array([tail, head]))
        lines.append(
            np.array([head - barb * (d + 0.6 * side), head, head - barb * (d - 0.6 * side)])
        )
    return lines


def _speed_inset(film: _Film, figure: Any, ax: Any) -> Any:
    """Curve of the hammer speed in a free corner; its marker, or None."""
    if film.speed is None:
        return None
    points = np.vstack(
        [
            to_ground(body_poses(film.action, q)[s.body], s.points)
            for q in film.some
            for s in film.scene.shapes
        ]
    )
    if not upper_right_is_free(points, film.limits, np.array([0.45, 0.42])):
        return None
    box = ax.get_position()
    small = figure.add_axes((0.60, box.y0 + 0.68 * box.height, 0.37, 0.27 * box.height))
    small.plot(1e3 * film.run.time, film.speed, color=RED, linewidth=1.1)
    style_axes(small, "time, ms", "")
    small.set_title("hammer speed toward string, m/s", fontsize=SMALL, loc="left")
    small.xaxis.label.set_size(SMALL)
    small.tick_params(labelsize=SMALL)
    set_window(small, (float(film.time[0]), float(film.time[-1])))
    return small.plot([], [], "o", color=BLACK, markersize=5)[0]


# --- HTML ----------------------------------------------------------------------------------------


def _rounded(values: Any, digits: int) -> Any:
    return np.round(np.asarray(values, dtype=float), digits).tolist()


def _thin(points: Array, tolerance: float) -> Array:
    """Fewer points of a curve; those left out lie within ``tolerance`` [m] of what remains."""
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    parts = [(0, len(points) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        d = points[last] - points[first]
        off = points[first + 1 : last] - points[first]
        share = np.clip(off @ d / max(float(d @ d), 1e-30), 0.0, 1.0)
        away = np.hypot(*(off - share[:, None] * d).T)
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            parts += [(first, middle), (middle, last)]
    return np.asarray(points[keep])


def _html(film: _Film, slowness: float, progress: Progress | None) -> str:
    action, drawn = film.action, film.scene
    bodies = ["ground", *action.config.bodies]
    names = {body: i for i, body in enumerate(bodies)}
    flexible = bent_beams(action, film.q[0])

    def bends(shape: Shape) -> bool:
        return shape.body in flexible and station_of(action, shape) is None

    shapes = [
        {
            "b": names[s.body],
            "r": s.role,
            "c": int(s.closed),
            "p": _rounded(1e3 * (s.points if bends(s) else _thin(s.points, 2e-5)), 3),
            "s": _rounded(1e3 * x, 3) if (x := station_of(action, s)) is not None else None,
        }
        for s in drawn.shapes
    ]
    poses = np.zeros((len(film.time), len(bodies), 3))
    points = np.zeros((len(film.time), len(film.contacts), 4))
    beams: dict[int, list[Any]] = {}
    finger = action.config.finger
    for i in range(len(film.time)):
        at = film.poses(i)
        poses[i] = [[1e3 * at[b][0], 1e3 * at[b][1], at[b][2]] for b in bodies]
        rows = contact_rows(action, film.q[i])
        points[i] = [
            [1e3 * rows[n][0], 1e3 * rows[n][1], rows[n][2], rows[n][3]] for n in film.contacts
        ]
        for body, line in bent_beams(action, film.q[i]).items():
            beams.setdefault(names[body], []).append(_rounded(1e3 * line[::3], 4))
        if progress is not None:
            progress((i + 1) / len(film.time))
    data: dict[str, Any] = {
        "time": _rounded(1e3 * film.time, 4),
        "unit": round(1e3 * drawn.unit, 4),
        "slowness": slowness,
        "view": _rounded(1e3 * np.array(film.limits), 2),
        "colors": [body_fill(drawn.group[b]) for b in bodies],
        "shapes": shapes,
        "poses": _rounded(poses, 5),
        "beams": [
            {"b": b, "length": 1e3 * (action.config.bodies[bodies[b]].length or 1.0), "line": line}
            for b, line in beams.items()
        ],
        "contacts": [
            {
                "number": n,
                "label": action.config.contacts[f"{n:02d}"].label or f"contact {n}",
                "force": _rounded(film.forces[n], 4),
                "at": _rounded(points[:, k], 4),
                "sides": film.sides[n],
            }
            for k, n in enumerate(film.contacts)
        ],
        "largest": film.largest,
        "joints": [
            {"b": names[parent], "p": _rounded(1e3 * place, 3), "g": int(parent == "ground")}
            for _, kind, parent, place in moving_joints(action)
            if kind == "revolute"
        ],
        "springs": [
            {
                "b": names[body],
                "p": _rounded(1e3 * spiral(4.6 * drawn.unit), 3),
            }
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
        "string": _rounded(1e3 * film.string, 3) if film.string is not None else None,
        "finger": None,
        "speed": None,
        "events": [
            [round(1e3 * t, 4), name.replace("_", " ")]
            for t, name in named_events(film.run)
            if film.time[0] <= t <= film.time[-1]
        ],
    }
    if finger is not None and film.finger is not None:
        direction = np.array(finger.direction) / np.hypot(*finger.direction)
        data["finger"] = {
            "b": names[finger.body],
            "p": _rounded(1e3 * np.array(finger.point), 3),
            "d": _rounded(direction, 5),
            "force": _rounded(film.finger, 4),
        }
    if film.speed is not None:
        data["speed"] = _rounded(np.interp(film.time, film.run.time, film.speed), 5)
    # Inside a script element only "<" could end it; & and > are escaped for good measure.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    for sign, code in (
        ("<", "\\u003c"),
        (">", "\\u003e"),
        ("&", "\\u0026"),
        ("\u2028", "\\u2028"),
        ("\u2029", "\\u2029"),
    ):
        text = text.replace(sign, code)
    parts = [
        str(film.run.provenance.get("action", "")),
        str(film.run.provenance.get("stroke", {}).get("name", "")),
    ]
    title = html.escape(" · ".join(p for p in parts if p) or "motion")
    return _PAGE.replace("@TITLE@", title, 2).replace("@DATA@", text, 1)


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'">
<title>@TITLE@</title>
<style>
 * { box-sizing: border-box; }
 body { margin: 0; font: 14px/1.35 system-ui, sans-serif; color: #222; background: #fff; }
 header { padding: 10px 16px 4px; display: flex; gap: 24px; align-items: baseline; }
 h1 { font-size: 17px; margin: 0; }
 #clock { font-variant-numeric: tabular-nums; }
 main { display: grid; grid-template-columns: minmax(0, 1fr) 330px; gap: 12px; padding: 0 16px; }
 @media (max-width: 900px) { main { grid-template-columns: minmax(0, 1fr); } }
 canvas { display: block; width: 100%; }
 #stage { border: 1px solid #ddd; }
 #controls { display: flex; gap: 12px; align-items: center; padding: 10px 16px; flex-wrap: wrap; }
 #time { flex: 1 1 320px; }
 button { font: inherit; min-width: 72px; padding: 3px 10px; }
 table { border-collapse: collapse; width: 100%; font-size: 12.5px; margin-top: 8px; }
 td { padding: 1px 4px; }
 td.n { text-align: right; width: 2em; color: #8e1b1b; }
 td.f { text-align: right; width: 5em; font-variant-numeric: tabular-nums; }
 td.bar { width: 60px; }
 td.bar div { height: 8px; background: #D55E00; width: 0; }
 .hint { color: #666; font-size: 12px; }
</style>
</head>
<body>
<header><h1>@TITLE@</h1><span id="clock"></span><span id="event" class="hint"></span></header>
<main>
 <div><canvas id="stage"></canvas></div>
 <div>
  <canvas id="curve"></canvas>
  <table id="forces"></table>
  <p class="hint">Arrows: contact forces on the bodies that move, length by the root of the force.
  Keys: space plays, arrows step.</p>
 </div>
</main>
<div id="controls">
 <button id="play">Play</button>
 <input id="time" type="range" min="0" max="1000" step="1" value="0" aria-label="time">
 <label>times slower <input id="slow" type="number" min="0.5" max="2000" step="any"
  style="width:6em"></label>
 <label><input id="arrows" type="checkbox" checked> forces</label>
</div>
<script type="application/json" id="data">@DATA@</script>
<script>
"use strict";
const D = JSON.parse(document.getElementById("data").textContent);
const $ = id => document.getElementById(id);
const N = D.time.length, T0 = D.time[0], T1 = D.time[N - 1];
let now = T0, playing = false, last = 0;
const stage = $("stage"), curve = $("curve");
const [[X0, Y0], [X1, Y1]] = D.view;
let scale = 1;

function fit(canvas, ratio) {
  const w = canvas.parentElement.clientWidth, h = Math.min(w * ratio, 0.82 * innerHeight);
  const dpr = devicePixelRatio || 1;
  canvas.style.height = h + "px";
  canvas.width = Math.round(w * dpr); canvas.height = Math.round(h * dpr);
  return [w, h, dpr];
}
function mix(a, b, s) { return a + (b - a) * s; }
function frame() {
  let lo = 0, hi = N - 1;
  while (hi - lo > 1) { const m = (lo + hi) >> 1; if (D.time[m] <= now) lo = m; else hi = m; }
  const s = (now - D.time[lo]) / (D.time[hi] - D.time[lo]);
  return [lo, hi, Math.max(0, Math.min(1, s))];
}
function pose(b, f) {
  const p = D.poses[f[0]][b], q = D.poses[f[1]][b];
  return [mix(p[0], q[0], f[2]), mix(p[1], q[1], f[2]), mix(p[2], q[2], f[2])];
}
function place(b, x, y, f) {
  const [px, py, a] = pose(b, f), c = Math.cos(a), s = Math.sin(a);
  return [px + c * x - s * y, py + s * x + c * y];
}
function path(g, points, close) {
  g.beginPath();
  points.forEach((p, i) => i ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1]));
  if (close) g.closePath();
}
const bodies = D.colors.map((color, b) => ({
  color, shapes: D.shapes.filter(s => s.b === b), beam: D.beams.find(x => x.b === b)}));
function bend(beam, shape, f) {
  const a = beam.line[f[0]], b = beam.line[f[1]], n = a.length - 1;
  const line = a.map((p, i) => [mix(p[0], b[i][0], f[2]), mix(p[1], b[i][1], f[2])]);
  // A surface stays straight: it moves with the cross section that it is fixed to.
  return shape.p.map(([x, y]) => {
    const s = shape.s ?? Math.max(0, Math.min(beam.length, x)), w = s / beam.length * n;
    const i = Math.min(n - 1, Math.floor(w)), p = line[i], q = line[i + 1];
    const l = Math.hypot(q[0] - p[0], q[1] - p[1]);
    const tx = (q[0] - p[0]) / l, ty = (q[1] - p[1]) / l;
    return [mix(p[0], q[0], w - i) + (x - s) * tx - y * ty,
            mix(p[1], q[1], w - i) + (x - s) * ty + y * tx];
  });
}
function arrow(g, x, y, dx, dy, u) {
  const l = Math.hypot(dx, dy), e = Math.min(4.5 * u, 0.5 * l) / l;
  g.beginPath(); g.moveTo(x, y);
  g.lineTo(x + dx * (1 - 0.6 * e), y + dy * (1 - 0.6 * e)); g.stroke();
  const hx = x + dx, hy = y + dy;
  g.beginPath(); g.moveTo(hx, hy);
  g.lineTo(hx - e * (dx - 0.4 * dy), hy - e * (dy + 0.4 * dx));
  g.lineTo(hx - e * (dx + 0.4 * dy), hy - e * (dy - 0.4 * dx)); g.closePath(); g.fill();
}
function drawStage(f) {
  const g = stage.getContext("2d"), u = D.unit, dpr = devicePixelRatio || 1;
  g.setTransform(1, 0, 0, 1, 0, 0);
  g.clearRect(0, 0, stage.width, stage.height);
  scale = Math.min(stage.width / (X1 - X0), stage.height / (Y1 - Y0));
  const ox = 0.5 * (stage.width - scale * (X1 - X0)) - scale * X0;
  const oy = 0.5 * (stage.height + scale * (Y1 - Y0)) + scale * Y0;
  g.setTransform(scale, 0, 0, -scale, ox, oy);
  g.lineJoin = g.lineCap = "round";
  const px = dpr / scale;
  if (D.string) {
    const a = D.string[f[0]], b = D.string[f[1]];
    path(g, a.map((p, i) => [mix(p[0], b[i][0], f[2]), mix(p[1], b[i][1], f[2])]), false);
    g.strokeStyle = "#3a3a3a"; g.lineWidth = 1.8 * px; g.stroke();
  }
  for (const j of D.joints) if (j.g) {
    const [x, y] = j.p;
    path(g, [[x, y], [x - 4.2 * u, y - 7 * u], [x + 4.2 * u, y - 7 * u]], true);
    g.fillStyle = "#fff"; g.fill(); g.strokeStyle = "#777"; g.lineWidth = px; g.stroke();
  }
  bodies.forEach((body, b) => {
    if (!body.shapes.length) return;
    const [x, y, a] = pose(b, f);
    const at = body.beam ? s => bend(body.beam, s, f) : s => s.p;
    g.save(); g.translate(x, y); g.rotate(a);
    const roles = [["wire", "#8a8a8a", "#555"], ["wood", body.color, "#3a3a3a"]];
    for (const [role, fill, ink] of roles) {
      const own = body.shapes.filter(s => s.r === role);
      g.strokeStyle = ink; g.lineWidth = 2.2 * px;
      for (const s of own) { path(g, at(s), true); g.stroke(); }
      g.fillStyle = fill;
      for (const s of own) { path(g, at(s), true); g.fill(); }
    }
    for (const s of body.shapes) if (s.r === "pad") {
      path(g, at(s), true); g.fillStyle = b ? "rgba(199,123,116,.45)" : body.color; g.fill();
    }
    g.strokeStyle = "#8e1b1b"; g.lineWidth = 1.4 * px;
    for (const s of body.shapes) if (s.r === "surface") { path(g, at(s), false); g.stroke(); }
    g.restore();
  });
  for (const s of D.straps) {
    const a = place(s.a[0], s.a[1], s.a[2], f), b = place(s.b[0], s.b[1], s.b[2], f);
    const gap = Math.hypot(b[0] - a[0], b[1] - a[1]);
    const sag = gap < s.free ? Math.min(Math.sqrt(0.375 * gap * (s.free - gap)), 0.5 * s.free) : 0;
    g.beginPath(); g.moveTo(a[0], a[1]);
    g.quadraticCurveTo(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]) - 2 * sag, b[0], b[1]);
    g.strokeStyle = "#CC79A7"; g.lineWidth = 1.8 * px; g.stroke();
  }
  g.strokeStyle = "#009E73"; g.lineWidth = 1.2 * px;
  for (const s of D.springs) {
    const [x, y, a] = pose(s.b, f);
    g.save(); g.translate(x, y); g.rotate(a); path(g, s.p, false); g.stroke(); g.restore();
  }
  for (const j of D.joints) {
    const [x, y] = place(j.b, j.p[0], j.p[1], f);
    g.beginPath(); g.arc(x, y, 1.7 * u, 0, 7); g.fillStyle = "#fff"; g.fill();
    g.strokeStyle = "#3a3a3a"; g.lineWidth = 1.3 * px; g.stroke();
  }
  if (!$("arrows").checked || !(D.largest > 0)) return;
  g.strokeStyle = g.fillStyle = "#D55E00"; g.lineWidth = 2.2 * px;
  for (const c of D.contacts) {
    const force = mix(c.force[f[0]], c.force[f[1]], f[2]);
    if (force <= 1e-3 * D.largest) continue;
    const a = c.at[f[0]], b = c.at[f[1]], at = a.map((v, i) => mix(v, b[i], f[2]));
    const l = 45 * u * Math.sqrt(force / D.largest);
    for (const s of c.sides) arrow(g, at[0], at[1], s * l * at[2], s * l * at[3], u);
  }
  if (D.finger) {
    const force = mix(D.finger.force[f[0]], D.finger.force[f[1]], f[2]);
    if (Math.abs(force) > 1e-3 * D.largest) {
      const l = 45 * u * Math.sqrt(Math.abs(force) / D.largest) * Math.sign(force);
      const [x, y] = place(D.finger.b, D.finger.p[0], D.finger.p[1], f);
      const dx = l * D.finger.d[0], dy = l * D.finger.d[1];
      arrow(g, x - dx, y - dy, dx, dy, u);
    }
  }
}
function niceStep(span, count) {
  const raw = span / count, p = Math.pow(10, Math.floor(Math.log10(raw)));
  return p * [1, 2, 5, 10].find(m => m * p >= raw);
}
function drawCurve(f) {
  if (!D.speed) { curve.style.display = "none"; return; }
  const g = curve.getContext("2d"), dpr = devicePixelRatio || 1;
  g.setTransform(dpr, 0, 0, dpr, 0, 0);
  const w = curve.width / dpr, h = curve.height / dpr, L = 36, B = 34, R = 8, Tp = 22;
  g.clearRect(0, 0, w, h);
  let lo = Math.min(...D.speed), hi = Math.max(...D.speed);
  const pad = 0.07 * (hi - lo) || 1; lo -= pad; hi += pad;
  const X = t => L + (w - L - R) * (t - T0) / (T1 - T0);
  const Y = v => h - B - (h - B - Tp) * (v - lo) / (hi - lo);
  g.font = "11px system-ui, sans-serif"; g.fillStyle = "#444";
  g.strokeStyle = "#e6e6e6"; g.lineWidth = 1;
  g.textAlign = "right"; g.textBaseline = "middle";
  const sv = niceStep(hi - lo, 5);
  for (let v = Math.ceil(lo / sv) * sv; v <= hi; v += sv) {
    g.beginPath(); g.moveTo(L, Y(v)); g.lineTo(w - R, Y(v)); g.stroke();
    g.fillText(String(+v.toFixed(6)), L - 5, Y(v));
  }
  g.textAlign = "center"; g.textBaseline = "top";
  const st = niceStep(T1 - T0, 5);
  for (let t = Math.ceil(T0 / st) * st; t <= T1; t += st) {
    g.beginPath(); g.moveTo(X(t), Tp); g.lineTo(X(t), h - B); g.stroke();
    g.fillText(String(+t.toFixed(6)), X(t), h - B + 4);
  }
  g.fillText("time, ms", 0.5 * (L + w - R), h - 14);
  g.textAlign = "left"; g.fillText("hammer speed toward string, m/s", 4, 3);
  path(g, D.speed.map((v, i) => [X(D.time[i]), Y(v)]), false);
  g.strokeStyle = "#D55E00"; g.lineWidth = 1.5; g.stroke();
  const v = mix(D.speed[f[0]], D.speed[f[1]], f[2]);
  g.strokeStyle = "#777"; g.lineWidth = 1;
  g.beginPath(); g.moveTo(X(now), Tp); g.lineTo(X(now), h - B); g.stroke();
  g.beginPath(); g.arc(X(now), Y(v), 4, 0, 7); g.fillStyle = "#222"; g.fill();
}
const rows = D.contacts.map(c => {
  const row = $("forces").insertRow();
  const cell = (name, text) => {
    const e = row.insertCell(); e.className = name; e.textContent = text; return e;
  };
  cell("n", c.number); cell("", c.label);
  const value = cell("f", ""), bar = document.createElement("div");
  cell("bar", "").appendChild(bar);
  return {c, value, bar};
});
function render() {
  const f = frame();
  drawStage(f); drawCurve(f);
  $("clock").textContent = now.toFixed(2) + " ms";
  const past = D.events.filter(e => e[0] <= now);
  const event = past[past.length - 1];
  $("event").textContent = event ? event[1] + " at " + event[0].toFixed(2) + " ms" : "";
  $("time").value = Math.round(1000 * (now - T0) / (T1 - T0));
  for (const r of rows) {
    const force = mix(r.c.force[f[0]], r.c.force[f[1]], f[2]);
    r.value.textContent = force > 0 ? force.toFixed(2) + " N" : "";
    r.bar.style.width = (D.largest > 0 ? 60 * Math.sqrt(force / D.largest) : 0) + "px";
  }
}
function layout() { fit(stage, (Y1 - Y0) / (X1 - X0)); fit(curve, 0.62); render(); }
function tick(stamp) {
  if (!playing) return;
  if (last) now += (stamp - last) / Math.max(1e-6, +$("slow").value || D.slowness);
  last = stamp;
  if (now >= T1) now = T0;
  render();
  requestAnimationFrame(tick);
}
function toggle(on) {
  playing = on; last = 0; $("play").textContent = on ? "Pause" : "Play";
  if (on) requestAnimationFrame(tick);
}
$("slow").value = D.slowness;
$("play").onclick = () => toggle(!playing);
$("time").oninput = e => {
  toggle(false); now = T0 + (T1 - T0) * e.target.value / 1000; render();
};
$("arrows").onchange = render;
addEventListener("keydown", e => {
  if (e.target.id === "slow") return;
  if (e.key === " ") { e.preventDefault(); toggle(!playing); }
  const step = {ArrowRight: 1, ArrowLeft: -1}[e.key];
  if (step) { e.preventDefault(); toggle(false);
    now = Math.max(T0, Math.min(T1, now + step * (T1 - T0) / (N - 1))); render(); }
});
addEventListener("resize", layout);
const asked = /^#t=([0-9.]+)$/.exec(location.hash);
if (asked) now = Math.max(T0, Math.min(T1, +asked[1]));
layout();
</script>
</body>
</html>
"""
