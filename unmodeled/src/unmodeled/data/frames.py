"""Records from tables of pandas, polars, PyArrow, or arrays by name, by the rules of files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data.files import build_records
from unmodeled.data.formats import columns_of_frame
from unmodeled.data.mapping import clock_column
from unmodeled.data.records import Record
from unmodeled.data.sheet import InputSpec, OutputSpec, Sheet
from unmodeled.errors import DataError, InvalidParameter, near_names
from unmodeled.units.quantity import fault_text

if TYPE_CHECKING:
    import pandas as pd


@checked
def records_from_frame(
    frame: Any,
    *,
    by: str,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    sigma: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    time: str = "",
) -> tuple[Record, ...]:
    """Records from a table that holds several runs.

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

    Examples
    --------
    Two runs in one table, positions in m:

    >>> import pandas as pd
    >>> from unmodeled import records_from_frame
    >>> times = [0.0, 0.1, 0.2, 0.0, 0.1, 0.2]
    >>> frame = pd.DataFrame(
    ...     {"run": [*"aaabbb"], "time": times, "x": [0.0, 0.1, 0.2, 0.0, 0.2, 0.4]}
    ... )
    >>> records = records_from_frame(frame, by="run", outputs=["x"], units={"x": "m"})
    >>> [record.outputs["x"].tolist() for record in records]
    [[0.0, 0.1, 0.2], [0.0, 0.2, 0.4]]
    """
    frame = as_frame(frame, "frame")
    names = [str(c) for c in frame.columns]
    if by not in names:
        raise DataError(f"frame: no column {by}{near_names(by, names)}; there are "
                        f"{', '.join(names)}")  # fmt: skip
    empty = frame[by].isna().to_numpy()
    if empty.any():
        raise DataError(f"frame: row {int(empty.argmax()) + 1}: {by} is missing, which names runs")
    parts = frame.groupby(by, sort=False, observed=True)
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
    frame: Any,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    sigma: Mapping[str, float],
    units: Mapping[str, str],
    time: str,
    name: str,
) -> Record:
    """One record; see :meth:`Record.from_frame`."""
    frame = as_frame(frame, name)
    if len(frame) < 2:
        raise DataError(f"{name}: {len(frame)} rows, expected at least 2")
    try:
        columns = columns_of_frame(frame, time)
    except DataError as error:
        raise DataError(f"{name}: {error}") from None
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
    faults = columns.faults([clock, *inputs], complete=True)
    if faults := [*faults, *columns.faults(shown)]:
        raise DataError(fault_text(name, faults, most=10))
    driven = {n: InputSpec(sigma=sigma.get(n, 0.0), unit=units.get(n, "")) for n in inputs}
    specs = {n: OutputSpec(sigma=sigma.get(n), unit=units.get(n, "")) for n in shown}
    sheet = Sheet(name=name, time=time, inputs=driven, outputs=specs)
    return build_records(Path(name), sheet, columns, {}, guessed=True)[0]


def _of_arrays(given: Mapping[Any, Any], what: str) -> pd.DataFrame:
    import pandas as pd

    sizes = {str(k): len(v) if np.ndim(v) else 1 for k, v in given.items()}
    if len({*sizes.values()}) > 1:
        listed = ", ".join(f"{k} {n}" for k, n in sizes.items())
        raise DataError(f"{what}: the columns have different numbers of values: {listed}")
    return pd.DataFrame({k: list(v) if np.ndim(v) > 1 else v for k, v in given.items()})


def as_frame(given: Any, what: str) -> pd.DataFrame:
    """A table as a DataFrame of pandas, with one heading for each column.

    Levels of headings are joined by a point; named levels of an index become columns.

    ``what``: name for messages.

    Raises
    ------
    InvalidParameter, DataError
        It is no table, or its columns differ in their length or have one name.
    """
    import pandas as pd

    frame = given
    if isinstance(given, Mapping) and not hasattr(given, "to_dataframe"):
        frame = _of_arrays(given, what)
    elif not isinstance(given, pd.DataFrame):
        make = getattr(given, "to_pandas", None) or getattr(given, "to_dataframe", None)
        try:
            frame = None if make is None else make()
        except ImportError as error:
            raise InvalidParameter(f"{what}: {type(given).__name__}: {error}") from None
    if not isinstance(frame, pd.DataFrame):
        raise InvalidParameter(
            f"{what}: got {type(given).__name__}, expected a DataFrame of pandas or polars, or "
            'arrays by name, such as {"time [s]": t, "x [m]": x}'
        )
    if frame.columns.nlevels > 1:
        frame = frame.set_axis([".".join(filter(None, map(str, c))) for c in frame.columns], axis=1)
    if frame.index.nlevels > 1:
        named = [n for n in frame.index.names if n is not None and n not in frame.columns]
        frame = frame.reset_index(level=named).reset_index(drop=True)
    names = [str(c) for c in frame.columns]
    if doubled := [n for n in dict.fromkeys(names) if names.count(n) > 1]:
        raise DataError(f"{what}: column {', '.join(doubled)} is there twice: rename one of them")
    return frame
