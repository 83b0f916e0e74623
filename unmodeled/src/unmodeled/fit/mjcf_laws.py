"""Laws of geared servos that MJCF has no word for: they change fields of a model at each step.

A remedy holds their sizes as numbers of the file, ``<numeric name="unmodeled.JOINT.load_friction"
data="0.3"/>``; :func:`servo_laws` reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array
from unmodeled.errors import InvalidParameter

#: Begin of the names of the numbers of a file that are sizes of laws.
NUMERIC = "unmodeled."


@dataclass(frozen=True, eq=False)
class Servo:
    """An actuator without a state at a hinge or slide: its force follows from the motion."""

    joint: str
    actuator: str
    dof: int
    place: int
    """Index of the position of its joint."""
    row: int
    """Index of the actuator."""
    control: int
    """Index of its control."""
    gain: float
    bias: tuple[float, float, float]
    gear: float
    goals: tuple[float, float]
    """Range of its control."""
    limits: tuple[float, float]
    """Range of its force."""
    friction: float
    """Dry friction of its joint."""


#: ``clip(x, low, high)`` of a number or of an array.
Clip = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True, eq=False)
class _At:
    """A servo at one state or at many; a law of friction gets the limited force."""

    servo: Servo
    clip: Clip
    goal: Any
    length: Any
    speed: Any
    force: Any


def _dead_band(at: _At, size: float) -> Any:
    return -at.servo.gain * at.clip(at.goal - at.length, -size, size)


def _speed_loss(at: _At, size: float) -> Any:
    return at.servo.limits[1] * size * at.speed


def _load_friction(at: _At, size: float) -> Any:
    return size * abs(at.servo.gear * at.force)


@dataclass(frozen=True)
class Law:
    """What is added to the force of an actuator or to the dry friction of its joint.

    ``limits``: what the largest force loses; the limits of the other direction stay.
    """

    of: Literal["force", "limits", "friction"]
    added: Callable[[_At, float], Any]


#: In the order in which they act.
LAWS = {
    "dead_band": Law("force", _dead_band),
    "speed_loss": Law("limits", _speed_loss),
    "load_friction": Law("friction", _load_friction),
    "one_sided_friction": Law(
        "friction", lambda at, size: size * ((at.speed > 0.0) * 1.0 - (at.speed < 0.0))
    ),
}


def servos_of(model: Any) -> list[Servo]:
    """Actuators whose force is an affine function of the motion of their joint; one a joint."""
    import mujoco as mj

    found: dict[str, Servo] = {}
    own = {"trntype": mj.mjtTrn.mjTRN_JOINT, "dyntype": mj.mjtDyn.mjDYN_NONE,
           "gaintype": mj.mjtGain.mjGAIN_FIXED, "biastype": mj.mjtBias.mjBIAS_AFFINE}  # fmt: skip

    def span(field: str, i: int) -> tuple[float, float]:
        low, high = getattr(model, f"actuator_{field}range")[i]
        limited = getattr(model, f"actuator_{field}limited")[i]
        return (float(low), float(high)) if limited else (-np.inf, np.inf)

    for i in range(model.nactuator):
        joint, name = int(model.actuator_trnid[i, 0]), model.actuator(i).name
        if not name or any(getattr(model, f"actuator_{n}")[i] != int(v) for n, v in own.items()):
            continue
        if model.jnt_type[joint] >= 2 and (owner := model.joint(joint).name):
            dof = int(model.jnt_dofadr[joint])
            zero, by_length, by_speed = map(float, model.actuator_biasprm[i, :3])
            found.setdefault(owner, Servo(
                owner, name, dof, int(model.jnt_qposadr[joint]), i, int(model.actuator_ctrladr[i]),
                float(model.actuator_gainprm[i, 0]), (zero, by_length, by_speed),
                float(model.actuator_gear[i, 0]),
                span("ctrl", i), span("force", i), float(model.dof_frictionloss[dof]),
            ))  # fmt: skip
    return list(found.values())


def _clip(x: float, low: float, high: float) -> float:
    return low if x < low else high if x > high else x


class ServoLaws:
    """Result of :func:`servo_laws`: call it before each step."""

    def __init__(self, model: Any, sizes: Mapping[str, float]):
        self._model = model
        self._own: list[tuple[Servo, list[tuple[Law, float]]]] = []
        for servo in servos_of(model) if any(sizes.values()) else ():
            named = [
                (law, float(size))
                for what, law in LAWS.items()
                for owner in dict.fromkeys((servo.joint, servo.actuator))
                if (size := sizes.get(f"{owner}.{what}", 0.0))
            ]
            if named:
                self._own.append((servo, named))

    def __bool__(self) -> bool:
        return bool(self._own)

    def __call__(self, data: Any) -> None:
        """Set the forces, their limits, and the frictions of the next step in the model."""
        q, v, u, model = data.qpos, data.qvel, data.ctrl, self._model
        for servo, named in self._own:
            motion = q.item(servo.place), v.item(servo.dof), u.item(servo.control)
            acting = _acting(servo, named, *motion, _clip)
            model.actuator_biasprm[servo.row, 0] = servo.bias[0] + acting.force
            model.actuator_forcerange[servo.row] = acting.low, acting.high
            model.dof_frictionloss[servo.dof] = max(servo.friction + acting.friction, 0.0)

    def undo(self) -> None:
        """Set the model as it was."""
        for servo, _ in self._own:
            self._model.actuator_biasprm[servo.row, 0] = servo.bias[0]
            self._model.actuator_forcerange[servo.row] = servo.limits
            self._model.dof_frictionloss[servo.dof] = servo.friction

    def forces(self, states: Array, controls: Array, accelerations: Array, step: float) -> Array:
        """Forces on the coordinates at many states, (rows, nv), for derivatives.

        A friction stops its joint within the step [s], and not more. Its direction is that which
        MuJoCo gives it, a little ahead by the accelerations.
        """
        model, nv = self._model, int(self._model.nv)
        out = np.zeros((len(states), nv))
        for s, named in self._own:
            speed = states[:, nv + s.dof]
            now = _acting(s, named, states[:, s.place], speed, controls[:, s.control], np.clip)
            more = np.clip(now.own + now.force, now.low, now.high) - np.clip(now.own, *s.limits)
            friction = np.maximum(now.friction, -s.friction)
            # Half of the time constant of the constraint, times its largest impedance.
            ahead = 0.5 * model.dof_solimp[s.dof, 1] * max(model.dof_solref[s.dof, 0], 2.0 * step)
            stop = (speed + ahead * accelerations[:, s.dof]) * model.dof_M0[s.dof] / step
            most = np.abs(friction)
            out[:, s.dof] = s.gear * more - np.sign(friction) * np.clip(stop, -most, most)
        return out


@dataclass(frozen=True, eq=False)
class _Acting:
    """Force of a servo without laws and limits, what laws add, the limits, and the friction."""

    own: Any
    force: Any
    low: Any
    high: Any
    friction: Any


def _acting(
    servo: Servo, named: Sequence[tuple[Law, float]], q: Any, v: Any, u: Any, clip: Clip
) -> _Acting:
    goal, length, speed = clip(u, *servo.goals), servo.gear * q, servo.gear * v
    own = servo.gain * goal + servo.bias[0] + servo.bias[1] * length + servo.bias[2] * speed
    added, friction, (low, high) = 0.0 * own, 0.0 * own, servo.limits
    for law, size in named:
        force = own + added
        if law.of == "friction":
            force = clip(force, low, high)
        more = law.added(_At(servo, clip, goal, length, speed, force), size)
        if law.of == "force":
            added = added + more
        elif law.of == "limits":
            low, high = clip(low - more, low, np.inf), clip(high - more, -np.inf, high)
        else:
            friction = friction + more
    return _Acting(own, added, low, high, friction)


@checked
def servo_laws(model: Any) -> ServoLaws:
    """Laws of servos in a MuJoCo model that MJCF cannot express, to be called before each step.

    A remedy of :func:`mujoco` stores friction in proportion to the load, one-sided friction, a dead
    band, and a force that falls with the speed as numbers (``<custom>``) of its file.

    Parameters
    ----------
    model
        Compiled model (``mujoco.MjModel``), whose dry frictions and biases of actuators it sets.

    Raises
    ------
    InvalidParameter
        It is no compiled model, or it has a size of a law, but no such servo.

    Examples
    --------
    >>> import mujoco
    >>> from unmodeled import servo_laws
    >>> text = '''<mujoco>
    ...   <custom><numeric name="unmodeled.lift.load_friction" data="0.5"/></custom>
    ...   <worldbody><body><joint name="lift" axis="0 1 0"/>
    ...     <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></worldbody>
    ...   <actuator><position name="lift" joint="lift" kp="20" kv="1"/></actuator>
    ... </mujoco>'''
    >>> model = mujoco.MjModel.from_xml_string(text)
    >>> data, laws = mujoco.MjData(model), servo_laws(model)
    >>> data.ctrl[:] = 0.1
    >>> laws(data)
    >>> print(model.dof_frictionloss)
    [1.]
    """
    import mujoco as mj

    if not isinstance(model, mj.MjModel):
        raise InvalidParameter(f"servo_laws: got {type(model).__name__}, expected a mujoco.MjModel")
    sizes, servos = sizes_in(model), servos_of(model)
    known = {f"{owner}.{n}" for s in servos for owner in (s.joint, s.actuator) for n in LAWS}
    if wrong := [n for n in sizes if n not in known]:
        raise InvalidParameter(
            f"servo_laws: the number {NUMERIC}{wrong[0]} of the model is no law of a servo; there "
            f"are {', '.join(sorted(known)) or 'none'}"
        )
    return ServoLaws(model, sizes)


def sizes_in(model: Any) -> dict[str, float]:
    """Sizes of laws that a compiled model holds as numbers, by ``JOINT.load_friction``."""
    names = [model.numeric(i).name for i in range(model.nnumeric)]
    return {
        n.removeprefix(NUMERIC): float(model.numeric(n).data[0])
        for n in names
        if n.startswith(NUMERIC)
    }


def write_sizes(spec: Any, sizes: Mapping[str, float]) -> None:
    """Store sizes of laws as numbers of a specification."""
    old = {n.name: n for n in spec.numerics}
    for name, size in sizes.items():
        entry = old.get(NUMERIC + name) or spec.add_numeric(name=NUMERIC + name)
        entry.size, entry.data = 1, [size]
