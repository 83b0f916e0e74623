"""Checks arguments of public functions by their annotations, with messages of one form.

``@checked`` is a decorator of a public function or class. It reads the annotations as text when the
function is first called, so that their types need not be imported. Numbers are in SI units and not
texts: ``duration="300 ms"`` is rejected, and the message states the correct form.
"""

from __future__ import annotations

import ast
import functools
import inspect
import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sized
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from unmodeled.errors import InvalidParameter, shown

T = TypeVar("T")

#: Annotation of a number that need not be finite.
AnyNumber = Annotated[float, "any"]

#: Function of a value and its place that returns the checked value or raises ``_Refused``.
Check = Callable[[Any, str], Any]


class _Refused(Exception):
    """An invalid value: its place, the value, and the expectation."""


@dataclass(frozen=True)
class _Kind:
    """Check that belongs to an annotation."""

    text: str
    check: Check


def checked(target: T) -> T:
    """Check the arguments of a function, or of the public methods of a class, by annotations.

    A ``float``, and each element of a ``Sequence[float]``, must be finite unless the default of the
    parameter is not, or its annotation is ``AnyNumber``. An ``int`` must not be negative. The value
    of an ``Array`` is converted to an array. The call raises
    :class:`~unmodeled.errors.InvalidParameter` with function, argument, value and expectation; a
    missing or unknown argument raises Python's ``TypeError``. Methods of a class that are marked by
    :func:`unchecked` are left as they are.
    """
    if not isinstance(target, type):
        wrapped: T = _wrapped(target)
        return wrapped
    for name, member in list(vars(target).items()):
        if (name.startswith("_") and name != "__init__") or hasattr(member, "__unchecked__"):
            continue
        if inspect.isfunction(member):
            setattr(target, name, _wrapped(member))
        elif isinstance(member, (classmethod, staticmethod)):
            setattr(target, name, type(member)(_wrapped(member.__func__)))
    return target


def unchecked(method: T) -> T:
    """Mark a method that is called at each step: its arguments are not checked."""
    method.__unchecked__ = True  # type: ignore[attr-defined]
    return method


