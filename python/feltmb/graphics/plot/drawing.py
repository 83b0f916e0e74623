"""Draws bodies, joints and fixed parts on axes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb.graphics.plot.outlines import spiral
from feltmb.graphics.plot.poses import Pose, moving_joints, spring_bodies, string_line, string_reach
from feltmb.graphics.plot.shapes import Scene, Shape, shape_points
from unmodeled.style import GRAY, GREEN, INK, PAD, RAIL, SURFACE, body_fill

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from feltmb.mechanism import Action

Array = npt.NDArray[np.float64]


def body_transform(ax: Axes, pose: Pose) -> Any:
    """Transformation from the frame of a body [m] to the axes."""
    from matplotlib.transforms import Affine2D

    return Affine2D().rotate(pose[2]).translate(pose[0], pose[1]) + ax.transData


def draw_bodies(
    ax: Axes,
    action: Action,
    drawn: Scene,
    poses: Mapping[str, Pose],
    bent: Mapping[str, Array],
    fills: Mapping[str, str] | None = None,
) -> dict[str, list[tuple[Any, list[Shape]]]]:
    """Draw the shapes [m]; returns artists by body, so that a pose is one transformation each.

    ``bent``: center lines of flexible beams; ``fills``: other colors of bodies.
    """
    artists: dict[str, list[Any]] = {}
    for order, body in enumerate(("ground", *action.config.bodies)):
        own = [(s, shape_points(action, s, bent)) for s in drawn.shapes if s.body == body]
        fill = (fills or {}).get(body)
        colors = {
            "wire": (fill or "#8A8A8A", "#555555"),
            "wood": (fill or body_fill(drawn.group[body]), INK),
            "lead": ("#8A8A8A", "#555555"),
        }
        pads = {"facecolors": PAD, "alpha": 0.45} if body != "ground" else {"facecolors": RAIL}
        artists[body] = list(_artists(own, colors, pads, 2.0 + 0.1 * order))
        for artist, _ in artists[body]:
            artist.set_transform(body_transform(ax, poses[body]))
            ax.add_collection(artist, autolim=False)
    return artists


def _artists(
    own: Sequence[tuple[Shape, Array]],
    colors: Mapping[str, tuple[str, str]],
    pads: Mapping[str, Any],
    z: float,
) -> Iterator[tuple[Any, list[Shape]]]:
    """Artists of the shapes of a body, with their shapes. ``colors``: fill and ink by role."""
    from matplotlib.collections import LineCollection, PolyCollection

    for role, (fill, ink) in colors.items():
        chosen = [s for s, _ in own if s.role == role]
        if outlines := [points for s, points in own if s.role == role]:
            # All outlines are drawn before all fills, so that overlapping parts look like one part.
            yield (
                PolyCollection(outlines, facecolors=ink, edgecolors=ink, linewidths=1.3, zorder=z),
                chosen,
            )
            yield (
                PolyCollection(outlines, facecolors=fill, edgecolors="none", zorder=z + 0.01),
                chosen,
            )
    if outlines := [points for s, points in own if s.role == "pad"]:
        made = PolyCollection(outlines, edgecolors="none", zorder=z + 0.02, **pads)
        yield made, [s for s, _ in own if s.role == "pad"]
    for s, points in own:
        if s.role == "surface":
            line = LineCollection([points], colors=SURFACE, linewidths=1.1, zorder=z + 0.03)
            line.set_gid(f"surface:{s.name}")
            yield line, [s]


def draw_fixed(
    ax: Axes,
    action: Action,
    drawn: Scene,
    limits: tuple[Array, Array],
    *,
    with_string: bool = True,
) -> None:
    """Draw the string at rest and the symbols of the ground joints [m]."""
    u = drawn.unit
    line = string_line(action)
    if line is not None and with_string:
        start, along, *_ = line
        ends = np.array([start, start + along * string_reach(line, limits)])
        ax.plot(ends[:, 0], ends[:, 1], color=INK, linewidth=1.8, zorder=1.5, gid="string")
        ax.plot([start[0]], [start[1]], marker="s", markersize=4, color=INK, zorder=1.6)
    for _, kind, parent, place in moving_joints(action):
        if parent == "ground" and kind == "revolute":
            foot = place + np.array([[0.0, 0.0], [-4.2 * u, -7.0 * u], [4.2 * u, -7.0 * u]])
            ax.fill(
                foot[:, 0], foot[:, 1], facecolor="white", edgecolor=GRAY, linewidth=0.8, zorder=1.7
            )
            for k in range(5):
                x = place[0] + (-4.2 + 2.1 * k) * u
                y = place[1] - 7.0 * u
                ax.plot([x, x - 1.8 * u], [y, y - 2.2 * u], color=GRAY, linewidth=0.7, zorder=1.7)


def draw_joints(ax: Axes, action: Action, drawn: Scene, poses: Mapping[str, Pose]) -> list[Any]:
    """Draw the pins and slides of the joints; returns artists, with their frame as ``body``."""
    u = drawn.unit
    angle = np.linspace(0.0, 2.0 * math.pi, 25)
    ring = 1.7 * u * np.column_stack([np.cos(angle), np.sin(angle)])
    out: list[Any] = []
    for name, kind, parent, place in moving_joints(action):
        if kind == "prismatic":
            axis = np.array(action.config.bodies[name].axis)
            axis = axis / np.hypot(*axis)
            side = np.array([axis[1], -axis[0]])
            for sign in (-1.0, 1.0):
                rail = place + np.array([-9.0 * u * axis, 9.0 * u * axis]) + sign * 2.6 * u * side
                (line,) = ax.plot(rail[:, 0], rail[:, 1], color=GRAY, linewidth=1.2, zorder=5.0)
                line.set_transform(body_transform(ax, poses[parent]))
                out.append((parent, line))
        else:
            (pin,) = ax.fill(
                ring[:, 0] + place[0],
                ring[:, 1] + place[1],
                facecolor="white",
                edgecolor=INK,
                linewidth=1.1,
                zorder=5.2,
            )
            pin.set_transform(body_transform(ax, poses[parent]))
            out.append((parent, pin))
    for body in spring_bodies(action):
        points = spiral(4.6 * u)
        (line,) = ax.plot(points[:, 0], points[:, 1], color=GREEN, linewidth=0.9, zorder=5.1)
        line.set_transform(body_transform(ax, poses[body]))
        out.append((body, line))
    return out
