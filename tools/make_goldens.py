"""Writes the goldens of tests/python/regression and prints their changes.

python tools/make_goldens.py --reason "why the numbers changed"
"""

import argparse
import datetime
import json
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "python" / "regression"))

import golden  # noqa: E402


def commit():
    """Commit of the working tree, with a mark if it has changes."""

    def git(*arguments):
        done = subprocess.run(
            ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    return (git("rev-parse", "--short=12", "HEAD") or "unknown") + (
        "+changes" if git("status", "--porcelain", "--", "cpp", "python") else ""
    )


def report_change(name, run):
    """Print the largest change of each signal, relative to its range."""
    try:
        stored, _ = golden.load(name)
    except FileNotFoundError:
        print(f"{name}: new")
        return
    for signal in golden.SIGNALS:
        if signal not in stored or len(stored["time"]) != len(run.time):
            print(f"{name}: {signal}: new, or of another length")
            continue
        change = np.max(np.abs(run[signal] - stored[signal])) / np.ptp(stored[signal])
        print(f"{name}: {signal}: changed by {change:.2e} of its range")


def write(name, reason):
    run = golden.simulate(name)
    report_change(name, run)
    record = {
        "reason": reason,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "command": f"python tools/make_goldens.py --reason {json.dumps(reason)}",
        "version": run.provenance["version"],
        "commit": commit(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "action": run.provenance["action"],
        "hash": run.provenance["hash"],
        "stroke": run.provenance["stroke"],
        "options": run.provenance["options"],
        "steps": run.stats["steps"],
        "summary": run.summary,
    }
    golden.FOLDER.mkdir(exist_ok=True)
    signals = {signal: run[signal] for signal in golden.SIGNALS}
    np.savez_compressed(golden.FOLDER / f"{name}.npz", time=run.time, **signals)
    text = json.dumps(record, indent=2) + "\n"
    (golden.FOLDER / f"{name}.json").write_text(text, encoding="utf-8")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reason", required=True, help="why the numbers changed")
    reason = parser.parse_args().reason.strip()
    if not reason:
        parser.error("give a reason: it goes into the golden and into CHANGELOG")
    for name in golden.DURATION:
        write(name, reason)


if __name__ == "__main__":
    main()
