"""Geometry of a mechanism in a pose: bodies, bent beams, contacts, straps, string."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb import _core
from unmodeled.arguments import checked

if TYPE_CHECKING:
    from feltmb.mechanism import Action

Array = npt.NDArray[np.float64]

Pose = tuple[float, float, float]


@checked
def body_poses(action: Action, q: npt.ArrayLike) -> dict[str, Pose]:
    """Origin x, y [m] and angle [rad] of every body; of a flexible beam at its clamped end.

    Parameters
    ----------
    q
        Mechanical coordinates [rad, m] in the order of ``action.coordinates``.
    """
    locate: Any = getattr(_core, "body_poses", None)  # the stub file of the core may be older
    found = locate(action.mechanism, np.asarray(q, dtype=float).ravel())
    poses: dict[str, Pose] = {"ground": (0.0, 0.0, 0.0)}
    for name, (x, y, angle) in found.items():
        poses[str(name)] = (float(x), float(y), float(angle))
    return poses


def bent_beams(action: Action, q: npt.ArrayLike) -> dict[str, Array]:
    """Center lines (n, 2) [m] of the flexible beams in the frames of their clamped ends."""
    mechanism = action.mechanism
    names = getattr(mechanism, "beam_names", ())  # the stub file of the core may be older
    position = np.asarray(q, dtype=float).ravel()
    line: Any = getattr(mechanism, "beam_centerline", None)
    return {str(n): np.asarray(line(n, position, 25)) for n in names}


def bend(points: Array, line: Array, length: float) -> Array:
    """Points of a straight beam [m] after it was bent to a center line."""
    grid = np.linspace(0.0, length, len(line))
    slope = np.gradient(line, grid, axis=0)
    slope /= np.hypot(slope[:, 0], slope[:, 1])[:, None]
    s = np.clip(points[:, 0], 0.0, length)
    center = np.column_stack([np.interp(s, grid, line[:, k]) for k in (0, 1)])
    along = np.column_stack([np.interp(s, grid, slope[:, k]) for k in (0, 1)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    out: Array = center + (points[:, 0] - s)[:, None] * along + points[:, 1, None] * across
    return out


def station(points: Array, line: Array, length: float, x: float) -> Array:
    """Points fixed to the cross section at ``x`` [m] of a beam that was bent to a center line."""
    grid = np.linspace(0.0, length, len(line))
    at = np.array([np.interp(x, grid, line[:, k]) for k in (0, 1)])
    angle = float(np.interp(x, grid, np.gradient(line[:, 1], grid, edge_order=2)))
    return to_ground((float(at[0]), float(at[1]), angle), points - np.array([x, 0.0]))


def point_at(
    action: Action,
    poses: Mapping[str, Pose],
    bent: Mapping[str, Array],
    body: str,
    point: npt.ArrayLike,
) -> Array:
    """Position in the ground frame [m] of a point of a body, which may be a flexible beam."""
    p = np.asarray(point, dtype=float)
    if body in bent:
        length = action.config.bodies[body].length or 1.0
        p = station(p[None, :], bent[body], length, float(p[0]))[0]
    out: Array = to_ground(poses[body], p[None, :])[0]
    return out


def to_ground(pose: Pose, points: Array) -> Array:
    """Transform points (n, 2) [m] from a frame to the ground frame."""
    x, y, angle = pose
    c, s = math.cos(angle), math.sin(angle)
    out: Array = points @ np.array([[c, s], [-s, c]]) + np.array([x, y])
    return out


def to_body(pose: Pose, points: Array) -> Array:
    """Transform points (n, 2) [m] from the ground frame to a frame."""
    x, y, angle = pose
    c, s = math.cos(angle), math.sin(angle)
    out: Array = (points - np.array([x, y])) @ np.array([[c, -s], [s, c]])
    return out


def contact_rows(action: Action, q: npt.ArrayLike) -> dict[int, tuple[float, ...]]:
    """Number -> (x, y [m] of the contact point, normal into the circle's body, compression [m])."""
    position = np.asarray(q, dtype=float).ravel()
    out = _core.evaluate(action.mechanism, position, np.zeros_like(position), 0.0)
    # Columns of the core: number, compression, rate, force, slip, friction, x, y, normal.
    return {
        int(row[0]): (row[6], row[7], row[8], row[9], row[1])
        for row in out["contacts"]
        if int(row[0]) > 0
    }


@dataclass(frozen=True)
class Way:
    """A mechanism in many poses, as arrays whose first axis is the pose.

    Attributes
    ----------
    bodies : dict of ndarray (n, 3)
        Origin x, y [m] and angle [rad] by body, as :func:`body_poses`.
    contacts : dict of ndarray (n, 4)
        By number: x, y [m] of the contact point and the unit normal, as :func:`contact_rows`.
    beams : dict of ndarray (n, points, 2)
        Center lines [m] of the flexible beams, as :func:`bent_beams`.
    """

    bodies: dict[str, Array]
    contacts: dict[int, Array]
    beams: dict[str, Array]

    def to_ground(self, body: str, points: Array) -> Array:
        """Places in the ground frame [m] of points (m, 2) of a body: x and y as (2, n, m)."""
        x, y, angle = self.bodies[body].T[:, :, None]
        c, s = np.cos(angle), np.sin(angle)
        px, py = points.T
        return np.stack([x + c * px - s * py, y + s * px + c * py])

    def to_body(self, body: str, points: Array) -> Array:
        """Points (n, 2) [m] of the ground frame, one a pose, in the frame of a body."""
        x, y, angle = self.bodies[body].T
        c, s = np.cos(angle), np.sin(angle)
        px, py = points[:, 0] - x, points[:, 1] - y
        return np.column_stack([c * px + s * py, c * py - s * px])


def poses_along(action: Action, q: npt.ArrayLike) -> Way:
    """Everything that moves in many poses at once.

    Parameters
    ----------
    q
        (n, coordinates), a pose in each row.
    """
    found = _core.move_through(action.mechanism, np.atleast_2d(np.asarray(q, dtype=float)))
    bodies, contacts = found["bodies"], found["contacts"]
    ground = {"ground": np.zeros((len(bodies), 3))}
    return Way(
        ground | {str(n): bodies[:, 3 * i : 3 * i + 3] for i, n in enumerate(found["names"])},
        {int(n): contacts[:, 4 * i : 4 * i + 4] for i, n in enumerate(found["numbers"]) if n > 0},
        {str(n): line.reshape(len(line), -1, 2) for n, line in found["beams"].items()},
    )


def moving_joints(action: Action) -> list[tuple[str, str, str, Array]]:
    """Body, kind, parent, and position in the parent's frame [m] of the movable joints."""
    return [
        (name, b.joint, b.parent, np.array(b.position))
        for name, b in action.config.bodies.items()
        if b.joint != "weld"
    ]


def spring_bodies(action: Action) -> list[str]:
    """Bodies with a torsion spring in their joint."""
    bodies = {b.coordinate: n for n, b in action.config.bodies.items() if b.coordinate}
    return [
        bodies[s.coordinate]
        for s in action.config.springs.values()
        if s.enabled and s.coordinate in bodies
    ]


def strap_ends(
    action: Action, poses: Mapping[str, Pose], bent: Mapping[str, Array]
) -> list[tuple[str, Array, Array, float]]:
    """Name, ends in the ground frame [m] and free length [m] of the enabled straps."""
    return [
        (
            name,
            point_at(action, poses, bent, s.body_a, s.point_a),
            point_at(action, poses, bent, s.body_b, s.point_b),
            s.free_length,
        )
        for name, s in action.config.straps.items()
        if s.enabled
    ]


def strap_curve(a: Array, b: Array, free_length: float, count: int = 24) -> Array:
    """Points of a strap between its ends [m]: straight when taut, else sagging."""
    gap = float(np.hypot(*(b - a)))
    s = np.linspace(0.0, 1.0, count)[:, None]
    line = a + s * (b - a)
    if gap >= free_length or gap <= 0:
        return np.asarray(line)
    # A shallow parabola of sag f over a chord c is longer than the chord by 8 f^2 / (3 c).
    sag = min(math.sqrt(3.0 / 8.0 * gap * (free_length - gap)), 0.5 * free_length)
    out: Array = line + 4.0 * s * (1.0 - s) * np.array([0.0, -sag])
    return out


def string_line(action: Action) -> tuple[Array, Array, Array, float] | None:
    """End y = 0 of the string, direction of y, normal toward the hammer, length [m]; or None."""
    config = action.config
    if config.string is None:
        return None
    s = config.surfaces[config.string.surface]
    if s.kind != "line" or s.normal is None:
        return None
    normal = np.array(s.normal) / np.hypot(*s.normal)
    along = np.array([normal[1], -normal[0]])
    if along @ np.array(config.string.direction) < 0:
        along = -along
    start = np.array(s.point) - config.string.anchor * along
    return start, along, normal, config.string.length


def string_reach(line: tuple[Array, Array, Array, float], limits: tuple[Array, Array]) -> float:
    """Length of the string in the view [m], from its end y = 0."""
    start, along, _, reach = line
    for k in (0, 1):
        edge = limits[1][k] if along[k] > 0 else limits[0][k]
        if abs(along[k]) > 1e-9:
            reach = min(reach, float((edge - start[k]) / along[k]))
    return max(reach, 1e-6)
