"""What the shell completes: names of packaged data, of laws, of effects; else files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem, split_arg_string

__all__ = ["actions", "actuators", "effects", "felts", "fiber_laws", "packaged", "strokes"]

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


def effects(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Effects of the library for the mechanism of the line; nothing of a Python file is run."""
    from feltmb import params
    from feltmb.errors import FeltmbError
    from feltmb.files import is_file

    # The line ends in an option without its value, so that click has not read the arguments.
    words = split_arg_string(os.environ.get("COMP_WORDS", ""))
    known = params.names()
    model = next(
        (w for w in words if w in known or (w.endswith(".toml") and is_file(Path(w)))), None
    )
    if model is None:
        return []
    from feltmb.cli.gap_subjects import load_subject

    try:
        names = [effect.name for effect in load_subject(model).effects]
    except FeltmbError:
        return []
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]
