"""A robot before and after the changes: a video side by side, and the residual by joint."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.files import write_file
from unmodeled.fit.mjcf_changes import import_mujoco
from unmodeled.pictures.curves import Motion, Motions
from unmodeled.report.figures import WIDTH, axis_unit
from unmodeled.style import BLACK, BLUE, GRAY, ORANGE, SMALL, new_figure, plain_text, style_axes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Frames a second, longest video [s], height and width of a view and of its margin [pixels].
RATE, LONGEST, SIZE, MARGIN = 12, 10.0, (260, 300), 30
#: Largest number of channels of a figure.
CHANNELS = 12


@dataclass(frozen=True, eq=False)
class View:
    """A robot over time."""

    label: str
    color: str
    model: Any
    shown: Mapping[str, Array]
    """Positions of its joints; the others stay in the pose of the file."""

    def poses(self, frames: NDArray[np.intp]) -> Iterator[Any]:
        """Its data at the samples ``frames``."""
        mj, model = import_mujoco(), self.model
        data = mj.MjData(model)
        at = {model.joint(i).name: int(model.jnt_qposadr[i])
              for i in range(model.njnt) if model.jnt_type[i] >= 2}  # fmt: skip
        named = {n: at[j] for j in at for n in (j, f"{j}.position") if n in self.shown}
        for k in frames:
            for name, row in named.items():
                if np.isfinite(self.shown[name][k]):
                    data.qpos[row] = self.shown[name][k]
            mj.mj_forward(model, data)
            yield data


def views_of(file: Any, fixed: Any, shown: tuple[Mapping[str, Array], ...]) -> list[View]:
    """Views of what was measured, of the model as it is, and of the one with the changes."""
    labels = "measured", "the model as it is", "with the changes"
    rows = zip(labels, (BLACK, ORANGE, BLUE), (fixed, file, fixed), shown, strict=True)
    return [View(*row) for row in rows]


def film(path: Path, time: Array, views: list[View], *, force: bool) -> Path:
    """See :meth:`unmodeled.Explained.film`."""
    from PIL import Image, ImageDraw

    end = min(float(time[-1]), float(time[0]) + LONGEST)
    frames = np.searchsorted(time, np.arange(float(time[0]), end, 1.0 / RATE))
    try:
        shown = [_rendered(view, frames) for view in views]
    except Exception:  # no graphics on this machine, in many ways
        shown = _drawn(views, frames)
    pictures = []
    for frame in zip(*shown, strict=True):
        picture = Image.fromarray(np.hstack(frame))
        for k, view in enumerate(views):
            place = k * SIZE[1] + MARGIN // 2, MARGIN // 4
            ImageDraw.Draw(picture).text(place, view.label, fill=view.color, stroke_fill="white",
                                         stroke_width=1)  # fmt: skip
        pictures.append(picture)
    how = {"save_all": True, "append_images": pictures[1:], "duration": 1000 // RATE, "loop": 0}
    return write_file(path, lambda p: pictures[0].save(p, "GIF", **how), force=force)


def _rendered(view: View, frames: NDArray[np.intp]) -> list[Array]:
    """Pictures by the renderer of MuJoCo, each (h, w, 3)."""
    pictures = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with import_mujoco().Renderer(view.model, *SIZE) as renderer:
            for data in view.poses(frames):
                renderer.update_scene(data)
                pictures.append(renderer.render().copy())
    return pictures


def _drawn(views: list[View], frames: NDArray[np.intp]) -> list[list[Array]]:
    """A line for each body in the plane in which they move most; behind a model the measured one.

    Pictures of each view, each (h, w, 3).
    """
    from PIL import Image, ImageDraw

    sticks = [np.array([_sticks(view.model, d) for d in view.poses(frames)]) for view in views]
    every = np.concatenate([s.reshape(-1, 3) for s in sticks])
    low, spread = every.min(axis=0), np.ptp(every, axis=0)
    across = int(np.argmax(spread[:2]))
    up = 2 if spread[2] > 0.0 else 1 - across
    scale = min((SIZE[1] - 2 * MARGIN) / spread[across], (SIZE[0] - 2 * MARGIN) / spread[up])
    found: list[list[Array]] = []
    for k, view in enumerate(views):
        found.append([])
        for f in range(len(frames)):
            picture = Image.new("RGB", SIZE[::-1], "white")
            for own, color, width in ((0, GRAY, MARGIN // 4), (k, view.color, MARGIN // 10)):
                x = MARGIN + scale * (sticks[own][f, ..., across] - low[across])
                y = SIZE[0] - MARGIN - scale * (sticks[own][f, ..., up] - low[up])
                for line in np.stack([x, y], axis=-1).reshape(-1, 4):
                    ImageDraw.Draw(picture).line([*map(float, line)], fill=color, width=width)
            found[-1].append(np.asarray(picture))
    return found


def _sticks(model: Any, data: Any) -> Array:
    """Ends of the lines of the bodies, (k, 2, 3): from body to body, the last to its center."""
    parents = model.body_parentid
    moving = [b for b in range(1, model.nbody) if model.body_weldid[b]]
    found = [(data.xpos[parents[b]], data.xpos[b]) for b in moving if parents[b]]
    found += [(data.xpos[b], data.xipos[b]) for b in moving if b not in parents]
    return np.array(found)


def channels(motions: Motions) -> Figure:
    """What the model leaves of each channel before and after the changes, in one record.

    The record is one that was held out, if there is one, else that of the chosen part.

    Parameters
    ----------
    motions
        Motions of the records by channel.
    """
    record = next((m.record for m in motions.whole if m.held_out), motions.chosen.record)
    shown = [m for m in motions.whole if m.record == record][:CHANNELS]
    figure = new_figure(WIDTH, 1.0 + len(shown))
    for k, m in enumerate(shown):
        ax = figure.add_subplot(len(shown), 1, k + 1)
        before, after = m.measured - m.tabulated, m.measured - m.changed
        factor, unit = axis_unit(before, after, unit=m.unit)
        for color, y in ((ORANGE, before), (BLUE, after)):
            ax.plot(m.time, factor * y, color=color, lw=1.0)
        title = f"{m.channel}: {_rms(m, before)} \N{RIGHTWARDS ARROW} {_rms(m, after)}"
        style_axes(ax, "time [s]" if m is shown[-1] else "", f"[{unit}]", plain_text(title))
        ax.locator_params(axis="y", nbins=3)
    label = f"{record}: measured minus the model as it is (orange) and with the changes (blue)"
    figure.suptitle(plain_text(label), fontsize=SMALL)
    return figure


def _rms(m: Motion, residual: Array) -> str:
    factor, unit = axis_unit(residual, unit=m.unit)
    return f"{factor * float(np.sqrt(np.nanmean(residual**2))):.3g} {unit} rms"
