"""Virtual regulation: turn the screws of an action until it does what a technician asks for.

Steps A to F of thesis section 4.2.3. Each step measures one thing, at rest, in a slow press or
after a simulated strike, and turns one screw, a bracketed one-dimensional solve. The steps follow
one another in the order of the targets file and are repeated until all hold at once.
``load_targets`` reads the file, :func:`regulate` does the work.
"""

from __future__ import annotations

from feltmb.action.regulate.targets import (
    MEASURES,
    Screw,
    Step,
    Targets,
    default_targets,
    load_targets,
    packaged_targets,
)
from feltmb.action.regulate.work import Regulation, Row, regulate

__all__ = [
    "MEASURES",
    "Regulation",
    "Row",
    "Screw",
    "Step",
    "Targets",
    "default_targets",
    "load_targets",
    "packaged_targets",
    "regulate",
]
