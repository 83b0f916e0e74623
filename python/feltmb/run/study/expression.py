"""Formulas and units in study files: arithmetic with named values, without other operations.

``hammer_tip.x - hammer_tip_rigid.x``, ``rebound_speed / impact_speed`` and
``check_gap(rigid, piano) < check_gap(flexible, piano)`` are formulas. Python's parser parses them,
and they are evaluated node by node, so that a file can compute but do nothing else.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from feltmb.errors import InvalidParameter
from feltmb.units import conversion_factor

__all__ = ["Formula", "NotThere", "si_unit", "to_unit"]

LONGEST = 2000  # characters

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "atan2": np.arctan2,
}


class NotThere(Exception):
    """A value or an output in a formula does not exist in a run."""


Lookup = Callable[[str, tuple[Any, ...] | None], Any]


def _dotted(tree: ast.AST) -> str | None:
    """``a.b.c`` as text."""
    parts: list[str] = []
    node = tree
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return None
    return ".".join([node.id, *reversed(parts)])


class Formula:
    """A parsed formula.

    Parameters
    ----------
    text
        Numbers, names with dots, ``+ - * / **``, comparisons, ``and or not``, parentheses,
        ``abs sqrt exp log sin cos atan2 min max``, and calls ``name(word, word, 3.0)`` of names
        that the caller defines.

    Raises
    ------
    InvalidParameter
        The text is not such a formula.
    """

    def __init__(self, text: str):
        self.text = text
        if len(text) > LONGEST:
            raise InvalidParameter(f"formula: {len(text)} characters; the limit is {LONGEST}")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
            self._check(self._tree)
        except SyntaxError as error:
            raise InvalidParameter(f"formula {text!r}: {error.msg}") from None
        except InvalidParameter:
            raise
        except (RecursionError, MemoryError, ValueError, OverflowError):
            raise InvalidParameter(f"formula {text[:60]!r}...: is no formula") from None

    def __repr__(self) -> str:
        return f"Formula({self.text!r})"

    def _refuse(self, node: ast.AST) -> InvalidParameter:
        shown = ast.unparse(node)
        return InvalidParameter(
            f"formula {self.text!r}: {shown!r} is not allowed; use numbers, names, + - * / **, "
            f"comparisons, and, or, not, min, max, {', '.join(_FUNCTIONS)}"
        )

    def _check(self, node: ast.AST) -> None:
        if isinstance(node, ast.Constant):
            if isinstance(node.value, bool) or not isinstance(node.value, (int, float)):
                raise self._refuse(node)
        elif isinstance(node, (ast.Name, ast.Attribute)):
            if _dotted(node) is None:
                raise self._refuse(node)
        elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
            self._check(node.left)
            self._check(node.right)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd, ast.Not)):
            self._check(node.operand)
        elif isinstance(node, ast.Compare) and all(type(o) in _COMPARE for o in node.ops):
            for child in (node.left, *node.comparators):
                self._check(child)
        elif isinstance(node, ast.BoolOp):
            for child in node.values:
                self._check(child)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            if node.func.id in _FUNCTIONS or node.func.id in ("min", "max"):
                if not node.args:
                    raise self._refuse(node)
                for child in node.args:
                    self._check(child)
            else:
                for child in node.args:
                    if self._word(child) is None:
                        raise self._refuse(node)
        else:
            raise self._refuse(node)

    @staticmethod
    def _word(node: ast.AST) -> str | float | None:
        """Argument of a call: a word, a text or a number."""
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            value = Formula._word(node.operand) if isinstance(node.operand, ast.Constant) else None
            return -value if isinstance(value, float) else None
        if isinstance(node, ast.Constant) and not isinstance(node.value, bool):
            if isinstance(node.value, (int, float)):
                return float(node.value)
            return node.value if isinstance(node.value, str) else None
        return None

    def names(self) -> list[str]:
        """Names of values, each once, in order; names of calls are not included."""
        return list(dict.fromkeys(name for name, args in self._leaves(self._tree) if args is None))

    def calls(self) -> list[tuple[str, tuple[Any, ...]]]:
        """Calls ``name(word, ...)`` in order."""
        return [(name, args) for name, args in self._leaves(self._tree) if args is not None]

    def _leaves(self, node: ast.AST) -> Iterator[tuple[str, tuple[Any, ...] | None]]:
        if isinstance(node, (ast.Name, ast.Attribute)):
            yield str(_dotted(node)), None
        elif isinstance(node, ast.Call):
            assert isinstance(node.func, ast.Name)
            if node.func.id in _FUNCTIONS or node.func.id in ("min", "max"):
                for child in node.args:
                    yield from self._leaves(child)
            else:
                yield node.func.id, tuple(self._word(child) for child in node.args)
        else:
            for inner in ast.iter_child_nodes(node):
                yield from self._leaves(inner)

    def __call__(self, lookup: Lookup) -> Any:
        """Evaluate.

        Parameters
        ----------
        lookup
            ``lookup(name, None)`` for a name, ``lookup(name, arguments)`` for a call; it returns a
            number or an array, or raises :class:`NotThere`.
        """
        try:
            with np.errstate(all="ignore"):
                return self._value(self._tree, lookup)
        except (OverflowError, ZeroDivisionError):
            return float("nan")

    def _value(self, node: ast.AST, lookup: Lookup) -> Any:
        if isinstance(node, ast.Constant):
            # Floats: a tower of integer powers would take forever.
            return float(node.value)  # type: ignore[arg-type]
        if isinstance(node, (ast.Name, ast.Attribute)):
            return lookup(str(_dotted(node)), None)
        if isinstance(node, ast.BinOp):
            left, right = self._value(node.left, lookup), self._value(node.right, lookup)
            return _BINARY[type(node.op)](left, right)
        if isinstance(node, ast.UnaryOp):
            value = self._value(node.operand, lookup)
            if isinstance(node.op, ast.Not):
                return np.logical_not(value)
            return -value if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.Compare):
            left = self._value(node.left, lookup)
            result: Any = True
            for op, child in zip(node.ops, node.comparators, strict=True):
                right = self._value(child, lookup)
                result = np.logical_and(result, _COMPARE[type(op)](left, right))
                left = right
            return result
        if isinstance(node, ast.BoolOp):
            combine = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
            values = [self._value(child, lookup) for child in node.values]
            result = values[0]
            for value in values[1:]:
                result = combine(result, value)
            return result
        assert isinstance(node, ast.Call)
        assert isinstance(node.func, ast.Name)
        name = node.func.id
        if name in ("min", "max"):
            values = [self._value(child, lookup) for child in node.args]
            result = values[0]
            for value in values[1:]:
                result = (np.minimum if name == "min" else np.maximum)(result, value)
            return result
        if name in _FUNCTIONS:
            try:
                return _FUNCTIONS[name](*[self._value(child, lookup) for child in node.args])
            except (TypeError, ValueError) as error:
                raise InvalidParameter(f"formula {self.text!r}: {name}: {error}") from None
        return lookup(name, tuple(self._word(child) for child in node.args))


def si_unit(unit: str) -> str:
    """SI unit of the quantity of a unit."""
    if unit in ("", "1"):
        return "1"
    for si in ("m", "s", "N", "rad", "m/s", "J", "Hz", "kg", "rad/s", "m/s^2", "N m", "Pa", "1"):
        try:
            conversion_factor(unit, si)
        except InvalidParameter:
            continue
        return si
    raise InvalidParameter(f"unit {unit!r} is unknown to studies")


def to_unit(unit: str) -> float:
    """Factor from the SI unit of the same quantity to a unit."""
    return 1.0 if unit in ("", "1") else 1.0 / conversion_factor(unit, si_unit(unit))
