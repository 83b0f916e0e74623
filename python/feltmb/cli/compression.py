"""Files of compression tests on the command line: their options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import click

from unmodeled.cli.options import fields_of, option, pairs

__all__ = ["TEST", "TestFile"]


@dataclass(frozen=True)
class TestFile:
    """How the file of a compression test is read."""

    __test__ = False

    columns: tuple[str, ...] = option(
        "Column of displacement, thickness, strain, v_f, force, pressure or specimen; its number "
        "in a file without names.",
        words="--column",
        metavar="QUANTITY=COLUMN",
    )
    units: tuple[str, ...] = option(
        "Unit of a quantity, such as displacement=mm.", words="--unit", metavar="QUANTITY=UNIT"
    )
    specimen: str = option("Which one of several specimens.", default="", metavar="NAME")
    cycle: int | None = option(
        "Number of the cycle to use; default: the first complete one.", click.IntRange(1)
    )

    @property
    def reading(self) -> dict[str, Any]:
        """Arguments of the functions that read a test."""
        from unmodeled.data import ReadOptions

        options = ReadOptions(
            columns=pairs("--column", self.columns, "QUANTITY=COLUMN"),
            units=pairs("--unit", self.units, "QUANTITY=UNIT"),
        )
        return {"options": options, "specimen": self.specimen, "cycle": self.cycle}


TEST = fields_of("feltmb.cli.compression:TestFile")
