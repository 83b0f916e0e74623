"""Options of the commands: each is written once, as a parameter of a function or a field.

:func:`declare` makes a click command from a function. A parameter whose default is made by
:func:`option` or :func:`argument` is one option or argument. A parameter whose default is made by
:func:`fields_of` has the options of a dataclass of the library: name, type, default, unit and help
are those of its fields.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import os
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import click

from unmodeled.cli import completing
from unmodeled.cli.screen import as_json_option, collected_json
from unmodeled.errors import InvalidParameter

__all__ = [
    "FORCE",
    "FRACTION",
    "MODEL_SET",
    "NOT_NEGATIVE",
    "POSITIVE",
    "Command",
    "CommandGroup",
    "FileName",
    "FolderName",
    "ListOption",
    "Number",
    "Quantity",
    "argument",
    "count",
    "declare",
    "fields_of",
    "group",
    "is_given",
    "option",
    "pairs",
    "parse_option",
    "picture",
    "positive",
    "split_list",
]


# --- types of values -----------------------------------------------------------------------------


class FileName(click.Path):
    """Name of a file to be written, with a suffix that the command supports."""

    def __init__(self, *suffixes: str, dir_okay: bool = False):
        super().__init__(path_type=Path, dir_okay=dir_okay)
        self.suffixes = suffixes

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        from unmodeled.files import check_suffix

        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        check_suffix(path, *self.suffixes)
        return path


class FolderName(click.Path):
    """Name of a folder to be written, which is not the name of a file."""

    def __init__(self, file_okay: bool = False) -> None:
        super().__init__(path_type=Path, file_okay=file_okay)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path."""
        from unmodeled.files import check_folder

        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        check_folder(path)
        return path


#: SI unit of an option -> name of its value in the help.
_KINDS = {
    "m": "LENGTH",
    "m^2": "AREA",
    "s": "TIME",
    "rad": "ANGLE",
    "Hz": "RATE",
    "Pa": "PRESSURE",
    "N/m": "FORCE/LENGTH",
}


