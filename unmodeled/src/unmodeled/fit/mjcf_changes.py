"""Numbers of a MuJoCo model that a fit changes, as fields of the compiled model."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.data.robots import Joint
from unmodeled.errors import InvalidParameter
from unmodeled.fit.mjcf_laws import LAWS, servos_of, sizes_in

#: Share of the inertia of a joint that its backlash joint gets as armature; time constant of the
#: limits of the clearance [s], at least two time steps.
ARMATURE, CONTACT = 0.01, 4e-3
#: End of the name of a backlash joint.
BACKLASH = "_backlash"
AXES = "xyz"


def import_mujoco() -> Any:
    """The package ``mujoco``."""
    try:
        import mujoco
        import mujoco.rollout
    except ImportError:
        raise InvalidParameter(
            "mujoco: the package mujoco is not installed; pip install mujoco"
        ) from None
    return mujoco


def _silent(_text: str) -> None:
    """Nothing is told: a run that fails is one that returns no numbers."""


@contextmanager
def quiet() -> Iterator[None]:
    """A block whose warnings of MuJoCo are not printed, nor written into a file MUJOCO_LOG.TXT."""
    mj = import_mujoco()
    told, log = mj.get_mju_user_warning(), mj.MjLogConfig.get()
    silent = mj.MjLogConfig.get()
    silent.logto_console = silent.logto_file = False
    mj.set_mju_user_warning(_silent)
    mj.MjLogConfig.set(silent)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield
    finally:
        mj.set_mju_user_warning(told)
        mj.MjLogConfig.set(log)


# -------------------------------------------------------------------------------------- properties


#: Sets a number of a compiled model: (model, name of the owner, value).
Setter = Callable[[Any, str, float], None]


@dataclass(frozen=True)
class Kind:
    """A kind of number of a joint, an actuator, a body, or gravity."""

    units: tuple[str, str]
    """By a slide and by a hinge; equal for others."""
    set: Setter
    mechanism: str = ""
    inertial: bool = False
    """Whether other fields of the model follow from it (``mj_setConst``)."""
    signed: bool = False
    moves: bool = False
    """Whether it moves a center of mass away from its joint."""
    steady: bool = False
    """Whether its force changes as slowly as the motion."""
    noun: str = ""
    """What differs: "the NOUN of OWNER", or what the owner has, if the file has none of it."""
    jumps: bool = False
    """Whether its first change switches something on."""
    place: bool = False
    """Whether it moves what is tracked, and nothing else shows it well."""


@dataclass(frozen=True)
class Property:
    """A number of a model."""

    value: float
    kind: Kind
    unit: str
    tested: bool
    """Whether another value is an effect that is tested by default."""


def _field(field: str, of: str, axis: int | None = None, sign: float = 1.0) -> Setter:
    """Sets a number of a field in the row of a joint, a "dof" of it, an actuator, or a body."""

    def put(model: Any, name: str, value: float) -> None:
        row = model.joint(name).dofadr[0] if of == "dof" else getattr(model, of)(name).id
        getattr(model, field)[row if axis is None else (row, axis)] = sign * value
        if field == "body_ipos":
            model.body_sameframe[row] = 0

    return put


def _clearance(model: Any, name: str, value: float) -> None:
    if value > 0.0:  # else there is no such joint
        model.jnt_range[model.joint(name + BACKLASH).id] = -value, value


def _gain(model: Any, name: str, value: float) -> None:
    """Gain; a servo of position or speed keeps its zero."""
    i = model.actuator(name).id
    gain, bias = model.actuator_gainprm[i], model.actuator_biasprm[i]
    for k in (1, 2):
        if gain[0] != 0.0 and bias[k] == -gain[0]:
            bias[k] = -value
    gain[0] = value


def _force(model: Any, name: str, value: float) -> None:
    model.actuator_forcerange[model.actuator(name).id] = -value, value


def _mass(model: Any, name: str, value: float) -> None:
    i = model.body(name).id
    model.body_inertia[i] *= value / model.body_mass[i]
    model.body_mass[i] = value


def _payload(model: Any, name: str, value: float) -> None:
    model.body_mass[model.body(name).id] += value


def _payload_at_site(model: Any, name: str, mass: float) -> None:
    i = model.site(name).id
    _payload_at(model, model.body(model.site_bodyid[i]).name, mass, model.site_pos[i])


def _payload_at(model: Any, name: str, mass: float, place: Array) -> None:
    """Add a point mass at a place in the frame of a body."""
    mj, i = import_mujoco(), model.body(name).id
    own, center = float(model.body_mass[i]), model.body_ipos[i].copy()
    nine = np.empty(9)
    mj.mju_quat2Mat(nine, model.body_iquat[i])
    turn = nine.reshape(3, 3)
    middle = (own * center + mass * place) / (own + mass)
    tensor = turn @ np.diag(model.body_inertia[i]) @ turn.T
    for m, d in ((own, center - middle), (mass, place - middle)):
        tensor += m * (d @ d * np.eye(3) - np.outer(d, d))
    size, turn = np.linalg.eigh(tensor)
    if np.linalg.det(turn) < 0.0:
        turn[:, 0] *= -1.0
    mj.mju_mat2Quat(model.body_iquat[i], turn.reshape(9))
    model.body_inertia[i], model.body_mass[i], model.body_ipos[i] = size, own + mass, middle
    model.body_sameframe[i] = 0


def _zero(model: Any, name: str, value: float) -> None:
    """Reading of the encoder in the pose of the file; what the machine has by its angle moves."""
    joint = model.joint(name)
    i, at = int(joint.id), int(joint.qposadr[0])
    moved = value - float(model.qpos0[at])
    model.qpos0[at] = value
    model.qpos_spring[at] += moved
    if model.jnt_limited[i]:
        model.jnt_range[i] += moved


def _length(model: Any, name: str, value: float) -> None:
    place = model.body_pos[model.body(name).id]
    place *= value / np.linalg.norm(place)


def _turn(axis: int) -> Setter:
    def put(model: Any, name: str, value: float) -> None:
        mj, turn = import_mujoco(), np.empty(4)
        own = model.body_quat[model.body(name).id]
        mj.mju_axisAngle2Quat(turn, np.eye(3)[axis], value)
        mj.mju_mulQuat(own, own.copy(), turn)

    return put


def _nothing(_model: Any, _name: str, _value: float) -> None:
    """A law changes fields during a run."""


def _tilt(axis: int) -> Setter:
    def put(model: Any, _name: str, value: float) -> None:
        mj, out, turn = import_mujoco(), np.empty(3), np.empty(4)
        mj.mju_axisAngle2Quat(turn, np.eye(3)[axis], value)
        mj.mju_rotVecQuat(out, model.opt.gravity, turn)
        model.opt.gravity[:] = out

    return put


JOINT = {
    "damping": Kind(("N s/m", "N m s/rad"), _field("dof_damping", "dof"),
                    "A force in proportion to the speed opposes the motion.", steady=True,
                    noun="damping"),
    "frictionloss": Kind(("N", "N m"), _field("dof_frictionloss", "dof"),
                         "A force of constant magnitude opposes the motion.", steady=True,
                         noun="dry friction"),
    "armature": Kind(("kg", "kg m^2"), _field("dof_armature", "dof"),
                     "The rotor has an inertia of its own.", inertial=True, noun="armature"),
    "stiffness": Kind(("N/m", "N m/rad"), _field("jnt_stiffness", "joint"),
                      "A spring acts on the joint.", steady=True, noun="stiffness"),
    "backlash": Kind(("m", "rad"), _clearance, "The gear has a clearance of twice this size.",
                     jumps=True, noun="backlash"),
    "zero": Kind(("m", "rad"), _zero, "The zero of the encoder is at another place: servo and "
                 "reading shift together.", inertial=True, signed=True,
                 noun="the zero of the encoder"),
    "load_friction": Kind(("1", "1"), _nothing, "Friction grows with the force of the actuator "
                          "that is transmitted.", noun="friction in proportion to its load",
                          jumps=True),
    "one_sided_friction": Kind(("N", "N m"), _nothing, "Dry friction is stronger in one direction "
                               "than in the other.", signed=True, noun="one-sided friction",
                               jumps=True),
}  # fmt: skip


def _places(name: str, field: str, of: str, what: str) -> dict[str, Kind]:
    """Coordinates of a place [m]."""
    return {
        f"{name}_{a}": Kind(("m", "m"), _field(field, of, i), f"{what} is at another place.",
                            inertial=True, signed=True, moves=True,
                            noun=f"the place along {a} of {what[0].lower()}{what[1:]}")
        for i, a in enumerate(AXES)
    }  # fmt: skip


OFFSETS = _places("offset", "jnt_pos", "joint", "The axis of the joint")
ACTUATOR = {
    "gain": Kind(("1", "1"), _gain, "The actuator is weaker or stronger.", noun="gain"),
    "kp": Kind(("N/m", "N m/rad"), _gain, "The servo is softer or stiffer.", noun="stiffness"),
    "kv": Kind(("N s/m", "N m s/rad"), _field("actuator_biasprm", "actuator", 2, -1.0),
               "The servo has another damping.", noun="damping"),
    "gear": Kind(("1", "1"), _field("actuator_gear", "actuator", 0), "The gear has another ratio.",
                 inertial=True, signed=True, noun="gear ratio"),
    "force": Kind(("N", "N m"), _force, "The actuator has another largest force.", jumps=True,
                  noun="largest force"),
    "dead_band": Kind(("m", "rad"), _nothing, "The servo makes no force while its error is "
                      "smaller than this.", noun="a dead band of its error", jumps=True),
    "speed_loss": Kind(("s/m", "s/rad"), _nothing, "The largest force falls with the speed, to "
                       "nothing at the reciprocal of this.", noun="a largest force that falls with "
                       "the speed", jumps=True),
}  # fmt: skip
BODY = {
    "mass": Kind(("kg", "kg"), _mass, "The body is lighter or heavier.", inertial=True,
                 noun="mass"),
    "payload": Kind(("kg", "kg"), _payload, "A mass is attached to the body.", inertial=True,
                    noun="a payload"),
    **_places("center", "body_ipos", "body", "The center of mass"),
    **{
        f"inertia_{a}": Kind(("kg m^2", "kg m^2"), _field("body_inertia", "body", i),
                             "The body has another inertia.", inertial=True,
                             noun=f"inertia about {a}")
        for i, a in enumerate(AXES)
    },
    **_places("payload", "body_ipos", "body", "The attached mass"),
    "length": Kind(("m", "m"), _length, "The body is mounted at another distance.", inertial=True,
                   place=True, noun="the distance of the mount"),
    **{n: replace(k, place=True, noun=f"the place of the mount along {n[-1]}")
       for n, k in _places("pos", "body_pos", "body", "The body").items()},
    **{f"turn_{a}": Kind(("rad", "rad"), _turn(i), "The body is mounted at another angle.",
                         inertial=True, signed=True, place=True,
                         noun=f"the angle of the mount about {a}") for i, a in enumerate(AXES)},
}  # fmt: skip
TILT = {
    f"tilt_{a}": Kind(
        ("rad", "rad"),
        _tilt(i),
        "The base is not level.",
        signed=True,
        steady=True,
        noun=f"the tilt about {a}",
    )
    for i, a in enumerate(AXES)
}


def properties(model: Any) -> dict[str, Property]:
    """Numbers of a model by name, ``JOINT.damping``, with their values in the file."""
    out = {**_of_joints(model), **_of_actuators(model), **_of_bodies(model), **_of_sites(model)}
    gravity = np.abs(model.opt.gravity)
    for name, kind in TILT.items():
        if gravity[AXES.index(name[-1])] < gravity.max():
            out[f"gravity.{name}"] = Property(0.0, kind, "rad", tested=True)
    return out


def _of_joints(model: Any) -> dict[str, Property]:
    mj, found, sizes = import_mujoco(), {}, sizes_in(model)
    driven = {s.joint for s in servos_of(model)}
    for i in range(model.njnt):
        name, kind = model.joint(i).name, int(model.jnt_type[i])
        hinge = kind == int(mj.mjtJoint.mjJNT_HINGE)
        if not name or not (hinge or kind == int(mj.mjtJoint.mjJNT_SLIDE)):
            continue
        at = int(model.jnt_dofadr[i])
        values = {
            "damping": model.dof_damping[at],
            "frictionloss": model.dof_frictionloss[at],
            "armature": model.dof_armature[at],
            "stiffness": model.jnt_stiffness[i],
            "backlash": 0.0,
            "zero": model.qpos0[int(model.jnt_qposadr[i])],
        }
        if name in driven:
            values |= {n: sizes.get(f"{name}.{n}", 0.0) for n in LAWS if n in JOINT}
        if i + 1 < model.njnt and model.jnt_bodyid[i + 1] == model.jnt_bodyid[i]:
            del values["backlash"]  # its second joint would be behind the next one
        for what, value in values.items():
            row = JOINT[what]
            tested = what != "zero" or name in driven
            found[f"{name}.{what}"] = Property(float(value), row, row.units[hinge], tested=tested)
        for k, (what, row) in enumerate(OFFSETS.items()):
            value = float(model.jnt_pos[i, k])
            found[f"{name}.{what}"] = Property(value, row, "m", tested=False)
    return found


def _of_actuators(model: Any) -> dict[str, Property]:
    mj, found, sizes = import_mujoco(), {}, sizes_in(model)
    servos = {s.actuator for s in servos_of(model)}
    for i in range(model.nactuator):
        name, gain, bias = (
            model.actuator(i).name,
            float(model.actuator_gainprm[i, 0]),
            model.actuator_biasprm[i],
        )
        if not name:
            continue
        joint = int(model.actuator_trnid[i, 0])
        on_joint = int(model.actuator_trntype[i]) == int(mj.mjtTrn.mjTRN_JOINT)
        hinge = not on_joint or int(model.jnt_type[joint]) == int(mj.mjtJoint.mjJNT_HINGE)
        servo = bool(model.actuator_biastype[i])
        position, speed = (servo and gain != 0.0 and bias[k] == -gain for k in (1, 2))
        values = {"kp" if position else "kv" if speed else "gain": gain}
        if position:
            values["kv"] = -float(bias[2])
        values["gear"] = float(model.actuator_gear[i, 0])
        low, high = model.actuator_forcerange[i]
        if model.actuator_forcelimited[i] and low == -high:
            values["force"] = float(high)
        if name in servos:
            laws = {"dead_band": position, "speed_loss": "force" in values}
            values |= {n: sizes.get(f"{name}.{n}", 0.0) for n, there in laws.items() if there}
        for what, value in values.items():
            row = ACTUATOR["gain"] if speed and what == "kv" else ACTUATOR[what]
            unit = ACTUATOR[what].units[hinge] if on_joint else "1"
            found[f"{name}.{what}"] = Property(value, row, unit, tested=servo)
    return found


def _of_bodies(model: Any) -> dict[str, Property]:
    found = {}
    # Moving bodies that carry no other body, welded ones included: what a machine holds is there.
    carriers = {int(b) for b in model.body_parentid[1:]}
    outermost = {b for b in range(1, model.nbody) if model.body_weldid[b] and b not in carriers}
    for i in range(1, model.nbody):
        name, mass = model.body(i).name, float(model.body_mass[i])
        if name and mass == 0.0 and model.body_weldid[i]:
            found[f"{name}.payload"] = Property(0.0, BODY["payload"], "kg", tested=i in outermost)
        if not name or not mass > 0.0:
            continue
        values = {"mass": mass, "payload": 0.0}
        for what, three in (
            ("center", model.body_ipos[i]),
            ("inertia", model.body_inertia[i]),
            ("payload", model.body_ipos[i]),
        ):
            values |= {f"{what}_{a}": float(v) for a, v in zip(AXES, three, strict=True)}
        other = "payload" if i in outermost else "mass" if model.body_weldid[i] else ""
        for what, value in values.items():
            unit = BODY[what].units[0]
            found[f"{name}.{what}"] = Property(value, BODY[what], unit, tested=what == other)
    return {**found, **_of_mounts(model)}


def _of_mounts(model: Any) -> dict[str, Property]:
    """Mounts of the moving bodies on each other; those that carry what is tracked are tested."""
    mj, found, tracked = import_mujoco(), {}, set[int]()
    kinds = {getattr(mj.mjtSensor, f"mjSENS_FRAME{n}")
             for n in ("POS", "QUAT", "XAXIS", "YAXIS", "ZAXIS")}  # fmt: skip
    owners = {mj.mjtObj.mjOBJ_SITE: model.site_bodyid, mj.mjtObj.mjOBJ_GEOM: model.geom_bodyid,
              mj.mjtObj.mjOBJ_CAMERA: model.cam_bodyid}  # fmt: skip
    for i in map(int, np.flatnonzero(np.isin(model.sensor_type, [int(k) for k in kinds]))):
        of = owners.get(mj.mjtObj(int(model.sensor_objtype[i])), np.arange(model.nbody))
        body = int(of[model.sensor_objid[i]])
        while body:
            tracked.add(body)
            body = int(model.body_parentid[body])
    for i in range(1, model.nbody):
        name, distance = model.body(i).name, float(np.linalg.norm(model.body_pos[i]))
        if not name or not model.body_weldid[model.body_parentid[i]]:
            continue  # its parent does not move
        welded = int(model.body_weldid[i]) != i
        values = {"length": distance} if distance > 0.0 else {}
        if welded:
            values |= {f"pos_{a}": float(v) for a, v in zip(AXES, model.body_pos[i], strict=True)}
            values |= {f"turn_{a}": 0.0 for a in AXES}
        for what, value in values.items():
            tested = i in tracked and welded == (what != "length")
            found[f"{name}.{what}"] = Property(value, BODY[what], BODY[what].units[0], tested)
    return found


def _of_sites(model: Any) -> dict[str, Property]:
    """Payloads at the places of the sites of moving bodies."""
    bodies = {model.body(i).name for i in range(model.nbody)}
    row = replace(BODY["payload"], set=_payload_at_site)
    return {
        f"{name}.payload": Property(0.0, row, "kg", tested=False)
        for i in range(model.nsite)
        if (name := model.site(i).name)
        and name not in bodies
        and model.body_weldid[model.site_bodyid[i]]
    }


def place_of_payload(model: Any, name: str) -> str:
    """Where the payload of a body or a site is, for the report."""
    if name in {model.body(i).name for i in range(model.nbody)}:
        place = model.body_ipos[model.body(name).id]
        what = f"at the center of mass of the body {name}"
    else:
        i = model.site(name).id
        place = model.site_pos[i]
        what = f"at the site {name} of the body {model.body(model.site_bodyid[i]).name}"
    numbers = ", ".join(f"{v:.4g}" for v in place)
    return f"{what}, ({numbers}) m in the frame of this body"


def set_properties(model: Any, values: Mapping[str, float], known: Mapping[str, Property]) -> None:
    """Set properties, in place, of a compiled model that differ from those of the file."""
    places: dict[str, Array] = {}
    for name, value in values.items():
        owner, _, what = name.rpartition(".")
        if what.startswith("payload_"):
            place = places.setdefault(owner, model.body_ipos[model.body(owner).id].copy())
            place[AXES.index(what[-1])] = value
    for name, value in values.items():
        owner, _, what = name.rpartition(".")
        if what == "payload" and owner in places:
            _payload_at(model, owner, value, places[owner])
        elif not what.startswith("payload_"):
            known[name].kind.set(model, owner, value)


# ------------------------------------------------------------------------- changes of a structure


def add_backlash(spec: Any, model: Any, names: Sequence[str]) -> None:
    """Add a second joint behind each of these joints, which moves freely within its range.

    ``model``: the compiled model without them. Keyframes move with the joints.
    """
    mj = import_mujoco()
    joints = [model.joint(n) for n in names]
    for i, key in enumerate(spec.keys if names else ()):
        key.qpos = np.insert(model.key_qpos[i], [int(j.qposadr[0]) + 1 for j in joints], 0.0)
        key.qvel = np.insert(model.key_qvel[i], [int(j.dofadr[0]) + 1 for j in joints], 0.0)
    for name, compiled in zip(names, joints, strict=True):
        joint = spec.joint(name)
        extra = joint.parent.add_joint(
            name=f"{name}{BACKLASH}",
            type=joint.type,
            axis=joint.axis,
            pos=joint.pos,
            limited=mj.mjtLimited.mjLIMITED_TRUE,
            armature=float(f"{ARMATURE * float(model.dof_M0[compiled.dofadr[0]]):.3g}"),
            # These would be the defaults of the joints of this file.
            frictionloss=0.0,
            ref=0.0,
            springref=0.0,
            margin=0.0,
            springdamper=[0.0, 0.0],
            actfrclimited=mj.mjtLimited.mjLIMITED_FALSE,
        )
        extra.damping = np.zeros(np.shape(joint.damping))
        extra.stiffness = np.zeros(np.shape(joint.stiffness))
        extra.solref_limit = [max(CONTACT, 2.0 * float(model.opt.timestep)), 1.0]
        extra.range = [-1.0, 1.0]  # set in the compiled model


def name_actuators(spec: Any) -> None:
    """Name the actuators of a specification that have no name as their joints."""
    mj = import_mujoco()
    used = {a.name for a in spec.actuators}
    for a in spec.actuators:
        joint = a.trntype in (mj.mjtTrn.mjTRN_JOINT, mj.mjtTrn.mjTRN_JOINTINPARENT)
        if not a.name and joint and a.target not in used:  # of two at one joint, the first one
            a.name = a.target
            used.add(a.name)


def controls(model: Any) -> dict[str, int]:
    """Actuators by name, as indices of their controls."""
    return {
        name: int(model.actuator_ctrladr[i])
        for i in range(model.nactuator)
        if (name := model.actuator(i).name)
    }


def probe(model: Any, name: str, value: float) -> float:
    """A small change of a property, whose action is in proportion to it; 0: none is known."""
    owner, _, what = name.rpartition(".")
    step = float(model.opt.timestep)
    if what == "speed_loss":
        return 10.0 * step  # of all force at 50 rad/s, for a usual step
    small = owner == "gravity" or what in ("zero", "load_friction", "dead_band")
    if small or (what in BODY and BODY[what].place):
        return 1e-4
    if what in JOINT and what != "backlash":
        inertia = float(model.dof_M0[model.joint(owner).dofadr[0]])
        return 1e-3 * inertia / (1.0 if what == "armature" else step)
    if what in ("payload", "mass"):
        return 1e-3 * float(model.body_subtreemass[1:].max())
    # A largest force may act nowhere, or at once.
    return 1e-3 * abs(value) if what in ACTUATOR and what != "force" else 0.0


def joints_of(model: Any) -> tuple[Joint, ...]:
    """Hinges and slides with their servos of position, in their order."""
    mj = import_mujoco()
    drives: dict[int, str] = {}
    for i in range(model.nactuator):
        gain, on_joint = model.actuator_gainprm[i, 0], int(mj.mjtTrn.mjTRN_JOINT)
        servo = gain != 0.0 and model.actuator_biasprm[i, 1] == -gain
        if servo and int(model.actuator_trntype[i]) == on_joint and model.actuator(i).name:
            drives.setdefault(int(model.actuator_trnid[i, 0]), model.actuator(i).name)
    found = []
    for i in range(model.njnt):
        if model.jnt_type[i] >= 2 and (name := model.joint(i).name):
            hinge = int(model.jnt_type[i]) == int(mj.mjtJoint.mjJNT_HINGE)
            low, high = model.jnt_range[i] if model.jnt_limited[i] else (-np.inf, np.inf)
            unit = "rad" if hinge else "m"
            found.append(Joint(name, drives.get(i, ""), unit, float(low), float(high)))
    return tuple(found)


def followed(model: Any) -> dict[str, str]:
    """Positions of joints that a servo leads to its goal, with the name of its actuator."""
    own = {j.actuator: j.name for j in joints_of(model) if j.actuator}
    servos = [
        (name, own[name])
        for i in range(model.nactuator)
        if (name := model.actuator(i).name) in own
        and model.actuator_gainprm[i, 0] != 0.0
        and model.actuator_biasprm[i, 1] == -model.actuator_gainprm[i, 0]
    ]
    return {out: name for name, joint in servos for out in (joint, f"{joint}.position")}
