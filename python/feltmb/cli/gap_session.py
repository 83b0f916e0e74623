"""``feltmb gap session``: repeats plan, measurement and diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.common import (
    Number,
    ProgressLine,
    credibility_option,
    folder_option,
    form_option,
    json_option,
    model_set_option,
    positive,
    print_json,
    say,
)
from feltmb.cli.completing import actions
from feltmb.cli.gap_plan import (
    Telling,
    input_files,
    limits_of,
    limits_option,
    measured_option,
    sensors_of,
    units_of,
)
from feltmb.errors import DataError, InvalidParameter

if TYPE_CHECKING:
    from feltmb.gap import SessionStep

__all__ = ["command"]

#: Number of characters of a command's output that are shown.
LAST_WORDS = 400


@click.command("session", short_help="Plan, measure and diagnose until the cause is named.")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--run",
    "run_command",
    metavar="COMMAND",
    required=True,
    help="Program that performs an experiment. It is called as COMMAND REQUEST RECORD.",
)
@folder_option(
    "Folder of the session, with one folder for each step. An interrupted session continues.",
    required=True,
)
@click.option(
    "--budget",
    type=Number(0, 1000, min_open=True),
    default=6.0,
    show_default=True,
    help="Number of records; the limits give the cost of a test of a part and of a sensor.",
)
@limits_option
@measured_option
@click.option("--timeout", type=positive("s"), help="Longest time of one call of COMMAND [s].")
@click.option("--candidates", type=click.IntRange(1, 10_000), default=12, show_default=True,
              help="Number of profiles that are evaluated in full.")  # fmt: skip
@click.option("--refine", "refinements", type=click.IntRange(0, 10_000), default=4,
              show_default=True, help="Profiles that improve the next experiment.")  # fmt: skip
@click.option("--bootstrap", type=click.IntRange(0, 100_000), default=12, show_default=True,
              help="Refits for the null distribution of each diagnosis.")  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random draws."
)
@credibility_option
@form_option
@model_set_option
@json_option
def command(
    model: str,
    data: tuple[Path, ...],
    run_command: str,
    output: Path,
    budget: float,
    limits_file: Path | None,
    measured: Path | None,
    timeout: float | None,
    candidates: int,
    refinements: int,
    bootstrap: int,
    seed: int,
    credibility: float,
    form: float,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Plan an experiment for MODEL, run it with COMMAND, diagnose, and repeat.

    COMMAND has two arguments. REQUEST is a CSV file with the time and the values of each input.
    COMMAND applies these inputs and writes the measurement to RECORD, a CSV file with time, inputs
    and outputs. A TOML file of the same name may describe the sensors. If the limits contain tests
    of parts, REQUEST may be a TOML file with [part] (parameter, sd, how). RECORD is then a TOML
    file with [measured.NAME] (value, sd). If they contain further sensors, REQUEST may be a
    TOML file with [sensor] (output, sigma, how). RECORD is then a TOML file with [sensors.OUTPUT]
    (sigma), and all later records have this output. The exit code must be 0. DATA are earlier
    records.

    The session ends when the cause is named, when no experiment within limits and budget separates
    the remaining causes, when nothing is missing, when nothing more can be learned, or when the
    budget is spent. A second call with the same folder continues the session.
    """
    from feltmb.cli.gap_models import load_adapter
    from feltmb.gap import Options, read_measured, session
    from feltmb.gap.report import plain

    call = _Caller(run_command, timeout)
    adapter = load_adapter(model, settings)
    records = adapter.read(data) if data else ()
    adapter = adapter.with_records(records, limits_file)
    limits = limits_of(model, adapter, limits_file)
    telling, line = Telling(), ProgressLine()
    warned: set[str] = set()

    def told(step: SessionStep) -> None:
        telling.close()
        line.close()
        if not as_json:
            say(f"{step.number}: {step.name}")
            if step.kind == "record":
                say(f"   expected probability of the correct name after it: {step.expected:.0%}")
            if step.verdict:
                say(f"   {step.verdict}: {step.statement}")
            for text in step.warnings:
                if text not in warned:  # a warning of an earlier step is still valid
                    warned.add(text)
                    say(f"   Warning: {text}")

    found = session(
        adapter.model,
        adapter.effects,
        call,
        lambda path: adapter.read([path]),
        output,
        limits=limits,
        records=records,
        sensors=sensors_of(adapter, limits, records, ()),
        measured=()
        if measured is None
        else read_measured(measured, adapter.model, adapter.effects),
        budget=budget,
        options=Options(
            credibility=credibility, form=form, bootstrap=bootstrap, seed=seed, advice=False
        ),
        candidates=candidates,
        refinements=refinements,
        seed=seed,
        units=units_of(adapter, limits),
        input_files=input_files(adapter, units_of(adapter, limits), force=True),
        progress=telling,
        diagnosing=line,
        told=told,
    )
    telling.close()
    line.close()
    if as_json:
        print_json({k: v for k, v in plain(found).items() if k != "report"})
        return
    say(f"{found.outcome}: {found.statement}")
    say(f"{output}: a folder a step, each with plan and report")


class _Caller:
    """Calls the command of the user."""

    def __init__(self, text: str, timeout: float | None):
        import shlex

        try:
            self.words = shlex.split(text)
        except ValueError as error:
            raise InvalidParameter(f"--run {text}: {error}") from None
        if not self.words:
            raise InvalidParameter("--run: is empty, expected a command such as 'python rig.py'")
        self.timeout = timeout

    def __call__(self, request: Path, answer: Path) -> None:
        """Perform a request."""
        import subprocess

        try:
            done = subprocess.run(
                [*self.words, str(request), str(answer)],
                check=False,
                capture_output=True,
                text=True,
                timeout=self.timeout,
            )
        except FileNotFoundError:
            raise InvalidParameter(f"--run: there is no command {self.words[0]}") from None
        except subprocess.TimeoutExpired:
            raise DataError(
                f"--run {' '.join(self.words)} {request.name}: took more than {self.timeout:g} s "
                "(--timeout) and was ended"
            ) from None
        except OSError as error:
            raise DataError(f"--run {' '.join(self.words)}: {error}") from None
        if done.returncode:
            said = (done.stderr or done.stdout).strip()[-LAST_WORDS:]
            raise DataError(
                f"--run {' '.join(self.words)} {request.name}: ended with exit code "
                f"{done.returncode}, expected 0" + (f"; it said: {said}" if said else "")
            )
        if not answer.is_file():
            raise DataError(
                f"--run {' '.join(self.words)}: wrote no {answer}; expected the record there"
            )
