"""Measures the Python of both distributions and fails if a measure became worse without a reason.

    python tools/house.py                  # compares with bench/results/house.json
    python tools/house.py --write          # stores what became better
    python tools/house.py --reason "WHY"   # stores what became worse too, with its reason

Measures, for each of which less is better, except the examples:

- ``lines PACKAGE``: lines of a folder or module below a distribution. ``ROOM`` above the stored
  number is free, so that a small change needs no entry.
- ``complex``: functions and methods above 20 (D to F of radon). ``share above 10``, ``share above
  5``: of all of them. The complexity is that of McCabe as radon counts it: 1, and 1 for each
  ``if``, ``elif``, ``for``, ``while``, ``except``, ``case``, ``assert``, ternary, comprehension and
  condition in it, each further operand of ``and`` or ``or``, and an ``else`` of a loop or ``try``.
  Functions inside belong to the function around them.
- ``unnamed floats``: literals in functions of search, library, fit and report, except ``PLAIN``.
- ``returns FUNCTION:VALUE``: how often a module is entered again when one value is followed, in the
  order of the text, through the calls that receive it, or what is made from it, and through its
  methods, each function once. A call is followed if its name is defined in the module, or imported.
- ``public names``: entries of ``__all__`` of packages and modules.
- ``examples``: public functions and classes with a block Examples, their methods included.

A reason is ``{"measure", "from", "to", "why"}`` in the list ``reasons`` of house.json; it holds
while ``from`` is the stored number. ``--reason`` writes it.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
STORED = Path("bench/results/house.json")
SOURCES = {"unmodeled": "unmodeled/src/unmodeled", "feltmb": "python/feltmb"}
WALKS = (
    ("unmodeled.search.verdict", "judge", "searched"),
    ("unmodeled.diagnosis", "diagnose", "model"),
    ("unmodeled.data.files", "read_record", "path"),
)
#: Growth of a number of lines that needs no reason.
ROOM = 0.02
#: Floats that need no name.
PLAIN = (0.0, 0.5, 1.0, 2.0)
#: A block above this is D, E or F.
COMPLEX = 20

Function = ast.FunctionDef | ast.AsyncFunctionDef
Trees = dict[str, ast.Module]


def sources(root: Path) -> dict[str, Path]:
    """Name and file of each module."""
    found = {}
    for folder in SOURCES.values():
        for path in sorted((root / folder).rglob("*.py")):
            parts = path.relative_to((root / folder).parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def complexity(function: ast.AST) -> int:
    def of(node: ast.AST) -> int:
        match node:
            case ast.If() | ast.IfExp() | ast.ExceptHandler() | ast.Assert():
                return 1
            case ast.For() | ast.AsyncFor() | ast.While() | ast.Try():
                return bool(node.orelse) + (not isinstance(node, ast.Try))
            case ast.comprehension():
                return 1 + len(node.ifs)
            case ast.BoolOp():
                return len(node.values) - 1
            case ast.match_case():
                return not (isinstance(node.pattern, ast.MatchAs) and node.pattern.pattern is None)
        return 0

    return 1 + sum(of(node) for node in ast.walk(function))


def blocks(tree: ast.Module) -> Iterator[Function]:
    """The functions of a module and the methods of its classes."""
    todo: list[ast.AST] = [tree]
    while todo:
        for node in ast.iter_child_nodes(todo.pop()):
            if isinstance(node, Function):
                yield node
            elif not isinstance(node, ast.expr):
                todo.append(node)


def unnamed(tree: ast.Module) -> int:
    return sum(
        isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value not in PLAIN
        for function in blocks(tree)
        for statement in function.body
        for node in ast.walk(statement)
    )


def exported(tree: ast.Module) -> list[str]:
    """The texts in the assignments to ``__all__``."""
    return [
        text.value
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign)
        and "__all__" in ast.unparse(node).split("=")[0]
        and node.value
        for text in ast.walk(node.value)
        if isinstance(text, ast.Constant) and isinstance(text.value, str)
    ]


def has_examples(node: ast.AST) -> bool:
    documented = (Function, ast.ClassDef)
    return any(
        "Examples\n" in (ast.get_docstring(inner) or "")
        for inner in ast.walk(node)
        if isinstance(inner, documented)
    )


class Walk:
    """Follows a value through the calls of a set of modules."""

    def __init__(self, trees: Trees) -> None:
        self.trees = trees
        self.definitions = {
            name: {n.name: n for n in tree.body if isinstance(n, Function | ast.ClassDef)}
            for name, tree in trees.items()
        }
        self.imported = {name: self._imports(name, tree) for name, tree in trees.items()}
        self.seen: set[tuple[str, int, str]] = set()
        self.entered: list[str] = []

    def _imports(self, module: str, tree: ast.Module) -> dict[str, tuple[str, str]]:
        found = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                home = node.module or ""
                if node.level:
                    package = module.split(".")[: -node.level]
                    home = ".".join([*package, *([home] if home else [])])
                found |= {a.asname or a.name: (home, a.name) for a in node.names}
        return found

    def find(self, module: str, name: str) -> tuple[str, Function | ast.ClassDef] | None:
        """The definition of a name, written ``name`` or ``module.name``, and its module."""
        first, _, rest = name.partition(".")
        if rest:
            home, part = self.imported.get(module, {}).get(first, ("", ""))
            target = f"{home}.{part}"
            return self.find(target, rest) if target in self.trees else None
        for _ in range(5):
            if definition := self.definitions.get(module, {}).get(first):
                return module, definition
            module, first = self.imported.get(module, {}).get(first, ("", ""))
        return None

    def follow(self, module: str, function: Function, value: str) -> None:
        if (key := (module, function.lineno, value)) in self.seen:
            return
        self.seen.add(key)
        if self.entered[-1:] != [module]:
            self.entered.append(module)
        names = {value}
        arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
        kind = next((a.annotation for a in arguments if a.arg == value), None)
        for node in in_order(function):
            if isinstance(node, ast.Assign) and mentions(node.value, names):
                names |= {t.id for t in node.targets if isinstance(t, ast.Name)}
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == value:
                self._method(module, kind, node.attr)
            if isinstance(node, ast.Call):
                self._call(module, node, names)

    def _method(self, module: str, kind: ast.expr | None, name: str) -> None:
        for part in ast.walk(kind) if kind else ():
            if isinstance(part, ast.Name) and (found := self.find(module, part.id)):
                home, owner = found
                for inner in owner.body if isinstance(owner, ast.ClassDef) else ():
                    if isinstance(inner, Function) and inner.name == name and inner.args.args:
                        self.follow(home, inner, inner.args.args[0].arg)

    def _call(self, module: str, call: ast.Call, names: set[str]) -> None:
        found = self.find(module, ast.unparse(call.func))
        if found is None or not isinstance(found[1], Function):
            return
        home, callee = found
        places = [a.arg for a in (*callee.args.posonlyargs, *callee.args.args)]
        given = [*zip(places, call.args, strict=False)]
        given += [(k.arg, k.value) for k in call.keywords if k.arg]
        for parameter, argument in given:
            if mentions(argument, names):
                self.follow(home, callee, parameter)

    def returns(self, module: str, function: str, value: str) -> int:
        start = self.find(module, function)
        if start is None or not isinstance(start[1], Function):
            raise SystemExit(f"house.py: no function {function} in {module}; change WALKS")
        self.seen, self.entered = set(), []
        self.follow(start[0], start[1], value)
        return len(self.entered) - len(set(self.entered))


def in_order(node: ast.AST) -> Iterator[ast.AST]:
    for inner in ast.iter_child_nodes(node):
        yield inner
        yield from in_order(inner)


def mentions(node: ast.expr, names: set[str]) -> bool:
    return any(isinstance(inner, ast.Name) and inner.id in names for inner in ast.walk(node))


def measures(root: Path) -> dict[str, float]:
    """Each measure of a tree, by its name."""
    files = sources(root)
    texts = {name: path.read_text("utf-8") for name, path in files.items()}
    trees = {name: ast.parse(text) for name, text in texts.items()}
    found: dict[str, float] = {}
    for name, text in texts.items():
        key = "lines " + ".".join(name.split(".")[:2])
        found[key] = found.get(key, 0) + text.count("\n")
    values = [complexity(block) for tree in trees.values() for block in blocks(tree)]
    found["complex"] = sum(v > COMPLEX for v in values)
    for limit in (10, 5):
        share = 100 * sum(v > limit for v in values) / max(len(values), 1)
        found[f"share above {limit} [%]"] = round(share, 1)
    judged = tuple(
        f"unmodeled.{p}" for p in ("search", "library", "models", "ode", "fit", "report")
    )
    found["unnamed floats"] = sum(unnamed(t) for n, t in trees.items() if n.startswith(judged))
    walk = Walk(trees)
    for module, function, value in WALKS:
        found[f"returns {function}:{value}"] = walk.returns(module, function, value)
    public = {(name.split(".")[0], n) for name, tree in trees.items() for n in exported(tree)}
    found["public names"] = sum(len(exported(tree)) for tree in trees.values())
    found["examples"] = sum(
        (name.split(".")[0], node.name) in public and has_examples(node)
        for name, tree in trees.items()
        for node in tree.body
        if isinstance(node, Function | ast.ClassDef)
    )
    return dict(sorted(found.items()))


def is_worse(measure: str, now: float, limit: float) -> bool:
    if measure == "examples":
        return now < limit
    return now > (math.floor(limit * (1 + ROOM)) if measure.startswith("lines ") else limit)


def is_better(measure: str, now: float, limit: float) -> bool:
    return now > limit if measure == "examples" else now < limit


def worse(now: dict[str, float], stored: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Measure, stored number and number now of what is worse and has no reason."""
    found = []
    for measure in sorted(now.keys() | stored["measures"].keys()):
        value, limit = now.get(measure, 0), stored["measures"].get(measure, 0)
        reasons = [
            r["to"]
            for r in stored["reasons"]
            if (r["measure"], r["from"]) == (measure, limit) and r["why"].strip()
        ]
        if all(is_worse(measure, value, allowed) for allowed in (limit, *reasons)):
            found.append((measure, limit, value))
    return found


