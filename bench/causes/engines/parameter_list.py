"""Fits of a list of numbers of a robot, as engineers make them with MuJoCo alone.

All numbers are fitted at once: dry friction, damping, armature, stiffness and damping of the servo
of each joint, a mass at the last link, and one delay of all goals. ``run`` is least squares within
bounds, the method of ``mujoco.sysid`` (whose extras need not be installed); ``cma`` is a CMA-ES, as
PACE has it. Named is what differs from the file by more than three standard deviations.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from causes.cases import opened

__all__ = ["cma", "run"]

#: Standard deviations above which a number is told; half of the width of the bounds.
SURE, MOST = 3.0, 5.0


class _Robot:
    """Residuals of the fitted records by changes of the numbers in their scales."""

    def __init__(self, folder: Path):
        found, _, records = opened(folder)
        self.file = str(found.mjcf.path)
        self.records = [r for r in records if r.role != "held_out"]
        self.model = mujoco.MjModel.from_xml_path(self.file)
        m, joints = self.model, range(self.model.nv)
        rows = [(f"joint{k}.frictionloss", m.dof_frictionloss, k, 1.0) for k in joints]
        rows += [(f"joint{k}.damping", m.dof_damping, k, 1.0) for k in joints]
        rows += [(f"joint{k}.armature", m.dof_armature, k, 1.0) for k in joints]
        rows += [(f"servo{k}.kp", m.actuator_gainprm, (k, 0), 0.2) for k in joints]
        rows += [(f"servo{k}.kv", m.actuator_biasprm, (k, 2), 0.5) for k in joints]
        rows += [(f"link{m.nv - 1}.payload", m.body_mass, m.nbody - 1, 0.5)]
        self.rows = [(name, field, at, share * abs(field[at])) for name, field, at, share in rows]
        self.names = [*(name for name, *_ in rows), "delay of all inputs"]
        self.low = np.array([max(-MOST, -s[1][s[2]] / s[3]) if s[1][s[2]] > 0 else -1.0
                             for s in self.rows] + [0.0])  # fmt: skip

    def residual(self, z: np.ndarray) -> np.ndarray:
        """In standard deviations of the noise; ``z[-1]``: delay in samples."""
        kept = [field[at] for _, field, at, _ in self.rows]
        for change, (_, field, at, size) in zip(z, self.rows, strict=False):
            field[at] += change * size
        m = self.model
        m.actuator_biasprm[:, 1] = -m.actuator_gainprm[:, 0]
        mujoco.mj_setConst(m, mujoco.MjData(m))
        left = [self._run(r, z[-1]) for r in self.records]
        for value, (_, field, at, _) in zip(kept, self.rows, strict=True):
            field[at] = value
        return np.nan_to_num(np.concatenate(left), nan=1e6, posinf=1e6, neginf=-1e6)

    def _run(self, r: Any, late: float) -> np.ndarray:
        m, data = self.model, mujoco.MjData(self.model)
        measured = np.column_stack([r.outputs[f"joint{k}.position"] for k in range(m.nv)])
        goals = np.column_stack([r.inputs[f"servo{k}"] for k in range(m.nv)])
        every = round(float(r.time[1] - r.time[0]) / m.opt.timestep)
        held = np.repeat(goals, every, axis=0)
        at = np.clip(np.arange(len(held)) - late * every, 0.0, None)
        low = at.astype(int)
        high = np.minimum(low + 1, len(held) - 1)
        held = held[low] + (at - low)[:, None] * (held[high] - held[low])
        data.qpos[:], seen = measured[:3].mean(axis=0), np.empty_like(measured)
        for i, row in enumerate(held):
            if i % every == 0:
                seen[i // every] = data.qpos
            data.ctrl[:] = row
            mujoco.mj_step(m, data)
        return ((seen - measured) / r.sensors["joint0.position"].sigma).ravel()

    def told(self, z: np.ndarray) -> dict[str, Any]:
        """What differs from the file for sure."""
        base, steps = self.residual(z), 1e-3
        slopes = np.array([(self.residual(z + steps * e) - base) / steps for e in np.eye(z.size)])
        spread = max(1.0, float(base @ base) / base.size)
        sd = np.sqrt(spread * np.diag(np.linalg.pinv(slopes @ slopes.T)))
        named = [n for n, v, s in zip(self.names, z, sd, strict=True) if abs(v) > SURE * s > 0.0]
        return {"named": named, "version": mujoco.__version__}


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """Least squares within bounds."""
    robot, end = _Robot(folder), time.process_time() + 0.7 * seconds

    def residual(z: np.ndarray) -> np.ndarray:
        if time.process_time() > end:
            raise TimeoutError
        seen.append(z.copy())
        return robot.residual(z)

    seen = [np.zeros(len(robot.names))]
    try:
        bounds = robot.low - 1e-9, np.full(len(seen[0]), MOST)
        z = least_squares(residual, seen[0], bounds=bounds, x_scale="jac", diff_step=1e-4).x
    except TimeoutError:
        z = seen[-1]
    return robot.told(z)


def cma(folder: Path, seconds: float) -> dict[str, Any]:
    """CMA-ES (Hansen, The CMA evolution strategy: a tutorial, 2016), until 70 % of the limit."""
    robot = _Robot(folder)
    z = _evolved(
        lambda x: float((robot.residual(np.clip(x, robot.low, MOST)) ** 2).sum()),
        np.zeros(len(robot.names)), 0.3, time.process_time() + 0.7 * seconds,
    )  # fmt: skip
    return robot.told(np.clip(z, robot.low, MOST))


def _evolved(
    cost: Callable[[np.ndarray], float], mean: np.ndarray, sigma: float, end: float
) -> np.ndarray:
    n, rng = mean.size, np.random.default_rng(1)
    count = 4 + int(3.0 * np.log(n))
    weight = np.log(count / 2.0 + 0.5) - np.log(np.arange(1, count // 2 + 1))
    weight /= weight.sum()
    good = 1.0 / (weight**2).sum()
    cc, cs = (4.0 + good / n) / (n + 4.0 + 2.0 * good / n), (good + 2.0) / (n + good + 5.0)
    c1 = 2.0 / ((n + 1.3) ** 2 + good)
    cmu = min(1.0 - c1, 2.0 * (good - 2.0 + 1.0 / good) / ((n + 2.0) ** 2 + good))
    damp = 1.0 + 2.0 * max(0.0, np.sqrt((good - 1.0) / (n + 1.0)) - 1.0) + cs
    pc, ps, cov, expected = np.zeros(n), np.zeros(n), np.eye(n), np.sqrt(n) * (1.0 - 0.25 / n)
    while time.process_time() < end:
        value, axes = np.linalg.eigh(cov)
        root = axes * np.sqrt(np.maximum(value, 1e-20))
        drawn = rng.standard_normal((count, n)) @ root.T
        order = np.argsort([cost(mean + sigma * y) for y in drawn])[: weight.size]
        best = drawn[order]
        step = weight @ best
        mean = mean + sigma * step
        ps = (1.0 - cs) * ps + np.sqrt(cs * (2.0 - cs) * good) * (
            axes @ ((axes.T @ step) / np.sqrt(np.maximum(value, 1e-20)))
        )
        pc = (1.0 - cc) * pc + np.sqrt(cc * (2.0 - cc) * good) * step
        cov = (1.0 - c1 - cmu) * cov + c1 * np.outer(pc, pc) + cmu * (best.T * weight) @ best
        sigma *= np.exp(cs / damp * (np.linalg.norm(ps) / expected - 1.0))
    return mean