class Quantity(click.FloatRange):
    """A finite number with a unit, such as 25um or "3 cm^2", within limits in the SI unit.

    A number without a unit is in the SI unit, which the help shows. The parser is also used for
    files, so that units are written in the same way everywhere.

    Parameters
    ----------
    unit
        SI unit of the value; "1" for a plain number, which may also be in %.
    low, high
        Limits in that unit.
    """

    name = "quantity"

    def __init__(
        self,
        unit: str,
        low: float | None = None,
        high: float | None = None,
        *,
        min_open: bool = False,
        max_open: bool = False,
    ) -> None:
        super().__init__(low, high, min_open=min_open, max_open=max_open)
        self.unit = unit

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str | None:
        """Text after the option in the help."""
        del ctx
        if isinstance(param, click.Argument):
            return None
        return "NUMBER" if self.unit == "1" else f"{_KINDS.get(self.unit, 'NUMBER')}[{self.unit}]"

    def _describe_range(self) -> str:
        return "" if self.min is None and self.max is None else super()._describe_range()

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number in the SI unit, or an error message."""
        from unmodeled.units.quantity import parse_scalar

        try:
            number = parse_scalar(value, self.unit)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        return float(super().convert(number, param, ctx))


class Number(Quantity):
    """A plain number within limits."""

    def __init__(
        self, low: float | None = None, high: float | None = None, **open_ends: bool
    ) -> None:
        super().__init__("1", low, high, **open_ends)


def positive(unit: str) -> Quantity:
    """A quantity > 0 with this SI unit."""
    return Quantity(unit, 0, min_open=True)


def count(low: int = 1, high: int | None = None) -> click.IntRange:
    """A whole number within limits."""
    return click.IntRange(low, high)


POSITIVE = Number(0, min_open=True)
NOT_NEGATIVE = Number(0)
FRACTION = Number(0, 1, min_open=True, max_open=True)

_BRACKETS = {"(": ")", "[": "]", "{": "}"}
_ASSIGNMENT = re.compile(r"\s*[\w.*\[\]-]+\s*\+?=")


def split_list(text: str) -> list[str]:
    """Items of a list separated by commas; commas in brackets or quotes do not separate.

    If the list begins with NAME=VALUE, a comma only separates before the next NAME=, so that a
    value may be a list: ``a=1,2,b=3`` has two items.

    Raises
    ------
    ValueError
        An item is empty.
    """
    pairs = _ASSIGNMENT.match(text) is not None
    items, start, quote = [], 0, ""
    closing: list[str] = []
    for i, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in _BRACKETS:
            closing.append(_BRACKETS[letter])
        elif closing and letter == closing[-1]:
            closing.pop()
        elif letter == "," and not closing and (not pairs or _ASSIGNMENT.match(text, i + 1)):
            items.append(text[start:i].strip())
            start = i + 1
    items.append(text[start:].strip())
    if not all(items):
        raise ValueError(f"got {text!r}, expected items between commas, none of them empty")
    return items


class ListOption(click.Option):
    """Option that may be repeated and accepts lists with commas: ``-x a -x b`` is ``-x a,b``."""

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """All items, converted."""
        items: list[Any] = []
        for given in value or ():
            try:
                # A file whose name contains a comma is one item.
                whole = not isinstance(given, str) or Path(given).exists()
                items += [given] if whole else split_list(given)
            except ValueError as error:
                raise click.BadParameter(str(error), ctx, self) from None
            except OSError:  # too long for a file name
                items += split_list(given)
        return super().type_cast_value(ctx, tuple(items))


def parse_option(option: str, text: str, unit: str) -> float:
    """Value of an option with its unit, such as 6mm, in SI units.

    Raises
    ------
    InvalidParameter
        The value is invalid; the message names the option.
    """
    from unmodeled.units.quantity import parse_scalar

    try:
        return parse_scalar(text, unit)
    except ValueError as error:
        raise InvalidParameter(f"{option}: {error}") from None


def pairs(
    option: str, texts: Sequence[str], form: str = "NAME=VALUE", *, bare: bool = False
) -> dict[str, str]:
    """Values by name of an option that is given as ``NAME=VALUE``, as text.

    Parameters
    ----------
    option
        Name of the option, for the message.
    texts
        Values of the option.
    form
        What is expected, for the message.
    bare
        Whether a value may stand alone: it is that of "", of all names.

    Raises
    ------
    InvalidParameter
        A text is no pair, or a name is given twice.
    """
    values: dict[str, str] = {}
    for text in texts:
        head, mark, tail = (part.strip() for part in text.partition("="))
        name, value = (head, tail) if mark or not bare else ("", head)
        if not value or (mark and not name) or not (mark or bare):
            raise InvalidParameter(f"{option} {text}: expected {form}")
        if name in values:
            raise InvalidParameter(f"{option} {name or 'without a name'}: given twice")
        values[name] = value
    return values


# --- parameters of a command ---------------------------------------------------------------------


@dataclass(frozen=True)
class Declaration:
    """What the command line knows of a parameter: its words, type, help."""

    words: str
    """Names on the command line, separated by spaces; default: from that of the parameter."""
    attributes: Mapping[str, Any]
    """Attributes for click."""
    is_argument: bool = False

    def made(self, name: str, annotation: str) -> click.Parameter:
        """The parameter of click; flags, lists and paths follow from the annotation."""
        attributes = {k: v for k, v in self.attributes.items() if v is not None}
        listed = annotation.startswith("tuple[") and annotation.endswith(", ...]")
        if "Path" in annotation:
            attributes.setdefault("type", click.Path(path_type=Path))
        if self.is_argument:
            attributes.setdefault("nargs", -1 if listed else 1)
            optional = "default" in attributes or annotation.endswith("| None")
            attributes.setdefault("required", not optional)
            return click.Argument([name], **attributes)
        words = self.words.split() or [f"--{name.replace('_', '-')}"]
        words += ["-o"] if words == ["--out"] else []
        if annotation == "bool":
            return click.Option([name, *words], is_flag=True, **attributes)
        attributes.setdefault("show_default", attributes.get("default", "") != "")
        if not listed:
            return click.Option([name, *words], **attributes)
        attributes["help"] += " Repeatable, or a list with commas."
        return ListOption([name, *words], multiple=True, **attributes)


def option(
    text: str,
    type: Any = None,
    default: Any = None,
    *,
    words: str = "",
    metavar: str | None = None,
    complete: Any = None,
    show: str | None = None,
    **attributes: Any,
) -> Any:
    """One option, as the default of a parameter.

    Parameters
    ----------
    text
        Help.
    type
        Type of click; default: from the annotation of the parameter.
    default
        Value without the option.
    words
        Names on the command line, such as ``"--to"``; default: from that of the parameter.
    metavar, complete, show
        Name of the value, completion, and default in the help.
    attributes
        Other attributes for click.
    """
    attributes |= {"help": text, "type": type, "default": default, "metavar": metavar}
    return Declaration(words, attributes | {"shell_complete": complete, "show_default": show})


def argument(type: Any = None, *, complete: Any = None, **attributes: Any) -> Any:
    """One argument, as the default of a parameter."""
    return Declaration(
        "", attributes | {"type": type, "shell_complete": complete}, is_argument=True
    )


@dataclass(frozen=True)
class Fields:
    """Options that are the fields of a dataclass."""

    place: str
    """``module:class``; it is imported when the options are needed."""
    changes: Mapping[str, Mapping[str, Any]]
    """What the command line has otherwise than the field, by field."""
    convert: Callable[..., Any] | None = None

    @property
    def target(self) -> Any:
        """The dataclass."""
        module, _, name = self.place.partition(":")
        return getattr(importlib.import_module(module), name)

    def parts(self) -> Iterator[tuple[dataclasses.Field[Any], dict[str, Any], str]]:
        """Fields that are options, what is changed, and the names of the values of the options."""
        for f in dataclasses.fields(self.target):
            changes = dict(self.changes.get(f.name, {}))
            if isinstance(f.default, Declaration):
                changes["words"] = f.default.words
            elif f.name not in self.changes:
                continue
            elif f.type == "bool" and f.default is True:
                changes.setdefault("words", f"--no-{f.name.replace('_', '-')}")
            word = (changes.get("words") or f.name).split()[0]
            yield f, changes, word.lstrip("-").replace("-", "_").lower()

    def made(self) -> Iterator[click.Parameter]:
        """The options of click."""
        texts = _texts(self.target)
        for f, changes, name in self.parts():
            if isinstance(f.default, Declaration):
                made = replace(f.default, words=f.default.words or f"--{f.name.replace('_', '-')}")
                yield made.made(name, str(f.type))
            else:
                yield _field_option(f, name, texts.get(f.name, ""), changes)

    def take(self, given: dict[str, Any]) -> Any:
        """Remove the values of the options from ``given``, and make the dataclass of them."""
        values: dict[str, Any] = {}
        for f, changes, name in self.parts():
            value = given.pop(name)
            convert = changes.get("convert")
            if value is not None and convert is not None:
                value = convert(value)
            elif f.type == "bool" and f.default is True:
                value = not value
            if value is not None or isinstance(f.default, Declaration):
                values[f.name] = value
        return self.target(**values)


def is_given(name: str) -> bool:
    """Whether the option with this name of its value is on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is click.core.ParameterSource.COMMANDLINE


