"""Runs of a MuJoCo model: fields of copies of the compiled model change, on several threads."""

from __future__ import annotations

import copy
import hashlib
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.data import Array, evenly_spaced
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.fit.mjcf_changes import (
    BACKLASH,
    Property,
    add_backlash,
    controls,
    import_mujoco,
    name_actuators,
    properties,
    quiet,
    set_properties,
)
from unmodeled.fit.mjcf_laws import LAWS, ServoLaws, write_sizes
from unmodeled.fit.mjcf_parts import check_compiled, outside_parts
from unmodeled.fit.mjcf_start import set_starts
from unmodeled.fit.running import KEPT, Latest, Run, cores

#: Steps of MuJoCo between two looks for Ctrl-C, and steps of all runs for which another thread is
#: worth its start.
STEPS, WORTH_A_THREAD = 20_000, 2_000
#: Keyframe of a remedy whose encoders read what those of the file do at its start.
BEFORE = "readings_before"
#: Fields that changes without influence on other fields set.
CHANGED = ("dof_damping", "dof_frictionloss", "jnt_stiffness", "jnt_range", "actuator_gainprm",
           "actuator_biasprm", "actuator_forcerange")  # fmt: skip


class _Structure:
    """A compiled model with some backlash joints, and copies of it for runs."""

    def __init__(self, model: Any):
        self.model = model
        self.readings = _readings(model)
        self.free: list[tuple[Any, Any]] = []

    def copy(self) -> tuple[Any, Any]:
        """A model whose fields may change, and data for it."""
        try:
            return self.free.pop()
        except IndexError:
            model = copy.copy(self.model)
            return model, import_mujoco().MjData(model)


class Player:
    """Steps of one run, from the state of its data."""

    def __init__(self, model: Any, data: Any, stop: threading.Event, laws: ServoLaws | None = None):
        mj = import_mujoco()
        self.model, self.data, self.stop, self.laws = model, data, stop, laws
        self.rollout = mj.rollout.Rollout(nthread=0).rollout
        self.spec = mj.mjtState.mjSTATE_CTRL.value
        full = mj.mjtState.mjSTATE_FULLPHYSICS.value
        self.state = np.empty(mj.mj_stateSize(model, full))
        mj.mj_getState(model, data, self.state, full)
        self.warm: Array | None = None
        self.motions = self.sensors = np.empty((0, 0))
        """Positions and speeds after each step, readings of sensors at its begin."""

    @property
    def motion(self) -> Array:
        """Positions and speeds now."""
        return self.state[1 : 1 + self.model.nq + self.model.nv]

    def play(self, controls: Array, step: float) -> bool:
        """Make steps with the same duration [s]; False: the run is unstable."""
        self.model.opt.timestep = step
        if self.laws:
            return self._step_by_step(self.laws, controls)
        states, sensors, done = [], [], 0
        while done < len(controls):
            if self.stop.is_set():
                raise KeyboardInterrupt
            count = len(controls) - done
            state = np.empty((1, count, self.state.size))
            read = np.empty((1, count, self.model.nsensordata))
            self.rollout(
                [self.model],
                [self.data],
                self.state[None],
                controls[None, done:],
                control_spec=self.spec,
                skip_checks=True,
                nstep=count,
                initial_warmstart=self.warm,
                state=state,
                sensordata=read,
            )
            # A warning ends a rollout: its last rows repeat the state.
            clock = np.diff(state[0, :, 0], prepend=self.state[0])
            made = int(np.argmax(clock <= 0.0)) or len(clock)
            if any(self.data.warning[k].number for k in _bad()):
                return False
            states.append(state[0, :made])
            sensors.append(read[0, :made])
            self.state, self.warm = state[0, made - 1], self.data.qacc_warmstart[None].copy()
            done += made
        found = np.concatenate(states)
        self.motions = found[:, 1 : 1 + self.model.nq + self.model.nv]
        self.sensors = np.concatenate(sensors)
        return True

    def _step_by_step(self, laws: ServoLaws, controls: Array) -> bool:
        """Steps before each of which the laws change the model."""
        mj, model, data, count = import_mujoco(), self.model, self.data, self.motion.size
        full = mj.mjtState.mjSTATE_FULLPHYSICS.value
        states = np.empty((len(controls), self.state.size))
        self.sensors = np.empty((len(controls), model.nsensordata))
        mj.mj_setState(model, data, self.state, full)
        for row, given in enumerate(controls):
            data.ctrl[:] = given
            laws(data)
            mj.mj_step(model, data)
            self.sensors[row] = data.sensordata
            mj.mj_getState(model, data, states[row], full)
        laws.undo()
        if self.stop.is_set():
            raise KeyboardInterrupt
        if any(data.warning[k].number for k in _bad()):
            return False
        self.state, self.motions = states[-1], states[:, 1 : 1 + count]
        return True


