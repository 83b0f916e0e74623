"""Slow motion of a mechanism, as a technician moves it with one finger.

There are two methods. :func:`simulated_press` simulates a finger with a constant, slow speed, with
the complete model. :func:`slow_press` neglects inertia: at each finger travel the forces are
balanced, Q(q, dq/dt) = 0, where dq/dt follows from the path (implicit Euler) and the finger force
is the multiplier of the prescribed travel. Nothing oscillates, and with Coulomb friction the path
does not depend on the speed. ``docs/validation/regulation.md`` compares the methods.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from feltmb import _core
from feltmb.mechanism import core_law, describe
from feltmb.mechanism.to_core import with_leads
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, ModelError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.mechanism import Action, FrictionParameters
    from feltmb.run.results import Run

    Array = npt.NDArray[np.float64]

__all__ = [
    "FrictionMode",
    "PressPath",
    "SimulatedPress",
    "SlowPress",
    "StaticLetOff",
    "simulated_press",
    "slow_press",
    "static_let_off",
]

FrictionMode = Literal["law", "saturated", "breakaway", "none"]
MODES = ("law", "saturated", "breakaway", "none")

#: Inertia is removed by smaller masses in a gravity that is larger by the same factor. All weights
#: are unchanged, exactly, because the factor is a power of two, and centripetal forces vanish.
#: Friction, felt, dashpots and damping have the true speeds, so that no law must be scaled.
_LIGHTNESS = 2.0**-27
#: Threshold speed of Coulomb friction in the modes without one, as a share of the press speed.
_SHARP = 1e-3
#: Speed in the modes without a speed, as a share of the press speed: speed-dependent terms vanish.
_STILL = 1e-4
_FELT = 1e-3  # m; a coordinate scale displaces a contact by this much


@dataclass(frozen=True, eq=False)
class PressPath:
    """Equilibria along a finger travel.

    Attributes
    ----------
    travel : ndarray (n,)
        Finger travel from rest along the finger direction [m].
    force : ndarray (n,)
        Finger force along the same direction [N], positive pressing.
    pose : ndarray (n, n_coordinates)
        Coordinates [rad, m].
    gap : dict
        By contact number, ndarray (n,): distance of the surfaces [m], negative when compressed.
    normal_force : dict
        By contact number, ndarray (n,) [N].
    jumps : list of int
        Rows after a jump: the path ended there (the jack slips out, the hammer falls), so that such
        a row is not continuous with the row before.
    evaluations : int
        Number of evaluations of the equations.
    """

    travel: Array
    force: Array
    pose: Array
    gap: dict[int, Array]
    normal_force: dict[int, Array]
    jumps: list[int]
    evaluations: int

    def when(self, contact: int, *, closes: bool = True) -> float | None:
        """Travel [m] at which a contact first closes (or opens after closing); None if never.

        Linear between the rows of the path.
        """
        import numpy as np

        gap = self.gap[contact] if closes else -self.gap[contact]
        rows = np.flatnonzero((gap[:-1] > 0.0) & (gap[1:] <= 0.0))
        if rows.size == 0:
            return None
        i = int(rows[0])
        part = gap[i] / (gap[i] - gap[i + 1])
        return float(self.travel[i] + part * (self.travel[i + 1] - self.travel[i]))

    def at(self, values: Array, travel: float) -> float:
        """A column at a travel [m] of the first, monotone part of the path, linear between rows."""
        import numpy as np

        end = int(np.argmax(self.travel)) + 1
        return float(np.interp(travel, self.travel[:end], values[:end]))


class SlowPress:
    """Equilibria of a mechanism along finger travels, row by row; see :func:`slow_press`."""

    def __init__(
        self,
        action: Action,
        *,
        speed: float = 0.010,
        friction: FrictionMode = "law",
        open_contacts: Iterable[int] = (),
    ):
        import numpy as np

        if not (math.isfinite(speed) and speed > 0):
            raise InvalidParameter(f"slow press: speed = {speed!r} m/s, must be > 0")
        if friction not in MODES:
            raise InvalidParameter(f"slow press: friction {friction!r} is none of {MODES}")
        if action.config.finger is None:
            raise InvalidParameter(f"slow press: mechanism {action.name!r} describes no finger")
        self.action = action
        self.speed = speed
        # Speed of the path [m/s]: an equilibrium at the start of a motion, or without friction, has
        # none.
        self._pace = speed if friction in ("law", "saturated") else speed * _STILL
        self.scale = np.asarray(action.mechanism.coordinate_scale)
        self.n = self.scale.size
        self.direction = np.asarray(action.config.finger.direction)
        opened = frozenset(open_contacts)
        # From smooth to sharp friction: each stage starts from the result of the previous one.
        self._stages = [
            _mechanism(action, self._pace, friction, blur, opened) for blur in (100.0, 10.0, 1.0)
        ]
        self._sharp = self._stages[-1]
        self._point = self._sharp.point_names.index(_POINT)
        self.evaluations = 0
        self.q = np.array(action.rest_pose)
        if opened:
            self.q = np.array(_core.find_equilibrium(self._sharp)["q"])
        self.force = 0.0
        self.travel = 0.0
        self._origin = self.height(self.q)
        self._rate = np.zeros(self.n)  # d q / d travel in the last step
        self._tau = 1.0
        self.jumped = False

    def height(self, q: Array) -> float:
        """Position of the finger point along the finger direction in a pose [m]."""
        x, y = _core.point_position(self._sharp, self._point, q)
        return float(self.direction[0] * x + self.direction[1] * y)

    def advance(self, travel: float) -> None:
        """Advance to a finger travel [m]; sets ``q``, ``force`` and ``jumped``.

        Raises
        ------
        ModelError
            No equilibrium was found beyond the present travel.
        """
        start = (self.q, self.travel, self._rate)
        step = travel - self.travel
        self.jumped = False
        if self._try(travel):
            return
        for parts in (4, 16):
            if all(self._try(start[1] + step * (k + 1) / parts) for k in range(parts)):
                return
            # The steps so far are kept; the rest is done with smaller steps.
            start = (self.q, self.travel, self._rate)
            step = travel - self.travel
        self._jump(travel)

    def _try(self, travel: float) -> bool:
        """One step along the path; False, without a change, if it needs a jump."""
        import numpy as np

        step = travel - self.travel
        if step == 0.0:
            return True
        self._tau = abs(step) / self._pace
        found = self._settle(self.q + self._rate * step, self.q, self.force, travel, 0.0)
        if found is None:
            return False
        moved = float(np.max(np.abs((found[0] - self.q) / self.scale)))
        if moved > 1.0 and moved > 20.0 * abs(step) / _FELT:
            return False
        self._take(found[0], found[1], travel)
        return True

    def _take(self, q: Array, force: float, travel: float) -> None:
        step = travel - self.travel
        self._rate = (q - self.q) / step if step != 0.0 else 0.0 * self._rate
        self.q, self.force, self.travel = q, float(force), travel

    def _settle(
        self, guess: Array, anchor: Array, force: float, travel: float, eta: float
    ) -> tuple[Array, float] | None:
        """Equilibrium near an anchor: directly, or else with friction from smooth to sharp."""
        for start in (guess, anchor):
            found = self._solve(self._sharp, start, force, anchor, travel, eta)
            if found is not None:
                return found
        best = anchor
        for mechanism in self._stages:
            found = self._solve(mechanism, best, force, anchor, travel, eta)
            if found is not None:
                best, force = found
        return found

    def _jump(self, travel: float) -> None:
        """Jump to the next equilibrium as in a viscous fluid: steps with a viscous force eta dq."""
        import numpy as np

        anchor, force = self.q, self.force
        eta = 1e4
        guess = anchor
        self._tau = 1e-4 / self._pace  # as for a finger motion of 0.1 mm
        for _ in range(500):
            found = self._settle(guess, anchor, force, travel, eta)
            moved = math.inf
            if found is not None:
                moved = float(np.max(np.abs((found[0] - anchor) / self.scale)))
            if found is None or moved > 0.5:
                eta *= 6.0
                guess = anchor
                if eta > 1e12:
                    break
                continue
            guess = found[0] + 0.5 * (found[0] - anchor)
            anchor, force = found
            if eta < 1e-3:
                self.jumped = bool(np.max(np.abs((anchor - self.q) / self.scale)) > 0.2)
                self._take(anchor, force, travel)
                self._rate = np.zeros(self.n)
                return
            if moved < 0.2:
                eta *= 0.3
        raise ModelError(
            f"slow press of {self.action.name!r}: no equilibrium found beyond a finger travel of "
            f"{1e3 * self.travel:.3f} mm (force {self.force:.3g} N)"
        )

    def _solve(
        self, mechanism: Any, q: Array, force: float, anchor: Array, travel: float, eta: float
    ) -> tuple[Array, float] | None:
        """Newton's method with line search for Q(q, (q - anchor)/tau) + F g = eta (q - anchor)."""
        import numpy as np

        n, scale, tau = self.n, self.scale, self._tau
        drag = eta * (1e-3 * _FELT) / scale**2
        drags = np.diag(drag)

        def residual(x: Array, f: float) -> tuple[Array, Array, float]:
            self.evaluations += 1
            out = _core.evaluate(mechanism, x, (x - anchor) / tau, f)["force"]
            r = np.empty(n + 1)
            r[:n] = (out - drag * (x - anchor)) * scale / _FELT  # N
            r[n] = (self.height(x) - self._origin - travel) / _FELT
            return out, r, math.sqrt(r @ r)

        out, r, size = residual(q, force)
        matrix = np.zeros((n + 1, n + 1))
        for _ in range(30):
            if size < 1e-8:
                return q, force
            rate = (q - anchor) / tau
            stiffness, damping = _core.jacobian_blocks(mechanism, q, rate, force)
            # The equations are linear in the finger force.
            pull = _core.evaluate(mechanism, q, rate, force + 1.0)["force"] - out
            self.evaluations += 1
            block = stiffness + damping / tau - drags
            matrix[:n, :n] = block * scale[None, :] * scale[:, None] / _FELT
            matrix[:n, n] = matrix[n, :n] = pull * scale / _FELT
            try:
                dx = np.linalg.solve(matrix, -r)
            except np.linalg.LinAlgError:
                return None
            largest = float(np.abs(dx[:n]).max())
            part = min(1.0, 0.5 / largest) if largest > 0.0 else 1.0
            for _ in range(10):
                x = q + part * dx[:n] * scale
                f = force + part * dx[n]
                trial = residual(x, f)
                if trial[2] < (1.0 - 1e-4 * part) * size:
                    break
                part *= 0.4
            else:
                break
            q, force, (out, r, size) = x, f, trial
        return (q, force) if size < 1e-6 else None

    def state(self) -> dict[int, tuple[float, float]]:
        """Gap [m] and normal force [N] by contact number in the present pose."""
        import numpy as np

        out = _core.evaluate(self._sharp, self.q, np.zeros(self.n), self.force)
        return {int(row[0]): (-float(row[1]), float(row[3])) for row in out["contacts"]}


