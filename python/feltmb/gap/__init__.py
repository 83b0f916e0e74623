"""Diagnosis of the gap between a model and measurements: where, which cause, how far it shrinks.

It knows time series and parameters, not any particular machine.
"""

from feltmb.data import Record, Sensor, StartPrior
from feltmb.fit import (
    Candidate,
    Coordinate,
    Coupling,
    Effect,
    FunctionModel,
    Jobs,
    LinearModel,
    Model,
    OdeModel,
    Parameter,
    Port,
    Rate,
    Sensitivity,
    Simulated,
    State,
    including,
)
from feltmb.gap.checks import DataChecks, check_records
from feltmb.gap.diagnose import Options, diagnose, fit_model
from feltmb.gap.findings import (
    Advice,
    ComponentRow,
    EventRow,
    GapRow,
    HowFar,
    LedgerCell,
    ModelWithEffects,
    NotTested,
    Ranked,
    RankedSet,
    Verdict,
    Where,
    Which,
)
from feltmb.gap.overlay import GapBefore, GapBeforeRow, check
from feltmb.gap.planning import Plan, noncentrality, plan
from feltmb.gap.report import Report
from feltmb.gap.withhold import OUTCOMES, Withheld, WithheldCase, withhold

__all__ = [
    "OUTCOMES",
    "Advice",
    "Candidate",
    "ComponentRow",
    "Coordinate",
    "Coupling",
    "DataChecks",
    "Effect",
    "EventRow",
    "FunctionModel",
    "GapBefore",
    "GapBeforeRow",
    "GapRow",
    "HowFar",
    "Jobs",
    "LedgerCell",
    "LinearModel",
    "Model",
    "ModelWithEffects",
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
    "Verdict",
    "Where",
    "Which",
    "Withheld",
    "WithheldCase",
    "check",
    "check_records",
    "diagnose",
    "fit_model",
    "including",
    "noncentrality",
    "plan",
    "withhold",
]
