"""Every public function with three or more arguments documents them, as numpydoc has it."""

import doctest
import inspect
import re
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parents[3] / "tools"
sys.path.insert(0, str(TOOLS))
try:
    from reference.python_api import offered
finally:
    sys.path.remove(str(TOOLS))


def functions():
    """Public functions, and methods of public classes, by name."""
    for module, items in offered().items():
        for item, value in items.items():
            if inspect.isfunction(value):
                yield f"{module}.{item}", value
            elif inspect.isclass(value):
                for member, inner in vars(value).items():
                    function = getattr(inner, "__func__", inner)
                    if not member.startswith("_") and inspect.isfunction(function):
                        yield f"{module}.{item}.{member}", function


def arguments(function):
    """Names of the arguments, without self."""
    return [p for p in inspect.signature(function).parameters if p not in ("self", "cls")]


def documented(function):
    """Names in the section ``Parameters``, or nothing without one."""
    text = inspect.getdoc(function) or ""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w[\w ]*\n-+$|\Z)", text, re.M | re.S)
    heads = re.findall(r"^(\S.*)$", section.group(1), re.M) if section else []
    return [name.strip(" *") for head in heads for name in head.split(" : ")[0].split(",")]


FUNCTIONS = {name: f for name, f in functions() if len(arguments(f)) >= 3}


def test_arguments_are_documented():
    assert [name for name, f in FUNCTIONS.items() if not documented(f)] == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_documented_arguments_exist(name):
    known = arguments(FUNCTIONS[name])
    assert [a for a in documented(FUNCTIONS[name]) if a not in known] == []


#: Public names with a block ``Examples`` that runs; fewer fail.
EXAMPLES = 78


def test_examples_of_public_functions_and_classes_run():
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    classes = {
        f"{module}.{item}": value
        for module, items in offered().items()
        for item, value in items.items()
        if inspect.isclass(value)
    }
    tests = [
        test
        for name, value in {**dict(functions()), **classes}.items()
        for test in finder.find(value, name, globs={})
        if test.examples
    ]
    said = []
    for test in tests:
        runner.run(test, out=said.append)
    assert len(tests) >= EXAMPLES
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
