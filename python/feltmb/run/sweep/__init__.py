"""Many simulations over parameters, strokes and options, resumable, in a fixed order.

:func:`sweep` is the function for users. A member is one simulation. Members run in one batch of the
core on threads, or on any ``concurrent.futures.Executor``. An executor only gets module-level
functions and plain data, so that processes and clusters can be used.
"""

from __future__ import annotations

from feltmb.run.sweep.axes import (
    Axis,
    apply_point,
    axis_values,
    grid_points,
)
from feltmb.run.sweep.members import Member, Outcome, run_member, run_members
from feltmb.run.sweep.progress import Progress, ProgressBar
from feltmb.run.sweep.table import SweepResult, sweep

__all__ = [
    "Axis",
    "Member",
    "Outcome",
    "Progress",
    "ProgressBar",
    "SweepResult",
    "apply_point",
    "axis_values",
    "grid_points",
    "run_member",
    "run_members",
    "sweep",
]
