"""Two results of feltmb_bench beside each other, or feltmb beside the peers' scripts in one run.

    python bench/speed/compare.py OLD.json NEW.json [--plot FILE]
    python bench/speed/compare.py --bench build/bench/feltmb_bench --peers bench/speed/peers
        [--python PYTHON] [--modes 40 --modes 200] [--damping 0.07 --damping 7e-4] [--rounds 3]
        [--limit 60] [--markdown FILE] [--plot FILE] [--json FILE]

With two results of ``feltmb_bench --json``: ratio of the medians of every case that both have, its
range from the quartiles, and the errors of both. With peers: the hammer-string problem H is solved
in turn by feltmb and by each engine of the scripts in the folder, round after round, one thread
each, by CPU time; the ratio is that of the best times of one round, its spread that over the
rounds. An engine
that is not installed, fails or takes longer than the limit is listed as such. Errors are those of
the force over its peak, against the reference files, beside every time.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

#: script -> arguments of its engines; {N} modes, {xi} damping ratio
PEERS = {
    "hs_py.py": [
        "scipy-LSODA-numpy {N} {xi} 1e-6",
        "scipy-LSODA-numba {N} {xi} 1e-6",
        "scipy-LSODA-numba {N} {xi} 1e-7",
        "sksundae-bdf-jac {N} {xi} 1e-6",
        "numbalsoda-lsoda {N} {xi} 1e-6",
        "numbalsoda-dop853 {N} {xi} 1e-6",
        "casadi-cvodes {N} {xi} 1e-6",
        "casadi-cvodes {N} {xi} 1e-8",
    ],
    "hs_exudyn.py": ["symbolic GeneralizedAlpha 5e-6 {N} {xi}"],
    "hs_mujoco.py": ["loop implicitfast 1e-6 {N} {xi}"],
    "hs_drake.py": ["runge_kutta3 1e-5 {N} {xi}", "runge_kutta3 1e-6 {N} {xi}"],
}

#: Cases of feltmb_bench that are compared.
OURS = (
    "H_exact_N{N}_xi{xi}_tol3e-05",
    "H_modal_N{N}_xi{xi}_rtol1e-05",
    "H_cvode_N{N}_xi{xi}_rtol1e-05",
)

#: Number of threads of the linear algebra that peers may start.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def load(path: Path) -> dict[str, dict[str, Any]]:
    """Cases of a result by name; a file that is not a result ends the program with one line."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return {case["name"]: case for case in data["cases"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"compare: {path}: is no result of feltmb_bench --json: {error}")


def spread(old: dict[str, Any], new: dict[str, Any]) -> tuple[float, float, float]:
    """Ratio new / old of the medians, and its range from the quartiles."""
    return (
        new["median_ms"] / old["median_ms"],
        new["quartile1_ms"] / old["quartile3_ms"],
        new["quartile3_ms"] / old["quartile1_ms"],
    )


def error_text(case: dict[str, Any]) -> str:
    return " ".join(f"{k}={v:.2g}" for k, v in case.get("errors", {}).items())


def compare_results(old_path: Path, new_path: Path) -> list[tuple[str, float, float, float]]:
    """Print the table of two results; return the rows of the figure."""
    old, new = load(old_path), load(new_path)
    names = [name for name in old if name in new]
    if not names:
        sys.exit(f"compare: {old_path} and {new_path} have no case in common")
    rows = []
    print(f"{'case':34} {'old ms':>10} {'new ms':>10} {'new/old':>8}  range          bits  errors")
    for name in names:
        ratio, low, high = spread(old[name], new[name])
        same = "same" if old[name].get("checksum") == new[name].get("checksum") else "new"
        print(
            f"{name:34} {old[name]['median_ms']:10.4g} {new[name]['median_ms']:10.4g} "
            f"{ratio:8.3f}  {low:.3f} to {high:.3f}  {same:4}  {error_text(old[name])}"
            f" -> {error_text(new[name])}"
        )
        rows.append((name, ratio, low, high))
    for name in sorted(set(old) ^ set(new)):
        print(f"{name:34} only in {'the first' if name in old else 'the second'}")
    return rows


