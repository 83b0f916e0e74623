"""Models of simulations that can be fitted: parameters with priors, effects, and derivatives."""

from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
from feltmb.fit.fmu import fmu_model
from feltmb.fit.inclusion import Including, including
from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.model import (
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
    State,
)
from feltmb.fit.ode import OdeModel
from feltmb.fit.simulator import Exposed, SimulatorModel

__all__ = [
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
    "Rate",
    "Ready",
    "Sensitivity",
    "SensitivityRequest",
    "SimulatorModel",
    "State",
    "fmu_model",
    "including",
]
