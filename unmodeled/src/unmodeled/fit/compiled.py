"""The compiled integrator of programs: ``tape.cpp`` as a shared object without dependencies.

It is used if it was compiled, by a package or by ``python -m unmodeled.fit.compiled``; otherwise
the same programs run in NumPy. Nothing is compiled without being asked.
"""

from __future__ import annotations

import ctypes
import functools
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array
from unmodeled.errors import InvalidParameter
from unmodeled.fit.program import Program
from unmodeled.fit.tape import NAMES

__all__ = ["SOURCE", "build", "library", "loaded", "run"]

SOURCE = Path(__file__).with_name("tape.cpp")
#: Name of the shared object, next to the source.
NAME = "_tape.dll" if sys.platform == "win32" else "_tape.so"
#: Version of the structs, and number of the operations.
VERSION = 100 + len(NAMES)
#: No contraction of products and sums: all machines give the same numbers.
OPTIONS = ("-O3", "-std=c++17", "-shared", "-fPIC", "-ffp-contract=off", "-fno-math-errno",
           "-fno-trapping-math", "-fvisibility=hidden")  # fmt: skip
#: Set to a value, this variable of the environment turns the extension off.
OFF = "FELTMB_NO_EXTENSION"


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


@functools.cache
def library() -> Any:
    """The shared object of the package; None: there is none, or it is of another version."""
    path = SOURCE.with_name(NAME)
    return loaded(path) if path.is_file() and not os.environ.get(OFF) else None


def loaded(path: Path | str) -> Any:
    """A loaded shared object; None, with a warning, if it is of another version."""
    try:
        found = ctypes.CDLL(str(path))
        found.tape_version.restype = ctypes.c_int64
        if found.tape_version() == VERSION:
            return found
        fault = "it is of another version"
    except (OSError, AttributeError) as error:
        fault = str(error)
    warnings.warn(
        f"{Path(path).name} is not used: {fault}; python -m unmodeled.fit.compiled makes it anew. "
        "Until then, simulations run in NumPy, which takes longer",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


# ---------------------------------------------------------------------- the structs of tape.cpp

_INTEGER, _NUMBER, _PLACE = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p


class _Operations(ctypes.Structure):
    _fields_ = (("rows", _PLACE), ("count", _INTEGER))


class _Program(ctypes.Structure):
    _fields_ = (
        *((n, _INTEGER) for n in ("states", "smooth", "columns", "signals", "constants_of_jobs")),
        ("registers", _INTEGER),
        ("constants", _INTEGER),
        ("constant_places", _PLACE),
        ("constant_values", _PLACE),
        ("once", _Operations),
        ("rates", _Operations),
        ("shown", _Operations),
        ("table_sizes", _PLACE),
        ("tables", _PLACE),
        ("rate", _PLACE),
        ("by_states", _INTEGER),
        ("by_state", _PLACE),
        ("by_columns", _INTEGER),
        ("by_column", _PLACE),
        ("outputs", _INTEGER),
        ("output", _PLACE),
        ("output_by_states", _INTEGER),
        ("output_by_state", _PLACE),
        ("output_by_columns", _INTEGER),
        ("output_by_column", _PLACE),
        ("blocks", _INTEGER),
        ("block_sizes", _PLACE),
    )


class _Method(ctypes.Structure):
    _fields_ = (
        *((n, _INTEGER) for n in ("stages", "substeps")),
        *((n, _PLACE) for n in ("inner", "carried", "weights", "instants")),
        ("gamma", _NUMBER),
    )


class _Lanes(ctypes.Structure):
    _fields_ = (
        ("count", _INTEGER),
        *(
            (n, _PLACE)
            for n in ("samples", "times", "signals", "constants", "starts", "seeds", "outputs",
                      "derivatives", "states")
        ),
    )  # fmt: skip


def _integers(values: Sequence[int]) -> NDArray[np.int64]:
    return np.array(values, dtype=np.int64)


def _addresses(arrays: Sequence[Array]) -> NDArray[np.uint64]:
    return np.array([a.ctypes.data for a in arrays], dtype=np.uint64)


class _Plan:
    """A program as the extension reads it."""

    def __init__(self, program: Program):
        p, kept = program, []

        def place(values: Any) -> int:
            kept.append(np.ascontiguousarray(values))
            return int(kept[-1].ctypes.data)

        def code(rows: Any) -> _Operations:
            return _Operations(place(rows), len(rows))

        tables = [np.ascontiguousarray(t) for t in p.tables]
        self.struct = _Program(
            p.states, p.smooth, p.columns, p.signals, p.constants_of_jobs, p.registers,
            len(p.constants[0]), place(p.constants[0]), place(p.constants[1]),
            code(p.once), code(p.rates), code(p.shown),
            place(_integers([t.shape[1] for t in tables])), place(_addresses(tables)),
            place(p.rate), len(p.by_state), place(p.by_state),
            len(p.by_column), place(p.by_column),
            len(p.output), place(p.output),
            len(p.output_by_state), place(p.output_by_state),
            len(p.output_by_column), place(p.output_by_column),
            len(p.blocks), place(_integers(p.blocks)),
        )  # fmt: skip
        self.kept = kept, tables


def run(program: Program, method: Any, substeps: int, lanes: Any) -> Any:
    """Outputs, derivatives and states by lane, as :func:`unmodeled.fit.step.run`."""
    plan = program.plan or _Plan(program)
    program.plan = plan
    samples = [len(lanes.times[r]) for r in lanes.track]
    outputs = [np.empty((n, len(program.output))) for n in samples]
    derivatives = [np.empty((n, len(program.output), program.columns)) for n in samples]
    states = [np.empty((n, program.states)) for n in samples]
    own: dict[str, Any] = {
        "samples": _integers(samples),
        "times": _addresses([lanes.times[r] for r in lanes.track]),
        "signals": _addresses([lanes.signals[r] for r in lanes.track]),
        "constants": lanes.constants,
        "starts": lanes.starts,
        "seeds": np.ascontiguousarray(lanes.seeds),
        "outputs": _addresses(outputs),
        "derivatives": _addresses(derivatives),
        "states": _addresses(states),
    }
    struct = _Lanes(len(samples), *(v.ctypes.data for v in own.values()))
    numbers = [method.inner, method.carried, method.weights, _integers(method.instants)]
    steps = _Method(len(method.instants), substeps, *(v.ctypes.data for v in numbers), method.gamma)
    library().tape_run(ctypes.byref(plan.struct), ctypes.byref(steps), ctypes.byref(struct))
    return outputs, derivatives, states


if __name__ == "__main__":
    print(build(*map(Path, sys.argv[1:2])))  # noqa: T201
