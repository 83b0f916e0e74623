"""Options for reading measured files, common to several commands."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from feltmb.cli.common import ListOption, Number, list_option, positive
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.data import ReadOptions

__all__ = ["config_option", "reading_options", "stated_options", "test_options"]

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
            "help": "Length of a pixel, or of another unit of the file, such as 0.21mm; or the "
            "distance of two points in pixels: '210mm from 120 340 to 412 338'. Repeatable.",
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


def stated_options(function: F) -> F:
    """Add the options that describe a model from a file; a command gets them as ``stated``."""

    @functools.wraps(function)
    def command(*args: Any, parameter: Sequence[str], unknown: Sequence[str], **kwargs: Any) -> Any:
        from feltmb.cli.gap_models import Stated

        stated = Stated(
            {
                n: _prior(n, text)
                for n, text in _pairs("--parameter", parameter, bare=False).items()
            },
            {n: _unknown(n, text) for n, text in _pairs("--unknown", unknown, bare=False).items()},
        )
        return function(*args, stated=stated, **kwargs)

    for option in (
        list_option(
            "--unknown",
            "unknown",
            metavar="NAME=UNIT",
            help="Parameter of a function, an FMU or a MuJoCo model that is a possible cause; or "
            "NAME=SIZE, its expected size, such as friction=0.3N.",
        ),
        list_option(
            "--parameter",
            "parameter",
            metavar="NAME=VALUE±SD",
            help="Fitted parameter of a function, an FMU or a MuJoCo model with its standard "
            "deviation, such as mass=2kg±0.1kg or mass=2kg+-5%. Without VALUE: that of the file.",
        ),
    ):
        command = option(command)
    return command  # type: ignore[return-value]


def config_option(function: F) -> F:
    """Option ``--config FILE``: options of the command from a TOML file."""

    def read(context: click.Context, _parameter: click.Parameter, path: Path | None) -> None:
        from difflib import get_close_matches

        from feltmb.files import read_toml

        if path is None:
            return
        options = {
            text.lstrip("-"): p
            for p in context.command.params
            for text in p.opts
            if isinstance(p, click.Option) and text.startswith("--") and p.expose_value
        }
        found: dict[str, Any] = {}
        for key, value in read_toml(path).items():
            option = options.get(key)
            if option is None:
                near = get_close_matches(key, options, n=1)
                hint = f"; did you mean {near[0]}?" if near else f"; known are {', '.join(options)}"
                raise InvalidParameter(f"{path}: {key} is no option of this command{hint}")
            if isinstance(value, dict):
                value = [f"{name}={text}" for name, text in value.items()]
            elif option.multiple and not isinstance(value, list):
                value = [value]
            found[str(option.name)] = [str(v) for v in value] if option.multiple else value
        context.default_map = {**(context.default_map or {}), **found}

    return click.option(
        "--config",
        type=click.Path(path_type=Path),
        metavar="FILE",
        is_eager=True,
        expose_value=False,
        callback=read,
        help='Options of this command from a TOML file, such as exclude = ["sensor x"] and '
        '[parameter] mass = "2kg±0.1kg"; those on the command line replace them.',
    )(function)


def _prior(name: str, text: str) -> tuple[float | None, float, str]:
    """Value, standard deviation and SI unit of ``2kg±0.1kg``, ``2 kg +- 5 %``, ``±0.1kg``."""
    from feltmb.units import conversion_factor, to_si

    fault = InvalidParameter(
        f"--parameter {name}={text}: expected a value and its standard deviation, such as "
        f"{name}=2kg±0.1kg"
    )
    whole, mark, spread = re.sub(r"\+/?-", "±", text).partition("±")
    value, deviation = _amount(whole), _amount(spread)
    unit = value[1] if value else deviation[1] if deviation else ""
    share = deviation is not None and deviation[1] == "%" and (value is None or unit != "%")
    missing = value is None and (bool(whole.strip()) or share or not mark)
    if missing or (mark and deviation is None):
        raise fault
    try:
        factor, si = to_si(unit) if unit else (1.0, "1")
        size = math.inf
        if share and deviation and value:
            size = 0.01 * deviation[0] * abs(value[0])
        elif deviation is not None:
            same = deviation[1] or unit
            size = deviation[0] * conversion_factor(same, unit) if unit else deviation[0]
    except InvalidParameter as error:
        raise InvalidParameter(f"--parameter {name}={text}: {error}") from None
    if size < 0.0:
        raise fault
    si = unit or si if factor == 1.0 else si
    return None if value is None else value[0] * factor, size * factor, si


def _amount(text: str) -> tuple[float, str] | None:
    from feltmb.units import number_and_unit

    return number_and_unit(text.strip())


def _unknown(name: str, text: str) -> object:
    """Unit of ``friction=N``; value without the effect, expected size and unit of ``0.3N``."""
    from feltmb.units import to_si

    size = _amount(text)
    try:
        factor, si = to_si(size[1] if size else text)
    except InvalidParameter as error:
        raise InvalidParameter(f"--unknown {name}={text}: {error}") from None
    si = (size[1] if size else text) if factor == 1.0 else si
    return si if size is None else (None, size[0] * factor, si)


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
