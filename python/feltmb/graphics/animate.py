"""Animation of a run as GIF; :mod:`feltmb.graphics.viewer` makes an animation in HTML.

The mechanism is made again from the parameters in the run, and drawn like
:func:`feltmb.graphics.plot.mechanism`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb.graphics.film import Film, time_window
from feltmb.graphics.plot.axes import set_window
from feltmb.graphics.plot.drawing import draw_bodies, draw_fixed, draw_joints
from feltmb.graphics.plot.poses import (
    bent_beams,
    body_poses,
    to_ground,
)
from feltmb.graphics.plot.readings import MOST_LETTERS, run_action, run_name
from feltmb.graphics.plot.series import striker_name
from feltmb.graphics.plot.shapes import shape_points, upper_right_is_free
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.files import check_writable, write_file
from unmodeled.style import (
    BLACK,
    INK,
    NORMAL,
    PAD,
    PURPLE,
    RED,
    SMALL,
    SURFACE,
    fit_text,
    new_figure,
    style_axes,
)

if TYPE_CHECKING:
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]
Progress = Callable[[float], object]

__all__ = ["animate"]

MOST_FRAMES = 5000


@checked
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
    """Write the motion of a run as GIF.

    Parameters
    ----------
    run
        Run with all coordinates and its parameters.
    path
        File with the suffix ``.gif``.
    fps
        Frames per second, 1 to 50. The delay between frames of a GIF is a multiple of 10 ms. The
        nearest one is used and the motion is sampled accordingly, so that ``slowness`` is exact.
    slowness
        Ratio of the duration of the animation to the duration of the motion.
    window
        First and last time [s]; default: from the first to the last motion of the run.
    force
        Whether an existing file is replaced.
    progress
        Function that is called with the completed share, 0 to 1.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    InvalidParameter
        An argument is out of range, the file has another suffix, or the run lacks coordinates.
    FileExists
        The file exists and ``force`` is false.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise InvalidParameter(
            f"animate: got {path.name!r}, expected a name in .gif; feltmb view writes HTML"
        )
    if not (math.isfinite(fps) and 1 <= fps <= 50):
        raise InvalidParameter(f"animate: fps = {fps:g}, must lie in [1, 50]")
    if not (math.isfinite(slowness) and slowness > 0):
        raise InvalidParameter(f"animate: slowness = {slowness:g}, must be > 0")
    start, end = time_window(run, window, "animate")
    check_writable(path, force=force)
    action = run_action(run)
    delay = max(2, round(100.0 / fps))  # hundredths of a second
    film = Film(run, action, _times(start, end, 0.01 * delay / slowness))
    return _write_gif(film, path, delay, slowness, force, progress)


def _times(start: float, end: float, step: float) -> Array:
    count = math.floor((end - start) / step + 1e-9) + 1
    if count > MOST_FRAMES:
        raise InvalidParameter(
            f"animate: {count} pictures, the limit is {MOST_FRAMES}; choose a shorter window or a "
            "smaller slowness"
        )
    out: Array = start + step * np.arange(max(count, 2), dtype=np.float64)
    return out


# --- GIF -----------------------------------------------------------------------------------------


