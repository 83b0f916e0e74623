"""Interpretation of a run according to ``[reading]`` of its mechanism file."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

from pydantic import ValidationError

from feltmb.mechanism import Reading

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.run.results import Run

__all__ = ["reading_of", "row_unit", "striker_speed"]


def reading_of(run: Run) -> Reading:
    """``[reading]`` of the mechanism of a run; empty if the run does not contain it."""
    try:
        tables = tomllib.loads(str(run.provenance.get("toml", "")))
        return Reading.model_validate(tables.get("reading", {}))
    except (ValueError, ValidationError, RecursionError):
        return Reading()


def row_unit(run: Run, name: str) -> str:
    """SI unit of a row of ``[reading.rows]``."""
    output = reading_of(run).rows[name].output
    return "s" if output is None else run.unit(output)


def striker_speed(run: Run) -> npt.NDArray[np.float64] | None:
    """Speed of the striking point along its direction [m/s]; None if there is none."""
    striker = reading_of(run).striker
    if striker is None or f"{striker.point}.vx" not in run:
        return None
    length = (striker.direction[0] ** 2 + striker.direction[1] ** 2) ** 0.5
    x, y = (part / length for part in striker.direction)
    speed: npt.NDArray[np.float64] = x * run[f"{striker.point}.vx"] + y * run[f"{striker.point}.vy"]
    return speed
