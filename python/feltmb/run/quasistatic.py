"""Slowly driven mechanism: what a technician does with one finger.

Two ways. :func:`simulated_press` simulates a finger that goes down at a constant, slow speed, with
everything that the model has. :func:`slow_press` leaves inertia out: at each finger travel the
forces balance, Q(q, dq/dt) = 0 with dq/dt from the path itself (implicit Euler), the finger force
being the multiplier of the prescribed travel; nothing oscillates, and with Coulomb friction the
path does not depend on the speed. ``docs/validation/2026-11_regulation.md`` compares them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from feltmb import _core
from feltmb.errors import InvalidParameter, ModelError
from feltmb.mechanism import core_law, describe

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

#: Inertia is left out by masses this much lighter in a gravity this much stronger: every weight
#: stays, to the last bit as it is a power of two, and centripetal forces vanish. Friction, felt,
#: dashpots and damping see the real speeds, so that no law is scaled or written here again.
_LIGHTNESS = 2.0**-27
#: Threshold of Coulomb friction without a speed of its own, as part of the press speed.
_SHARP = 1e-3
#: Speed of the modes without a speed, as part of the press speed: what needs a speed vanishes.
_STILL = 1e-4
_FELT = 1e-3  # m; a coordinate scale moves a contact by this much


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
        Rows that were reached by a jump: the path ended there (the jack slips out, the hammer
        falls) and the row before is not continuous with it.
    evaluations : int
        Evaluations of the equations that the path took.
    """

    travel: Array
    force: Array
    pose: Array
    gap: dict[int, Array]
    normal_force: dict[int, Array]
    jumps: list[int]
    evaluations: int

    def when(self, contact: int, *, closes: bool = True) -> float | None:
        """Travel [m] at which a contact first closes (or opens, having been closed); None if never.

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
    """Follows a mechanism along finger travels, row by row; see :func:`slow_press`."""

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
        # Of the path [m/s]: equilibria about to move, and without friction, have no speed.
        self._pace = speed if friction in ("law", "saturated") else speed * _STILL
        self.scale = np.asarray(action.mechanism.coordinate_scale)
        self.n = self.scale.size
        self.direction = np.asarray(action.config.finger.direction)
        opened = frozenset(open_contacts)
        # From smooth to sharp: each stage starts from the one before.
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
        self._rate = np.zeros(self.n)  # d q / d travel of the last step
        self._tau = 1.0
        self.jumped = False

    def height(self, q: Array) -> float:
        """Finger point along the finger direction at a pose [m]."""
        x, y = _core.point_position(self._sharp, self._point, q)
        return float(self.direction[0] * x + self.direction[1] * y)

    def advance(self, travel: float) -> None:
        """Go to a finger travel [m]; sets ``q``, ``force``, ``jumped``.

        Raises
        ------
        ModelError
            No equilibrium was found from here on.
        """
        start = (self.q, self.travel, self._rate)
        step = travel - self.travel
        self.jumped = False
        if self._try(travel):
            return
        for parts in (4, 16):
            if all(self._try(start[1] + step * (k + 1) / parts) for k in range(parts)):
                return
            # What was reached so far is kept; the rest goes on with smaller steps.
            start = (self.q, self.travel, self._rate)
            step = travel - self.travel
        self._jump(travel)

    def _try(self, travel: float) -> bool:
        """One step along the path; false (and nothing changed) if it would have to jump."""
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
        """Equilibrium next to an anchor: tried at once, then with friction from smooth to sharp."""
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
        """Fall to the next equilibrium as if in thick oil: steps with a viscous force eta dq."""
        import numpy as np

        anchor, force = self.q, self.force
        eta = 1e4
        guess = anchor
        self._tau = 1e-4 / self._pace  # as if the finger moved by 0.1 mm
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
        """Newton with line search for Q(q, (q - anchor)/tau) + F g = eta (q - anchor)."""
        import numpy as np

        n, scale, tau = self.n, self.scale, self._tau
        drag = eta * (1e-3 * _FELT) / scale**2

        def residual(x: Array, f: float) -> Array:
            self.evaluations += 1
            out = _core.evaluate(mechanism, x, (x - anchor) / tau, f)["force"]
            balance = (out - drag * (x - anchor)) * scale / _FELT  # N
            return np.append(balance, (self.height(x) - self._origin - travel) / _FELT)

        r = residual(q, force)
        size = float(np.linalg.norm(r))
        matrix = np.zeros((n + 1, n + 1))
        for _ in range(30):
            if size < 1e-8:
                return q, force
            stiffness, damping = _core.jacobian_blocks(mechanism, q, (q - anchor) / tau, force)
            # The finger force enters linearly.
            pull = (
                _core.evaluate(mechanism, q, (q - anchor) / tau, force + 1.0)["force"]
                - _core.evaluate(mechanism, q, (q - anchor) / tau, force)["force"]
            )
            self.evaluations += 2
            block = stiffness + damping / tau - np.diag(drag)
            matrix[:n, :n] = block * scale[None, :] * scale[:, None] / _FELT
            matrix[:n, n] = matrix[n, :n] = pull * scale / _FELT
            try:
                dx = np.linalg.solve(matrix, -r)
            except np.linalg.LinAlgError:
                return None
            largest = float(np.max(np.abs(dx[:n])))
            part = min(1.0, 0.5 / largest) if largest > 0.0 else 1.0
            for _ in range(10):
                x = q + part * dx[:n] * scale
                f = force + part * dx[n]
                trial = residual(x, f)
                norm = float(np.linalg.norm(trial))
                if norm < (1.0 - 1e-4 * part) * size:
                    break
                part *= 0.4
            else:
                break
            q, force, r, size = x, f, trial, norm
        return (q, force) if size < 1e-6 else None

    def state(self) -> dict[int, tuple[float, float]]:
        """Gap [m] and normal force [N] by contact number at the present pose."""
        import numpy as np

        out = _core.evaluate(self._sharp, self.q, np.zeros(self.n), self.force)
        return {int(row[0]): (-float(row[1]), float(row[3])) for row in out["contacts"]}


_POINT = "quasistatic finger"


def _mechanism(
    action: Action, pace: float, friction: FrictionMode, blur: float, opened: frozenset[int]
) -> Any:
    """The mechanism with weight but without inertia, and the finger as a point."""
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
            # Slip of the joint a meter of finger travel.
            reach = scale[body.coordinate] / _FELT
            given = action.config.bodies[body.name].friction
            where = f"bodies.{body.name}.friction"
            body.friction = _friction(given, where, friction, pace * reach, blur)
    description.bodies = bodies
    contacts = description.contacts
    for contact in contacts:
        data = action.config.contacts[f"{contact.number:02d}"]
        where = f"contacts.{contact.number:02d}.friction"
        contact.friction = _friction(data.friction, where, friction, pace, blur)
        if friction != "law":
            # Without a speed felt follows its loading curve, the slow limit of eq. 4.22.
            slow = {"alpha": data.alpha * 1e-3 * _STILL}
            contact.law = core_law(data.model_copy(update=slow))
        if contact.number in opened:
            contact.enabled = False
    description.contacts = contacts
    return _core.assemble(description)


def _friction(
    given: FrictionParameters, where: str, mode: FrictionMode, speed: float, blur: float
) -> _core.Friction:
    """Friction of a mode: the law itself, but for the terms that the mode leaves out.

    ``speed``: typical of the sliding; ``blur``: the law turns over at this many times its speed.
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
    """Largest force of the dry terms: what holds until it slides."""
    import numpy as np

    least, most = given.dry_speeds
    if math.isinf(most):
        raise InvalidParameter(
            f"slow press: {where} has b1 = {given.b1:g} and b2 = 0, so that it grows with the "
            f"speed without end and has no breakaway value; give b2 > 0, or use viscous"
        )
    speeds = np.geomspace(least, most, 20001)
    return float(max(given.amplitude, np.max(given.dry().coefficient(speeds))))


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
        Finger speed [m/s] that friction, hysteresis and damping see, > 0.
    friction
        ``law``: thesis eq. A.1 with the viscous, quadratic and Stribeck terms, at the sliding
        speeds of the path. ``saturated``: the same with a threshold speed of zero, Coulomb friction
        with the coefficient A and the three terms. ``breakaway``: Coulomb friction with the largest
        value of the dry terms, A (tanh x + B1 x / (1 + B2 x^4)) and Stribeck's. ``none``: no
        friction. In the last three felt follows its loading curve, the slow limit of eq. 4.22. The
        last two do not depend on ``speed``: dashpots and damping have no force in them.
    open_contacts
        Contacts by number that are switched off, such as the damper spoon under a raised pedal.

    Raises
    ------
    ModelError
        No equilibrium beyond some travel.
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
    """Columns of the rows of a press."""
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
    """A simulated slow press and, if asked for, release.

    Attributes
    ----------
    run : Run
        The simulation.
    travel : ndarray (n_times,)
        Travel of the finger point on the key from rest [m], positive pressing.
    force : ndarray (n_times,)
        Finger force on the key [N].
    gap : ndarray (n_times,)
        Distance of hammer and string [m], the string undisplaced; negative: pressed beyond it.
    turn : int
        First sample of the release (the number of samples without one).
    """

    run: Run
    travel: Array
    force: Array
    gap: Array
    turn: int

    @property
    def closest(self) -> float:
        """Closest approach of the hammer to the string at rest, the let-off distance [m]."""
        return float(self.gap[: self.turn].min())

    @property
    def closest_travel(self) -> float:
        """Finger travel at the closest approach [m]."""
        return float(self.travel[int(self.gap[: self.turn].argmin())])

    def gap_when(self, contact: int) -> float | None:
        """Distance hammer - string [m] when a contact first closes; None if it never does."""
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
        [m/s], > 0.
    travel
        Of the finger [m], > 0: past the let-off and into the front punching.
    release
        Let the finger come up again at the same speed, after a rest of 0.2 s.

    Raises
    ------
    InvalidParameter
        The mechanism names no strike contact or no finger, or a number is out of range.
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
    # 20 samples a millimeter of finger travel at least.
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
    """Let-off of a press without inertia."""

    gap: float  #: closest approach of hammer and string [m]
    travel: float  #: finger travel there [m]
    force: float  #: largest finger force up to there [N]
    tripped: bool  #: the jack let go; false: the press ended first


def static_let_off(
    action: Action,
    *,
    travel: float = 0.012,
    speed: float = 0.010,
    friction: FrictionMode = "saturated",
    step: float = 1e-5,
    most_force: float = 60.0,
) -> StaticLetOff:
    """Closest approach of the hammer in a press without inertia; see :func:`slow_press`.

    Parameters
    ----------
    travel
        Finger travel at which the press ends [m].
    step
        Of the finger travel once the hammer is within 8 mm of the string [m]; ten times longer
        before.
    most_force
        The press ends at this force, the hammer then being blocked on the string [N].
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
        if press.force > most_force:
            break
        largest = max(largest, press.force)
        if gap < best:
            best, where = gap, at
    return StaticLetOff(best, where, largest, False)
