"""A package of a third party: its simulator of a servo as a model, and its files as records.

    pip install ./examples/third_party
    unmodeled diagnose servo-lab run_*.servo

The entry points in ``pyproject.toml`` name this module in two groups: ``unmodeled.models`` needs
``load``, ``names`` and ``settings``; ``unmodeled.readers`` needs ``read_logs``.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from unmodeled import Record
from unmodeled.data.robots import Joint, Log, Signal
from unmodeled.errors import DataError
from unmodeled.loading import LoadedModel
from unmodeled.models import Array, Jobs, Model, Parameter

#: Steps of the simulator between two samples.
STEPS = 4


def simulated(time: Array, goal: Array, numbers: Array) -> Array:
    """The simulator: angles [rad] of several servos from rest at the first goal, (B, n).

    ``numbers``: gain [N m/rad], damping [N m s/rad] and inertia [kg m^2], (B, 3).
    """
    gain, damping, inertia = numbers.T
    angle, speed = np.full(len(numbers), goal[0]), np.zeros(len(numbers))
    found = [angle]
    for step, now in zip(np.diff(time) / STEPS, goal, strict=False):
        for _ in range(STEPS):
            speed = (speed + step / inertia * gain * (now - angle)) / (1 + step * damping / inertia)
            angle = angle + step * speed
        found.append(angle)
    return np.array(found).T


class Servo(Model):
    """The servo as a model: what it has is stated, and how it runs is one method."""

    name = "servo-lab"
    inputs = ("arm",)
    outputs = ("arm.position",)
    units: Mapping[str, str] = {"arm": "rad", "arm.position": "rad"}
    joints = (Joint("arm", actuator="arm"),)
    parameters = (
        Parameter(name="gain", value=60.0, sd=6.0, unit="N m/rad", lower=1.0),
        Parameter(name="damping", value=2.0, sd=0.4, unit="N m s/rad", lower=0.0),
        Parameter(name="inertia", value=0.05, sd=0.0, unit="kg m^2"),
    )

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """Outputs of all jobs, (B, n, 1)."""
        return simulated(record.time, record.inputs["arm"], jobs.theta)[:, :, None]


def load(name: str, *_: object) -> LoadedModel | None:
    """The model of a name, with the usual effects; None: it is not of this package.

    Also gets settings (``--set``), the wanted channels, and a function for sentences to the user.
    """
    return LoadedModel(Servo(), default=True) if name == "servo-lab" else None


def names() -> Sequence[str]:
    """Models without a file."""
    return ("servo-lab",)


def settings(*_: object) -> Sequence[str]:
    """Completions of settings: there are none."""
    return ()


def read_logs(path: Path) -> list[Log] | None:
    """The run of a file with rows of time [s], goal and angle [deg]; None: of another format."""
    if path.suffix != ".servo":
        return None
    try:
        time, goal, angle = np.loadtxt(path).T
    except ValueError as error:
        raise DataError(f"{path}: {error}; expected rows of time, goal and angle") from None
    goals = Signal("arm", "goal", time, goal, "deg")
    return [Log(path.stem, (goals, Signal("arm", "position", time, angle, "deg")), "servo-lab")]
