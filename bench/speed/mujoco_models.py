#!/usr/bin/env python3
"""Diagnosis of MuJoCo models: CPU time and answer, with this package and with another one.

    python bench/speed/mujoco_models.py reacher arm7                      # this package
    python bench/speed/mujoco_models.py arm7 --package OTHER/python       # and that of another tree

Each case runs in processes of its own, in turn. The models are made here: a reacher of two links
(two records, six causes), an arm with seven position servos and meshes whose fourth joint has 4
instead of 1 N m of friction, and a quadruped on a floor with 1.2 instead of 0.3 N m in a knee, both
among all default candidates.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import unmodeled

REACHER = """<mujoco model="reacher">
  <compiler angle="radian" inertiafromgeom="true"/>
  <option timestep="0.01" integrator="RK4"/>
  <default><joint armature="1" damping="1"/>
    <geom contype="0" conaffinity="0" density="300000"/></default>
  <worldbody><body name="body0" pos="0 0 .01"><joint name="joint0" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/>
    <body name="body1" pos=".1 0 0"><joint name="joint1" axis="0 0 1" limited="true" range="-3 3"/>
      <geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/>
      <body name="tip" pos=".11 0 0"><geom size=".01"/></body></body></body></worldbody>
  <actuator><motor name="m0" joint="joint0" gear="200"/>
    <motor name="m1" joint="joint1" gear="200"/></actuator>
