"""What functions of the user read beside their arguments: globals, closures, attributes, defaults.

A trace is that of the values at its time. It is made anew when one of them is another.
"""

from __future__ import annotations

import builtins
import dis
import functools
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from unmodeled.ode.calling import installed

#: Largest number of values that are compared; of further ones, only their identity.
MOST = 20_000
_NUMBERS = (bool, int, float, complex, str, bytes, type(None), np.generic)
#: Words of the values of a place: equal words, equal values.
Words = tuple[Any, ...]


def read_by(functions: Iterable[Any]) -> dict[Any, Words]:
    """Values that functions read, by place."""
    reader = _Reader()
    for k, function in enumerate(functions):
        reader.visit((k,), function)
    return reader.found


def changed(now: Mapping[Any, Words], before: Mapping[Any, Words], own: frozenset[Any]) -> bool:
    """Whether functions read other values, but for those at the places that they write."""
    return any(before.get(k) != now.get(k) for k in before.keys() | now.keys() if k not in own)


def written(before: Mapping[Any, Words], after: Mapping[Any, Words]) -> frozenset[Any]:
    """Places whose values differ after calls of the functions."""
    return frozenset(k for k in {*before, *after} if before.get(k) != after.get(k))


@functools.lru_cache(maxsize=1000)
def _names(code: CodeType) -> tuple[frozenset[str], frozenset[str]]:
    """Globals that code reads, and attributes, with those of the functions inside it."""
    read = [
        (i.opname in ("LOAD_GLOBAL", "LOAD_NAME"), str(i.argval))
        for i in dis.get_instructions(code)
        if i.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_ATTR", "LOAD_METHOD", "IMPORT_FROM")
    ]
    own = [frozenset(n for is_global, n in read if is_global == wanted) for wanted in (True, False)]
    inner = [_names(c) for c in code.co_consts if isinstance(c, CodeType)]
    return own[0].union(*(g for g, _ in inner)), own[1].union(*(a for _, a in inner))


@functools.lru_cache(maxsize=1000)
def _is_installed(name: str) -> bool:
    """Whether a module is this package, of the standard library, or installed."""
    root = name.partition(".")[0]
    path = getattr(sys.modules.get(name), "__file__", None)
    return (
        root == "unmodeled"
        or root in sys.stdlib_module_names - {"__main__"}
        or (path is not None and installed(Path(path)))
    )


class _Reader:
    """Walks through what functions refer to, each object once."""

    def __init__(self) -> None:
        self.found: dict[Any, Words] = {}
        self.seen: dict[int, Any] = {}
        """Objects that were visited; they exist as long as their identities are compared."""
        self.left = MOST

    def visit(self, place: Any, value: Any) -> None:
        """Note what a place refers to."""
        words = tuple(self._words(place, value))
        if words:
            self.found[place] = words

    def _words(self, place: Any, value: Any) -> Iterator[Any]:
        if isinstance(value, _NUMBERS):
            yield type(value).__name__, repr(value) if value != value else value
            return
        self.left -= 1
        if id(value) in self.seen or self.left < 0:
            yield id(value)
            return
        self.seen[id(value)] = value
        if isinstance(value, np.ndarray) and value.dtype != object:
            yield value.shape, value.dtype.str, value.tobytes()
        elif isinstance(value, Mapping):
            for k, v in list(value.items()):
                yield from self._words((place, "key"), k)
                yield from self._words((place, "value"), v)
        elif isinstance(value, list | tuple | set | frozenset | np.ndarray):
            yield type(value).__name__, len(value)
            if all(type(v) is float for v in value):
                yield np.array(list(value)).tobytes()
                return
            for v in list(np.ravel(value)) if isinstance(value, np.ndarray) else list(value):
                yield from self._words(place, v)
        elif isinstance(value, ModuleType):
            yield value.__name__
        else:
            yield from self._parts(place, value)

    def _parts(self, place: Any, value: Any) -> Iterator[Any]:
        """Functions and objects: their parts are places of their own."""
        if isinstance(value, FunctionType):
            yield value.__code__
            self._function(place, value)
        elif isinstance(value, MethodType):
            self.visit((place, "function"), value.__func__)
            self.visit((place, "object"), value.__self__)
        elif isinstance(value, functools.partial):
            self.visit((place, "partial"), [value.func, value.args, value.keywords])
        elif hasattr(value, "to_numpy"):
            yield from self._words(place, np.asarray(value.to_numpy()))
        elif isinstance(value, type):
            yield id(value)
            for c in value.__mro__:
                if not _is_installed(c.__module__):
                    self._attributes((place, c.__name__), vars(c))
        elif isinstance(value, property | staticmethod | classmethod):
            of = value.fget if isinstance(value, property) else value.__func__
            self.visit((place, "function"), of)
        else:
            yield id(value)
            self._attributes(place, getattr(value, "__dict__", {}))
            slots = [n for c in type(value).__mro__ for n in getattr(c, "__slots__", ())]
            self._attributes(place, {n: getattr(value, n, None) for n in slots})
            self.visit((place, "class"), type(value))

    def _attributes(self, place: Any, values: Mapping[str, Any]) -> None:
        for name, value in list(values.items()):
            if name == "__call__" or not (name.startswith("__") and name.endswith("__")):
                self.visit((place, name), value)

    def _function(self, place: Any, function: FunctionType) -> None:
        code = function.__code__
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            try:
                self.visit((place, name), cell.cell_contents)
            except ValueError:  # not set yet
                continue
        self.visit((place, "defaults"), [function.__defaults__, function.__kwdefaults__])
        if _is_installed(function.__module__ or ""):
            return
        names, attributes = _names(code)
        for name in names:
            if name not in function.__globals__ or hasattr(builtins, name):
                continue
            value = function.__globals__[name]
            self.visit((place, name), value)
            if isinstance(value, ModuleType) and not _is_installed(value.__name__):
                for inner in attributes:
                    if hasattr(value, inner):
                        self.visit((place, name, inner), getattr(value, inner))