def fields_of(place: str, *names: str, **changes: Mapping[str, Any]) -> Any:
    """Options that are fields of a dataclass, as the default of a parameter.

    Parameters
    ----------
    place
        ``module:class``; fields made by :func:`option` are options as they are.
    names
        Fields whose options are exactly the fields.
    changes
        Other fields, with what their option has otherwise: ``text``, ``type``, ``words``,
        ``metavar``, ``default``, and ``convert``, a function of the value.
    """
    return Fields(place, {**{name: {} for name in names}, **changes})


def _field_option(
    f: dataclasses.Field[Any], name: str, text: str, changes: dict[str, Any]
) -> click.Parameter:
    """Option of a field: type and unit from its annotation and its documentation."""
    changes.pop("convert", None)
    kind = str(f.type).removesuffix(" | None")
    listed = kind.startswith(("Mapping[", "Sequence["))
    unit = re.search(r"\[([^\[\]]+)\]", text)
    known = {"float": Quantity(unit[1] if unit else "1"), "int": count()}
    default = None if f.default is dataclasses.MISSING or listed else f.default
    changes.setdefault("default", None if default == "" or kind == "bool" else default)
    changes.setdefault("type", known.get(kind))
    changes.setdefault("words", f"--{f.name.replace('_', '-')}")
    text = changes.pop("text", text.replace(" [1]", ""))
    made: Declaration = option(text, **changes)
    return made.made(name, "tuple[str, ...]" if listed else kind)


