"""Cost against the number of string modes, bodies, closed contacts and strokes, as one picture.

    python bench/speed/cost_against_size.py --bench build/bench/feltmb_bench [--repeat 7]
        [--strokes 10 30 100 300] [--plot FILE] [--json FILE]

CPU times. Modes: a stroke of the rigid action. Bodies and contacts: one right-hand side. Strokes:
one batch on two threads. The exponent of a power law through the upper half of the sizes is
printed: 1 is linear.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import feltmb
from feltmb.run.batch import simulate_many

Curve = list[tuple[float, float]]  # size, milliseconds


def measure_core(bench: Path, repeat: int) -> dict[str, Curve]:
    """Best CPU times of the size cases of feltmb_bench, by the varied quantity."""
    out: dict[str, Curve] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "size.json"
        command = [
            str(bench),
            "--cpu",
            "--case",
            "size_",
            "--repeat",
            str(repeat),
            "--json",
            str(path),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit(f"cost_against_size: {' '.join(command)}: {done.stderr.strip()}")
        cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
    for case in cases:
        name, _, size = case["name"].removeprefix("size_").rpartition("_")
        out.setdefault(name, []).append((float(size), float(case["best_ms"])))
    return out


def measure_strokes(counts: list[int]) -> Curve:
    """CPU time of batches of the flexible action; other work on the computer does not count."""
    action, stroke = feltmb.load_action("steinway45"), feltmb.load_stroke("forte")
    jobs = min(2, os.cpu_count() or 1)
    out = []
    for count in counts:

        def pairs(count: int = count) -> Any:
            for i in range(count):
                yield action.with_values({"key.mass": 0.117 + 1e-5 * i}), stroke

        begin = time.process_time()
        simulate_many(pairs(), lambda *_: None, jobs=jobs, summary_only=True)
        out.append((float(count), 1e3 * (time.process_time() - begin)))
    return out


def exponent(curve: Curve) -> float:
    """Slope in logarithms over the upper half of the sizes."""
    upper = np.log(np.array(curve[len(curve) // 2 - 1 :]))
    return float(np.polyfit(upper[:, 0], upper[:, 1], 1)[0])


def draw(curves: dict[str, Curve], path: Path) -> None:
    """Plot four panels; the gray line is proportional to the size, through the largest one."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = {
        "modes of the string": (("modes_modal", "method modal"), ("modes_cvode", "method cvode")),
        "bodies": (("bodies", "one right-hand side"),),
        "closed contacts on 8 bodies": (("contacts", "one right-hand side"),),
        "strokes in a batch": (("strokes", "two threads"),),
    }
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    for ax, (label, parts) in zip(figure.subplots(2, 2).flat, panels.items(), strict=True):
        for k, (name, text) in enumerate(parts):
            size, cost = np.array(curves[name]).T
            if name == "strokes":
                cost, unit = 1e-3 * cost, "s"
            elif name.startswith("modes"):
                unit = "ms"
            else:
                cost, unit = 1e3 * cost, "us"
            ax.loglog(size, cost, "os"[k] + "-", color=f"C{k}", label=text)
            if k == 0:
                ax.loglog(size, cost[-1] * size / size[-1], color="#aaaaaa", label="proportional")
        ax.set_xlabel(label)
        ax.set_ylabel(f"CPU time [{unit}]")
        ax.set_xticks(size, [f"{s:g}" for s in size])
        ax.minorticks_off()
        ax.grid(alpha=0.25)
        ax.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)
    print(f"wrote {path}", file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bench", type=Path, required=True, help="the program feltmb_bench")
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--strokes", type=int, nargs="+", default=[10, 30, 100, 300])
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    curves = measure_core(options.bench, options.repeat)
    curves["strokes"] = measure_strokes(sorted(options.strokes))
    for name, curve in curves.items():
        shown = "  ".join(f"{size:g}: {ms:.4g}" for size, ms in curve)
        print(f"{name:12} exponent {exponent(curve):.2f}   ms at size {shown}")
    if options.json is not None:
        options.json.write_text(json.dumps(curves, indent=1) + "\n", encoding="utf-8")
    if options.plot is not None:
        draw(curves, options.plot)


if __name__ == "__main__":
    main()
