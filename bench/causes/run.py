"""A leaderboard of causes: engines on cases whose truth is known.

    python bench/causes/run.py --engine unmodeled --set interventions
    python bench/causes/run.py --engine bic --set machines --cases 0,3,5-9 --limit 60
    python bench/causes/run.py --engine mine:diagnose --set questions --output mine.json
    python bench/causes/run.py --write out/causes --set measured    only the folders of the cases
    python bench/causes/run.py --page                               the page, from the results

An engine gets the folder of a case and a limit of processor time, in a process of its own. See
bench/causes/README.md.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blind.marks import Answer, case_numbers, mark, without_nan
from causes.cases import SETS, truth_of, write
from causes.page import of_tier, write_page

__all__ = ["ENGINES", "answer_of", "run_case"]

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RESULTS = HERE / "results"
LIMIT = 60.0
#: Wall time per processor time that a case may take on a busy machine.
BUSY = 30.0
#: Name -> module and function.
ENGINES: Mapping[str, str] = {
    "unmodeled": "causes.engines.unmodeled:run",
    "bic": "causes.engines.bic:run",
    "sindy": "causes.engines.sindy:run",
    "lasso": "causes.engines.sindy:lasso",
    "petab_select": "causes.engines.petab_select:run",
    "gp": "causes.engines.gp:run",
    "parameter_list": "causes.engines.parameter_list:run",
    "cma": "causes.engines.parameter_list:cma",
}
Engine = Callable[[Path, float], Mapping[str, Any]]


def engine_of(name: str) -> Engine:
    """An engine of the list, or MODULE:FUNCTION.

    Raises
    ------
    SystemExit
        It cannot be imported.
    """
    module, _, function = ENGINES.get(name, name).partition(":")
    try:
        engine: Engine = getattr(importlib.import_module(module), function or "run")
    except (ImportError, AttributeError) as error:
        raise SystemExit(
            f"engine {name}: {error}; expected one of {', '.join(ENGINES)} with its packages "
            "(bench/causes/README.md), or MODULE:FUNCTION on the path of Python"
        ) from None
    return engine


def answer_of(told: Mapping[str, Any], seconds: float) -> Answer:
    """An answer from what an engine returns; all keys but ``named`` may be missing."""
    named, classes = told.get("named", ()), told.get("classes", ())
    verdict = "NAMED" if named else "ONE OF" if classes else "CALIBRATED"
    plain = {
        "verdict": told.get("verdict", verdict), "named": named, "classes": classes,
        "moved": told.get("moved", ()), "parameters": told.get("parameters", {}),
        "magnitudes": told.get("magnitudes", {}), "seconds": seconds, "held_out": None,
        "said": told.get("said", ""), "supported": told.get("supported", ()),
        "predicted": told.get("predicted"),
    }  # fmt: skip
    return Answer.of(without_nan(plain))


def _spent() -> float:
    """Processor time of this process and its ended children [s]."""
    who = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(r.ru_utime + r.ru_stime for r in map(resource.getrusage, who))


def _child(engine: str, folder: Path, limit: float) -> None:
    """Print the answer of an engine; the limit begins after the imports."""
    run = engine_of(engine)
    before = _spent()
    ceiling = int(time.process_time() + limit) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (ceiling, ceiling + 5))
    shown = os.dup(1)
    os.dup2(2, 1)  # what the engine prints is not its answer
    told = dict(run(folder, limit))
    line = json.dumps(without_nan({**told, "seconds": _spent() - before}), default=list) + "\n"
    os.write(shown, line.encode())


def run_case(engine: str, folder: Path, limit: float) -> tuple[Answer, str]:
    """Answer of an engine to a case folder, in a process of its own, and the engine's version."""
    path = os.pathsep.join(filter(None, [str(HERE.parent), os.environ.get("PYTHONPATH")]))
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, str(HERE / "run.py"), "--engine", engine, "--limit", str(limit)]
    done = subprocess.run(
        [*command, "--child", str(folder)], capture_output=True, text=True, check=False,
        timeout=BUSY * limit + 60.0,
        env={**os.environ, **threads, "PYTHONPATH": path, "PYTHONWARNINGS": "ignore"},
    )  # fmt: skip
    if done.returncode == 0 and done.stdout:
        told = json.loads(done.stdout.splitlines()[-1])
        if told["seconds"] <= 1.1 * limit:
            return answer_of(told, told["seconds"]), str(told.get("version", ""))
        return Answer("none", seconds=told["seconds"], said="late"), str(told.get("version", ""))
    if done.returncode == -24:
        return Answer("none", seconds=limit, said=f"no answer in {limit:g} s"), ""
    last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    return Answer("none", said=last[0][:300]), ""


