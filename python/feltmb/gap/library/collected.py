"""The effects of a coordinate that the modules of this folder define."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Callable
from pathlib import Path

from feltmb.fit import Effect
from feltmb.gap.library.forces import Part, Scales

__all__ = ["makers"]


@functools.cache
def makers() -> tuple[Callable[[Part, Scales], Effect], ...]:
    """Functions that make the effects of a coordinate: every ``FOR_COORDINATE`` of this folder."""
    found: list[Callable[[Part, Scales], Effect]] = []
    for module in sorted(info.name for info in pkgutil.iter_modules([str(Path(__file__).parent)])):
        found += getattr(importlib.import_module(f"{__package__}.{module}"), "FOR_COORDINATE", ())
    return tuple(found)
