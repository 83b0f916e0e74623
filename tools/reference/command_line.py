"""The command line: the help of every command."""

from __future__ import annotations

from collections.abc import Iterator

import click

WIDTH = 80


def commands(
    command: click.Command, context: click.Context, path: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Path and help of a command and of its subcommands."""
    if hasattr(command, "_help_option"):
        command._help_option = None  # cached by an earlier call with other names of the option
    yield path, command.get_help(context)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            inner = below.context_class(below, info_name=name, parent=context)
            yield from commands(below, inner, (*path, name))


def page() -> str:
    """Text of the page."""
    from feltmb.cli import cli

    context = click.Context(
        cli,
        info_name="feltmb",
        terminal_width=WIDTH,
        max_content_width=WIDTH,
        help_option_names=["-h", "--help"],
    )
    lines = [
        "# Command line",
        "",
        "The help of every command, as it prints it. What all commands share is in",
        "[the conventions](../conventions.md).",
        "",
    ]
    for path, text in commands(cli, context, ("feltmb",)):
        lines += [f"{'#' * min(len(path) + 1, 4)} {' '.join(path)}", "", "```text"]
        lines += [line.rstrip() for line in text.splitlines()]
        lines += ["```", ""]
    return "\n".join(lines).rstrip() + "\n"