def _commit() -> str:
    git = ["git", "-C", str(ROOT), "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()


def run_set(given: argparse.Namespace) -> None:
    """Run an engine on the cases of a set; rows are stored as they come."""
    path = given.output or RESULTS / f"{given.engine.replace(':', '.')}.json"
    stored = json.loads(path.read_text("utf-8")) if path.exists() else {"rows": []}
    stored["engine"] = given.engine
    cases = SETS[given.set]()
    numbers = case_numbers(given.cases, len(cases)) if given.cases else range(len(cases))
    known = {(r["set"], r["case"]) for r in stored["rows"]}
    with tempfile.TemporaryDirectory() as place:
        for n in numbers:
            case = cases[n]
            if (given.set, case.name) in known and not given.again:
                continue
            folder = Path(place) / case.name
            try:
                write(case, folder, given.cache)
            except Exception as error:  # a machine that cannot be built here is skipped
                print(f"{given.set} {n} {case.name}: skipped: {error}", flush=True)
                continue
            truth, salt = truth_of(folder)
            beside = folder.with_name(f"{folder.name}.truth.json")
            beside.unlink()  # the engine cannot read it
            answer, version = run_case(given.engine, folder, given.limit)
            sealed = json.loads((folder / "case.json").read_text("utf-8"))
            row = {
                "set": given.set, "number": n, "case": case.name, "commit": _commit(),
                "version": version, "limit": given.limit, "salt": salt,
                "sha256_of_truth": sealed["sha256_of_truth"],
                "truth": vars(truth) | {"causes": [vars(c) for c in truth.causes]},
                "answer": vars(answer),
                "mark": mark(truth, answer),
                "mark_with_supported": mark(truth, of_tier(answer, "supported")),
            }  # fmt: skip
            same = (given.set, case.name)
            rows = [r for r in stored["rows"] if (r["set"], r["case"]) != same]
            stored["rows"] = sorted([*rows, row], key=lambda r: (r["set"], r["number"]))
            path.parent.mkdir(parents=True, exist_ok=True)
            lines = ",\n".join(json.dumps(without_nan(r), default=list) for r in stored["rows"])
            head = json.dumps(given.engine)
            path.write_text(f'{{"engine": {head}, "rows": [\n{lines}\n]}}\n', encoding="utf-8")
            told = ", ".join([*answer.named, *(" | ".join(c) for c in answer.classes)])
            print(f"{given.set} {n} {case.name}: {row['mark']}: {truth.about} -> {answer.verdict} "
                  f"{told}; supported: {', '.join(answer.supported)}; {answer.seconds:.1f} s "
                  f"{answer.said}", flush=True)  # fmt: skip


def main() -> None:
    """Run an engine, write cases, or write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--engine", help=f"{', '.join(ENGINES)}, or MODULE:FUNCTION")
    parser.add_argument("--set", choices=[*SETS])
    parser.add_argument("--cases", help="some cases, such as 0,3,5-9")
    parser.add_argument("--limit", type=float, default=LIMIT, help="processor time of a case [s]")
    parser.add_argument("--output", type=Path, help="file of results; default: results/ENGINE.json")
    parser.add_argument("--again", action="store_true", help="repeat stored rows")
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="only write the case folders")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "causes", help="simulations")
    parser.add_argument("--page", action="store_true", help="write the page of the results")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        _child(given.engine, given.child, given.limit)
    elif given.page:
        write_page(RESULTS, ROOT / "docs", {n: len(make()) for n, make in SETS.items()})
    elif given.write and given.set:
        for case in SETS[given.set]():
            write(case, given.write / given.set / case.name, given.cache)
    elif given.engine and given.set:
        engine_of(given.engine)
        run_set(given)
    else:
        parser.error("expected --engine and --set, --write and --set, or --page")


if __name__ == "__main__":
    main()