_POINT = "quasistatic finger"


def _mechanism(
    action: Action, pace: float, friction: FrictionMode, blur: float, opened: frozenset[int]
) -> Any:
    """The mechanism with weight but without inertia; the finger is a point."""
    description = describe(action.config)
    finger = action.config.finger
    assert finger is not None
    point = _core.TrackingPointDescription(name=_POINT, body=finger.body, point=finger.point)
    description.points = [*description.points, point]
    x, y = description.gravity
    description.gravity = (x / _LIGHTNESS, y / _LIGHTNESS)

    scale = dict(zip(action.coordinates, action.mechanism.coordinate_scale, strict=True))
    bodies = description.bodies
    for body in bodies:
        body.mass *= _LIGHTNESS
        body.inertia *= _LIGHTNESS
        if body.beam is not None:
            beam = body.beam
            beam.linear_density *= _LIGHTNESS
            body.beam = beam
        if body.coordinate:
            # Rotation of the joint per meter of finger travel.
            reach = scale[body.coordinate] / _FELT
            given = with_leads(action.config, body.name).friction
            where = f"bodies.{body.name}.friction"
            body.friction = _friction(given, where, friction, pace * reach, blur)
    description.bodies = bodies
    contacts = description.contacts
    for contact in contacts:
        data = action.config.contacts[f"{contact.number:02d}"]
        where = f"contacts.{contact.number:02d}.friction"
        contact.friction = _friction(data.friction, where, friction, pace, blur)
        if friction != "law":
            # At zero speed felt follows its loading curve, the slow limit of eq. 4.22.
            slow = {"alpha": data.alpha * 1e-3 * _STILL}
            contact.law = core_law(data.model_copy(update=slow))
        if contact.number in opened:
            contact.enabled = False
    description.contacts = contacts
    return _core.assemble(description)


