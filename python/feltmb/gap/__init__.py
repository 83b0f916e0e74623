"""Diagnosis of the gap between a model and measurements: where, which cause, how far it shrinks.

It knows time series and parameters, not any particular machine.
"""

from feltmb.data import Record, Sensor, StartPrior
from feltmb.fit import (
    Coordinate,
    Coupling,
    Effect,
    FunctionNominal,
    Lanes,
    LinearNominal,
    Nominal,
    OdeNominal,
    Parameter,
    Port,
    Rate,
    Sensitivity,
    Simulated,
    State,
    Term,
    including,
)
from feltmb.gap.diagnose import Options, diagnose, fit_nominal
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
from feltmb.gap.foresee import Foresight, foresee, noncentrality
from feltmb.gap.gates import Gates, check_records
from feltmb.gap.report import Report
from feltmb.gap.withhold import OUTCOMES, Withheld, WithheldCase, withhold

__all__ = [
    "OUTCOMES",
    "Advice",
    "Amended",
    "ComponentRow",
    "Coordinate",
    "Coupling",
    "Effect",
    "EventRow",
    "Foresight",
    "FunctionNominal",
    "GapRow",
    "Gates",
    "HowFar",
    "Lanes",
    "LedgerCell",
    "LinearNominal",
    "Nominal",
    "NotTested",
    "OdeNominal",
    "Options",
    "Parameter",
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
    "fit_nominal",
    "foresee",
    "including",
    "noncentrality",
    "withhold",
]
