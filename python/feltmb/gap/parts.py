"""Parts of results: what the attributes of a report, a comparison or a blind test hold.

Users read them and never make them.
"""

from feltmb.gap.blind import OUTCOMES, Case
from feltmb.gap.compare import Compared, Hint
from feltmb.gap.result import (
    Cell,
    Channel,
    Event,
    Named,
    ParameterValue,
    Place,
    Reason,
    Result,
    SetOfCauses,
    Trace,
)

__all__ = [
    "OUTCOMES",
    "Case",
    "Cell",
    "Channel",
    "Compared",
    "Event",
    "Hint",
    "Named",
    "ParameterValue",
    "Place",
    "Reason",
    "Result",
    "SetOfCauses",
    "Trace",
]