def kept(now: dict[str, float], stored: dict[str, Any], reason: str | None) -> dict[str, Any]:
    """What is stored: what is better, and with a reason what is worse."""
    listed = stored["reasons"]
    bad = worse(now, stored) if reason else []
    listed = [*listed, *({"measure": m, "from": f, "to": t, "why": reason} for m, f, t in bad)]
    told = {m for m, _, _ in bad}
    best = dict(now)
    for measure, limit in stored["measures"].items():
        if measure in now and is_better(measure, now[measure], limit):
            # What was paid back needs no reason, and the old one must not allow it again.
            listed = [r for r in listed if r["measure"] != measure]
        elif measure in now and measure not in told:
            best[measure] = limit  # within the room, which does not grow with it
    return {"measures": best, "reasons": listed}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--root", type=Path, default=ROOT, help="tree that is measured")
    parser.add_argument("--write", action="store_true", help="store what became better")
    parser.add_argument("--reason", metavar="WHY", help="store what became worse too")
    options = parser.parse_args()
    path = options.root / STORED
    stored = json.loads(path.read_text("utf-8"))
    now = measures(options.root)
    bad = [] if options.reason and options.reason.strip() else worse(now, stored)
    for measure, limit, value in bad:
        print(f"{measure}: {value:g}, stored {limit:g}")
    if bad:
        print(
            f"{len(bad)} of {len(now)} measures of {STORED} became worse: make them better, or "
            'give the cause: python tools/house.py --reason "WHY"'
        )
        return 1
    if options.write or options.reason:
        text = json.dumps(kept(now, stored, options.reason), indent=1, ensure_ascii=False)
        path.write_text(text + "\n", "utf-8")
    print(f"{len(now)} measures, none worse than {STORED} without a reason")
    return 0


if __name__ == "__main__":
    sys.exit(main())
