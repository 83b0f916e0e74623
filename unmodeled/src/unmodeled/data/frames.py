"""Records from tables of pandas, by the same rules as from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unmodeled.arguments import checked
from unmodeled.data.files import build_records
from unmodeled.data.formats import columns_of_frame
from unmodeled.data.mapping import clock_column
from unmodeled.data.records import Record
from unmodeled.data.sheet import InputSpec, OutputSpec, Sheet
from unmodeled.errors import DataError, InvalidParameter, near_names

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["record_from_frame", "records_from_frame"]


@checked
def records_from_frame(
    frame: pd.DataFrame,
    *,
    by: str,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    sigma: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    time: str = "",
) -> tuple[Record, ...]:
    """Records from a table of pandas that holds several runs.

    Parameters
    ----------
    frame
        Table; see :meth:`Record.from_frame`.
    by
        Column whose values name the runs.
    inputs, outputs, sigma, units, time
        As for :meth:`Record.from_frame`.

    Raises
    ------
    DataError
        A column is missing, or has another unit or no numbers.
    """
    _check_frame(frame, [by])
    parts = frame.groupby(by, sort=False)
    return tuple(
        record_from_frame(
            part.drop(columns=by),
            inputs=inputs,
            outputs=outputs,
            sigma=sigma or {},
            units=units or {},
            time=time,
            name=str(key),
        )
        for key, part in parts
    )


def record_from_frame(
    frame: pd.DataFrame,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    sigma: Mapping[str, float],
    units: Mapping[str, str],
    time: str,
    name: str,
) -> Record:
    """One record; see :meth:`Record.from_frame`."""
    columns = columns_of_frame(frame, time)
    _check_frame(frame, [])
    known = list(columns.values)
    clock = clock_column(columns, time)
    given = {**{n: "input" for n in inputs}, **{n: "output" for n in outputs}}
    if missing := [f"{kind} {n}{near_names(n, known)}" for n, kind in given.items()
                   if n not in known]:  # fmt: skip
        raise DataError(f"{name}: no column {', '.join(missing)}; there are {columns}")
    shown = list(outputs) or [n for n in known if n not in inputs and n != clock]
    for what, table in (("sigma", sigma), ("units", units)):
        for n in table:
            if n not in (*shown, *inputs):
                raise InvalidParameter(
                    f"{name}: {what} of {n}, which is no column{near_names(n, known)}"
                )
    driven = {n: InputSpec(sigma=sigma.get(n, 0.0), unit=units.get(n, "")) for n in inputs}
    seen = {n: OutputSpec(sigma=sigma.get(n), unit=units.get(n, "")) for n in shown}
    sheet = Sheet(name=name, time=time, inputs=driven, outputs=seen)
    return build_records(Path(name), sheet, columns, {}, guessed=True)[0]


def _check_frame(frame: Any, wanted: Sequence[str]) -> None:
    if not hasattr(frame, "columns") or not hasattr(frame, "groupby"):
        raise InvalidParameter(f"frame: got {type(frame).__name__}, expected a DataFrame of pandas")
    for name in wanted:
        if name not in frame.columns:
            known = [str(c) for c in frame.columns]
            raise DataError(
                f"frame: no column {name}{near_names(name, known)}; there are {', '.join(known)}"
            )
