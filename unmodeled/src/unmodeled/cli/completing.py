"""Shell completion: names of models and their settings; else files."""

from __future__ import annotations

import os
from collections.abc import Iterable

import click
from click.shell_completion import CompletionItem, split_arg_string

from unmodeled.loading import extensions


def matching(names: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """Names that begin with the word; files too, if the shell finds no name."""
    return [
        CompletionItem(incomplete, type="file"),
        *(CompletionItem(name) for name in names if name.startswith(incomplete)),
    ]


def words() -> list[str]:
    """Words of the command line; click has not parsed it, because the last option has no value."""
    return split_arg_string(os.environ.get("COMP_WORDS", ""))


def models(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Names of the models of extensions, and files."""
    return matching((n for e in extensions() for n in e.names()), incomplete)


def settings(
    _context: click.Context, _parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Settings of the model of an extension on the command line."""
    items = (item for e in extensions() for item in e.settings(words(), incomplete))
    return [CompletionItem(item) for item in items]
