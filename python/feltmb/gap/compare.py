"""Compares a model with records before any fit: size of the difference, factor, delay, hints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record, join_records
from feltmb.data.joining import align_clocks
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit.model import Model, Ready
from feltmb.gap.beside import Compared, row_of, simulated
from feltmb.gap.figures import comparison
from feltmb.gap.hints import Hint, Runs, hints
from feltmb.gap.records import ready_records

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Comparison", "check", "compared", "join_by_motion", "refuse"]

#: Largest number of alignments of clocks; smallest standard deviation of their offset [s], because
#: a lighter or easier part is early, too.
ROUNDS, CLOCK_SD = 4, 2e-3


@dataclass(frozen=True, eq=False)
class Comparison:
    """Records and the tabulated model, simulated with the inputs of the records."""

    model: str
    rows: tuple[Compared, ...]
    hints: tuple[Hint, ...]
    records: tuple[Record, ...]
    """Records in the coordinates of the model."""
    simulated: Mapping[str, Mapping[str, Array]]
    """Outputs of the model by record and channel, at the times of the record."""
    notes: tuple[str, ...] = ()

    @property
    def frame(self) -> pd.DataFrame:
        """One row for each channel of each record."""
        import pandas as pd

        rows = [asdict(r) | {"share": r.share, "in_noise": r.in_noise} for r in self.rows]
        return pd.DataFrame(rows)

    @checked
    def plot(self) -> Figure:
        """Record and model over time, and their difference; one row of panels per channel."""
        shown = [
            (r, next(x for x in self.records if x.name == r.record), self.simulated[r.record])
            for r in self.rows
            if r.samples
        ]
        return comparison(
            f"{self.model}: before anything is fitted",
            [(r.channel, r.unit, x, y[r.channel], r.noise) for r, x, y in shown],
        )


@checked
def check(model: Model, records: Sequence[Record] | Record) -> Comparison:
    """Simulate the inputs of records with the tabulated parameters, and compare the outputs.

    No parameter is fitted. A start state that is not known is the one that fits the beginning of
    the record best.

    Parameters
    ----------
    model
        Model of the machine.
    records
        Measured runs; at least one.

    Raises
    ------
    DataError
        The records cannot be used with this model.
    InvalidParameter
        The model gives no finite outputs.
    """
    found = compared(ready_records(model, records))
    values = [y[1:] for run in found.simulated.values() for y in run.values()]
    if not found.hints and not any(np.isfinite(y).any() for y in values):
        raise InvalidParameter(
            f"model {model.name}: it gives no finite outputs with the tabulated parameters; are "
            "its rates per second?"
        )
    return found


@checked
def join_by_motion(
    first: Record,
    second: Record,
    model: Model | None = None,
    *,
    inputs: Mapping[str, str] | None = None,
) -> Record:
    """Join two records with two clocks: by the begin of the motion, and then by that of a model.

    Parameters
    ----------
    first, second, inputs
        As in :func:`feltmb.data.join_records`.
    model
        Model whose motion under the force is correlated with ``first``.
    """
    clocks, sd = align_clocks(first, second)
    offset = clocks.offset
    for _ in range(ROUNDS):
        if model is None:
            break
        made = join_records(first, second, same=[(0.0, offset)], inputs=inputs)
        delays = [r.delay for r in check(model, [made]).rows if np.isfinite(r.delay)]
        if not delays:
            break
        middle = sum(delays) / len(delays)
        offset -= middle
        sd = max(max(delays) - min(delays), CLOCK_SD, first.interval, second.interval)
        if abs(middle) < 0.1 * sd:
            break
    return join_records(first, second, same=[(0.0, offset)], inputs=inputs, same_sd=sd)


def compared(ready: Ready) -> Comparison:
    """Compare a prepared model with its records; see :func:`check`.

    Parameters
    ----------
    ready
        Model and records, from :func:`~feltmb.gap.records.ready_records`.
    """
    model = ready.model
    runs = [(r, simulated(model, r)) for r in ready.records]
    rows = tuple(
        row_of(r, name, y[name]) for r, y in runs for name in r.outputs if name in model.outputs
    )
    notes = [*ready.notes, *_not_finite(runs)]
    return Comparison(
        model.name, rows, hints(model, runs, rows), ready.records, {r.name: y for r, y in runs},
        tuple(notes),
    )  # fmt: skip


def refuse(found: Comparison) -> None:
    """Refuse records with a certain error.

    Parameters
    ----------
    found
        Comparison of the model with the records.

    Raises
    ------
    DataError
        A unit, sign, clock, or the order of columns is certainly wrong.
    """
    if sure := [h.text for h in found.hints if h.sure]:
        raise DataError(
            f"records: {'; '.join(sure)}. State it (--unit CHANNEL=UNIT, --column CHANNEL=COLUMN; "
            "in the TOML file unit, column, gain), or give parameters of the model their true "
            "tolerances"
        )


def _not_finite(runs: Runs) -> Iterator[str]:
    for record, outputs in runs:
        for name in [n for n in record.outputs if n in outputs]:
            if (v := ~np.isfinite(outputs[name])).any():
                yield (
                    f"{record.name}: the model gives no numbers for {name} at {v.sum()} of "
                    f"{v.size} samples, from {record.time[np.argmax(v)]:.4g} s on"
                )
