"""Command line of feltmb. Commands are imported when they are called, so that help is fast."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
import warnings
from pathlib import Path

import click

from unmodeled.blas import one_thread_from_the_start

__all__ = ["main"]

#: command -> (module below feltmb.cli, and object in it, one line of help)
COMMANDS = {
    "stroke": ("stroke", "Simulate strokes, and save, plot or summarize them."),
    "demo": ("stroke:demo", "Demonstration: piano, forte, staccato; table, plots, animation."),
    "regulate": ("technician:regulate", "Regulate a mechanism as a technician does, steps A to F."),
    "sensitivity": ("sensitivity", "Derivatives of a stroke with respect to parameters."),
    "actuator": ("actuator", "The key actuator: simulate, match a finger force."),
    "touch": ("technician:touch", "Static and dynamic touch: weights, let-off, timing."),
    "repeat": (
        "technician:repeat",
        "Repetition: highest rate up to which every press is a note, and why.",
    ),
    "wear": (
        "technician:wear",
        "Wear: each felt, friction and spring changed, against the regulation.",
    ),
    "symptom": ("technician:symptom", "Symptoms, such as blocks: tests, causes and screws."),
    "gap": ("gap", "The gap to measurements: where, which cause, how far it shrinks."),
    "fit": ("gap:fit", "Fit a model to measured records: parameters with intervals."),
    "show": (
        "inputs:showing",
        "Bodies, contacts, springs of a mechanism, with units and sources.",
    ),
    "fmu": ("inputs:fmu", "Export a mechanism as a co-simulation unit (FMI 3.0 or 2.0)."),
    "plot": ("runs:plot", "Plots of saved runs."),
    "view": ("runs:view", "Saved runs in a browser: motion, forces, curves, string."),
    "live": ("inputs:live", "Change a mechanism in a browser and see its motion."),
    "animate": ("runs:animate", "Animation of a saved run (GIF)."),
    "wav": ("runs:wav", "Sound of the string of a saved run (WAV)."),
    "felt": ("felt", "Felt: identification, envelopes for the contact law, audit."),
    "fiber": ("fiber", "Fiber masses: fits of compression laws, simulation of fibers."),
    "list": (
        "inputs:listing",
        "Packaged mechanisms, strokes, actuators, felts, laws, units.",
    ),
    "validate": ("inputs:validate", "Check mechanism, stroke and run files; report all faults."),
    "new": ("inputs:new", "Write a commented template of a mechanism file."),
}


class _Lazy(click.Group):
    """Group whose commands are in modules that are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in COMMANDS:
            return None
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        found = getattr(importlib.import_module(f"feltmb.cli.{module}"), name or "command")
        assert isinstance(found, click.Command)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        import difflib

        name = args[0] if args else ""
        if name and name not in COMMANDS and not name.startswith("-"):
            near = difflib.get_close_matches(name, COMMANDS, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise click.UsageError(f"No such command {name!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)


def _show_version(ctx: click.Context, _parameter: click.Parameter, wanted: bool) -> None:
    if not wanted or ctx.resilient_parsing:
        return
    from feltmb import __version__

    click.echo(f"feltmb, version {__version__}")
    ctx.exit()


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_version,
    help="Show the version and exit.",
)
def cli() -> None:
    """Simulate machines whose parts meet through felt.

    Exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.
    """


def main(
    arguments: list[str] | None = None, command: click.Command = cli, name: str = "feltmb"
) -> None:
    """Run the command line, or another command; no traceback is shown for invalid input."""
    one_thread_from_the_start()
    from feltmb.cli.screen import complain

    for word in arguments or ():  # impossible in a shell, but possible in a call from Python
        if "\0" in word:
            complain(f"argument {word[:60]!r}: holds a null character, expected none")
            sys.exit(2)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: complain(f"warning: {message}")
            code = command.main(arguments, prog_name=name, standalone_mode=False)
    except SystemExit as end:
        if "_FELTMB_COMPLETE" in os.environ:  # click ends in this way after a completion
            raise
        code = _ended(end)
    except (Exception, KeyboardInterrupt) as error:
        code = _told(error)
    sys.exit(code if isinstance(code, int) else 0)


def _ended(end: SystemExit) -> int:
    """Exit code after an end of the program in the middle of a command."""
    from feltmb.cli.screen import complain

    frames = traceback.extract_tb(end.__traceback__)
    by_click = frames and frames[-1].filename.startswith(str(Path(click.__file__).parent))
    # The reader of the output ended: rich and click end in these ways.
    if by_click or isinstance(end.__context__, BrokenPipeError):
        return 0
    # No command ends in this way: a Python model or effect of the user did.
    where = f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else "a model"
    complain(
        f"{where}: ends the program (exit code {end.code!r}); a model must return or raise an "
        "exception"
    )
    return 1


def _told(error: BaseException) -> int:
    """Print one message for an error, and return the exit code; others are raised."""
    from feltmb.cli.screen import complain, say
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
    complain(text)
    return code
