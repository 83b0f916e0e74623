"""Diagnosis of the gap between a model and measurements: where, which cause, how far it shrinks.

It knows time series and parameters, not any particular machine.
"""

from feltmb.data import Record, Sensor, StartPrior
from feltmb.fit import (
    Candidate,
    Coordinate,
    Coupling,
    Effect,
    Exposed,
    FunctionModel,
    Jobs,
    LinearModel,
    Model,
    OdeModel,
    Parameter,
    Port,
    Rate,
    Sensitivity,
    SensitivityRequest,
    Simulated,
    SimulatorModel,
    State,
    including,
)
from feltmb.fit.limits import FurtherSensor, InputLimits, Limits, PartTest
from feltmb.gap.checks import DataChecks, check_records
from feltmb.gap.designs import Design, DesignedExperiment, design, draw_experiment
from feltmb.gap.diagnosis import diagnose, fit_model
from feltmb.gap.findings import (
    Advice,
    AsItIs,
    Calibrated,
    Closest,
    ComponentRow,
    EventRow,
    GapRow,
    HowFar,
    LedgerCell,
    ModelWithEffects,
    NotTested,
    Profile,
    Ranked,
    RankedSet,
    RecordError,
    VaryingLaw,
    Verdict,
    Where,
    Which,
)
from feltmb.gap.information import Belief
from feltmb.gap.limits import read_limits
from feltmb.gap.measured import Measured, measured_toml, read_measured, with_measured
from feltmb.gap.options import Options
from feltmb.gap.overlay import GapBefore, GapBeforeRow, check
from feltmb.gap.plan_files import write_design
from feltmb.gap.planning import Plan, plan
from feltmb.gap.report import Report
from feltmb.gap.sessions import Session, SessionStep, session
from feltmb.gap.withholding import OUTCOMES, Withheld, WithheldCase, withhold

__all__ = [
    "OUTCOMES",
    "Advice",
    "AsItIs",
    "Belief",
    "Calibrated",
    "Candidate",
    "Closest",
    "ComponentRow",
    "Coordinate",
    "Coupling",
    "DataChecks",
    "Design",
    "DesignedExperiment",
    "Effect",
    "EventRow",
    "Exposed",
    "FunctionModel",
    "FurtherSensor",
    "GapBefore",
    "GapBeforeRow",
    "GapRow",
    "HowFar",
    "InputLimits",
    "Jobs",
    "LedgerCell",
    "Limits",
    "LinearModel",
    "Measured",
    "Model",
    "ModelWithEffects",
    "NotTested",
    "OdeModel",
    "Options",
    "Parameter",
    "PartTest",
    "Plan",
    "Port",
    "Profile",
    "Ranked",
    "RankedSet",
    "Rate",
    "Record",
    "RecordError",
    "Report",
    "Sensitivity",
    "SensitivityRequest",
    "Sensor",
    "Session",
    "SessionStep",
    "Simulated",
    "SimulatorModel",
    "StartPrior",
    "State",
    "VaryingLaw",
    "Verdict",
    "Where",
    "Which",
    "Withheld",
    "WithheldCase",
    "check",
    "check_records",
    "design",
    "diagnose",
    "draw_experiment",
    "fit_model",
    "including",
    "measured_toml",
    "plan",
    "read_limits",
    "read_measured",
    "session",
    "with_measured",
    "withhold",
    "write_design",
]
