"""What the command line shows: tables on narrow screens, completion, targets, folders."""

import ast
import io
import json
import random
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.shell_completion import BashComplete
from click.testing import CliRunner

import feltmb.cli
from feltmb import load_action, simulate, tables
from feltmb.action.regulate import load_targets
from feltmb.action.touch import Touch, TouchRow
from feltmb.cli import cli, completing
from feltmb.cli.common import new_table
from feltmb.errors import InvalidParameter
from feltmb.files import make_folder
from feltmb.mechanism import apply_values
from feltmb.tables import FittingTable, Screen, _words

# --- tables --------------------------------------------------------------------------------------

CLI = Path(feltmb.cli.__file__).parent

FAST = [
    "list",
    "show steinway45",
    "show steinway45 --values",
    "stroke steinway45 forte",
    "felt list",
    "felt show a12_03",
    "study --list",
    "fiber models",
    "fiber models binomial",
    "fiber structure 1 3",
    "fiber contacts --v-f 0.1 --length 1e-3",
    "fiber tensor --v-f 0.12 --e-modulus 1e9",
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
                   for w in _words(t)), default=0)  # fmt: skip
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

    for _ in range(150):
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
    assert _words("inertia [kg mm^2] a") == ["inertia", "[kg mm^2]", "a"]


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


# --- folders of results --------------------------------------------------------------------------


def _call(*arguments):
    result = CliRunner(env={"COLUMNS": "80"}).invoke(cli, [str(a) for a in arguments])
    return result, str(result.exception or "")


def test_a_mistyped_folder_is_not_made(tmp_path):
    (tmp_path / "results").mkdir()
    result, said = _call("stroke", "steinway45", "forte", "-o", tmp_path / "resutls/a/run.nc")
    assert "there is no such folder ('resutls' is missing); did you mean 'results'?" in said
    assert isinstance(result.exception, InvalidParameter)
    for line in (
        ["stroke", "steinway45", "forte", "piano", "-o", tmp_path / "typo" / "runs"],
        ["study", "wire", "--out", tmp_path / "typo" / "wire"],
        ["touch", "steinway45", "--plot", tmp_path / "typo" / "touch"],
        ["regulate", "steinway45", "-o", tmp_path / "typo" / "new.toml"],
        ["demo", "--out", tmp_path / "typo" / "demo"],
        ["new", tmp_path / "typo" / "own.toml"],
        ["felt", "show", "a12_03", "-o", tmp_path / "typo" / "loop.png"],
    ):
        _, said = _call(*line)
        assert "there is no such folder" in said, line
        assert "create it first, or correct the path" in said
    assert [p.name for p in tmp_path.iterdir()] == ["results"]


def test_the_folder_that_is_named_is_made(tmp_path):
    run = simulate("steinway45", "forte", duration=0.005, ledger=False)
    with pytest.raises(InvalidParameter, match="there is no such folder"):
        run.save(tmp_path / "none" / "run.nc")
    assert make_folder(tmp_path / "new") == tmp_path / "new"
    assert make_folder(tmp_path / "new").is_dir()
    run.save(tmp_path / "new" / "run.nc")
    with pytest.raises(InvalidParameter, match="is a file, expected a folder"):
        make_folder(tmp_path / "new" / "run.nc")
    with pytest.raises(InvalidParameter, match="no such folder"):
        make_folder(tmp_path / "a" / "b")


# --- completion ----------------------------------------------------------------------------------


