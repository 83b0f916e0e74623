"""A MuJoCo model (MJCF) as a simulator: its joints and actuators have parameters and effects."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, near_names, shortened, which_column
from unmodeled.files import check_suffix, write_text
from unmodeled.fit.mjcf_changes import controls, followed, joints_of, place_of_payload, probe
from unmodeled.fit.mjcf_laws import LAWS
from unmodeled.fit.mjcf_linear import columns_of, largest_forces
from unmodeled.fit.mjcf_parts import outside_parts
from unmodeled.fit.mjcf_runs import Mjcf
from unmodeled.fit.mjcf_start import (
    POSITION,
    VELOCITY,
    begun_records,
    measured_joints,
    nearest,
    poses,
    scale_of,
    starts_of,
    unit_of_start,
)
from unmodeled.fit.priors import (
    MOST,
    TRIALS,
    Bounds,
    Priors,
    Unknowns,
    share_of,
    sized,
    wanted_change,
)
from unmodeled.fit.running import Run
from unmodeled.fit.simulator import Simulator, match_simulator, numbers_of_simulator
from unmodeled.models.influence import Influence, influences
from unmodeled.models.matching import matched
from unmodeled.models.model import (
    Candidate,
    Effect,
    Origin,
    Ready,
    Sensitivity,
    SensitivityRequest,
    State,
    difference_sensitivities,
    start_in,
)
from unmodeled.models.writing import numbers, suffixes, text, write, write_numbers

#: Share of the noise of a sensor, or of the spread of an output without stated noise, above which
#: the error of the time step is told.
STEP_ERROR, OF_SPREAD = 0.3, 0.01
#: What to do about a law that MJCF cannot express.
SERVO_LAWS = "The remedy holds it as a number, which unmodeled.servo_laws applies before each step."
#: Derivatives by fewer numbers, or by fewer start states, are faster by runs.
FEW = 3
#: Samples after which the influence of the starts may have faded, and the share of it that is none.
BEGINNINGS, FADED = (30, 100, 300), 1e-3


#: What a number follows, and which motions show it.
SPEED = "the speed", "motions at several constant speeds"
GOAL = "the distance from the goal", "rests in several poses under load"
GRAVITY = "gravity and acceleration", "the same motion in several poses"
INFLUENCES = {
    "damping": SPEED, "kv": SPEED, "kp": GOAL, "gear": GOAL, "gain": GOAL,
    "frictionloss": ("the direction of the motion", "slow motions that reverse"),
    "armature": ("the acceleration", "fast starts and stops"),
    "stiffness": ("the position", "rests at several places"),
}  # fmt: skip


class MujocoModel(Simulator):
    """Result of :func:`mujoco`."""

    mjcf: Mjcf
    """The function, which makes changed models with ``mjcf.patched``."""
    _tested = False
    _starts: tuple[State, ...] = ()
    _faded: dict[str, int]
    """Samples after which the starts of a record had no influence."""

    def ready(self, records: Sequence[Record]) -> Ready:
        """See :class:`~unmodeled.fit.Model`: starts and the error of the time step are notes."""
        if self._ready or any(self.open):
            return super().ready(records)
        names = {n for r in records for n in r.outputs}
        joints = measured_joints(self.mjcf.model, [n for n in self.outputs if n in names])
        model = self
        if joints and not (self.mjcf.key or self.mjcf.settle):
            known = poses(self.mjcf.model, [j + k for j in joints for k in (POSITION, VELOCITY)])
            key = nearest([starts_of(r, joints) for r in records], known)
            model = self._in_pose(known, joints, records, key)
        ready = super(MujocoModel, model).ready(records)
        return replace(ready, notes=(*ready.notes, *model._time_step(ready.records[0])))

    def _begun(self, records: Sequence[Record]) -> tuple[Sequence[Record], list[str]]:
        if not self._starts:
            return records, []
        joints = measured_joints(self.mjcf.model, [n for r in records for n in r.outputs])
        measured = [starts_of(r, joints) for r in records]
        begun, moved = begun_records(self, records, joints, measured)
        return begun, self._told(moved, joints)

    def _sized(self, records: Sequence[Record]) -> tuple[tuple[Effect, ...], list[str]]:
        """Sizes follow from the derivatives along the motion, without trials."""
        record, _, unit, goal = wanted_change(self, records)
        known, run = self.mjcf.properties, self._tabulated_run(record)
        found = self._by_probes(run, sorted(self._unsized))
        if found is None:
            return super()._sized(records)
        sizes = {n: _expected(goal, share_of(by, unit), known[n].unit) for n, by in found.items()}
        joints = measured_joints(self.mjcf.model, self.outputs)
        shown = dict(zip(self.outputs, goal * unit, strict=True))
        used = largest_forces(self.mjcf, run)
        for name in sorted(self._unsized):
            owner, _, what = name.rpartition(".")
            if what == "backlash" and owner in joints:  # its clearance is what the joint shows
                sizes[name] = shown[joints[owner][POSITION]]
            elif what == "force" and owner in used:
                limit = known[name].value
                sizes[name] = limit - (1.0 - MOST) * min(used[owner], limit)
        sizes = {n: float(f"{min(v, self._largest(n)):.2g}") for n, v in sizes.items()}
        told = ", ".join(f"{n} {v:g} {known[n].unit}" for n, v in sizes.items())
        notes = [f"expected sizes, from their influence on record {record.name}: {told}"]
        effects = tuple(
            replace(e, scale=sizes[e.name], sign=self._side(e, used)) if e.name in sizes else e
            for e in self.effects
        )
        others, more = sized(self, effects, self._unsized - sizes.keys(), records)
        return others, [*(notes if told else []), *more]

    def _tabulated_run(self, record: Record) -> Run:
        return self._run(record, self._point([p.value for p in self.parameters]))

    def _by_probes(self, run: Run, names: Iterable[str]) -> dict[str, Array] | None:
        """Derivatives along a motion by properties, (n, ny); None: not for this model or record."""
        known = self.mjcf.properties
        values = {n: run.parameters.get(n, known[n].value) for n in names}
        steps = {n: v for n in values if (v := probe(self.mjcf.model, n, known[n].value))}
        changes = [[({n: values[n] + v}, 1.0 / v)] for n, v in steps.items()]
        found = columns_of(self.mjcf, run, changes, (), (), self.outputs)
        return None if found is None else dict(zip(steps, np.moveaxis(found, 2, 0), strict=True))

    def _largest(self, name: str) -> float:
        """Largest expected size: a stiff servo hides changes that no robot has."""
        owner, _, what = name.rpartition(".")
        value = abs(self.mjcf.properties[name].value)
        if owner == "gravity":
            return MOST
        if what == "payload":
            return float(self.mjcf.model.body_subtreemass[0])
        if what in ("kp", "kv", "gear", "gain", "force"):
            return value or np.inf
        return TRIALS * value or np.inf

    def _side(self, effect: Effect, used: Mapping[str, float]) -> Literal[-1, 0, 1]:
        """Sign of a change: of a largest force that is not reached, only a smaller one shows."""
        owner, _, what = effect.name.rpartition(".")
        unseen = (
            what == "force" and used.get(owner, np.inf) < self.mjcf.properties[effect.name].value
        )
        return -1 if unseen else effect.sign

    def _in_pose(
        self,
        known: Mapping[str, Mapping[str, float]],
        joints: Mapping[str, Mapping[str, str]],
        records: Sequence[Record],
        key: str,
    ) -> MujocoModel:
        """The model whose runs start in a keyframe, unless a record states another start."""
        out = copy.copy(self)
        out.mjcf = out.function = copy.copy(self.mjcf)
        out.mjcf.key = key
        out._runner, out._faded = out.new_runner(), {}
        out._starts = tuple(
            State(
                name=name,
                unit=unit_of_start(self.mjcf.model, name),
                scale=scale_of(records, joints, name),
                start=at,
                start_sd=0.0,
            )
            for name, at in known[key].items()
        )
        return out

    def _told(self, moved: Sequence[str], joints: Iterable[str]) -> list[str]:
        """A note about the starts. ``moved``: records that do not start in the pose."""
        pose = f"keyframe {self.mjcf.key}" if self.mjcf.key else "the pose of the file"
        if not moved:
            return [f"its runs start in {pose}"] if self.mjcf.key else []
        return [
            f"{shortened(', '.join(moved), 100)} starts where its first samples are, position and "
            f"rate of {', '.join(joints)}; all else as in {pose}"
        ]

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """Positions and rates of the measured joints at the start of a run."""
        del included
        return self._starts

    def _run(self, record: Record, values: dict[str, float], start: Array | None = None) -> Run:
        x = [start_in(s, record)[0] for s in self._starts] if start is None else start
        states = {s.name: float(v) for s, v in zip(self._starts, x, strict=True)}
        return Run.of(record, self.inputs, {**values, **states})

    def _time_step(self, record: Record) -> Iterator[str]:
        """Notes about the steps of runs, and their error: the change by steps of half the size."""
        own, interval = float(self.mjcf.model.opt.timestep), float(np.median(np.diff(record.time)))
        step = interval / self.mjcf.steps(interval)
        if not 0.999 * own < step < 1.001 * own:
            yield (
                f"model {self.name}: its time step of {own:g} s is {step:.4g} s in record "
                f"{record.name}, whose samples are {interval:.4g} s apart"
            )
        run = self._run(record, self._point([p.value for p in self.parameters]))
        smaller = copy.copy(self.mjcf)
        smaller.parts = 2
        (one,) = self._runner.values([run])
        (half,) = smaller.run_all([run])
        found = []
        for name, own_values in zip(self.outputs, one.T, strict=True):
            sensor = record.sensors.get(name)
            sigma = sensor.sigma if sensor is not None else None
            error = float(np.sqrt(np.mean((own_values - half[name]) ** 2)))
            if not error <= (STEP_ERROR * sigma if sigma else OF_SPREAD * np.std(own_values)):
                beside = f", {error / sigma:.2g} times its noise" if sigma else ""
                found.append(f"{name} by {error:.2g} (rms{beside})")
        if found:
            yield (
                f"model {self.name}: half its time step changes {', '.join(found)}: {step:.4g} s "
                "is a long step, whose error may be taken for a cause"
            )

    def sensitivities(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """See :class:`~unmodeled.fit.Model`: rough ones along the motion, others by runs."""
        for request in requests:
            request.check(self)
        found = {i: s for i, r in enumerate(requests) if (s := self._along(r)) is not None}
        left = [i for i in range(len(requests)) if i not in found]
        starts = {i: by for i in left if (by := self._by_starts(requests[i])) is not None}
        fewer = [replace(requests[i], by_starts=i not in starts) for i in left]
        for i, s in zip(left, difference_sensitivities(self, fewer), strict=True):
            found[i] = replace(s, d_starts=starts[i]) if i in starts else s
        return [found[i] for i in range(len(requests))]

    def _by_starts(self, request: SensitivityRequest) -> Array | None:
        """Derivatives by the start states along the motion: there are many, and they fade."""
        free = [start_in(s, request.record)[1] > 0.0 for s in self._starts]
        if not request.by_starts or sum(free) < FEW:
            return None
        values = self._values(np.concatenate([request.theta, request.sizes]), request.included)
        names, count = [s.name for s in self._starts], request.record.samples
        out = np.zeros((count, len(self.outputs), len(names)))
        before = self._faded.get(request.record.name, 0)
        for end in (*(n for n in BEGINNINGS if before <= n < count), count):
            run = self._run(request.record.cut(0, end), values, request.start)
            found = columns_of(self.mjcf, run, (), names, (), self.outputs)
            if found is None:
                return None
            self._faded[request.record.name] = end
            if np.abs(found[-1]).max() < FADED * np.abs(found).max():
                break
        out[:end] = found
        return out

    def _along(self, request: SensitivityRequest) -> Sensitivity | None:
        """Derivatives along the motion; None: they are to be those of runs."""
        if not request.rough or request.shape_changes:
            return None
        point = np.concatenate([request.theta, request.sizes])
        values = self._values(point, request.included)
        base = self.mjcf.structure(self.mjcf.changed(values))
        by_runs, changes, places = [], [], []

        def add(name: str, offsets: Sequence[tuple[float, float]]) -> bool:
            """Whether the structure of the model stays."""
            moved = [({name: values[name] + o}, w) for o, w in offsets]
            own = [self.mjcf.structure(self.mjcf.changed({**values, **m})) for m, _ in moved]
            if any(s is not base for s in own):
                return False
            changes.append(moved)
            return True

        for i in request.parameters_of(self):
            if not add(self.parameters[i].name, self._offsets(self.parameters[i], point[i])):
                return None
        for c, size in zip(request.included, request.sizes, strict=True):
            if not add(str(c.effect.data), self._offsets(c.effect, float(size))):
                return None
        first = len(changes)
        for k, c in enumerate(request.candidates):
            if add(str(c.effect.data), self._offsets(c.effect, 0.0)):
                places.append(k)
            else:
                by_runs.append(k)
        starts = [s.name for s in self._starts] if request.by_starts else []
        if len(changes) + len(request.input_changes) < FEW:
            return None
        run = self._run(request.record, values, request.start)
        found = columns_of(self.mjcf, run, changes, starts, request.input_changes, self.outputs)
        if found is None:
            return None
        (outputs,) = self._runner.values([run])
        by_candidate = np.zeros((*outputs.shape, len(request.candidates)))
        own = len(request.parameters_of(self)), first, len(changes), len(changes) + len(starts)
        by_candidate[..., places] = found[..., own[1] : own[2]]
        if by_runs:
            some = replace(
                request,
                by_theta=(),
                by_starts=False,
                candidates=tuple(request.candidates[k] for k in by_runs),
                input_changes=(),
            )
            by_candidate[..., by_runs] = difference_sensitivities(self, [some])[0].d_candidates
        return Sensitivity(
            outputs=outputs,
            d_theta=found[..., : own[0]],
            d_magnitudes=found[..., own[0] : own[1]],
            d_starts=found[..., own[2] : own[3]],
            d_candidates=by_candidate,
            d_inputs=found[..., own[3] :],
        )


@matched.register
def _(model: MujocoModel, records: Sequence[Record]) -> Ready:
    """The actuators of the model are its inputs.

    Raises
    ------
    InvalidParameter
        An input of a record is no actuator.
    """
    known, shown = controls(model.mjcf.model), {n for r in records for n in r.outputs}
    joints = [j.name for j in joints_of(model.mjcf.model) if f"{j.name}.torque" in shown]
    if joints and not model.mjcf.torques:
        model = copy.copy(model)
        model.mjcf = model.function = model.mjcf.with_torques(joints)
        model._runner = model.new_runner()
    if not any(model.open):
        ready = match_simulator(model, records)
        left = ", ".join(n for n in known if n not in model.inputs)
        note = f"no column is its actuator {left}, which keeps its start value"
        return replace(ready, notes=(*ready.notes, note)) if left else ready
    for r in records if model.open[0] else ():
        if wrong := [n for n in r.inputs if n not in known]:
            raise InvalidParameter(
                f"model {model.name}: the input {wrong[0]} of record {r.name} is no actuator"
                f"{near_names(wrong[0], known)}; there are {', '.join(known) or 'none'} "
                f"({which_column('ACTUATOR', wrong[0])}; inputs= of the model chooses)"
            )
    return match_simulator(model, records)


@influences.register
def _(model: MujocoModel, record: Record) -> Sequence[Influence]:
    """Numbers of joints, servos and payloads."""
    tested = [n for n, p in model.mjcf.properties.items() if p.tested]
    found = model._by_probes(model._tabulated_run(record), tested) or {}
    kinds = {n: INFLUENCES.get(n.rpartition(".")[2], GRAVITY) for n in found}
    return [Influence(n, by, *kinds[n]) for n, by in found.items()]


@text.register
def _(model: MujocoModel) -> str:
    return str(model.mjcf.spec.to_xml())


@suffixes.register
def _(model: MujocoModel) -> tuple[str, ...]:
    del model
    return (".xml", ".toml")


@numbers.register
def _(
    model: MujocoModel, theta: Array, included: Sequence[Candidate], magnitudes: Array
) -> tuple[dict[str, float], dict[str, float]]:
    """Properties of the file that change, and effects that MJCF cannot express.

    An input that acts late is the delay of its actuator.
    """
    values, effects = numbers_of_simulator(model, theta, included, magnitudes)
    known = model.mjcf.properties
    values = {n: v for n, v in values.items() if v != known[n].value}
    for name in controls(model.mjcf.model):
        late = -effects.pop(f"delay of input {name}", 0.0) - effects.get("delay of all inputs", 0.0)
        if late > 0.0:
            values[f"{name}.delay"] = late
    effects.pop("delay of all inputs", None)
    return values, effects


@write.register
def _(
    model: MujocoModel,
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
        return write_numbers(
            model, path, theta, included, magnitudes, provenance=provenance, force=force
        )
    check_suffix(path, *suffixes(model))
    values, _ = numbers(model, theta, included, magnitudes)
    patched = model.mjcf.patched(values)
    source = model.mjcf.path.absolute().parent
    outside = ", ".join(os.path.relpath(p, source) for p in outside_parts(model.mjcf.path))
    assets = (*patched.meshes, *patched.textures, *patched.hfields, *patched.skins)
    if assets and path.absolute().parent != source:  # their files stay where they are
        patched.meshdir = (source / patched.meshdir).as_posix()
        patched.texturedir = (source / patched.texturedir).as_posix()
    told = f"{provenance}: {', '.join(f'{n} = {v:.6g}' for n, v in values.items())}"
    told += f"; holds what is in {outside}" if outside else ""
    if any(n.rpartition(".")[2] in LAWS for n in values):
        told += "; its custom numbers act by unmodeled.servo_laws(model)(data) before each step"
    comment = f"<!-- {told.replace('--', '- -')} -->\n"
    return write_text(path, comment + patched.to_xml(), force=force)


def _expected(goal: float, share: float, unit: str) -> float:
    """Expected size by the influence of one unit: of an angle at most one, which is much."""
    size = goal / share if share else 0.1
    return min(size, 1.0) if unit == "rad" else size


def _placed(effect: Effect, function: Mjcf) -> Effect:
    """An effect with its component and its mechanism; a payload with its place."""
    owner, _, what = effect.name.rpartition(".")
    kind = function.properties[effect.name].kind
    mechanism = kind.mechanism
    if what == "payload":
        mechanism = f"A mass is attached {place_of_payload(function.model, owner)}."
    new = function.properties[effect.name].value == 0.0 and not kind.noun.startswith("the ")
    what = kind.noun.removeprefix("the ").removeprefix("a ")
    label = kind.noun if new else f"the {what} of {owner}"
    remedy = SERVO_LAWS if effect.name.rpartition(".")[2] in LAWS else ""
    return replace(effect, component=owner, mechanism=mechanism, label=label, remedy=remedy)


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

    Properties are numbers of the compiled model, with these names and units (of a slide, of a
    hinge):

    ``JOINT.damping``, ``.frictionloss``, ``.armature``, ``.stiffness``
        As in MJCF.
    ``JOINT.backlash``
        Half of the clearance [m, rad]: a second joint with this range. Not for a joint that is
        followed by another one of its body.
    ``JOINT.zero``
        Reading of the encoder in the pose of the file (``ref``) [m, rad]: servo and reading shift
        together.
    ``JOINT.load_friction``, ``.one_sided_friction``
        Dry friction in proportion to the force of the servo [1], and friction that is larger in one
        direction and smaller in the other by this [N, N m]. MJCF has no word for these, for
        ``dead_band`` and for ``speed_loss``: see :func:`servo_laws`.
    ``JOINT.offset_x``, ``_y``, ``_z``
        Place of the axis in the frame of its body [m].
    ``ACTUATOR.kp``, ``.kv``, ``.gain``, ``.gear``, ``.force``
        Stiffness and damping of a servo, gain of another actuator, ratio of the gear, and limit of
        the force, if the file has the same on both sides.
    ``ACTUATOR.dead_band``, ``.speed_loss``
        Error up to which a servo of position makes no force [m, rad]; share of the largest force
        that is lost by the speed [s/m, s/rad], the reciprocal of the speed without load.
    ``BODY.mass``
        Mass [kg], with the inertia in proportion.
    ``BODY.center_x``, ..., ``BODY.inertia_x``, ...
        Center of mass [m] and principal inertias [kg m^2].
    ``BODY.payload``, ``BODY.payload_x``, ...
        Attached point mass [kg], and its place in the frame of the body [m]; without a place it is
        at the center of mass.
    ``BODY.length``, ``.pos_x``, ..., ``.turn_x``, ...
        Distance and place of its mount on a moving body, and rotation about its own axes
        [m, m, rad].
    ``SITE.payload``
        Attached point mass [kg] at the place of a site.
    ``gravity.tilt_x``, ``gravity.tilt_y``
        Rotation of the gravity about an axis of the world [rad].

    Parameters
    ----------
    path
        MJCF or URDF file.
    parameters
        Fitted properties with their priors; the value None is that of the file:
        ``{"hip.damping": (None, 0.1)}``.
    unknown
        Properties that are effects; default: damping, friction, armature, stiffness and backlash
        of every hinge and slide, all of every servo, payloads of the outermost bodies, welded ones
        included, masses of the other moving bodies, the tilt of the gravity, and the mounts of
        bodies that carry what a sensor of a frame tracks. (The gain of a motor is that of its
        input.)
    inputs
        Default: the actuators that the records have.
    outputs
        Sensors, ``SENSOR`` or ``SENSOR.x``, and joints, ``JOINT`` (or ``JOINT.position``) and
        ``JOINT.velocity`` [m or rad, m/s or rad/s]; default: those that the records have. With
        backlash, a joint is both sides together; a sensor of a joint is on the side of the motor.
    bounds
        As for :class:`Simulator`.
    key
        Keyframe at which records start. Default: each measured joint starts with the position and
        the rate of its first samples, within their noise, and the others as in the keyframe (or in
        the pose of the file) that is nearest to these positions.
    settle
        Time before a record with its first inputs [s]; the run starts before it in the keyframe
        or in the pose of the file.
    hold
        Input between samples: constant, or ``"linear"``.
    workers
        Number of threads; default: number of cores.
    name
        As for :class:`Simulator`; default: the name of the file.

    Raises
    ------
    InvalidParameter
        MuJoCo is not installed, the file is not MJCF, or it does not have a property, an actuator
        or a keyframe of this name.
    """
    path = Path(path).absolute()
    again = {"unknown": unknown, "inputs": inputs, "outputs": outputs, "bounds": bounds}
    how = {"key": key, "settle": settle, "hold": hold, "name": name}
    function = Mjcf(path, key, settle, hold)
    known = function.properties
    listed = [p if isinstance(p, str) else p.name for p in parameters]
    asked = [*listed, *(unknown or {})]
    for n in asked:
        if n not in known:
            raise InvalidParameter(
                f"{path}: has no property {n}{near_names(n, known)}; there are {', '.join(known)}"
            )
    actuators = controls(function.model)
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
    out.joints = joints_of(function.model)
    out.follows = followed(function.model)
    out.origin = Origin("mujoco", str(path), {**again, **how})
    out._jumps = frozenset(n for n, p in known.items() if p.kind.jumps)
    out.effects = tuple(_placed(e, function) for e in out.effects)
    return out
