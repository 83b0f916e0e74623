"""Diagnosis of the gap between a model and measurements, by one likelihood for imperfect models.

:func:`diagnose` fits the parameters of a model, searches the effects that it lacks, and compares
held-out records; :func:`text` writes the result for a person. The engine of :mod:`feltmb.gap` is
replaced by this one.
"""

from feltmb.diagnosis.options import Options
from feltmb.diagnosis.pipeline import diagnose
from feltmb.diagnosis.report import statement, text
from feltmb.diagnosis.result import (
    Channel,
    Named,
    ParameterValue,
    Reason,
    Result,
    SetOfCauses,
    Verdict,
)

__all__ = [
    "Channel",
    "Named",
    "Options",
    "ParameterValue",
    "Reason",
    "Result",
    "SetOfCauses",
    "Verdict",
    "diagnose",
    "statement",
    "text",
]
