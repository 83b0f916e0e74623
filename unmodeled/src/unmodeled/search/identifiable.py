"""What the motions of records cannot tell apart, from one pass of derivatives before a search."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.errors import shortened
from unmodeled.models.influence import Influence, influences
from unmodeled.models.model import Model, prior_jobs
from unmodeled.search.records import noise_of_channel
from unmodeled.search.score import ALIKE


def told_apart(model: Model, records: Sequence[Record], seconds: float) -> tuple[str, ...]:
    """Sentences about numbers of the model that act alike, or not at all; (): nothing is known.

    ``seconds``: limit of the processor time; longer records are cut, or left out.
    """
    begin = time.process_time()
    first = records[0].cut(0, max(30, records[0].samples // 10))
    model.simulate(first, prior_jobs(model, first))
    # A pass differentiates by states and inputs, of which there are about half as many.
    if (time.process_time() - begin) * len(model.effects) > 2.0 * seconds:
        return (f"left out, because it would take more than {seconds:g} s: which numbers these "
                "motions cannot tell apart",)  # fmt: skip
    if not (found := influences(model, first)):
        return ()
    spent = time.process_time() - begin
    share = (seconds - spent) * first.samples / (spent * sum(r.samples for r in records))
    parts = [r.cut(0, max(first.samples, int(min(1.0, share) * r.samples))) for r in records]
    columns = np.concatenate([_in_noise(model, p, influences(model, p)) for p in parts])
    part = f" (from the first {share:.0%} of each record)" * (share < 1.0)
    return tuple(f"{text}{part}" for text in _sentences(found, columns))


def _in_noise(model: Model, record: Record, found: Sequence[Influence]) -> Array:
    """Derivatives of the measured outputs in units of their noise, (samples, numbers)."""
    own = []
    for k, name in enumerate(model.outputs):
        if name in record.outputs:
            there = np.isfinite(record.outputs[name])
            own.append(np.array([f.by[there, k] for f in found]).T
                       / (noise_of_channel(record, name).sigma or 1.0))  # fmt: skip
    return np.concatenate(own)


def _sentences(found: Sequence[Influence], columns: Array) -> Iterator[str]:
    size = np.linalg.norm(columns, axis=0)
    shown = size > np.finfo(float).eps * size.max(initial=0.0)
    if not shown.all():
        silent = ", ".join(f.name for f, yes in zip(found, shown, strict=True) if not yes)
        yield f"{shortened(silent, 200)}: these motions do not show them"
    told: dict[str, list[str]] = {}
    for group in _alike(columns[:, shown] / size[shown]):
        some = [found[k] for k in np.flatnonzero(shown)[group]]
        told.setdefault(_way(some), []).append(" and ".join(f.name for f in some))
    for way, names in told.items():
        yield f"{shortened('; '.join(names), 300)} act alike in these motions: {way}"
    if not told:
        yield f"these motions tell all {shown.sum()} numbers apart that they show"


def _alike(columns: Array) -> list[list[int]]:
    """Largest groups of columns of length 1 that are nearly parallel to one of them."""
    rows = np.abs(columns.T @ columns) > ALIKE
    groups = {frozenset(map(int, np.flatnonzero(row))) for row in rows}
    largest = [g for g in groups if len(g) > 1 and not any(g < other for other in groups)]
    return sorted(sorted(g) for g in largest)


def _way(alike: Sequence[Influence]) -> str:
    """Which motions tell numbers apart."""
    laws = dict.fromkeys((f.law, f.shown_by) for f in alike)
    if len(laws) == 1:
        return f"no motion tells them apart, because they follow {alike[0].law}"
    return f"{' and '.join(by for _, by in laws)} would tell them apart"
