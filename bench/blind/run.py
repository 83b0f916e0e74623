"""Sealed cases of a machine, their diagnosis, the score.

python bench/blind/run.py --cases 40 --seed 7 -o out/bench --half development
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor, wait
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blind.bench import MACHINES, Bench
from blind.machine import sha256
from blind.score import markdown, read, score
from feltmb.cli import main
from feltmb.cli.common import (
    complain,
    console,
    is_terminal,
    json_option,
    new_table,
    print_json,
    say_written,
)
from feltmb.errors import InvalidParameter
from feltmb.files import write_text

__all__ = ["command"]


class _Told:
    """Progress with an estimate: a line on a terminal, else one line now and then."""

    def __init__(self) -> None:
        self.start: dict[str, float] = {}
        self.last = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        start = self.start.setdefault(stage, now)
        if done < total and now - self.last < (1.0 if is_terminal() else 30.0):
            return
        self.last = now
        rate = (now - start) / max(done - 1, 1)
        left = f", about {rate * (total - done):.0f} s left" if done > 1 and done < total else ""
        text = f"{stage}: {done} of {total}{left}"
        if is_terminal():
            click.echo(f"\r{text:<70}", nl=done == total, err=True)
        else:
            click.echo(text, err=True)


@contextmanager
def _cluster(address: str | None) -> Iterator[Executor | None]:
    """Executor of a Dask cluster; None without an address."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise InvalidParameter(
            "--dask: distributed is not installed; pip install distributed"
        ) from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except (OSError, TypeError, ValueError) as error:
        raise InvalidParameter(
            f"--dask {address}: no scheduler answers ({error}); expected the address that dask "
            "scheduler prints, for example tcp://127.0.0.1:8786"
        ) from None
    with client:
        executor = client.get_executor(pure=False)
        probe = executor.submit(sha256, b"")
        if wait([probe], timeout=10.0).not_done:
            complain(
                f"--dask {address}: no worker answers, waiting; a worker ends if it cannot import "
                "the bench, see its log"
            )
        try:
            probe.result()
        except RuntimeError as error:
            raise InvalidParameter(
                f"--dask {address}: the scheduler cannot import the bench; expected bench on its "
                f"PYTHONPATH ({error})"
            ) from None
        yield executor


