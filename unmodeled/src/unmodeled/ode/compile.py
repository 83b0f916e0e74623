"""Compiles the integrator of programs: ``python -m unmodeled.ode.compile [FOLDER]``.

Only with the standard library, because the build of the wheel runs this file.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).with_name("tape.cpp")
#: Name of the shared object, next to the source.
NAME = "_tape.dll" if sys.platform == "win32" else "_tape.so"
#: No contraction of products and sums: all machines give the same numbers.
OPTIONS = ("-O3", "-std=c++17", "-shared", "-fPIC", "-ffp-contract=off", "-fno-math-errno",
           "-fno-trapping-math", "-fvisibility=hidden")  # fmt: skip


def build(folder: Path = SOURCE.parent) -> Path:
    """Compile the integrator with the C++ compiler of the machine; returns the shared object.

    Parameters
    ----------
    folder
        Folder of the shared object.

    Raises
    ------
    RuntimeError
        There is no compiler, or it fails.
    """
    compiler = os.environ.get("CXX") or shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        raise RuntimeError(
            "no C++ compiler: got neither CXX nor c++ nor g++, expected one of them; without the "
            "extension, the same programs run in NumPy"
        )
    path = folder / NAME
    part = path.with_suffix(f".{os.getpid()}")
    command = [*compiler.split(), *OPTIONS, "-o", str(part), str(SOURCE)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise RuntimeError(f"{compiler}: cannot be run: {error.strerror or error}") from None
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} fails: {done.stderr.strip()[:500]}")
    part.replace(path)
    return path


if __name__ == "__main__":
    try:
        print(build(*map(Path, sys.argv[1:2])))  # noqa: T201
    except RuntimeError as fault:
        raise SystemExit(str(fault)) from None
