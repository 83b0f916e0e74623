"""Virtual regulation: turns the screws of an action until it meets a technician's targets.

Steps A to F of thesis section 4.2.3. Each step measures one quantity, at rest, in a slow press or
after a simulated strike, and turns one screw by a bracketed one-dimensional solve. The steps have
the order of the targets file and are repeated until all targets are met simultaneously.
``load_targets`` reads the file, and :func:`regulate` performs the steps.
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
