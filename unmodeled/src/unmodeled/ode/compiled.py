"""The compiled integrator of programs: ``tape.cpp`` as a shared object without dependencies.

It is used if it was compiled, by a package or by ``python -m unmodeled.ode.compile``; otherwise the
same programs run in NumPy. Nothing is compiled without being asked.
"""

from __future__ import annotations

import ctypes
import functools
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.ode.program import Program
from unmodeled.ode.tape import NAMES

#: Version of the lists, and number of the operations.
VERSION = 200 + len(NAMES)
#: Set to a value, this variable of the environment turns the extension off.
OFF = "UNMODELED_NO_EXTENSION"


@functools.cache
def library() -> Any:
    """The shared object of the package; None: there is none, or it is of another version."""
    from unmodeled.ode.compile import NAME, SOURCE

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
        f"{Path(path).name} is not used: {fault}; python -m unmodeled.ode.compile makes it anew. "
        "Until then, simulations run in NumPy, which takes longer",
        RuntimeWarning,
        stacklevel=2,
    )
    return None


class _Lists:
    """Numbers and places of arrays, in the order in which ``tape.cpp`` reads them."""

    def __init__(self, *parts: Any):
        self.numbers: list[int] = []
        self.places: list[int] = []
        self.kept: list[Any] = []  # arrays exist as long as their places are known
        for part in parts:
            self.add(part)

    def add(self, part: Any) -> None:
        """A number, an array, or a list of arrays, whose places are an array."""
        if isinstance(part, int):
            self.numbers.append(part)
            return
        if isinstance(part, list):
            self.kept.append(part)
            part = np.array([v.ctypes.data for v in part], dtype=np.uint64)
        self.kept.append(np.ascontiguousarray(part))
        self.places.append(self.kept[-1].ctypes.data)


def _integers(values: Sequence[int]) -> NDArray[np.int64]:
    return np.array(values, dtype=np.int64)


def _plan(p: Program) -> _Lists:
    """A program as the extension reads it."""
    tables = [np.ascontiguousarray(t) for t in p.tables]
    entries = (p.rate, p.by_state, p.by_column, p.output, p.output_by_state, p.output_by_column)
    return _Lists(
        *(p.states, p.smooth, p.columns, p.signals, p.constants_of_jobs, p.registers),
        *(len(p.constants[0]), *p.constants),
        *(part for rows in (p.once, p.rates, p.shown) for part in (len(rows), rows)),
        *(_integers([t.shape[1] for t in tables]), tables),
        *(part for rows in entries for part in (len(rows), rows)),
        *(len(p.blocks), _integers(p.blocks)),
    )


def run(program: Program, method: Any, substeps: int, lanes: Any) -> Any:
    """Outputs, derivatives and states by lane, as :func:`unmodeled.ode.step.run`."""
    plan = program.plan = program.plan or _plan(program)
    times, signals = ([of[r] for r in lanes.track] for of in (lanes.times, lanes.signals))
    outputs = [np.empty((len(t), len(program.output))) for t in times]
    derivatives = [np.empty((len(t), len(program.output), program.columns)) for t in times]
    states = [np.empty((len(t), program.states)) for t in times]
    own = _Lists(
        *(len(method.instants), substeps, method.inner, method.carried, method.weights),
        *(np.array([method.gamma]), _integers(method.instants)),
        *(len(times), _integers([len(t) for t in times]), times, signals),
        *(lanes.constants, lanes.starts, lanes.seeds, outputs, derivatives, states),
    )
    numbers = _integers([*plan.numbers, *own.numbers])
    places = np.array([*plan.places, *own.places], dtype=np.uint64)
    library().tape_run(*map(ctypes.c_void_p, (numbers.ctypes.data, places.ctypes.data)))
    return outputs, derivatives, states
