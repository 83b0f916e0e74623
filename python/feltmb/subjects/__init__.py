"""Mechanisms as subjects of a fit or a diagnosis: tolerances, effects, records.

The layer between :mod:`feltmb.simulate`, which runs mechanisms, and :mod:`feltmb.fit` and
:mod:`feltmb.gap`, which know time series and nothing of pianos.
"""

from feltmb.subjects.amend import amended_action
from feltmb.subjects.blows import BlowNominal, blow_record, load_blows
from feltmb.subjects.effects import effect_of
from feltmb.subjects.library import Entry, Library, load_library
from feltmb.subjects.mechanism import mechanism_nominal
from feltmb.subjects.nominal import MechanismNominal
from feltmb.subjects.planned import planned_strokes

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
