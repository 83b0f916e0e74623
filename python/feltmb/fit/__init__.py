"""Fits of anything that simulates: parameters with priors, windows, intervals."""

from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
from feltmb.fit.including import Including, including
from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.model import (
    FLOOR,
    Effect,
    EffectKind,
    Lanes,
    Model,
    Parameter,
    Port,
    Ready,
    Sensitivity,
    Simulated,
    State,
    Term,
)
from feltmb.fit.ode import OdeModel

__all__ = [
    "FLOOR",
    "Coordinate",
    "Coupling",
    "Effect",
    "EffectKind",
    "FunctionModel",
    "Including",
    "Lanes",
    "LinearModel",
    "Model",
    "Named",
    "OdeModel",
    "Parameter",
    "Port",
    "Rate",
    "Ready",
    "Sensitivity",
    "Simulated",
    "State",
    "Term",
    "including",
]
