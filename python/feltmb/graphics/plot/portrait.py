"""Drawing of a mechanism with labels: bodies, contacts with numbers, joints, springs, string."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb.graphics.plot.drawing import draw_bodies, draw_fixed, draw_joints
from feltmb.graphics.plot.labels import Labels
from feltmb.graphics.plot.poses import (
    Pose,
    bent_beams,
    body_poses,
    contact_rows,
    point_at,
    spring_bodies,
    strap_curve,
    strap_ends,
    string_line,
    to_ground,
)
from feltmb.graphics.plot.readings import LINE, MOST_LETTERS, run_action
from feltmb.graphics.plot.shapes import Scene, body_center, scene, upper_right_is_free, view_box
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.style import (
    BLACK,
    BLUE,
    DPI,
    GREEN,
    INK,
    LARGE,
    NORMAL,
    PURPLE,
    RAIL,
    RED,
    SMALL,
    SURFACE,
    fit_text,
    new_figure,
    plain_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feltmb.mechanism import Action
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]

#: Distance of the points of outlines that labels avoid [pixels].
SPACING = 5.0

#: Height of the strip below the mechanism with the scale bar, in units of the drawing.
SCALE_STRIP = 14.0
#: Length of the arrow of the finger and space for its label, in units of the drawing.
ARROW, ARROW_LABEL = 32.0, 12.0


@checked
def mechanism(
    action: Action,
    q: npt.ArrayLike | None = None,
    *,
    title: str | None = None,
    shares: Mapping[str, float] | None = None,
) -> Figure:
    """Plot a mechanism in a pose: bodies, numbered contacts, joints, springs, string.

    Contact surfaces (dark red) have the geometry of the simulation. The outlines of the bodies only
    connect their known points: joints, surfaces, center of mass, attachments.

    Parameters
    ----------
    action
        The mechanism.
    q
        Coordinates [rad, m] in the order of ``action.coordinates``; default: at rest.
    title
        Name of the pose, after the name of the mechanism; default: ``at rest``, or nothing.
    shares
        Shares by body [1]; they color the bodies from white to orange. Bodies without a share are
        white.

    Raises
    ------
    InvalidParameter
        The pose has the wrong length, or there is nothing to plot.
    """
    if q is None and title is None:
        title = "at rest"
    pose = action.rest_pose if q is None else np.asarray(q, dtype=float).ravel()
    if pose.size != len(action.coordinates):
        raise InvalidParameter(
            f"plot mechanism: the pose has {pose.size} numbers, expected {len(action.coordinates)} "
            f"({', '.join(action.coordinates)})"
        )
    drawn = scene(action, [pose])
    poses = body_poses(action, pose)
    bent = bent_beams(action, pose)
    limits = view_box(action, drawn, [pose])
    cloud = np.vstack([to_ground(poses[s.body], s.points) for s in drawn.shapes])
    line = string_line(action)
    if line is not None:
        start, along, _, length = line
        cloud = np.vstack([cloud, start + np.linspace(0.0, length, 51)[:, None] * along])
    contacts = {int(k): c for k, c in action.config.contacts.items() if c.enabled}
    limits[0][1] -= SCALE_STRIP * drawn.unit
    if action.config.finger is not None:  # its arrow comes from outside
        tail = _finger_tail(action, drawn, poses, bent)
        limits = np.minimum(limits[0], tail), np.maximum(limits[1], tail)
    size = limits[1] - limits[0]
    names = {n: _contact_name(n, c) for n, c in contacts.items()}
    rows = sum(name.count("\n") + 1 for name in names.values()) + 9
    # Space for the list, in inches.
    text_height, text_width = 0.155 * rows + 0.2, 2.9
    width = float(np.clip(8.6 * size[0] / size[1], 4.5, 11.0))
    height = float(np.clip(width * size[1] / size[0], text_height, 8.6))
    # The axes are filled: what the drawing does not need is divided between both sides.
    spare = np.maximum(0.5 * (max(size / (width, height)) * np.array([width, height]) - size), 0.0)
    limits = limits[0] - spare, limits[1] + spare
    inside = upper_right_is_free(
        cloud, limits, np.array([text_width / width, text_height / height])
    )
    figure = new_figure(width + (0.2 if inside else text_width + 0.2), height + 0.5)
    figure.set_layout_engine("none")
    head = figure.text(
        0.0,
        0.0,
        plain_text(f"Mechanism {action.name}" + (f", {title}" if title else "")),
        fontsize=LARGE,
        fontweight="bold",
        va="top",
    )
    fit_text(head, width - (text_width if inside else 0.0))
    figure.set_figheight(figure.get_figheight() + 0.18 * head.get_text().count("\n"))
    total_w, total_h = figure.get_size_inches()
    head.set_position((0.1 / total_w, 1.0 - 0.1 / total_h))
    ax = figure.add_axes(
        (0.1 / total_w, 0.05 / total_h, width / total_w, (height - 0.05) / total_h)
    )
    ax.set_xlim(limits[0][0], limits[1][0])
    ax.set_ylim(limits[0][1], limits[1][1])
    ax.set_aspect("equal", adjustable="box")
    ax.set_axis_off()
    draw_fixed(ax, action, drawn, limits)
    draw_bodies(ax, action, drawn, poses, bent, None if shares is None else _tints(action, shares))
    draw_joints(ax, action, drawn, poses)
    _draw_attachments(ax, action, drawn, poses, bent)
    _draw_scale(ax, drawn, limits)
    figure.draw_without_rendering()
    _label_mechanism(ax, action, drawn, pose, poses)
    _list_contacts(figure, action, names, drawn)
    return figure


def sketch(ax: Axes, action: Action, shares: Mapping[str, float]) -> None:
    """Draw a mechanism at rest without labels; shares color bodies as in :func:`mechanism`."""
    pose = action.rest_pose
    drawn, poses = scene(action, [pose]), body_poses(action, pose)
    bent, limits = bent_beams(action, pose), view_box(action, drawn, [pose])
    ax.set_xlim(limits[0][0], limits[1][0])
    ax.set_ylim(limits[0][1], limits[1][1])
    ax.set_aspect("equal", adjustable="box")
    ax.set_axis_off()
    draw_fixed(ax, action, drawn, limits)
    draw_bodies(ax, action, drawn, poses, bent, _tints(action, shares))
    draw_joints(ax, action, drawn, poses)
    _draw_attachments(ax, action, drawn, poses, bent)


def _tints(action: Action, shares: Mapping[str, float]) -> dict[str, str]:
    """Color by body; white for a body without a share."""
    full = np.array([0xD5, 0x5E, 0x00])
    out = {}
    for body in action.config.bodies:
        share = float(np.clip(shares.get(body, 0.0), 0.0, 1.0))
        red, green, blue = np.round(255 + share * (full - 255)).astype(int)
        out[body] = f"#{red:02x}{green:02x}{blue:02x}"
    return out


def _draw_attachments(
    ax: Axes, action: Action, drawn: Scene, poses: Mapping[str, Pose], bent: Mapping[str, Array]
) -> None:
    u = drawn.unit
    for name, a, b, free in strap_ends(action, poses, bent):
        curve = strap_curve(a, b, free)
        ax.plot(
            curve[:, 0], curve[:, 1], color=PURPLE, linewidth=1.5, zorder=5.3, gid=f"strap:{name}"
        )
        ax.plot(
            *np.array([a, b]).T, "o", color=PURPLE, markersize=2.6, zorder=5.4, linestyle="none"
        )
    for name, body in action.config.bodies.items():
        if body.mass <= 0 and body.kind != "beam":
            continue
        center = point_at(action, poses, bent, name, body_center(action, name))
        ax.plot(
            *center,
            marker="o",
            markersize=5.0,
            color="white",
            markeredgecolor=INK,
            markeredgewidth=0.7,
            zorder=5.5,
        )
        ax.plot(*center, marker="+", markersize=5.0, color=INK, markeredgewidth=0.7, zorder=5.6)
    for name, point in action.config.points.items():
        at = point_at(action, poses, bent, point.body, point.point)
        if point.body in poses:  # behind the body: shows to what a point in the air belongs
            center = point_at(action, poses, bent, point.body, body_center(action, point.body))
            ax.plot(*np.array([center, at]).T, color=BLUE, linewidth=0.7, ls=":", zorder=1.2)
        ax.plot(
            *at,
            marker="D",
            markersize=3.2,
            color=BLUE,
            markeredgecolor="white",
            markeredgewidth=0.4,
            zorder=5.8,
            gid=f"point:{name}",
        )
    finger = action.config.finger
    if finger is not None:
        at = point_at(action, poses, bent, finger.body, finger.point)
        direction = np.array(finger.direction) / np.hypot(*finger.direction)
        ax.annotate(
            "",
            at - 0.6 * u * direction,
            at - ARROW * u * direction,
            arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 1.6},
            zorder=6,
        )
        # Behind an upright arrow, above a level one.
        level = abs(direction[0]) > abs(direction[1])
        x, y = at - (0.6 * ARROW if level else ARROW + 2.0) * u * direction
        ax.text(
            float(x),
            float(y + 3.0 * u * level),
            "finger",
            color=RED,
            fontsize=NORMAL,
            ha="center",
            va="bottom" if level or direction[1] < 0 else "top",
        )


def _finger_tail(
    action: Action, drawn: Scene, poses: Mapping[str, Pose], bent: Mapping[str, Array]
) -> Array:
    """Upper end of the label of the finger [m]."""
    finger = action.config.finger
    assert finger is not None
    at = point_at(action, poses, bent, finger.body, finger.point)
    direction = np.array(finger.direction) / np.hypot(*finger.direction)
    return np.asarray(at - (ARROW + ARROW_LABEL) * drawn.unit * direction)


def _draw_scale(ax: Axes, drawn: Scene, limits: tuple[Array, Array]) -> None:
    """Draw a scale bar of a round length in the lower right corner."""
    span = min(100.0 * drawn.unit, 0.4 * float(limits[1][0] - limits[0][0]))
    round_length = 10.0 ** math.floor(math.log10(span))
    for step in (5.0, 2.0):
        if step * round_length <= span:
            round_length *= step
            break
    x1 = limits[1][0] - 6.0 * drawn.unit
    y = limits[0][1] + 0.3 * SCALE_STRIP * drawn.unit
    ax.plot(
        [x1 - round_length, x1],
        [y, y],
        color=INK,
        linewidth=2.0,
        solid_capstyle="butt",
        gid="scale",
    )
    ax.text(
        x1 - 0.5 * round_length,
        y + 2.0 * drawn.unit,
        f"{1e3 * round_length:g} mm",
        ha="center",
        va="bottom",
        fontsize=SMALL + 0.5,
    )


def _body_label(action: Action, name: str) -> str:
    return plain_text(action.config.bodies[name].label or name.replace("_", " "))


def _obstacles(
    action: Action,
    drawn: Scene,
    poses: Mapping[str, Pose],
    bent: dict[str, Array],
    pixels: Callable[[Array], Array],
) -> Iterator[Array]:
    """Points that labels must not cover [pixels]: outlines, string, arrow of the finger."""
    for shape in drawn.shapes:
        if shape.role in ("surface", "wood", "wire"):
            yield _spaced(pixels(to_ground(poses[shape.body], shape.points)))
    if (line := string_line(action)) is not None:
        start, along, _, length = line
        yield pixels(np.linspace(start, start + along * length, 300))
    if (finger := action.config.finger) is not None:
        at = point_at(action, poses, bent, finger.body, finger.point)
        away = -np.array(finger.direction) / np.hypot(*finger.direction)
        yield pixels(at + np.linspace(0, 42 * drawn.unit, 60)[:, None] * away)


def _label_mechanism(
    ax: Axes, action: Action, drawn: Scene, q: Array, poses: Mapping[str, Pose]
) -> None:
    """Place numbers of contacts and names of bodies without overlaps."""
    bent = bent_beams(action, q)
    to_pixels = ax.transData
    obstacles = [*_obstacles(action, drawn, poses, bent, to_pixels.transform)]
    rows = contact_rows(action, q)
    for key, contact in action.config.contacts.items():
        if contact.enabled:
            x, y, nx, ny, compression = rows[int(key)]
            half = 0.5 * max(-compression, 0.0) * np.array([nx, ny])
            middle = np.array([x, y])
            ends = np.array([middle - half, middle + half])
            if half @ half > (0.4 * drawn.unit) ** 2:
                ax.plot(*ends.T, color=SURFACE, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=5.9)
                obstacles.append(to_pixels.transform(np.linspace(ends[0], ends[1], 10)))
    box = ax.get_window_extent()
    labels = Labels(
        np.vstack(obstacles) if obstacles else np.zeros((0, 2)), (box.x0, box.y0, box.x1, box.y1)
    )
    pixel = DPI / 72.0
    back = to_pixels.inverted()

    def put(text: str, at: Array, size: float, color: str, circle: bool, unit: float) -> None:
        """Write a text near ``at``, one position or several equally good ones [m]."""
        height = 1.5 * size * pixel
        width = 1.65 * size * pixel if circle else (0.6 * size * len(text) + 4.0) * pixel
        anchors = np.atleast_2d(np.asarray(to_pixels.transform(np.atleast_2d(at))))
        pixels, place = labels.place(anchors, width, height, unit)
        at = back.transform(pixels)
        where = back.transform(place)
        toward = pixels - place
        length = float(np.hypot(*toward))
        # The leader ends at the edge of the text box.
        reach = min(
            0.5 * width / abs(toward[0]) if toward[0] else math.inf,
            0.5 * height / abs(toward[1]) if toward[1] else math.inf,
        )
        if length > 0.8 * height and reach < 1.0:
            edge = back.transform(place + toward * reach)
            ax.plot(*np.array([edge, at]).T, color=color, linewidth=0.6, zorder=7)
        options: dict[str, Any] = {}
        if circle:
            options["bbox"] = {
                "boxstyle": "circle,pad=0.22",
                "facecolor": "white",
                "edgecolor": color,
                "linewidth": 0.8,
            }
        ax.text(
            where[0],
            where[1],
            text,
            fontsize=size,
            color=color,
            ha="center",
            va="center",
            zorder=8,
            **options,
        )

    for key, contact in action.config.contacts.items():
        if contact.enabled:
            at = np.array(rows[int(key)][:2])
            put(str(int(key)), at, SMALL, SURFACE, True, 1.6 * SMALL * pixel)
    for name, body in action.config.bodies.items():
        if body.mass <= 0 and body.kind != "beam":
            continue
        middles = [body_center(action, name)] + [
            0.5 * (s.points.min(axis=0) + s.points.max(axis=0))
            for s in drawn.shapes
            if s.body == name and s.role == "wood"
        ]
        at = to_ground(poses[name], np.array(middles))
        put(_body_label(action, name), at, NORMAL, BLACK, False, 2.0 * NORMAL * pixel)
    for name, point in action.config.points.items():
        at = point_at(action, poses, bent, point.body, point.point)
        put(plain_text(name.replace("_", " ")), at, SMALL - 0.5, BLUE, False, 1.6 * SMALL * pixel)


def _spaced(points: Array) -> Array:
    """Points along a polyline at equal distances of :data:`SPACING` pixels."""
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    even = np.linspace(0.0, at[-1], 2 + int(at[-1] / SPACING))
    return np.column_stack([np.interp(even, at, points[:, i]) for i in (0, 1)])


def _contact_name(number: int, contact: Any) -> str:
    """Name of a contact in the list beside a drawing."""
    name = shortened(contact.label or f"contact {number}", MOST_LETTERS)
    return plain_text(textwrap.fill(name, LINE))


def _list_contacts(
    figure: Figure, action: Action, contacts: Mapping[int, str], drawn: Scene
) -> None:
    """Draw a list of contact numbers, names and symbols beside the drawing."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for number, name in contacts.items():
        handles.append(
            Line2D(
                [],
                [],
                linestyle="none",
                marker=f"${number}$",
                markeredgewidth=0,
                markersize=5.5 + 2.5 * (number > 9),
                color=SURFACE,
                label=name,
            )
        )
    if any(s.role == "surface" for s in drawn.shapes):
        handles.append(Line2D([], [], color=SURFACE, linewidth=1.2, label="contact surface"))
    if any(s.body == "ground" and s.role == "pad" for s in drawn.shapes):
        handles.append(Patch(facecolor=RAIL, label="fixed to the ground"))
    if spring_bodies(action):
        handles.append(
            Line2D([], [], color=GREEN, marker="$◎$", linestyle="none", label="torsion spring")
        )
    for strap in action.config.straps.values():
        if strap.enabled:
            name = strap.label.split(",")[0] or "strap"
            handles.append(Line2D([], [], color=PURPLE, linewidth=1.5, label=plain_text(name)))
            break
    handles.append(
        Line2D(
            [],
            [],
            color="white",
            marker="o",
            markeredgecolor=INK,
            linestyle="none",
            markersize=6,
            label="joint",
        )
    )
    handles.append(
        Line2D(
            [],
            [],
            color=INK,
            marker="$⊕$",
            markeredgewidth=0.3,
            linestyle="none",
            markersize=6,
            label="center of mass",
        )
    )
    if action.config.points:
        handles.append(
            Line2D(
                [],
                [],
                color=BLUE,
                marker="D",
                linestyle="none",
                markersize=3.5,
                label="tracking point",
            )
        )
    if string_line(action) is not None:
        handles.append(Line2D([], [], color=INK, linewidth=1.8, label="string"))
    total_w, total_h = figure.get_size_inches()
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(1.0 - 0.1 / total_w, 1.0 - 0.1 / total_h),
        frameon=False,
        fontsize=NORMAL - 0.5,
        labelspacing=0.45,
    )


def moment_of_run(run: Run) -> Figure:
    """Plot the mechanism of a run at its impact, or else farthest from its start."""
    action = run_action(run)
    names = action.coordinates
    if not all(name in run for name in names) or run.time.size == 0:
        raise InvalidParameter("plot mechanism: the run does not hold all coordinates")
    poses = np.stack([run[name] for name in names], axis=1)
    impact = run.summary.get("impact_time")
    if impact is not None and run.time[0] <= impact <= run.time[-1]:
        index, word = int(np.argmin(np.abs(run.time - impact))), "at impact"
    else:
        away = np.abs(poses - poses[0]) / np.asarray(action.mechanism.coordinate_scale)
        index, word = int(np.argmax(away.max(axis=1))), "farthest from its start"
    return mechanism(action, poses[index], title=f"{word}, {1e3 * run.time[index]:.2f} ms")