def _friction(
    given: FrictionParameters, where: str, mode: FrictionMode, speed: float, blur: float
) -> _core.Friction:
    """Friction law of a mode: without the terms that the mode neglects.

    ``speed``: typical sliding speed; ``blur``: factor of the threshold speed of the law.
    """
    friction = given.core
    if mode == "law":
        friction.threshold_speed *= blur
        return friction
    sharp = speed * _SHARP * blur
    if mode == "saturated":
        return friction.sharpened(sharp)
    amplitude = _breakaway(friction, where) if mode == "breakaway" else 0.0
    return _core.Friction(amplitude=amplitude, threshold_speed=sharp)


def _breakaway(given: _core.Friction, where: str) -> float:
    """Largest dry friction force: the limit up to which nothing slides."""
    import numpy as np

    least, most = given.dry_speeds
    if math.isinf(most):
        raise InvalidParameter(
            f"slow press: {where} has b1 = {given.b1:g} and b2 = 0, so that it grows with the "
            f"speed without end and has no breakaway value; give b2 > 0, or use viscous"
        )
    speeds = np.geomspace(least, most, 20001)
    return float(max(given.amplitude, np.max(given.dry().coefficient(speeds))))


@checked
def slow_press(
    action: Action,
    travel: npt.ArrayLike,
    *,
    speed: float = 0.010,
    friction: FrictionMode = "law",
    open_contacts: Iterable[int] = (),
) -> PressPath:
    """Equilibria along prescribed finger travels.

    Parameters
    ----------
    action
        The mechanism; it starts from its rest pose.
    travel
        Finger travels [m] from rest, positive pressing, in the order in which they are passed.
    speed
        Finger speed [m/s] for friction, hysteresis and damping, > 0.
    friction
        ``law``: thesis eq. A.1 with the viscous, quadratic and Stribeck terms, at the sliding
        speeds of the path. ``saturated``: the same terms with a threshold speed of zero, i.e.
        Coulomb friction with the coefficient A and the three terms. ``breakaway``: Coulomb friction
        with the largest value of the dry terms, A (tanh x + B1 x / (1 + B2 x^4)) and the Stribeck
        term. ``none``: no friction. In the last three modes felt follows its loading curve, the
        slow limit of eq. 4.22. The last two do not depend on ``speed``: dashpots and damping have
        no force.
    open_contacts
        Numbers of contacts that are switched off, for example the damper spoon when the pedal is
        pressed.

    Raises
    ------
    ModelError
        There is no equilibrium beyond some travel.
    """
    import numpy as np

    press = SlowPress(action, speed=speed, friction=friction, open_contacts=open_contacts)
    rows: list[tuple[float, float, Array, dict[int, tuple[float, float]]]] = []
    jumps: list[int] = []
    for target in np.asarray(travel, dtype=float).ravel():
        press.advance(float(target))
        if press.jumped:
            jumps.append(len(rows))
        rows.append((press.travel, press.force, press.q, press.state()))
    return path_of(rows, jumps, press.evaluations)


