"""Mutation test: changes a comparison, a constant or a truth value; a test should fail.

    python tools/mutate.py --count 20 --seed 1 --tests unmodeled/tests/diagnosis SOURCE...

A mutant that no test notices shows a rule without a test. Each one works on a copy of the package,
so that the tree is never changed. Sources: files, or folders of them.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unmodeled" / "src"
SOURCES = ("unmodeled/src/unmodeled/search", "unmodeled/src/unmodeled/report")
#: Comparisons and what they become.
OTHER: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


def _texts(node: ast.AST) -> Iterator[int]:
    """Identities of the nodes that are annotations: they decide nothing."""
    for n in ast.walk(node):
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


def mutant(text: str, index: int) -> tuple[str, int, str]:
    """Changed source, the line, and the change as text."""
    tree = ast.parse(text)
    node = places(tree)[index]
    before = ast.unparse(node)
    change(node)
    return ast.unparse(tree), node.lineno, f"{before}  ->  {ast.unparse(node)}"


def killed(copy: Path, tests: Sequence[str], seconds: float) -> bool:
    """Whether a test fails with the copy of the package."""
    path = os.pathsep.join([str(copy), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=ROOT, env={**os.environ, "PYTHONPATH": path}, capture_output=True,
            timeout=seconds, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def main() -> None:
    """Run mutants, print those that live, and the number of the others."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("sources", nargs="*", default=SOURCES)
    parser.add_argument("--tests", nargs="+", default=["unmodeled/tests/diagnosis"])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1800.0, help="limit of time of a mutant")
    given = parser.parse_args()
    roots = [ROOT / s for s in given.sources]
    files = sorted(f for r in roots for f in ([r] if r.is_file() else r.rglob("*.py")))
    texts = {f: f.read_text(encoding="utf-8") for f in files}
    every = [(f, i) for f, text in texts.items() for i in range(len(places(ast.parse(text))))]
    chosen = random.Random(given.seed).sample(every, min(given.count, len(every)))
    dead = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
        if killed(copy, given.tests, given.seconds):
            raise SystemExit("the tests fail without a mutant")
        for n, (file, index) in enumerate(chosen, 1):
            place = copy / file.relative_to(PACKAGE)
            source, line, what = mutant(texts[file], index)
            place.write_text(source, encoding="utf-8")
            found = killed(copy, given.tests, given.seconds)
            place.write_text(texts[file], encoding="utf-8")
            dead += found
            mark = "killed" if found else "LIVES "
            print(f"{mark} {file.relative_to(ROOT)}:{line}: {what[:120]}", flush=True)
            print(f"{dead} of {n} killed", flush=True)
        if killed(copy, given.tests, given.seconds):
            raise SystemExit("the tests were changed meanwhile: the numbers are of no use")


if __name__ == "__main__":
    main()
