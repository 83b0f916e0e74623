"""Diagnosis of the gap between a model and measurements, by one likelihood for imperfect models.

:func:`diagnose` fits the parameters of a model, searches the effects that it lacks, and compares
held-out records; its :class:`Report` is a text, a page, a table, and JSON. It knows time series and
parameters, not any particular machine.
"""

from feltmb.data import Record, Sensor, StartPrior
from feltmb.fit import (
    Candidate,
    Coordinate,
    Coupling,
    Effect,
    Equations,
    Exposed,
    FunctionModel,
    Jobs,
    LinearModel,
    Model,
    Parameter,
    Port,
    Rate,
    Sensitivity,
    SensitivityRequest,
    Simulator,
    State,
    including,
)
from feltmb.gap.beside import Compared
from feltmb.gap.blind import OUTCOMES, Case, Withheld, withhold
from feltmb.gap.compare import Comparison, check
from feltmb.gap.defaults import candidates
from feltmb.gap.diagnosis import diagnose, fit_model
from feltmb.gap.explained import Explained, explained_model
from feltmb.gap.hints import Hint
from feltmb.gap.measured import Measured, measured_toml, read_measured, with_measured
from feltmb.gap.options import Options
from feltmb.gap.progress import Progress, Stop
from feltmb.gap.report import Report
from feltmb.gap.result import (
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
    "OUTCOMES",
    "Candidate",
    "Case",
    "Cell",
    "Channel",
    "Compared",
    "Comparison",
    "Coordinate",
    "Coupling",
    "Effect",
    "Equations",
    "Event",
    "Explained",
    "Exposed",
    "FunctionModel",
    "Hint",
    "Jobs",
    "LinearModel",
    "Measured",
    "Model",
    "Named",
    "Options",
    "Parameter",
    "ParameterValue",
    "Place",
    "Port",
    "Progress",
    "Rate",
    "Reason",
    "Record",
    "Report",
    "Result",
    "Sensitivity",
    "SensitivityRequest",
    "Sensor",
    "SetOfCauses",
    "Simulator",
    "StartPrior",
    "State",
    "Stop",
    "Trace",
    "Verdict",
    "Withheld",
    "candidates",
    "check",
    "diagnose",
    "explained_model",
    "fit_model",
    "including",
    "measured_toml",
    "read_measured",
    "with_measured",
    "withhold",
]
