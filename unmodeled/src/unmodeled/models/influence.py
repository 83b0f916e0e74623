"""Influence of the numbers of a model on the outputs over a record, from one pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch

from unmodeled.data import Array, Record
from unmodeled.models.model import Model


@dataclass(frozen=True, eq=False)
class Influence:
    """How a number of a model acts."""

    name: str
    by: Array
    """Derivatives of the outputs by the number, (n, ny)."""
    law: str
    """What its force follows: "the speed"."""
    shown_by: str
    """Motions that show it: "motions at several constant speeds"."""


@singledispatch
def influences(model: Model, record: Record) -> Sequence[Influence]:
    """Influence of each number on a record; (): the model knows none without a run for each."""
    del model, record
    return ()