def run_peer(command: list[str], environment: dict[str, str], limit: float) -> dict[str, Any]:
    """Last JSON line of a peer's script, or the reason why there is none."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=limit, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        return {"note": f"over {limit:g} s"}
    for line in reversed(done.stdout.splitlines()):
        if line.startswith("{"):
            found: dict[str, Any] = json.loads(line)
            return found
    lines = done.stderr.strip().splitlines()
    return {"note": lines[-1][:90] if lines else f"no result, exit code {done.returncode}"}


@dataclass
class Timed:
    """One engine on one problem, in all rounds."""

    engine: str
    milliseconds: list[float] = field(default_factory=list)  # best of each round
    ratios: list[float] = field(default_factory=list)  # relative to feltmb in the same round
    error: float = math.nan  # error of the force, relative to its peak
    note: str = ""

    def row(self) -> tuple[str, float, float, float]:
        """Name, median, smallest and largest ratio."""
        return self.engine, statistics.median(self.ratios), min(self.ratios), max(self.ratios)


def run_ours(bench: Path, modes: int, damping: str, repeat: int) -> dict[str, dict[str, Any]]:
    """Cases of feltmb_bench for one problem, by name."""
    out = {}
    for name in OURS:
        case = name.format(N=modes, xi=damping)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "result.json"
            command = [str(bench), "--cpu", "--case", case, "--repeat", str(repeat)]
            command += ["--json", str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                sys.exit(f"compare: {' '.join(command)}: {done.stderr.strip() or 'failed'}")
            out.update(load(path))
    return out


def compare_peers(options: argparse.Namespace) -> dict[str, list[Timed]]:
    """Time all engines on all problems in turn; print tables on standard output."""
    folder: Path = options.peers
    scripts = [name for name in PEERS if (folder / name).is_file()]
    if not scripts:
        sys.exit(f"compare: {folder} holds none of {', '.join(PEERS)}")
    environment = {
        **os.environ,
        "REPS": str(options.repeat),
        "LIM": f"{options.limit:g}",
        "CLOCK": "cpu",  # other work on the computer does not count
        "PYTHONDONTWRITEBYTECODE": "1",
        **dict.fromkeys(ONE_THREAD, "1"),
    }
    out: dict[str, list[Timed]] = {}
    for modes in options.modes:
        for damping in (f"{d:g}" for d in options.damping):
            found: dict[str, Timed] = {}
            for _ in range(options.rounds):
                _one_round(found, modes, damping, scripts, environment, options)
            title = f"{modes} modes, damping ratio {damping}"
            out[title] = list(found.values())
            print(table(title, out[title]), flush=True)
    return out


def _one_round(
    found: dict[str, Timed],
    modes: int,
    damping: str,
    scripts: list[str],
    environment: dict[str, str],
    options: argparse.Namespace,
) -> None:
    ours = run_ours(options.bench, modes, damping, 5 * options.repeat)
    best = min(float(case["best_ms"]) for case in ours.values())

    def add(name: str, ms: float, error: float) -> None:
        each = found.setdefault(name, Timed(name))
        each.milliseconds.append(ms)
        each.ratios.append(ms / best)
        each.error = error

    for name, case in ours.items():
        _, method, _, _, tolerance = name.split("_")
        digits = tolerance.lstrip("rtol")
        word = "tolerance" if method == "exact" else "rtol"
        label = f"feltmb {method}, {word} {digits}"
        add(label, float(case["best_ms"]), float(case["errors"]["force_rel"]))
    for script in scripts:
        for engine in PEERS[script]:
            given = engine.format(N=modes, xi=damping).split()
            name = " ".join(w for w in engine.split() if "{" not in w)
            name = f"{script[3:-3]} {name}" if script != "hs_py.py" else name
            if name in found and found[name].note:
                continue
            command = [options.python, str(options.peers / script), *given]
            result = run_peer(command, environment, options.limit * (options.repeat + 1) + 30)
            if not result.get("ms"):
                found.setdefault(name, Timed(name)).note = str(result.get("note", "no time"))
                continue
            add(name, float(result["ms"]), float(result.get("err_F", math.nan)))


def table(title: str, rows: list[Timed]) -> str:
    """Markdown: best time, error of the force, ratio to the fastest feltmb method, range."""
    lines = [f"{title}:", "", "| engine | ms | force error | times ours |", "|---|---|---|---|"]
    for row in rows:
        if not row.ratios:
            lines.append(f"| {row.engine} | - | | {row.note} |")
            continue
        _, middle, low, high = row.row()
        lines.append(
            f"| {row.engine} | {min(row.milliseconds):.3g} | {row.error:.1e} | "
            f"{middle:.3g} ({low:.3g} to {high:.3g}) |"
        )
    return "\n".join([*lines, ""])


def draw_peers(found: dict[str, list[Timed]], path: Path, bar: float = 1e-3) -> None:
    """Plot the error of the force over time, one panel per problem, with the requested error."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(2, len(found))
    rows = math.ceil(len(found) / columns)
    figure = Figure(figsize=(max(9.0, 5.2 * columns), 1.2 + 3.6 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    names = [row.engine for rows_ in found.values() for row in rows_]
    peers = [n for n in dict.fromkeys(names) if not n.startswith("feltmb")]
    marks = "osD^v<>pPXh*8d"
    for ax, (title, engines) in zip(axes.flat, found.items(), strict=False):
        for row in engines:
            if not row.ratios:
                continue
            own = row.engine.startswith("feltmb")
            ax.plot(
                min(row.milliseconds),
                row.error,
                "*" if own else marks[peers.index(row.engine) % len(marks)],
                color={"exact": "#D55E00", "modal": "#E69F00", "cvode": "#CC79A7"}[
                    row.engine.split()[1].rstrip(",")
                ]
                if own
                else f"C{peers.index(row.engine) % 10}",
                markersize=13 if own else 7,
                label=row.engine,
            )
        ax.axhline(bar, color="#888888", linewidth=0.8, linestyle="--")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_title(title, fontsize=10)
        ax.grid(alpha=0.25)
        ax.set_xlabel("time of 50 ms of motion [ms]")
        ax.set_ylabel("largest error of the force / peak")
    handles: dict[str, Any] = {}
    for ax in axes.flat:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncols=3,
        fontsize=8,
        frameon=False,
    )
    figure.savefig(path, dpi=110)
    print(f"wrote {path}", file=sys.stderr)


def draw(rows: list[tuple[str, float, float, float]], path: Path, label: str) -> None:
    """Plot bars on a logarithmic axis with the range of each ratio."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 1.0 + 0.25 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    places = range(len(rows))
    ratios = [r[1] for r in rows]
    ranges = [
        [max(0.0, r[1] - r[2]) for r in rows],
        [max(0.0, r[3] - r[1]) for r in rows],
    ]
    ax.barh(places, ratios, xerr=ranges, color="#0072B2", height=0.6, ecolor="#777777")
    ax.axvline(1.0, color="black", linewidth=0.8)
    ax.set_xscale("log")
    ax.set_yticks(places, [r[0] for r in rows])
    ax.invert_yaxis()
    ax.set_xlabel(label)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)
    print(f"wrote {path}", file=sys.stderr)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", nargs="*", type=Path)
    parser.add_argument("--bench", type=Path, help="the program feltmb_bench")
    parser.add_argument("--peers", type=Path, help="folder of the peers' scripts")
    parser.add_argument("--python", default=sys.executable, help="that has the peers installed")
    parser.add_argument("--modes", type=int, action="append", help="40 and 200 unless told")
    parser.add_argument("--damping", type=float, action="append", help="0.07 and 7e-4 unless told")
    parser.add_argument("--rounds", type=int, default=3, help="of all engines in turn")
    parser.add_argument("--repeat", type=int, default=3, help="best of so many in each round")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for one engine")
    parser.add_argument("--markdown", type=Path, help="tables to write")
    parser.add_argument("--json", type=Path, help="all times to write")
    parser.add_argument("--plot", type=Path, help="picture to write")
    options = parser.parse_args()
    options.modes = options.modes or [40, 200]
    options.damping = options.damping or [0.07, 7e-4]
    if options.peers is not None:
        if options.results or options.bench is None:
            parser.error("with --peers give --bench, and no results")
        found = compare_peers(options)
        if options.markdown is not None:
            text = "\n".join(table(title, rows) for title, rows in found.items())
            options.markdown.write_text(text, encoding="utf-8")
        if options.json is not None:
            data = {title: [asdict(row) for row in rows] for title, rows in found.items()}
            options.json.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        if options.plot is not None:
            draw_peers(found, options.plot)
        return
    if len(options.results) != 2:
        parser.error("give two results, or --bench PROGRAM --peers FOLDER")
    rows = compare_results(*options.results)
    if options.plot is not None:
        draw(rows, options.plot, "time, new over old")


if __name__ == "__main__":
    main()
