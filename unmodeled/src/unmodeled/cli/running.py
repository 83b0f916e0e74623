"""Groups of commands that are imported when they are called, and one message for each error."""

from __future__ import annotations

import difflib
import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path

import click

from unmodeled.blas import one_thread_from_the_start

#: command -> (module and object in it, one line of help)
Commands = Mapping[str, tuple[str, str]]


class LazyGroup(click.Group):
    """Group whose commands are in modules that are imported when they are used.

    Parameters
    ----------
    listed
        Command -> (``module:object``, its line in the help of the group).
    """

    def __init__(self, *arguments: object, listed: Commands, **attributes: object) -> None:
        super().__init__(*arguments, **attributes)  # type: ignore[arg-type]
        self.listed = listed

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands."""
        del ctx
        return list(self.listed)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        del ctx
        if cmd_name not in self.listed:
            return None
        module, _, name = self.listed[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), name or "command")
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of the commands without importing them."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self.listed.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; an unknown name gives the most similar one."""
        name = args[0] if args else ""
        if name and name not in self.listed and not name.startswith("-"):
            near = difflib.get_close_matches(name, self.listed, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise click.UsageError(f"No such command {name!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)


def version_option(package: str) -> click.Option:
    """Option ``--version`` of a package."""

    def show_version(ctx: click.Context, _parameter: click.Parameter, wanted: bool) -> None:
        if not wanted or ctx.resilient_parsing:
            return
        click.echo(f"{package}, version {importlib.import_module(package).__version__}")
        ctx.exit()

    return click.Option(
        ["--version"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show_version,
        help="Show the version and exit.",
    )


def run(command: click.Command, arguments: list[str] | None, name: str) -> None:
    """Run a command line; no traceback is shown for invalid input.

    Parameters
    ----------
    command
        The command or group.
    arguments
        Words of the command line; None: those of the process.
    name
        Name of the program, the beginning of its messages.
    """
    one_thread_from_the_start()
    try:
        from unmodeled.cli.screen import complain, named

        with named(name), warnings.catch_warnings():
            for word in arguments or ():  # impossible in a shell, but possible in Python
                if "\0" in word:
                    raise click.UsageError(
                        f"argument {word[:60]!r}: holds a null character, expected none"
                    )
            warnings.showwarning = lambda message, *_: complain(f"warning: {message}")
            code = command.main(arguments, prog_name=name, standalone_mode=False)
    except SystemExit as end:
        if f"_{name.upper()}_COMPLETE" in os.environ:  # click ends so after a completion
            raise
        code = _ended(end, name)
    except (Exception, KeyboardInterrupt) as error:
        code = _reported(error, name)
    sys.exit(code if isinstance(code, int) else 0)


def _ended(end: SystemExit, name: str) -> int:
    """Exit code after an end of the program in the middle of a command."""
    from unmodeled.cli.screen import complain, named

    frames = traceback.extract_tb(end.__traceback__)
    by_click = frames and frames[-1].filename.startswith(str(Path(click.__file__).parent))
    # The reader of the output ended: rich and click end in these ways.
    if by_click or isinstance(end.__context__, BrokenPipeError):
        return 0
    # No command ends in this way: a Python model or effect of the user did.
    where = f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else "a model"
    with named(name):
        complain(
            f"{where}: ends the program (exit code {end.code!r}); a model must return or raise an "
            "exception"
        )
    return 1


def _reported(error: BaseException, name: str) -> int:
    """Print one message for an error, and return the exit code; others are raised."""
    from unmodeled.cli.screen import complain, named, say
    from unmodeled.errors import Error, FileExists, ModelError

    text, code = str(error), 1
    if isinstance(error, BrokenPipeError):
        return 0
    if isinstance(error, (click.exceptions.Abort, KeyboardInterrupt)):
        text, code = f"interrupted{f': {text}' if text else ''}", 130
    elif isinstance(error, click.ClickException):
        if isinstance(error, click.UsageError) and error.ctx is not None:
            say(error.ctx.get_usage(), err=True)
            say(f"Try '{error.ctx.command_path} --help' for help.\n", err=True)
        text, code = error.format_message(), error.exit_code
    elif isinstance(error, Error):
        code = 2 if isinstance(error, (ValueError, FileExists, ModelError)) else 1
    elif isinstance(error, MemoryError):
        text = f"not enough memory: {error}" if text else "not enough memory"
    elif isinstance(error, OSError):
        text = f"{error.filename or 'a file'}: {error.strerror or error}"
    else:
        raise error
    with named(name):
        complain(text)
    return code
