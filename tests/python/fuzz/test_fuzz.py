"""Inputs that nobody intended: no crash, no hang, no traceback, one clear message."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

WORKER = Path(__file__).with_name("fuzz.py")
FEW = 4  # cases of each target in the fast set
TARGETS = {  # cases of the slow set, together 140 000
    "mechanism": 32_000,
    "stroke_csv": 24_000,
    "stroke_toml": 16_000,
    "curves": 10_000,
    "compression": 6_000,
    "felt": 8_000,
    "regulation": 6_000,
    "actuator": 4_000,
    "run_file": 4_000,
    "attacked_run": 1_000,
    "csv_heading": 10_000,
    "record_file": 8_000,
    "command_line": 5_000,
    **dict.fromkeys(("mat4", "mat5", "mat73", "netcdf", "npz", "csv", "toml"), 4_000),
    "live": 1_000,
}
TIMEOUT = 3600.0  # s of wall time for one process; hangs are ended by their processor time


def faults(target, first, count, folder):
    """What is wrong, of a crash or a hang too."""
    log = folder / "case"
    process = subprocess.run(
        [sys.executable, str(WORKER), target, str(first), str(count), str(log)],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
        errors="replace",
    )
    found = [json.loads(line) for line in process.stdout.splitlines() if line.startswith("{")]
    out = [f"{f['target']} {f['case']}: {f['wrong']}" for f in found]
    if process.returncode != 0:
        end = process.stderr[-2000:]
        out.append(f"case {log.read_text()}: the process ended by {process.returncode}: {end}")
    return out


def test_some_mutations(tmp_path):
    """All targets in one process."""
    wrong = faults(",".join(TARGETS), 0, FEW, tmp_path)
    assert not wrong, "\n\n".join(wrong[:5])


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_many_mutations(target, tmp_path):
    count, step = TARGETS[target], 500
    wrong = []
    for first in range(1000, 1000 + count, step):
        wrong += faults(target, first, min(step, 1000 + count - first), tmp_path)
    assert not wrong, f"{len(wrong)} of {count}\n" + "\n\n".join(wrong[:20])


def test_the_number_of_cases():
    assert sum(TARGETS.values()) >= 100_000


def test_the_fuzzer_finds_what_is_wrong(monkeypatch):
    """The checks can fail: a target that does each wrong thing is told."""
    sys.path.insert(0, str(WORKER.parent))
    import feltmb
    import fuzz

    def wrong(case):
        kind = case.rng.randrange(5)
        if kind == 0:
            raise KeyError("x")
        if kind == 1:
            raise feltmb.InvalidParameter("")
        if kind == 2:
            raise MemoryError
        if kind == 3:
            (case.folder / ".feltmb123.nc").touch()
        if kind == 4:
            error = feltmb.InvalidParameter()
            error.args = ("a" * 30_000,)  # past what cuts messages
            raise error

    monkeypatch.setitem(fuzz.TARGETS, "wrong", wrong)
    told = [fuzz.run_case("wrong", k) for k in range(40)]
    assert all(told)
    assert len({t.split()[0] for t in told}) >= 4
