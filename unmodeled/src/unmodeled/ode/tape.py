"""Tracing: functions of the user become lists of operations, with their derivatives.

A function is called once with symbols instead of numbers. Every operation on a symbol is recorded.
The record, a :class:`Tape`, is evaluated by :mod:`unmodeled.ode.step` without Python, and its
derivatives are further operations of the same tape.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array

Code = NDArray[np.int32]
#: A quantity of a tape: its place among the nodes.
Node = int
#: What a tape computes, and by which input that is differentiated; None: the value itself.
Target = tuple[Any, Any]


class NotTraceable(BaseException):
    """A function needs the number of a symbol, for example for an index.

    No ``except Exception`` of a user catches it; what does is found by :attr:`Tape.refused`.
    """


class Kept(NotTraceable):
    """A symbol is used after its call: the function has a state of its own."""


def _where(a: Any, b: Any, c: Any) -> Any:
    return np.where(a != 0.0, b, c)


def _slope(x: Array, table: Array) -> Array:
    """Slope of a table, (2, n), at values: zero beyond its ends."""
    knots, values = table
    i = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2)
    inside = (x >= knots[0]) & (x < knots[-1])
    return np.where(inside, (values[i + 1] - values[i]) / (knots[i + 1] - knots[i]), 0.0)


#: Operations by name, in the order of their codes in tape.cpp.
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "negative": np.negative,
    "absolute": np.absolute,
    "minimum": np.minimum,
    "maximum": np.maximum,
    "power": np.power,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "arcsin": np.arcsin,
    "arccos": np.arccos,
    "arctan": np.arctan,
    "arctan2": np.arctan2,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "sign": np.sign,
    "floor": np.floor,
    "less": lambda a, b: 1.0 * np.less(a, b),
    "less_equal": lambda a, b: 1.0 * np.less_equal(a, b),
    "equal": lambda a, b: 1.0 * np.equal(a, b),
    "where": _where,
    "expm1": np.expm1,
    "log1p": np.log1p,
    "interp": lambda a, table: np.interp(a, table[0], table[1]),
    "slope": _slope,
}
NAMES = tuple(FUNCTIONS)
_PAIRS = ("add", "subtract", "multiply", "divide", "minimum", "maximum", "power", "arctan2", "less",
          "less_equal", "equal")  # fmt: skip
#: Numbers of arguments by code.
ARGUMENTS = tuple(3 if n == "where" else 2 if n in _PAIRS else 1 for n in NAMES)
_CODE = {name: k for k, name in enumerate(NAMES)}
#: Largest number of paths through a function, and of branches on one.
PATHS = 64
#: Operations whose second argument is a table.
TABLES = (_CODE["interp"], _CODE["slope"])
#: Operations at which a function may jump.
_JUMPS = ("sign", "floor", "less", "less_equal", "equal")


class Tape:
    """Operations on inputs and constants, each of which is stored once."""

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, ...]] = []
        """``("input", key)``, ``("constant", value)`` or an operation with its nodes."""
        self.tables: list[Array] = []
        self._known: dict[tuple[Any, ...], Node] = {}
        self._path: dict[Node, bool] = {}
        """Conditions that a function asked for, and the answers."""
        self._answers: tuple[bool, ...] = ()
        self.refused: NotTraceable | None = None
        """What a function asked for that a symbol does not have, whether it caught that or not."""
        self.closed = False
        """Whether the function has returned."""
        self.zero = self.constant(0.0)
        self.one = self.constant(1.0)

    def _node(self, row: tuple[Any, ...]) -> Node:
        if row not in self._known:
            self._known[row] = len(self.nodes)
            self.nodes.append(row)
        return self._known[row]

    def input(self, key: Any) -> Symbol:
        """Symbol of an input."""
        return Symbol(self, self._node(("input", key)))

    def constant(self, value: float) -> Node:
        """Node of a constant; -0 and NaN are constants of their own."""
        return self._node(("constant", float(value).hex()))

    def value(self, node: Node) -> float | None:
        """Number of a constant; None: the node is no constant."""
        row = self.nodes[node]
        return float.fromhex(row[1]) if row[0] == "constant" else None

    def refuse(self, why: str) -> NoReturn:
        """Raise that a function cannot be traced, and remember it."""
        self.refused = NotTraceable(why)
        raise self.refused

    def of(self, value: Any) -> Node:
        """Node of a symbol or a number.

        Raises
        ------
        NotTraceable
            The value is no real number.
        """
        if isinstance(value, Symbol):
            if self.closed or value.tape is not self:
                self.refused = Kept("a symbol of an earlier call was kept")
                raise self.refused
            return value.node
        if isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
            return self.of(value.reshape(-1)[0])
        if np.iscomplexobj(value):
            self.refuse(f"complex numbers, such as {value!r:.40}")
        if np.size(value) != 1:
            self.refuse(f"an array of {np.size(value)} numbers where one value is expected")
        try:
            return self.constant(float(np.asarray(value).reshape(-1)[0]))
        except (TypeError, ValueError):
            self.refuse(f"{type(value).__name__} where a number is expected")

    def table(self, knots: Any, values: Any) -> int:
        """Place of a table of constants."""
        rows = [np.asarray(v, dtype=np.float64).reshape(-1) for v in (knots, values)]
        table = np.array(rows)
        for i, known in enumerate(self.tables):
            if np.array_equal(known, table):
                return i
        self.tables.append(table)
        return len(self.tables) - 1

    def add(self, name: str, *args: Node, exact: bool = False) -> Node:
        """Node of an operation, which is simplified if its arguments are constants.

        ``exact``: only where it has the same value also for infinite numbers.
        """
        known = [self.value(a) for a in args] if name not in ("interp", "slope") else [None]
        if all(v is not None for v in known):
            with np.errstate(all="ignore"):
                return self.constant(float(FUNCTIONS[name](*map(np.float64, known))))
        simple = None if exact and 0.0 in known[:2] else self._simplified(name, args, known)
        return self._node((name, *args)) if simple is None else simple

    def _simplified(
        self, name: str, args: tuple[Node, ...], known: Sequence[float | None]
    ) -> Node | None:
        if name == "where":
            if known[0] is not None:
                return args[1] if known[0] != 0.0 else args[2]
            return args[1] if args[1] == args[2] else None
        if name == "negative" and self.nodes[args[0]][0] == "negative":
            return int(self.nodes[args[0]][1])
        if len(args) != 2 or len(known) != 2:
            return None
        rule = getattr(self, f"_of_{name}", None)
        found: Node | None = None if rule is None else rule(*args, *known)
        return found

    # Simpler nodes of operations on a and b, of which u and v are the numbers, if they are known.

    def _of_add(self, a: Node, b: Node, u: float | None, v: float | None) -> Node | None:
        return b if u == 0.0 else a if v == 0.0 else None

    def _of_subtract(self, a: Node, b: Node, u: float | None, v: float | None) -> Node | None:
        return self.add("negative", b) if u == 0.0 else a if v == 0.0 else None

    def _of_multiply(self, a: Node, b: Node, u: float | None, v: float | None) -> Node | None:
        if u == 0.0 or v == 0.0:
            return self.zero
        for number, other in ((u, b), (v, a)):
            if number in (1.0, -1.0):
                return other if number == 1.0 else self.add("negative", other)
        return None

    def _of_divide(self, a: Node, _: Node, u: float | None, v: float | None) -> Node | None:
        return self.zero if u == 0.0 else a if v == 1.0 else None

    def _of_power(self, a: Node, _: Node, __: float | None, v: float | None) -> Node | None:
        return None if v is None else self._power(a, v)

    def _power(self, a: Node, power: float) -> Node | None:
        """Small powers as products."""
        if power in (0.0, 1.0):
            return self.one if power == 0.0 else a
        if power == 0.5:
            return self.add("sqrt", a)
        if power in (2.0, 3.0, 4.0):
            square = self.add("multiply", a, a)
            if power == 2.0:
                return square
            return self.add("multiply", square, a if power == 3.0 else square)
        return self.add("divide", self.one, a) if power == -1.0 else None

    # --------------------------------------------------------------------------------- branches

    def asked(self, node: Node) -> bool:
        """Answer to a branch of Python: the function is called again with the other one."""
        known = self.value(self.of(Symbol(self, node)))
        if known is not None:
            return known != 0.0
        if node not in self._path:
            k = len(self._path)
            if k >= PATHS:
                self.refuse(f"more than {PATHS} branches, or a loop, depend on values")
            self._path[node] = self._answers[k] if k < len(self._answers) else True
        return self._path[node]

    def called(self, function: Callable[[], Mapping[Any, Any]]) -> dict[Any, Node]:
        """Nodes of what a function returns by name, for all paths through its branches."""
        return self._called(function, (), [PATHS])

    def _called(
        self, function: Callable[[], Mapping[Any, Any]], answers: tuple[bool, ...], left: list[int]
    ) -> dict[Any, Node]:
        left[0] -= 1
        if left[0] < 0:
            self.refuse(f"more than {PATHS} paths through branches that depend on values")
        self._path, self._answers = {}, answers
        found = {key: self.of(v) for key, v in function().items()}
        if self.refused is not None:  # the function caught it
            raise self.refused
        path = list(self._path.items())
        for k in range(len(path) - 1, len(answers) - 1, -1):
            taken = tuple(answer for _, answer in path[:k])
            other = self._called(function, (*taken, False), left)
            found = {
                key: self.add(
                    "where", path[k][0], found.get(key, self.zero), other.get(key, self.zero)
                )
                for key in dict.fromkeys([*found, *other])
            }
        return found

    def evaluated(self, wanted: Iterable[Node], at: Mapping[Any, Any]) -> dict[Node, Any]:
        """Values of nodes from those of the inputs by key: numbers, or arrays of one shape."""
        found: dict[Node, Any] = {}
        with np.errstate(all="ignore"):
            for node in sorted(_needed(self.nodes, wanted)):
                name, *args = self.nodes[node]
                if name == "input":
                    found[node] = at[args[0]]
                elif name == "constant":
                    found[node] = float.fromhex(args[0])
                elif name in ("interp", "slope"):
                    found[node] = FUNCTIONS[name](found[args[0]], self.tables[args[1]])
                else:
                    found[node] = FUNCTIONS[name](*(found[a] for a in args))
        return found

    def terms_with(self, node: Node, inputs: Container[Any]) -> Node:
        """Sum of the terms of a sum that depend on some inputs; it may be over a common divisor."""
        if not self._reads(node, inputs):
            return self.zero
        name, *args = self.nodes[node]
        if name in ("add", "subtract", "negative"):
            return self.add(name, *(self.terms_with(a, inputs) for a in args))
        if name == "divide" and not self._reads(args[1], inputs):
            return self.add(name, self.terms_with(args[0], inputs), args[1])
        return node

    def _reads(self, node: Node, inputs: Container[Any]) -> bool:
        rows = (self.nodes[n] for n in _needed(self.nodes, [node]))
        return any(row[0] == "input" and row[1] in inputs for row in rows)

    # ------------------------------------------------------------------------------ derivatives

    def derivatives(self, targets: Iterable[Node]) -> dict[Node, dict[Any, Node]]:
        """Nodes of the derivatives of some nodes by the inputs; absent: zero."""
        wanted = _needed(self.nodes, targets)
        out: dict[Node, dict[Any, Node]] = {}
        for node in sorted(wanted):  # arguments before results
            row = self.nodes[node]
            if row[0] == "input":
                out[node] = {row[1]: self.one}
            elif row[0] != "constant":
                out[node] = self._derivative(node, row, out)
        return out

    def _derivative(
        self, node: Node, row: tuple[Any, ...], known: Mapping[Node, dict[Any, Node]]
    ) -> dict[Any, Node]:
        name, args = row[0], row[1:]
        if name in _JUMPS or name == "slope":
            return {}
        total: dict[Any, Node] = {}
        if name in ("where", "minimum", "maximum"):
            choice, one, other = args if name == "where" else (self._choice(name, *args), *args)
            a, b = known.get(one, {}), known.get(other, {})
            for key in dict.fromkeys([*a, *b]):
                parts = a.get(key, self.zero), b.get(key, self.zero)
                total[key] = self.add("where", choice, *parts)
            return {k: d for k, d in total.items() if d != self.zero}
        for place, arg in enumerate(args[:1] if name == "interp" else args):
            inner = known.get(arg, {})
            if not inner:
                continue
            partial = self._partial(name, node, args, place)
            for key, d in inner.items():
                term = self.add("multiply", partial, d)
                total[key] = self.add("add", total[key], term) if key in total else term
        return {k: d for k, d in total.items() if d != self.zero}

    def _choice(self, name: str, a: Node, b: Node) -> Node:
        return self.add("less_equal", *((a, b) if name == "minimum" else (b, a)))

    def _partial(self, name: str, node: Node, args: tuple[Node, ...], place: int) -> Node:
        """Derivative of an operation by one of its arguments."""
        do, one = self.add, self.one
        a = args[0]
        if name == "add":
            return one
        if name == "subtract":
            return one if place == 0 else self.constant(-1.0)
        if name == "multiply":
            return args[1 - place]
        if name == "divide":
            own = do("divide", one, args[1])
            return own if place == 0 else do("negative", do("multiply", node, own))
        if name == "power":
            if place == 0:
                rest = do("power", a, do("subtract", args[1], one))
                return do("multiply", args[1], self._finite(a, rest))
            return do(
                "where", do("less", self.zero, a), do("multiply", node, do("log", a)), self.zero
            )
        if name == "sqrt":
            return self._finite(a, do("divide", self.constant(0.5), node))
        if name == "arctan2":
            square = do("add", *(do("multiply", v, v) for v in args))
            own = do("divide", args[1 - place], square)
            return own if place == 0 else do("negative", own)
        if name == "interp":
            return do("slope", a, args[1])
        square = do("multiply", a, a)
        if name in ("arcsin", "arccos"):
            own = do("divide", one, do("sqrt", do("subtract", one, square)))
            return own if name == "arcsin" else do("negative", own)
        if name in ("tan", "tanh"):
            return do("add" if name == "tan" else "subtract", one, do("multiply", node, node))
        return {
            "negative": lambda: self.constant(-1.0),
            "absolute": lambda: do("sign", a),
            "exp": lambda: node,
            "log": lambda: do("divide", one, a),
            "sin": lambda: do("cos", a),
            "cos": lambda: do("negative", do("sin", a)),
            "arctan": lambda: do("divide", one, do("add", one, square)),
            "sinh": lambda: do("cosh", a),
            "cosh": lambda: do("sinh", a),
            "expm1": lambda: do("exp", a),
            "log1p": lambda: do("divide", one, do("add", one, a)),
        }[name]()

    def _finite(self, a: Node, partial: Node) -> Node:
        """A partial derivative that may be infinite at zero; there, it counts as zero."""
        return self.add("where", self.add("equal", a, self.zero), self.zero, partial)


def _needed(nodes: Sequence[tuple[Any, ...]], targets: Iterable[Node]) -> set[Node]:
    """Nodes on which some nodes depend, and these."""
    found: set[Node] = set()
    waiting = list(targets)
    while waiting:
        node = waiting.pop()
        if node in found:
            continue
        found.add(node)
        name, *args = nodes[node]
        if name not in ("input", "constant"):
            waiting += args[:1] if name in ("interp", "slope") else args
    return found


# ----------------------------------------------------------------------------------------- symbols


def _recorded(name: str, *args: Any) -> Any:
    """Result of an operation of which at least one argument is a symbol."""
    if name in _COMPOSED:
        return _COMPOSED[name](*args)
    tape: Tape = next(a.tape for a in args if isinstance(a, Symbol))
    if name not in _CODE:
        tape.refuse(f"np.{name} cannot be traced")
    return Symbol(tape, tape.add(name, *map(tape.of, args), exact=True))


def _operator(name: str, swap: bool = False) -> Callable[[Symbol, Any], Any]:
    def of(self: Symbol, other: Any) -> Any:
        if isinstance(other, np.ndarray) and other.ndim:
            return NotImplemented  # the array applies the operator to each of its elements
        return _recorded(name, *((other, self) if swap else (self, other)))

    return of


def _method(name: str) -> Callable[[Symbol], Any]:
    return lambda self: _recorded(name, self)


def _refusal(what: str) -> Callable[[Symbol], NoReturn]:
    def refuse(symbol: Symbol) -> NoReturn:
        symbol.tape.refuse(what)

    return refuse


class Symbol:
    """A quantity whose operations are recorded."""

    __slots__ = ("node", "tape")
    shape = ()
    ndim = 0
    size = 1

    def __init__(self, tape: Tape, node: Node):
        self.tape, self.node = tape, node

    def __array_ufunc__(self, ufunc: Any, method: str, *args: Any, **options: Any) -> Any:
        if method != "__call__" or options:
            self.tape.refuse(f"np.{ufunc.__name__}.{method} of a value, or with an option")
        if any(isinstance(a, np.ndarray) and a.ndim for a in args):
            each = np.frompyfunc(ufunc, len(args), 1)
            return each(*(np.asarray(a, dtype=object) for a in args))
        return _recorded(ufunc.__name__, *args)

    def __array_function__(self, func: Any, types: Any, args: Any, options: Any) -> Any:
        if func.__name__ not in _ARRAY_FUNCTIONS:
            self.tape.refuse(f"np.{func.__name__} cannot be traced")
        return _ARRAY_FUNCTIONS[func.__name__](*args, **options)

    def __bool__(self) -> bool:
        return self.tape.asked(self.node)

    __float__ = _refusal(
        "a number of Python is needed, as by functions of math, or by an array of numbers"
    )
    __int__ = __index__ = __complex__ = __float__

    def copy(self) -> Symbol:
        """Itself: symbols do not change."""
        return self

    def clip(self, *args: Any, **options: Any) -> Any:
        """As ``np.clip``."""
        return _clip(self, *args, **options)

    __add__, __radd__ = _operator("add"), _operator("add", True)
    __sub__, __rsub__ = _operator("subtract"), _operator("subtract", True)
    __mul__, __rmul__ = _operator("multiply"), _operator("multiply", True)
    __truediv__, __rtruediv__ = _operator("divide"), _operator("divide", True)
    __pow__, __rpow__ = _operator("power"), _operator("power", True)
    __mod__, __rmod__ = _operator("remainder"), _operator("remainder", True)
    __floordiv__, __rfloordiv__ = _operator("floor_divide"), _operator("floor_divide", True)
    __and__, __rand__ = _operator("logical_and"), _operator("logical_and", True)
    __or__, __ror__ = _operator("logical_or"), _operator("logical_or", True)
    __xor__, __rxor__ = _operator("logical_xor"), _operator("logical_xor", True)
    __lt__, __gt__ = _operator("less"), _operator("greater")
    __le__, __ge__ = _operator("less_equal"), _operator("greater_equal")
    __eq__, __ne__ = _operator("equal"), _operator("not_equal")
    __neg__, __pos__, __abs__ = _method("negative"), _method("positive"), _method("absolute")
    __invert__ = _method("logical_not")
    # NumPy calls these methods of the elements of an array of objects.
    sin, cos, tan, arctan = map(_method, ("sin", "cos", "tan", "arctan"))
    exp, log, sqrt, square = map(_method, ("exp", "log", "sqrt", "square"))
    tanh, sinh, cosh, sign = map(_method, ("tanh", "sinh", "cosh", "sign"))


def _clip(a: Any, a_min: Any = None, a_max: Any = None, *, min: Any = None, max: Any = None) -> Any:
    lower, upper = (a_min if min is None else min), (a_max if max is None else max)
    a = a if lower is None else np.maximum(a, lower)
    return a if upper is None else np.minimum(a, upper)


def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None) -> Any:
    tape = next(v.tape for v in (x, *np.ravel(xp), *np.ravel(fp)) if isinstance(v, Symbol))
    if left is not None or right is not None or not isinstance(x, Symbol):
        tape.refuse("np.interp with a table of values, or with left= or right=")
    if np.size(xp) < 2 or np.size(xp) != np.size(fp) or not np.all(np.diff(xp) > 0.0):
        tape.refuse("np.interp with a table that does not grow")
    return Symbol(x.tape, x.tape.add("interp", x.node, x.tape.table(xp, fp)))


def _truth(value: Any) -> Any:
    """1 for true, 0 for false."""
    return 1.0 - np.equal(value, 0.0)


def _arcsinh(a: Any) -> Any:
    """By log1p, which keeps the digits of small numbers."""
    size = np.absolute(a)
    return np.sign(a) * np.log1p(size + size * size / (1.0 + np.sqrt(size * size + 1.0)))


def _halves(a: Any) -> tuple[Any, Any]:
    """A number as a sum of two with half of its digits (Veltkamp)."""
    shifted = 134217729.0 * a
    high = shifted - (shifted - a)
    return high, a - high


def _divided(a: Any, b: Any) -> tuple[Any, Any]:
    """Whole quotient and remainder; the product of both is exact (Dekker), as in NumPy."""
    q = np.floor(a / b)
    product = q * b
    (q1, q2), (b1, b2) = _halves(q), _halves(b)
    lost = ((q1 * b1 - product) + q1 * b2 + q2 * b1) + q2 * b2
    rest = (a - product) - lost
    over = 1.0 * np.less_equal(np.absolute(b), np.absolute(rest)) * np.less_equal(0.0, rest * b)
    under = 1.0 * np.less(rest * b, 0.0)
    return q + over - under, rest + (under - over) * b


_COMPOSED: dict[str, Callable[..., Any]] = {
    "greater": lambda a, b: np.less(b, a),
    "greater_equal": lambda a, b: np.less_equal(b, a),
    "not_equal": lambda a, b: 1.0 - np.equal(a, b),
    "logical_not": lambda a: np.equal(a, 0.0),
    "logical_and": lambda a, b: _truth(a) * _truth(b),
    "logical_or": lambda a, b: _truth(_truth(a) + _truth(b)),
    "logical_xor": lambda a, b: 1.0 - np.equal(_truth(a), _truth(b)),
    "square": lambda a: a * a,
    "reciprocal": lambda a: 1.0 / a,
    "positive": lambda a: a,
    "fabs": np.absolute,
    "float_power": np.power,
    "hypot": lambda a, b: np.sqrt(a * a + b * b),
    "exp2": lambda a: np.power(2.0, a),
    "cbrt": lambda a: np.sign(a) * np.power(np.absolute(a), 1.0 / 3.0),
    "log2": lambda a: np.log(a) / math.log(2.0),
    "log10": lambda a: np.log(a) / math.log(10.0),
    "arcsinh": _arcsinh,
    "arctanh": lambda a: 0.5 * (np.log1p(a) - np.log1p(-a)),
    "degrees": lambda a: a * (180.0 / math.pi),
    "radians": lambda a: a * (math.pi / 180.0),
    "ceil": lambda a: -np.floor(-a),
    "floor_divide": lambda a, b: _divided(a, b)[0],
    "remainder": lambda a, b: _divided(a, b)[1],
    "heaviside": lambda a, b: np.where(np.equal(a, 0.0), b, np.less(0.0, a)),
    "copysign": lambda a, b: np.absolute(a) * (1.0 - 2.0 * np.less(b, 0.0)),
    "isnan": lambda a: 1.0 - np.equal(a, a),
    "isfinite": lambda a: np.equal(a - a, 0.0),
}
_COMPOSED |= {
    other: _COMPOSED[name]
    for other, name in (
        ("invert", "logical_not"), ("bitwise_and", "logical_and"), ("bitwise_or", "logical_or"),
        ("bitwise_xor", "logical_xor"), ("rad2deg", "degrees"), ("deg2rad", "radians"),
    )
}  # fmt: skip

_ARRAY_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "where": lambda condition, a, b: _recorded("where", condition, a, b),
    "clip": _clip,
    "interp": _interp,
    "zeros_like": lambda _: 0.0,
    "ones_like": lambda _: 1.0,
    "full_like": lambda _, value: value,
    "shape": lambda _: (),
    "ndim": lambda _: 0,
    "size": lambda _: 1,
    "iscomplexobj": lambda _: False,
    "real": lambda a: a,
    "copy": lambda a: a,
}


# --------------------------------------------------------------------------------------- fragments


@dataclass(frozen=True)
class Fragment:
    """The part of a tape that computes some targets, with registers of its own.

    The first registers are its inputs, then its constants, then one per operation.
    """

    inputs: tuple[Any, ...]
    constants: Array
    operations: Code
    """(code, first, second and third argument), (m, 4); a table is the second argument."""
    moving: NDArray[np.bool_]
    """Whether an operation depends on more than constants of a job, (m,)."""
    tables: tuple[Array, ...]
    targets: dict[Target, int]
    """Registers of the targets; one that is absent is zero."""


#: Inputs that are constant over a simulation, by the first word of their keys.
STEADY = ("p", "size", "shape")


@dataclass
class Traced:
    """What a function returned, with derivatives by all inputs."""

    tape: Tape
    values: dict[Any, Node]
    """Nodes by target."""
    jumps: bool = False
    """Whether it may jump, so that its derivatives must be tested."""
    _slopes: dict[Node, dict[Any, Node]] | None = None
    _fragments: dict[frozenset[Target], Fragment] = field(default_factory=dict)

    @classmethod
    def of(cls, tape: Tape, nodes: dict[Any, Node]) -> Traced:
        """From nodes by target."""
        jumps = any(tape.nodes[n][0] in _JUMPS for n in _needed(tape.nodes, nodes.values()))
        return cls(tape, nodes, jumps)

    @property
    def slopes(self) -> dict[Node, dict[Any, Node]]:
        """Derivatives of the values."""
        if self._slopes is None:
            self._slopes = self.tape.derivatives(self.values.values())
        return self._slopes

    def keys(self, target: Any) -> tuple[Any, ...]:
        """Inputs by which a target has a derivative."""
        return tuple(self.slopes.get(self.values[target], {}))

    def depends(self, targets: Iterable[Target], key: Any) -> bool:
        """Whether targets depend on an input."""
        nodes = [n for t in targets if (n := self._place(t)) is not None]
        return any(self.tape.nodes[n] == ("input", key) for n in _needed(self.tape.nodes, nodes))

    def _place(self, target: Target) -> Node | None:
        value = self.values[target[0]]
        return value if target[1] is None else self.slopes.get(value, {}).get(target[1])

    def fragment(self, targets: Iterable[Target]) -> Fragment:
        """The operations for some targets."""
        wanted = frozenset(targets)
        if wanted not in self._fragments:
            self._fragments[wanted] = self._cut(wanted)
        return self._fragments[wanted]

    def _cut(self, targets: frozenset[Target]) -> Fragment:
        nodes = self.tape.nodes
        places = {t: n for t in targets if (n := self._place(t)) is not None}
        order = sorted(_needed(nodes, places.values()))
        inputs = [n for n in order if nodes[n][0] == "input"]
        constants = [n for n in order if nodes[n][0] == "constant"]
        rest = [n for n in order if nodes[n][0] not in ("input", "constant")]
        register = {n: i for i, n in enumerate([*inputs, *constants, *rest])}
        moving = {n: nodes[n][1][0] not in STEADY for n in inputs}
        rows = np.zeros((len(rest), 4), dtype=np.int32)
        for row, n in zip(rows, rest, strict=True):
            name, *args = nodes[n]
            tables = args[1:] if name in ("interp", "slope") else []
            args = args[:1] if tables else args
            own = [*(register[a] for a in args), *tables]
            row[: 1 + len(own)] = [_CODE[name], *own]
            moving[n] = any(moving.get(a, False) for a in args)
        return Fragment(
            inputs=tuple(nodes[n][1] for n in inputs),
            constants=np.array([self.tape.value(n) for n in constants], dtype=np.float64),
            operations=rows,
            moving=np.array([moving[n] for n in rest], dtype=bool),
            tables=tuple(self.tape.tables),
            targets={t: register[n] for t, n in sorted(places.items(), key=lambda i: repr(i[0]))},
        )
