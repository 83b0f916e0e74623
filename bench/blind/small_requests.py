"""The small machine of the interactive blind bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from blind import truth, truth_machine, truth_sensors
from blind.interactive import NULLS, Asked, Interactive, drawn_size, role_of
from blind.key_hammer import PARAMETERS, effects
from blind.small_machine import VARIATION, record_of_view, stated_model
from feltmb import gap
from feltmb.data import Array, Record

__all__ = ["SmallRequests"]

#: Records before any experiment: role by stroke.
DEFAULT = {"piano": "fit", "staccato": "fit", "forte": "held_out"}
#: Parts that can be measured separately: standard deviation as a share of their tolerance; cost.
PARTS = {
    "key_mass": (0.1, 0.5),
    "hammer_mass": (0.1, 0.5),
    "jack_stiffness": (0.2, 1.0),
    "bed_stiffness": (0.2, 1.0),
    "bed_position": (0.2, 0.5),
    "string_stiffness": (0.2, 1.0),
    "check_position": (0.2, 0.5),
    "key_balance": (0.2, 0.5),
    "hammer_spring_rate": (0.2, 1.0),
}


def _limits() -> gap.Limits:
    """Limits of the finger, and tests of parts."""
    sd = {name: own for name, _, own, _, _ in PARAMETERS}
    return gap.Limits(
        inputs={
            "finger": gap.InputLimits(
                most=12.0, rate=1500.0, unit="N", sigma=truth_sensors.NOISE_INPUT["force"]
            )
        },
        duration=truth.LENGTH - 1e-6,
        sample_rate=1.0 / truth.FRAME,
        parts=tuple(
            gap.PartTest(parameter=name, sd=share * sd[name], cost=cost, how="test of the part")
            for name, (share, cost) in PARTS.items()
        ),
    )


class SmallRequests(Interactive):
    """The small machine with a key and a hammer.

    Only profiles that press the key once are permitted. If the key goes down again while the hammer
    is below the backcheck, the law of the backcheck holds 20 mm deep: the hammer creeps out at
    0.2 m/s, which neither a piano does nor the fixed steps of the model resolve.

    """

    name = "key_hammer"
    families = ("step", "pulse", "slow pulse")
    together = 6

    def __init__(self) -> None:
        self.model, self.effects, self.limits = stated_model(), effects(), _limits()

    def draw(self, seed: int, number: int) -> truth.Case:
        rng = np.random.default_rng([seed, number, 26])
        bare = truth.draw(
            seed, number, {"force": {}, "motion": {}}, {}, mix=(1.0, 0.0, 0.0, 0.0, 0.0)
        )
        bare.mode = "force"
        if rng.random() < NULLS:
            return bare
        library = {e.name: e for e in self.effects}
        names = sorted(library)
        name = names[int(rng.integers(len(names)))]
        form = "AB"[int(rng.integers(2))]
        size = min(drawn_size(library[name].scale, rng), truth.LARGEST[name])
        if name in truth.BOTH_SIGNS and rng.random() < 0.5:
            size = -size
        bare.parts = [truth.Part(name, form, size, float("nan"))]
        return bare

    def defaults(self, cases: Sequence[truth.Case]) -> list[list[Record]]:
        names = list(DEFAULT)
        out: list[list[Record]] = []
        # Jobs of a case are at the indices of all strokes: parameters are selected by number.
        result = truth_machine.integrate(cases, [truth.STROKES] * len(cases), {})
        for i, case in enumerate(cases):
            views = truth_sensors.record(case, truth.STROKES, result, i * len(truth.STROKES), {})
            out.append([record_of_view(n, views[n], "force", DEFAULT[n]) for n in names])
        return out

    def default(self, k: int) -> tuple[str, Array]:
        name = list(DEFAULT)[k % len(DEFAULT)]
        count = round(truth.LENGTH / truth.FRAME)
        frames: Array = np.arange(count, dtype=np.float64) * truth.FRAME
        plain = {"strength": 1.0, "speed": 1.0, "shape": 0.05}
        return name, truth.played(frames, "force", name, plain)

    def simulated(self, asked: Sequence[Asked]) -> list[Record]:
        # All requests are integrated together.
        cases = [self._played(a.case, a.values, a.number) for a in asked]
        result = truth_machine.integrate(cases, [["piano"]] * len(cases), {})
        out = []
        for i, (case, a) in enumerate(zip(cases, asked, strict=True)):
            view = truth_sensors.record(case, ["piano"], result, i, {})["piano"]
            view = {k: v[: a.values.size] for k, v in view.items()}
            out.append(record_of_view(a.name, view, "force", role_of(a)))
        return out

    def _played(self, case: truth.Case, force: Array, number: int) -> truth.Case:
        """The case with a request instead of its strokes, and the run-to-run variability."""
        rng = np.random.default_rng([*case.seed, 3, number])
        n = len(truth.STROKES)
        parameters = {}
        for name, values in case.parameters.items():
            value = float(np.mean(values))
            if name in truth.WANDERING:
                value *= 1.0 + VARIATION * rng.standard_normal()
            elif name in ("start_key", "start_hammer"):
                value = (5e-5 if name == "start_key" else 1e-4) * rng.standard_normal()
            parameters[name] = [value] * n
        time = np.arange(force.size) * truth.FRAME
        strokes = [{"profile": (time, force)} for _ in range(n)]
        return replace(
            case, parameters=parameters, strokes=strokes, seed=[*case.seed, 100 + number]
        )

    def true_value(self, case: truth.Case, parameter: str) -> float:
        return float(np.mean(case.parameters[parameter]))
