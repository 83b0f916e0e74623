"""Adapters that make mechanisms models of a fit or a diagnosis: tolerances, effects, records.

This layer is between :mod:`feltmb.run.simulate`, which runs mechanisms, and :mod:`unmodeled.fit`
and
:mod:`unmodeled`, which only use time series and know nothing about pianos.
"""

from feltmb.adapters.changes import Entry
from feltmb.adapters.effects import effect_of
from feltmb.adapters.findings import action_with_effects
from feltmb.adapters.library import Library, load_library
from feltmb.adapters.model import (
    MechanismModel,
    mechanism_model,
    planned_strokes,
)

__all__ = [
    "Entry",
    "Library",
    "MechanismModel",
    "action_with_effects",
    "effect_of",
    "load_library",
    "mechanism_model",
    "planned_strokes",
]
