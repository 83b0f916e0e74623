"""Whether the tests notice that a decision threshold of a diagnosis has no influence.

python bench/blind/criteria_tests.py            # all of feltmb.gap.criteria
python bench/blind/criteria_tests.py WALD RIVAL

The test file of every criterion is run twice, with a hundredth and with a hundred times its value.
A criterion that no test notices is not needed, or its test is missing. Defaults of options are left
out: a test gives the option itself.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from feltmb.gap.criteria import CRITERIA

from blind.ablation import at_value
from feltmb.cli import main
from feltmb.errors import InvalidParameter

__all__ = ["command"]

ROOT = Path(__file__).resolve().parents[2]
FACTORS = (0.01, 100.0)


def _times(value: float | tuple[float, ...], factor: float) -> float | tuple[float, ...]:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor


def _first_failure(name: str, test: str, factor: float) -> str:
    """First test that fails with another value of a criterion; empty: all pass."""
    call = [sys.executable, __file__, "--inside", str(factor), name]
    # at_value changes modules, so that each trial has a process of its own.
    done = subprocess.run(
        call, cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True
    )
    if done.returncode == 0:
        return ""
    failed = [x for x in done.stdout.splitlines() if x.startswith(("FAILED", "ERROR"))]
    return failed[0].split("::")[-1].split(" - ")[0] if failed else f"{test} ended"


@click.command()
@click.argument("names", nargs=-1)
@click.option("--inside", type=float, hidden=True, help="Run the test with this factor, here.")
def command(names: tuple[str, ...], inside: float | None) -> None:
    """Run the test of criteria NAMES (default: all) with other values; print which test fails."""
    known = {c.name: c for c in CRITERIA}
    unknown = sorted(set(names) - known.keys())
    if unknown:
        raise InvalidParameter(f"{unknown[0]}: is no criterion; expected one of {', '.join(known)}")
    if inside is not None:
        import pytest

        c = known[names[0]]
        with at_value(c.name, _times(c.value, inside)):
            path = str(ROOT / "tests" / "python" / c.test)
            code = pytest.main(["-q", "-x", "--tb=no", "-p", "no:cacheprovider", path])
        click.get_current_context().exit(code)
    print("| criterion | value | factor | first test that fails |\n|---|---|---|---|")
    usual = [c.name for c in CRITERIA if not c.reason.startswith("default of `Options")]
    for c in map(known.__getitem__, names or usual):
        for factor in FACTORS:
            failed = _first_failure(c.name, c.test, factor) or "**none**"
            print(f"| `{c.name}` | {c.value} | {factor:g} | {failed} |", flush=True)


if __name__ == "__main__":
    main(command=command, name="criteria_tests.py")
