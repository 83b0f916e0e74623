"""Command line of unmodeled. Commands are imported when they are called, so that help is fast."""

from __future__ import annotations

from unmodeled.cli.running import LazyGroup, run, version_option

__all__ = ["COMMANDS", "cli", "main"]

#: command -> (module and object in it, one line of help)
COMMANDS = {
    "check": ("unmodeled.cli.records:check", "Check measured files, also against a model."),
    "diagnose": ("unmodeled.cli.diagnose:run", "Which effect does the model lack, and how large?"),
    "fit": ("unmodeled.cli.diagnose:fit", "Fit parameters to records, with intervals."),
    "plan": ("unmodeled.cli.plan:plan", "What proposed records would tell about causes."),
    "why": ("unmodeled.cli.why:why", "Why a candidate is in the answer, or not."),
    "verify": ("unmodeled.cli.verify:verify", "Repeat a diagnosis, and compare the answers."),
    "blind": ("unmodeled.cli.diagnose:blind", "Test the diagnosis on simulated machines."),
    "page": ("unmodeled.page.serve:command", "Model, records and diagnosis in a browser."),
    "join": ("unmodeled.cli.records:join", "Join two files with two clocks to one record."),
    "new": ("unmodeled.cli.records:new", "Write the TOML file that describes a measured file."),
}

cli = LazyGroup(
    "unmodeled",
    listed=COMMANDS,
    params=[version_option("unmodeled")],
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Find what a simulation lacks, from measurements: which effect, how large, where.

    MODEL is an FMU, a MuJoCo model (robot.xml), a function or model of a Python file
    (model.py:cart), or a model of an installed extension. Measured files are CSV, MAT, HDF5,
    NetCDF, Parquet, Feather or MCAP. A TOML file of the same name describes each file.

    Exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.
    """,
)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line."""
    run(cli, arguments, "unmodeled")
