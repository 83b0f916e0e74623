"""Commands that are killed: each runs in a process that has everything loaded already."""

from __future__ import annotations

import os
from pathlib import Path

HERE = Path(__file__).resolve()
SUBJECT = f"""
import sys
sys.path.insert(0, {str(HERE.parents[3] / "unmodeled" / "tests" / "diagnosis")!r})
from models import EFFECTS as effects, NOMINAL as model
"""


def prepare(folder: Path) -> list[str]:
    """Write an adapter and its measured files; return their paths."""
    import sys

    from unmodeled.data import write_record

    sys.path.insert(0, str(HERE.parents[3] / "unmodeled" / "tests" / "diagnosis"))
    import models

    (folder / "adapter.py").write_text(SUBJECT)
    files = [
        write_record(record, folder / f"{record.name}.csv")
        for record in models.records(4, dry=0.02)
    ]
    return [str(folder / "adapter.py"), *map(str, files)]


def work(arguments: list[str], message: object = None, limit: int = 0) -> None:
    """Run a command of feltmb; say how it ended, and its processor time, into a pipe."""
    import contextlib
    import io
    import resource

    from feltmb.cli import main

    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    stderr, code = io.StringIO(), 0
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
        try:
            main(arguments)
        except SystemExit as end:
            code = int(end.code or 0)
    if message is not None:
        spent = sum(os.times()[:2])
        message.send((code, stderr.getvalue(), spent))  # type: ignore[attr-defined]
    os._exit(code)
