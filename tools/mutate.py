"""Mutation test: changes a comparison, a constant or a truth value; a test should fail.

    python tools/mutate.py --count 40 --seed 1 SOURCE...

A mutant that no test notices shows a rule without a test. Each one works on a copy of the package,
so that the tree is never changed, in a process that is forked from one with NumPy and pytest. Only
the tests that call the changed function are run, the fastest first, up to a limit of time. Which
they are is measured once, and is kept in ``out/tests_of_functions.json``: delete it after a change
of the tests. Sources: files, or folders of them.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy  # noqa: F401  # so that no fork imports it
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unmodeled" / "src"
SOURCES = ("unmodeled/src/unmodeled/search", "unmodeled/src/unmodeled/report")
TESTS = ("unmodeled/tests",)
KNOWN = ROOT / "out" / "tests_of_functions.json"
#: Comparisons and what they become.
OTHER: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


# ---------------------------------------------------------------- mutants


def _texts(node: ast.AST) -> Iterator[int]:
    """Identities of nodes that decide nothing: annotations, ``strict`` and how a class is made."""
    for n in ast.walk(node):
        if isinstance(n, ast.ClassDef):
            for decorator in n.decorator_list:
                yield from map(id, ast.walk(decorator))
        if isinstance(n, ast.keyword) and n.arg == "strict":
            yield id(n.value)
        if isinstance(n, ast.AnnAssign | ast.arg) and n.annotation is not None:
            yield from map(id, ast.walk(n.annotation))
        if isinstance(n, ast.FunctionDef) and n.returns is not None:
            yield from map(id, ast.walk(n.returns))


def places(tree: ast.AST) -> list[ast.AST]:
    """Nodes that can be changed."""
    out, known = [], {*_texts(tree)}
    for n in ast.walk(tree):
        number = isinstance(n, ast.Constant) and isinstance(n.value, bool | int | float)
        if id(n) not in known and (number or isinstance(n, ast.Compare | ast.BoolOp)):
            out.append(n)
    return out


def change(node: ast.AST) -> None:
    """Change a node: the other comparison, the other truth value, three times a number."""
    if isinstance(node, ast.Compare):
        node.ops[0] = OTHER[type(node.ops[0])]()
    elif isinstance(node, ast.BoolOp):
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        node.value = not node.value
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        node.value += 1
    elif isinstance(node, ast.Constant):
        node.value = 3.0 * float(node.value) or 1.0  # type: ignore[arg-type]


def mutant(text: str, index: int) -> tuple[str, int, str, set[str]]:
    """Changed source, the line, the change as text, and the functions or names that it is in."""
    tree = ast.parse(text)
    node = places(tree)[index]
    before = ast.unparse(node)
    within = {*_within(tree, node)}
    change(node)
    what = f"{before}  ->  {ast.unparse(node)}"
    return ast.unparse(tree), getattr(node, "lineno", 0), what, within


def _within(tree: ast.AST, node: ast.AST, name: str = "") -> Iterator[str]:
    """Qualified name of the innermost function with a node, or the names that are assigned."""
    for n in ast.iter_child_nodes(tree):
        if not any(m is node for m in ast.walk(n)):
            continue
        if isinstance(n, ast.FunctionDef):
            inner = {*_within(n, node, f"{name}{n.name}.<locals>.")}
            yield from inner or {f"{name}{n.name}"}
        elif isinstance(n, ast.ClassDef):
            yield from _within(n, node, f"{name}{n.name}.")
        elif isinstance(n, ast.Assign) and not name:
            yield from (m.id for t in n.targets for m in ast.walk(t) if isinstance(m, ast.Name))
        else:
            yield from _within(n, node, name)


def functions_with(names: set[str], files: dict[str, str]) -> set[str]:
    """Functions of the package that use one of the names of a module."""
    found = set()

    def look(tree: ast.AST, file: str, name: str) -> None:
        for n in ast.iter_child_nodes(tree):
            if isinstance(n, ast.FunctionDef | ast.ClassDef):
                scope = f"{name}{n.name}"
                used = {m.id for m in ast.walk(n) if isinstance(m, ast.Name)}
                if isinstance(n, ast.FunctionDef) and used & names:
                    found.add(f"{file}:{scope}")
                look(n, file, scope + (".<locals>." if isinstance(n, ast.FunctionDef) else "."))

    for file, text in files.items():
        if any(n in text for n in names):
            look(ast.parse(text), file, "")
    return found


# ---------------------------------------------------------------- tests


def name_of(item: pytest.Item) -> str:
    """Name of a test with its path from the top of the repository."""
    return f"{item.path.relative_to(ROOT)}::{item.nodeid.split('::', 1)[1]}"


class Calls:
    """A plugin of pytest: the functions of the package that each test calls, and its time."""

    def __init__(self) -> None:
        self.now: set[CodeType] = set()
        self.tests: dict[str, dict[str, Any]] = {}
        self.shared: dict[str, set[str]] = defaultdict(set)

    def _trace(self, frame: FrameType, _event: str, _arg: Any) -> None:
        self.now.add(frame.f_code)

    def _names(self) -> set[str]:
        own = [(c, c.co_filename.removeprefix(f"{PACKAGE}{os.sep}")) for c in self.now]
        return {f"{file}:{c.co_qualname}" for c, file in own if file != c.co_filename}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """What a fixture calls counts for all tests of its file."""
        self.now = set()
        sys.settrace(self._trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            self.shared[name_of(item).split("::")[0]] |= self._names()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Trace one test."""
        self.now, began = set(), time.process_time()
        sys.settrace(self._trace)
        try:
            yield
        finally:
            sys.settrace(None)
        spent = time.process_time() - began  # a test that fails without a mutant is left out
        self.tests[name_of(item)] = {"seconds": round(spent, 3), "calls": sorted(self._names())}


