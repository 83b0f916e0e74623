"""Logs of robots with a known cause, as their recorders write them: ``python record.py ROBOT``.

The robot is its own model with one or two changes, so that the right answer is known.
"""

import sys

import numpy as np
import pandas as pd

import unmodeled

#: Causes, interval of the log [s], step of the encoders [rad] and noise of the torques [N m], and
#: names and unit of the columns.
ROBOTS = {
    "so101": ({"elbow_flex.load_friction": 0.35}, 1 / 50, (2 * np.pi / 4096, 0.0),
              ("timestamp", "action.{}.pos", "observation.state.{}.pos", ""), np.degrees(1.0)),
    "leg": ({"calf.armature": 0.012, "foot.payload": 0.12}, 1 / 100, (1e-4, 0.0),
            ("time [s]", "{}_goal [rad]", "{}_pos [rad]", ""), 1.0),
    "arm7": ({"joint4.frictionloss": 0.9, "hand.payload": 0.3}, 1 / 50, (1e-5, 0.05),
             ("time [s]", "{} [rad]", "{}.position [rad]", "{}.torque [N m]"), 1.0),
}  # fmt: skip


def main(robot: str) -> None:
    """Write three logs of a robot."""
    causes, interval, (step, noise), (clock, goal, position, torque), unit = ROBOTS[robot]
    mjcf = unmodeled.mujoco(f"{robot}.xml").mjcf
    joints = [mjcf.model.joint(i).name for i in range(mjcf.model.njnt)]
    mjcf = mjcf.with_torques(joints)
    for number in range(3):
        random = np.random.default_rng(number)
        time = interval * np.arange(round(6.0 / interval))
        slow, fast = random.uniform(0.2, 0.5, len(joints)), random.uniform(0.8, 1.6, len(joints))
        turns = 2 * np.pi * time[:, None]
        wave = np.sin(slow * turns) + 0.4 * np.sin(fast * turns)
        goals = dict(zip(joints, (random.uniform(0.3, 0.6, len(joints)) * wave).T, strict=True))
        seen = mjcf(time, goals, causes)
        log = {clock: time, **{goal.format(j): unit * goals[j] for j in joints}}
        for j in joints:
            log[position.format(j)] = unit * step * np.round(seen[f"{j}.position"] / step)
        for j in joints if torque else ():
            shown = seen[f"{j}.torque"] + noise * random.standard_normal(time.size)
            log[torque.format(j)] = shown
        pd.DataFrame(log).to_csv(f"{robot}_{number}.csv", index=False)


if __name__ == "__main__":
    main(sys.argv[1])
