"""Which development cases change without a decision threshold of a diagnosis.

python bench/blind/run.py --cases 200 --seed 7 -o out/bench --half development --no-oracle
python bench/blind/ablation.py out/bench --cases 60

Every case of the development half is diagnosed as it is, and again with one threshold at a time at
its neutral value, at which the rule has no influence. The fits that both have in common are
computed once: they are read from a store of the case. Results are files in ``ablation/`` of the
bench, so that an interrupted run continues, and ``ablation.md`` is the table.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import feltmb.gap
from blind.bench import MACHINES, Bench
from blind.machine import Machine, as_json, summarize
from blind.score import Scored, read_truth
from feltmb.cli import main
from feltmb.cli.common import complain, say_written
from feltmb.errors import InvalidParameter
from feltmb.files import make_folder, read_json, write_text
from feltmb.gap import criteria

__all__ = ["NEUTRAL", "at_value", "command"]

#: Values at which a threshold, or an option, has no influence. Some rules can be switched off in
#: two directions. Left out: limits of effort (how many sets are fitted), levels of statistical
#: tests, prior probabilities, and the calibration of the confidence, which have no neutral value.
NEUTRAL: dict[str, tuple[float, ...]] = {
    "ALLOWED_REST": (0.0,),
    "COLOR_GAIN": (math.inf,),
    "EXPLAINS_MOST": (0.0,),
    "FORM_ERROR": (0.0,),
    "NO_GAP_RATIO": (1.0,),
    "SLOW_COLOR": (math.inf,),
    "STILL_SHRINKS": (math.inf,),
    "WALD": (0.0,),
    "form": (0.0,),
}
#: Key of the results with all thresholds.
AS_IT_IS = "as it is"


@contextmanager
def at_value(name: str, value: float | tuple[float, ...]) -> Iterator[None]:
    """Give a threshold another value in every module that uses it."""
    old = getattr(criteria, name)
    for found in pkgutil.iter_modules(feltmb.gap.__path__, "feltmb.gap."):
        importlib.import_module(found.name)  # one that is imported later would keep the value
    users = [
        m
        for key, m in list(sys.modules.items())
        if key.startswith("feltmb.gap") and getattr(m, name, None) is old
    ]
    try:
        for module in users:
            setattr(module, name, value)
        yield
    finally:
        for module in users:
            setattr(module, name, old)


def _variants() -> list[tuple[str, str, float]]:
    """Key of the results, name and neutral value of every variant."""
    return [(f"{n} = {v:g}", n, v) for n, values in NEUTRAL.items() for v in values]


def _case(machine: Machine, folder: Path, number: int, known: Mapping[str, Any]) -> dict[str, Any]:
    """Results of a case, by threshold and value."""
    found = dict(known)
    records = machine.read_records(folder / "records" / f"{number}.npz")
    with tempfile.TemporaryDirectory() as store:
        options = replace(machine.options, resume=Path(store))
        if AS_IT_IS not in found:
            found[AS_IT_IS] = summarize(machine.diagnose(records, options=options))
        for key, name, value in _variants():
            if key in found:
                continue
            own: Any = {name: value} if hasattr(options, name) else {}
            with nullcontext() if own else at_value(name, value):
                report = machine.diagnose(records, options=replace(options, **own))
            found[key] = summarize(report)
    return found


def _table(folder: Path, numbers: list[int]) -> str:
    """Number of cases that a threshold changes, and the scores with and without it."""
    truths = {n: read_truth(folder / "answers" / f"{n}.json") for n in numbers}
    results = {n: read_json(folder / "ablation" / f"{n}.json") for n in numbers}
    lines = [
        "| threshold | neutral value | cases changed | right, before and after | wrong, before and "
        "after | false alarms, before and after | unknown flagged, before and after | cases |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for key, name, value in _variants():
        pairs = [
            (Scored(n, truths[n], r[AS_IT_IS]), Scored(n, truths[n], r[key]))
            for n, r in results.items()
            if key in r and AS_IT_IS in r
        ]
        changed = [(a, b) for a, b in pairs if _said(a) != _said(b)]

        def counts(hit: Any, pairs: Any = pairs) -> str:
            old, new = (sum(bool(hit(p[i])) for p in pairs) for i in (0, 1))
            return f"{old}" if old == new else f"{old}, {new}"

        which = ", ".join(str(a.number) for a, _ in changed)
        lines.append(
            f"| `{name}` | {value:g} | {len(changed)}{f' ({which})' if which else ''} | "
            f"{counts(_right)} | {counts(Scored.wrong)} | "
            f"{counts(lambda c: c.kind == 0 and c.claims)} | "
            f"{counts(lambda c: c.kind == 4 and c.flagged())} | {len(pairs)} |"
        )
    return "\n".join(lines) + "\n"


def _said(c: Scored) -> tuple[Any, ...]:
    return c.verdict, tuple(sorted(c.named)), tuple(sorted(c.result["one_of"]))


def _right(c: Scored) -> bool:
    """Whether a true effect is named, or is in the class, and nothing wrong is."""
    offered = c.named | set(c.result["one_of"])
    return bool(offered & c.truth) and not c.wrong()


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option(
    "--cases",
    type=click.IntRange(1),
    default=60,
    show_default=True,
    help="Number of cases of the development half.",
)
@click.option(
    "--number",
    "first",
    type=click.IntRange(0),
    multiple=True,
    help="Number of a case that comes first; several are possible.",
)
def command(folder: Path, cases: int, first: tuple[int, ...]) -> None:
    """Diagnose development cases of a bench without one threshold at a time.

    FOLDER is a bench that run.py has made.
    """
    bench = Bench(folder.resolve())
    machine = MACHINES[bench.sealed()["machine"]]
    known = [n for n in bench.numbers("development") if bench.answered(n)]
    unknown = sorted(set(first) - set(known))
    if unknown:
        raise InvalidParameter(
            f"--number {unknown[0]}: is no case of the development half of {folder} with an answer"
        )
    numbers = list(dict.fromkeys((*first, *known)))[:cases]
    if not numbers:
        raise InvalidParameter(f"{folder}: no case of the development half was scored; run run.py")
    place = make_folder(folder / "ablation")
    for i, n in enumerate(numbers):
        path = place / f"{n}.json"
        found = _case(machine, folder, n, read_json(path) if path.exists() else {})
        write_text(path, as_json(found), force=True)
        complain(f"case {n}: {i + 1} of {len(numbers)}")
        text = _table(folder, numbers[: i + 1])
        write_text(folder / "ablation.md", text, force=True)
    say_written(folder / "ablation.md")


if __name__ == "__main__":
    main(command=command, name="ablation.py")
