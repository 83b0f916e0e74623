"""Tables at any width: no broken word or number, one place that makes them."""

import ast
import io
import json
import random
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

import feltmb.cli
from feltmb.cli import cli
from unmodeled import tables
from unmodeled.tables import FittingTable, Screen, new_table

CLI = Path(feltmb.cli.__file__).parent


FAST = [
    "list",
    "show steinway45",
    "show steinway45 --values",
    "stroke steinway45 forte",
    "felt audit steinway45:04",
]


def _render(table, width):
    stream = io.StringIO()
    Screen(file=stream, width=width, highlight=False, markup=False, emoji=False).print(table)
    return stream.getvalue()


def _words_of(table):
    texts = [str(table.title or ""), str(table.caption or "")]
    for column in table.columns:
        texts += [str(column.header), *map(str, column.cells)]
    return {word for text in texts for word in text.split()}


def _check(table, width):
    """Every word of a table is whole at a width, and no part of one is a word of its own."""
    shown = _render(table, width)
    words = _words_of(table)
    found = set(shown.replace("─", " ").split())
    heads = {word + ":" for word in words}  # of a table in blocks
    assert words <= found | {word.rstrip(":") for word in found}, shown
    assert found <= words | heads, (found - words - heads, shown)
    longest = max((len(w) for c in table.columns for t in [str(c.header), *map(str, c.cells)]
                   for w in re.findall(r"(?:\[[^\[\]]*\]|\S)+", t)), default=0)  # fmt: skip
    assert max(map(len, shown.splitlines()), default=0) <= max(width, 2 * longest + 4), shown


@pytest.mark.parametrize("line", FAST)
def test_no_command_breaks_a_number_or_a_name(line, monkeypatch):
    printed = []
    made = FittingTable.__init__

    def remember(self, *args, **kwargs):
        made(self, *args, **kwargs)
        printed.append(self)

    monkeypatch.setattr(FittingTable, "__init__", remember)
    result = CliRunner(env={"COLUMNS": "80"}).invoke(cli, line.split())
    assert result.exception is None, result.output
    for table in printed:
        for width in (120, 80, 60, 40):
            _check(table, width)
    assert max(len(text) for text in result.stdout.splitlines()) <= 80


def test_random_tables_never_break_a_word():
    draw = random.Random(3)

    def cell():
        kind = draw.randrange(3)
        if kind == 0:
            return f"{draw.gauss(0, 1) * 10 ** draw.randrange(-6, 6):.6g}"
        if kind == 1:
            parts = ["felt", "thickness", "06", "hammer"]
            return "_".join(draw.choices(parts, k=draw.randrange(1, 5)))
        return " ".join(draw.choices(["the", "jack", "regulation"], k=draw.randrange(1, 20)))

    for _ in range(60):
        n = draw.randrange(1, 9)
        whole = [i for i in range(n) if draw.random() < 0.2]
        table = new_table("a title", *(cell() for _ in range(n)), whole=tuple(whole))
        for _ in range(draw.randrange(1, 4)):
            table.add_row(*(cell() for _ in range(n)))
        for width in (100, 80, 60, 40, 20):
            _check(table, width)


def test_a_table_that_fits_is_one_table_and_one_that_does_not_is_split_or_stacked():
    table = new_table("", "name", *(f"column_{i}" for i in range(8)))
    table.add_row("felt_thickness.06", *(["0.00442123"] * 8))
    assert _render(table, 200).count("felt_thickness.06") == 1
    split = _render(table, 60)
    assert split.count("felt_thickness.06") == split.count("name") > 1
    stacked = _render(table, 26)
    assert stacked.count("felt_thickness.06") == 1
    assert "  column_7: 0.00442123\n" in stacked
    unit = new_table("", "name", "inertia [kg mm^2] of the hammer")
    unit.add_row("a", "1")
    assert "[kg mm^2]" in _render(unit, 20)


def test_every_table_of_the_commands_is_made_in_one_place():
    for path in CLI.rglob("*.py"):
        if path == Path(tables.__file__):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.ImportFrom) else []
            if isinstance(node, ast.ImportFrom) and node.module == "rich.table":
                inside = "TYPE_CHECKING" in path.read_text()
                assert inside, f"{path}: imports {names}"
        calls = re.findall(r"(?<![\w.])Table\(", path.read_text())
        assert not calls, f"{path}: makes a table of its own"


def test_numbers_are_aligned_to_the_right(capsys):
    from unmodeled.cli.screen import console

    table = new_table("", "name", "value", right=(1,))
    table.add_row("a", "1.5")
    table.add_row("b", "100.25")
    console().print(table)
    rows = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    (one,) = [r for r in rows if r.endswith("1.5")]
    (hundred,) = [r for r in rows if r.endswith("100.25")]
    assert len(one) == len(hundred)


def test_the_list_tells_where_numbers_come_from():
    listed = json.loads(CliRunner().invoke(cli, ["list", "--json"]).output)
    assert listed["sources"].keys() == listed["actions"].keys()
    assert "Piano Technicians Guild" in listed["sources"]["grand_action"]
    assert "Stanwood" in listed["sources"]["steinway45_note64"]
    assert listed["sources"]["steinway45_printed"] == "steinway45"
