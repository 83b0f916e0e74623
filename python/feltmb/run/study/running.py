"""Runs studies, with all simulations in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from pathlib import Path
from typing import Any

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.run.study.model import Case, Study, load_study
from feltmb.run.study.result import StudyResult
from feltmb.run.sweep import Member, Outcome, Progress, ProgressBar, run_members


@checked
def run_studies(
    studies: Sequence[Study],
    *,
    executor: Executor | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
    progress: Progress | bool | None = None,
) -> list[StudyResult]:
    """Run several studies, all their simulations in parallel; see :func:`study`."""
    tagged: list[tuple[int, Case]] = []
    members: list[Member] = []
    found: list[dict[Case, Outcome | None]] = []
    for k, each in enumerate(studies):
        found.append(dict.fromkeys(each.cases()))
        for case in each.cases():
            try:
                members.append(each.member(case))
            except (InvalidParameter, TypeError, ValueError) as error:
                found[k][case] = Outcome("failed", " ".join(str(error).split()))
                continue
            tagged.append((k, case))
    outcomes = run_members(members, executor=executor, jobs=jobs, folder=folder)
    with closing(outcomes), ProgressBar(progress, len(members), "studies") as bar:
        for index, outcome in outcomes:
            k, case = tagged[index]
            found[k][case] = outcome
            bar.step(members[index].name)
    return [
        StudyResult(each, {c: o or Outcome("error", "was not run") for c, o in made.items()})
        for each, made in zip(studies, found, strict=True)
    ]


@checked
def study(
    name_or_path: str | Path | Study | Mapping[str, Any],
    executor: Executor | None = None,
    *,
    jobs: int | None = None,
    folder: str | Path | None = None,
    progress: Progress | bool | None = None,
) -> StudyResult:
    """Run a study: variants with strokes, in parallel, with table, figures and findings.

    Parameters
    ----------
    name_or_path
        Name of a packaged study, path of a TOML file, its tables, or a result of ``load_study``.
    executor
        Any ``concurrent.futures.Executor``; default: threads, one per core.
    jobs
        Number of threads without an executor.
    folder
        Folder of finished simulations, from which an interrupted study continues.
    progress
        ``progress(done, total, name)``, whose result is ignored; default: a bar on a terminal;
        False: none.

    Returns
    -------
    StudyResult
        Result with ``table``, ``findings`` and ``figures``; a failed simulation has its error in
        the table.

    Raises
    ------
    InvalidParameter
        The study has faults; all of them are in the message.
    """
    if isinstance(name_or_path, Study):
        made = name_or_path
    elif isinstance(name_or_path, Mapping):
        made = Study.from_dict(name_or_path)
    else:
        made = load_study(name_or_path)
    return run_studies([made], executor=executor, jobs=jobs, folder=folder, progress=progress)[0]