@click.command()
@click.option(
    "--cases",
    type=click.IntRange(1, 100_000),
    default=20,
    show_default=True,
    help="Number of sealed cases; even numbers are for development, odd ones for the test.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="All that is random in the cases comes from it.",
)
@click.option(
    "--out",
    "-o",
    "output",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder of the bench.",
)
@click.option(
    "--machine",
    type=click.Choice([*MACHINES]),
    default="key_hammer",
    show_default=True,
    help="The small machine, or the full action with all its tolerances.",
)
@click.option(
    "--outside",
    type=click.Path(path_type=Path),
    help="Python file with KINDS: further causes that the library does not hold.",
)
@click.option(
    "--half",
    type=click.Choice(["development", "test", "both"]),
    default="both",
    show_default=True,
    help="Which half to diagnose and score.",
)
@click.option("--resume", is_flag=True, help="Go on with a bench that was cut off.")
@click.option(
    "--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes."
)
@click.option(
    "--dask",
    "address",
    metavar="ADDRESS",
    help="Scheduler of a Dask cluster, in place of processes of this machine. Its workers see the "
    "folder under the same path; they and the scheduler have bench on their PYTHONPATH.",
)
@click.option(
    "--oracle/--no-oracle",
    default=True,
    show_default=True,
    help="Whether to compare the held-out gap with that of the true structure.",
)
@click.option(
    "--score-only", is_flag=True, help="Score the cases that have a result, diagnose nothing."
)
@json_option
def command(
    cases: int, seed: int, output: Path, machine: str, outside: Path | None, half: Any,
    resume: bool, workers: int, address: str | None, oracle: bool, score_only: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Make sealed cases of a model, diagnose them blindly, score.

    Writes the truths and their SHA-256 first, then records, results (a file a case, so that a
    bench that was cut off goes on with --resume), answers of the cases with a result, and the
    table of scores as score.json and score.md. See docs/validation/2026-11_gap_blind_bench.md.
    """
    # Workers of a cluster may start in other folders.
    bench = Bench(output.resolve(), outside and outside.resolve(), MACHINES[machine])
    if score_only:
        bench = replace(bench, machine=MACHINES[bench.sealed()["machine"]])
    told = _Told()
    with _cluster(address) as pool:
        if score_only:
            seal = bench.sealed()
        else:
            seal = bench.seal(cases, seed, resume=resume)
            complain(f"sealed {seal['cases']} cases, SHA-256 {seal['truths_sha256'][:16]}...")
            bench.make_records(half, workers=workers, executor=pool, progress=told)
            bench.diagnose(half, workers=workers, executor=pool, oracle=oracle, progress=told)
        bench.make_answers(half, workers=workers, executor=pool, progress=told)
    try:
        scored = read(output, bench.numbers(half))
    except ValueError as error:
        raise InvalidParameter(str(error)) from None
    figures = score(scored)
    rows = [asdict(f) for f in figures]
    result = {"seal": seal, "half": half, "cases": len(scored), "figures": rows,
              "verdicts": _verdicts(scored)}  # fmt: skip
    # NaN is not valid JSON: a statistic without cases is null.
    result = json.loads(json.dumps(result), parse_constant=lambda _: None)
    name = "score" if half == "both" else f"score_{half}"
    text = _head(result) + "\n" + markdown(figures)
    for path, content in (
        (output / f"{name}.json", json.dumps(result, indent=1, sort_keys=True) + "\n"),
        (output / f"{name}.md", text),
    ):
        say_written(write_text(path, content, force=True))
    if as_json:
        print_json(result)
        return
    table = new_table(
        f"Blind bench, {half} half, {len(scored)} cases, seed {seal['seed']}",
        "figure", "value", "95 %", "n", "target", right=(1, 3),
    )  # fmt: skip
    for f in figures:
        unit = "" if f.unit == "1" else f" {f.unit}"
        shown = "-" if math.isnan(f.value) else f"{f.value:.3g}{unit}"
        span = "" if math.isnan(f.value) else f"{f.low:.3g}..{f.high:.3g}"
        met = "" if f.met is None else " met" if f.met else " MISSED"
        table.add_row(f.name, shown, span, str(f.n), f"{f.target}{met}")
    console().print(table)


def _verdicts(scored: list[Any]) -> dict[str, dict[str, int]]:
    """Count the verdicts by the number of withheld effects."""
    names = {0: "none", 1: "one", 2: "two", 3: "three", 4: "outside"}
    counts: dict[str, dict[str, int]] = {}
    for c in scored:
        row = counts.setdefault(names[c.kind], {})
        row[c.verdict] = row.get(c.verdict, 0) + 1
    return counts


def _head(result: dict[str, Any]) -> str:
    seal = result["seal"]
    counts = result["verdicts"]
    verdicts = sorted({v for row in counts.values() for v in row})
    lines = [
        f"Blind bench of {seal['machine']}: seed {seal['seed']}, {seal['cases']} cases sealed "
        f"{seal['sealed']}, feltmb {seal['version']}, {result['half']} half, "
        f"{result['cases']} cases scored. SHA-256 of the truths: `{seal['truths_sha256']}`.",
        "",
        f"| withheld | {' | '.join(verdicts)} |",
        "|---|" + "---|" * len(verdicts),
    ]
    for kind in ("none", "one", "two", "three", "outside"):
        if kind in counts:
            cells = " | ".join(str(counts[kind].get(v, 0)) for v in verdicts)
            lines.append(f"| {kind} | {cells} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(command=command, name="run.py")
