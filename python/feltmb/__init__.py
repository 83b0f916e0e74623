"""Multibody simulation of machines whose parts meet through felt.

For example::

    import feltmb

    action = feltmb.load_action("steinway45")   # or the path of a TOML file
    run = feltmb.simulate(action, "forte")      # or a stroke of your own
    run.summary, run.events, run.to_dataframe(), run.plot()

All numbers are in SI units. ``help(feltmb.simulate)`` explains a function, ``feltmb --help`` the
command line, and the pages in ``docs`` everything else.

Mechanisms
    load_action, packaged_actions, Action, evaluate, Evaluation, parameters
Strokes
    ramp_stroke, pulse_stroke, table_stroke, motion_stroke, torque_stroke, sequence, load_stroke,
    read_stroke_csv, packaged_strokes, Stroke
Simulation
    simulate, RunOptions, Run, load_run, view, plot, animate; step by step: Machine, MachineState
Many simulations
    sweep, batch
Derivatives
    gradient, Gradient, sensitivity
Piano actions
    regulate, load_targets, Regulation, touch, Touch, repeat, Repetition, wear, Wear, symptom,
    actuator
Felt
    felt: materials, identification, audit; fiber: fiber networks; contact: contact laws
Your own models and measurements
    Simulator (a function), Equations, fmu, mujoco, each with fit(records) and diagnose(records);
    read, Record, records_from_frame; data: records and sensors; fit: models and priors; gap:
    diagnosis of the difference between a model and measurements; adapters: mechanisms as models
Co-simulation
    export_fmu
Errors
    Error, below it InvalidParameter, DataError, ModelError, IntegrationError, FileExists

Everything is imported at its first use, so that ``import feltmb`` is fast.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

    import unmodeled
    from feltmb import adapters, contact, felt, fiber
    from feltmb._core import __version__
    from feltmb.action.regulate import Regulation, load_targets, regulate
    from feltmb.action.repetition import Repetition, repeat
    from feltmb.action.symptoms import symptom
    from feltmb.action.touch import Touch, touch
    from feltmb.action.wearing import Wear, wear
    from feltmb.errors import IntegrationError
    from feltmb.graphics.viewer import view
    from feltmb.mechanism import Action, load_action, packaged_actions
    from feltmb.run.fmu import export_fmu
    from feltmb.run.machine import Machine, MachineState
    from feltmb.run.options import RunOptions
    from feltmb.run.results import Run, load_run
    from feltmb.run.sensitivity import Gradient, gradient
    from feltmb.run.simulate import Evaluation, evaluate, simulate
    from feltmb.run.stroke import (
        Stroke,
        load_stroke,
        motion_stroke,
        packaged_strokes,
        pulse_stroke,
        ramp_stroke,
        read_stroke_csv,
        sequence,
        table_stroke,
        torque_stroke,
    )
    from feltmb.run.sweep import sweep
    from unmodeled import data, fit
    from unmodeled.data import Record, read, records_from_frame
    from unmodeled.errors import DataError, Error, FileExists, InvalidParameter, ModelError
    from unmodeled.fit import Equations, Simulator, fmu, mujoco

__all__ = [
    "Action",
    "DataError",
    "Equations",
    "Error",
    "Evaluation",
    "FileExists",
    "Gradient",
    "IntegrationError",
    "InvalidParameter",
    "Machine",
    "MachineState",
    "ModelError",
    "Record",
    "Regulation",
    "Repetition",
    "Run",
    "RunOptions",
    "Simulator",
    "Stroke",
    "Touch",
    "Wear",
    "__version__",
    "adapters",
    "contact",
    "data",
    "evaluate",
    "export_fmu",
    "felt",
    "fiber",
    "fit",
    "fmu",
    "gap",
    "gradient",
    "load_action",
    "load_run",
    "load_stroke",
    "load_targets",
    "motion_stroke",
    "mujoco",
    "packaged_actions",
    "packaged_strokes",
    "pulse_stroke",
    "ramp_stroke",
    "read",
    "read_stroke_csv",
    "records_from_frame",
    "regulate",
    "repeat",
    "sequence",
    "simulate",
    "sweep",
    "symptom",
    "table_stroke",
    "torque_stroke",
    "touch",
    "view",
    "wear",
]

#: module -> its public names that the package imports at their first use
_LAZY = {
    "_core": "__version__",
    "mechanism": "Action load_action packaged_actions",
    "data": "Record read records_from_frame",
    "errors": "DataError Error FileExists IntegrationError InvalidParameter ModelError",
    "action.regulate": "Regulation load_targets regulate",
    "fit": "Equations Simulator fmu mujoco",
    "run.fmu": "export_fmu",
    "action.repetition": "Repetition repeat",
    "run.machine": "Machine MachineState",
    "run.options": "RunOptions",
    "run.results": "Run load_run",
    "run.sensitivity": "Gradient gradient",
    "run.simulate": "Evaluation evaluate simulate",
    "run.stroke": "Stroke load_stroke motion_stroke packaged_strokes pulse_stroke ramp_stroke "
    "read_stroke_csv sequence table_stroke torque_stroke",
    "run.sweep": "sweep",
    "action.symptoms": "symptom",
    "action.touch": "Touch touch",
    "action.wearing": "Wear wear",
    "graphics.viewer": "view",
}
_HOME = {name: module for module, names in _LAZY.items() for name in names.split()}

#: name -> module that is imported at its first use
_MODULES = {
    "actuator": "action.actuator",
    "adapters": "adapters",
    "animate": "graphics.animate",
    "batch": "run.batch",
    "contact": "contact",
    "data": "data",
    "felt": "felt",
    "fiber": "fiber",
    "fit": "fit",
    "gap": "gap",
    "graph": "graphics.graph",
    "parameters": "mechanism.parameters",
    "plot": "graphics.plot",
    "sensitivity": "run.sensitivity",
    "units": "units",
    "viewer": "graphics.viewer",
}


def __getattr__(name: str) -> object:
    """Import a name at its first use, for example ``feltmb.simulate`` or ``feltmb.fiber``."""
    import importlib

    if name in _HOME:
        value = getattr(importlib.import_module(f"feltmb.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    if name in _MODULES:
        return importlib.import_module(f"feltmb.{_MODULES[name]}")
    raise AttributeError(f"module 'feltmb' has no attribute {name!r}")


def __dir__() -> list[str]:
    names = {*globals(), *_HOME, *_MODULES}
    # help() prints everything that dir() lists, more than 1700 lines; the docstring is an index
    # instead.
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_globals.get("__name__") == "inspect":
        frame = frame.f_back
    if frame is not None and frame.f_globals.get("__name__") == "pydoc":
        names -= {*_HOME, "annotations", "TYPE_CHECKING"}
    return sorted(names)