def _bad() -> tuple[int, ...]:
    kind = import_mujoco().mjtWarning
    return int(kind.mjWARN_BADQPOS), int(kind.mjWARN_BADQVEL), int(kind.mjWARN_BADQACC)


class Mjcf:
    """Function that runs an MJCF model.

    ``key``, ``settle`` and ``hold`` are those of :func:`~unmodeled.fit.mujoco`.
    """

    def __init__(self, path: Path, key: str, settle: float, hold: str):
        self.path, self.key, self.settle, self.hold = path, key, settle, hold
        self.parts = 1
        """Parts of each time step; more than 1 tells the error of the time step."""
        self.torques: tuple[str, ...] = ()
        """Joints whose torque by all their actuators is an output, ``JOINT.torque``."""
        self.notices: tuple[str, ...] = ()
        """Notes for the user."""
        self._read_file()
        known = self.properties
        # Read by fit.priors.stated: units and values of the numbers, and limits.
        self.units = {n: v.unit for n, v in known.items()}
        self.values = {n: v.value for n, v in known.items()}
        self.limits = {n: (0.0, np.inf) for n, v in known.items() if not v.kind.signed}

    def _read_file(self) -> None:
        outside = outside_parts(self.path)
        if outside:
            names = ", ".join(map(str, outside[:5]))
            more = f" and {len(outside) - 5} more" if len(outside) > 5 else ""
            self.notices = (
                f"reads files outside its folder: {names}{more}; a remedy and a case hold their "
                "content",
            )
        mj = import_mujoco()
        try:
            with quiet():
                self.spec = mj.MjSpec.from_file(str(self.path))
                """The unchanged specification."""
                name_actuators(self.spec)
                self.model = self.spec.compile()
                """The unchanged model."""
        except (ValueError, RuntimeError, MemoryError, mj.FatalError) as error:
            raise InvalidParameter(f"{self.path}: cannot be read as MJCF: {error}") from None
        check_compiled(self.path, self.model)
        self.properties: dict[str, Property] = properties(self.model)
        self.linearized: Latest[Any, Any] = Latest(KEPT // 4, lambda one: one.size)
        """Linearized motions, see ``fit.mjcf_linear``."""
        self._structures: dict[tuple[frozenset[str], frozenset[int]], _Structure] = {}
        keys = [k.name for k in self.spec.keys]
        if self.key and self.key not in keys:
            raise InvalidParameter(
                f"{self.path}: has no keyframe {self.key}{near_names(self.key, keys)}; there are "
                f"{', '.join(keys) or 'none'}"
            )

    @property
    def version(self) -> str:
        """What identifies its results: the compiled model with its meshes, and MuJoCo."""
        mj = import_mujoco()
        whole = np.empty(mj.mj_sizeModel(self.model), np.uint8)
        mj.mj_saveModel(self.model, None, whole)
        own = self.key, self.settle, self.hold, self.parts, self.torques, mj.__version__
        return f"{self.path.name} sha256 {hashlib.sha256(whole.tobytes()).hexdigest()} {own}"

    def __getstate__(self) -> dict[str, Any]:
        left = ("spec", "model", "properties", "linearized", "_structures")
        return {k: v for k, v in vars(self).items() if k not in left}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._read_file()

    # ------------------------------------------------------------------------------------ changes

    def with_torques(self, joints: Sequence[str]) -> Mjcf:
        """The function with the torques of joints among its outputs."""
        out = copy.copy(self)
        out.torques, out._structures, out.linearized = (
            tuple(joints),
            {},
            Latest(KEPT // 4, lambda one: one.size),
        )
        return out

    def changed(self, values: Mapping[str, float]) -> dict[str, float]:
        """Properties that differ from those of the file."""
        known = self.properties  # other names are start states
        return {n: v for n, v in values.items() if n in known and v != known[n].value}

    def patched(self, values: Mapping[str, float]) -> Any:
        """The specification with these values of properties, ``JOINT.damping``; others stay.

        ``values``: also ``ACTUATOR.delay`` [s].
        """
        late = {n: v for n, v in values.items() if n.endswith(".delay")}
        changed = self.changed({n: v for n, v in values.items() if n not in late})
        spec = self.spec.copy()
        for name, value in late.items():
            actuator = spec.actuator(name.removesuffix(".delay"))
            actuator.delay = value
            actuator.nsample = int(np.ceil(value / float(self.model.opt.timestep))) + 2
        add_backlash(spec, self.model, _slack(changed))
        write_sizes(spec, {n: v for n, v in changed.items() if _law(n)})
        try:
            with quiet():
                model = spec.compile()
                pose = model.qpos0.copy()
                set_properties(model, changed, self.properties)
                spec.copy_back(model)
                if any(n.endswith(".zero") for n in changed):  # the same readings as before
                    spec.add_key(name=BEFORE, qpos=pose)
                spec.compile()
        except ValueError as error:
            told = ", ".join(f"{n} = {v:.4g}" for n, v in values.items())
            raise InvalidParameter(f"{self.path}: is no MJCF with {told}: {error}") from None
        return spec

    def laws(self, model: Any, values: Mapping[str, float]) -> ServoLaws:
        """Laws of a run, with the sizes of its values, else of the file."""
        sizes = {n: values.get(n, p.value) for n, p in self.properties.items() if _law(n)}
        return ServoLaws(model, sizes)

    def structure(self, changed: Mapping[str, float]) -> _Structure:
        """The compiled model for changed properties, without what is only seen."""
        slack, bodies = _slack(changed), set()
        for name in changed:
            owner, _, what = name.rpartition(".")
            if what.startswith("offset"):
                bodies.add(int(self.model.joint(owner).bodyid[0]))
            elif self.properties[name].kind.moves:
                bodies.add(int(self.model.body(owner).id))
        # MuJoCo stores the mass matrix of a body whose center is at its joint as a diagonal.
        aside = [b for b in sorted(bodies) if self.model.body_simple[b]]
        key = frozenset(slack), frozenset(aside)
        if key not in self._structures:
            seen = import_mujoco().mjtSensor.mjSENS_RANGEFINDER in self.model.sensor_type
            with quiet():
                try:
                    model = self._compiled(slack, aside, visual=seen)
                except ValueError:  # inertias that are those of visible parts
                    model = self._compiled(slack, aside, visual=True)
            self._structures[key] = _Structure(model)
        return self._structures[key]

    def _compiled(self, slack: Sequence[str], aside: Sequence[int], *, visual: bool) -> Any:
        """The model with backlash joints, with or without the parts that are only seen."""
        spec = self.spec.copy()
        spec.compiler.discardvisual = not visual
        add_backlash(spec, self.model, slack)
        mj = import_mujoco()
        for joint in self.torques:
            kind, of = mj.mjtSensor.mjSENS_JOINTACTFRC, mj.mjtObj.mjOBJ_JOINT
            spec.add_sensor(name=f"{joint}.torque", type=kind, objtype=of, objname=joint)
        for b in aside:
            spec.body(self.model.body(b).name).simple = False
        return spec.compile()

    # --------------------------------------------------------------------------------------- runs

    def __call__(  # noqa: D102
        self, time: Array, inputs: Mapping[str, Array], parameters: Mapping[str, float]
    ) -> dict[str, Array]:
        driven = {n: inputs[n] for n in controls(self.model) if n in inputs}
        (found,) = self.run_all([Run("", time, driven, dict(parameters))])
        return found

    def run_all(self, runs: Sequence[Run], workers: int | None = None) -> list[dict[str, Array]]:
        """Outputs of several runs; they do not depend on the number of threads.

        ``workers``: number of threads; None: number of cores.
        """
        stop = threading.Event()
        changes = [self.changed(run.parameters) for run in runs]
        jobs = [(self.structure(c), r, c, stop) for c, r in zip(changes, runs, strict=True)]
        steps = sum((r.time[-1] - r.time[0]) / self.model.opt.timestep for r in runs)
        count = min(
            workers or cores(), len(jobs) or 1, 1 + int(steps * self.parts / WORTH_A_THREAD)
        )
        with quiet():
            if count == 1:
                return [self._run(*job) for job in jobs]
            with ThreadPoolExecutor(count) as pool:
                waiting = [
                    pool.submit(lambda some: [self._run(*job) for job in some], jobs[k::count])
                    for k in range(count)
                ]
                try:
                    found = [w.result() for w in waiting]
                except BaseException:
                    stop.set()
                    raise
        return [found[i % count][i // count] for i in range(len(jobs))]

    def _run(
        self, structure: _Structure, run: Run, changed: Mapping[str, float], stop: threading.Event
    ) -> dict[str, Array]:
        """Outputs of a run."""
        model, data = prepared(self, structure, run, changed)
        seen = np.empty((run.time.size, model.nq + model.nv + model.nsensordata))
        if not self._play(model, data, run, seen, stop):
            seen[:] = np.nan  # unstable: MuJoCo has started again from the reference pose
        # Properties with influence on other fields leave the copy changed.
        if not any(self.properties[n].kind.inertial for n in changed):
            for field in CHANGED:
                getattr(model, field)[:] = getattr(structure.model, field)
            model.opt.gravity[:] = structure.model.opt.gravity
            structure.free.append((model, data))
        return {name: seen[:, at].sum(axis=1) for name, at in structure.readings.items()}

    def _play(self, model: Any, data: Any, run: Run, seen: Array, stop: threading.Event) -> bool:
        """Fill positions, speeds and readings of sensors at all samples; False: unstable.

        A sample has the inputs of its time: readings are those of the step that begins there.
        """
        player, time = Player(model, data, stop, self.laws(model, run.parameters)), run.time
        base, moving = float(self.model.opt.timestep), model.nq + model.nv
        table = np.repeat(data.ctrl[None], time.size, axis=0)
        for name, column in controls(model).items():
            if name in run.inputs:
                table[:, column] = run.inputs[name]
        count = round(self.settle / base)
        stable = all(
            player.play(np.repeat(table[:1], min(STEPS, count - s), axis=0), base)
            for s in range(0, count, STEPS)
        )
        seen[0, :moving] = player.motion
        for first, intervals, parts, step in self._blocks(time):
            for s in range(0, intervals * parts, STEPS):
                index = np.arange(s, min(s + STEPS, intervals * parts))
                at, part = first + index // parts, index % parts
                held = table[at]
                if self.hold == "linear":
                    held += ((part + 0.5) / parts)[:, None] * (table[at + 1] - held)
                if at[-1] + 2 == time.size and part[-1] + 1 == parts:  # readings at the end
                    held = np.concatenate([held, table[-1:]])
                if not (stable and player.play(held, step)):
                    return False
                ends, begins = np.flatnonzero(part == parts - 1), part == 0
                seen[at[ends] + 1, :moving] = player.motions[ends]
                seen[at[begins], moving:] = player.sensors[: part.size][begins]
        seen[-1, moving:] = player.sensors[-1]
        return True

    def _blocks(self, time: Array) -> Iterator[tuple[int, int, int, float]]:
        """Intervals with equal steps: the first, their number, steps in each, and the step [s]."""
        spans = np.diff(time)
        if evenly_spaced(time):
            spans = np.array([(time[-1] - time[0]) / spans.size])
        for j, span in enumerate(spans):
            count = self.steps(span)
            yield j, time.size - 1 if spans.size == 1 else 1, count, span / count

    def steps(self, span: float) -> int:
        """Number of time steps in an interval [s]; they are not longer than that of the file."""
        base = float(self.model.opt.timestep)
        count = max(1, round(span / base))
        if not 0.999 * span < count * base < 1.001 * span:
            count = int(np.ceil(span / base))
        return count * self.parts


def prepared(
    function: Mjcf, structure: _Structure, run: Run, changed: Mapping[str, float]
) -> tuple[Any, Any]:
    """A model with changed properties, and its data at the start of a run."""
    mj = import_mujoco()
    model, data = structure.copy()
    pose = model.qpos0.copy()
    set_properties(model, changed, function.properties)
    if any(function.properties[n].kind.inertial for n in changed):
        mj.mj_setConst(model, data)
    if function.key:
        mj.mj_resetDataKeyframe(model, data, model.key(function.key).id)
    else:
        mj.mj_resetData(model, data)
        data.qpos[:] = pose  # an encoder with another zero reads the same
    states = {n: v for n, v in run.parameters.items() if n not in function.properties}
    set_starts(model, data, states)
    return model, data


def _law(name: str) -> bool:
    return name.rpartition(".")[2] in LAWS


def _slack(changed: Mapping[str, float]) -> list[str]:
    """Joints with backlash."""
    return [n.removesuffix(".backlash") for n, v in changed.items()
            if n.endswith(".backlash") and v > 0.0]  # fmt: skip


def _readings(model: Any) -> dict[str, list[int]]:
    """Outputs by name, as indices in positions, speeds and readings of sensors that are added.

    The position of a joint includes that of its backlash joint.
    """
    found: dict[str, list[int]] = {}
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    drives = controls(model)
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
