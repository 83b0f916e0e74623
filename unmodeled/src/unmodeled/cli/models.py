"""Models and measured files on the command line: their options, and how they are loaded."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
from click.shell_completion import CompletionItem

from unmodeled.cli import completing
from unmodeled.cli.options import (
    Number,
    Quantity,
    argument,
    count,
    fields_of,
    option,
    pairs,
    positive,
)
from unmodeled.cli.screen import complain, console, table
from unmodeled.errors import InvalidParameter
from unmodeled.loading import LoadedModel, load_model

if TYPE_CHECKING:
    from unmodeled.data import Record
    from unmodeled.data.robots import Assigned

# --- options -------------------------------------------------------------------------------------

MODEL = argument(complete=completing.models)
DATA = argument(click.Path(path_type=Path))
EXCLUDE = option(
    "Effect, pattern such as 'sensor*', or component that is not tested.", metavar="EFFECT"
)
HOLD_OUT = option(
    "Record (or its file) that is not fitted, but predicted. Default: the records with the role "
    "held_out, else some records are chosen.",
    metavar="NAME",
)
MEASURED = option(
    "TOML file with tests of single parts: [measured.NAME] with value, sd and how. NAME is a "
    "parameter, whose tolerance the test replaces, or an effect, which becomes a parameter.",
    metavar="FILE",
)


def _delays(texts: Sequence[str]) -> dict[str, float]:
    from unmodeled.units import si_value

    given = pairs("--delay", texts, "[CHANNEL=]TIME", bare=True)
    delays = {channel: si_value(text) for channel, text in given.items()}
    wrong = [t for t, value in zip(texts, delays.values(), strict=True) if value is None]
    if wrong:
        raise InvalidParameter(f"--delay {wrong[0]}: expected a time such as 12ms")
    return {channel: value for channel, value in delays.items() if value is not None}


def _references(texts: Sequence[str]) -> dict[str, str]:
    kinds = pairs("--reference", texts, "[CHANNEL=]KIND", bare=True)
    for kind in kinds.values():
        if kind not in ("absolute", "rest"):
            raise InvalidParameter(f"--reference {kind}: expected absolute or rest")
    return kinds


def _numbers(texts: Sequence[str]) -> tuple[float, ...]:
    try:
        return tuple(float(t) for t in texts)
    except ValueError:
        raise InvalidParameter(f"--missing {', '.join(texts)}: expected a number") from None


def _origins(texts: Sequence[str]) -> dict[str, str]:
    """Origins; X,Y without a channel, which was split as a list, becomes one point again."""
    bare = [t for t in texts if "=" not in t]
    texts = [t for t in texts if "=" in t] + ([",".join(bare)] if bare else [])
    return pairs("--origin", texts, "[CHANNEL=]VALUE", bare=True)


#: How measured files are read.
READING = fields_of(
    "unmodeled.data.sheet:ReadOptions",
    columns={
        "words": "--column",
        "metavar": "CHANNEL=COLUMN",
        "convert": lambda texts: pairs("--column", texts, "CHANNEL=COLUMN"),
    },
    units={
        "words": "--unit",
        "metavar": "[CHANNEL=]UNIT",
        "convert": lambda texts: pairs("--unit", texts, "[CHANNEL=]UNIT", bare=True),
    },
    scales={
        "words": "--scale",
        "metavar": "[CHANNEL=]LENGTH",
        "convert": lambda texts: pairs("--scale", texts, "[CHANNEL=]LENGTH", bare=True),
    },
    origins={"words": "--origin", "metavar": "[CHANNEL=]VALUE", "convert": _origins},
    periods={
        "words": "--period",
        "metavar": "CHANNEL=PERIOD",
        "convert": lambda texts: pairs("--period", texts, "CHANNEL=PERIOD"),
    },
    references={"words": "--reference", "metavar": "[CHANNEL=]KIND", "convert": _references},
    frame_rate={"type": positive("Hz")},
    delays={"words": "--delay", "metavar": "[CHANNEL=]TIME", "convert": _delays},
    run={"metavar": "COLUMN"},
    missing={"metavar": "NUMBER", "convert": _numbers},
    likelihood={"type": Number(0, 1)},
)


@dataclass(frozen=True)
class StatedOptions:
    """Parameters of a model, effects that are its parameters, and how its runs start."""

    parameter: tuple[str, ...] = option(
        "Fitted parameter of a function, an FMU or a MuJoCo model with its standard deviation, "
        "such as mass=2kg±0.1kg or mass=2kg+-5%. Without VALUE, as in mass=±5%: that of the file.",
        metavar="NAME=VALUE±SD",
    )
    unknown: tuple[str, ...] = option(
        "Parameter of a function, an FMU or a MuJoCo model that is a possible cause; or "
        "NAME=SIZE, its expected size, such as friction=0.3N.",
        metavar="NAME=UNIT",
    )
    key: str = option(
        "Keyframe of a MuJoCo model in which records start. Default: measured joints start where "
        "their first samples are, the others as in the nearest keyframe.",
        metavar="KEYFRAME",
        default="",
    )
    settle: float = option(
        "Time before a record with its first inputs, for a MuJoCo model, such as 2s.",
        Quantity("s", 0.0),
        default=0.0,
    )
    hold: Literal["linear", "zero"] | None = option(
        "Inputs of a MuJoCo model or an FMU between samples: linear, or constant (zero). Default: "
        "constant for MuJoCo, linear for an FMU."
    )

    @property
    def running(self) -> dict[str, Any]:
        """Given options of :func:`unmodeled.mujoco` and :func:`unmodeled.fmu` about its runs."""
        own = {"key": self.key, "settle": self.settle, "hold": self.hold}
        return {name: value for name, value in own.items() if value}

    @property
    def parameters(self) -> dict[str, tuple[float | None, float, str]]:
        """(value or None, sd, unit) by name."""
        given = pairs("--parameter", self.parameter, "NAME=VALUE±SD")
        return {name: _prior(name, text) for name, text in given.items()}

    @property
    def causes(self) -> dict[str, Any]:
        """Unit, or (value without the effect, expected size, unit), by name."""
        given = pairs("--unknown", self.unknown, "NAME=UNIT")
        return {name: _unknown(name, text) for name, text in given.items()}


STATED = fields_of("unmodeled.cli.models:StatedOptions")


@dataclass(frozen=True)
class Running:
    """Where runs of a function, an FMU or a MuJoCo model are computed and kept."""

    workers: int | None = option(
        "Number of processes for the runs of a function or an FMU, for MuJoCo of threads. Default: "
        "one for each core, if a run takes more than 5 ms.",
        count(),
        metavar="N",
    )
    cache: Path | None = option(
        "Folder of finished runs of a function, an FMU or a MuJoCo model: an interrupted command "
        "continues from it. Runs belong to the file that defines the model; delete the folder if "
        "anything else has changed, such as a module that it imports.",
        metavar="FOLDER",
    )

    def of(self, loaded: LoadedModel) -> LoadedModel:
        """The model with these runs."""
        if self.workers is None and self.cache is None:
            return loaded
        from unmodeled.models.elsewhere import running

        model = running(loaded.model, workers=self.workers, cache=self.cache)
        return replace(loaded, model=model)


RUNNING = fields_of("unmodeled.cli.models:Running")


def _prior(name: str, text: str) -> tuple[float | None, float, str]:
    """Value, standard deviation and unit of ``2kg±0.1kg``, ``2 kg +- 5 %``, ``±0.1kg``, ``±5%``."""
    from unmodeled.units import number_and_unit, to_si

    whole, mark, spread = re.sub(r"\+/?-", "±", text).partition("±")
    value, deviation = number_and_unit(whole.strip()), number_and_unit(spread.strip())
    unit = (value or deviation or (0.0, ""))[1]
    share = deviation is not None and deviation[1] == "%" and (value is None or unit != "%")
    # Without a value, a standard deviation with a unit must be there.
    missing = value is None and (bool(whole.strip()) or not mark)
    try:
        to_si(unit or "1")
        size = _spread(value, deviation, unit, share=share)
    except InvalidParameter as error:
        raise InvalidParameter(f"--parameter {name}={text}: {error}") from None
    if missing or (mark and deviation is None) or size < 0.0:
        raise InvalidParameter(
            f"--parameter {name}={text}: expected a value and its standard deviation, such as "
            f"{name}=2kg±0.1kg"
        )
    return None if value is None else value[0], size, unit or "1"


def _spread(
    value: tuple[float, str] | None, deviation: tuple[float, str] | None, unit: str, *, share: bool
) -> float:
    """Standard deviation in the unit of the value; without one infinite."""
    from unmodeled.units import conversion_factor

    if deviation is None:
        return math.inf
    if share and value is None:
        return deviation[0]  # of the value of the file, which the model knows
    if share and value is not None:
        return 0.01 * deviation[0] * abs(value[0])
    return deviation[0] * (conversion_factor(deviation[1] or unit, unit) if unit else 1.0)


def _unknown(name: str, text: str) -> Any:
    """Unit of ``friction=N``; value without the effect, expected size and unit of ``0.3N``."""
    from unmodeled.units import number_and_unit, to_si

    size = number_and_unit(text.strip())
    unit = size[1] if size else text
    try:
        to_si(unit)
    except InvalidParameter as error:
        raise InvalidParameter(
            f"--unknown {name}={text}: {error}; expected the unit of {name}, such as {name}=N"
        ) from None
    return unit if size is None else (None, size[0], unit)


def config_option() -> click.Option:
    """Option ``--config FILE``: options of the command from a TOML file."""
    return click.Option(
        ["--config"],
        type=click.Path(path_type=Path),
        metavar="FILE",
        is_eager=True,
        expose_value=False,
        callback=_read_config,
        help='Options of this command from a TOML file, such as exclude = ["sensor x"] and '
        '[parameter] mass = "2kg±0.1kg"; those on the command line replace them.',
    )


def _read_config(context: click.Context, _parameter: click.Parameter, path: Path | None) -> None:
    from difflib import get_close_matches

    from unmodeled.files import read_toml

    if path is None:
        return
    options = {
        text.lstrip("-"): p
        for p in context.command.params
        for text in p.opts
        if isinstance(p, click.Option) and text.startswith("--") and p.expose_value
    }
    values: dict[str, Any] = {}
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
        values[str(option.name)] = [str(v) for v in value] if option.multiple else value
    context.default_map = {**(context.default_map or {}), **values}


def load_named(
    name: str,
    settings: Sequence[str] = (),
    channels: Sequence[str] = (),
    stated: StatedOptions | None = None,
) -> LoadedModel:
    """Model of the command line, see :func:`unmodeled.loading.load_model`."""
    stated = stated or StatedOptions((), (), "", 0.0, None)
    loaded = load_model(
        name,
        pairs("--set", settings, "PATH=VALUE"),
        channels,
        parameters=stated.parameters,
        unknown=stated.causes,
        running=stated.running,
        notify=complain,
    )
    return replace(loaded, tell=_Shown())


class _Shown:
    """Prints what the signals of logs became, on stderr: once for files with the same columns."""

    def __init__(self) -> None:
        self.last: list[tuple[str, str, str, str]] = []

    def __call__(self, path: Path, rows: Sequence[Assigned]) -> None:
        """Print the table of a file, unless it is that of the file before it."""
        same = [(r.signal, r.channel, r.unit, r.guessed) for r in rows]
        if same != self.last:
            _show_assigned(path, rows)
        self.last = same


def _show_assigned(path: Path, rows: Sequence[Assigned]) -> None:
    """Print what the signals of a log became."""
    heads = "=signal | =channel | =unit | >samples | >Hz | =guessed"
    cells = [
        (r.signal, r.channel or "(not used)", r.unit, str(r.samples), f"{r.rate:.4g}", r.guessed)
        for r in rows
    ]
    console(stderr=True).print(table(f"{path.name}: its first run", heads, cells))


def effects(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Effects of the library for the model on the command line; files are not run."""
    from unmodeled.errors import Error
    from unmodeled.loading import extensions

    known = {n for e in extensions() for n in e.names()}
    model = next((w for w in completing.words() if w in known), None)
    if model is None:
        return []
    try:
        names = [effect.name for effect in load_model(model).effects]
    except Error:
        return []
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def held_out(
    given: tuple[str, ...], data: Sequence[Path], groups: Sequence[Sequence[Record]]
) -> list[str]:
    """Names of the held-out records.

    Each is given by its name, by its file, or by the file name; a file means all of its runs.

    Raises
    ------
    InvalidParameter
        A name is ambiguous.
    """
    out: list[str] = []
    for h in given:
        paths = [g for p, g in zip(data, groups, strict=True) if str(p) == h]
        files = [g for p, g in zip(data, groups, strict=True) if p.name == h]
        if not paths and len(files) > 1:
            raise InvalidParameter(
                f"--hold-out {h}: is the name of {len(files)} files; give the whole path of one, "
                "as it stands among the data"
            )
        found = (paths or files or [()])[0]
        out += [r.name for r in found] or [h]
    return out
