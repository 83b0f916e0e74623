"""Tables of many runs as labelled arrays."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from feltmb.errors import near_names, shown

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["Numbers", "missing_number", "renamed", "summary_unit", "table_to_dataset"]

#: Suffix of the name of a number in ``Run.summary`` -> its SI unit; other numbers are lengths.
ENDINGS = (
    ("_time", "s"),
    ("_duration", "s"),
    ("_speed", "m/s"),
    ("_force", "N"),
    ("steps", "1"),
    ("rhs", "1"),
)


#: Numbers of ``Run.summary`` in files of earlier versions -> their present names.
_EARLIER = {
    "max_string_force": "max_impact_force",
    "sampled_string_force": "sampled_impact_force",
    "string_contact_duration": "impact_duration",
}


def renamed(data: Any) -> Any:
    """Text or tables of a file, with the present names of the numbers of a summary."""
    if isinstance(data, Mapping):
        return {renamed(key): renamed(value) for key, value in data.items()}
    if isinstance(data, list):
        return [renamed(value) for value in data]
    if not isinstance(data, str):
        return data
    return re.sub(rf"\b({'|'.join(_EARLIER)})(?=_time\b|\b)", lambda m: _EARLIER[m[0]], data)


def missing_number(name: object, known: Iterable[str]) -> str:
    """Message about a number that a summary does not have, with its present name if it had one."""
    new = renamed(name)
    hint = f"; the present name is {new!r}" if new != name else near_names(name, known)
    return f"{shown(name)} is no number of this stroke{hint}; it has {', '.join(known) or 'none'}"


class Numbers(dict[str, float]):
    """Numbers of a run by name; a number that is missing is told with those that are there."""

    def __missing__(self, name: str) -> float:
        raise KeyError(missing_number(name, self))


def summary_unit(name: str) -> str:
    """SI unit of a number of ``Run.summary``."""
    return next((unit for end, unit in ENDINGS if name.endswith(end)), "m")


def table_to_dataset(
    table: pd.DataFrame, axes: Sequence[str], units: Mapping[str, str]
) -> xr.Dataset:
    """Convert a table to a dataset over its axes.

    Parameters
    ----------
    table
        One row for each run.
    axes
        Columns that become dimensions. The only dimension is ``member`` if the rows are not all
        combinations of their values, or if a value is neither a number nor text.
    units
        Units by column, for columns that have one.

    Returns
    -------
    Dataset
        Each variable and coordinate with a unit has the attribute ``units``.
    """
    import numpy as np
    import xarray as xr

    def attributes(name: str) -> dict[str, str]:
        return {"units": units[name]} if units.get(name) else {}

    plain = all(isinstance(v, (int, float, str)) for a in axes for v in table[a])
    levels = {a: list(dict.fromkeys(table[a])) for a in axes} if plain else {}
    shape = tuple(len(v) for v in levels.values())
    places = [
        tuple(level.index(row[a]) for a, level in levels.items())
        for row in (table.to_dict("records") if plain else [])
    ]
    grid = bool(places) and len(set(places)) == len(table) == math.prod(shape)
    numbers = {
        name: column.to_numpy(dtype=object if column.dtype == object else None)
        for name, column in table.items()
    }
    if not grid:
        return xr.Dataset(
            {
                str(n): ("member", v, attributes(str(n)))
                for n, v in numbers.items()
                if n not in axes
            },
            coords={
                str(a): ("member", numbers[a], attributes(a)) for a in numbers if a in set(axes)
            },
        )
    order = np.argsort([np.ravel_multi_index(place, shape) for place in places])
    return xr.Dataset(
        {
            str(n): (tuple(axes), values[order].reshape(shape), attributes(str(n)))
            for n, values in numbers.items()
            if n not in axes
        },
        coords={a: (a, level, attributes(a)) for a, level in levels.items()},
    )