@cache
def _texts(target: type) -> dict[str, str]:
    """First sentence of the documentation of each field."""
    texts = {}
    doc = inspect.getdoc(target) or ""
    for m in re.finditer(r"^(\w+) : .*\n((?:    .*\n?|\n)+)", doc, re.MULTILINE):
        texts[m[1]] = m[2]
    body = ast.parse(textwrap.dedent(inspect.getsource(target))).body[0].body  # type: ignore[attr-defined]
    for node, after in pairwise(body):
        if isinstance(node, ast.AnnAssign) and isinstance(after, ast.Expr):
            texts[ast.unparse(node.target)] = ast.literal_eval(after.value)
    return {name: _first_sentence(text) for name, text in texts.items()}


def _first_sentence(text: str) -> str:
    words = " ".join(text.replace("``", "").split())
    end = re.search(r"\.(?= [A-Z])|\.$", words)
    return words[: end.end()] if end else words


class _Declared:
    """Options are made when they are needed, with the modules of their fields."""

    def __init__(
        self,
        name: str,
        function: Callable[..., None],
        *,
        more: Sequence[Any] = (),
        **attributes: Any,
    ) -> None:
        self._function = function
        self._more = more
        self._made: list[click.Parameter] = []
        super().__init__(name, callback=self._call, help=inspect.getdoc(function), **attributes)  # type: ignore[call-arg]

    @property
    def _parts(self) -> dict[str, inspect.Parameter]:
        return dict(inspect.signature(self._function).parameters)

    @property
    def params(self) -> list[click.Parameter]:
        """Options and arguments."""
        if not self._made:
            for name, part in self._parts.items():
                spec = part.default
                if isinstance(spec, Fields):
                    self._made += spec.made()
                elif isinstance(spec, Declaration):
                    self._made.append(spec.made(name, str(part.annotation)))
            self._made += [make() for make in (as_json_option, *self._more)]
        return self._made

    @params.setter
    def params(self, given: list[click.Parameter]) -> None:
        self._made = given

    def _call(self, **given: Any) -> None:
        parts = self._parts
        for name, part in parts.items():
            if isinstance(part.default, Fields):
                given[name] = part.default.take(given)
        if "as_json" in parts:
            self._function(**given)
        else:
            collected_json(self._function, **given)


class Command(_Declared, click.Command):
    """A command of :func:`declare`."""


class CommandGroup(_Declared, click.Group):
    """A command of :func:`declare` that has commands below it."""


C = TypeVar("C", bound=click.Command)


def declare(
    name: str,
    group: click.Group | None = None,
    short: str | None = None,
    *,
    cls: type[C] = Command,  # type: ignore[assignment]
    **attributes: Any,
) -> Callable[[Callable[..., None]], C]:
    """Make a command from a function whose parameters are options and arguments.

    Every command has ``--json``. A function with the parameter ``as_json`` prints JSON itself;
    tables and files of another one are collected, see :func:`unmodeled.cli.screen.collected_json`.

    Parameters
    ----------
    name
        Name of the command.
    group
        Group to which it belongs.
    short
        Its line in the help of the group; default: from the documentation of the function.
    cls
        ``CommandGroup`` for a command with commands below it.
    attributes
        ``more``: functions that make options whose values the function does not get. Others are
        attributes for click.
    """

    def make(function: Callable[..., None]) -> C:
        made = cls(name, function, short_help=short, **attributes)  # type: ignore[arg-type]
        if group is not None:
            group.add_command(made)
        return made

    return make


def group(name: str) -> Callable[[Callable[[], None]], click.Group]:
    """Group of commands; its help is that of the function."""
    return click.group(name=name, context_settings={"help_option_names": ["-h", "--help"]})


# --- options that several commands have ----------------------------------------------------------

FORCE = option("Overwrite existing files.")
SEED = option("Seed of all random draws.", count(0), 0)
MODEL_SET = option(
    "Setting of a model of an extension; its documentation lists them.",
    words="--set",
    metavar="NAME=VALUE",
    complete=completing.settings,
)


def picture(text: str) -> Any:
    """Option ``--plot FILE`` of a command that draws one picture."""
    return option(text, FileName(".png", ".pdf", ".svg"), words="--plot", metavar="FILE")
