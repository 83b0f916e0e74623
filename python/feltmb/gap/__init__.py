"""Diagnosis of the gap between a model and measurements: where, which cause, how far it shrinks.

It knows time series and parameters, not any particular machine.
"""

from feltmb.data import Record, Sensor, StartPrior
from feltmb.fit import (
    Coordinate,
    Coupling,
    Effect,
    FunctionModel,
    Lanes,
    LinearModel,
    Model,
    OdeModel,
    Parameter,
    Port,
    Rate,
    Sensitivity,
    Simulated,
    State,
    Term,
    including,
)
from feltmb.gap.checks import DataChecks, check_records
from feltmb.gap.diagnose import Options, diagnose, fit_model
from feltmb.gap.findings import (
    Advice,
    Amended,
    ComponentRow,
    EventRow,
    GapRow,
    HowFar,
    LedgerCell,
    NotTested,
    Ranked,
    RankedSet,
    Verdict,
    Where,
    Which,
)
from feltmb.gap.planning import Plan, noncentrality, plan
from feltmb.gap.report import Report
from feltmb.gap.withhold import OUTCOMES, Withheld, WithheldCase, withhold

__all__ = [
    "OUTCOMES",
    "Advice",
    "Amended",
    "ComponentRow",
    "Coordinate",
    "Coupling",
    "DataChecks",
    "Effect",
    "EventRow",
    "FunctionModel",
    "GapRow",
    "HowFar",
    "Lanes",
    "LedgerCell",
    "LinearModel",
    "Model",
    "NotTested",
    "OdeModel",
    "Options",
    "Parameter",
    "Plan",
    "Port",
    "Ranked",
    "RankedSet",
    "Rate",
    "Record",
    "Report",
    "Sensitivity",
    "Sensor",
    "Simulated",
    "StartPrior",
    "State",
    "Term",
    "Verdict",
    "Where",
    "Which",
    "Withheld",
    "WithheldCase",
    "check_records",
    "diagnose",
    "fit_model",
    "including",
    "noncentrality",
    "plan",
    "withhold",
]
