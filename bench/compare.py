"""Two results of feltmb_bench beside each other, or one beside the peers' scripts.

    python bench/compare.py OLD.json NEW.json [--plot FILE]
    python bench/compare.py RESULT.json --peers bench/peers [--python PYTHON] [--modes 40]
        [--damping 0.07] [--repeat 3] [--limit 60] [--plot FILE]

RESULT.json is what ``feltmb_bench --json`` writes. With two results: ratio of the medians of every
case that both have, its range from the quartiles, and the errors of both. With peers: each engine
of the scripts in the folder solves the hammer-string problem H; one that is not installed, fails or
takes longer than the limit is listed as such. Times of one run on one quiet machine only can be
compared; errors are printed beside every time.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

#: script -> arguments of its engines; {N} modes, {xi} damping ratio
PEERS = {
    "hs_py.py": [
        "scipy-LSODA-numpy {N} {xi}",
        "scipy-LSODA-numba {N} {xi}",
        "sksundae-bdf-jac {N} {xi}",
        "numbalsoda-lsoda {N} {xi}",
        "numbalsoda-dop853 {N} {xi}",
        "casadi-cvodes {N} {xi}",
    ],
    "hs_exudyn.py": ["symbolic GeneralizedAlpha 5e-6 {N} {xi}"],
    "hs_mujoco.py": ["loop implicitfast 1e-6 {N} {xi}"],
    "hs_drake.py": ["runge_kutta3 1e-6 {N} {xi}"],
}


def load(path: Path) -> dict[str, dict[str, Any]]:
    """Cases of a result by name; exits with one line if the file is none."""
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
    """Print the table of two results; rows for the picture."""
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
    """Last JSON line of a peer's script, or why there is none."""
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


def compare_peers(
    result: Path, folder: Path, options: argparse.Namespace
) -> list[tuple[str, float, float, float]]:
    """Print our cases of problem H beside the peers; rows for the picture."""
    cases = load(result)
    start = f"H_N{options.modes}_xi{options.damping:g}_"
    ours = {name: case for name, case in cases.items() if name.startswith(start)}
    if not ours:
        sys.exit(f"compare: {result} has no case {start}*; run feltmb_bench --case {start}")
    scripts = [name for name in PEERS if (folder / name).is_file()]
    if not scripts:
        sys.exit(f"compare: {folder} holds none of {', '.join(PEERS)}")
    print(f"hammer on string, {options.modes} modes, damping ratio {options.damping:g}")
    print(f"{'engine':34} {'ms':>10} {'times':>8}  errors")
    best = min(case["median_ms"] for case in ours.values())
    rows = []
    for name, case in ours.items():
        ms = float(case["median_ms"])
        print(f"{name:34} {ms:10.4g} {ms / best:8.1f}  {error_text(case)}")
        low, high = case["quartile1_ms"] / best, case["quartile3_ms"] / best
        rows.append((name, case["median_ms"] / best, low, high))
    environment = {**os.environ, "REPS": str(options.repeat), "LIM": f"{options.limit:g}"}
    for script in scripts:
        for engine in PEERS[script]:
            given = engine.format(N=options.modes, xi=f"{options.damping:g}").split()
            command = [options.python, str(folder / script), *given]
            found = run_peer(command, environment, options.limit * (options.repeat + 1) + 30)
            name = str(found.get("engine", engine.split()[0]))
            if not found.get("ms"):
                print(f"{name:34} {'-':>10} {'':8}  {found.get('note', 'no time')}")
                continue
            ms = float(found["ms"])
            errors = " ".join(
                f"{k}={found[k]:.2g}" for k in ("err_x", "err_F") if found.get(k) is not None
            )
            print(f"{name:34} {ms:10.4g} {ms / best:8.1f}  {errors}")
            rows.append((name, ms / best, ms / best, ms / best))
    return rows


def draw(rows: list[tuple[str, float, float, float]], path: Path, label: str) -> None:
    """Bars on a logarithmic axis with the range of each ratio."""
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
    parser.add_argument("results", nargs="+", type=Path)
    parser.add_argument("--peers", type=Path, help="folder of the peers' scripts")
    parser.add_argument("--python", default=sys.executable, help="that has the peers installed")
    parser.add_argument("--modes", type=int, default=40)
    parser.add_argument("--damping", type=float, default=0.07)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for one engine")
    parser.add_argument("--plot", type=Path, help="picture to write")
    options = parser.parse_args()
    if options.peers is not None:
        if len(options.results) != 1:
            parser.error("with --peers give one result")
        rows = compare_peers(options.results[0], options.peers, options)
        label = "time over the quickest of feltmb"
    else:
        if len(options.results) != 2:
            parser.error("give two results, or one and --peers FOLDER")
        rows = compare_results(*options.results)
        label = "time, new over old"
    if options.plot is not None:
        draw(rows, options.plot, label)


if __name__ == "__main__":
    main()
