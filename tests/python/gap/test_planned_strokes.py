"""Planned strokes of a mechanism."""

from __future__ import annotations

from feltmb.adapters import planned_strokes
from feltmb.adapters.model import resolve
from unmodeled.experiment import plan


def test_a_stroke_of_a_mechanism():
    """The action is linearized as in its diagnosis, with its variation from stroke to stroke."""
    settings = {"effects": "coulomb_friction.butt,felt_hardening.06", "tolerances": "felt.0*"}
    model, effects = resolve("steinway45", settings)
    (forte,) = planned_strokes(model, ("forte",))
    result = plan(model, effects, [forte.cut(0, 300)])
    assert result.records[0].after == result.after > 0.8
    assert {v.cause for v in result.effects if not v.parameter} == {e.name for e in effects}
