"""Fits of anything that simulates: parameters with priors, windows, intervals."""

from feltmb.fit.coordinates import Coordinate, Coupling, Named, Rate
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
from feltmb.fit.ode import OdeNominal

__all__ = [
    "FLOOR",
    "Coordinate",
    "Coupling",
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
    "Rate",
    "Ready",
    "Sensitivity",
    "Simulated",
    "State",
    "Term",
    "including",
]
