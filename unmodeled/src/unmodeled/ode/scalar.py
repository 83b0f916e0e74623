"""Programs as generated functions of plain numbers, for a few simulations without the extension.

An operation of NumPy takes as long for one number as for twenty: its call costs more than its work.
The loop over the steps of an explicit method is therefore generated as Python, in which a register
is a local variable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from unmodeled.data import Array
from unmodeled.ode.program import Program
from unmodeled.ode.tape import ARGUMENTS, FUNCTIONS, NAMES, TABLES, Code

if TYPE_CHECKING:
    from unmodeled.ode.methods import Method

#: Largest number of simulations for which plain numbers are faster than arrays: an operation takes
#: 0.04 us on a number, and 0.7 us on an array of up to 20.
MOST = 16
#: Operations as expressions of their arguments. NaN remains NaN, as in NumPy.
EXPRESSIONS = {
    "add": "{0} + {1}",
    "subtract": "{0} - {1}",
    "multiply": "{0} * {1}",
    # Often the branch of a condition that is not taken: no exception.
    "divide": "{0} / {1} if {1} != 0.0 else by_zero({0}, {1})",
    "negative": "-{0}",
    "absolute": "abs({0})",
    "minimum": "{0} if {0} <= {1} or {0} != {0} else {1}",
    "maximum": "{0} if {0} >= {1} or {0} != {0} else {1}",
    "sign": "1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else {0}",
    "less": "1.0 if {0} < {1} else 0.0",
    "less_equal": "1.0 if {0} <= {1} else 0.0",
    "equal": "1.0 if {0} == {1} else 0.0",
    "where": "{1} if {0} != 0.0 else {2}",
    "power": "power({0}, {1})",
}
#: Functions of the standard library that raise an exception where NumPy gives NaN or infinity.
OF_MATH = {
    "sqrt": math.sqrt, "exp": math.exp, "log": math.log, "sin": math.sin, "cos": math.cos,
    "tan": math.tan, "arcsin": math.asin, "arccos": math.acos, "arctan": math.atan,
    "arctan2": math.atan2, "sinh": math.sinh, "cosh": math.cosh, "tanh": math.tanh,
    "expm1": math.expm1, "log1p": math.log1p, "power": math.pow,
}  # fmt: skip


def marched(
    program: Program,
    rates: Code,
    method: Method,
    substeps: int,
    times: Sequence[Array],
    signals: Sequence[Array],
    constants: Array,
    starts: Array,
) -> list[Array] | None:
    """States at all stages of each simulation, (samples, substeps, stages, states).

    None: an operation has no number, such as a division by zero; NumPy says what it gives.

    Parameters
    ----------
    program, method, substeps
        As for :func:`unmodeled.ode.step.run`; the method is explicit.
    rates
        The operations of the program on which the rates depend.
    times, signals
        Those of each simulation.
    constants, starts
        Constants of jobs and states at the start, (..., lanes).
    """
    if method not in program.marches:
        program.marches[method] = _generated(program, rates, method)
    march = program.marches[method]
    found = []
    for lane, (t, s) in enumerate(zip(times, signals, strict=True)):
        own = constants[:, lane].tolist(), starts[:, lane].tolist()
        try:
            flat = march(t.tolist(), s.tolist(), *own, substeps)
        except (ArithmeticError, ValueError):
            return None
        shape = len(t), substeps, len(method.instants), program.states
        found.append(np.array(flat).reshape(shape))
    return found


def _generated(program: Program, rates: Code, method: Method) -> Callable[..., list[float]]:
    """``march(times, signals, constants, starts, substeps)``, all states at all stages in a row."""
    names: dict[str, Any] = {"inf": math.inf, "nan": math.nan, "by_zero": _by_zero, **OF_MATH}
    first = 1 + program.states + program.signals
    held = range(1 + program.states, first)
    states = range(program.states)
    lines = ["def march(times, signals, constants, starts, substeps):", " path = []"]
    lines += [f" r{i} = {float(v)!r}" for i, v in zip(*program.constants, strict=True)]
    lines += [f" r{first + i} = constants[{i}]" for i in range(program.constants_of_jobs)]
    lines += [f" {line}" for line in _operations(program, program.once, names)]
    lines += [f" x{i} = starts[{i}]" for i in states]
    lines += [
        " for j in range(len(times) - 1):",
        "  begin, now = times[j], signals[j]",
        "  h = (times[j + 1] - begin) / substeps",
        "  for step in range(substeps):",
    ]
    body: list[str] = []
    for stage, instant in enumerate(method.instants):
        body += [f"at = 2 * step + {instant}", "r0 = begin + (0.5 * at) * h"]
        body += ["u = now[at]"] if len(held) else []
        body += [f"r{r} = u[{k}]" for k, r in enumerate(held)]
        body += [f"r{1 + i} = x{i}{_sum(method.inner[stage], i, 'h * ')}" for i in states]
        body.append(f"path += ({', '.join(f'r{1 + i}' for i in states)},)")
        body += _operations(program, rates, names)
        body += [
            f"k{stage}_{i} = r{r}{_sum(method.carried[stage], i)}"
            for i, r in enumerate(program.rate)
        ]
    body += [f"x{i} = x{i}{_sum(method.weights, i, 'h * ')}" for i in states]
    lines += [f"   {line}" for line in body]
    last = [f"x{i}" for i in states] * len(method.instants)
    lines.append(f" path += [{', '.join(last)}] * substeps")
    lines.append(" return path")
    exec("\n".join(lines), names)
    made: Callable[..., list[float]] = names["march"]
    return made


def _by_zero(a: float, b: float) -> float:
    if a == 0.0 or math.isnan(a):
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def _sum(shares: Array, state: int, factor: str = "") -> str:
    """Text of what is added to a value: shares of the earlier stages."""
    terms = [f"{float(a)!r} * k{j}_{state}" for j, a in enumerate(shares) if a != 0.0]
    return f" + {factor}({' + '.join(terms)})" if terms else ""


def _operations(program: Program, code: Code, names: dict[str, Any]) -> Iterator[str]:
    """Lines of operations; ``names`` gets the functions that they need."""
    for operation, out, *args in code.tolist():
        name = NAMES[operation]
        if operation in TABLES:
            of, table = FUNCTIONS[name], program.tables[args[1]]
            names[f"{name}{args[1]}"] = lambda x, of=of, table=table: float(of(x, table))
            yield f"r{out} = {name}{args[1]}(r{args[0]})"
            continue
        given = [f"r{a}" for a in args[: ARGUMENTS[operation]]]
        if name == "floor":  # of an infinite number: an exception
            names["floor"] = lambda x: float(math.floor(x))
        text = EXPRESSIONS.get(name, f"{name}({', '.join(given)})")
        yield f"r{out} = {text.format(*given)}"
