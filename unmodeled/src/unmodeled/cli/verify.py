"""``unmodeled verify``: a stored diagnosis is repeated, and its answer compared."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from unmodeled.cli.completing import models
from unmodeled.cli.options import argument, declare, option, positive
from unmodeled.cli.screen import ProgressLine, print_json, say


@declare("verify")
def verify(
    folder: Path = argument(),
    model: str = option(
        "Model instead of the stored one, such as model.py:cart; it gets the stored priors.",
        default="",
        metavar="MODEL",
        complete=models,
    ),
    seconds: float | None = option("Limit of time; default: that of the case.", positive("s")),
    *,
    as_json: bool,
) -> None:
    """Repeat the diagnosis in FOLDER, and compare the answers.

    `unmodeled diagnose --out FOLDER` writes such a folder, and report.write in Python.

    The code of a Python model or of an FMU in FOLDER is executed, in a process of its own but with
    your rights: only repeat cases that you trust. All files are first compared with the hashes of
    the case; if one changed, nothing is run.

    Exit codes: 0 all files, words and numbers agree; 1 some differ; 2 bad input.
    """
    from unmodeled import verify

    if not model:
        say(
            f"If all files are those of the case, the code of its model in {folder} is run.",
            err=True,
        )
    line = ProgressLine()
    verification = verify(folder, model=model, seconds=seconds, progress=line)
    line.close()
    if as_json:
        rows = [asdict(r) for r in verification.rows]
        print_json({"agrees": verification.agrees, "rows": rows, "notes": list(verification.notes)})
    else:
        say(str(verification))
    if not verification.agrees:
        click.get_current_context().exit(1)
