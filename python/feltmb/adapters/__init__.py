"""Adapters that make mechanisms models of a fit or a diagnosis: tolerances, effects, records.

This layer is between :mod:`feltmb.run.simulate`, which runs mechanisms, and :mod:`feltmb.fit` and
:mod:`feltmb.gap`, which only use time series and know nothing about pianos.
"""

from feltmb.adapters.apply_effects import action_with_effects
from feltmb.adapters.effects import effect_of
from feltmb.adapters.library import Entry, Library, load_library
from feltmb.adapters.mechanism import mechanism_model
from feltmb.adapters.model import MechanismModel
from feltmb.adapters.planned import (
    STROKE_KINDS,
    finger_limits,
    planned_strokes,
    write_planned_stroke,
    write_planned_torque,
)

__all__ = [
    "STROKE_KINDS",
    "Entry",
    "Library",
    "MechanismModel",
    "action_with_effects",
    "effect_of",
    "finger_limits",
    "load_library",
    "mechanism_model",
    "planned_strokes",
    "write_planned_stroke",
    "write_planned_torque",
]
