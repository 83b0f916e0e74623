"""Numeric constants of the diagnosis: lists them, and proves that the numerics decide nothing.

    python tools/constants.py                    # kind, place, name and value of each
    python tools/constants.py --prove [NAME...]  # tests with half and with double of each

A constant is a name in capitals of a module that gets a number. A *numeric* makes the work precise
or fast: with half and with double of it, each diagnosis of the tests that call a function which
reads it has the same verdict, names, classes and supported causes. The fastest tests are run, or a
random choice, up to a limit of time; if none of them diagnoses, they have to pass. NUMBERS: the
verdicts are the same, but a test of other numbers fails. A *decision* is a number that somebody
could choose otherwise. A *limit* refuses a file that would take all memory or time; no diagnosis
comes near it. A *definition* is no choice: a table of a method or of units, the version of a
format.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import os
import random
import re
import resource
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from mutate import TESTS, functions_with, name_of, tests_of_functions

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unmodeled" / "src"
PLACES = ("search", "models", "ode", "fit", "experiment", "library", "diagnosis.py")
#: Limit of the time of the tests with one constant [s].
LONGEST = 120
#: Constants of each file that are no numerics.
DEFINITIONS = {
    "search/compare.py": "_FACTORS _CLOCKS",
    "search/result.py": "VERSION",
    "search/held_out.py": "HALF",
    "search/ledger.py": "RULES MARKING",
    "search/tolerances.py": "OUTSIDE",
    "ode/compiled.py": "VERSION",
    "ode/methods.py": "_GAMMA METHODS",
    "fit/mjcf_changes.py": "ACTUATOR BODY",
    "fit/mjcf_laws.py": "LAWS",
    "fit/runs.py": "FORM",
    "ode/tape.py": "FUNCTIONS ARGUMENTS _COMPOSED _ARRAY_FUNCTIONS",
    "experiment/information.py": "NAMED",
    "library/balance.py": "DEFLECTIONS MEMORY",
    "library/bouc_wen.py": "AWAY FOR_COORDINATE",
    "library/forces.py": "FOR_SPEED FOR_COORDINATE",
}
DECISIONS = {
    "search/choice.py": "PREDICTED UNLIKELY SINGLE POSSIBLE WORTH",
    "search/compare.py": "LONGEST_DELAY UNKNOWN_START CORRELATED CERTAIN NEAR_FACTOR TAKES_AWAY "
    "LEAVES LEAVES_CERTAIN DELAY_SPREAD ANY_SIZE",
    "search/evidence.py": "DEGREES CHANCE",
    "search/held_out.py": "MANY SHARED",
    "search/ledger.py": "SAME",
    "search/linear.py": "NARROW",
    "search/locate.py": "ALIKE",
    "search/problem.py": "RELEASED NARROW SIMULATED STRICT TRUSTED",
    "search/records.py": "WRONG_STATEMENT SHARE JUMP SATURATED PLATEAU FAR CERTAINLY_FAR "
    "HUGE SPIKE",
    "search/options.py": "GOOD_ENOUGH",
    "search/result.py": "TOLERANCE NO_GAIN",
    "search/score.py": "ALIKE",
    "search/search.py": "WORTH",
    "search/tolerances.py": "NEGLIGIBLE ALONE TOGETHER",
    "search/verdict.py": "CLASS EQUAL",
    "fit/mjcf.py": "STEP_ERROR OF_SPREAD",
    "fit/mjcf_changes.py": "ARMATURE CONTACT",
    "fit/noise.py": "AGREES",
    "experiment/information.py": "MAGNITUDES",
    "experiment/planning.py": "LEAST_SHOWN SHARE_OF_SPREAD SHARE_OF_TOLERANCE",
    "library/defaults.py": "TYPICAL FLOW",
    "library/forces.py": "CLEARANCE_SHARPNESS",
}
#: Sizes beyond which a file is refused.
LIMITS = {
    "fit/fmi.py": "MOST_ENTRIES LARGEST_TEXT",
    "fit/mjcf_parts.py": "NUMBERS COPIES DEEPEST MOST_PARTS MOST_ITERATIONS SHORTEST_STEP "
    "LARGEST_START",
}
KINDS = {"definition": DEFINITIONS, "decision": DECISIONS, "limit": LIMITS}


@dataclass(frozen=True)
class Constant:
    """One number of a module."""

    file: str
    """Relative to the package."""
    name: str
    node: ast.expr
    kind: str

    @property
    def numbers(self) -> list[ast.Constant]:
        """Its numbers."""
        return [n for n in ast.walk(self.node) if isinstance(n, ast.Constant) and _number(n)]


def _number(node: ast.Constant) -> bool:
    return type(node.value) in (int, float)


def constants(tree: ast.Module, file: str) -> Iterator[Constant]:
    """Constants of a module."""
    own = file.removeprefix("unmodeled/")
    for n in tree.body:
        if isinstance(n, ast.AnnAssign) and n.value is not None:
            pairs: list[tuple[ast.expr, ast.expr]] = [(n.target, n.value)]
        elif isinstance(n, ast.Assign) and len(n.targets) == 1:
            target, value = n.targets[0], n.value
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = [*zip(target.elts, value.elts, strict=True)]
        else:
            continue
        for target, value in pairs:
            name = getattr(target, "id", "")
            if not re.fullmatch("_?[A-Z][A-Z0-9_]*", name):
                continue
            kind = next(
                (kind for kind, table in KINDS.items() if name in table.get(own, "").split()),
                "numeric",
            )
            found = Constant(file, name, value, kind)
            if found.numbers:
                yield found


def sources() -> Iterator[Path]:
    """Files that are searched."""
    for place in PLACES:
        path = PACKAGE / "unmodeled" / place
        yield from [path] if path.is_file() else sorted(path.rglob("*.py"))


def readers(constant: Constant) -> set[str]:
    """Functions that read a constant, as :mod:`mutate` names them."""
    home = constant.file.removesuffix(".py").replace("/", ".")
    files = {constant.file: (PACKAGE / constant.file).read_text("utf-8")}
    for path in (PACKAGE / "unmodeled").rglob("*.py"):
        text = path.read_text("utf-8")
        if constant.name in text and constant.name in _imported(text, home):
            files[path.relative_to(PACKAGE).as_posix()] = text
    return functions_with({constant.name}, files)


def _imported(text: str, home: str) -> set[str]:
    """Names that a module imports from another one."""
    return {
        alias.name
        for n in ast.walk(ast.parse(text))
        if isinstance(n, ast.ImportFrom) and n.module == home
        for alias in n.names
    }


class Answers:
    """A plugin of pytest: the answers of the diagnoses of each test, and the tests that fail."""

    def __init__(self) -> None:
        self.now = ""
        self.told: dict[str, list[str]] = defaultdict(list)
        self.failed: list[str] = []

    def keep(self, result: Any) -> Any:
        """Verdict, names, classes and supported causes of a diagnosis."""
        names = sorted(n.cause for n in result.named)
        names += sorted(" | ".join(sorted(n.cause for n in g)) for g in result.classes)
        supported = ", ".join(sorted(n.cause for n in result.supported))
        self.told[self.now].append(f"{result.verdict.name} {', '.join(names)} ({supported})")
        return result

    @pytest.hookimpl
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """A test begins; what a fixture diagnoses belongs to the first test that needs it."""
        self.now = name_of(item)

    @pytest.hookimpl
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test ends."""
        if report.failed:
            self.failed.append(self.now)


