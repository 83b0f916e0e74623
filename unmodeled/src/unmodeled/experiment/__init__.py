"""Experiments: what the next record would tell about parameters and causes, and which one to make.

The information of a planned record follows from the derivatives of the model, as in a diagnosis.
"""

from unmodeled.experiment.designs import (
    Design,
    DesignedExperiment,
    Help,
    Visible,
    design,
)
from unmodeled.experiment.files import design_json, reasons, write_design
from unmodeled.experiment.information import Belief
from unmodeled.experiment.limits import read_limits
from unmodeled.fit.limits import InputLimits, Limits, PartTest

__all__ = [
    "Belief",
    "Design",
    "DesignedExperiment",
    "Help",
    "InputLimits",
    "Limits",
    "PartTest",
    "Visible",
    "design",
    "design_json",
    "read_limits",
    "reasons",
    "write_design",
]
