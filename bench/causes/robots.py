"""Arms in servos of position, drawn at random, each with a withheld change or none.

The simulations of the robot are MuJoCo's alone; the goals of a late robot act some steps later.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from blind.marks import Cause, Truth
from unmodeled import Record, Sensor

__all__ = ["FAULTS", "MODEL", "Robot"]

#: Withheld change of each case.
FAULTS = (
    "nothing", "nothing", "friction", "friction", "payload", "payload", "kp", "damping", "delay",
    "delay", "friction payload", "kp friction",
)  # fmt: skip
SEED, STEP, EVERY, SAMPLES, NOISE = 20261201, 0.002, 5, 300, 2e-4
MODEL = '''"""The file of the robot as its owner has it."""

from pathlib import Path

import unmodeled

model = unmodeled.mujoco(Path(__file__).with_name("robot.xml"))
'''


class Robot:
    """A drawn arm of three to seven joints with its change."""

    def __init__(self, number: int):
        self.draw = np.random.default_rng((SEED, number))
        self.fault, self.joints = FAULTS[number], int(self.draw.integers(3, 8))
        size = 0.75 ** np.arange(self.joints)
        u = self.draw.uniform
        self.length = 0.3 * np.sqrt(size) * u(0.7, 1.3, self.joints)
        self.mass, self.kp = 2.0 * size * u(0.7, 1.3, self.joints), 900.0 * size * u(0.6, 1.6)
        self.kv, self.friction = self.kp * u(0.06, 0.12, self.joints), 0.8 * size
        self.axes = self.draw.permuted(["0 0 1", "0 1 0", "1 0 0"] * 3)[: self.joints]
        self.joint = int(self.draw.integers(0, self.joints))
        self.steps_late = int(self.draw.integers(2, 6)) * ("delay" in self.fault)

    @property
    def xml(self) -> str:
        """The file without the change."""
        inside, drives = "", ""
        for k in reversed(range(self.joints)):
            place = self.length[k - 1] if k else 0.2
            inside = (
                f'<body name="link{k}" pos="0 0 {place:.4f}"><joint name="joint{k}" '
                f'axis="{self.axes[k]}" damping="{0.01 * self.kp[k]:.4f}" armature="0.05" '
                f'frictionloss="{self.friction[k]:.4f}"/><geom type="capsule" size=".03" '
                f'mass="{self.mass[k]:.4f}" fromto="0 0 0 .03 0 {self.length[k]:.4f}" '
                f'contype="0" conaffinity="0"/>{inside}</body>'
            )
            drives = (
                f'<position name="servo{k}" joint="joint{k}" kp="{self.kp[k]:.4f}" '
                f'kv="{self.kv[k]:.4f}"/>{drives}'
            )
        return (
            f'<mujoco><option timestep="{STEP}" integrator="implicitfast"/><worldbody>{inside}'
            f"</worldbody><actuator>{drives}</actuator></mujoco>"
        )

    def _changed(self) -> object:
        import mujoco

        model, k = mujoco.MjModel.from_xml_string(self.xml), self.joint
        size = self.draw.uniform(0.7, 1.3)
        if "friction" in self.fault:
            model.dof_frictionloss[k] += 3.0 * size * self.friction[k]
        if "payload" in self.fault:
            model.body_mass[-1] += 0.5 * size
            mujoco.mj_setConst(model, mujoco.MjData(model))
        if "kp" in self.fault:
            model.actuator_gainprm[k, 0] *= 1.0 - 0.25 * size
            model.actuator_biasprm[k, 1] *= 1.0 - 0.25 * size
        if "damping" in self.fault:
            model.dof_damping[k] *= 1.0 + 3.0 * size
        return model

    def make(self, _: Path) -> tuple[Sequence[Record], Truth]:
        """Three records, and what is right."""
        import mujoco

        model = self._changed()
        time, records = STEP * EVERY * np.arange(SAMPLES), []
        home = self.draw.uniform(-0.8, 0.8, self.joints)
        for n in range(3):
            w, p = self.draw.uniform((1.0, 0.0), (6.0, 6.0), (self.joints, 3, 2)).T
            wave = np.sin(time[:, None, None] * w + p).sum(axis=1)
            goals = home + 0.25 * (1.0 - np.exp(-((time / 0.3) ** 2)))[:, None] * (wave - wave[0])
            held = np.repeat(goals, EVERY, axis=0)
            held = np.concatenate([np.repeat(held[:1], self.steps_late, axis=0), held])
            data, seen = mujoco.MjData(model), np.empty((SAMPLES, self.joints))
            data.qpos[:] = data.ctrl[:] = home
            mujoco.mj_step(model, data, 2000)  # it hangs where its servos hold it
            for i, row in enumerate(held[: SAMPLES * EVERY]):
                if i % EVERY == 0:
                    seen[i // EVERY] = data.qpos
                data.ctrl[:] = row
                mujoco.mj_step(model, data)
            seen += NOISE * self.draw.standard_normal(seen.shape)
            names = [f"joint{k}.position" for k in range(self.joints)]
            records.append(
                Record(
                    name=f"run{n}", time=time, role="held_out" if n == 2 else "fit",
                    inputs={f"servo{k}": goals[:, k] for k in range(self.joints)},
                    input_units={f"servo{k}": "rad" for k in range(self.joints)},
                    outputs=dict(zip(names, seen.T, strict=True)),
                    sensors={n: Sensor(name=n, unit="rad", sigma=NOISE) for n in names},
                )
            )  # fmt: skip
        return records, self.truth

    @property
    def truth(self) -> Truth:
        """What is right: a delay of all commands is one of all readings as well."""
        k, last = self.joint, self.joints - 1
        known = {
            "friction": Cause((f"joint{k}.frictionloss",)),
            "payload": Cause((f"link{last}.payload",)),
            "kp": Cause((f"servo{k}.kp",), (f"servo{k}.gear",)),
            "damping": Cause((f"joint{k}.damping", f"servo{k}.kv")),
            "delay": Cause(("delay of all inputs", "delay of all sensors")),
        }
        causes = tuple(known[f] for f in self.fault.split() if f in known)
        kind = "effect" if causes else "control"
        return Truth(kind, causes, about=f"{self.joints} joints: {self.fault}")
