"""Numbers that decide stand in one file, and the page shows them."""

import ast
from pathlib import Path

import pytest

from feltmb.gap import criteria

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "reference" / "gap-criteria.md"


def test_the_page_shows_the_table():
    page = PAGE.read_text(encoding="utf-8")
    assert page.endswith(criteria.table()), "write feltmb.gap.criteria.table() to the page"


@pytest.mark.parametrize("criterion", criteria.CRITERIA, ids=lambda c: c.name)
def test_a_criterion_is_what_its_name_holds_and_has_a_test(criterion):
    assert getattr(criteria, criterion.name) == criterion.value
    assert criterion.unit
    assert criterion.reason
    assert criterion.data
    assert (ROOT / "tests" / "python" / criterion.test).is_file()


def test_every_criterion_is_used():
    sources = [
        p.read_text(encoding="utf-8")
        for p in (ROOT / "python" / "feltmb" / "gap").rglob("*.py")
        if p.name != "criteria.py"
    ]
    names = {c.name for c in criteria.CRITERIA}
    used = {
        node.id for s in sources for node in ast.walk(ast.parse(s)) if isinstance(node, ast.Name)
    }
    assert names <= used
    assert len(names) == len(criteria.CRITERIA)
