"""Files of compression tests on the command line: their options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from unmodeled.cli.options import fields_of, option, pairs
from unmodeled.errors import InvalidParameter


@dataclass(frozen=True)
class TestFile:
    """How the file of a compression test is read."""

    __test__ = False

    columns: tuple[str, ...] = option(
        "Column of displacement, thickness, strain, v_f, force, pressure, time or specimen; its "
        "number in a file without names.",
        words="--column",
        metavar="QUANTITY=COLUMN",
    )
    units: tuple[str, ...] = option(
        "Unit of a quantity, such as displacement=mm.", words="--unit", metavar="QUANTITY=UNIT"
    )
    scales: tuple[str, ...] = option(
        "What one of a raw reading is, such as displacement=2.5um (a step) or force=46uN (a count "
        "of a converter).",
        words="--scale",
        metavar="QUANTITY=SIZE",
    )
    origins: tuple[str, ...] = option(
        "Zero of a quantity in the unit of the file, such as force=84312 (the count without load).",
        words="--origin",
        metavar="QUANTITY=VALUE",
    )
    specimen: str = option("Which one of several specimens.", default="", metavar="NAME")
    cycle: int | None = option(
        "Number of the cycle to use; default: the first complete one.", click.IntRange(1)
    )

    frame: str | None = option(
        "Compliance of the frame of the machine, such as 0.1um/N, or a file with its displacement "
        "and force without a specimen."
    )

    @property
    def reading(self) -> dict[str, Any]:
        """Arguments of the functions that read a test."""
        from unmodeled.data import ReadOptions

        options = ReadOptions(
            columns=pairs("--column", self.columns, "QUANTITY=COLUMN"),
            units=pairs("--unit", self.units, "QUANTITY=UNIT"),
            scales=pairs("--scale", self.scales, "QUANTITY=SIZE"),
            origins=pairs("--origin", self.origins, "QUANTITY=VALUE"),
        )
        return {
            "options": options,
            "specimen": self.specimen,
            "cycle": self.cycle,
            "frame": None if self.frame is None else _compliance(self.frame),
        }


TEST = fields_of("feltmb.cli.compression:TestFile")


def _compliance(text: str) -> float | Path:
    """Compliance of a frame [m/N], or the file of a record."""
    from unmodeled.units import split_quantity
    from unmodeled.units.quantity import parse_scalar

    if Path(text).exists() or split_quantity(text) is None:
        return Path(text)
    try:
        return parse_scalar(text, "m/N")
    except ValueError as error:
        raise InvalidParameter(f"--frame: {error}") from None
