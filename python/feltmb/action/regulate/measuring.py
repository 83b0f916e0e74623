"""Measurements of a regulation: at rest, in a slow press, after a strike."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from feltmb.action.regulate.targets import Step
from feltmb.mechanism import Action
from unmodeled.errors import Error, InvalidParameter

if TYPE_CHECKING:
    from feltmb.run.quasistatic import SimulatedPress


#: A hammer in check with a larger motion is not at rest [m].
MOST_SWING = 1e-3


class CannotMeasure(Error):
    """The measurement has no result for this action; the message states the reason."""


@dataclass
class Bench:
    """Performs measurements and caches the simulations of each action."""

    counts: dict[str, int] = field(
        default_factory=lambda: {"rest poses": 0, "slow presses": 0, "strokes": 0}
    )
    _rests: dict[str, dict[int, tuple[float, float]]] = field(default_factory=dict)
    _presses: dict[tuple[str, float, float], SimulatedPress] = field(default_factory=dict)
    _values: dict[tuple[str, str], float] = field(default_factory=dict)

    def measure(self, action: Action, step: Step) -> float:
        """Measure the quantity of a step, in SI units.

        Raises
        ------
        CannotMeasure
            The event that the step measures does not occur.
        """
        key = (action.hash, step.model_dump_json(exclude={"screw", "target", "tolerance"}))
        if key not in self._values:
            try:
                self._values[key] = getattr(self, f"_{step.measure}")(action, step)
            except CannotMeasure:
                raise
            except InvalidParameter:
                raise
            except Error as error:
                raise CannotMeasure(str(error)) from None
        return self._values[key]

    def _rest(self, action: Action) -> dict[int, tuple[float, float]]:
        if action.hash not in self._rests:
            import numpy as np

            from feltmb.run.simulate import evaluate

            self.counts["rest poses"] += 1
            pose = action.rest_pose
            table = evaluate(action, pose, np.zeros_like(pose)).rows
            self._rests[action.hash] = {int(r[0]): (-float(r[1]), float(r[3])) for r in table}
        return self._rests[action.hash]

    def _contact(self, action: Action, number: int | None) -> tuple[float, float]:
        rest = self._rest(action)
        if number not in rest:
            known = ", ".join(str(n) for n in sorted(rest))
            raise InvalidParameter(f"targets: there is no contact {number}; contacts are {known}")
        return rest[number]

    def _rest_gap(self, action: Action, step: Step) -> float:
        return self._contact(action, step.contact)[0]

    def _rest_force(self, action: Action, step: Step) -> float:
        return self._contact(action, step.contact)[1]

    def _press(self, action: Action, step: Step) -> SimulatedPress:
        from feltmb.run.quasistatic import simulated_press

        key = (action.hash, step.speed, step.travel)
        if key not in self._presses:
            self.counts["slow presses"] += 1
            self._presses.clear()  # enough: let-off and damper steps are consecutive
            self._presses[key] = simulated_press(action, speed=step.speed, travel=step.travel)
        return self._presses[key]

    def _simulated_press(self, action: Action, step: Step) -> float:
        return self._press(action, step).closest

    def _static_press(self, action: Action, step: Step) -> float:
        from feltmb.run.quasistatic import static_let_off

        self.counts["slow presses"] += 1
        return static_let_off(
            action, travel=step.travel, speed=step.speed, friction=step.friction
        ).gap

    def _simulated_start(self, action: Action, step: Step) -> float:
        self._contact(action, step.contact)
        assert step.contact is not None
        gap = self._press(action, step).gap_when(step.contact)
        if gap is None:
            raise CannotMeasure(
                f"contact {step.contact} does not close in a press of {1e3 * step.travel:g} mm"
            )
        strike = action.config.reading.strike_contact
        return 1.0 - gap / self._contact(action, strike)[0]

    def _aftertouch(self, action: Action, step: Step) -> float:
        self._contact(action, step.contact)
        assert step.contact is not None
        return self._press(action, step).left(step.contact)

    def _spring_force(self, action: Action, step: Step) -> float:
        from feltmb.mechanism.workshop import distance_from_joint

        spring = action.config.springs.get(step.spring or "")
        if spring is None:
            raise InvalidParameter(f"targets: there is no spring {step.spring!r}")
        angle = action.rest_pose[action.coordinates.index(spring.coordinate)]
        arm = distance_from_joint(action.config, spring.coordinate, step.point or "")
        return abs(float(spring.stiffness) * (float(angle) - float(spring.rest_angle))) / arm

    def _drop(self, action: Action, step: Step) -> float:
        press = self._press(action, step)
        return float(press.gap[-1]) - press.closest

    def _check_distance(self, action: Action, step: Step) -> float:
        from feltmb.run.simulate import simulate

        self.counts["strokes"] += 1
        summary = simulate(action, step.stroke, ledger=False, output_rate=2000.0).summary
        if "check_gap" not in summary:
            raise CannotMeasure(f"the backcheck does not hold the hammer after {step.stroke}")
        if summary["check_gap_swing"] > MOST_SWING:
            raise CannotMeasure(
                f"the hammer swings by {1e3 * summary['check_gap_swing']:.3g} mm in check at the "
                f"end of {step.stroke}"
            )
        return summary["check_gap"]
