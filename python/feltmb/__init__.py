"""Multibody simulation of machines whose parts meet through felt."""

from feltmb._core import __version__
from feltmb.config import Action, load_action, packaged_actions
from feltmb.errors import (
    DataError,
    FeltmbError,
    FileExists,
    IntegrationError,
    InvalidParameter,
    ModelError,
)
from feltmb.regulate import Regulation, load_targets, regulate
from feltmb.results import Run, load_run
from feltmb.simulate import Evaluation, evaluate, simulate
from feltmb.stroke import (
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
from feltmb.study import StudyResult, packaged_studies, study
from feltmb.sweep import sweep
from feltmb.touch import Touch, touch

__all__ = [
    "Action",
    "DataError",
    "Evaluation",
    "FeltmbError",
    "FileExists",
    "IntegrationError",
    "InvalidParameter",
    "ModelError",
    "Regulation",
    "Run",
    "Stroke",
    "StudyResult",
    "Touch",
    "__version__",
    "evaluate",
    "load_action",
    "load_run",
    "load_stroke",
    "load_targets",
    "motion_stroke",
    "packaged_actions",
    "packaged_strokes",
    "packaged_studies",
    "pulse_stroke",
    "ramp_stroke",
    "read_stroke_csv",
    "regulate",
    "sequence",
    "simulate",
    "study",
    "sweep",
    "table_stroke",
    "torque_stroke",
    "touch",
]

#: Modules that are loaded when they are first asked for.
_MODULES = (
    "animate",
    "contact",
    "data",
    "felt",
    "fiber",
    "fit",
    "gap",
    "graph",
    "plot",
    "units",
    "viewer",
)


def __getattr__(name: str) -> object:
    """Load a module of the package on first use, ``feltmb.fiber`` for example."""
    if name in _MODULES:
        import importlib

        return importlib.import_module(f"feltmb.{name}")
    if name == "view":
        from feltmb.viewer import view

        return view
    raise AttributeError(f"module 'feltmb' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULES, "view"])
