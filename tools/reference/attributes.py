"""Docstrings of the fields of a class, which Python itself does not store."""

from __future__ import annotations

import ast
import functools
import itertools
import sys
from pathlib import Path


@functools.cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Classes of a module by name."""
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None or not file.endswith(".py"):
        return {}
    tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    return {node.name: node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}


def field_texts(cls: type) -> dict[str, str]:
    """Field -> its docstring, own fields before inherited ones."""
    found: dict[str, str] = {}
    for base in cls.__mro__:
        if not base.__module__.startswith("feltmb"):
            continue
        node = _classes(base.__module__).get(base.__name__)
        body = node.body if node is not None else []
        for field, below in itertools.pairwise(body):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(below, ast.Expr)
                and isinstance(below.value, ast.Constant)
                and isinstance(below.value.value, str)
            ):
                found.setdefault(field.target.id, " ".join(below.value.value.split()))
    return found