def path_of(
    rows: list[tuple[float, float, Array, dict[int, tuple[float, float]]]],
    jumps: list[int],
    evaluations: int,
) -> PressPath:
    """Path from the rows of a press."""
    import numpy as np

    if not rows:
        raise InvalidParameter("slow press: travel is empty")
    numbers = sorted(rows[0][3])
    return PressPath(
        np.array([r[0] for r in rows]),
        np.array([r[1] for r in rows]),
        np.array([r[2] for r in rows]),
        {k: np.array([r[3][k][0] for r in rows]) for k in numbers},
        {k: np.array([r[3][k][1] for r in rows]) for k in numbers},
        jumps,
        evaluations,
    )


# --- simulated press -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SimulatedPress:
    """A simulated slow press and, if requested, release.

    Attributes
    ----------
    run : Run
        The simulation.
    travel : ndarray (n_times,)
        Travel of the finger point on the key from rest [m], positive pressing.
    force : ndarray (n_times,)
        Finger force on the key [N].
    gap : ndarray (n_times,)
        Distance of hammer and undisplaced string [m]; negative: the hammer is beyond the string.
    turn : int
        Index of the first sample of the release (number of samples if there is none).
    """

    run: Run
    travel: Array
    force: Array
    gap: Array
    turn: int

    @property
    def closest(self) -> float:
        """Smallest distance of hammer and string at rest, i.e. the let-off distance [m]."""
        return float(self.gap[: self.turn].min())

    def left(self, contact: int) -> float:
        """Distance of the surfaces of a contact when the hammer is closest to the string [m].

        For key and front punching, this is the aftertouch. Negative: the key was on the punching
        before.
        """
        at = int(self.gap[: self.turn].argmin())
        return -float(self.run[f"contact{contact:02d}.compression"][at])

    def gap_when(self, contact: int) -> float | None:
        """Distance of hammer and string [m] when a contact first closes; None if never."""
        table = self.run.event_table
        for time, number, change in zip(
            table["time"], table["contact"], table["change"], strict=True
        ):
            if number == contact and change == "closes" and time > 0.0:
                return self._gap_at(time)
        return None

    def _gap_at(self, time: float) -> float:
        import numpy as np

        return float(np.interp(time, self.run.time, self.gap))


