"""Fits of any simulation model: parameters with priors, segments, and confidence intervals."""

from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
from feltmb.fit.fmu import fmu_model
from feltmb.fit.inclusion import Including, including
from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.model import (
    VARIABILITY,
    Candidate,
    Effect,
    EffectKind,
    Jobs,
    Model,
    Parameter,
    Port,
    Ready,
    Sensitivity,
    SensitivityRequest,
    Simulated,
    State,
)
from feltmb.fit.ode import OdeModel
from feltmb.fit.simulator import Exposed, SimulatorModel
from feltmb.fit.watch import Progress

__all__ = [
    "VARIABILITY",
    "Candidate",
    "Coordinate",
    "Coupling",
    "Effect",
    "EffectKind",
    "Exposed",
    "FunctionModel",
    "Including",
    "Jobs",
    "LinearModel",
    "Model",
    "Named",
    "OdeModel",
    "Parameter",
    "Port",
    "Progress",
    "Rate",
    "Ready",
    "Sensitivity",
    "SensitivityRequest",
    "Simulated",
    "SimulatorModel",
    "State",
    "fmu_model",
    "including",
]
