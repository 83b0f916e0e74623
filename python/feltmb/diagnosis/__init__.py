"""Diagnosis of the gap between a model and measurements, by one likelihood for imperfect models.

:func:`diagnose` fits the parameters of a model, searches the effects that it lacks, and compares
held-out records; its :class:`Report` is a text, a page, a table, and JSON. The engine of
:mod:`feltmb.gap` is replaced by this one.
"""

from feltmb.diagnosis.options import Options
from feltmb.diagnosis.pipeline import diagnose
from feltmb.diagnosis.progress import Progress
from feltmb.diagnosis.report import Report
from feltmb.diagnosis.result import (
    Cell,
    Channel,
    Event,
    Named,
    ParameterValue,
    Place,
    Reason,
    Result,
    SetOfCauses,
    Trace,
    Verdict,
)

__all__ = [
    "Cell",
    "Channel",
    "Event",
    "Named",
    "Options",
    "ParameterValue",
    "Place",
    "Progress",
    "Reason",
    "Report",
    "Result",
    "SetOfCauses",
    "Trace",
    "Verdict",
    "diagnose",
]