def _completed(line, monkeypatch):
    words = line.split(" ")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    complete = BashComplete(cli, {}, "feltmb", "_FELTMB_COMPLETE")
    return [item.value for item in complete.get_completions(words[1:-1], words[-1])]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("stroke steinway45 forte --set string.mo", ["string.modes="]),
        ("stroke steinway45 forte --set bodies.key.friction.stribeck_", None),
        ("show steinway45 --set key.friction.stribeck_", ["key.friction.stribeck_speed="]),
        ("show steinway45 --set contacts.06.law=pri", ["contacts.06.law=printed"]),
        ("show steinway45 --set wire.rigid=", ["wire.rigid=true", "wire.rigid=false"]),
        ("show steinway45 --set surfaces.Gp10.point.", None),
        ("regulate nothing --set string.mo", []),
        ("gap diagnose steinway45 a.csv --set toler", ["tolerances="]),
        ("gap diagnose steinway45 a.csv --set string.mo", ["string.modes="]),
        ("sensitivity steinway45 forte --parameters string.te", ["string.tension"]),
    ],
)
def test_paths_are_completed(line, wanted, monkeypatch):
    found = _completed(f"feltmb {line}", monkeypatch)
    start = line.split(" ")[-1]
    if wanted is None:
        axes = [start + "x=", start + "y="]
        wanted = axes if start.endswith("point.") else [start + "speed="]
    assert found == wanted


def test_every_completed_path_can_be_set(monkeypatch):
    """By reflection: what is offered is what a file says and --set takes."""
    monkeypatch.setenv("COMP_WORDS", "feltmb show steinway45 --set ")
    offered = completing._settable()
    numbers = [p for p, v in offered.items() if isinstance(v, float)]
    assert len(numbers) > 500
    same = apply_values(load_action("steinway45").raw, {p: offered[p] for p in numbers}, "--set")
    assert same["string"]["modes"] == 40


def test_outputs_and_events_of_saved_runs_are_completed(tmp_path, monkeypatch):
    path = simulate("steinway45", "forte").save(tmp_path / "run.nc")
    assert _completed(f"feltmb plot {path} --compare hammer_tip.v", monkeypatch) == [
        "hammer_tip.vx",
        "hammer_tip.vy",
    ]
    assert _completed(f"feltmb view {path} --align string_contact_", monkeypatch) == [
        "string_contact_on",
        "string_contact_off",
    ]
    assert _completed("feltmb plot none.nc --compare h", monkeypatch) == []


# --- targets of a regulation ---------------------------------------------------------------------


def test_targets_of_the_line_stand_beside_those_of_a_file():
    packaged = load_targets("steinway45")
    mine = packaged.with_targets(
        {"let-off": "4mm", "A": "10 mm", "shank on_the REST rail": "0 N to 1 N"}
    )
    by_name = {step.name: step for step in mine.steps}
    assert by_name["let-off"].target == pytest.approx(4e-3)
    assert by_name["key dip"].target == pytest.approx(10e-3)
    assert (by_name["shank on the rest rail"].low, by_name["shank on the rest rail"].high) == (0, 1)
    assert by_name["hammer blow"] == packaged.steps[1]
    assert mine.name == (
        "steinway45 with let-off = 4mm, A = 10 mm, shank on_the REST rail = 0 N to 1 N"
    )


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("letoff", "4mm", "there is no such step; did you mean 'let-off'?"),
        ("D", "1 mm", "names 2 steps"),
        ("let-off", "4 N", "does not measure"),
        ("let-off", "nan mm", "expected"),
        ("shank on the rest rail", "1 N", "is a range of 0.001 to 0.2"),
        ("shank on the rest rail", "1 N to 0.5 N", "the smaller number first"),
    ],
)
def test_a_target_that_is_none_is_refused(name, value, said):
    with pytest.raises(InvalidParameter) as caught:
        load_targets("steinway45").with_targets({name: value})
    assert said in str(caught.value)
    assert name in str(caught.value)


