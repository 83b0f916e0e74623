"""Shell completion: names of packaged data, laws and effects; else files."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from unmodeled.cli.completing import matching, words

if TYPE_CHECKING:
    from feltmb.run.results import Run

Completer = Callable[[click.Context, click.Parameter, str], "list[CompletionItem]"]


def packaged(*kinds: str) -> Completer:
    """Names of packaged data of these kinds, folders of ``feltmb.params``."""

    def complete(
        _context: click.Context, _parameter: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        from feltmb import params

        return matching((name for kind in kinds for name in params.names(kind)), incomplete)

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

    return matching([*models(), *history_models()], incomplete)


def mechanism_named() -> str | None:
    """Mechanism on the command line."""
    from feltmb import params
    from unmodeled.files import is_file

    known = params.names()
    return next(
        (w for w in words() if w in known or (w.endswith(".toml") and is_file(Path(w)))), None
    )


def _paths(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths of the values of a mechanism file; a body may also be given by its name."""
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
    """Whether a file has the table of a path; --set can add values, but no tables."""
    *tables, last = path.split(".")
    node: Any = raw
    for key in tables:
        if not isinstance(node, Mapping) or key not in node:
            return False
        node = node[key]
    return isinstance(node, Mapping) if last not in ("x", "y") else True


def _settable() -> dict[str, Any]:
    """Value by dotted path of the mechanism on the command line."""
    from feltmb.mechanism import load_action
    from unmodeled.errors import Error

    name = mechanism_named()
    if name is None:
        return {}
    try:
        action = load_action(name)
    except Error:
        return {}
    raw = action.raw  # a copy of the whole mechanism
    found = {k: v for k, v in _paths(action.config) if _is_given(raw, k)}
    short = {k.removeprefix("bodies."): v for k, v in found.items() if k.startswith("bodies.")}
    return found | short


def paths(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Dotted paths of the values of the mechanism on the command line."""
    return [CompletionItem(path) for path in _settable() if path.startswith(incomplete)]


def settings(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """PATH= for the mechanism on the command line; values too if they are words."""
    return [CompletionItem(found) for found in setting_words(incomplete)]


def setting_words(incomplete: str, more: Iterable[str] = ()) -> Iterator[str]:
    """Completions of a setting of the mechanism on the command line; ``more``: other names."""
    from feltmb.contact import LAWS

    path, sign, value = incomplete.partition("=")
    known: dict[str, Any] = {**dict.fromkeys(more), **_settable()}
    if not sign:
        yield from (f"{name}=" for name in known if name.startswith(path))
    elif path.rpartition(".")[2] == "law":
        yield from (f"{path}={word}" for word in LAWS if word.startswith(value))
    elif isinstance(known.get(path), bool):
        yield from (f"{path}={word}" for word in ("true", "false") if word.startswith(value))


def _runs() -> Iterator[Run]:
    """Saved runs on the command line; unreadable files give no completions."""
    from feltmb.run.results import load_run
    from unmodeled.errors import Error
    from unmodeled.files import is_file

    for word in words():
        if word.endswith(".nc") and is_file(Path(word)):
            with contextlib.suppress(Error):
                yield load_run(word)


def outputs(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Outputs of the saved runs on the command line."""
    names = dict.fromkeys(name for run in _runs() for name in run.names)
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def events(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Events that all saved runs on the command line have."""
    lists = [list(run.event_table["event"]) for run in _runs()]
    first = dict.fromkeys(lists[0] if lists else ())
    names = [name for name in first if all(name in each for each in lists)]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]
