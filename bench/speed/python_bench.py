"""Overhead of Python: import, gradient versus stroke, many strokes, changed mechanisms, files.

    python bench/speed/python_bench.py [--case TEXT] [--repeat N] [--strokes N] [--json FILE]

The JSON is that of feltmb_bench, for compare.py. The gradient and its stroke are timed in
turn, so that a busy machine slows both; CPU time is printed beside wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import feltmb
from feltmb.run.batch import simulate_many

#: Thirty parameters of a typical fit of the action: felts, masses, string, input.
PARAMETERS = ["contacts.*.loading.a", "bodies.*.inertia", "string.tension", "stroke.scale"]
PARAMETERS += ["key.mass", "jack.mass"]


def timed(repeat: int, work: Callable[[], Any]) -> tuple[list[float], list[float]]:
    """Wall and CPU times of every repeat [ms]."""
    wall, cpu = [], []
    for _ in range(repeat):
        a, b = time.perf_counter(), time.process_time()
        work()
        wall.append(1e3 * (time.perf_counter() - a))
        cpu.append(1e3 * (time.process_time() - b))
    return wall, cpu


def case(name: str, wall: list[float], cpu: list[float] | None = None, **more: float) -> Any:
    out = {
        "name": name,
        "median_ms": float(np.median(wall)),
        "quartile1_ms": float(np.quantile(wall, 0.25)),
        "quartile3_ms": float(np.quantile(wall, 0.75)),
        "repeats": len(wall),
        "errors": {},
        **({"cpu_median_ms": float(np.median(cpu))} if cpu else {}),
        **more,
    }
    shown = "  ".join(f"{k} {v:.4g}" for k, v in out.items() if k not in ("name", "errors"))
    print(f"{name:24} {shown}", flush=True)
    return out


def measure_import(repeat: int) -> list[Any]:
    out = []
    for name, code in (
        ("python_alone", "pass"),
        ("import", "import feltmb"),
        ("help", "from feltmb.cli import main; main(['--help'])"),
        ("load_action", "import feltmb; feltmb.load_action('steinway45')"),
    ):
        command = [sys.executable, "-c", code]
        wall, _ = timed(
            repeat, lambda c=command: subprocess.run(c, check=False, stdout=subprocess.DEVNULL)
        )
        out.append(case(name, wall))
    return out


def measure_gradient(repeat: int) -> list[Any]:
    action, stroke = feltmb.load_action("steinway45"), feltmb.load_stroke("forte")
    options = {"output_rate": 1000.0, "rtol": 1e-6}
    last: dict[str, Any] = {}

    def run() -> None:
        last["g"] = feltmb.gradient(action, stroke, PARAMETERS, ["hammer.angle"], **options)

    def alone() -> None:
        feltmb.simulate(action, stroke, ledger=False, **options)

    alone()
    pairs = [(timed(1, alone), timed(1, run)) for _ in range(repeat)]
    strokes = [p[0][0][0] for p in pairs], [p[0][1][0] for p in pairs]
    gradients = [p[1][0][0] for p in pairs], [p[1][1][0] for p in pairs]
    found = last["g"]
    ratio = np.median(np.divide(gradients[1], strokes[1]))
    return [
        case("stroke_forte", *strokes),
        case(
            "gradient_forte",
            *gradients,
            columns=len(found.columns),
            strokes_of_cpu=float(ratio),
            stages=found.stats["factorizations"],
            rhs=found.stats["rhs"],
        ),
    ]


def measure_many(strokes: int) -> list[Any]:
    action, stroke = feltmb.load_action("steinway45"), feltmb.load_stroke("forte")
    changed, _ = timed(20, lambda: action.with_values({"key.mass": 0.117}))
    out = [case("with_values", changed)]

    def pairs() -> Any:
        for i in range(strokes):
            yield action.with_values({"key.mass": 0.117 + 1e-5 * i}), stroke

    jobs = min(2, os.cpu_count() or 1)
    wall, cpu = timed(
        1, lambda: simulate_many(pairs(), lambda *_: None, jobs=jobs, summary_only=True)
    )
    per = {"strokes": strokes, "jobs": jobs, "cpu_ms_a_stroke": cpu[0] / strokes}
    out.append(case(f"batch_{strokes}", wall, cpu, **per))
    return out


def measure_sweep(strokes: int) -> list[Any]:
    """A typical sweep with members that are stored in a folder; peak memory."""
    action = feltmb.load_action("steinway45")
    values = {"key.mass": {"scale": {"from": 0.95, "to": 1.05, "count": strokes}}}
    jobs = min(2, os.cpu_count() or 1)
    peaks: dict[int, float] = {}

    def note(done: int, _total: int, _name: str) -> None:
        if done in (strokes // 10, strokes):
            peaks[done] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0

    with tempfile.TemporaryDirectory() as folder:

        def run() -> None:
            result = feltmb.sweep(action, "forte", values, jobs=jobs, folder=folder, progress=note)
            assert result.failed.empty

        wall, cpu = timed(1, run)
        again, _ = timed(1, run)  # everything is in the folder
    per = {
        "strokes": strokes,
        "jobs": jobs,
        "load": os.getloadavg()[0],
        "cpu_ms_a_stroke": cpu[0] / strokes,
        "peak_MB_at_a_tenth": peaks[strokes // 10],
        "peak_MB": peaks[strokes],
    }
    return [case(f"sweep_{strokes}", wall, cpu, **per), case(f"sweep_{strokes}_resumed", again)]


def measure_save(repeat: int) -> list[Any]:
    run = feltmb.simulate("steinway45", "forte")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.nc"
        run.save(path)
        return [
            case("save", *timed(repeat, lambda: run.save(path, force=True))),
            case("save_plain", *timed(repeat, lambda: run.save(path, force=True, compress=False))),
        ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", default="", help="import, gradient, many, sweep, save")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--strokes", type=int, default=100)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    groups = {
        "import": lambda: measure_import(options.repeat),
        "gradient": lambda: measure_gradient(options.repeat),
        "many": lambda: measure_many(options.strokes),
        "sweep": lambda: measure_sweep(options.strokes),
        "save": lambda: measure_save(options.repeat),
    }
    cases = [c for name, group in groups.items() if options.case in name for c in group()]
    if options.json is not None:
        text = json.dumps({"version": feltmb.__version__, "cases": cases}, indent=1)
        options.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
