"""Diagnosis of the gap between a model and measurements, by one likelihood for imperfect models.

:func:`diagnose` fits the parameters of a model, searches the effects that it lacks, and compares
held-out records; its :class:`Report` is a text, a page, a table, and JSON. It knows time series and
parameters, not any particular machine.
"""

from feltmb.data import Record, Sensor, StartPrior
from feltmb.fit import Candidate as Candidate
from feltmb.fit import (
    Coordinate,
    Coupling,
    Effect,
    Equations,
    Exposed,
    FunctionModel,
    LinearModel,
    Model,
    Parameter,
    Rate,
    Simulator,
    State,
    including,
)
from feltmb.fit import Jobs as Jobs
from feltmb.fit import Port as Port
from feltmb.fit import Sensitivity as Sensitivity
from feltmb.fit import SensitivityRequest as SensitivityRequest
from feltmb.gap.blind import Withheld, withhold
from feltmb.gap.compare import Comparison, check
from feltmb.gap.defaults import candidates
from feltmb.gap.diagnosis import diagnose, fit_model
from feltmb.gap.measured import Measured, read_measured, with_measured
from feltmb.gap.options import Options
from feltmb.gap.progress import Progress, Stop
from feltmb.gap.report import Explained, Report, explained_model
from feltmb.gap.result import OUTCOMES as OUTCOMES
from feltmb.gap.result import Case as Case
from feltmb.gap.result import Cell as Cell
from feltmb.gap.result import Channel as Channel
from feltmb.gap.result import Compared as Compared
from feltmb.gap.result import Event as Event
from feltmb.gap.result import Hint as Hint
from feltmb.gap.result import Named as Named
from feltmb.gap.result import ParameterValue as ParameterValue
from feltmb.gap.result import Place as Place
from feltmb.gap.result import Reason as Reason
from feltmb.gap.result import Result as Result
from feltmb.gap.result import SetOfCauses as SetOfCauses
from feltmb.gap.result import Trace as Trace
from feltmb.gap.result import Verdict

# The other names are parts of results (feltmb.gap.result), or for authors of models
# (feltmb.fit.authoring).
__all__ = [
    "Comparison",
    "Coordinate",
    "Coupling",
    "Effect",
    "Equations",
    "Explained",
    "Exposed",
    "FunctionModel",
    "LinearModel",
    "Measured",
    "Model",
    "Options",
    "Parameter",
    "Progress",
    "Rate",
    "Record",
    "Report",
    "Sensor",
    "Simulator",
    "StartPrior",
    "State",
    "Stop",
    "Verdict",
    "Withheld",
    "candidates",
    "check",
    "diagnose",
    "explained_model",
    "fit_model",
    "including",
    "read_measured",
    "with_measured",
    "withhold",
]
