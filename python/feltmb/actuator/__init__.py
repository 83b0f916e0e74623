"""The key actuator of thesis chapter 5: alone, coupled to an action, and its design.

SI units, positive pressing. See ``docs/actuator.md``.
"""

from feltmb.actuator.compose import compose, stand_alone
from feltmb.actuator.model import (
    DAMPING,
    Actuator,
    ActuatorRun,
    load_actuator,
    packaged_actuators,
    simulate_actuator,
)

__all__ = [
    "DAMPING",
    "Actuator",
    "ActuatorRun",
    "compose",
    "load_actuator",
    "packaged_actuators",
    "simulate_actuator",
    "stand_alone",
]
