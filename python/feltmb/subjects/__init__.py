"""Mechanisms as subjects of a fit or a diagnosis: tolerances, effects, records.

The layer between :mod:`feltmb.simulate`, which runs mechanisms, and :mod:`feltmb.fit` and
:mod:`feltmb.gap`, which know time series and nothing of pianos.
"""

from feltmb.subjects.library import Entry, Library, load_library
from feltmb.subjects.nominal import MechanismNominal, effects_of, mechanism_nominal

__all__ = [
    "Entry",
    "Library",
    "MechanismNominal",
    "effects_of",
    "load_library",
    "mechanism_nominal",
]
