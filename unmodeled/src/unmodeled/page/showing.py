"""What a local page shows of a check and of a search: curves, sizes, progress."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from unmodeled.data import Array
from unmodeled.search.compare import Comparison
from unmodeled.search.progress import Progress, Stop
from unmodeled.style import reader_unit

#: Interval of the messages about progress [s].
EVERY = 0.3


class Curves(NamedTuple):
    """A channel of a record."""

    name: str
    unit: str
    both: Array
    """Measured, and simulated by the model as it is, shape (samples, 2) [``unit``]."""


class Drawn(NamedTuple):
    """A record with few samples."""

    name: str
    time: Array
    """[s]"""
    channels: tuple[Curves, ...]


def drawn(found: Comparison, samples: int, records: int) -> Iterator[Drawn]:
    """The first records of a check, with at most about so many samples."""
    for record in found.records[:records]:
        simulated = found.simulated[record.name]
        stride = max(1, record.samples // samples)
        channels = []
        for name in record.outputs:
            if name in simulated:
                factor, unit = reader_unit(record.sensors[name].unit)
                both = factor * np.column_stack([record.outputs[name], simulated[name]])[::stride]
                channels.append(Curves(name, unit, both))
        yield Drawn(record.name, record.time[::stride], tuple(channels))


def rows(found: Comparison) -> list[dict[str, Any]]:
    """Difference of each channel of each record, in units for people."""
    return [
        {
            "record": r.record,
            "channel": r.channel,
            "unit": reader_unit(r.unit)[1],
            "rms": reader_unit(r.unit)[0] * r.rms,
            "noise": r.in_noise if math.isfinite(r.in_noise) else None,
        }
        for r in found.rows
    ]


def teller(
    post: Callable[[dict[str, Any]], None], stopped: Callable[[], bool]
) -> Callable[[Progress], None]:
    """Function that posts the progress of a search from time to time, and ends it on demand."""
    last = [-math.inf]

    def tell(p: Progress) -> None:
        if stopped():
            raise Stop
        now = time.monotonic()
        if now - last[0] >= EVERY:
            last[0] = now
            left = p.left if math.isfinite(p.left) else None
            post({"stage": p.stage, "share": p.share, "left": left})

    return tell
