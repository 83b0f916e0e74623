"""The picture and the tables of docs/explanation/architecture.md are those of the source."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def tool():
    path = ROOT / "tools" / "make_architecture.py"
    spec = importlib.util.spec_from_file_location("make_architecture", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_page_and_picture_are_up_to_date(tool):
    for file, text in tool.pages().items():
        assert file.read_text(encoding="utf-8") == text, "run python tools/make_architecture.py"


def test_a_part_stands_above_all_that_it_uses(tool):
    for table in tool.may_use().values():
        rows = {p: i for i, row in enumerate(tool.levels(table)) for p in row}
        assert rows.keys() == table.keys()
        assert all(rows[p] > rows[q] for p, used in table.items() for q in used)


def test_arrows_leave_out_what_follows(tool):
    table = {"a": set(), "b": {"a"}, "c": {"a", "b"}}
    assert tool.reduced(table) == {"a": [], "b": ["a"], "c": ["b"]}


def test_the_page_names_files_that_exist(tool):
    text = tool.PAGE.read_text(encoding="utf-8")
    for name in ("planar/description.hpp", "model/equilibrium.hpp", "model/simulation.hpp"):
        assert name.removesuffix(".hpp") in text
        assert (ROOT / "cpp" / "include" / "feltmb" / name).is_file()
