"""Finds infinite lines that are touched at a place where their body has no parts."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.mechanism import Action
from unmodeled.errors import shortened

Array = npt.NDArray[np.float64]


def _known_points(action: Action, body: str) -> Array:
    """Points of a body in a file: joints, center of mass, surfaces, tracking points [m]."""
    config = action.config
    points: list[tuple[float, float]] = []
    if body != "ground":
        own = config.bodies[body]
        points += [(0.0, 0.0), own.center_of_mass]
        if own.length:
            points.append((own.length, 0.0))
    points += [b.position for b in config.bodies.values() if b.parent == body]
    for surface in config.surfaces.values():
        if surface.body != body:
            continue
        points.append(surface.point)
        if surface.end is not None:
            points.append(surface.end)
    points += [p.point for p in config.points.values() if p.body == body]
    if config.finger is not None and config.finger.body == body:
        points.append(config.finger.point)
    return np.array(points)


def unreached_lines(action: Action) -> list[str]:
    """Warnings for lines that are touched at rest outside the known extent of their body.

    A line is infinite. Where it carries a load at rest, its body should have material. The known
    extent of the body along the line is given by its points in the file: joints, center of mass,
    surfaces and tracking points. A line segment has a known extent.
    """
    config = action.config
    rest = action.rest_pose
    rows = {
        int(row[0]): row
        for row in _core.evaluate(action.mechanism, rest, np.zeros_like(rest), 0.0)["contacts"]
    }
    strings = [] if config.string is None else [config.string.surface]
    strings += [] if config.string is None else config.string.other_surfaces
    out = []
    for key, contact in config.contacts.items():
        row = rows.get(int(key))
        if not contact.enabled or row is None or not row[3] > 0.0:
            continue
        for name in contact.surfaces:
            line = config.surfaces[name]
            if line.kind != "line" or line.normal is None or name in strings:
                continue
            [other] = [n for n in contact.surfaces if n != name]
            along = np.array([line.normal[1], -line.normal[0]]) / np.hypot(*line.normal)
            place = _in_body(action, line.body, rest, (row[6], row[7]))
            known = _known_points(action, line.body) @ along
            room = config.surfaces[other].radius or 0.0
            at = float(along @ place)
            beyond = max(at - float(known.max()), float(known.min()) - at) - room
            if beyond > 0.0:
                out.append(
                    f"contacts.{key}: the infinite line {shortened(name)} carries "
                    f"{shortened(other)} at rest {1e3 * beyond:.1f} mm beyond all points of "
                    f"{shortened(line.body)} in the file; end it (kind 'segment'), or give the "
                    "body a point that reaches there"
                )
    return out


def _in_body(action: Action, body: str, pose: Array, point: tuple[float, float]) -> Array:
    """A point of the ground, in the frame of a body."""
    if body == "ground":
        return np.array(point)
    x, y, angle = _core.body_poses(action.mechanism, pose)[body]
    c, s = np.cos(angle), np.sin(angle)
    d = np.array([point[0] - x, point[1] - y])
    return np.array([c * d[0] + s * d[1], -s * d[0] + c * d[1]])