@checked
def simulated_press(
    action: Action,
    *,
    speed: float = 0.010,
    travel: float = 0.012,
    release: bool = False,
    rtol: float = 1e-6,
) -> SimulatedPress:
    """Simulate a finger that presses at a constant slow speed.

    Parameters
    ----------
    speed
        Speed of the finger [m/s], > 0.
    travel
        Travel of the finger [m], > 0: beyond the let-off and into the front punching.
    release
        Whether the finger returns at the same speed, after a rest of 0.2 s.

    Raises
    ------
    InvalidParameter
        The mechanism has no strike contact or no finger, or a number is out of range.
    IntegrationError
        The solver stopped early.
    """
    import numpy as np

    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import motion_stroke

    strike = action.config.reading.strike_contact
    if strike is None or action.config.finger is None:
        raise InvalidParameter(
            f"slow press: mechanism {action.name!r} needs [finger] and reading.strike_contact"
        )
    for name, given, unit in (("speed", speed, "m/s"), ("travel", travel, "m")):
        if not (math.isfinite(given) and given > 0):
            raise InvalidParameter(f"slow press: {name} = {given!r} {unit}, must be > 0")
    down = travel / speed
    time, value = [0.02, 0.02 + down], [0.0, travel]
    if release:
        time += [time[1] + 0.2, time[1] + 0.2 + down]
        value += [travel, 0.0]
    stroke = motion_stroke(
        time, value, interpolation="linear", duration=time[-1] + 0.1, name="slow press"
    )
    # At least 20 samples per millimeter of finger travel.
    run = simulate(action, stroke, None, rtol, ledger=False, output_rate=max(2000.0, 2e4 * speed))
    point = np.asarray(_finger_travel(action, run))
    gap = -run[f"contact{strike:02d}.compression"]
    if "string.strike" in run:
        gap = gap - run["string.strike"]
    turn = int(np.searchsorted(run.time, time[1])) if release else run.time.size
    return SimulatedPress(run, point, run["finger.force"], gap, turn)


def _finger_travel(action: Action, run: Run) -> Array:
    """Travel of the finger's point on the key along the finger direction, from rest [m]."""
    import numpy as np

    finger = action.config.finger
    assert finger is not None
    direction = np.asarray(finger.direction)
    for name, point in action.config.points.items():
        if point.body == finger.body and point.point == finger.point:
            along = direction[0] * run[f"{name}.x"] + direction[1] * run[f"{name}.y"]
            break
    else:
        poses = np.stack([run[name] for name in action.coordinates], axis=1)
        press = SlowPress(action)
        along = np.array([press.height(q) for q in poses])
    travel: Array = along - along[0]
    return travel


# --- let-off without inertia ---------------------------------------------------------------------


@dataclass(frozen=True)
class StaticLetOff:
    """Let-off in a press without inertia."""

    gap: float  #: smallest distance of hammer and string [m]
    travel: float  #: finger travel at the smallest distance [m]
    force: float  #: largest finger force before it [N]
    tripped: bool  #: whether there was a let-off; false: the press ended first


#: Force at which a press ends because the hammer is blocked on the string [N].
BLOCKED = 60.0


@checked
def static_let_off(
    action: Action,
    *,
    travel: float = 0.012,
    speed: float = 0.010,
    friction: FrictionMode = "saturated",
    step: float = 1e-5,
) -> StaticLetOff:
    """Smallest distance of hammer and string in a press without inertia; see :func:`slow_press`.

    Parameters
    ----------
    travel
        Finger travel at which the press ends [m].
    step
        Step of the finger travel when the hammer is within 8 mm of the string [m]; before, it is
        ten times longer.
    """
    strike = action.config.reading.strike_contact
    if strike is None:
        raise InvalidParameter(f"let-off: mechanism {action.name!r} names no strike contact")
    press = SlowPress(action, speed=speed, friction=friction)
    best, where, largest = math.inf, 0.0, 0.0
    at = 0.0
    while at < travel:
        at += step if best < 0.008 else 10.0 * step
        press.advance(at)
        gap = press.state()[strike][0]
        if best < 0.008 and (press.force < 0.85 * largest or gap > best + 2e-4):
            return StaticLetOff(min(best, gap), where, largest, True)
        if press.force > BLOCKED:
            break
        largest = max(largest, press.force)
        if gap < best:
            best, where = gap, at
    return StaticLetOff(best, where, largest, False)
