"""The whole action as a machine of the interactive blind bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from blind import action_truth as truth
from blind.action_calibration import packaged_scales, to_record
from blind.action_machine import RTOL
from blind.interactive import NULLS, Asked, Interactive, drawn_size, role_of
from feltmb import Action, gap
from feltmb.adapters import finger_limits, mechanism_model
from feltmb.adapters.changes import read_entry
from feltmb.data import Array, Record
from feltmb.run.stroke import table_stroke

__all__ = ["ActionRequests"]

#: Records before any experiment.
DEFAULT = ("piano", "staccato", "forte")
#: Test of a part: its standard deviation as a share of the tolerance or of the expected magnitude
#: of an effect, and its cost in strokes.
PART_SD, PART_COST = 0.2, 1.0
#: Effects that a caliper, a balance or a torque gauge measures: beginnings of names.
TESTED = (
    "center_of_mass", "coulomb_friction", "felt_thickness", "inertia", "pivot_position",
    "string_distance",
)  # fmt: skip


class ActionRequests(Interactive):
    """The packaged upright action with all its tolerances, recorded by six cameras.

    A request is a force of the finger. Each tolerance, and each effect of geometry, mass and dry
    friction, can be tested separately, to a fifth of it, at the cost of a stroke.
    """

    name = "steinway45"
    together = 1

    def __init__(self) -> None:
        action, self._refined, self._library, self._outputs = truth.setup()
        self._entries = {e.name: e for e in truth.candidates(self._library, self._outputs)}
        self._scales = packaged_scales()
        self.model, self.effects = mechanism_model(
            action,
            channels=self._outputs,
            library=self._library,
            effects=[*self._entries],
            rtol=RTOL,
            workers=1,
        )
        own = finger_limits(self.model)
        assert own is not None
        self._tolerances = {e.name: e for e in self._library.tolerances}
        self._same = {e.name: e.tolerance_parameter for e in self.effects}
        tested = [*self._tolerances.values()]
        tested += [
            e
            for e in self._entries.values()
            if e.name.startswith(TESTED) and not self._same[e.name]
        ]
        tests = tuple(
            gap.PartTest(
                parameter=e.name, sd=PART_SD * e.magnitude, cost=PART_COST, how="test of the part"
            )
            for e in tested
        )
        self.limits = replace(own, sample_rate=truth.RATE, parts=tests)

    def draw(self, seed: int, number: int) -> truth.Case:
        rng = np.random.default_rng([seed, number, 26])
        bare = truth.draw(
            seed, number, {}, self._library, self._outputs,
            mix=(1.0, 0.0, 0.0, 0.0, 0.0), views={"force": 1.0},
        )  # fmt: skip
        if rng.random() < NULLS:
            return bare
        forms = [
            (e, form)
            for _, e in sorted(self._entries.items())
            for form, _ in truth.forms(e, self._library)
            if self._scales.get(f"{e.name}:{form}", 0.0) > 0.0
        ]
        names = sorted({e.name for e, _ in forms})
        name = names[int(rng.integers(len(names)))]
        own = [(e, form) for e, form in forms if e.name == name]
        entry, form = own[int(rng.integers(len(own)))]
        size = drawn_size(entry.magnitude, rng)
        if (entry.sign == 0 and rng.random() < 0.5) or not entry.lower <= size <= entry.upper:
            size = -size
        return replace(bare, parts=(truth.Part(name, form, size, float("nan")),))

    def defaults(self, cases: Sequence[truth.Case]) -> list[list[Record]]:
        out = []
        for case in cases:
            views = {
                s: truth.record(self._refined, self._library, case, s, self._outputs)[0]
                for s in DEFAULT
            }
            out.append([to_record(s, view) for s, view in views.items()])
        return out

    def default(self, k: int) -> tuple[str, Array]:
        name = DEFAULT[k % len(DEFAULT)]
        played, longest = truth.command(name, truth.plain_case())
        return name, np.asarray(played.at(np.arange(0.0, longest, 1.0 / truth.RATE)))

    def simulated(self, asked: Sequence[Asked]) -> list[Record]:
        out = []
        for a in asked:
            time = np.arange(a.values.size) / truth.RATE
            stroke = table_stroke(tuple(time), tuple(a.values), name=a.name)
            rng = np.random.default_rng([*a.case.seed, 3, a.number])
            own = {
                n: float(truth.VARIATION * rng.standard_normal())
                for n in truth.varying(self._library)
            }
            case = replace(a.case, varied={a.name: own}, seed=(*a.case.seed, 100 + a.number))
            view, _ = truth.record(
                self._refined, self._library, case, a.name, self._outputs, played=stroke
            )
            out.append(replace(to_record(a.name, view), role=role_of(a)))
        return out

    def true_value(self, case: truth.Case, parameter: str) -> float:
        """Value in a test of the part as it is in the machine, with its effect."""
        entry = self._tolerances.get(parameter)
        if entry is None:  # an effect: relative to the machine without it
            entry, tabulated = self._entries[parameter], self._machine(replace(case, parts=()))
        else:
            tabulated = self._refined
        change, found = entry.changes[0], self._machine(case)
        was, now = (float(read_entry(a.config, change.path)) for a in (tabulated, found))
        if change.exp:
            return float(np.log(now / was) / change.exp)
        return (now - was) / (change.scale * was + change.add)

    def _machine(self, case: truth.Case) -> Action:
        """The machine of a case, without the variability of a stroke."""
        return truth.machine(self._refined, self._library, replace(case, varied={}), DEFAULT[0])