class Proof:
    """A plugin of pytest: runs the tests of each constant, in processes that it forks."""

    def __init__(self, chosen: dict[Constant, list[str]]) -> None:
        self.chosen, self.items, self.not_proven = chosen, dict[str, pytest.Item](), 0

    @pytest.hookimpl
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Half and double of each constant."""
        self.items = {name_of(i): i for i in session.items}
        base = self.answers(None, 1.0, [*self.items])
        count = sum(map(len, base["told"].values()))
        print(f"{len(self.items)} tests, {count} diagnoses; failing: {base['failed']}", flush=True)
        for c, names in self.chosen.items():
            tests = [t for t in names if base["told"].get(t)] or names
            changed = [x for factor in (0.5, 2.0) for x in self.changes(c, factor, tests, base)]
            decides = any("->" in line for line in changed)
            mark = "DECIDES" if decides else "NUMBERS" if changed else "same" if tests else "UNREAD"
            number = sum(len(base["told"].get(t, ())) for t in tests)
            print(f"{mark:8}{c.file}: {c.name}: {number} diagnoses, {len(tests)} tests")
            print("".join(f"    {line}\n" for line in changed), end="", flush=True)
            self.not_proven += decides or not tests
        return True

    def answers(self, c: Constant | None, factor: float, tests: Sequence[str]) -> dict[str, Any]:
        """Answers and failures with a multiple of a constant, of a process of its own."""
        read, write = os.pipe()
        if child := os.fork():
            os.close(write)
            with os.fdopen(read) as pipe:
                text = pipe.read()
            os.waitpid(child, 0)
            return dict(json.loads(text or '{"told": {}, "failed": ["the process ended"]}'))
        try:
            import unmodeled.diagnosis as diagnosis

            resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST + 2))
            if c is not None:
                scale(c, factor)
            found, judge = Answers(), diagnosis.judge
            diagnosis.judge = lambda *a, **k: found.keep(judge(*a, **k))
            nothing = os.open(os.devnull, os.O_WRONLY)
            for stream in (1, 2):
                os.dup2(nothing, stream)
            items = [self.items[t] for t in tests]
            items[0].config.pluginmanager.register(found)
            for item, after in zip(items, [*items[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            with os.fdopen(write, "w") as pipe:
                json.dump({"told": found.told, "failed": found.failed}, pipe)
        finally:
            os._exit(0)

    def changes(
        self, c: Constant, factor: float, tests: Sequence[str], base: dict[str, Any]
    ) -> Iterator[str]:
        """Answers that are others with a multiple of a constant, and tests that fail."""
        if not tests:
            return
        now = self.answers(c, factor, tests)
        if any(now["told"].get(t) != base["told"].get(t) for t in tests):
            # What a fixture diagnoses belongs to another test if fewer tests are run.
            base = self.answers(None, 1.0, tests)
        for t in tests:
            before, after = (x["told"].get(t, []) for x in (base, now))
            failed = t in now["failed"] and t not in base["failed"]
            pairs = zip(before, after, strict=False) if failed else [(before, after)]
            yield from (f"times {factor:g}: {t}: {a} -> {b}" for a, b in pairs if a != b)
            if failed:
                yield f"times {factor:g}: {t} fails"
        if not {*now["failed"]} <= {*tests}:
            yield f"times {factor:g}: {now['failed']}"


def scale(constant: Constant, factor: float) -> None:
    """Multiply a constant in its module, and in those that import it."""
    home = constant.file.removesuffix(".py").replace("/", ".")

    def times(value: Any) -> Any:
        if isinstance(value, tuple | list):
            return type(value)(times(v) for v in value)
        if isinstance(value, dict):
            return {k: times(v) for k, v in value.items()}
        return max(round(value * factor), 1) if isinstance(value, int) else value * factor

    new = times(getattr(importlib.import_module(home), constant.name))
    for name, module in [*sys.modules.items()]:
        file = getattr(module, "__file__", None) or ""
        if name == home or (
            name.startswith("unmodeled.")
            and constant.name in _imported(Path(file).read_text("utf-8"), home)
        ):
            setattr(module, constant.name, new)


def prove(found: list[Constant], seconds: float, seed: int) -> int:
    """Run tests with half and double of each constant; the number of those that are not proven."""
    time.monotonic = time.process_time  # limits of time on a busy machine
    import unmodeled.diagnosis  # noqa: F401  # before the processes are forked

    by_function, spent = tests_of_functions(TESTS)
    diagnosing = {*by_function["unmodeled/search/verdict.py:judge"]}
    chosen: dict[Constant, list[str]] = {}
    for c in found:
        names = {t for f in readers(c) for t in by_function.get(f, ())}
        tests = sorted(names & diagnosing or names)
        random.Random(seed).shuffle(tests)
        chosen[c], total = [], 0.0
        for test in tests if seed else sorted(tests, key=lambda t: spent[t]):
            if total + spent[test] <= seconds:
                chosen[c].append(test)
                total += spent[test]
    proof = Proof(chosen)
    every = sorted({t for tests in chosen.values() for t in tests})
    os.chdir(ROOT)
    pytest.main(["-q", "-s", "-p", "no:cacheprovider", *every], plugins=[proof])
    return proof.not_proven


def main() -> int:
    """List the constants, or prove that those of a kind decide nothing."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="FILE:NAME or NAME; default: all numerics")
    parser.add_argument("--prove", action="store_true")
    parser.add_argument("--places", nargs="+", help="parts of paths, such as search/")
    parser.add_argument("--seconds", type=float, default=2.0, help="time of tests of a constant")
    parser.add_argument("--seed", type=int, default=0, help="tests by chance; 0: the fastest")
    given = parser.parse_args()
    found = [
        c
        for path in sources()
        for c in constants(ast.parse(path.read_text("utf-8")), str(path.relative_to(PACKAGE)))
        if not given.places or any(p in str(path) for p in given.places)
    ]
    if given.names:
        found = [c for c in found if {c.name, f"{c.file}:{c.name}"} & {*given.names}]
    if given.prove:
        some = [c for c in found if given.names or c.kind == "numeric"]
        return int(prove(some, given.seconds, given.seed) > 0)
    for c in found:
        print(f"{c.kind:10s} {c.file}: {c.name} = {ast.unparse(c.node)[:60]}")
    counts = Counter(c.kind for c in found)
    print(", ".join(f"{n} {kind}s" for kind, n in sorted(counts.items())), f"of {len(found)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
