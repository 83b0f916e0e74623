"""Tables of many runs as labeled arrays."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from unmodeled.errors import near_names, shown

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

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
    plain = all(isinstance(v, (int, float, str)) for a in axes for v in table[a])
    order = {a: list(dict.fromkeys(table[a])) for a in axes} if plain else {}
    data: xr.Dataset
    if order and len(table.drop_duplicates(axes)) == len(table) == math.prod(
        map(len, order.values())
    ):
        data = table.set_index(list(axes)).to_xarray()
        data = data.isel({a: data.get_index(a).get_indexer(v) for a, v in order.items()})
    else:
        rows = table.reset_index(drop=True).rename_axis("member")
        data = rows.to_xarray().set_coords(list(axes)).drop_vars("member")
    for name, variable in data.variables.items():
        if units.get(str(name)):
            variable.attrs["units"] = units[str(name)]
    return data
