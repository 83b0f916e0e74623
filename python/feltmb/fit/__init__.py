"""Models of simulations that can be fitted: parameters with priors, effects, and derivatives."""

from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
from feltmb.fit.equations import Equations
from feltmb.fit.fmi import fmu
from feltmb.fit.inclusion import Including, including
from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.mjcf import mujoco
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
from feltmb.fit.priors import Exposed
from feltmb.fit.simulator import Simulator

__all__ = [
    "Candidate",
    "Coordinate",
    "Coupling",
    "Effect",
    "EffectKind",
    "Equations",
    "Exposed",
    "FunctionModel",
    "Including",
    "Jobs",
    "LinearModel",
    "Model",
    "Named",
    "Parameter",
    "Port",
    "Rate",
    "Ready",
    "Sensitivity",
    "SensitivityRequest",
    "Simulator",
    "State",
    "fmu",
    "including",
    "mujoco",
]