def _wrapped(function: Any) -> Any:
    @functools.cache
    def checks() -> _Checks:
        return _Checks(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        args, kwargs = checks().apply(args, kwargs)
        return function(*args, **kwargs)

    call.__checks__ = checks  # type: ignore[attr-defined]
    return call


class _Checks:
    """The checks of one function."""

    def __init__(self, function: Any):
        self.function = function
        self.names: dict[str, Check | None] = {}
        self.positions: list[tuple[str, Check | None]] = []
        self.rest: tuple[str, Check | None] = ("", None)
        self.more: Check | None = None
        self.unknown: set[str] = set()  # names that are neither classes nor aliases of the module
        for name, parameter in inspect.signature(function).parameters.items():
            check = self._check(parameter)
            if parameter.kind is parameter.VAR_POSITIONAL:
                self.rest = (name, check)
            elif parameter.kind is parameter.VAR_KEYWORD:
                self.more = check
            else:
                self.names[name] = check
                if parameter.kind is not parameter.KEYWORD_ONLY:
                    self.positions.append((name, check))

    def _check(self, parameter: inspect.Parameter) -> Check | None:
        annotation = parameter.annotation
        if annotation is parameter.empty:
            return None
        text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
        default = parameter.default
        finite = not (isinstance(default, float) and not math.isfinite(default))
        kind = self._kind(ast.parse(text, mode="eval").body, finite)
        return kind.check if kind is not None else None

    def apply(
        self, args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments after the checks and conversions."""
        try:
            known = len(self.positions)
            checked_args = [
                value if check is None else check(value, name)
                for value, (name, check) in zip(args, self.positions, strict=False)
            ]
            name, check = self.rest
            for i, value in enumerate(args[known:]):
                checked_args.append(value if check is None else check(value, f"{name}[{i}]"))
            for name, value in kwargs.items():
                check = self.names.get(name, self.more)
                if check is not None:
                    kwargs[name] = check(value, name)
        except _Refused as refused:
            where, value, expected = refused.args
            raise InvalidParameter(
                f"{self._title()}: {where}: got {shown(value)}, expected {expected}"
                f"{_hint(where, value, expected)}"
            ) from None
        return tuple(checked_args), kwargs

    def _title(self) -> str:
        return str(self.function.__qualname__).removesuffix(".__init__")

    def _kind(self, node: ast.expr, finite: bool = True) -> _Kind | None:
        """Check for an annotation; None if any value is permitted."""
        if isinstance(node, ast.BinOp):  # X | Y
            return _union([self._kind(node.left, finite), self._kind(node.right, finite)])
        if isinstance(node, ast.Constant):
            if node.value is None:
                return _Kind("None", _none)
            return self._kind(ast.parse(str(node.value), mode="eval").body, finite)
        inner: list[ast.expr] = []
        if isinstance(node, ast.Subscript):
            inner = list(node.slice.elts) if isinstance(node.slice, ast.Tuple) else [node.slice]
            node = node.value
        name = node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")
        if name == "float":
            return _FINITE if finite else _NUMBER
        if name == "Literal":
            return _literal([ast.literal_eval(item) for item in inner])
        if name == "Annotated":
            return self._kind(inner[0], finite and ast.unparse(inner[1]) != "'any'")
        return _PLAIN[name] if name in _PLAIN else self._composed(name, inner, finite)

    def _composed(self, name: str, inner: list[ast.expr], finite: bool) -> _Kind | None:
        """Check for a type that is made of others, or for a class."""
        if name in ("Union", "Optional"):
            kinds = [self._kind(item, finite) for item in inner]
            return _union([*kinds, _Kind("None", _none)] if name == "Optional" else kinds)
        if name in ("Mapping", "dict"):
            return _mapping([self._kind(item) for item in inner])
        if name in ("Sequence", "Iterable", "list", "tuple"):
            fixed = name == "tuple" and not (inner and isinstance(inner[-1], ast.Constant))
            items = [self._kind(item) for item in inner if not isinstance(item, ast.Constant)]
            return _sequence(items, name, fixed)
        return self._named(name)

    def _named(self, name: str) -> _Kind | None:
        """A class or an alias, of the function's module or known by its name."""
        known = self.function.__globals__.get(name)
        if isinstance(known, TypeVar):
            if known.__bound__ is None:
                return None  # any value
            known = known.__bound__
        if isinstance(known, type) and getattr(known, "_is_protocol", False):
            parts = [part for part in vars(known) if not part.startswith("_")]
            return _instance(known.__name__, lambda value: all(hasattr(value, p) for p in parts))
        if isinstance(known, type):
            return _instance(known.__name__, lambda value: isinstance(value, known))
        if known is not None:
            return self._kind(ast.parse(repr(known), mode="eval").body)
        self.unknown.add(name)
        return _instance(name, lambda value: any(c.__name__ == name for c in type(value).__mro__))


#: Functions that give the number in SI units that a text means, or None. ``unmodeled.units`` adds
#: one: its own functions are checked, and cannot be imported here.
text_readers: list[Callable[[str], float | None]] = []


def _hint(where: str, value: object, expected: str) -> str:
    if isinstance(value, str) and expected.startswith("a sequence") and where.isidentifier():
        if "numbers" not in expected:
            return f"; write {where}=[{shown(value)}]"
    elif isinstance(value, str) and "number" in expected:
        for read in text_readers:
            if (number := read(value)) is not None:
                return f"; numbers are SI without a unit, write {number:.12g}"
    return ""


def _none(value: Any, where: str) -> Any:
    if value is not None:
        raise _Refused(where, value, "None")
    return value


def _union(kinds: list[_Kind | None]) -> _Kind | None:
    parts = [kind for kind in kinds if kind is not None]
    if len(parts) < len(kinds):
        return None
    text = " or ".join(kind.text for kind in parts)

    def check(value: Any, where: str) -> Any:
        inside = None
        for kind in parts:
            try:
                return kind.check(value, where)
            except _Refused as refused:
                if refused.args[0] != where:  # the right type, but with a fault
                    inside = refused
        raise inside or _Refused(where, value, text)

    return _Kind(text, check)


def _is_flag(value: object) -> bool:
    return isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")


def _as_float(value: Any, where: str, text: str) -> Any:
    real = isinstance(value, numbers.Real)
    if not real and getattr(value, "shape", None) == ():  # an array with one number
        real = getattr(getattr(value, "dtype", None), "kind", "") in "iuf"
    if not real or _is_flag(value):
        raise _Refused(where, value, text)
    try:
        number = float(value)
    except (OverflowError, ValueError):
        raise _Refused(where, value, f"{text} that a float can hold") from None
    return value if type(value) is int else number


def _any_number(value: Any, where: str) -> Any:
    return value if type(value) is float else _as_float(value, where, "a number")


def _finite(value: Any, where: str) -> Any:
    number = value if type(value) is float else _as_float(value, where, "a finite number")
    if not math.isfinite(number):
        raise _Refused(where, value, "a finite number")
    return number


def _whole(value: Any, where: str) -> Any:
    given = value
    if type(value) is not int:
        number = _as_float(value, where, "a whole number")
        if not (math.isfinite(number) and number == int(number)):
            raise _Refused(where, value, "a whole number")
        value = int(value)
    if not 0 <= value < 2**63:
        raise _Refused(where, given, "a whole number >= 0, below 2^63")
    return value


def _text(value: Any, where: str) -> Any:
    if not isinstance(value, str):
        raise _Refused(where, value, "a text")
    if "\0" in value:  # neither a name nor a path may contain it
        raise _Refused(where, value, "a text without a zero character")
    try:
        value.encode()
    except UnicodeEncodeError:  # half a surrogate pair
        raise _Refused(where, value, "a text of valid Unicode") from None
    return value


def _flag(value: Any, where: str) -> Any:
    if not _is_flag(value):
        raise _Refused(where, value, "True or False")
    return bool(value)


def _path(value: Any, where: str) -> Any:
    if not isinstance(value, os.PathLike):
        raise _Refused(where, value, "a path")
    if "\0" in os.fsdecode(value):
        raise _Refused(where, value, "a path without a zero character")
    return value


def _callable(value: Any, where: str) -> Any:
    if not callable(value):
        raise _Refused(where, value, "a function")
    return value


def _as_array(value: Any, where: str, kinds: str = "fiub") -> Any:
    import numpy as np

    try:
        array = np.asarray(value)
    except Exception:  # rows of different lengths, or an object that cannot be converted
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in kinds and not (array.size == 0 and array.dtype.kind == "f"):
        words = "numbers" if "f" in kinds else "whole numbers"
        raise _Refused(where, value, f"{words}, as an array or a list")
    return array


def _array_like(value: Any, where: str) -> Any:
    _as_array(value, where)
    return value


def _array(value: Any, where: str) -> Any:
    array = _as_array(value, where)
    if array.ndim == 0:
        raise _Refused(where, value, "an array of numbers")
    return array


def _indices(value: Any, where: str) -> Any:
    array = _as_array(value, where, "iu")
    if array.ndim == 0:
        raise _Refused(where, value, "an array of whole numbers")
    return array


_ANY = _Kind("any value", lambda value, _: value)
_NUMBER = _Kind("a number", _any_number)
_FINITE = _Kind("a finite number", _finite)
_ARRAY = _Kind("an array of numbers", _array)
_PLAIN: dict[str, _Kind | None] = {
    "int": _Kind("a whole number >= 0", _whole),
    "str": _Kind("a text", _text),
    "bool": _Kind("True or False", _flag),
    "Path": _Kind("a path", _path),
    "Callable": _Kind("a function", _callable),
    "None": _Kind("None", _none),
    "NoneType": _Kind("None", _none),
    "Any": None,
    "object": None,
    "Self": None,
    "ArrayLike": _Kind("a number or an array", _array_like),
    "Integers": _Kind("an array of whole numbers", _indices),
    **dict.fromkeys(("Array", "NDArray", "ndarray"), _ARRAY),
}


def _literal(values: list[Any]) -> _Kind:
    text = ", ".join(map(repr, values))

    def check(value: Any, where: str) -> Any:
        if not any(type(value) is type(v) and value == v for v in values):
            raise _Refused(where, value, f"one of {text}" if len(values) > 1 else text)
        return value

    return _Kind(text, check)


def _instance(name: str, fits: Callable[[Any], bool]) -> _Kind:
    text = f"{'an' if name[:1] in 'AEIOU' else 'a'} {name}"

    def check(value: Any, where: str) -> Any:
        if not fits(value):
            raise _Refused(where, value, text)
        return value

    return _Kind(text, check)


def _mapping(kinds: list[_Kind | None]) -> _Kind:
    key, item = kinds if len(kinds) == 2 else (None, None)

    def check(value: Any, where: str) -> Any:
        if not isinstance(value, Mapping):
            raise _Refused(where, value, "a mapping")
        if key is None and item is None:
            return value
        pairs = list(value.items())  # another thread may add to it
        try:
            for name, inner in pairs:
                if key is not None:
                    key.check(name, where)
                if item is not None:
                    item.check(inner, where)
        except _Refused:
            for name, inner in pairs:  # which of them
                if key is not None:
                    key.check(name, f"{where}: key")
                if item is not None:
                    item.check(inner, f"{where}[{shown(name)}]")
            raise
        return value

    return _Kind("a mapping", check)


def _sequence(kinds: list[_Kind | None], name: str, fixed: bool) -> _Kind:
    numeric = len(kinds) == 1 and kinds[0] in (_FINITE, _NUMBER) and not fixed
    text = f"{len(kinds)} values" if fixed else "a sequence of numbers" if numeric else "a sequence"

    def check(value: Any, where: str) -> Any:
        if isinstance(value, Mapping) and name == "Iterable":
            value = tuple(value)
        items = _items(value, where, text)
        if numeric:
            _check_numbers(items, value, where, finite=kinds[0] is _FINITE)
        elif fixed and kinds and len(items) != len(kinds):
            raise _Refused(where, value, text)
        elif any(kinds):
            items = _checked_items(items, kinds if fixed else kinds * len(items), where)
        return tuple(items) if name == "tuple" else items

    return _Kind(text, check)


def _check_numbers(items: Any, value: Any, where: str, *, finite: bool) -> None:
    array = _as_array(items, where)
    if array.ndim != 1:
        raise _Refused(where, value, "a sequence of numbers")
    for i, number in enumerate(array.tolist() if finite else ()):
        _finite(number, f"{where}[{i}]")


def _checked_items(items: Any, kinds: list[_Kind | None], where: str) -> Any:
    """Items after their checks; a list to which the function appends remains the caller's."""
    pairs = [(v, _ANY if kind is None else kind) for v, kind in zip(items, kinds, strict=False)]
    try:
        after = [kind.check(v, where) for v, kind in pairs]
    except _Refused:
        for i, (inner, kind) in enumerate(pairs):  # which of them
            kind.check(inner, f"{where}[{i}]")
        raise
    same = all(new is old for new, old in zip(after, items, strict=False))
    return items if same and isinstance(items, list) else after


def _items(value: Any, where: str, text: str) -> Any:
    """A sequence that can be read more than once; not a text or a mapping."""
    if isinstance(value, (list, tuple)):
        return value
    if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Iterable):
        raise _Refused(where, value, text)
    try:
        return value if isinstance(value, Sized) and len(value) >= 0 else tuple(value)
    except TypeError:  # an array with one number
        raise _Refused(where, value, text) from None
