"""The frozen yardstick of the diagnosis: runs an engine on a set and stores the answers.

    python bench/blind/yardstick.py imperfect --third --cache out/yardstick
    python bench/blind/yardstick.py --compare present feltmb        paired table of two files
    python bench/blind/yardstick.py small --seed 20281201 --count 100    a sealed half

An engine is a function ``(model, effects, records, seconds) -> Answer``, given by ``--engine
MODULE:FUNCTION``; the default is feltmb. With a new seed, the truths of ``imperfect``, ``small``
and ``action`` are drawn and hashed before anything is diagnosed. Each case runs in a process of its
own with a limit of processor time; no answer within it is the answer "none". Answers are lines of
``bench/results/yardstick/LABEL.jsonl``; a case that has an answer is not repeated. Sets: see
:mod:`blind.yardstick_sets`; marks: see :mod:`blind.marks`.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib
import io
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

if "--child" in sys.argv:  # a diagnosis on a busy machine gets the time that it gets on a quiet one
    time.monotonic = time.process_time

import unmodeled

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blind.marks import Answer, Marked, Told, Truth, case_numbers, compare, read, table
from blind.yardstick_sets import ROOT, SEALED, SETS, Set, Task

__all__ = ["ENGINES", "diagnosed", "run_case"]

RESULTS = ROOT / "bench" / "results" / "yardstick"
LIMIT = 120.0
#: Wall time per processor time that a case may take, on a busy machine; beyond it, nothing is
#: stored, because it is no fault of the engine.
BUSY = 30.0
#: Signals of a process that crashes.
CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL)
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
Engine = Callable[[Any, Sequence[Any], Sequence[Any], float], Answer]


# ---------------------------------------------------------------- engines


def diagnosed(model: Any, effects: Sequence[Any], records: Sequence[Any], budget: float) -> Answer:
    """The engine of :mod:`unmodeled`; what it names are causes, some of them parameters."""
    result = unmodeled.diagnose(model, effects, records, options=unmodeled.Options(seconds=budget))

    def name(cause: Any) -> str:
        return f"parameter:{cause.cause}" if cause.parameter else str(cause.cause)

    told = [*result.named, *(c for group in result.classes for c in group)]
    gain = result.held_out_gain
    return Answer(
        str(result.verdict.value).upper(),
        tuple(name(c) for c in result.named),
        tuple(tuple(name(c) for c in group) for group in result.classes),
        tuple(p.name for p in result.parameters if not p.low <= p.tabulated <= p.high),
        {p.name: (p.value, p.low, p.high) for p in result.parameters},
        {c.cause: (c.magnitude, c.low, c.high) for c in told if not c.parameter},
        held_out=None if gain is None else (1.0, float(gain[0])),
        said=", ".join(r.value for r in result.reasons),
        supported=tuple(name(c) for c in getattr(result, "supported", ())),
        first=result.summary(),
        predicted=result.worst.held_out_explained,
        members=tuple(_members(result)),
    )


def _members(result: Any) -> Iterator[Told]:
    """Members of the set of an answer."""
    parameters = {p.name for p in result.parameters}
    for f in result.findings:
        if f.mark is not None:
            own = (f.cause, *f.equivalents)
            names = tuple(f"parameter:{n}" if n in parameters else n for n in own)
            sets = [s.probability for s in result.sets if {*s.causes} & {*own}]
            together = min(max(sum(sets), f.probability), 1.0)
            yield Told(names, f.mark.value, together, f.excludes_zero)


ENGINES: Mapping[str, Engine] = {"feltmb": diagnosed}


def _engine(name: str) -> Engine:
    if name in ENGINES:
        return ENGINES[name]
    module, _, function = name.partition(":")
    engine: Engine = getattr(importlib.import_module(module), function)
    return engine


# ---------------------------------------------------------------- one case


def _spent() -> float:
    """Processor time of this process and of the processes it has ended [s]."""
    return sum(
        r.ru_utime + r.ru_stime
        for r in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def _answer(run: Engine, task: Task, limit: float) -> Answer:
    """Answer of an engine to a case, in this process."""
    begin = _spent()
    try:
        answer = run(task.model, task.effects, task.records, limit)
    except Exception as error:  # an error is a bad answer
        answer = Answer("none", said=f"{type(error).__name__}: {error}"[:500])
    return replace(answer, seconds=_spent() - begin)


def _child(engine: str, cases: Set, case: int, cache: Path, limit: float) -> None:
    """Print the truth, then the answer, as JSON; the limit begins with the diagnosis."""
    task, run = cases.task(case, cache), _engine(engine)
    print(json.dumps(asdict(task.truth), default=list), flush=True)
    ceiling = int(time.process_time() + limit) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (ceiling, ceiling + 5))
    shown = sys.stdout
    with contextlib.redirect_stdout(io.StringIO()):
        answer = _answer(run, task, limit)
    print(json.dumps(asdict(answer), default=list), file=shown, flush=True)


def run_case(
    engine: str, name: str, case: int, cache: Path, limit: float, further: Sequence[str] = ()
) -> tuple[Truth, Answer]:
    """Answer of an engine to a case, in a process of its own; ``further``: options of the set.

    Raises
    ------
    TimeoutError
        Somebody else ended the process, or the machine is too busy for an answer.
    """
    arguments = [name, "--engine", engine, "--child", str(case), "--cache", str(cache)]
    arguments += ["--limit", str(limit), *further]
    try:
        done = subprocess.run(
            [sys.executable, str(Path(__file__).resolve()), *arguments],
            capture_output=True,
            text=True,
            timeout=BUSY * limit,
            check=False,
            env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONWARNINGS": "ignore"},
        )
    except subprocess.TimeoutExpired:
        raise TimeoutError(f"{name} {case}: no answer in {BUSY * limit:g} s of the wall") from None
    lines = done.stdout.splitlines()
    if not lines:
        raise RuntimeError(f"{name} {case}: cannot be loaded: {done.stderr[-1000:]}")
    truth = Truth.of(json.loads(lines[0]))
    if len(lines) > 1:
        answer = Answer.of(json.loads(lines[1]))
        if answer.seconds <= limit:
            return truth, answer
        return truth, Answer("none", seconds=answer.seconds, said=f"late: {answer.said}")
    if done.returncode == -signal.SIGXCPU:
        return truth, Answer("none", seconds=limit, said=f"no answer in {limit:g} s")
    if done.returncode < 0 and -done.returncode not in CRASHES:  # somebody ended it
        raise TimeoutError(f"{name} {case}: ended by signal {-done.returncode}")
    return truth, Answer("none", said=done.stderr[-500:] or f"signal {-done.returncode}")


# ---------------------------------------------------------------- command


def _commit() -> str:
    """Commit of the code, with + if files were changed since."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run(
        [*git, "rev-parse", "--short=8", "HEAD"], capture_output=True, text=True
    )
    changed = subprocess.run(
        [*git, "status", "--porcelain", "python"], capture_output=True, text=True
    )
    return commit.stdout.strip() + ("+" if changed.stdout.strip() else "")