def tests_of_functions(
    folders: Sequence[str],
) -> tuple[dict[str, list[str]], dict[str, float]]:
    """Tests by the function that they call, and the time of each [s]."""
    if not KNOWN.exists():
        print("measuring which test calls which function", flush=True)
        if child := os.fork():
            os.waitpid(child, 0)
        else:
            try:
                from unmodeled.fit import simulator

                simulator.WORTH_A_PROCESS = math.inf  # traced runs are slow; no process for them
                calls = Calls()
                os.chdir(ROOT)
                pytest.main(["-q", "-p", "no:cacheprovider", *folders], plugins=[calls])
                for name, own in calls.tests.items():
                    own["calls"] = sorted({*own["calls"]} | calls.shared[name.split("::")[0]])
                KNOWN.parent.mkdir(parents=True, exist_ok=True)
                KNOWN.write_text(json.dumps(calls.tests), encoding="utf-8")
            finally:
                sys.stdout.flush()
                os._exit(0)
    tests = json.loads(KNOWN.read_text(encoding="utf-8"))
    found: dict[str, list[str]] = defaultdict(list)
    for name, own in tests.items():
        for call in own["calls"]:
            found[call].append(name)
    return found, {name: own["seconds"] for name, own in tests.items()}


def killed(copy: Path, tests: Sequence[str], seconds: float) -> bool:
    """Whether a test fails with the copy of the package, or takes too long."""
    child = os.fork()
    if child:
        status = os.waitpid(child, 0)[1]
        if os.WIFEXITED(status) and os.WEXITSTATUS(status) > pytest.ExitCode.INTERNAL_ERROR:
            collect = [sys.executable, "-m", "pytest", "-q", "--collect-only", *tests]
            if subprocess.run(collect, cwd=ROOT, capture_output=True, check=False).returncode:
                raise SystemExit(f"the tests are not found: delete {KNOWN}")
        return status != 0
    code = 1
    try:
        used = int(time.process_time())
        time.monotonic = time.process_time  # limits of time on a busy machine
        resource.setrlimit(resource.RLIMIT_CPU, (used + int(seconds) + 1, used + int(seconds) + 3))
        os.environ["PYTHONPATH"] = os.pathsep.join([str(copy), os.environ.get("PYTHONPATH", "")])
        sys.path.insert(0, str(copy))
        sys.dont_write_bytecode = True
        os.chdir(ROOT)
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        code = int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests]))
    finally:
        os._exit(code)


def main() -> None:
    """Run mutants, print those that live, and the number of the others."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("sources", nargs="*", default=SOURCES)
    parser.add_argument("--tests", nargs="+", default=TESTS)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=20.0, help="time of the tests of a mutant")
    parser.add_argument("--also", nargs="+", default=[], help="tests that each mutant has to pass")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of some of the mutants")
    given = parser.parse_args()
    roots = [ROOT / s for s in given.sources]
    files = sorted(f for r in roots for f in ([r] if r.is_file() else r.rglob("*.py")))
    texts = {f: f.read_text(encoding="utf-8") for f in files}
    every = [(f, i) for f, text in texts.items() for i in range(len(places(ast.parse(text))))]
    chosen = random.Random(given.seed).sample(every, min(given.count, len(every)))
    by_function, spent = tests_of_functions(given.tests)
    package = {str(f.relative_to(PACKAGE)): f.read_text("utf-8") for f in PACKAGE.rglob("*.py")}
    dead = count = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
        for n, (file, index) in enumerate(chosen, 1):
            if given.only and n not in given.only:
                continue
            own = str(file.relative_to(PACKAGE))
            source, line, what, within = mutant(texts[file], index)
            calls = {f"{own}:{name}" for name in within}
            if not calls & by_function.keys():  # a constant, or a field of a class
                calls = functions_with(within, package) or {
                    c for c in by_function if c.startswith(f"{own}:")
                }
            names = {t for c in calls for t in by_function.get(c, ())}
            tests, total = [*given.also], 0.0
            for test in sorted(names, key=lambda t: spent[t]):
                total += spent[test]
                if total > given.seconds:
                    break
                tests.append(test)
            (copy / own).write_text(source, encoding="utf-8")
            found = bool(tests) and killed(copy, tests, 60.0 + 4.0 * given.seconds)
            (copy / own).write_text(texts[file], encoding="utf-8")
            dead, count = dead + found, count + 1
            print(
                f"{'killed' if found else 'LIVES '} {n} {file.relative_to(ROOT)}:{line}: "
                f"{what[:120]} ({len(tests)} of {len(names)} tests)",
                flush=True,
            )
        print(f"{dead} of {count} killed", flush=True)


if __name__ == "__main__":
    main()
