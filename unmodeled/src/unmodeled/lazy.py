"""Functions of a part above, by name: the figure of a run, the diagnosis of a model.

Methods of data and of models offer what a part above them computes. As with the plotting backend
of pandas, the part is imported when it is called, and the part below depends on its name only.
"""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["above"]


def above(part: str, function: str) -> Any:
    """Function of a part of feltmb: ``above("gap.diagnosis", "diagnose")``."""
    return getattr(importlib.import_module(f"feltmb.{part}"), function)
