"""Builds the C++ network of the bench, ``blind._network``, if it is missing or out of date.

The extension is not part of feltmb; one machine of the bench uses it. The build needs CMake, a C++
compiler and pybind11.
"""

from __future__ import annotations

import fcntl
import subprocess
import sys
import sysconfig
from pathlib import Path

from unmodeled.errors import Error

__all__ = ["build_network"]

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "network"
LIBRARY = HERE / f"_network{sysconfig.get_config_var('EXT_SUFFIX')}"
BUILD = HERE.parents[1] / "build" / f"network-{sysconfig.get_config_var('SOABI')}"


def _is_new() -> bool:
    return LIBRARY.exists() and LIBRARY.stat().st_mtime >= max(
        f.stat().st_mtime for f in SOURCES.iterdir()
    )


def build_network() -> None:
    """Build ``blind._network`` if it is not up to date; one process at a time.

    Raises
    ------
    Error
        A command failed; the message has its output.
    """
    if _is_new():
        return
    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if _is_new():
            return
        print("blind bench: building its C++ network, once", file=sys.stderr)
        pybind = _output([sys.executable, "-m", "pybind11", "--cmakedir"]).strip()
        found = [f"-Dpybind11_DIR={pybind}", f"-DPython_EXECUTABLE={sys.executable}"]
        _output(["cmake", "-S", str(SOURCES), "-B", str(BUILD), *found])
        _output(["cmake", "--build", str(BUILD), "--target", "_network"])
        LIBRARY.touch()


def _output(command: list[str]) -> str:
    try:
        run = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise Error(
            f"blind bench: its C++ network needs {command[0]}, which is not installed"
        ) from None
    if run.returncode != 0:
        raise Error(
            f"blind bench: building its C++ network failed: {' '.join(command)}\n"
            f"{run.stdout[-2000:]}{run.stderr[-2000:]}"
        )
    return run.stdout
