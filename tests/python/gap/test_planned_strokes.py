"""Designed experiments against closed forms."""

from __future__ import annotations

from unmodeled import Sensor
from unmodeled.experiment import (
    InputLimits,
    Limits,
    design,
)


def test_a_stroke_of_a_mechanism():
    """The action is linearized as in its diagnosis, with its variation from stroke to stroke."""
    from feltmb.adapters.model import resolve

    settings = {"effects": "coulomb_friction.butt,felt_hardening.06", "tolerances": "felt.0*"}
    model, effects = resolve("steinway45", settings)
    own = InputLimits(most=25.0, rate=2000.0, unit="N", sigma=0.01)
    box = Limits(inputs={"force": own}, duration=0.15)
    found = design(
        model, effects, limits=box, budget=1, refinements=0, candidates=1, families=["pulse"],
        sensors={n: Sensor(name=n, unit="m", sigma=2e-5) for n in ("hammer_tip.x", "key_front.y")},
    )  # fmt: skip
    assert found.experiments[0].after == found.after > 0.8
    assert {v.cause for v in found.effects if not v.parameter} == {e.name for e in effects}
