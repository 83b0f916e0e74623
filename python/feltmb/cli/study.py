"""``feltmb study``: runs studies with figures, tables and findings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.common import (
    FolderName,
    complain,
    console,
    force_option,
    json_option,
    new_table,
    print_json,
    say,
    say_written,
)
from feltmb.cli.completing import packaged

if TYPE_CHECKING:
    from feltmb.run.study import FindingResult, Study, StudyResult
    from feltmb.run.study.page import Table

WIDTH = 80
#: Number of simulations of a study whose warnings are printed; `--json` has all.
MOST_WARNINGS = 3


@click.command("study")
@click.argument("names", nargs=-1, shell_complete=packaged("studies"))
@click.option("--list", "listing", is_flag=True, help="List the packaged studies.")
@click.option(
    "--out",
    "-o",
    type=FolderName(file_okay=False),
    help="Folder for one HTML page of all studies, figures, tables, and the finished simulations. "
    "An interrupted study continues from this folder.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    help="Number of parallel simulations; default: one for each core.",
)
@force_option
@json_option
def command(
    names: tuple[str, ...],
    listing: bool,
    out: Path | None,
    jobs: int | None,
    force: bool,
    as_json: bool,
) -> None:
    """Run studies: simulate variants in parallel, compare them, and test findings.

    NAMES are packaged studies (feltmb study --list), paths of your own TOML files, or all. The page
    docs/howto/run_studies.md describes the files. If a simulation fails, the table contains its
    error. A finding that disagrees is a result, and the exit code is 0.
    """
    from feltmb.errors import InvalidParameter
    from feltmb.run.study import load_study, packaged_studies, run_studies

    if listing:
        _list(as_json)
        return
    if not names:
        raise click.UsageError("give names of studies, or all; see: feltmb study --list")
    wanted = [n for name in names for n in (packaged_studies() if name == "all" else [name])]
    studies = [load_study(name) for name in dict.fromkeys(wanted)]
    twice = {s.name for s in studies if [t.name for t in studies].count(s.name) > 1}
    if twice:
        raise InvalidParameter(f"two studies have the name {', '.join(sorted(twice))}")
    if out is not None:
        _check_targets(studies, out, force=force)
    results = run_studies(
        studies,
        jobs=jobs,
        folder=out / "members" if out is not None else None,
        progress=False if as_json else None,
    )
    if as_json:
        print_json({r.study.name: r.as_dict() for r in results})
    else:
        screen = console()
        for result in results:
            _print(result, screen)
    if out is not None:
        _write(results, out, force=force)
    for result in results:
        for name, error in result.failed.items():
            complain(f"{result.study.name}: {name}: {error}")
        warned = list(result.warnings.items())
        for name, text in warned[:MOST_WARNINGS]:
            complain(f"warning: {result.study.name}: {name}: {text}")
        if len(warned) > MOST_WARNINGS:
            rest = len(warned) - MOST_WARNINGS
            complain(f"warning: {result.study.name}: and {rest} more simulations (--json)")


def _list(as_json: bool) -> None:
    from feltmb.run.study import study_outlines

    studies = study_outlines()
    if as_json:
        print_json(
            {
                s.name: {
                    "title": s.spec.title,
                    "about": s.spec.about,
                    "source": s.spec.thesis.model_dump(),
                    "runs": len(s.cases()),
                }
                for s in studies
            }
        )
        return
    table = new_table("studies", "name", "title", "of the thesis", "runs", right=(3,))
    for s in studies:
        table.add_row(s.name, s.spec.title, s.spec.thesis.figure, str(len(s.cases())))
    console().print(table)


def _page(out: Path, studies: list[Any]) -> Path:
    return out / ("index.html" if len(studies) > 1 else f"{studies[0].name}.html")


def _check_targets(studies: list[Study], out: Path, *, force: bool) -> None:
    from feltmb.files import check_writable, make_folder
    from feltmb.run.study import study_targets

    make_folder(out)
    targets = [_page(out, studies)]
    for each in studies:
        targets += [p for p in study_targets(each, out) if p.suffix != ".html"]
    for path in targets:
        check_writable(path, force=force)


def _write(results: list[StudyResult], out: Path, *, force: bool) -> None:
    from feltmb.files import write_text
    from feltmb.run.study.page import page

    say_written(write_text(_page(out, [r.study for r in results]), page(results), force=force))
    for result in results:
        written = result.save(out, force=force, page=False)
    count = sum(len(r.study.spec.figures) + 2 for r in results)
    del written
    say(f"wrote {count} figures and tables beside it", err=True)


# --- the terminal --------------------------------------------------------------------------------


def _print(result: StudyResult, screen: Any) -> None:
    from feltmb.run.study.page import by_claim, tables

    spec = result.study.spec
    source = f" ({spec.thesis.cite}, {spec.thesis.figure})" if spec.thesis.figure else ""
    screen.print(f"{spec.title}{source}", width=WIDTH)
    for table in tables(result):
        for part in _chunks(table):
            screen.print(_terminal_table(part, spec.thesis.cite), width=WIDTH)
    for title, group in by_claim(result.findings, spec.thesis.cite).items():
        screen.print(_findings(title, group), width=WIDTH)


def _widths(table: Table) -> list[int]:
    return [max(len(cell.text) for cell in column) for column in zip(*table.rows, strict=True)]


def _chunks(table: Table) -> list[Table]:
    """Split a table into parts that fit the terminal; the first column is repeated."""
    from feltmb.run.study.page import Table as Made

    if not table.rows:
        return []
    # A heading may be broken between words, a number may not.
    widths = [
        max(body, max(len(word) for word in head.text.split() or [""]), 9 if i else 12)
        for i, (body, head) in enumerate(zip(_widths(table), table.head, strict=True))
    ]
    first = min(widths[0], 36)
    parts: list[list[int]] = [[]]
    used = first
    for i in range(1, len(widths)):
        if parts[-1] and used + widths[i] + 3 > WIDTH - 2:
            parts.append([])
            used = first
        parts[-1].append(i)
        used += widths[i] + 3
    return [
        Made(
            table.title,
            tuple(table.head[i] for i in (0, *part)),
            tuple(tuple(row[i] for i in (0, *part)) for row in table.rows),
        )
        for part in parts
    ]


def _terminal_table(table: Table, cite: str) -> Any:
    title = table.title
    out = new_table(title, *(cell.text for cell in table.head), right=_right(table))
    for column in out.columns:
        column.overflow = "fold"
    for row in table.rows:
        out.add_row(*(cell.text for cell in row))
        if any(cell.printed for cell in row):
            out.add_row(*(f"  {cite}" if i == 0 else c.printed for i, c in enumerate(row)))
    return out


def _right(table: Table) -> tuple[int, ...]:
    return tuple(i for i, cell in enumerate(table.head) if cell.num)


def _findings(title: str, findings: list[FindingResult]) -> Any:
    from feltmb.run.study.page import finding_sizes, outcome_text

    out = new_table(title, "outcome", "finding", "here", "there", right=(2, 3))
    out.columns[0].no_wrap = True
    for finding in findings:
        here, there = finding_sizes(finding)
        says = finding.says + (f" ({finding.reason})" if finding.reason else "")
        out.add_row(outcome_text(finding), says, here, there)
    for column in out.columns[2:]:
        column.no_wrap = True
    return out


__all__ = ["command"]