def main() -> None:
    """Run an engine on a set, or compare two files of answers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("set", nargs="*", help=", ".join(SETS))
    parser.add_argument("--engine", default="feltmb", help="MODULE:FUNCTION; default: feltmb")
    parser.add_argument("--seed", type=int, help=f"other truths of {' or '.join(SEALED)}")
    parser.add_argument("--count", type=int, default=100, help="number of cases with --seed")
    parser.add_argument("--third", action="store_true", help="every third case")
    parser.add_argument("--cases", help="some cases, such as 0,3,5-9")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "yardstick")
    parser.add_argument("--limit", type=float, default=LIMIT, help="processor time of a case [s]")
    parser.add_argument("--label", help="name of the file of answers; default: the engine")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--compare", nargs=2, metavar=("A", "B"), help="labels or files")
    parser.add_argument("--make", action="store_true", help="only simulate the records")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()

    def file(label: str) -> Path:
        return Path(label) if label.endswith(".jsonl") else given.results / f"{label}.jsonl"

    if given.compare:
        one, two = (read(file(label)) for label in given.compare)
        print(f"A: {given.compare[0]}, B: {given.compare[1]}\n")
        print(compare(one, two))
        return
    known_sets = SETS if given.seed is None else SEALED
    if not given.set or set(given.set) - set(known_sets):
        parser.error(f"expected some of the sets {', '.join(known_sets)}")
    sets = SETS
    further: list[str] = []
    if given.seed is not None:
        sets = {name: SEALED[name](given.seed, given.count) for name in given.set}
        further = ["--seed", str(given.seed), "--count", str(given.count)]
    if given.child is not None:
        _child(given.engine, sets[given.set[0]], given.child, given.cache, given.limit)
        return
    path = file(given.label or given.engine.replace(":", "."))
    path.parent.mkdir(parents=True, exist_ok=True)
    for asked in given.set:
        cases, name = sets[asked], sets[asked].name
        numbers = cases.third() if given.third else list(range(cases.count))
        if given.cases:
            numbers = case_numbers(given.cases, cases.count)
        cases.make(numbers, given.cache)
        if given.seed is not None:
            seal = hashlib.sha256((given.cache / name / "truths.json").read_bytes()).hexdigest()
            print(f"{name}: SHA-256 of the truths: {seal}", flush=True)
        if given.make:
            continue
        known = read(path) if path.exists() else {}
        for n in numbers:
            if (name, n) in known:
                continue
            try:
                truth, answer = run_case(given.engine, asked, n, given.cache, given.limit, further)
            except TimeoutError as error:
                print(f"{error}; not stored", flush=True)
                continue
            marked = Marked(name, n, _commit(), truth, answer)
            with path.open("a", encoding="utf-8") as lines:
                lines.write(marked.line + "\n")
            told = [*answer.named, *(" | ".join(c) for c in answer.classes)]
            print(
                f"{name} {n}: {marked.mark}: {truth.about} -> {answer.verdict} "
                f"{', '.join(told)}"
                + (f"; supported: {', '.join(answer.supported)}" if answer.supported else "")
                + f"; held out {marked.over_engineer:.3g} of an engineer"
                * math.isfinite(marked.over_engineer)
                + f"; {answer.seconds:.0f} s: {answer.first}",
                flush=True,
            )
        answered = [m for (s, n), m in read(path).items() if s == name and n in numbers]
        print(f"\n{name}, {len(answered)} cases")
        for row, value in table(answered).items():
            print(f"  {row:42s} {value}")


if __name__ == "__main__":
    main()
