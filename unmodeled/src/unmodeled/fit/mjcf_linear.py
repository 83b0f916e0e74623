"""Derivatives of a MuJoCo run along its motion: one step is linearized, and the steps are chained.

A run for each number is exact and slow: a robot with seven joints has some 180 candidates. Here
numbers of joints and servos, whose forces along the motion follow from their laws, cost a product
of matrices, as a change of an input does. Other numbers cost single steps.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array, evenly_spaced
from unmodeled.fit.mjcf_changes import controls, import_mujoco, quiet
from unmodeled.fit.mjcf_laws import LAWS, ServoLaws
from unmodeled.fit.mjcf_runs import Mjcf, Player, prepared
from unmodeled.fit.priors import LEAST
from unmodeled.fit.running import Run, cores

#: Distance of the points at which steps are linearized [s].
GRID = 0.004
#: Changes of a position or a control, and of a velocity, for derivatives of one step [SI unit].
SMALL, SMALL_RATE = 1e-6, 1e-5
#: Blocks whose changes are computed together, and that are worth a thread.
TOGETHER = 500

#: A force on a degree of freedom in each step, (t,), the readings that show it at once, and what
#: these show, (t,).
Force = tuple[int, Array, list[int], Array]
#: Values of all properties that differ from those of the run, with a weight in the derivative.
Change = Sequence[tuple[Mapping[str, float], float]]


@dataclass(frozen=True, eq=False)
class _Motion:
    """The steps of a run, and the blocks of them that have one linearization."""

    states: Array
    """Positions and velocities before each step, and at the end, (t + 1, 2 nv)."""
    controls: Array
    """(t + 1, nu)"""
    begins: NDArray[np.intp]
    """Step at which each block begins, and the end, (g + 1,)."""
    samples: NDArray[np.intp]
    """Index of the sample that holds at the begin of each block, (g + 1,)."""
    is_sample: NDArray[np.bool_]
    """Whether a sample is there, (g + 1,)."""
    step: float
    """[s]"""


#: Numbers of a joint, and of its servo, that are nothing but a force on it. Dry friction is none:
#: where a joint sticks, more of it does nothing.
OF_JOINTS = ("damping", "stiffness", "armature", *LAWS)
OF_SERVOS = ("kp", "kv", "gain", "gear", "force")


def _servos(model: Any, motion: _Motion, after: int = 1) -> tuple[NDArray[np.intp], Array]:
    """Actuators with a gain and a bias on one joint, and their forces without limits, (t, n).

    ``after``: with the speed after each step, as implicit integrators have it, or before it (0).
    """
    mj = import_mujoco()
    plain = (
        (model.actuator_trntype == int(mj.mjtTrn.mjTRN_JOINT))
        & (model.actuator_gaintype == int(mj.mjtGain.mjGAIN_FIXED))
        & (model.actuator_biastype <= int(mj.mjtBias.mjBIAS_AFFINE))
        & (model.actuator_ctrlnum == 1)
    )
    which = np.flatnonzero(plain)
    at = model.actuator_ctrladr[which]
    low, high = np.where(model.actuator_ctrllimited[which, None], model.actuator_ctrlrange[at],
                         (-np.inf, np.inf)).T  # fmt: skip
    given = np.clip(motion.controls[:-1, at], low, high)
    dof, ratio = model.jnt_dofadr[model.actuator_trnid[which, 0]], model.actuator_gear[which, 0]
    bias = model.actuator_biasprm[which].T
    nv = int(model.nv)
    rates = motion.states[after:][: len(given), nv + dof]
    length, rate = ratio * motion.states[:-1, dof], ratio * rates
    force = model.actuator_gainprm[which, 0] * given + bias[0] + bias[1] * length + bias[2] * rate
    return which, force


def _torques(model: Any, motion: _Motion, laws: ServoLaws) -> Array:
    """Forces of joints and servos along a motion that these numbers change, (t, nv)."""
    nv = int(model.nv)
    ahead = np.diff(motion.states[:, nv:], axis=0) / motion.step
    place, rate = motion.states[:-1, :nv], motion.states[:, nv:]
    out = _driven(model, motion) - model.dof_damping * rate[1:] - model.dof_armature * ahead
    out -= model.jnt_stiffness * (place - model.qpos_spring)
    out += laws.forces(motion.states[:-1], motion.controls[:-1], ahead, motion.step)
    return np.asarray(out)


def _driven(model: Any, motion: _Motion, after: int = 1) -> Array:
    """Forces of servos on the coordinates, (t, nv); ``after``: see :func:`_servos`."""
    which, force = _servos(model, motion, after)
    out = np.zeros((len(force), int(model.nv)))
    limits = np.where(model.actuator_forcelimited[which, None], model.actuator_forcerange[which],
                      (-np.inf, np.inf))  # fmt: skip
    force = model.actuator_gear[which, 0] * np.clip(force, *limits.T)
    np.add.at(out.T, model.jnt_dofadr[model.actuator_trnid[which, 0]], force.T)
    return out


def largest_forces(function: Mjcf, run: Run) -> dict[str, float]:
    """Largest force that each servo of a joint would use in a run without limits [N or N m]."""
    with quiet():
        linear = _linear(function, run)
    if linear is None:
        return {}
    which, force = _servos(linear.model, linear.motion)
    most = np.abs(force).max(axis=0)
    return {linear.model.actuator(int(i)).name: float(v) for i, v in zip(which, most, strict=True)}


def columns_of(
    function: Mjcf,
    run: Run,
    changes: Sequence[Change],
    starts: Sequence[str],
    inputs: Sequence[Mapping[str, Array]],
    outputs: Sequence[str],
) -> Array | None:
    """Derivatives of the outputs, (n, ny, c); None: not for this model or record.

    ``changes``, ``starts`` and ``inputs``: changes of properties that do not change the structure
    of the model, names of start states, and changes of the inputs by name, (n,): in this order.
    """
    structure = function.structure(function.changed(run.parameters))
    model = structure.model
    if model.na or model.nq != model.nv or not evenly_spaced(run.time):
        return None
    with quiet():
        linear = _linear(function, run, GRID if changes or inputs else np.inf)
        if linear is None:
            return None
        along, pushes = dict[int, Force](), dict[int, tuple[Array, Array]]()
        for c, change in enumerate(changes):
            force = linear.force_of(function, run, change)
            if force is None:
                pushes[c] = linear.by_change(function, run, change)
            else:
                along[c] = force
    drives = controls(model)
    driven = np.zeros((run.time.size, model.nu, len(inputs)))
    for c, given in enumerate(inputs):
        for name in given.keys() & drives.keys():
            driven[:, drives[name], c] = given[name]
    if function.hold == "linear":
        driven[:-1] = 0.5 * (driven[:-1] + driven[1:])
    moving = np.zeros((2 * model.nv, len(changes) + len(starts) + len(inputs)))
    for c, name in enumerate(starts, len(changes)):
        moving[_row(model, name), c] = 1.0
    where = [structure.readings[n] for n in outputs]
    with quiet():
        out = linear.chained(moving, pushes, along, driven, where)
    return out if np.isfinite(out).all() else None


def _row(model: Any, name: str) -> int:
    """Row of a start state among positions and velocities."""
    joint, _, kind = name.rpartition(".")
    return int(model.joint(joint).dofadr[0]) + int(model.nv) * (kind == "velocity")


def _linear(function: Mjcf, run: Run, grid: float = GRID) -> _Linear | None:
    """The linearized steps of a run, or of one with nearly the same start; None: it is unstable."""
    own = {n: v for n, v in run.parameters.items() if n in function.properties}
    starts = {n: v for n, v in run.parameters.items() if n not in own}
    key = grid, function.key, function.settle, function.hold, replace(run, parameters=own).key
    found = function.linearized.find(key)
    if found is None or not found.is_near(starts):
        changed = function.changed(own)
        model, data = prepared(function, function.structure(changed), run, changed)
        laws = function.laws(model, own)
        motion = _motion(function, Player(model, data, threading.Event(), laws), run, grid)
        if motion is None:
            return None
        found = _Linear(model, motion, starts, laws)
        function.linearized.keep(key, found)
    return found


class _Linear:
    """Linearized steps of a motion."""

    def __init__(self, model: Any, motion: _Motion, starts: Mapping[str, float], laws: ServoLaws):
        mj = import_mujoco()
        self.model, self.motion, self.starts, nv = model, motion, starts, model.nv
        self.laws = laws
        count = min(cores(), 1 + len(motion.begins) // TOGETHER)
        self.data = [mj.MjData(model) for _ in range(count)]
        self.rollout = mj.rollout.Rollout(nthread=count if count > 1 else 0)
        self.lengths = np.diff(motion.begins)
        at = motion.begins
        self.after, self.sensors = self.steps(model, motion.states[at], motion.controls[at])
        self.by_state, self.seen_by_state = self._differences(
            [SMALL] * nv + [SMALL_RATE] * nv,
            lambda h: self.steps(model, motion.states[at] + h, motion.controls[at]),
        )

    @property
    def size(self) -> int:
        """Number of values that it holds, about."""
        return 8 * int(self.by_state.size)

    def is_near(self, starts: Mapping[str, float]) -> bool:
        """Whether a run with these start states has the same derivatives, as far as it matters."""
        spread = np.ptp(self.motion.states, axis=0)
        if starts.keys() != self.starts.keys():
            return False
        return all(
            abs(v - self.starts[n]) <= LEAST * spread[_row(self.model, n)]
            for n, v in starts.items()
        )

    @cached_property
    def whole(self) -> Array:
        """Derivatives of the states at the ends of blocks by those at the begins."""
        nv = self.model.nv
        out: Array = np.broadcast_to(np.eye(2 * nv), (len(self.lengths), 2 * nv, 2 * nv))
        for i in range(int(self.lengths.max())):
            longer = (i < self.lengths)[:, None, None]
            out = np.where(longer, self.by_state[:-1] @ out, out)
        return out

    @cached_property
    def by_control(self) -> tuple[Array, Array]:
        """Derivatives of one step and of the sensors by the controls, (g + 1, ., nu)."""
        at = self.motion.begins
        states, given = self.motion.states[at], self.motion.controls[at]
        return self._differences(
            [SMALL] * self.model.nu, lambda h: self.steps(self.model, states, given + h)
        )

    @cached_property
    def by_force(self) -> tuple[Array, Array]:
        """Derivatives of one step and of the sensors by forces on the joints, (g + 1, ., nv)."""
        at = self.motion.begins
        states, given = self.motion.states[at], self.motion.controls[at]
        sizes = SMALL_RATE * self.model.dof_M0 / self.motion.step
        return self._differences(sizes, lambda h: self.steps(self.model, states, given, h))

    def _differences(
        self, steps: Sequence[float], moved: Callable[[Array], tuple[Array, Array]]
    ) -> tuple[Array, Array]:
        """Derivatives of states after a step and of sensors before it, (g + 1, ., k)."""
        count = len(steps)
        by = np.zeros((*self.after.shape, count))
        seen_by = np.zeros((*self.sensors.shape, count))
        for k, h in enumerate(steps):
            after, read = moved(h * np.eye(count)[k])
            by[..., k], seen_by[..., k] = (after - self.after) / h, (read - self.sensors) / h
        return by, seen_by

    def steps(
        self, model: Any, states: Array, given: Array, force: Array | None = None
    ) -> tuple[Array, Array]:
        """Positions and velocities after one step from each state, and the sensors before it."""
        mj = import_mujoco()
        size = mj.mj_stateSize(model, mj.mjtState.mjSTATE_FULLPHYSICS.value)
        begin = np.zeros((len(states), size))
        begin[:, 1 : 1 + states.shape[1]] = states
        spec = mj.mjtState.mjSTATE_CTRL.value
        if force is not None or self.laws:
            none = np.zeros((len(states), model.nv))
            acting = self.laws.forces(states, given, none, self.motion.step)
            acting += 0.0 if force is None else force
            given = np.concatenate([given, acting], axis=1)
            spec |= mj.mjtState.mjSTATE_QFRC_APPLIED.value
        after, read = self.rollout.rollout(
            [model], self.data, begin, given[:, None], nstep=1, control_spec=spec
        )
        for data in self.data:
            data.qfrc_applied[:] = 0.0
        return after[:, 0, 1 : 1 + states.shape[1]], read[:, 0]

    def summed(self, pushes: Array) -> Array:
        """What pushes that are constant in a block, (g, 2 nv, k), have done at its end."""
        total = np.zeros_like(pushes)
        for i in range(int(self.lengths.max())):
            longer = (i < self.lengths)[:, None, None]
            total = np.where(longer, self.by_state[:-1] @ total + pushes, total)
        return total

    @cached_property
    def all_steps(self) -> tuple[Array, Array]:
        """Each step of the motion, not only those at the begins of blocks."""
        return self.steps(self.model, self.motion.states, self.motion.controls)

    def force_of(self, function: Mjcf, run: Run, change: Change) -> Force | None:
        """What a change is as a force; None: it is none."""
        for name in {n for values, _ in change for n in values}:
            owner, _, what = name.rpartition(".")
            if what not in OF_JOINTS and not (what in OF_SERVOS and owner in self.servos):
                return None
        total, shown = np.zeros_like(self.torques), np.zeros_like(self.torques)
        for values, weight in change:
            model = self.changed(function, run, values)
            shown += weight * (_driven(model, self.motion, 0) - self.driven)
            laws = function.laws(model, {**run.parameters, **values})
            total += weight * (_torques(model, self.motion, laws) - self.torques)
        dof = int(np.argmax(np.abs(total).max(axis=0)))
        return dof, total[:, dof], self.torque_sensors(dof), shown[:, dof]

    def torque_sensors(self, dof: int) -> list[int]:
        """Readings that are the torque of a joint by its actuators."""
        m, kind = self.model, int(import_mujoco().mjtSensor.mjSENS_JOINTACTFRC)
        return [
            int(m.sensor_adr[i])
            for i in np.flatnonzero(m.sensor_type == kind)
            if int(m.jnt_dofadr[m.sensor_objid[i]]) == dof
        ]

    @cached_property
    def servos(self) -> set[str]:
        """Servos whose numbers are nothing but forces on joints.

        A sensor of forces or of accelerations shows the change of any number at once; what that of
        the torque of a joint shows is this force.
        """
        mj = import_mujoco()
        forces = self.model.sensor_needstage == int(mj.mjtStage.mjSTAGE_ACC)
        if (forces & (self.model.sensor_type != int(mj.mjtSensor.mjSENS_JOINTACTFRC))).any():
            return set()
        return {self.model.actuator(int(i)).name for i in _servos(self.model, self.motion)[0]}

    @cached_property
    def torques(self) -> Array:
        """Forces of the joints and servos along the motion, (t, nv)."""
        return _torques(self.model, self.motion, self.laws)

    @cached_property
    def driven(self) -> Array:
        """What sensors of the torques of joints read, (t, nv)."""
        return _driven(self.model, self.motion, 0)

    def changed(self, function: Mjcf, run: Run, values: Mapping[str, float]) -> Any:
        """The model with other values of properties."""
        own = {**run.parameters, **values}
        structure = function.structure(function.changed(run.parameters))
        changes = function.changed(own)
        model, _ = prepared(function, structure, replace(run, parameters=own), changes)
        model.opt.timestep = self.motion.step
        return model

    def by_change(self, function: Mjcf, run: Run, change: Change) -> tuple[Array, Array]:
        """Derivatives of the states at the ends of blocks and of sensors at their begins.

        (g, 2 nv) and (g + 1, ns). A force that follows the motion is nearly constant in a block; an
        inertia or a servo acts in proportion to what jumps with each new goal.
        """
        motion, at = self.motion, self.motion.begins
        names = {n for values, _ in change for n in values}
        steady = all(function.properties[n].kind.steady for n in names)
        rows = at if steady else np.arange(len(motion.states))
        one, shown = (self.after, self.sensors) if steady else self.all_steps
        pushed, seen = 0.0 * one, 0.0 * shown
        for values, weight in change:
            model = self.changed(function, run, values)
            after, read = self.steps(model, motion.states[rows], motion.controls[rows])
            pushed += weight * (after - one)
            seen += weight * (read - shown)
        if steady:
            return self.summed(pushed[:-1, :, None])[..., 0], seen
        total = np.zeros((len(self.lengths), pushed.shape[1]))
        for i in range(int(self.lengths.max())):
            there = i < self.lengths
            total[there] = (
                np.einsum("gij,gj->gi", self.by_state[:-1][there], total[there])
                + pushed[at[:-1][there] + i]
            )
        return total, seen[at]

    def chained(
        self,
        moving: Array,
        pushes: Mapping[int, tuple[Array, Array]],
        along: Mapping[int, Force],
        driven: Array,
        where: Sequence[Sequence[int]],
    ) -> Array:
        """Derivatives of outputs at the samples, (n, ny, c), from those of the states at the start.

        ``pushes`` and ``along``: what changes do, by their columns; ``driven``: changes of the
        controls, (n, nu, .), of the last columns; ``where``: rows of states and sensors whose sum
        is an output.
        """
        last = moving.shape[1] - driven.shape[2]
        out = np.empty((len(driven), len(where), moving.shape[1]))
        by_inputs = (self.held, self.by_control[1]) if driven.shape[2] else None
        samples, columns = self.motion.samples, [*along, *pushes]
        shown = np.zeros((len(where), self.after.shape[1] + self.sensors.shape[1]))
        for row, parts in zip(shown, where, strict=True):
            row[parts] = 1.0
        moved, read = np.split(shown, [self.after.shape[1]], axis=1)
        seen_moved = moved + read @ self.seen_by_state
        for g, (push, seen) in enumerate(self._pushed([*along.values()], [*pushes.values()])):
            if self.motion.is_sample[g]:
                one = seen_moved[g] @ moving
                one[:, columns] += read @ seen
                if by_inputs is not None:
                    one[:, last:] += read @ by_inputs[1][g] @ driven[samples[g]]
                out[samples[g]] = one
            if g < len(self.lengths):
                moving = self.whole[g] @ moving
                moving[:, columns] += push
                if by_inputs is not None:
                    moving[:, last:] += by_inputs[0][g] @ driven[samples[g]]
        return out

    @cached_property
    def held(self) -> Array:
        """Derivatives of the states at the ends of blocks by controls that are constant in them."""
        return self.summed(self.by_control[0][:-1])

    def _pushed(
        self, along: Sequence[Force], pushes: Sequence[tuple[Array, Array]]
    ) -> Iterator[tuple[Array, Array]]:
        """What changes do to the states at the end of each block, and to the sensors at its begin.

        ``along`` and ``pushes``: by :meth:`force_of` and by :meth:`by_change`.
        """
        begins = self.motion.begins
        values = np.zeros((len(self.motion.states), len(along)))
        readings = np.zeros_like(values)
        for c, (_, force, _, shown) in enumerate(along):
            values[:, c], readings[:, c] = (np.append(y, y[-1]) for y in (force, shown))
        dofs = [dof for dof, *_ in along]
        # At the end nothing is pushed any more.
        ended = [(np.concatenate([p, p[-1:]]), q) for p, q in pushes]
        for first in range(0, len(begins), TOGETHER):
            some = slice(first, first + TOGETHER)
            one, shown = (
                (b[some][..., dofs] for b in self.by_force)
                if dofs
                else (
                    np.zeros((len(begins[some]), b.shape[1], 0)) for b in (self.after, self.sensors)
                )
            )
            shown = shown * values[begins[some], None]
            for c, (_, _, rows, _) in enumerate(along):
                shown[:, rows, c] += readings[begins[some], c, None]
            lengths, total = np.append(self.lengths, 0)[some], np.zeros_like(one)
            for i in range(int(lengths.max())):
                there = np.flatnonzero(i < lengths)
                now = values[begins[some][there] + i, None]
                total[there] = self.by_state[some][there] @ total[there] + one[there] * now
            yield from zip(
                np.concatenate([total, *(p[some, :, None] for p, _ in ended)], axis=2),
                np.concatenate([shown, *(q[some, :, None] for _, q in ended)], axis=2),
                strict=True,
            )


def _motion(function: Mjcf, player: Player, run: Run, grid: float) -> _Motion | None:
    """The steps of a run; None: it is unstable."""
    model, time = player.model, run.time
    table = np.repeat(player.data.ctrl[None], time.size, axis=0)
    for name, column in controls(model).items():
        if name in run.inputs:
            table[:, column] = run.inputs[name]
    base = float(function.model.opt.timestep)
    count = round(function.settle / base)
    if count and not player.play(np.repeat(table[:1], count, axis=0), base):
        return None
    span = float(time[-1] - time[0]) / (time.size - 1)
    steps = function.steps(span)
    parts = min(steps, max(1, round(span / grid)))
    ends = np.round(np.linspace(0, steps, parts + 1)).astype(int)[:-1]
    held = np.repeat(table[:-1], steps, axis=0)
    if function.hold == "linear":
        held += np.tile((np.arange(steps) + 0.5) / steps, time.size - 1)[:, None] * np.repeat(
            np.diff(table, axis=0), steps, axis=0
        )
    begin = player.motion.copy()
    if not player.play(held, span / steps):
        return None
    sample = np.arange(time.size - 1)
    last = (time.size - 1) * steps
    begins = np.append((sample[:, None] * steps + ends).ravel(), last)
    model.opt.timestep = span / steps
    return _Motion(
        states=np.vstack([begin, player.motions]),
        controls=np.vstack([held, table[-1:]]),
        begins=begins,
        samples=np.append(np.repeat(sample, parts), time.size - 1),
        is_sample=begins % steps == 0,
        step=span / steps,
    )
