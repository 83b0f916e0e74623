"""Compiles the integrator of programs: ``python -m unmodeled.fit.compile [FOLDER]``."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from unmodeled.errors import InvalidParameter
from unmodeled.fit.compiled import NAME, SOURCE, library

__all__ = ["build"]

#: No contraction of products and sums: all machines give the same numbers.
OPTIONS = ("-O3", "-std=c++17", "-shared", "-fPIC", "-ffp-contract=off", "-fno-math-errno",
           "-fno-trapping-math", "-fvisibility=hidden")  # fmt: skip


def build(folder: Path | None = None) -> Path:
    """Compile the integrator with the C++ compiler of the machine.

    Parameters
    ----------
    folder
        Folder of the shared object; default: that of the package.

    Raises
    ------
    InvalidParameter
        There is no compiler, or it fails.
    """
    compiler = os.environ.get("CXX") or shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        raise InvalidParameter(
            "no C++ compiler: got neither CXX nor c++ nor g++, expected one of them; without the "
            "extension, the same programs run in NumPy"
        )
    path = (folder or SOURCE.parent) / NAME
    part = path.with_suffix(f".{os.getpid()}")
    command = [*compiler.split(), *OPTIONS, "-o", str(part), str(SOURCE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InvalidParameter(f"{' '.join(command)} fails: {done.stderr.strip()[:500]}")
    part.replace(path)
    library.cache_clear()
    return path


if __name__ == "__main__":
    print(build(*map(Path, sys.argv[1:2])))  # noqa: T201
