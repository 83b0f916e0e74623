"""Diagnosis of the gap between a model and measurements, by one likelihood for imperfect models.

:func:`diagnose` fits the parameters of a model, searches the effects that it lacks, and compares
held-out records; its :class:`Report` is a text, a page, a table, and JSON. It knows time series and
parameters, not any particular machine.
"""

from unmodeled.blind import Withheld, withhold
from unmodeled.data import Record, Sensor, StartPrior
from unmodeled.diagnosis import diagnose, fit_model
from unmodeled.fit import Candidate as Candidate
from unmodeled.fit import (
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
from unmodeled.fit import Jobs as Jobs
from unmodeled.fit import Port as Port
from unmodeled.fit import Sensitivity as Sensitivity
from unmodeled.fit import SensitivityRequest as SensitivityRequest
from unmodeled.fit.measured import Measured, read_measured, with_measured
from unmodeled.library.defaults import candidates
from unmodeled.report import Explained, Report, explained_model
from unmodeled.search.compare import Comparison, check
from unmodeled.search.options import Options
from unmodeled.search.progress import Progress, Stop
from unmodeled.search.result import OUTCOMES as OUTCOMES
from unmodeled.search.result import Case as Case
from unmodeled.search.result import Cell as Cell
from unmodeled.search.result import Channel as Channel
from unmodeled.search.result import Compared as Compared
from unmodeled.search.result import Event as Event
from unmodeled.search.result import Hint as Hint
from unmodeled.search.result import Named as Named
from unmodeled.search.result import ParameterValue as ParameterValue
from unmodeled.search.result import Place as Place
from unmodeled.search.result import Reason as Reason
from unmodeled.search.result import Result as Result
from unmodeled.search.result import SetOfCauses as SetOfCauses
from unmodeled.search.result import Trace as Trace
from unmodeled.search.result import Verdict

# The other names are parts of results (unmodeled.search.result), or for authors of models
# (unmodeled.fit.authoring).
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
