"""A case of the yardstick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from blind.marks import Truth
from unmodeled import Effect, Record

__all__ = ["Task"]


@dataclass(frozen=True)
class Task:
    """One case, as an engine gets it, and its truth."""

    model: Any
    effects: Sequence[Effect]
    records: Sequence[Record]
    truth: Truth
