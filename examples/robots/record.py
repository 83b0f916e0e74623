"""Logs of robots with a known cause, as their recorders write them: ``python record.py ROBOT``.

The robot is its own model with one change, so that the right answer of the diagnosis is known.
"""

import sys

import numpy as np
import pandas as pd

import unmodeled

#: Cause, interval of the log [s], step of its encoders [rad], and names and unit of its columns.
ROBOTS = {
    "so101": ({"elbow_flex.load_friction": 0.35}, 1 / 50, 2 * np.pi / 4096,
              ("action.{}.pos", "observation.state.{}.pos", "timestamp"), np.degrees(1.0)),
    "leg": ({"calf.armature": 0.012, "foot.payload": 0.12}, 1 / 100, 1e-4,
            ("{}_goal [rad]", "{}_pos [rad]", "time [s]"), 1.0),
}  # fmt: skip


def main(robot: str) -> None:
    """Write three logs of a robot."""
    cause, interval, step, (goal, position, clock), unit = ROBOTS[robot]
    mjcf = unmodeled.mujoco(f"{robot}.xml").mjcf
    joints = [mjcf.model.joint(i).name for i in range(mjcf.model.njnt)]
    for number in range(3):
        random = np.random.default_rng(number)
        time = interval * np.arange(round(6.0 / interval))
        slow, fast = random.uniform(0.2, 0.5, len(joints)), random.uniform(0.8, 1.6, len(joints))
        wave = np.sin(2 * np.pi * slow * time[:, None]) + 0.4 * np.sin(
            2 * np.pi * fast * time[:, None]
        )
        goals = dict(zip(joints, (random.uniform(0.3, 0.6, len(joints)) * wave).T, strict=True))
        seen = mjcf(time, goals, cause)
        log = {clock: time}
        for j in joints:
            log[goal.format(j)] = unit * goals[j]
        for j in joints:
            log[position.format(j)] = unit * step * np.round(seen[f"{j}.position"] / step)
        pd.DataFrame(log).to_csv(f"{robot}_{number}.csv", index=False)


if __name__ == "__main__":
    main(sys.argv[1])
