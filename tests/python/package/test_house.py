"""The ratchet of the structure: a tree that became worse fails, unless a reason says why."""

import ast
import importlib.util
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MODULE = '''"""Judges."""

from ..report.words import shown

__all__ = ["judge"]


def judge(searched):
    """The sum.

    Examples
    --------
    >>> judge(1)
    """
    return shown(searched)


def again(value):
    return value
'''
WORDS = """from ..search.verdict import again


def shown(value):
    return again(value)


def told(value):
    return value
"""
#: What makes the small tree worse, and the measure that tells it.
WORSE = {
    "complex": lambda text: text + "\n\ndef f(a):\n" + "    if a:\n        a = 2\n" * 20,
    "share above 5 [%]": lambda text: text + "\n\ndef f(a):\n" + "    a = a or 2\n" * 5,
    "unnamed floats": lambda text: text.replace("return value", "return value * 0.7"),
    "public names": lambda text: text.replace('["judge"]', '["judge", "again"]'),
    "examples": lambda text: text.replace("Examples", "Example"),
    "lines unmodeled.search": lambda text: text + "\n" * 2,
    "returns judge:searched": lambda text: text.replace(
        "import shown", "import shown, told"
    ).replace("return value", "return told(value)"),
}


@pytest.fixture
def house(monkeypatch, tmp_path):
    spec = importlib.util.spec_from_file_location("house", ROOT / "tools" / "house.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    monkeypatch.setattr(tool, "WALKS", (("unmodeled.search.verdict", "judge", "searched"),))
    source = tmp_path / "unmodeled" / "src" / "unmodeled"
    for name, text in {"search/verdict": MODULE, "report/words": WORDS}.items():
        (source / name).parent.mkdir(parents=True)
        (source / f"{name}.py").write_text(text)
    stored = tmp_path / tool.STORED
    stored.parent.mkdir(parents=True)
    stored.write_text(json.dumps({"measures": tool.measures(tmp_path), "reasons": []}))

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["house.py", "--root", str(tmp_path), *arguments])
        return tool.main()

    tool.run, tool.judge, tool.stored = run, source / "search" / "verdict.py", stored
    return tool


@pytest.mark.parametrize("measure", WORSE)
def test_a_worse_tree_fails_until_a_reason_is_given(house, measure, capsys):
    assert house.run() == 0
    house.judge.write_text(WORSE[measure](MODULE))
    assert house.run() == house.run("--write") == house.run("--reason", " ") == 1
    assert f"{measure}: " in capsys.readouterr().out
    assert house.run("--reason", "a new law") == house.run() == 0
    reasons = json.loads(house.stored.read_text())["reasons"]
    assert (measure, "a new law") in {(r["measure"], r["why"]) for r in reasons}


def test_what_became_better_is_stored_and_holds(house):
    house.judge.write_text(WORSE["unnamed floats"](MODULE))
    assert house.run("--reason", "a number of a table") == 0
    house.judge.write_text(MODULE)
    assert house.run("--write") == 0
    assert json.loads(house.stored.read_text())["measures"]["unnamed floats"] == 0
    house.judge.write_text(WORSE["unnamed floats"](MODULE))
    assert house.run() == 1


def test_room_for_lines_does_not_grow_with_a_reason(house):
    house.judge.write_text(MODULE + "\n" * 100)
    assert house.run("--reason", "a table") == 0
    before = json.loads(house.stored.read_text())["measures"]["lines unmodeled.search"]
    house.judge.write_text(WORSE["unnamed floats"](MODULE) + "\n" * 101)
    assert house.run("--reason", "a number of a table") == 0
    assert json.loads(house.stored.read_text())["measures"]["lines unmodeled.search"] == before


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("return a", 1),
        ("if a:\n  pass\n elif b and c and d:\n  pass", 5),
        ("for x in a:\n  pass\n else:\n  pass", 3),
        ("try:\n  pass\n except A:\n  pass\n except B:\n  pass", 3),
        ("return [x for x in a if x if not x] if a else 0", 5),
        ("assert a", 2),
    ],
)
def test_complexity_is_that_of_mccabe_as_radon_counts(house, text, expected):
    assert house.complexity(ast.parse(f"def f(a):\n {text}")) == expected
