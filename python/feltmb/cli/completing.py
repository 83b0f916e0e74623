"""What the shell completes: names of packaged data, of laws, of effects; else files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem, split_arg_string

if TYPE_CHECKING:
    from feltmb.run.results import Run

__all__ = [
    "actions",
    "actuators",
    "effects",
    "events",
    "felts",
    "fiber_laws",
    "outputs",
    "packaged",
    "paths",
    "settings",
    "strokes",
]

Completer = Callable[[click.Context, click.Parameter, str], "list[CompletionItem]"]


def _matching(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """Names that go on as the word begins; files too, where the shell finds no name."""
    return [
        CompletionItem(incomplete, type="file"),
        *(CompletionItem(name) for name in names if name.startswith(incomplete)),
    ]


def packaged(*kinds: str) -> Completer:
    """Names of packaged data of these kinds, folders of ``feltmb.params``."""

    def complete(
        _context: click.Context, _parameter: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        from feltmb import params

        return _matching((name for kind in kinds for name in params.names(kind)), incomplete)

    return complete


actions = packaged("")
strokes = packaged("strokes")
felts = packaged("felts")
actuators = packaged("actuators")


def fiber_laws(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Laws of fiber masses."""
    from feltmb.fiber import history_models, models

    return _matching([*models(), *history_models()], incomplete)


def _line() -> list[str]:
    """Words of the line: it ends in an option without its value, so that click has read none."""
    return split_arg_string(os.environ.get("COMP_WORDS", ""))


def _mechanism() -> str | None:
    """The mechanism that the line names."""
    from feltmb import params
    from feltmb.files import is_file

    known = params.names()
    return next(
        (w for w in _line() if w in known or (w.endswith(".toml") and is_file(Path(w)))), None
    )


def effects(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Effects of the library for the mechanism of the line; nothing of a Python file is run."""
    from feltmb.errors import FeltmbError

    model = _mechanism()
    if model is None:
        return []
    from feltmb.cli.gap_models import load_adapter

    try:
        names = [effect.name for effect in load_adapter(model).effects]
    except FeltmbError:
        return []
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _paths(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths of the values of a mechanism file; a body also goes by its own name."""
    from pydantic import BaseModel

    if isinstance(node, tuple):
        yield path, node
        yield from ((f"{path}.{axis}", value) for axis, value in zip("xy", node, strict=False))
        return
    fields = dict(node) if isinstance(node, (BaseModel, Mapping)) else None
    if fields is None:
        yield path, node
        return
    for key, value in fields.items():
        if path or key not in ("schema_version", "name", "about", "source", "start_pose", "events"):
            yield from _paths(value, f"{path}.{key}" if path else key)


def _is_given(raw: Mapping[str, Any], path: str) -> bool:
    """Whether a file has the table that a path ends in; --set makes values, but no tables."""
    *tables, last = path.split(".")
    node: Any = raw
    for key in tables:
        if not isinstance(node, Mapping) or key not in node:
            return False
        node = node[key]
    return isinstance(node, Mapping) if last not in ("x", "y") else True


def _settable() -> dict[str, Any]:
    """Value by dotted path, of the mechanism that the line names."""
    from feltmb.errors import FeltmbError
    from feltmb.mechanism import load_action

    name = _mechanism()
    if name is None:
        return {}
    try:
        action = load_action(name)
    except FeltmbError:
        return {}
    found = {k: v for k, v in _paths(action.config) if _is_given(action.raw, k)}
    short = {k.removeprefix("bodies."): v for k, v in found.items() if k.startswith("bodies.")}
    return found | short


def paths(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Dotted paths of the values of the mechanism of the line."""
    return [CompletionItem(path) for path in _settable() if path.startswith(incomplete)]


#: Settings of what is fitted or diagnosed, beside the values of its mechanism.
ADAPTER = ("channels", "effects", "library", "rtol", "segment",
           "tolerances", "until", "variation")  # fmt: skip


def settings(
    _context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """PATH= of the mechanism of the line; the values where they are words."""
    from feltmb.contact import LAWS

    path, sign, value = incomplete.partition("=")
    of_adapter = dict.fromkeys(ADAPTER) if parameter.metavar == "NAME=VALUE" else {}
    known: dict[str, Any] = {**of_adapter, **_settable()}
    if not sign:
        return [CompletionItem(f"{name}=") for name in known if name.startswith(path)]
    if path.rpartition(".")[2] == "law":
        words: Iterable[str] = LAWS
    else:
        words = ("true", "false") if isinstance(known.get(path), bool) else ()
    return [CompletionItem(f"{path}={word}") for word in words if word.startswith(value)]


def _runs() -> Iterator[Run]:
    """The saved runs that the line names; what cannot be read has nothing to complete."""
    from feltmb.errors import FeltmbError
    from feltmb.files import is_file
    from feltmb.run.results import load_run

    for word in _line():
        if word.endswith(".nc") and is_file(Path(word)):
            with contextlib.suppress(FeltmbError):
                yield load_run(word)


def outputs(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Outputs of the saved runs of the line."""
    names = dict.fromkeys(name for run in _runs() for name in run.names)
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def events(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Events that all saved runs of the line have."""
    lists = [list(run.event_table["event"]) for run in _runs()]
    first = dict.fromkeys(lists[0] if lists else ())
    names = [name for name in first if all(name in each for each in lists)]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]