def test_targets_extend_packaged_ones(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n'
        '[[steps]]\nname = "let-off"\ntarget = "3 mm"\n'
        '[[steps]]\nname = "shank on the rest rail"\ntarget = "0.1 N"\ntolerance = "0.05 N"\n'
        '[[steps]]\nname = "damper at rest"\nmeasure = "rest_force"\ncontact = 10\nlow = "0.1 N"\n'
    )
    base, mine = load_targets("steinway45"), load_targets(path)
    assert mine.name == "mine"
    assert mine.cite == base.cite
    assert [s.name for s in mine.steps] == [*(s.name for s in base.steps), "damper at rest"]
    by_name = {step.name: step for step in mine.steps}
    assert by_name["let-off"].target == pytest.approx(3e-3)
    assert by_name["let-off"].screw == base.steps[4].screw
    assert by_name["shank on the rest rail"].low is None  # a target instead of the range
    assert by_name["shank on the rest rail"].target == 0.1
    again = tmp_path / "again.toml"
    again.write_text('schema = 1\nname = "again"\nextends = "mine.toml"\nrounds = 2\n')
    assert load_targets(again).steps == mine.steps
    assert load_targets(again).rounds == 2
    again.write_text('schema = 1\nname = "again"\nextends = "again.toml"\n')
    with pytest.raises(InvalidParameter, match="leads back to itself"):
        load_targets(again)
    again.write_text('schema = 1\nname = "again"\nextends = "nothing"\n')
    with pytest.raises(InvalidParameter, match="'nothing' are unknown"):
        load_targets(again)


def test_regulate_shows_the_screws_before_and_after(tmp_path):
    path = tmp_path / "dip.toml"
    path.write_text(
        'schema = 1\nname = "dip"\n[[steps]]\nname = "key dip"\nmeasure = "rest_gap"\ncontact = 2\n'
        'target = "10.5 mm"\ntolerance = "0.01 mm"\n'
        'screw = { name = "washers", path = "surfaces.Gp3.point", direction = [0.0, 1.0], '
        'low = "-5 mm", high = "5 mm", gain = -1.0 }\n'
    )
    result, said = _call(
        "regulate", "steinway45_printed", "--targets", path, "--target", "key-dip=10mm"
    )
    assert said == ""
    words = " ".join(result.stdout.split())
    assert "dip with key-dip = 10mm" in words
    assert "10.000" in words
    assert "(218, -40.7)" in words
    screws = json.loads(
        _call("regulate", "steinway45_printed", "--targets", path, "--json")[0].stdout
    )["steps"]
    assert screws[0]["value_before"] == "(218, -40.7) mm"
    assert screws[0]["value_after"] != screws[0]["value_before"]
    for wrong in ("let-off", "=4mm", "let-off="):
        result, said = _call("regulate", "steinway45", "--target", wrong)
        assert result.exit_code == 2


def test_touch_shows_before_and_after(monkeypatch):
    def fake(action, **_):
        weight = 50.0 + 100.0 * action.config.bodies["key"].friction.viscous
        rows = (TouchRow("a", "down-weight", weight, "gf"), TouchRow("b", "key dip", None, "mm"))
        return Touch(action, rows, SimpleNamespace(window=(0.0, 0.0)), None, (), {})

    monkeypatch.setattr(sys.modules["feltmb.action.touch"], "touch", fake)
    plain = _call("touch", "steinway45")[0].stdout
    assert "here" in plain
    assert "before" not in plain
    changed = _call("touch", "steinway45", "--set", "bodies.key.friction.viscous=0.3")[0].stdout
    assert "before" in changed
    assert "after" in changed
    assert re.search(r"down-weight +50\.0 +80\.0 +gf", changed)
    other = _call("touch", "steinway45", "--before", "steinway45_printed")[0].stdout
    assert "touch of steinway45, before: steinway45_printed" in other


def test_numbers_are_aligned_to_the_right(capsys):
    from feltmb.cli.common import console, new_table

    table = new_table("", "name", "value", right=(1,))
    table.add_row("a", "1.5")
    table.add_row("b", "100.25")
    console().print(table)
    rows = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    (one,) = [r for r in rows if r.endswith("1.5")]
    (hundred,) = [r for r in rows if r.endswith("100.25")]
    assert len(one) == len(hundred)
