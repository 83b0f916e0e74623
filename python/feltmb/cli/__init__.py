"""Command line of feltmb. Commands are imported when they are called, so that help is fast."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
import warnings
from pathlib import Path
from typing import Any

import click

from feltmb.blas import one_thread_from_the_start

__all__ = ["main"]

#: command -> (module below feltmb.cli, one line of help)
COMMANDS = {
    "stroke": ("stroke", "Simulate strokes, and save, plot or summarize them."),
    "demo": ("demo", "Demonstration: piano, forte, staccato; table, plots, animation."),
    "regulate": ("regulate", "Regulate a mechanism as a technician does, steps A to F."),
    "sensitivity": ("sensitivity", "Derivatives of a stroke with respect to parameters."),
    "actuator": ("actuator", "The key actuator: simulate, study, match a finger force."),
    "touch": ("touch", "Static and dynamic touch: weights, let-off, timing."),
    "repeat": ("repeat", "Repetition: highest rate at which every press strikes, and why."),
    "wear": ("wear", "Wear: each felt, friction and spring changed, against the regulation."),
    "symptom": ("symptom", "Symptoms, such as blocks: tests, causes and screws."),
    "gap": ("gap", "The gap to measurements: where, which cause, how far it shrinks."),
    "fit": ("fit", "Fit a model to measured records: parameters with intervals."),
    "show": ("show", "Bodies, contacts, springs of a mechanism, with units and sources."),
    "fmu": ("fmu", "Export a mechanism as a co-simulation unit (FMI 3.0 or 2.0)."),
    "plot": ("plot", "Plots of saved runs."),
    "view": ("view", "Saved runs in a browser: motion, forces, curves, string."),
    "live": ("live", "Change a mechanism in a browser and see its motion."),
    "animate": ("animate", "Animation of a saved run (GIF)."),
    "wav": ("wav", "Sound of the string of a saved run (WAV)."),
    "felt": ("felt", "Felt: identification, envelopes for the contact law, audit."),
    "fiber": ("fiber", "Micromechanics of fiber masses: structure, contacts, laws, fits."),
    "list": ("listing", "Packaged mechanisms, strokes, actuators, laws, units."),
    "validate": ("validate", "Check mechanism, stroke and run files; report all faults."),
    "new": ("new", "Write a commented template of a mechanism file."),
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
        module = importlib.import_module(f"feltmb.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = module.command
        return command

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
    from feltmb.cli.common import complain, say
    from feltmb.errors import FeltmbError, FileExists, ModelError

    for word in arguments or ():  # impossible in a shell, but possible in a call from Python
        if "\0" in word:
            complain(f"argument {word[:60]!r}: holds a null character, expected none")
            sys.exit(2)
    code: Any = 0
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: complain(f"warning: {message}")
            code = command.main(arguments, prog_name=name, standalone_mode=False)
    except SystemExit as end:
        if "_FELTMB_COMPLETE" in os.environ:  # click ends in this way after a completion
            raise
        frames = traceback.extract_tb(end.__traceback__)
        by_click = frames and frames[-1].filename.startswith(str(Path(click.__file__).parent))
        # The reader of the output ended: rich and click end in these ways.
        if by_click or isinstance(end.__context__, BrokenPipeError):
            sys.exit(0)
        # No command ends in this way: a Python model or effect of the user did.
        where = f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else "a model"
        complain(
            f"{where}: ends the program (exit code {end.code!r}); a model must return or raise an "
            "exception"
        )
        code = 1
    except click.exceptions.Abort:
        complain("interrupted")
        code = 130
    except click.ClickException as error:
        if isinstance(error, click.UsageError) and error.ctx is not None:
            say(error.ctx.get_usage(), err=True)
            say(f"Try '{error.ctx.command_path} --help' for help.\n", err=True)
        complain(error.format_message())
        code = error.exit_code
    except KeyboardInterrupt as error:
        complain(f"interrupted{f': {error}' if str(error) else ''}")
        code = 130
    except FeltmbError as error:
        complain(str(error))
        bad_input = isinstance(error, (ValueError, FileExists, ModelError))
        code = 2 if bad_input else 1
    except BrokenPipeError:
        code = 0
    except MemoryError as error:
        complain(f"not enough memory: {error}" if str(error) else "not enough memory")
        code = 1
    except OSError as error:
        complain(f"{error.filename or 'a file'}: {error.strerror or error}")
        code = 1
    sys.exit(code if isinstance(code, int) else 0)
