"""Mechanisms as subjects of a fit or a diagnosis: tolerances, effects, records.

The layer between :mod:`feltmb.run.simulate`, which runs mechanisms, and :mod:`feltmb.fit` and
:mod:`feltmb.gap`, which know time series and nothing of pianos.
"""

from feltmb.adapters.amend import amended_action
from feltmb.adapters.blows import BlowNominal, blow_record, load_blows
from feltmb.adapters.effects import effect_of
from feltmb.adapters.library import Entry, Library, load_library
from feltmb.adapters.mechanism import mechanism_nominal
from feltmb.adapters.nominal import MechanismNominal
from feltmb.adapters.planned import planned_strokes

__all__ = [
    "BlowNominal",
    "Entry",
    "Library",
    "MechanismNominal",
    "amended_action",
    "blow_record",
    "effect_of",
    "load_blows",
    "load_library",
    "mechanism_nominal",
    "planned_strokes",
]