def _write_gif(
    film: Film,
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
        # One palette for all frames and no dithering: unchanged parts remain unchanged and need no
        # data.
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
    """Colors of the first frame, and further colors that it may lack."""
    from matplotlib.colors import to_rgb
    from PIL import Image

    found = image.quantize(colors=112, dither=Image.Dither.NONE).getpalette()[: 3 * 112]
    # Almost white becomes white: the background must be one color.
    for i in range(0, len(found), 3):
        if min(found[i : i + 3]) > 247:
            found[i : i + 3] = [255, 255, 255]
    for color in ("#FFFFFF", RED, PURPLE, INK, BLACK, SURFACE, PAD):
        rgb = np.array(to_rgb(color))
        # Also colors half-way to white, for smooth edges.
        for share in (1.0, 0.5):
            found += [int(v) for v in np.round(255.0 * (share * rgb + (1.0 - share)))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(found)
    return palette


def _empty_stage(film: Film) -> tuple[Any, Any]:
    """Figure and axes with what does not move."""
    low, high = film.limits
    width = 7.6
    height = float(np.clip(width * (high[1] - low[1]) / (high[0] - low[0]), 3.0, 8.0)) + 0.3
    # The limits fill the axes at an equal scale: matplotlib would cut what it must adjust.
    scale = max((high - low) / (width, height - 0.3))
    middle, half = 0.5 * (low + high), 0.5 * scale * np.array([width, height - 0.3])
    figure = new_figure(width, height)
    figure.set_layout_engine("none")
    figure.set_dpi(100)
    ax = figure.add_axes((0.0, 0.0, 1.0, (height - 0.3) / height))
    ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
    ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
    ax.set_axis_off()
    # Text and lines of the frames are those of a small figure.
    name = shortened(run_name(film.run), MOST_LETTERS)
    figure.text(0.01, 1.0 - 0.07 / height, name, fontsize=NORMAL, va="top", fontweight="bold")
    draw_fixed(ax, film.action, film.scene, film.limits, with_string=False)
    return figure, ax


def _pictures(film: Film, slowness: float) -> Any:
    """Yield RGB frames (height, width, 3); fixed parts are drawn only once."""
    figure, ax = _empty_stage(film)
    canvas: Any = figure.canvas
    marker = _speed_inset(film, figure, ax)
    parts = _MovingParts(film, ax)
    clock = figure.text(
        0.99,
        1.0 - 0.07 / figure.get_figheight(),
        "",
        fontsize=NORMAL,
        va="top",
        ha="right",
        family="monospace",
    )
    changing = [*parts.artists, clock] + ([marker] if marker is not None else [])
    for artist in changing:
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    parts.attach()
    for i, time in enumerate(film.time):
        parts.move(i)
        clock.set_text(f"{1e3 * time:7.2f} ms, {slowness:g} times slower")
        if marker is not None and film.speed is not None:
            marker.set_data([1e3 * time], [np.interp(time, film.run.time, film.speed)])
        canvas.restore_region(background)
        for artist in changing:
            (artist.axes or figure).draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


class _MovingParts:
    """Bodies, joints, straps, string and arrows of the forces."""

    def __init__(self, film: Film, ax: Any) -> None:
        from matplotlib.collections import LineCollection
        from matplotlib.transforms import Affine2D

        self.film, self.ax = film, ax
        action, drawn, poses = film.action, film.scene, film.poses(0)
        self.bodies = draw_bodies(ax, action, drawn, poses, bent_beams(action, film.q[0]))
        self.rigid: list[tuple[str, Any]] = [
            (body, artist)
            for body, own in self.bodies.items()
            for artist, _ in own
            if body != "ground"
        ]
        self.rigid += draw_joints(ax, action, drawn, poses)
        self.frames: dict[str, Any] = {body: Affine2D() for body, _ in self.rigid}
        self.straps = [
            ax.plot(*curve.T, color=PURPLE, linewidth=1.2, zorder=5.3)[0]
            for curve in film.straps(0, poses)
        ]
        strings = [] if film.string is None else [film.string]
        self.strings = [
            (ax.plot(*way[0].T, color=INK, linewidth=1.4, zorder=1.5)[0], way) for way in strings
        ]
        self.arrows = LineCollection([], colors=RED, linewidths=1.8, zorder=7)
        ax.add_collection(self.arrows, autolim=False)

    @property
    def artists(self) -> list[Any]:
        """All of them, in the order of drawing."""
        lines = [*self.straps, *(line for line, _ in self.strings), self.arrows]
        every = [artist for _, artist in self.rigid] + lines
        return sorted(every, key=lambda artist: float(artist.get_zorder()))

    def attach(self) -> None:
        """Let the frames of the bodies move their artists."""
        for body, artist in self.rigid:
            artist.set_transform(self.frames[body] + self.ax.transData)

    def move(self, i: int) -> None:
        """Show the instant of a number."""
        film, poses = self.film, self.film.poses(i)
        for body, frame in self.frames.items():
            x, y, angle = poses[body]
            frame.clear().rotate(angle).translate(x, y)
        bent = bent_beams(film.action, film.q[i])
        for body in bent:
            for artist, shapes in self.bodies[body]:
                artist.set_verts([shape_points(film.action, s, bent) for s in shapes])
        for line, curve in zip(self.straps, film.straps(i, poses), strict=True):
            line.set_data(*curve.T)
        for line, way in self.strings:
            line.set_data(*way[i].T)
        self.arrows.set_segments(_arrow_lines(film.arrows(i, poses), film.scene.unit))


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


def _speed_inset(film: Film, figure: Any, ax: Any) -> Any:
    """Curve of the striker's speed in a free corner; returns its marker, or None."""
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
    style_axes(small, "time [ms]", "")
    title = small.set_title(
        f"speed of the {striker_name(film.run)} [m/s]", fontsize=SMALL, loc="left"
    )
    fit_text(title, 0.37 * figure.get_figwidth())
    small.xaxis.label.set_size(SMALL)
    small.tick_params(labelsize=SMALL)
    set_window(small, (float(film.time[0]), float(film.time[-1])))
    return small.plot([], [], "o", color=BLACK, markersize=5)[0]
