"""Fits of anything that simulates: parameters with priors, windows, intervals."""

from feltmb.fit.including import Including, including
from feltmb.fit.linear import FunctionNominal, LinearNominal
from feltmb.fit.nominal import (
    FLOOR,
    Effect,
    EffectKind,
    Lanes,
    Nominal,
    Parameter,
    Port,
    Ready,
    Sensitivity,
    Simulated,
    State,
    Term,
)
from feltmb.fit.ode import Coordinate, Named, OdeNominal

__all__ = [
    "FLOOR",
    "Coordinate",
    "Effect",
    "EffectKind",
    "FunctionNominal",
    "Including",
    "Lanes",
    "LinearNominal",
    "Named",
    "Nominal",
    "OdeNominal",
    "Parameter",
    "Port",
    "Ready",
    "Sensitivity",
    "Simulated",
    "State",
    "Term",
    "including",
]
