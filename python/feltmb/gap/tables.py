"""Reads tables of a TOML file about a model, and reports all faults of the file at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from feltmb.errors import DataError, InvalidParameter
from feltmb.files import read_toml
from feltmb.units.quantity import fault_lines, fault_text, parse_scalar

__all__ = ["TableReader", "in_unit"]

T = TypeVar("T")


class TableReader:
    """Collects the faults of a file: names, then keys and kinds, then numbers.

    A fault of one entry does not hide those of another. If the model does not have the name of an
    entry, only the name is reported, because the unit of its numbers is unknown.
    """

    def __init__(self, path: str | Path, schema: type[BaseModel]):
        self.path = Path(path)
        self.raw: dict[str, Any] = read_toml(self.path)
        self.faults: list[str] = []
        self._schema = schema
        self._bad: set[tuple[Any, ...]] = set()

    def check(self, strange: Iterable[str]) -> None:
        """Collect names that the model does not have, and faults of the schema."""
        self.faults += strange
        try:
            self._schema.model_validate(self.raw)
        except ValidationError as error:
            self.faults += fault_lines(error, self._schema)
            self._bad = {tuple(item["loc"]) for item in error.errors(include_url=False)}

    def entries(self, table: str) -> Iterator[tuple[Any, str, dict[str, Any]]]:
        """Key or place, name in a message, and content of the tables below a name."""
        found = self.raw.get(table)
        rows: Iterable[tuple[Any, Any]] = found.items() if isinstance(found, dict) else ()
        for key, entry in enumerate(found) if isinstance(found, list) else rows:
            if isinstance(entry, dict):
                yield key, f"{table}.{key}", entry

    def number(
        self,
        where: str,
        entry: dict[str, Any],
        key: str,
        unit: str,
        missing: float = math.nan,
        hint: str = "",
    ) -> float:
        """A number in an SI unit; nan where it has a fault.

        ``missing``: where the entry does not say it; nan: the schema asks for it.
        """
        value = entry.get(key)
        if value is None:
            return missing
        wild = isinstance(value, float) and not math.isfinite(value)
        if wild or not isinstance(value, (int, float, str)):
            return math.nan  # a fault of the schema
        try:
            return in_unit(value, unit)
        except (ValueError, InvalidParameter) as error:
            self.faults.append(f"{where}.{key}: got {value!r}; {error}{hint}")
            return math.nan

    def made(
        self, place: tuple[Any, ...], where: str, kind: Callable[..., T], **values: Any
    ) -> T | None:
        """An object of an entry; None where the entry has a fault.

        ``place``: of the entry in the file; empty: the whole file.
        """
        told = any(isinstance(v, float) and math.isnan(v) for v in values.values())
        if told or (place and any(b[: len(place)] == place for b in self._bad)):
            return None
        try:
            return kind(**values)
        except InvalidParameter as error:
            self.faults.append(f"{where}{error}")
            return None

    def finish(self) -> None:
        """End the reading.

        Raises
        ------
        DataError
            All faults that were found.
        """
        if self.faults:
            raise DataError(fault_text(self.path.name, self.faults))


def in_unit(value: float | str, unit: str) -> float:
    """A number, or a text with a unit, in an SI unit; shares may be in percent.

    Raises
    ------
    ValueError
        It is none.
    """
    if isinstance(value, str) and value.strip().endswith("%") and unit == "1":
        return 0.01 * parse_scalar(value.strip().removesuffix("%").strip(), "1")
    return parse_scalar(value, unit)
