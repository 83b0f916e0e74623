"""Mechanisms as subjects of a fit or a diagnosis: tolerances, effects, records.

The layer between :mod:`feltmb.run.simulate`, which runs mechanisms, and :mod:`feltmb.fit` and
:mod:`feltmb.gap`, which know time series and nothing of pianos.
"""

from feltmb.adapters.amend import amended_action
from feltmb.adapters.blows import ImpactModel, blow_record, load_blows
from feltmb.adapters.effects import effect_of
from feltmb.adapters.library import Entry, Library, load_library
from feltmb.adapters.mechanism import mechanism_model
from feltmb.adapters.model import MechanismModel
from feltmb.adapters.planned import planned_strokes

__all__ = [
    "Entry",
    "ImpactModel",
    "Library",
    "MechanismModel",
    "amended_action",
    "blow_record",
    "effect_of",
    "load_blows",
    "load_library",
    "mechanism_model",
    "planned_strokes",
]
