"""Progress of many simulations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from unmodeled.arguments import checked

Progress = Callable[[int, int, str], object]


@checked
class ProgressBar:
    """Progress of members: a function of the user, a bar on a terminal, or nothing.

    Parameters
    ----------
    progress
        ``progress(done, total, name)``, whose result is ignored; None: a bar if standard error is a
        terminal; False: none.
    total
        Number of members.
    """

    def __init__(self, progress: Progress | bool | None, total: int, title: str = ""):
        import sys

        self._call = progress if callable(progress) else None
        self._total = total
        self._done = 0
        self._bar: Any = None
        wanted = progress is True or (progress is None and sys.stderr.isatty())
        if self._call is None and wanted:
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                TextColumn,
                TimeRemainingColumn,
            )

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._task = self._bar.add_task(title or "simulating", total=total)

    def __enter__(self) -> ProgressBar:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self, name: str) -> None:
        """Count one more member."""
        self._done += 1
        if self._call is not None:
            self._call(self._done, self._total, name)
        elif self._bar is not None:
            self._bar.update(self._task, completed=self._done, description=name[:32])
