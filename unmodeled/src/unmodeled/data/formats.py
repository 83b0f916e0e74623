"""Tables of other programs: Parquet and Feather by pandas, JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unmodeled.data.records import Array
from unmodeled.data.series import MOST_NUMBERS, Columns, limit_text
from unmodeled.data.tables import read_number
from unmodeled.errors import DataError, shortened
from unmodeled.files import (
    LARGEST_JSON,
    LARGEST_TABLE,
    is_file,
    plain_text,
    read_input,
    read_json,
    read_text,
)
from unmodeled.units import split_column

if TYPE_CHECKING:
    import pandas as pd

#: Columns of LeRobot that only count, beside the number of the episode.
_LEROBOT_COUNTERS = ("frame_index", "index", "task_index")
#: Largest number of columns of one array.
MOST_COLUMNS = 256


@contextmanager
def reading(path: Path, kind: str, package: str = "", extra: str = "") -> Iterator[None]:
    """A block in which a package reads a file.

    Raises
    ------
    DataError
        The package is missing, or raises any exception: none documents those of damaged files.
    """
    try:
        yield
    except DataError:
        raise
    except ImportError:
        raise DataError(
            f"{path}: to read {path.suffix}, the package {package} is needed: pip install {package}"
            f" (extra {extra!r} of unmodeled)"
        ) from None
    except Exception as error:
        reason = shortened(plain_text(str(error) or type(error).__name__), 200)
        raise DataError(f"{path}: cannot be read as {kind}: {reason}") from None


def add_block(
    columns: Columns, name: str, values: Array, features: Mapping[str, list[str]] | None = None
) -> bool:
    """Add the columns of an array, (n, k), as ``name.0``, or with given names; False: too many."""
    width = values.shape[1]
    if not 1 <= width <= MOST_COLUMNS:
        return False
    parts = (features or {}).get(name)
    parts = parts if parts and len(parts) == width else [str(j) for j in range(width)]
    for part, column in zip(parts, values.T, strict=True):
        columns.values[f"{name}.{part}"] = np.array(column, dtype=np.float64)
    return True


# ---------------------------------------------------------------- Parquet and Feather


def read_frame(path: Path) -> Columns:
    """Columns of a Parquet or Feather file; a column of lists of one length becomes several.

    The names of their parts are those of ``meta/info.json`` of a LeRobot data set.
    """
    import pandas as pd

    read = pd.read_feather if path.suffix.lower() == ".feather" else pd.read_parquet
    data = io.BytesIO(read_input(path, most=LARGEST_TABLE))
    with reading(path, path.suffix[1:], "pyarrow", "parquet"):
        frame = read(data)
    if frame.size > MOST_NUMBERS:
        raise DataError(f"{path}: {frame.size} numbers; {limit_text()}")
    try:
        return columns_of_frame(frame, features=_features(path))
    except DataError as error:
        raise DataError(f"{path}: {error}") from None


def columns_of_frame(
    frame: pd.DataFrame, time: str = "", features: Mapping[str, list[str]] | None = None
) -> Columns:
    """Columns of numbers with the units of their headings; an index of times is the clock.

    Dates become seconds from the first. A column of lists of one length becomes several columns,
    with the names of ``features``.
    """
    columns = Columns()
    parts = [(str(c), frame.iloc[:, j]) for j, c in enumerate(frame.columns)]
    index, headings = frame.index, [heading for heading, _ in parts]
    if index.nlevels == 1 and (index.name is not None or index.dtype.kind in "mMf"):
        clock = str(index.name or time or "time")
        parts[:0] = [] if clock in headings else [(clock, index.to_series())]
    counted = _LEROBOT_COUNTERS if "episode_index" in frame else ()
    heading_of: dict[str, str] = {}
    for heading, series in parts:
        name, unit = split_column(plain_text(heading))
        if name in heading_of:
            raise DataError(
                f"column {name} is there twice ({heading_of[name]!r} and {heading!r}): rename one"
            )
        heading_of[name] = heading
        kind = series.dtype.kind
        if name in counted:
            columns.left_out[name] = "a counter"
        elif kind in "mM":
            since = series - series.iloc[0] if kind == "M" and series.size else series
            columns.values[name], columns.units[name] = since.dt.total_seconds().to_numpy(), "s"
        elif kind in "iufb":
            columns.values[name] = series.to_numpy(dtype=np.float64, na_value=np.nan)
        elif not _add_block(columns, name, series, features):
            columns.add_cells(name, *_cells_of(series), unit)
        if name in columns.values and unit:
            columns.units.setdefault(name, unit)
            columns.headings[name] = heading
    return columns


def _add_block(
    columns: Columns, name: str, series: pd.Series[Any], features: Mapping[str, list[str]] | None
) -> bool:
    """Add the parts of a column of lists of one length."""
    if not all(isinstance(v, list | tuple | np.ndarray) for v in series):
        return False
    try:
        block = np.array([np.ravel(v) for v in series], dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return block.ndim == 2 and add_block(columns, name, block, features)


def _cells_of(series: pd.Series[Any]) -> tuple[Array, dict[int, str]]:
    """Numbers of a column of any objects, and the cells that are no numbers by row."""
    values, words = np.full(series.size, np.nan), {}
    for i, cell in enumerate(series):
        text = str(cell)
        real = cell.real if isinstance(cell, complex) and cell.imag == 0.0 else cell
        try:
            number = read_number(text) if isinstance(cell, str) else float(real)
        except (TypeError, ValueError):
            number = float("nan") if text in ("None", "NaT", "<NA>") else None
        if number is None:
            words[i] = text
        else:
            values[i] = number
    return values, words


def _features(path: Path) -> dict[str, list[str]]:
    """Names of the parts of the columns of a LeRobot data set."""
    for folder in list(path.absolute().parents)[:4]:
        listed = folder / "meta" / "info.json"
        if is_file(listed):
            info = read_json(listed)
            features = info.get("features") if isinstance(info, dict) else None
            if not isinstance(features, dict):
                return {}
            named = {k: v.get("names") for k, v in features.items()}
            flat = {k: next(iter(v.values())) if isinstance(v, dict) else v
                    for k, v in named.items() if v}  # fmt: skip
            return {k: list(map(str, v)) for k, v in flat.items() if isinstance(v, list)}
    return {}


# ---------------------------------------------------------------- JSON


def read_json_table(path: Path) -> Columns:
    """Columns of a JSON file: a list of records, or a list of values for each name.

    Records in records have names such as ``arm.angle``. ``.jsonl`` has a record in each line.
    """
    import pandas as pd

    content: Any
    if path.suffix.lower() == ".jsonl":
        lines = read_text(path, most=LARGEST_JSON).splitlines()
        with reading(path, "JSON"):
            content = [json.loads(line) for line in lines if line.strip()]
    else:
        content = read_json(path)
    with reading(path, "JSON"):
        if isinstance(content, dict):
            lists = {k: v for k, v in content.items() if isinstance(v, list)}
            content = next((v for v in lists.values() if v and isinstance(v[0], dict)), lists)
        if isinstance(content, dict):
            longest = max(map(len, content.values()), default=0)
            table = {k: v for k, v in content.items() if len(v) == longest}
        else:
            table = _of_records(path, content)
        return columns_of_frame(pd.DataFrame(table))


def _of_records(path: Path, content: Any) -> dict[str, list[Any]]:
    if not (isinstance(content, list) and content and all(isinstance(r, dict) for r in content)):
        raise DataError(f"{path}: expected a list of records, or lists by name")
    rows = [dict(_leaves(r)) for r in content]
    names = dict.fromkeys(n for row in rows for n in row)
    if len(names) * len(rows) > MOST_NUMBERS:
        raise DataError(f"{path}: {len(rows)} records of {len(names)}; {limit_text()}")
    return {n: [row.get(n) for row in rows] for n in names}


def _leaves(record: Mapping[str, Any], name: str = "") -> Iterator[tuple[str, Any]]:
    """Values of a record and of the records in it, by name."""
    for key, value in record.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{name}{key}.")
        else:
            yield f"{name}{key}", value
