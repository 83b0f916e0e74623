"""A MuJoCo model (MJCF) as a simulator: its joints and actuators have parameters and effects."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.files import is_file, write_text
from unmodeled.fit.mjcf_parts import outside_parts
from unmodeled.fit.model import Candidate, Ready
from unmodeled.fit.priors import Bounds, Priors, Unknowns
from unmodeled.fit.simulator import Simulator

__all__ = ["MujocoModel", "mujoco"]

#: Property of a joint -> unit by a slide and by a hinge, what it is, and how it is changed.
JOINTS = {
    "damping": ("N s/m", "N m s/rad", "A force in proportion to the speed opposes the motion."),
    "frictionloss": ("N", "N m", "A force of constant magnitude opposes the motion."),
    "armature": ("kg", "kg m^2", "The rotor has an inertia of its own."),
    "stiffness": ("N/m", "N m/rad", "A spring acts on the joint."),
    "backlash": ("m", "rad", "The gear has a clearance of twice this size."),
}
#: Share of the inertia of a joint that its backlash joint gets as armature; time constant of the
#: limits of the clearance [s], at least two time steps.
ARMATURE, CONTACT = 0.01, 4e-3
#: End of the name of a backlash joint.
BACKLASH = "_backlash"


#: Steps of MuJoCo between two looks for Ctrl-C.
STEPS = 1000


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise InvalidParameter(
            "mujoco: the package mujoco is not installed; pip install mujoco"
        ) from None
    return mujoco


@contextmanager
def _quiet() -> Iterator[None]:
    """A block whose warnings of MuJoCo are not printed, nor written into a file MUJOCO_LOG.TXT."""
    mj = _mujoco()
    told = mj.get_mju_user_warning()
    mj.set_mju_user_warning(_silent)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            yield
    finally:
        mj.set_mju_user_warning(told)


@dataclass(frozen=True)
class _Property:
    """A number of the file."""

    value: float
    unit: str
    mechanism: str
    tested: bool = True
    """Whether another value is an effect that is tested by default."""


class _Mjcf:
    """Function that runs an MJCF model; every process reads the file once."""

    def __init__(self, path: Path, key: str, settle: float, hold: str):
        self.path, self.key, self.settle, self.hold = path, key, settle, hold
        self.units: dict[str, str] = {}
        self.values: dict[str, float] = {}
        self.limits: dict[str, tuple[float, float]] = {}
        self._spec: Any = None
        self._model: Any = None
        self.outside: tuple[Path, ...] = ()
        """Files of the model that are not in its folder."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Notes for the user."""
        names = ", ".join(map(str, self.outside[:5]))
        more = f" and {len(self.outside) - 5} more" if len(self.outside) > 5 else ""
        return (f"reads files outside its folder: {names}{more}",) if names else ()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_spec": None, "_model": None}

    @property
    def spec(self) -> Any:
        """The unchanged specification."""
        self._read_file()
        return self._spec

    @property
    def model(self) -> Any:
        """The unchanged model."""
        self._read_file()
        return self._model

    def _read_file(self) -> None:
        if self._spec is not None:
            return
        self.outside = outside_parts(self.path)
        try:
            with _quiet():
                spec = _mujoco().MjSpec.from_file(str(self.path))
                _name_actuators(spec)
                self._model = spec.compile()
        except (ValueError, RuntimeError, MemoryError) as error:
            raise InvalidParameter(f"{self.path}: cannot be read as MJCF: {error}") from None
        self._spec = spec

    def patched(self, values: Mapping[str, float]) -> Any:
        """The specification with these values of properties, ``JOINT.damping``; others stay."""
        out = self.spec.copy()
        slack = [n[:-9] for n, v in values.items() if n.endswith(".backlash") and v > 0.0]
        if slack:
            self._move_keys(out, slack)
        for name, value in values.items():
            owner, _, what = name.rpartition(".")
            if what == "backlash":
                if owner in slack:
                    self._add_backlash(out, owner, value)
            elif what == "mass":
                body = out.body(owner)
                compiled = self.model.body(owner)
                share = value / float(compiled.mass[0])
                body.explicitinertial, body.mass = True, value
                body.ipos, body.iquat = compiled.ipos.copy(), compiled.iquat.copy()
                body.inertia = share * compiled.inertia
            elif what == "gain":
                actuator = out.actuator(owner)
                servo = actuator.biasprm[1] == -actuator.gainprm[0]
                actuator.gainprm[0] = value
                if servo:
                    actuator.biasprm[1] = -value
            elif what == "gear":
                out.actuator(owner).gear[0] = value
            elif what == "delay":
                actuator = out.actuator(owner)
                step = float(self.model.opt.timestep)
                actuator.delay, actuator.nsample = value, int(np.ceil(value / step)) + 2
            else:
                joint = out.joint(owner)
                given = getattr(joint, what)
                if np.ndim(given):  # coefficients of a polynomial
                    given[0] = value
                else:
                    setattr(joint, what, value)
        return out

    def _add_backlash(self, spec: Any, name: str, value: float) -> None:
        """A second joint behind a joint, which moves freely within its range."""
        mj, joint = _mujoco(), spec.joint(name)
        model = self.model
        inertia = float(model.dof_M0[model.joint(name).dofadr[0]])
        extra = joint.parent.add_joint(
            name=f"{name}{BACKLASH}",
            type=joint.type,
            axis=joint.axis,
            pos=joint.pos,
            range=[-value, value],
            limited=mj.mjtLimited.mjLIMITED_TRUE,
            armature=float(f"{ARMATURE * inertia:.3g}"),
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
        if spec.compiler.degree and joint.type == mj.mjtJoint.mjJNT_HINGE:
            extra.range = np.degrees([-value, value])

    def _move_keys(self, spec: Any, slack: Sequence[str]) -> None:
        """Keyframes of a specification whose joints have backlash joints behind them."""
        model = self.model
        joints = [model.joint(n) for n in slack]
        qpos = [int(j.qposadr[0]) + 1 for j in joints]
        qvel = [int(j.dofadr[0]) + 1 for j in joints]
        for i, key in enumerate(spec.keys):
            key.qpos = np.insert(model.key_qpos[i], qpos, 0.0)
            key.qvel = np.insert(model.key_qvel[i], qvel, 0.0)

    def __call__(
        self, time: Array, inputs: Mapping[str, Array], parameters: Mapping[str, float]
    ) -> dict[str, Array]:
        with _quiet():
            return self._run(time, inputs, parameters)

    def _run(
        self, time: Array, inputs: Mapping[str, Array], parameters: Mapping[str, float]
    ) -> dict[str, Array]:
        mj = _mujoco()
        model = self.patched(parameters).compile()
        data = mj.MjData(model)
        if self.key:
            mj.mj_resetDataKeyframe(model, data, model.key(self.key).id)
        drives = [(i, inputs[n]) for n, i in _controls(model).items() if n in inputs]
        step = float(model.opt.timestep)

        def step_on(count: int) -> None:
            while count > 0:  # Ctrl-C is heard between the calls
                mj.mj_step(model, data, min(count, STEPS))
                count -= STEPS

        def advance(span: float, j: int) -> None:
            count = max(1, round(span / step))
            if not 0.999 * span < count * step < 1.001 * span:
                count = int(np.ceil(span / step))
            model.opt.timestep = span / count
            for k in range(count if self.hold == "linear" else 1):
                for i, u in drives:
                    rise = (k + 0.5) / count * (u[j + 1] - u[j]) if self.hold == "linear" else 0.0
                    data.ctrl[i] = u[j] + rise
                step_on(1 if self.hold == "linear" else count)

        if self.settle:
            for i, u in drives:
                data.ctrl[i] = u[0]
            step_on(round(self.settle / step))
        seen = np.empty((time.size, model.nq + model.nv + model.nsensordata))
        for j in range(time.size):
            if model.nsensor:
                mj.mj_forward(model, data)
            seen[j] = np.concatenate([data.qpos, data.qvel, data.sensordata])
            if j + 1 < time.size:
                advance(float(time[j + 1] - time[j]), j)
        kinds = (mj.mjtWarning.mjWARN_BADQPOS, mj.mjtWarning.mjWARN_BADQVEL,
                 mj.mjtWarning.mjWARN_BADQACC)  # fmt: skip
        if any(data.warning[int(k)].number for k in kinds):
            seen[:] = np.nan  # unstable: MuJoCo has started again from the reference pose
        return {name: seen[:, at].sum(axis=1) for name, at in _readings(model).items()}


def _silent(_text: str) -> None:
    """Nothing is told: a run that fails is one that returns no numbers."""


def _readings(model: Any) -> dict[str, list[int]]:
    """Outputs by name, as indices in positions, speeds and readings of sensors that are added.

    The position of a joint includes that of its backlash joint.
    """
    found: dict[str, list[int]] = {}
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    drives = _controls(model)
    for name, i in joints.items():
        if model.jnt_type[i] < 2 or (name.endswith(BACKLASH) and name[: -len(BACKLASH)] in joints):
            continue  # a joint with more than one coordinate
        both = [i, *([joints[name + BACKLASH]] if name + BACKLASH in joints else [])]
        found[f"{name}.position"] = [int(model.jnt_qposadr[k]) for k in both]
        found[f"{name}.velocity"] = [model.nq + int(model.jnt_dofadr[k]) for k in both]
        if name not in drives:
            found[name] = found[f"{name}.position"]
    for i in range(model.nsensor):
        at, size = model.nq + model.nv + int(model.sensor_adr[i]), int(model.sensor_dim[i])
        ends = ("",) if size == 1 else tuple(f".{c}" for c in "xyzw"[:size])
        found |= {f"{model.sensor(i).name}{e}": [at + k] for k, e in enumerate(ends)}
    return found


def _controls(model: Any) -> dict[str, int]:
    """Actuators by name, as indices of their controls."""
    each = range(getattr(model, "nactuator", model.nu))
    first = getattr(model, "actuator_ctrladr", each)
    return {name: int(first[i]) for i in each if (name := model.actuator(i).name)}


def _name_actuators(spec: Any) -> None:
    """Name the actuators of a specification that have no name as their joints."""
    mj = _mujoco()
    used = {a.name for a in spec.actuators}
    for a in spec.actuators:
        joint = a.trntype in (mj.mjtTrn.mjTRN_JOINT, mj.mjtTrn.mjTRN_JOINTINPARENT)
        if not a.name and joint and a.target not in used:  # of two at one joint, the first one
            a.name = a.target
            used.add(a.name)


class MujocoModel(Simulator):
    """Result of :func:`mujoco`."""

    mjcf: _Mjcf
    """The function, which makes changed models with ``mjcf.patched``."""

    def matched(self, records: Sequence[Record]) -> Ready:
        """See :class:`~unmodeled.fit.Model`.

        Raises
        ------
        InvalidParameter
            An input of a record is no actuator.
        """
        known = _controls(self.mjcf.model)
        if not any(self._open):
            ready = super().matched(records)
            left = ", ".join(n for n in known if n not in self.inputs)
            note = f"no column is its actuator {left}, which keeps its start value"
            return replace(ready, notes=(*ready.notes, note)) if left else ready
        for r in records if self._open[0] else ():
            if wrong := [n for n in r.inputs if n not in known]:
                raise InvalidParameter(
                    f"model {self.name}: the input {wrong[0]} of record {r.name} is no actuator"
                    f"{near_names(wrong[0], known)}; there are {', '.join(known) or 'none'} "
                    f"(--column ACTUATOR={wrong[0]}, in Python columns of ReadOptions, says which "
                    "it is; inputs= of the model chooses)"
                )
        return super().matched(records)

    @property
    def text(self) -> str:
        """The file as MuJoCo writes it."""
        return str(self.mjcf.spec.to_xml())

    @property
    def suffixes(self) -> tuple[str, ...]:
        """A changed MJCF file, or the numbers."""
        return (".xml", ".toml")

    @checked
    def numbers(
        self, theta: Array, included: Sequence[Candidate], magnitudes: Array
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Properties of the file that change, and effects that MJCF cannot express.

        An input that acts late is the delay of its actuator (MuJoCo 4).
        """
        values, effects = super().numbers(theta, included, magnitudes)
        model = self.mjcf.model
        known = _properties(_mujoco(), model)
        values = {n: v for n, v in values.items() if v != known[n].value}
        for name in _controls(model):
            late = -effects.get(f"delay of input {name}", 0.0)
            if late > 0.0 and hasattr(model, "actuator_delay"):
                values[f"{name}.delay"] = late
                del effects[f"delay of input {name}"]
        return values, effects

    def write(  # noqa: D102
        self,
        path: Path,
        theta: Array,
        included: Sequence[Candidate],
        magnitudes: Array,
        *,
        provenance: str = "",
        force: bool = False,
    ) -> Path:
        # As MuJoCo writes it, without the comments of the file.
        if path.suffix != ".xml":
            return super().write(
                path, theta, included, magnitudes, provenance=provenance, force=force
            )
        self.check_writing(path)
        values, _ = self.numbers(theta, included, magnitudes)
        patched = self.mjcf.patched(values)
        source = self.mjcf.path.absolute().parent
        assets = (*patched.meshes, *patched.textures, *patched.hfields, *patched.skins)
        if assets and path.absolute().parent != source:  # their files stay where they are
            patched.meshdir = (source / patched.meshdir).as_posix()
            patched.texturedir = (source / patched.texturedir).as_posix()
        patched.compile()
        told = f"{provenance}: {', '.join(f'{n} = {v:.6g}' for n, v in values.items())}"
        comment = f"<!-- {told.replace('--', '- -')} -->\n"
        return write_text(path, comment + patched.to_xml(), force=force)


@checked
def mujoco(
    path: str | Path,
    *,
    parameters: Priors = (),
    unknown: Unknowns = None,
    inputs: Sequence[str] | Mapping[str, str] | None = None,
    outputs: Sequence[str] | Mapping[str, str] | None = None,
    bounds: Bounds = None,
    key: str = "",
    settle: float = 0.0,
    hold: Literal["linear", "zero"] = "zero",
    workers: int | None = None,
    name: str = "",
) -> MujocoModel:
    """A MuJoCo model as a model; requires the package ``mujoco``.

    Properties have the names ``JOINT.damping``, ``JOINT.frictionloss``, ``JOINT.armature``,
    ``JOINT.stiffness``, ``JOINT.backlash`` (half of the clearance: a second joint with this range),
    ``ACTUATOR.gain``, ``ACTUATOR.gear`` and ``BODY.mass``.

    Parameters
    ----------
    path
        MJCF or URDF file.
    parameters
        Fitted properties with their priors; the value None is that of the file:
        ``{"hip.damping": (None, 0.1)}``.
    unknown
        Properties that are effects; default: all of every hinge and slide, and gain and gear of
        every servo. (The gain of a motor is that of its input.)
    inputs
        Default: the actuators that the records have.
    outputs
        Sensors, ``SENSOR`` or ``SENSOR.x``, and joints, ``JOINT`` (or ``JOINT.position``) and
        ``JOINT.velocity`` [m or rad, m/s or rad/s]; default: those that the records have. With
        backlash, a joint is both sides together; a sensor of a joint is on the side of the motor.
    bounds
        As for :class:`Simulator`.
    key
        Keyframe at which records start; default: the pose of the file.
    settle
        Time before a record with its first inputs [s].
    hold
        Input between samples: constant, or ``"linear"``.
    workers, name
        As for :class:`Simulator`; default of the name: the name of the file.

    Raises
    ------
    InvalidParameter
        MuJoCo is not installed, the file is not MJCF, or it does not have a property.
    """
    mj = _mujoco()
    path = Path(path).absolute()
    if not is_file(path):
        raise InvalidParameter(f"{path}: there is no such file")
    function = _Mjcf(path, key, settle, hold)
    known = _properties(mj, function.model)
    function.units = {n: v.unit for n, v in known.items()}
    function.values = {n: v.value for n, v in known.items()}
    function.limits = {n: (0.0, np.inf) for n, v in known.items() if v.value >= 0.0}
    listed = [p if isinstance(p, str) else p.name for p in parameters]
    asked = [*listed, *(unknown or {})]
    for n in asked:
        if n not in known:
            raise InvalidParameter(
                f"{path}: has no property {n}{near_names(n, known)}; there are {', '.join(known)}"
            )
    actuators = _controls(function.model)
    if wrong := [n for n in inputs or () if n not in actuators]:
        raise InvalidParameter(
            f"{path}: its input {wrong[0]} is no actuator{near_names(wrong[0], actuators)}; "
            f"there are {', '.join(actuators) or 'none'}"
        )
    if unknown is None:
        chosen = {n: v for n, v in known.items() if n not in listed and v.tested}
        unknown = {n: (v.value, 0.0, v.unit) for n, v in chosen.items()}
    out = MujocoModel(
        function,
        parameters=parameters,
        unknown=unknown,
        inputs=inputs,
        outputs=outputs,
        bounds=bounds,
        workers=workers,
        name=name or path.stem,
    )
    out.mjcf = function
    out._jumps = frozenset(n for n in known if n.endswith(".backlash"))
    out.effects = tuple(
        replace(e, component=e.name.rpartition(".")[0], mechanism=known[e.name].mechanism)
        for e in out.effects
    )
    return out


def _properties(mj: Any, model: Any) -> dict[str, _Property]:
    """Properties of joints, actuators and bodies, with their values in the file."""
    found: dict[str, _Property] = {}
    for i in range(model.njnt):
        name, kind = model.joint(i).name, int(model.jnt_type[i])
        if not name or kind < int(mj.mjtJoint.mjJNT_SLIDE):
            continue
        at = int(model.jnt_dofadr[i])
        values = {
            "damping": model.dof_damping[at],
            "frictionloss": model.dof_frictionloss[at],
            "armature": model.dof_armature[at],
            "stiffness": model.jnt_stiffness[i],
            "backlash": 0.0,
        }
        if i + 1 < model.njnt and model.jnt_bodyid[i + 1] == model.jnt_bodyid[i]:
            del values["backlash"]  # its second joint would be behind the next one
        for what, value in values.items():
            slide, hinge, mechanism = JOINTS[what]
            unit = slide if kind == int(mj.mjtJoint.mjJNT_SLIDE) else hinge
            found[f"{name}.{what}"] = _Property(float(value), unit, mechanism)
    for i in range(getattr(model, "nactuator", model.nu)):
        name, servo = model.actuator(i).name, bool(model.actuator_biastype[i])
        gain, gear = float(model.actuator_gainprm[i, 0]), float(model.actuator_gear[i, 0])
        if name:
            found[f"{name}.gain"] = _Property(gain, "1", "The servo is softer or stiffer.", servo)
            found[f"{name}.gear"] = _Property(gear, "1", "The gear has another ratio.", servo)
    for i in range(1, model.nbody):
        if name := model.body(i).name:
            found[f"{name}.mass"] = _Property(float(model.body_mass[i]), "kg", "", tested=False)
    return found
