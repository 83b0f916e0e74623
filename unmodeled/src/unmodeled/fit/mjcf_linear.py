"""Derivatives of a MuJoCo run along its motion: one step is linearized, and the steps are chained.

A run for each number is exact and slow: a robot with seven joints has some 180 candidates. Here
each number costs single steps at some hundred points of the motion, and each change of an input
costs nothing but a product of matrices.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array, evenly_spaced
from unmodeled.fit.mjcf_changes import controls, import_mujoco, quiet
from unmodeled.fit.mjcf_runs import Mjcf, Player, prepared
from unmodeled.fit.running import Run, cores

#: Distance of the points at which steps are linearized [s].
GRID = 0.004
#: Changes of a position or a control, and of a velocity, for derivatives of one step [SI unit].
SMALL, SMALL_RATE = 1e-6, 1e-5

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
    base = function.changed(run.parameters)
    structure = function.structure(base)
    model = structure.model
    if model.na or model.nq != model.nv or not evenly_spaced(run.time):
        return None
    with quiet():
        model, data = prepared(function, structure, run, base)
        motion = _motion(function, model, data, run)
        if motion is None:
            return None
        linear = _Linear(model, motion, driven=bool(inputs))
        pushes = [linear.by_change(function, run, change) for change in changes]
    drives = controls(model)
    driven = np.zeros((run.time.size, model.nu, len(inputs)))
    for c, given in enumerate(inputs):
        for name in given.keys() & drives.keys():
            driven[:, drives[name], c] = given[name]
    if function.hold == "linear":
        driven[:-1] = 0.5 * (driven[:-1] + driven[1:])
    moving = np.zeros((2 * model.nv, len(changes) + len(starts) + len(inputs)))
    for c, name in enumerate(starts, len(changes)):
        joint, _, kind = name.rpartition(".")
        moving[int(model.joint(joint).dofadr[0]) + model.nv * (kind == "velocity"), c] = 1.0
    where = [structure.readings[n] for n in outputs]
    out = linear.chained(moving, pushes, driven, where)
    return out if np.isfinite(out).all() else None


class _Linear:
    """Linearized steps of a motion."""

    def __init__(self, model: Any, motion: _Motion, *, driven: bool):
        mj = import_mujoco()
        self.motion, nv = motion, model.nv
        count = min(cores(), 1 + len(motion.begins) // 500)
        self.data = [mj.MjData(model) for _ in range(count)]
        self.rollout = mj.rollout.Rollout(nthread=count if count > 1 else 0)
        self.size = mj.mj_stateSize(model, mj.mjtState.mjSTATE_FULLPHYSICS.value)
        self.lengths = np.diff(motion.begins)
        states, given = motion.states, motion.controls
        self.after, self.sensors = self.steps(model, states, given)
        at = motion.begins
        one, seen = self.after[at], self.sensors[at]
        self.by_state, self.seen_by_state = self._differences(
            (2 * nv, [SMALL] * nv + [SMALL_RATE] * nv),
            one, seen, lambda h: self.steps(model, states[at] + h, given[at]),
        )  # fmt: skip
        by_control, self.seen_by_control = self._differences(
            (model.nu, [SMALL] * model.nu * driven),
            one, seen, lambda h: self.steps(model, states[at], given[at] + h),
        )  # fmt: skip
        self.by_control = self.summed(by_control[:-1])
        self.whole = np.broadcast_to(np.eye(2 * nv), (len(at) - 1, 2 * nv, 2 * nv))
        for i in range(int(self.lengths.max())):
            longer = (i < self.lengths)[:, None, None]
            self.whole = np.where(longer, self.by_state[:-1] @ self.whole, self.whole)

    def _differences(
        self,
        sizes: tuple[int, Sequence[float]],
        one: Array,
        seen: Array,
        moved: Callable[[Array], tuple[Array, Array]],
    ) -> tuple[Array, Array]:
        """Derivatives of states after a step and of sensors before it, (g + 1, ., k)."""
        count, steps = sizes
        by = np.zeros((*one.shape, count))
        seen_by = np.zeros((*seen.shape, count))
        for k, h in enumerate(steps):
            after, read = moved(h * np.eye(count)[k])
            by[..., k], seen_by[..., k] = (after - one) / h, (read - seen) / h
        return by, seen_by

    def steps(self, model: Any, states: Array, given: Array) -> tuple[Array, Array]:
        """Positions and velocities after one step from each state, and the sensors before it."""
        begin = np.zeros((len(states), self.size))
        begin[:, 1 : 1 + states.shape[1]] = states
        after, read = self.rollout.rollout([model], self.data, begin, given[:, None], nstep=1)
        return after[:, 0, 1 : 1 + states.shape[1]], read[:, 0]

    def summed(self, pushes: Array) -> Array:
        """What pushes that are constant in a block, (g, 2 nv, k), have done at its end."""
        total = np.zeros_like(pushes)
        for i in range(int(self.lengths.max())):
            longer = (i < self.lengths)[:, None, None]
            total = np.where(longer, self.by_state[:-1] @ total + pushes, total)
        return total

    def by_change(self, function: Mjcf, run: Run, change: Change) -> tuple[Array, Array]:
        """Derivatives of the states at the ends of blocks and of sensors at their begins.

        (g, 2 nv) and (g + 1, ns). A force that follows the motion is nearly constant in a block; an
        inertia or a servo acts in proportion to what jumps with each new goal.
        """
        motion, at = self.motion, self.motion.begins
        names = {n for values, _ in change for n in values}
        steady = all(function.properties[n].kind.steady for n in names)
        rows = at if steady else np.arange(len(motion.states))
        pushed, seen = 0.0 * self.after[rows], 0.0 * self.sensors[rows]
        base = function.changed(run.parameters)
        for values, weight in change:
            own = {**run.parameters, **values}
            changed = function.changed(own)
            model, _ = prepared(function, function.structure(base), replace(run, parameters=own),
                                changed)  # fmt: skip
            model.opt.timestep = motion.step
            after, read = self.steps(model, motion.states[rows], motion.controls[rows])
            pushed += weight * (after - self.after[rows])
            seen += weight * (read - self.sensors[rows])
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
        pushes: Sequence[tuple[Array, Array]],
        driven: Array,
        where: Sequence[Sequence[int]],
    ) -> Array:
        """Derivatives of outputs at the samples, (n, ny, c), from those of the states at the start.

        ``driven``: changes of the controls, (n, nu, .), of the last columns; ``where``: rows of
        states and sensors whose sum is an output.
        """
        motion, count = self.motion, len(pushes)
        push = np.array([p for p, _ in pushes]) if pushes else np.zeros((0, len(self.lengths), 1))
        seen = np.array([s for _, s in pushes]) if pushes else np.zeros((0, len(motion.begins), 1))
        last = moving.shape[1] - driven.shape[2]
        out = np.empty((driven.shape[0], len(where), moving.shape[1]))
        for g, j in enumerate(motion.samples):
            if motion.is_sample[g]:
                read = self.seen_by_state[g] @ moving
                read[:, :count] += seen[:, g].T if count else 0.0
                read[:, last:] += self.seen_by_control[g] @ driven[j]
                both = np.concatenate([moving, read])
                out[j] = [both[rows].sum(axis=0) for rows in where]
            if g < len(self.lengths):
                moving = self.whole[g] @ moving
                if count:
                    moving[:, :count] += push[:, g].T
                moving[:, last:] += self.by_control[g] @ driven[j]
        return out


def _motion(function: Mjcf, model: Any, data: Any, run: Run) -> _Motion | None:
    """The steps of a run; None: it is unstable."""
    player, time = Player(model, data, threading.Event()), run.time
    table = np.repeat(data.ctrl[None], time.size, axis=0)
    for name, column in controls(model).items():
        if name in run.inputs:
            table[:, column] = run.inputs[name]
    base = float(function.model.opt.timestep)
    count = round(function.settle / base)
    if count and not player.play(np.repeat(table[:1], count, axis=0), base):
        return None
    span = float(time[-1] - time[0]) / (time.size - 1)
    steps = function.steps(span)
    parts = min(steps, max(1, round(span / GRID)))
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
