"""What a model is, for its author: a class that simulates jobs of a record.

A subclass of :class:`Model` has parameters and one method, ``simulate``; a second one,
``sensitivities``, if it can compute derivatives. What is done with a model,
as writing it or running it in other processes, are functions beside it. Users of a model need none
of these names.
"""

from unmodeled.data.records import Array, InputMode, Integers, Reference, Role, evenly_spaced
from unmodeled.models.coordinates import Named
from unmodeled.models.elsewhere import running
from unmodeled.models.model import (
    Candidate,
    EffectKind,
    Jobs,
    Port,
    Ready,
    Sensitivity,
    SensitivityRequest,
)
from unmodeled.models.model import Effect as Effect
from unmodeled.models.model import Model as Model
from unmodeled.models.model import Parameter as Parameter
from unmodeled.models.model import State as State

# Those that users need too are listed in unmodeled.fit.
__all__ = [
    "Array",
    "Candidate",
    "EffectKind",
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
    "running",
]
