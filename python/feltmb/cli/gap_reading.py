"""Options for reading measured files, common to several commands."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

from feltmb.cli.common import ListOption, Number, positive
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.data import ReadOptions

__all__ = ["reading_options", "test_options"]

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    (
        "--column",
        {
            "metavar": "CHANNEL=COLUMN",
            "cls": ListOption,
            "multiple": True,
            "help": "Column of the file for this channel (or for time). Repeatable.",
        },
    ),
    (
        "--unit",
        {
            "metavar": "[CHANNEL=]UNIT",
            "cls": ListOption,
            "multiple": True,
            "help": "Unit of a channel (or of time), also px. Without CHANNEL: unit of all outputs "
            "without a unit in the header. Repeatable.",
        },
    ),
    (
        "--scale",
        {
            "metavar": "[CHANNEL=]LENGTH",
            "cls": ListOption,
            "multiple": True,
            "help": "Length of a pixel, or of another unit of the file, such as 0.21mm. "
            "Repeatable.",
        },
    ),
    (
        "--origin",
        {
            "metavar": "[CHANNEL=]VALUE",
            "cls": ListOption,
            "multiple": True,
            "help": "Zero of a channel in the unit of the file; X,Y: zero of all channels in "
            "pixels; start: first value of the channel. Repeatable.",
        },
    ),
    ("--y-up", {"is_flag": True, "help": "The y pixels count upward; default: downward."}),
    (
        "--reference",
        {
            "metavar": "[CHANNEL=]KIND",
            "cls": ListOption,
            "multiple": True,
            "help": "absolute (coordinates of the mechanism) or rest (displacement from rest); "
            "default: determined from the first value of the channel. Repeatable.",
        },
    ),
    (
        "--frame-rate",
        {"type": positive("Hz"), "help": "Frames per second of the camera [Hz]."},
    ),
    (
        "--time-offset",
        {
            "metavar": "[CHANNEL=]TIME",
            "cls": ListOption,
            "multiple": True,
            "help": "Delay of a channel, or of all outputs, relative to the input, such as 12ms. "
            "Repeatable.",
        },
    ),
    (
        "--run",
        {
            "metavar": "COLUMN",
            "default": "",
            "help": "Column with the number of the run; default: a new run begins where the time "
            "restarts.",
        },
    ),
    (
        "--missing",
        {
            "metavar": "NUMBER",
            "cls": ListOption,
            "multiple": True,
            "help": "Number of the file that stands for a missing value, such as -9999. "
            "Repeatable.",
        },
    ),
    (
        "--likelihood",
        {
            "type": Number(0, 1),
            "help": "Points of a tracker below this likelihood are missing values; default 0.6. "
            "The file needs a column such as tip_likelihood beside tip_x.",
        },
    ),
)


def reading_options(function: F) -> F:
    """Add the options to a command, which gets them as ``reading``."""

    @functools.wraps(function)
    def command(*args: Any, **kwargs: Any) -> Any:
        taken = {k: kwargs.pop(k) for k in _KEYS}
        return function(*args, reading=_options(taken), **kwargs)

    for name, attributes in reversed(_OPTIONS):
        command = click.option(name, **attributes)(command)
    return command  # type: ignore[return-value]


def test_options(function: F) -> F:
    """Options for reading a compression test, which a command gets as ``reading``."""

    @functools.wraps(function)
    def command(
        *args: Any,
        column: Sequence[str],
        unit: Sequence[str],
        specimen: str,
        cycle: int | None,
        **kwargs: Any,
    ) -> Any:
        from feltmb.data import ReadOptions

        options = ReadOptions(
            columns=_pairs("--column", column, bare=False),
            units=_pairs("--unit", unit, bare=False),
        )
        reading = {"options": options, "specimen": specimen, "cycle": cycle}
        return function(*args, reading=reading, **kwargs)

    for option in (
        click.option(
            "--cycle",
            type=click.IntRange(1),
            help="Number of the cycle to use; default: the first complete one.",
        ),
        click.option(
            "--specimen", metavar="NAME", default="", help="Which one of several specimens."
        ),
        click.option(
            "--unit",
            metavar="QUANTITY=UNIT",
            cls=ListOption,
            multiple=True,
            help="Unit of a quantity, such as displacement=mm. Repeatable.",
        ),
        click.option(
            "--column",
            metavar="QUANTITY=COLUMN",
            cls=ListOption,
            multiple=True,
            help="Column of displacement, thickness, strain, v_f, force, pressure or specimen; its "
            "number in a file without names. Repeatable.",
        ),
    ):
        command = option(command)
    return command  # type: ignore[return-value]


_KEYS = tuple(name.lstrip("-").replace("-", "_") for name, _ in _OPTIONS)


def _options(given: dict[str, Any]) -> ReadOptions:
    from feltmb.data import ReadOptions
    from feltmb.units import si_value

    delays = {}
    for channel, text in _pairs("--time-offset", given["time_offset"]).items():
        value = si_value(text)
        if value is None:
            raise InvalidParameter(f"--time-offset {text}: expected a time such as 12ms")
        delays[channel] = value
    references = _pairs("--reference", given["reference"])
    for kind in references.values():
        if kind not in ("absolute", "rest"):
            raise InvalidParameter(f"--reference {kind}: expected absolute or rest")
    return ReadOptions(
        columns=_pairs("--column", given["column"], bare=False),
        units=_pairs("--unit", given["unit"]),
        scales=_pairs("--scale", given["scale"]),
        origins=_pairs("--origin", _points(given["origin"])),
        delays=delays,
        references=references,
        frame_rate=given["frame_rate"],
        run=given["run"],
        likelihood=given["likelihood"],
        missing=_numbers("--missing", given["missing"]),
        down=False if given["y_up"] else None,
    )


def _numbers(option: str, texts: Sequence[str]) -> tuple[float, ...]:
    try:
        return tuple(float(t) for t in texts)
    except ValueError:
        raise InvalidParameter(f"{option} {', '.join(texts)}: expected a number") from None


def _points(texts: Sequence[str]) -> list[str]:
    """Origins; X,Y without a channel, which was split as a list, becomes one point again."""
    bare = [t for t in texts if "=" not in t]
    return [t for t in texts if "=" in t] + ([",".join(bare)] if bare else [])


def _pairs(option: str, texts: Sequence[str], *, bare: bool = True) -> dict[str, str]:
    """Values by channel; "" means all channels."""
    out: dict[str, str] = {}
    for text in texts:
        channel, mark, value = text.partition("=")
        if not mark:
            channel, value = "", text
        channel, value = channel.strip(), value.strip()
        if not value or not (channel or (bare and not mark)):
            raise InvalidParameter(f"{option} {text}: expected CHANNEL=VALUE")
        if channel in out:
            raise InvalidParameter(f"{option} {text}: {channel or 'all'} is told twice")
        out[channel] = value
    return out
