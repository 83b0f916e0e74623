"""Functions of a part above, imported when they are called.

Methods of data and of models offer what a part above them computes. As with the plotting backend
of pandas, the part below depends on the name only.
"""

from __future__ import annotations

import importlib
from typing import Any


def lazy_import(place: str) -> Any:
    """Object at ``module:name``, such as ``"unmodeled.diagnosis:diagnose"``."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)