</mujoco>"""

#: axis, length of the link [m], mass [kg], friction [N m], damping [N m s/rad], kp, kv, force.
LINKS = (
    ("0 0 1", 0.27, 2.4, 1.0, 10.0, 1500.0, 150.0, 50.0),
    ("0 1 0", 0.28, 1.9, 1.0, 10.0, 1500.0, 150.0, 50.0),
    ("0 0 1", 0.20, 1.7, 1.0, 5.0, 1000.0, 100.0, 30.0),
    ("0 1 0", 0.18, 1.8, 1.0, 5.0, 1000.0, 100.0, 30.0),
    ("0 0 1", 0.12, 1.4, 1.0, 5.0, 1000.0, 100.0, 30.0),
    ("0 1 0", 0.10, 1.4, 1.0, 2.0, 800.0, 80.0, 20.0),
    ("0 0 1", 0.08, 0.9, 1.0, 2.0, 800.0, 80.0, 20.0),
)
HOME = (0.0, -0.25, 0.0, 0.9, 0.0, 0.6, 0.0)


def arm() -> str:
    """An arm with seven position servos, whose links have meshes that are only seen."""
    inside, actuators = "", ""
    for k, (axis, length, mass, friction, damping, kp, kv, force) in reversed(
        list(enumerate(LINKS, 1))
    ):
        inside = f"""<body name="link{k}" pos="0 0 {LINKS[k - 2][1] if k > 1 else 0.1}">
          <joint name="joint{k}" axis="{axis}" frictionloss="{friction}" damping="{damping}"
            armature="0.1"/>
          <geom type="capsule" size=".04" mass="{mass}" fromto="0 0 0 .02 0 {length}"
            contype="0" conaffinity="0"/>
          <geom type="mesh" mesh="link{k}" mass="0" contype="0" conaffinity="0"/>
          {inside}</body>"""
        actuators = (
            f'<position name="act{k}" joint="joint{k}" kp="{kp}" kv="{kv}" '
            f'forcerange="-{force} {force}"/>' + actuators
        )
    home = " ".join(map(str, HOME))
    meshes = "".join(
        f'<mesh name="link{k}" file="link.obj" scale="{0.04 + 0.001 * k} .04 .04"/>'
        for k in range(1, len(LINKS) + 1)
    )
    return f"""<mujoco model="arm"><option timestep="0.002" integrator="implicitfast"/>
      <asset>{meshes}</asset>
      <worldbody>{inside}</worldbody><actuator>{actuators}</actuator>
      <keyframe><key name="home" qpos="{home}" ctrl="{home}"/></keyframe></mujoco>"""


def write_ball(path: Path, rings: int = 60, around: int = 100) -> None:
    """A ball of some thousand faces, as of a drawing."""
    lines = []
    for i in range(rings + 1):
        up = np.pi * (i + 0.5) / (rings + 1)
        for j in range(around):
            turn = 2.0 * np.pi * j / around
            x, y = np.sin(up) * np.cos(turn), np.sin(up) * np.sin(turn)
            lines.append(f"v {x:.6f} {y:.6f} {np.cos(up):.6f}")
    for i in range(rings):
        for j in range(around):
            a, b = 1 + i * around + j, 1 + i * around + (j + 1) % around
            lines += [f"f {a} {a + around} {b}", f"f {b} {a + around} {b + around}"]
    path.write_text("\n".join(lines) + "\n")


def measured(path, change, controls, outputs, step, every, noise, start=None, skip=0):
    """Records by MuJoCo alone, of a model whose compiled fields ``change`` sets.

    ``skip``: positions of a free base, which are not measured.
    """
    import mujoco

    from unmodeled import Record, Sensor

    model = mujoco.MjModel.from_xml_path(str(path))
    change(model)
    found = []
    for seed, control in enumerate(controls):
        data = mujoco.MjData(model)
        if start is not None:
            mujoco.mj_resetDataKeyframe(model, data, start)
        seen = np.empty((len(control), model.nq - skip))
        for row, values in zip(seen, control, strict=True):
            row[:] = data.qpos[skip:]
            data.ctrl[:] = values
            mujoco.mj_step(model, data, every)
        seen += noise * np.random.default_rng(seed).standard_normal(seen.shape)
        found.append(
            Record(
                name=f"run{seed}",
                time=step * every * np.arange(len(control)),
                inputs={model.actuator(i).name: control[:, i] for i in range(model.nu)},
                outputs=dict(zip(outputs, seen.T, strict=True)),
                sensors={n: Sensor(name=n, sigma=noise, unit="rad") for n in outputs},
            )
        )
    return found


def waves(seed, samples, interval, count, size, rates):
    """Sums of sines that start at zero with zero speed, (samples, count)."""
    random = np.random.default_rng(seed)
    time = interval * np.arange(samples)
    w, p = random.uniform(*rates, (2, count, 3))
    p = random.uniform(0.0, 6.0, (count, 3))
    y = np.sin(time[:, None, None] * w + p).sum(axis=2)
    rise = 1.0 - np.exp(-((time / 0.3) ** 2))
    return size * rise[:, None] * (y - y[0])


def reacher(folder):

    def change(model):
        model.dof_frictionloss[1] = 0.5

    path = folder / "reacher.xml"
    path.write_text(REACHER)
    names = ("joint0", "joint1")
    controls = [waves(k, 200, 0.01, 2, 0.02, (3.0, 15.0)) for k in (1, 2)]
    records = measured(path, change, controls, names, 0.01, 1, 1e-3)
    prior = {f"{n}.damping": (None, 0.1) for n in names}
    effects = [f"{n}.{w}" for n in names for w in ("frictionloss", "armature", "backlash")]
    return unmodeled.mujoco(path, parameters=prior), records, effects


def arm7(folder):

    def change(model):
        model.dof_frictionloss[3] = 4.0

    path = folder / "arm.xml"
    path.write_text(arm())
    write_ball(folder / "link.obj")
    controls = [np.array(HOME) + waves(k, 250, 0.01, 7, 0.25, (1.0, 5.0)) for k in (1, 2, 3)]
    names = tuple(f"joint{k}" for k in range(1, 8))
    records = measured(path, change, controls, names, 0.002, 5, 1e-4, start=0)
    return unmodeled.mujoco(path, key="home"), records, None


LEG = """<body name="{n}hip" pos="{x} {y} 0"><joint name="{n}abduct" axis="1 0 0" class="j"/>
  <geom type="capsule" size=".03" fromto="0 0 0 0 {w} 0" mass=".6"/>
  <body name="{n}thigh" pos="0 {w} 0"><joint name="{n}swing" axis="0 1 0" class="j"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".9"/>
    <body name="{n}calf" pos="0 0 -.2"><joint name="{n}knee" axis="0 1 0" class="j"/>
      <geom type="capsule" size=".015" fromto="0 0 0 0 0 -.2" mass=".2"/>
      <geom name="{n}foot" class="foot" pos="0 0 -.2"/></body></body></body>"""


def quadruped_text() -> str:
    """A quadruped with a free base and twelve position servos, which stands on a floor."""
    legs = {
        f"{a}{b}_": LEG.format(n=f"{a}{b}_", x=x, y=y, w=w)
        for a, x in (("f", 0.2), ("r", -0.2))
        for b, y, w in (("l", 0.05, 0.08), ("r", -0.05, -0.08))
    }
    joints = [f"{n}{j}" for n in legs for j in ("abduct", "swing", "knee")]
    drives = "".join(
        f'<position name="{j}_set" joint="{j}" kp="60" kv="2" forcerange="-30 30"/>' for j in joints
    )
    pose = " ".join(["0 0.7 -1.4"] * 4)
    return f"""<mujoco model="quadruped"><option timestep="0.002" integrator="implicitfast"/>
      <default><geom contype="0" conaffinity="0"/>
        <default class="j"><joint damping="0.5" frictionloss="0.3" armature="0.01"/></default>
        <default class="foot"><geom size=".022" conaffinity="1" friction="0.8"/></default></default>
      <worldbody><geom type="plane" size="5 5 .1" contype="1" conaffinity="0"/>
        <body name="trunk" pos="0 0 .325"><freejoint/>
          <geom type="box" size=".2 .06 .05" mass="6"/>{"".join(legs.values())}</body></worldbody>
      <actuator>{drives}</actuator>
      <keyframe><key name="home" qpos="0 0 .325 1 0 0 0 {pose}" ctrl="{pose}"/></keyframe>
      </mujoco>"""


def quadruped(folder):

    def change(model):
        model.joint("fl_knee").frictionloss[0] = 1.2

    path = folder / "quadruped.xml"
    path.write_text(quadruped_text())
    pose = np.tile((0.0, 0.7, -1.4), 4)
    controls = [pose + waves(k, 200, 0.01, 12, 0.08, (2.0, 8.0)) for k in (1, 2, 3)]
    model = unmodeled.mujoco(path, key="home")
    legs = ("fl_", "fr_", "rl_", "rr_")
    joints = [f"{n}{j}" for n in legs for j in ("abduct", "swing", "knee")]
    records = measured(path, change, controls, joints, 0.002, 5, 2e-4, start=0, skip=7)
    return model, records, None


CASES = {"reacher": reacher, "arm7": arm7, "quadruped": quadruped}


def run(case: str, seconds: float, full: bool) -> None:
    """Print one line of JSON about a case."""
    from unmodeled import Options

    with tempfile.TemporaryDirectory() as folder:
        model, records, effects = CASES[case](Path(folder))
        begin, ticks = time.perf_counter(), os.times()
        report = model.diagnose(records, effects=effects, options=Options(seconds=seconds))
        after = os.times()
        if full:
            print(report, file=sys.stderr)
        named = [f"{n.cause} {n.magnitude:.3g} {n.unit}" for n in report.named]
        line = {
            "wall": time.perf_counter() - begin,
            "cpu_here": after.user + after.system - ticks.user - ticks.system,
            "verdict": str(report.verdict),
            "named": named,
            "classes": [[n.cause for n in group] for group in report.classes],
            "not_tried": len(report.not_tried),
        }
    print(json.dumps(line))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--package", action="append", default=[], help="folder of another package")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--only", default="", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        return run(options.only, options.seconds, options.report)
    for case in options.cases or CASES:
        for package in (None, *options.package):
            environment = {**os.environ, **({"PYTHONPATH": package} if package else {})}
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, __file__, "--only", case, "--seconds", str(options.seconds)]
            command += ["--report"] if options.report else []
            done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True,
                                  check=True)  # fmt: skip
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"{case:8} {package or 'this':30} {cpu:7.1f} CPU s, {done.stdout.strip()}",
                  flush=True)  # fmt: skip
    return None


if __name__ == "__main__":
    main()
