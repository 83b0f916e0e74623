"""Multibody simulation of machines whose parts meet through felt.

Everything is imported when it is first used: ``import feltmb`` itself is quick.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
    from feltmb.sensitivity import Gradient, gradient
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
    from feltmb.viewer import view

__all__ = [
    "Action",
    "DataError",
    "Evaluation",
    "FeltmbError",
    "FileExists",
    "Gradient",
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
    "gradient",
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
    "view",
]

#: module -> what the package takes from it, on first use
_LAZY = {
    "_core": "__version__",
    "config": "Action load_action packaged_actions",
    "errors": "DataError FeltmbError FileExists IntegrationError InvalidParameter ModelError",
    "regulate": "Regulation load_targets regulate",
    "results": "Run load_run",
    "sensitivity": "Gradient gradient",
    "simulate": "Evaluation evaluate simulate",
    "stroke": "Stroke load_stroke motion_stroke packaged_strokes pulse_stroke ramp_stroke "
    "read_stroke_csv sequence table_stroke torque_stroke",
    "study": "StudyResult packaged_studies study",
    "sweep": "sweep",
    "touch": "Touch touch",
    "viewer": "view",
}
_HOME = {name: module for module, names in _LAZY.items() for name in names.split()}

#: Modules that are loaded when they are first asked for.
_MODULES = (
    "animate",
    "batch",
    "contact",
    "data",
    "felt",
    "fiber",
    "fit",
    "gap",
    "graph",
    "parameters",
    "plot",
    "sensitivity",
    "subjects",
    "units",
    "viewer",
)


class _Package(ModuleType):
    """The package; some of its functions bear the name of the module that they live in."""

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and _HOME.get(name) == name:
            value = getattr(value, name, value)  # the import of feltmb.sweep sets feltmb.sweep
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> object:
    """Load what is asked for on first use, ``feltmb.simulate`` or ``feltmb.fiber`` for example."""
    import importlib

    if name in _HOME:
        value = getattr(importlib.import_module(f"feltmb.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    if name in _MODULES:
        return importlib.import_module(f"feltmb.{name}")
    raise AttributeError(f"module 'feltmb' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, *_MODULES})
