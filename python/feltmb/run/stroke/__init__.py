"""Strokes: force or motion of the finger or the motor as a function of time.

``load_stroke`` reads a packaged stroke, a TOML file or a CSV table. ``ramp_stroke``,
``pulse_stroke``, ``table_stroke``, ``motion_stroke``, ``torque_stroke`` and ``sequence`` make
strokes in Python.
"""

from __future__ import annotations

from feltmb.run.stroke.files import load_stroke, packaged_strokes, read_stroke_csv
from feltmb.run.stroke.strokes import (
    MOTORS,
    PRESCRIBED,
    Stroke,
    motion_stroke,
    pulse_stroke,
    ramp_stroke,
    sequence,
    table_stroke,
    torque_stroke,
)

__all__ = [
    "MOTORS",
    "PRESCRIBED",
    "Stroke",
    "load_stroke",
    "motion_stroke",
    "packaged_strokes",
    "pulse_stroke",
    "ramp_stroke",
    "read_stroke_csv",
    "sequence",
    "table_stroke",
    "torque_stroke",
]
