"""Splits records into fitted and held-out records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Record, Role
from feltmb.errors import DataError, InvalidParameter

__all__ = ["split_records"]


def split_records(
    records: Sequence[Record],
    hold_out: Sequence[str] | str | None,
    *,
    masked: bool = False,
    left_out: Sequence[str] = (),
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Split records into fitted and held-out records.

    Records named in ``hold_out`` are held out; else those with the role "held_out"; else every
    third of three or more records. Otherwise every record is cut into five blocks (two if it has
    less than 100 samples), and every second block is held out. ``masked``: the records are not cut;
    both parts keep all times, and the outputs of the other blocks are removed. ``left_out``:
    reasons why records were removed before, for messages.
    """
    if isinstance(hold_out, str):
        hold_out = [hold_out]
    names = [r.name for r in records]
    why = "".join(f"; {note}" for note in left_out)
    if hold_out is not None:
        unknown = [h for h in hold_out if h not in names]
        if unknown:
            raise InvalidParameter(
                f"hold_out: no record {', '.join(unknown)}; there are {', '.join(names)}{why}"
            )
        held = [r for r in records if r.name in hold_out]
        kept = [r for r in records if r.name not in hold_out]
    else:
        held = [r for r in records if r.role == "held_out"]
        kept = [r for r in records if r.role != "held_out"]
        if not held and len(kept) >= 3:
            held = kept[2::3]
            kept = [r for r in kept if r not in held]
    if held and kept:
        return _with_values(kept, held)
    if not kept:
        raise InvalidParameter(f"hold_out: every record is held out, none is left to fit{why}")
    fit_parts: list[Record] = []
    held_parts: list[Record] = []
    for r in kept:
        blocks = 5 if r.samples >= 100 else 2
        edges = np.linspace(0, r.samples, blocks + 1).astype(int)
        if masked:
            block = np.searchsorted(edges, np.arange(r.samples), side="right") - 1
            for parts, odd, name in ((fit_parts, 0, "fit"), (held_parts, 1, "held-out")):
                outputs = {k: np.where(block % 2 == odd, v, np.nan) for k, v in r.outputs.items()}
                part_role: Role = "held_out" if odd else "fit"
                parts.append(replace(r, name=f"{r.name}[{name}]", outputs=outputs, role=part_role))
            continue
        for b in range(blocks):
            role: Role = "held_out" if b % 2 else "fit"
            part = r.cut(int(edges[b]), int(edges[b + 1]), f"{r.name}[{b + 1}/{blocks}]", role)
            if any(np.isfinite(y).any() for y in part.outputs.values()):
                (held_parts if b % 2 else fit_parts).append(part)
    return _with_values(fit_parts, held_parts)


def _with_values(
    kept: Sequence[Record], held: Sequence[Record]
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Check that both parts contain measured values."""
    for side, what in ((kept, "to fit"), (held, "to hold out")):
        if not any(np.isfinite(y).any() for r in side for y in r.outputs.values()):
            names = ", ".join(r.name for r in side) or "none is left"
            raise DataError(
                f"records {what} ({names}): no output has a measured value; "
                "hold out another record, or give a longer one"
            )
    return tuple(kept), tuple(held)
