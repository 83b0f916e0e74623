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
Measurements
    action.diagnose(records), action.fit(records); gap: the diagnosis of mechanisms. The package
    unmodeled has the rest: read, Record, your own simulators, FMUs, MuJoCo models, equations
    adapters: mechanisms as models
Co-simulation
    export_fmu, export_felt (a contact law alone), export_felt_c (a contact law for C)
A mechanism as a web page
    export_page
Errors
    Error, below it InvalidParameter, DataError, ModelError, IntegrationError, FileExists

Everything is imported at its first use, so that ``import feltmb`` is fast.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

    from feltmb import adapters, contact, felt, fiber
    from feltmb._core import __version__
    from feltmb.action.regulate import Regulation, load_targets, regulate
    from feltmb.action.repetition import Repetition, repeat
    from feltmb.action.symptoms import symptom
    from feltmb.action.touch import Touch, touch
    from feltmb.action.wearing import Wear, wear
    from feltmb.errors import IntegrationError
    from feltmb.graphics.viewer import view
    from feltmb.live.page import export_page
    from feltmb.mechanism import Action, load_action, packaged_actions
    from feltmb.run.c_library import export_felt_c
    from feltmb.run.fmu import export_felt, export_fmu
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
    from unmodeled.errors import DataError, Error, FileExists, InvalidParameter, ModelError

__all__ = [
    "Action",
    "DataError",
    "Error",
    "Evaluation",
    "FileExists",
    "Gradient",
    "IntegrationError",
    "InvalidParameter",
    "Machine",
    "MachineState",
    "ModelError",
    "Regulation",
    "Repetition",
    "Run",
    "RunOptions",
    "Stroke",
    "Touch",
    "Wear",
    "__version__",
    "adapters",
    "contact",
    "evaluate",
    "export_felt",
    "export_felt_c",
    "export_fmu",
    "export_page",
    "felt",
    "fiber",
    "gap",
    "gradient",
    "load_action",
    "load_run",
    "load_stroke",
    "load_targets",
    "motion_stroke",
    "packaged_actions",
    "packaged_strokes",
    "pulse_stroke",
    "ramp_stroke",
    "read_stroke_csv",
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

#: module (below feltmb, or with its whole name) -> names that are imported at their first use
_LAZY = {
    "_core": "__version__",
    "mechanism": "Action load_action packaged_actions",
    "errors": "IntegrationError",
    "unmodeled.errors": "DataError Error FileExists InvalidParameter ModelError",
    "action.regulate": "Regulation load_targets regulate",
    "run.c_library": "export_felt_c",
    "run.fmu": "export_felt export_fmu",
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
    "live.page": "export_page",
}
_HOME = {name: module for module, names in _LAZY.items() for name in names.split()}

#: name -> module that is imported at its first use
_MODULES = {
    "actuator": "action.actuator",
    "adapters": "adapters",
    "animate": "graphics.animate",
    "batch": "run.batch",
    "contact": "contact",
    "felt": "felt",
    "fiber": "fiber",
    "gap": "gap",
    "graph": "graphics.graph",
    "parameters": "mechanism.parameters",
    "plot": "graphics.plot",
    "sensitivity": "run.sensitivity",
    "viewer": "graphics.viewer",
}


def __getattr__(name: str) -> object:
    """Import a name at its first use, for example ``feltmb.simulate`` or ``feltmb.fiber``."""
    import importlib

    if name in _HOME:
        home = _HOME[name]
        module = home if home.startswith("unmodeled.") else f"feltmb.{home}"
        value = getattr(importlib.import_module(module), name)
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
