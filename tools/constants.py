"""Numeric constants of the diagnosis: lists them, and proves that the numerics decide nothing.

    python tools/constants.py                    # kind, place, name and value of each
    python tools/constants.py --prove [NAME...]  # diagnoses with half and with double of each
    python tools/constants.py --prove --cases 1,4,7   # imperfect machines of the yardstick, too

A constant is a name in capitals of a module that gets a number. A *numeric* makes the work precise
or fast: with half and with double of it, each diagnosis of a small set has the same verdict, names,
classes and supported causes. A *decision* is a number that somebody could choose otherwise. A
*definition* is no choice: a table of a method or of units, the version of a format.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "unmodeled" / "src"
PLACES = ("search", "fit", "experiment", "library", "diagnosis.py")
#: Constants of each file that are no numerics.
DEFINITIONS = {
    "search/compare.py": "_FACTORS _CLOCKS",
    "search/result.py": "VERSION",
    "search/verdict.py": "HALF",
    "fit/compiled.py": "VERSION",
    "fit/methods.py": "_GAMMA METHODS",
    "fit/mjcf_changes.py": "ACTUATOR",
    "fit/runs.py": "FORM",
    "fit/tape.py": "FUNCTIONS ARGUMENTS _COMPOSED _ARRAY_FUNCTIONS",
    "experiment/information.py": "NAMED",
    "library/balance.py": "MEMORY",
    "library/bouc_wen.py": "AWAY FOR_COORDINATE",
    "library/forces.py": "FOR_SPEED FOR_COORDINATE",
}
DECISIONS = {
    "search/changes.py": "ODDS ALIKE",
    "search/compare.py": "LONGEST_DELAY UNKNOWN_START CORRELATED CERTAIN NEAR_FACTOR TAKES_AWAY "
    "LEAVES LEAVES_CERTAIN LEAST_VARIANCE DELAY_SPREAD ANY_SIZE",
    "search/evidence.py": "DEGREES CHANCE",
    "search/linear.py": "NARROW WIDE",
    "search/locate.py": "ALIKE",
    "search/problem.py": "RELEASED STRICT TRUSTED",
    "search/records.py": "WRONG_STATEMENT OFFSET SHARE JUMP SATURATED PLATEAU FAR CERTAINLY_FAR "
    "HUGE SPIKE",
    "search/result.py": "TOLERANCE",
    "search/score.py": "ALIKE",
    "search/search.py": "WORTH",
    "search/verdict.py": "CLASS SAME GOOD_ENOUGH WORTH_A_MEMBER EQUAL POSSIBLE",
    "fit/equations.py": "NOISY",
    "fit/fmi.py": "LARGEST",
    "fit/mjcf.py": "STEP_ERROR OF_SPREAD",
    "fit/mjcf_changes.py": "ARMATURE CONTACT",
    "fit/mjcf_parts.py": "LARGEST NUMBERS COPIES FILES",
    "fit/noise.py": "AGREES",
    "experiment/information.py": "MAGNITUDES RESERVE",
    "experiment/planning.py": "TESTS LEAST_SHOWN SHARE_OF_SPREAD SHARE_OF_TOLERANCE",
    "library/defaults.py": "TYPICAL FLOW",
    "library/forces.py": "CLEARANCE_SHARPNESS",
}


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
                (
                    kind
                    for kind, table in (("definition", DEFINITIONS), ("decision", DECISIONS))
                    if name in table.get(own, "").split()
                ),
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


def _module(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def diagnoses(cases: str, folder: Path) -> dict[str, str]:
    """Verdict, names, classes and supported causes of each diagnosis of the set."""
    from unmodeled import Effect, LinearModel, Parameter, diagnose

    tests = ROOT / "unmodeled" / "tests" / "diagnosis"
    own, made = _module(tests / "models.py"), _module(tests / "conftest.py")
    spring = LinearModel(
        name="spring", output="force", columns={"k": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="k", value=95.0, sd=10.0, unit="N/m")],
    )  # fmt: skip

    def law(name: str, power: int, scale: float) -> Effect:
        return Effect(name=name, component="spring", unit=f"N/m^{power}", scale=scale,
                      regressor=lambda r, _: r.inputs["x"] ** power)  # fmt: skip

    laws = [law("even", 2, 100.0), law("hardening", 3, 1000.0), law("preload", 0, 1.0)]

    def pulled(**what: float) -> list[Any]:
        roles = ("fit", "fit", "held_out")
        return [
            made.spring_record(f"{k}", k, role=r, **what)
            for k, r in zip((2, 3, 5), roles, strict=True)
        ]

    every: dict[str, tuple[Any, Any, Any]] = {
        "spring, nothing": (spring, laws, pulled()),
        "spring, hardening": (spring, laws, pulled(hardening=2000.0)),
        "spring, two": (spring, laws, pulled(hardening=2000.0, preload=1.0)),
        "spring, weak": (spring, laws, pulled(preload=0.02)),
        "spring, foreign": (spring, laws, pulled(foreign=1.0)),
        "spring, foreign and hardening": (spring, laws, pulled(foreign=0.3, hardening=2000.0)),
        "oscillator, nothing": (own.NOMINAL, own.EFFECTS, own.records(1)),
        "oscillator, both": (own.NOMINAL, own.EFFECTS, own.records(3, dry=0.05, cubic=2e4)),
    }
    if cases:
        sys.path.insert(0, str(ROOT / "bench"))
        from blind.marks import case_numbers
        from blind.yardstick_sets import SETS

        machines = SETS["imperfect"]
        for k in case_numbers(cases, machines.count):
            task = machines.task(k, folder)
            every[f"imperfect {k}"] = task.model, task.effects, task.records
    out = {}
    for name, (model, effects, records) in every.items():
        try:
            found = diagnose(model, effects, records)
        except Exception as error:
            out[name] = f"{type(error).__name__}: {error}"
            continue
        told = [n.cause for n in found.named]
        told += sorted(" | ".join(sorted(n.cause for n in g)) for g in found.classes)
        supported = ", ".join(sorted(n.cause for n in found.supported))
        out[name] = f"{found.verdict.name} {', '.join(sorted(told))} ({supported})"
    return out


def answers(constant: Constant | None, factor: float, cases: str, folder: Path) -> dict[str, str]:
    """The diagnoses with a multiple of a constant, in a process of its own."""
    read, write = os.pipe()
    if child := os.fork():
        os.close(write)
        with os.fdopen(read) as pipe:
            text = pipe.read()
        os.waitpid(child, 0)
        return dict(json.loads(text or '{"": "the process ended"}'))
    try:
        if constant is not None:
            scale(constant, factor)
        found = diagnoses(cases, folder)
        with os.fdopen(write, "w") as pipe:
            json.dump(found, pipe)
    finally:
        os._exit(0)


def scale(constant: Constant, factor: float) -> None:
    """Multiply a constant in its module, and in those that import it."""
    home = constant.file.removesuffix(".py").replace("/", ".")

    def times(value: Any) -> Any:
        if isinstance(value, tuple | list):
            return type(value)(times(v) for v in value)
        return max(round(value * factor), 1) if isinstance(value, int) else value * factor

    new = times(getattr(importlib.import_module(home), constant.name))
    for name, module in [*sys.modules.items()]:
        if name == home or (
            name.startswith("unmodeled.") and constant.name in _imported(module, home)
        ):
            setattr(module, constant.name, new)


@cache
def _imported(module: Any, home: str) -> set[str]:
    """Names that a module imports from another one."""
    if not getattr(module, "__file__", ""):
        return set()
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    return {
        alias.name
        for n in ast.walk(tree)
        if isinstance(n, ast.ImportFrom) and n.module == home
        for alias in n.names
    }


def prove(found: list[Constant], cases: str, folder: Path) -> int:
    """Diagnose with half and double of each constant; the number of those that decide."""
    import unmodeled  # noqa: F401  # before the processes are forked

    deciding, base = 0, answers(None, 1.0, cases, folder)
    for name, said in base.items():
        print(f"{name}: {said}", flush=True)
    for c in found:
        changed = [
            f"\n    times {factor:g}: {k}: {now.get(k, now.get(''))}"
            for factor in (0.5, 2.0)
            for now in [answers(c, factor, cases, folder)]
            for k in base
            if now.get(k) != base[k]
        ]
        deciding += bool(changed)
        mark = "DECIDES" if changed else "same   "
        print(f"{mark} {c.kind} {c.file}: {c.name}{''.join(changed)}", flush=True)
    return deciding


def main() -> int:
    """List the constants, or prove that those of a kind decide nothing."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="FILE:NAME or NAME; default: all numerics")
    parser.add_argument("--prove", action="store_true")
    parser.add_argument("--places", nargs="+", help="parts of paths, such as search/")
    parser.add_argument("--cases", default="", help="imperfect machines, such as 1,4,7")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "yardstick")
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
        return int(prove(some, given.cases, given.cache) > 0)
    for c in found:
        print(f"{c.kind:10s} {c.file}: {c.name} = {ast.unparse(c.node)[:60]}")
    counts = Counter(c.kind for c in found)
    print(", ".join(f"{n} {kind}s" for kind, n in sorted(counts.items())), f"of {len(found)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
