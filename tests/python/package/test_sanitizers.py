"""Memory, undefined behavior, races, and what a reader of the C++ would object to. All slow."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["address", "thread"])
def test_sanitizers_are_silent(kind):
    """In the folder of the script: what was compiled before is not compiled again."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", str(ROOT / "tools" / "sanitize.sh"), kind],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PATH": path},
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-5000:]
    assert done.stdout.splitlines()[-1].startswith(f"sanitize {kind}: ")


def test_the_script_of_the_sanitizers_says_what_it_takes():
    script = ["bash", str(ROOT / "tools" / "sanitize.sh"), "memory"]
    done = subprocess.run(script, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "sanitize.sh: got memory, expected address or thread\n"


@pytest.mark.slow
def test_static_analysis_is_silent():
    if shutil.which("cppcheck") is None:
        pytest.skip("no cppcheck; on Debian: apt-get install cppcheck")
    done = subprocess.run(
        [
            "cppcheck",
            "--enable=warning,performance,portability",
            "--inline-suppr",
            "--std=c++20",
            "--language=c++",
            "--quiet",
            "--error-exitcode=1",
            "--suppress=missingInclude",
            "--suppress=missingIncludeSystem",
            "-I",
            str(ROOT / "cpp" / "include"),
            str(ROOT / "cpp" / "src"),
            str(ROOT / "cpp" / "include"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
