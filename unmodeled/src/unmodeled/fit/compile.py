"""Compiles the integrator of programs: ``python -m unmodeled.fit.compile [FOLDER]``."""

from __future__ import annotations

import sys
from pathlib import Path

from unmodeled.errors import InvalidParameter
from unmodeled.fit.build_tape import SOURCE, compile_tape
from unmodeled.fit.compiled import library


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
    try:
        path = compile_tape(SOURCE, folder or SOURCE.parent)
    except RuntimeError as error:
        raise InvalidParameter(str(error)) from None
    library.cache_clear()
    return path


if __name__ == "__main__":
    print(build(*map(Path, sys.argv[1:2])))  # noqa: T201
