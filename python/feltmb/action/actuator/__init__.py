"""The key actuator of thesis chapter 5: simulation alone, simulation with an action, and design.

SI units; pressing is positive. See ``docs/explanation/actuator.md``.
"""

from feltmb.action.actuator.composing import compose, stand_alone
from feltmb.action.actuator.matching import Match, MatchParameter, match
from feltmb.action.actuator.model import (
    DAMPING,
    Actuator,
    ActuatorRun,
    load_actuator,
    simulate_actuator,
)

__all__ = [
    "DAMPING",
    "Actuator",
    "ActuatorRun",
    "Match",
    "MatchParameter",
    "compose",
    "load_actuator",
    "match",
    "simulate_actuator",
    "stand_alone",
]
