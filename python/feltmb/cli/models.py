"""Models and measured files on the command line: their options, and how they are loaded."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from feltmb.cli.completing import actions, mechanism_named
from feltmb.cli.options import (
    Number,
    argument,
    fields_of,
    option,
    pairs,
    positive,
)
from feltmb.cli.screen import complain
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.data import ReadOptions, Record
    from feltmb.data.mapping import Signals
    from feltmb.experiment import Limits
    from feltmb.fit import Effect, Model
    from feltmb.run.stroke.strokes import Kind

__all__ = [
    "DATA",
    "EXCLUDE",
    "HOLD_OUT",
    "MEASURED",
    "MODEL",
    "READING",
    "STATED",
    "TEST",
    "Adapter",
    "Stated",
    "TestFile",
    "config_option",
    "effects",
    "held_out",
    "load_adapter",
]

#: Endings of files of MuJoCo models.
MJCF = (".xml", ".mjcf", ".urdf")


# --- options -------------------------------------------------------------------------------------

MODEL = argument(complete=actions)
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
    from feltmb.units import si_value

    given = pairs("--time-offset", texts, "[CHANNEL=]TIME", bare=True)
    delays = {channel: si_value(text) for channel, text in given.items()}
    wrong = [t for t, value in zip(texts, delays.values(), strict=True) if value is None]
    if wrong:
        raise InvalidParameter(f"--time-offset {wrong[0]}: expected a time such as 12ms")
    return {channel: value for channel, value in delays.items() if value is not None}


def _references(texts: Sequence[str]) -> dict[str, str]:
    found = pairs("--reference", texts, "[CHANNEL=]KIND", bare=True)
    for kind in found.values():
        if kind not in ("absolute", "rest"):
            raise InvalidParameter(f"--reference {kind}: expected absolute or rest")
    return found


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
    "data.sheet:ReadOptions",
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
    down={
        "words": "--y-up",
        "text": "The y pixels count upward; default: downward.",
        "convert": lambda up: False if up else None,
    },
    references={"words": "--reference", "metavar": "[CHANNEL=]KIND", "convert": _references},
    frame_rate={"type": positive("Hz")},
    delays={"words": "--time-offset", "metavar": "[CHANNEL=]TIME", "convert": _delays},
    run={"metavar": "COLUMN"},
    missing={"metavar": "NUMBER", "convert": _numbers},
    likelihood={"type": Number(0, 1)},
)


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

    frame: str | None = option(
        "Compliance of the frame of the machine, such as 0.1um/N, or a file with its displacement "
        "and force without a specimen."
    )

    @property
    def reading(self) -> dict[str, Any]:
        """Arguments of the functions that read a test."""
        from feltmb.data import ReadOptions

        options = ReadOptions(
            columns=pairs("--column", self.columns, "QUANTITY=COLUMN"),
            units=pairs("--unit", self.units, "QUANTITY=UNIT"),
        )
        return {
            "options": options,
            "specimen": self.specimen,
            "cycle": self.cycle,
            "frame": None if self.frame is None else _compliance(self.frame),
        }


TEST = fields_of("cli.models:TestFile")


def _compliance(text: str) -> float | Path:
    """Compliance of a frame [m/N], or the file of a record."""
    from feltmb.units import split_quantity
    from feltmb.units.quantity import parse_scalar

    if Path(text).exists() or split_quantity(text) is None:
        return Path(text)
    try:
        return parse_scalar(text, "m/N")
    except ValueError as error:
        raise InvalidParameter(f"--frame: {error}") from None


@dataclass(frozen=True)
class Stated:
    """Parameters of a model and effects that are its parameters, from the command line."""

    parameter: tuple[str, ...] = option(
        "Fitted parameter of a function, an FMU or a MuJoCo model with its standard deviation, "
        "such as mass=2kg±0.1kg or mass=2kg+-5%. Without VALUE: that of the file.",
        metavar="NAME=VALUE±SD",
    )
    unknown: tuple[str, ...] = option(
        "Parameter of a function, an FMU or a MuJoCo model that is a possible cause; or "
        "NAME=SIZE, its expected size, such as friction=0.3N.",
        metavar="NAME=UNIT",
    )

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


STATED = fields_of("cli.models:Stated")


def _prior(name: str, text: str) -> tuple[float | None, float, str]:
    """Value, standard deviation and SI unit of ``2kg±0.1kg``, ``2 kg +- 5 %``, ``±0.1kg``."""
    from feltmb.units import number_and_unit, to_si

    whole, mark, spread = re.sub(r"\+/?-", "±", text).partition("±")
    value, deviation = number_and_unit(whole.strip()), number_and_unit(spread.strip())
    unit = (value or deviation or (0.0, ""))[1]
    share = deviation is not None and deviation[1] == "%" and (value is None or unit != "%")
    # Without a value, a standard deviation with a unit must be there.
    missing = value is None and (bool(whole.strip()) or share or not mark)
    try:
        factor, si = to_si(unit) if unit else (1.0, "1")
        size = _spread(value, deviation, unit, share=share)
    except InvalidParameter as error:
        raise InvalidParameter(f"--parameter {name}={text}: {error}") from None
    if missing or (mark and deviation is None) or size < 0.0:
        raise InvalidParameter(
            f"--parameter {name}={text}: expected a value and its standard deviation, such as "
            f"{name}=2kg±0.1kg"
        )
    si = unit or si if factor == 1.0 else si
    return None if value is None else value[0] * factor, size * factor, si


def _spread(
    value: tuple[float, str] | None, deviation: tuple[float, str] | None, unit: str, *, share: bool
) -> float:
    """Standard deviation in the unit of the value; without one infinite."""
    from feltmb.units import conversion_factor

    if deviation is None or (share and value is None):
        return math.inf
    if share and value is not None:
        return 0.01 * deviation[0] * abs(value[0])
    return deviation[0] * (conversion_factor(deviation[1] or unit, unit) if unit else 1.0)


def _unknown(name: str, text: str) -> Any:
    """Unit of ``friction=N``; value without the effect, expected size and unit of ``0.3N``."""
    from feltmb.units import number_and_unit, to_si

    size = number_and_unit(text.strip())
    unit = size[1] if size else text
    try:
        factor, si = to_si(unit)
    except InvalidParameter as error:
        raise InvalidParameter(
            f"--unknown {name}={text}: {error}; expected the unit of {name}, such as {name}=N"
        ) from None
    si = unit if factor == 1.0 else si
    return si if size is None else (None, size[0] * factor, si)


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


# --- models --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Adapter:
    """A model with the effects that are tested."""

    model: Model
    effects: tuple[Effect, ...] = ()
    planned: tuple[Record, ...] = ()
    """Possible runs, for ``feltmb gap plan``."""
    outputs_of: Callable[[Sequence[str]], tuple[str, ...]] = tuple
    """Function that returns the outputs of named channels."""
    limits: Limits | None = None
    """Limits of experiments, unless a file states others."""
    kinds: Mapping[str, Kind] = field(default_factory=dict)
    """Inputs that are strokes of a mechanism, with the kind of the stroke."""
    made: Callable[[Sequence[Record]], Sequence[Effect]] | None = None
    """Function that makes the effects from the records; None: ``effects`` are all."""
    default: bool = False
    """Whether the effects are the default ones, :func:`feltmb.gap.candidates`."""

    @property
    def signals(self) -> Signals:
        """Possible signals of the columns of a measured file."""
        from feltmb.data.mapping import Signals

        return Signals(
            inputs=self.model.inputs,
            outputs=self.model.outputs,
            modes=self.model.input_modes,
            units=self.model.units,
            names=self.model.input_names,
            any_inputs=self.model.any_inputs,
        )

    def read(self, data: Sequence[Path], options: ReadOptions | None = None) -> tuple[Record, ...]:
        """Read measured files as records of the model."""
        return tuple(r for group in self.read_each(data, options) for r in group)

    def read_each(
        self, data: Sequence[Path], options: ReadOptions | None = None
    ) -> tuple[tuple[Record, ...], ...]:
        """Read records by file; a file may contain several runs."""
        from feltmb.data.files import read_each

        return read_each(data, self.signals, options)

    def with_records(self, records: Sequence[Record], exclude: Sequence[str] = ()) -> Adapter:
        """Copy of the adapter whose effects are made from these records, or from planned ones.

        ``exclude``: names, patterns or components of effects that are left out.

        Raises
        ------
        InvalidParameter
            There is no record, or the function of the effects fails.
        """
        from feltmb.fit.calling import calling
        from feltmb.gap.defaults import chosen_effects
        from feltmb.gap.records import ready_records

        records = tuple(records) or self.planned
        if self.made is None and not self.default:
            kept, _ = chosen_effects(self.model, records, self.effects, exclude)
            return replace(self, effects=kept)
        if not records:
            raise InvalidParameter(
                f"model {self.model.name}: its effects are a function of the records; give "
                "measured files, or define planned records"
            )
        if self.made is None:
            ready = ready_records(self.model, records)
            kept, _ = chosen_effects(ready.model, ready.records, None, exclude)
            return replace(self, model=ready.model, effects=kept, default=False)
        with calling(f"model {self.model.name}: effects(records)"):
            effects, fault = _listed(self.made(records))
        if fault:
            raise InvalidParameter(f"model {self.model.name}: effects(records) {fault}")
        return replace(self, effects=effects, made=None).with_records(records, exclude)

    def measured(self, path: Path | None) -> Adapter:
        """Copy of the adapter with tests of single parts instead of tolerances."""
        from feltmb.gap import read_measured, with_measured

        if path is None:
            return self
        tests = read_measured(path, self.model, self.effects)
        return replace(self, model=with_measured(self.model, tests, self.effects))

    def including(self, names: Sequence[str]) -> Adapter:
        """Copy of the adapter whose model includes effects of the library."""
        from feltmb.fit import including

        names = list(dict.fromkeys(names))
        if not names:
            return self
        known = {e.name: e for e in self.effects}
        unknown = [n for n in names if n not in known]
        if unknown:
            raise InvalidParameter(
                f"--include {', '.join(unknown)}: no such effect; there are {', '.join(known)}"
            )
        return replace(
            self,
            model=including(self.model, [known[n] for n in names]),
            effects=tuple(e for e in known.values() if e.name not in names),
        )


def _mechanism(name: str, settings: Mapping[str, str], channels: Sequence[str]) -> Adapter | None:
    """Packaged mechanism or mechanism file, see :mod:`feltmb.adapters.model`."""
    from feltmb.adapters import STROKE_KINDS, finger_limits, planned_strokes
    from feltmb.adapters.model import resolve

    found = resolve(name, settings, channels, tell=complain)
    if found is None:
        return None
    model, effects = found
    return Adapter(
        model,
        effects,
        planned_strokes(model),
        model.library.outputs,
        finger_limits(model),
        STROKE_KINDS,
    )


def load_adapter(
    name: str,
    settings: Sequence[str] = (),
    channels: Sequence[str] = (),
    stated: Stated | None = None,
) -> Adapter:
    """Adapter by the name of a packaged mechanism, or the path of a file.

    The file is a mechanism (TOML), an FMU, a MuJoCo model (XML), or Python. ``channels`` are
    required in addition to the default channels of a mechanism.

    A Python file defines ``model``, or another name behind a colon: a :class:`feltmb.fit.Model`, or
    a function ``(time, inputs, parameters) -> {output: values}``. It may define ``effects`` (a
    sequence of :class:`feltmb.fit.Effect`, or a function of the records that returns one, see
    :meth:`Adapter.with_records`), ``planned`` (possible records) and ``limits`` (a
    :class:`feltmb.experiment.Limits`). The file is executed: only use files that you trust.
    """
    from feltmb.fit import fmu, mujoco

    stated = stated or Stated((), ())
    values = pairs("--set", settings, "PATH=VALUE")
    stem, _, attribute = name.partition(".py:")
    path = Path(f"{stem}.py" if attribute else name)
    kind = path.suffix.lower()
    if values and kind in (".py", ".fmu", *MJCF):
        raise InvalidParameter(f"{name}: --set works with packaged mechanisms, not with a file")
    if kind == ".py":
        return _from_file(path, attribute, stated)
    if kind in (".fmu", *MJCF):
        make = fmu if kind == ".fmu" else mujoco
        model = make(path, parameters=stated.parameters, unknown=stated.causes or None)
        return Adapter(model, default=True)
    if stated.parameter or stated.unknown:
        raise InvalidParameter(
            f"{name}: a mechanism has its parameters; --set changes their values"
        )
    found = _mechanism(name, values, channels)
    if found is None:
        from feltmb.data.columns import MEASURED_FILES

        measured = path.suffix.lower() in MEASURED_FILES
        hint = "; this is a file of data, the model is the first argument" if measured else ""
        raise InvalidParameter(
            f"no model {name!r}; expected a Python file (model.py:FUNCTION), an FMU, a MuJoCo "
            f"model (.xml), a mechanism file, or a packaged mechanism (feltmb list){hint}"
        )
    return found


def _from_file(path: Path, attribute: str, stated: Stated) -> Adapter:
    """Model, effects, planned runs and limits of a Python file."""
    from feltmb.experiment import Limits
    from feltmb.fit import Model
    from feltmb.fit.calling import calling

    names = _executed(path)
    model = _model_of(path, names, attribute or "model", stated)
    given = names.get("effects")
    made = given if callable(given) else None
    with calling(f"{path}: effects"):
        effects, fault = ((), "") if made or given is None else _listed(given)
    faults = [] if isinstance(model, Model) else [model]
    faults += [f"effects {fault}"] if fault else []
    limits = names.get("limits")
    if limits is not None and not isinstance(limits, Limits):
        faults.append(f"limits is {type(limits).__name__}, expected a feltmb.experiment.Limits")
    if faults:
        raise InvalidParameter(f"{path}: " + "; ".join(map(str, faults)))
    assert isinstance(model, Model)
    planned = tuple(names.get("planned", ()))
    return Adapter(model, effects, planned, limits=limits, made=made, default=given is None)


def _executed(path: Path) -> dict[str, Any]:
    """Names that a Python file defines."""
    from feltmb.files import is_file

    if not is_file(path):
        raise InvalidParameter(f"{path}: there is no such file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SystemExit as error:
        raise InvalidParameter(
            f"{path}: ends the program (exit code {error.code!r}), expected it to define a model"
        ) from None
    except Exception as error:
        raise InvalidParameter(f"{path}: {type(error).__name__}: {error}") from error
    return vars(module)


def _model_of(path: Path, names: Mapping[str, Any], wanted: str, stated: Stated) -> Model | str:
    """Model of a Python file, or why there is none."""
    from feltmb.fit import Model, Simulator

    model = names.get(wanted)
    if callable(model) and not isinstance(model, (Model, type)):
        unknown = {
            n: (0.0, *u[1:]) if isinstance(u, tuple) else u for n, u in stated.causes.items()
        }
        return Simulator(model, parameters=stated.parameters, unknown=unknown)
    if model is not None and (stated.parameter or stated.unknown):
        raise InvalidParameter(
            f"{path}: --parameter and --unknown describe a function; {wanted} is "
            f"{type(model).__name__}, which has its own"
        )
    if isinstance(model, Model):
        return model
    if model is not None:
        return f"{wanted} is {type(model).__name__}, expected a feltmb.gap.Model or a function"
    others = [n for n, v in names.items()
              if isinstance(v, (Model, FunctionType)) and not n.startswith("_")]  # fmt: skip
    hint = f"; there is {path.name}:{f', {path.name}:'.join(others)}" if others else ""
    return f"{wanted} is missing, expected a model or a function with this name{hint}"


def _listed(given: object) -> tuple[tuple[Effect, ...], str]:
    """Effects as a tuple, and why something is no sequence of effects; empty: it is one."""
    from feltmb.fit import Effect

    if not isinstance(given, Iterable):
        return (), f"is {type(given).__name__}, expected a sequence of feltmb.gap.Effect"
    effects = tuple(given)
    if not all(isinstance(e, Effect) for e in effects):
        return (), "holds something that is no feltmb.gap.Effect"
    return effects, ""


def effects(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Effects of the library for the mechanism on the command line; Python files are not run."""
    from feltmb.errors import FeltmbError

    model = mechanism_named()
    if model is None:
        return []
    try:
        names = [effect.name for effect in load_adapter(model).effects]
    except FeltmbError:
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
