"""Moving parts of a run at the times of frames: poses, forces, straps and string."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from feltmb.graphics.plot.poses import (
    Pose,
    bent_beams,
    body_poses,
    contact_rows,
    strap_curve,
    strap_ends,
    string_line,
    string_reach,
    to_ground,
)
from feltmb.graphics.plot.readings import busy_window, loaded_contacts
from feltmb.graphics.plot.shapes import Scene, scene, view_box
from feltmb.run.reading import striker_speed
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.mechanism import Action
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]

STRING_POINTS = 48
#: Number of frames that determine how much of each surface is drawn.
POSES = 13


def time_window(run: Run, window: tuple[float, float] | None, what: str) -> tuple[float, float]:
    """First and last time [s] that are shown; default: from the first to the last motion."""
    if len(run.time) < 2:
        raise InvalidParameter(f"{what}: the run has {len(run.time)} samples, expected 2 or more")
    if window is None:
        return busy_window(run)
    first, last = float(run.time[0]), float(run.time[-1])
    start, end = max(first, float(window[0])), min(last, float(window[1]))
    if not end > start:
        raise InvalidParameter(
            f"{what}: window {window[0]:g} to {window[1]:g} s holds nothing of the run, which "
            f"goes from {first:g} to {last:g} s"
        )
    return start, end


class Film:
    """All moving parts at the times of the frames.

    Attributes
    ----------
    time : ndarray (n_pictures,)
        Times [s].
    q : ndarray (n_pictures, n_coordinates)
        Coordinates [rad, m] of the mechanism.
    contacts : list of int
        Numbers of the contacts with a force; ``forces`` [N] by number.
    finger : ndarray (n_pictures,) or None
        Force [N].
    """

    def __init__(self, run: Run, action: Action, times: Array):
        missing = [name for name in action.coordinates if name not in run]
        if missing:
            raise InvalidParameter(f"the run lacks the coordinates {', '.join(missing)}")
        self.run = run
        self.action = action
        self.time = times
        self.q = np.column_stack([self.sample(name) for name in action.coordinates])
        # A few poses are sufficient for the range of the contacts along their surfaces.
        some = np.unique(np.linspace(0, len(times) - 1, POSES).astype(int))
        self.some = [self.q[i] for i in some]
        enabled = {int(k) for k, c in action.config.contacts.items() if c.enabled}
        self.contacts = [n for n in loaded_contacts(run) if n in enabled]
        self.forces = {
            n: np.maximum(self.sample(f"contact{n:02d}.force"), 0) for n in self.contacts
        }
        self.finger = self.sample("finger.force") if "finger.force" in run else None
        peaks = [float(np.max(f)) for f in self.forces.values()]
        if self.finger is not None and action.config.finger is not None:
            peaks.append(float(np.max(np.abs(self.finger))))
        self.largest = max(peaks, default=0.0)

    @cached_property
    def scene(self) -> Scene:
        """Shapes of the mechanism."""
        return scene(self.action, self.some)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Corners of the area that is covered [m]."""
        return view_box(self.action, self.scene, self.some)

    @cached_property
    def sides(self) -> dict[int, tuple[float, ...]]:
        """Signs of the forces on the movable bodies, along the normal, of each enabled contact."""
        rows, at = contact_rows(self.action, self.q[0]), self.poses(0)
        enabled = {int(k) for k, c in self.action.config.contacts.items() if c.enabled}
        return {n: self._sides(n, rows[n], at) for n in sorted(enabled & rows.keys())}

    @cached_property
    def speed(self) -> Array | None:
        """Speed of the striking point at the times of the run [m/s]; None if there is none."""
        return striker_speed(self.run)

    def sample(self, name: str) -> Array:
        """Output of the run at the times of the frames."""
        return np.asarray(np.interp(self.time, self.run.time, self.run[name]))

    def poses(self, i: int) -> dict[str, Pose]:
        """Position and angle of every body in frame ``i``."""
        return body_poses(self.action, self.q[i])

    def _sides(
        self, number: int, row: tuple[float, ...], poses: dict[str, Pose]
    ) -> tuple[float, ...]:
        """Signs of the forces on the movable bodies of a contact, along its normal."""
        config = self.action.config
        pair = [config.surfaces[n] for n in config.contacts[f"{number:02d}"].surfaces]
        x, y, nx, ny, _ = row

        def depth(k: int) -> float:
            """Distance of the center of a circle from the surface, on the side of the normal."""
            if pair[k].kind != "circle":
                return -math.inf
            center = to_ground(poses[pair[k].body], np.array([pair[k].point]))[0]
            return float((center[0] - x) * nx + (center[1] - y) * ny)

        # The normal of the core points into the body with the circle.
        circle = 0 if depth(0) > depth(1) else 1
        signs = []
        if self.scene.group[pair[circle].body] >= 0:
            signs.append(1.0)
        if self.scene.group[pair[1 - circle].body] >= 0:
            signs.append(-1.0)
        return tuple(signs)

    def arrow_length(self, force: float) -> float:
        """Length [m] of an arrow; a square root keeps small forces visible."""
        if self.largest <= 0 or force <= 1e-3 * self.largest:
            return 0.0
        return 45.0 * self.scene.unit * math.sqrt(force / self.largest)

    def arrows(self, i: int, poses: dict[str, Pose]) -> list[tuple[Array, Array]]:
        """Start and end [m] of the forces on movable bodies in frame ``i``."""
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
        """Curves (n, 2) [m] of the straps in frame ``i``."""
        bent = bent_beams(self.action, self.q[i])
        return [strap_curve(a, b, free) for _, a, b, free in strap_ends(self.action, poses, bent)]

    @cached_property
    def string(self) -> Array | None:
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
