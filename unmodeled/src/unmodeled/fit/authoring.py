"""For authors of models and adapters: what a class has that a fit or a diagnosis simulates.

A subclass of :class:`Model` simulates jobs (:class:`Jobs`) of a record with its own parameters,
magnitudes of effects and start states. Users of a model need none of these names.
"""

from unmodeled.data.records import Array, InputMode, Integers, Reference, Role, evenly_spaced
from unmodeled.fit.inclusion import Including
from unmodeled.models.coordinates import Named
from unmodeled.models.model import (
    Candidate,
    EffectKind,
    Jobs,
    Port,
    Ready,
    Sensitivity,
    SensitivityRequest,
)

__all__ = [
    "Array",
    "Candidate",
    "EffectKind",
    "Including",
    "InputMode",
    "Integers",
    "Jobs",
    "Named",
    "Port",
    "Ready",
    "Reference",
    "Role",
    "Sensitivity",
    "SensitivityRequest",
    "evenly_spaced",
]
