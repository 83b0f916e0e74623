"""Texts below the fields of a class, which Python itself forgets."""

from __future__ import annotations

import ast
import inspect
import textwrap


def field_texts(cls: type) -> dict[str, str]:
    """Field -> the text below it, own fields before inherited ones."""
    found: dict[str, str] = {}
    for base in cls.__mro__:
        try:
            tree = ast.parse(textwrap.dedent(inspect.getsource(base)))
        except (OSError, TypeError):
            continue
        body = tree.body[0]
        if not isinstance(body, ast.ClassDef):
            continue
        for node, below in zip(body.body, body.body[1:], strict=False):
            if (
                isinstance(node, ast.AnnAssign)
                and isinstance(node.target, ast.Name)
                and isinstance(below, ast.Expr)
                and isinstance(below.value, ast.Constant)
                and isinstance(below.value.value, str)
            ):
                found.setdefault(node.target.id, " ".join(below.value.value.split()))
    return found
