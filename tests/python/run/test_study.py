"""Studies: what the thesis found and what comes out here; files, formulas, pictures, page."""

import json
import math
import re
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli.study import command
from feltmb.errors import FileExists, InvalidParameter
from feltmb.run.study import (
    Study,
    load_study,
    packaged_studies,
    run_studies,
    statistic,
    study,
    study_outlines,
)
from feltmb.run.study.expression import Formula
from feltmb.run.study.page import by_claim, finding_sizes, outcome_text, page, tables

#: Outcomes of the claims of the thesis and of the study's own findings, each in the order of the
#: file: agrees (A), holds in part of the cases (P), disagrees (D), not tested (N).
OUTCOMES = {
    "wire": ("AAAADDA", "AP"),
    "wire_vibration": ("AA", "A"),
    "shank": ("DPAADP", ""),
    "string": ("AAAAAAAAADAAAD", "DDA"),
    "hysteresis": ("AADA", "AA"),
    "staccato": ("PPNPPPAPA", ""),
    "shapes": ("", "AAAAA"),
    "axial": ("", "AAAAAAAAA"),
    "letoff": ("", "AAAAA"),
    "input": ("AA", "AAD"),
    "contact-law": ("AAAADD", "ADAA"),
}
SLOW = ("staccato", "shapes", "axial", "input")


@cache
def result_of(name):
    return study(name, progress=False)


def test_every_packaged_study_is_tested():
    assert sorted(OUTCOMES) == sorted(packaged_studies())
    assert packaged_studies()[:2] == ["wire", "wire_vibration"]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in OUTCOMES]
)
def test_findings(name):
    result = result_of(name)
    letter = {"agrees": "A", "depends": "P", "disagrees": "D", "not tested": "N"}
    for claim, wanted in zip(("thesis", "own"), OUTCOMES[name], strict=True):
        group = [f for f in result.findings if f.claim == claim]
        found = "".join(letter[f.outcome] for f in group)
        assert found == wanted, "\n".join(f"{f.outcome}: {f.says}" for f in group)
    failed = {"stop_printed_rigid forte"} if name == "string" else set()
    assert set(result.failed) == failed


def test_wire_numbers():
    result = result_of("wire")
    assert result.number("check_gap", "flexible", "piano", 1.0) == pytest.approx(
        14.65e-3, abs=0.3e-3
    )
    assert list(dict.fromkeys(result.table["variant"])) == ["flexible", "rigid"]
    assert result.table["check_gap"].notna().all()
    # Judged at every stiffness of the shank that the assumption leaves open.
    closer = next(f for f in result.findings if "closer" in f.says and "forte" in f.says)
    assert (closer.held, closer.of, closer.outcome) == (6, 6, "agrees")


def test_rigid_members_do_not_bend():
    result = result_of("wire_vibration")
    assert result.number("swing", "rigid", "forte") < 1e-12
    assert result.number("frequency", "flexible", "piano") == pytest.approx(114, abs=15)
    assert result.number("frequency", "rigid", "piano") is None  # of round-off
    assert result_of("shank").number("vibration", "rigid", "forte", 1.0) < 1e-12


def test_printed_law_on_rigid_stop_reaches_the_force_of_the_thesis():
    result = result_of("string")
    assert result.number("max_impact_force", "stop_printed", "forte") == pytest.approx(
        370, rel=0.02
    )
    assert result.number("max_impact_force", "stop", "forte") == pytest.approx(162, rel=0.02)


# --- a study of one's own ------------------------------------------------------------------------

OWN = """
schema = 1
name = "own"
title = "Fewer string modes <b>&</b>"
about = "Does it matter?"

[thesis]
cite = "somebody"
figure = "Fig. 1"
found = "It does."

[base]
strokes = ["pulse", "late"]
values = { "shank.rigid" = true, "wire.rigid" = true }
options = { duration = 0.04 }

[strokes.pulse]
base = "staccato"
delay = -0.02

[strokes.late]
base = "staccato"
delay = -0.015
scale = 0.5

[variants.many]
label = "40 modes"

[variants.few]
label = "3 modes"
values = { "string.modes" = 3 }
note = "Too few to sound."

[variants.wrong]
strokes = ["pulse"]
values = { "string.modes" = 4 }

[numbers.steps]

[numbers.dip]
label = "key goes down by"
value = "up - down"
unit = "mm"
thesis = { "many.pulse" = 3.0 }

[numbers.up]
output = "key_front.y"
stat = "first"

[numbers.down]
output = "key_front.y"
stat = "min"
from = "key_start_time"
to = 0.04

[figures.key]
title = "Key"
[[figures.key.panels]]
output = "key_front.y"
stroke = "pulse"
from_rest = true
unit = "mm"
from = "key_start_time - 0.001"

[figures.bars]
title = "Dip $5"
kind = "bars"
[[figures.bars.panels]]
number = "dip"

[[findings]]
says = "The modes do not matter for the key."
check = "abs(dip(many, pulse) - dip(few, pulse)) < 1e-6"
size = "dip(few, pulse) / dip(many, pulse)"

[[findings]]
says = "The dip is 3 mm."
size = "dip(many, pulse)"
unit = "mm"
thesis = 3.0
within = 0.01

[[findings]]
says = "The hammer is caught."
check = "check_gap(many, late) > 0"
"""

SWEPT = """
schema = 1
name = "swept"
title = "Swept"
[base]
strokes = ["staccato"]
values = { "shank.rigid" = true, "wire.rigid" = true }
options = { duration = 0.03 }
[variants.all]
[variants.some]
only = { modes = [3] }
[[sweep.axis]]
name = "modes"
path = "string.modes"
values = [3, -1, 5]
[[sweep.axis]]
name = "push"
path = "stroke.scale"
values = { from = 1.0, to = 2.0, count = 2 }
[figures.steps]
title = "Steps"
kind = "sweep"
[[figures.steps.panels]]
number = "steps"
log = true
[figures.key]
title = "Key"
[[figures.key.panels]]
output = "key_front.y"
[[findings]]
says = "More push, more steps."
check = "steps(all, 3, 2.0) > 0"
[[findings]]
says = "Minus one mode."
check = "steps(all, -1, 2.0) > 0"
"""


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    return path


def test_own_study(own):
    result = study(own, progress=False, jobs=2)
    first, second, third = result.findings
    assert first.outcome == "agrees"
    assert first.here == pytest.approx(1.0, abs=1e-3)
    assert second.outcome == "disagrees"
    assert third.outcome == "not tested"
    assert third.reason == "many late has no check_gap"
    assert [(c.variant, c.stroke) for c in result.outcomes] == [
        ("many", "pulse"),
        ("many", "late"),
        ("few", "pulse"),
        ("few", "late"),
        ("wrong", "pulse"),
    ]
    dip = result.number("dip", "many", "pulse")
    assert dip == pytest.approx(
        result.number("up", "many", "pulse") - result.number("down", "many", "pulse")
    )
    assert "3 disagrees" not in repr(result)
    json.dumps(result.as_dict(), allow_nan=False)


def test_names_of_earlier_versions(own):
    text = own.read_text() + "\n[numbers.max_string_force]\n[numbers.string_contact_duration]\n"
    own.write_text(text.replace("check_gap(many", "max_string_force(many"))
    spec = load_study(own).spec
    assert {"max_impact_force", "impact_duration"} < set(spec.numbers)
    assert "max_impact_force(many" in str(spec.findings[-1].check)


def test_page_is_whole_and_escaped(own):
    result = study(own, progress=False)
    html = result.html()
    assert "<b>&</b>" not in html
    assert "&lt;b&gt;&amp;&lt;/b&gt;" in html
    sources = re.findall(r'src="([^"]{0,30})', html)
    assert len(sources) == 2
    assert all(s.startswith("data:image/png;base64,") for s in sources)
    assert "http" not in html
    assert "<script" not in html
    for text in ("Too few to sound.", "40 modes", "disagrees", "not tested", "somebody"):
        assert text in html
    assert "<h3>Own findings</h3>" in html
    both = page([result, study(Study.from_dict(load_dict(SWEPT)), progress=False)])
    assert 'href="#study-2-swept"' in both
    assert "string.modes: got" in both


def load_dict(text):
    import tomllib

    return tomllib.loads(text)


def test_swept_study():
    result = study(load_dict(SWEPT), progress=False, jobs=2)
    assert [c.point for c in result.outcomes if c.variant == "all"] == [
        (m, p) for m in (3, -1, 5) for p in (1.0, 2.0)
    ]
    assert [c.point for c in result.outcomes if c.variant == "some"] == [(3, 1.0), (3, 2.0)]
    assert [f.outcome for f in result.findings] == ["agrees", "not tested"]
    assert "string.modes: got" in result.findings[1].reason
    assert len(result.failed) == 2
    assert list(result.table.columns[:4]) == ["variant", "stroke", "modes", "push"]
    assert [t.title for t in tables(result)] == ["all, staccato", "some, staccato"]
    for figure in result.figures.values():
        figure.savefig("/dev/null", format="png")


def test_same_bits_for_any_number_of_workers(own):
    one, four = study(own, jobs=1, progress=False), study(own, jobs=4, progress=False)
    assert one.table.equals(four.table)
    for a, b in zip(one.outcomes.values(), four.outcomes.values(), strict=True):
        assert a.numbers == b.numbers
        assert all(np.array_equal(a.series[k], b.series[k]) for k in a.series)


def test_process_pool_gives_the_same(own):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        there = study(own, pool, progress=False)
    here = study(own, jobs=1, progress=False)
    assert there.table.equals(here.table)
    assert there.html() == here.html()


def test_study_goes_on_from_its_folder(own, tmp_path):
    folder = tmp_path / "members"
    first = study(own, folder=folder, progress=False)
    again = study(own, folder=folder, progress=False)
    assert all(o.resumed for o in again.outcomes.values())
    assert first.table.equals(again.table)
    assert first.html() == again.html()


def test_files_beside_the_study_are_found(own):
    own.with_name("mine.toml").write_text(
        'schema = 1\nname = "mine"\n'
        '[pulse]\nforce = "9 N"\nstart = 0.0\nrise = "5 ms"\nfall = "5 ms"\n'
    )
    text = OWN.replace('base = "staccato"\ndelay = -0.02', 'base = "mine.toml"')
    own.write_text(text)
    assert load_study(own).strokes["pulse"].value == (0.0, 9.0, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("schema = 1", "schema = 2", "schema"),
        ('title = "Fewer', 'tittle = "Fewer', "unknown key; did you mean 'title'"),
        ('"string.modes" = 3', '"string.moods.x" = 3', "variants.few: "),
        ('"string.modes" = 3', '"string.modes" = 0', "variants.few: .*\n.*must be >= 1"),
        ("duration = 0.04", "duraton = 0.04", "option 'duraton' is unknown"),
        ("[variants.few]", '[variants."a few"]', "expected a word"),
        ('strokes = ["pulse"]', 'strokes = ["pulze"]', "stroke 'pulze' is unknown"),
        ("dip(few, pulse) /", "dop(few, pulse) /", "number 'dop' is none of steps, dip"),
        ("dip(few, pulse) /", "dip(fev, pulse) /", "'fev' is no variant"),
        ("dip(few, pulse) /", "__import__(few, pulse) /", "number '__import__' is none of"),
        ("dip(few, pulse) /", "dip(few) /", "says no stroke"),
        ("dip(few, pulse) /", "dip(few, pulse, 3) /", "value for each of 0 axes"),
        ("dip(few, pulse) /", "few /", "'few' stands alone"),
        ("dip(few, pulse) /", "dip(few, pulse) //", "not allowed"),
        ('value = "up - down"', 'value = "up - "', "formula"),
        ('stat = "min"', 'stat = "pulses"', "'pulses' needs level"),
        ('stat = "first"', "", "output needs stat"),
        ('unit = "mm"\nthesis', 'unit = "miles"\nthesis', "unit 'miles' is unknown"),
        ("within = 0.01", "", "size, thesis and within belong together"),
        ('stroke = "pulse"\nfrom_rest', 'stroke = "plse"\nfrom_rest', "stroke 'plse' is none of"),
        ('number = "dip"', "", "needs number"),
        ('thesis = { "many.pulse"', 'thesis = { "most.pulse"', "variant 'most' is none of"),
        ('kind = "bars"', 'kind = "pie"', "expected 'time', 'sweep' or 'bars'"),
    ],
)
def test_faults_are_named(own, old, new, message):
    assert old in OWN
    own.write_text(OWN.replace(old, new))
    with pytest.raises(InvalidParameter, match=message):
        load_study(own)


def test_all_faults_come_at_once(own):
    own.write_text(
        OWN.replace("dip(few, pulse) /", "dop(few, pulse) /").replace('number = "dip"', "")
    )
    with pytest.raises(InvalidParameter, match=r"own.toml: 2 faults") as caught:
        load_study(own)
    assert "dop" in str(caught.value)
    assert "needs number" in str(caught.value)


def test_unknown_study():
    with pytest.raises(InvalidParameter, match="did you mean 'wire'"):
        load_study("wires")
    with pytest.raises(InvalidParameter, match="no such file"):
        load_study("nothing.toml")


# --- formulas and statistics ---------------------------------------------------------------------


def value(text, **names):
    return Formula(text)(lambda name, arguments: names[name] if arguments is None else arguments)


def test_formulas():
    assert value("2 * a.b + 1", **{"a.b": 3.0}) == 7
    assert value("max(1, 2, a) - min(a, 0)", a=5.0) == 5
    assert bool(value("1 < a <= 2 and not a == 1.5", a=2.0))
    assert value("f(x, -0.1, 'y z')") == ("x", -0.1, "y z")
    assert math.isnan(value("1 / 0"))
    assert value("9**9**9**9") != value("9**9**9**9") or math.isinf(value("9**9**9**9"))
    assert Formula("sqrt(a.x**2 + b) + g(c)").names() == ["a.x", "b"]
    assert Formula("sqrt(a) + g(c)").calls() == [("g", ("c",))]
    assert np.array_equal(value("abs(a) > 1", a=np.array([-2.0, 0.5])), [True, False])


@pytest.mark.parametrize(
    "text",
    [
        "a.__class__()",
        "(1).real",
        "[1][0]",
        "lambda: 1",
        "a if b else c",
        "f(g(x))",
        "f(x=1)",
        "'text'",
        "True",
        "a[0]",
        "a; b",
        "",
        "a +",
        "max()",
        "a % b",
        "(" * 500 + "a" + ")" * 500,
        "a+" * 2000 + "a",
    ],
)
def test_what_is_no_formula_is_refused(text):
    with pytest.raises(InvalidParameter):
        Formula(text)(lambda name, _arguments: {"a.__class__": 1}[name])


def test_statistics():
    time = np.linspace(0.0, 1.0, 1001)
    wave = np.sin(2 * np.pi * 20 * time)
    assert statistic("frequency", time, wave + 3 * time) == pytest.approx(20, abs=0.2)
    assert math.isnan(statistic("frequency", time, 0 * time))
    assert statistic("span", time, wave) == pytest.approx(2, rel=1e-2)
    assert statistic("rms", time, wave) == pytest.approx(2**-0.5, rel=1e-3)
    assert statistic("variation", time, wave) == pytest.approx(80, rel=1e-2)
    assert statistic("pulses", time, np.sin(2 * np.pi * 5 * time), 0.5) == 5
    assert statistic("pulses", time, wave * 0, 0.5) == 0
    assert statistic("time_above", time, wave, 0.0) == pytest.approx(0.5, abs=0.02)
    assert statistic("rises_above", time, time, 0.25) == pytest.approx(0.251)
    assert statistic("falls_below", time, -time, -0.25) == pytest.approx(0.251)
    assert math.isnan(statistic("rises_above", time, time, 2.0))
    assert statistic("settles", time, np.exp(-10 * time), 0.1) == pytest.approx(0.23, abs=0.01)
    assert statistic("settles", time, time * 0, 0.1) == 0.0
    # Comes back to where it began, or does not; to settle elsewhere is no return.
    gone = np.where(time < 0.3, 0.0, np.where(time < 0.6, 1.0, 0.05))
    assert statistic("returns", time, gone, 0.1) == pytest.approx(0.6)
    assert statistic("returns", time, time * 0, 0.1) == 0.0
    assert math.isnan(statistic("returns", time, np.where(time < 0.3, 0.0, 1.0), 0.1))
    hump = np.where(time < 0.5, time, 1.0 - time)
    assert statistic("swing_back", time, hump) == pytest.approx(0.5)
    assert statistic("time_of_max", time, hump) == pytest.approx(0.5)


# --- the command line ----------------------------------------------------------------------------


def run(*arguments, code=0):
    runner = CliRunner(env={"COLUMNS": "80"})
    result = runner.invoke(command, [str(a) for a in arguments])
    if code == 0 and result.exception is not None:
        raise result.exception
    if "--json" not in arguments:
        assert all(len(line) <= 80 for line in result.stdout.splitlines()), result.stdout
    return result


def test_list():
    text = run("--list").stdout
    for name in packaged_studies():
        assert name in text
    assert json.loads(run("--list", "--json").stdout)["wire"]["runs"] == 24


def test_command_writes_and_does_not_overwrite(own, tmp_path):
    out = tmp_path / "out"
    text = run(own, "--out", out).stdout
    for word in ("key goes down by [mm]", "somebody", "agrees", "disagrees", "not tested"):
        assert word in text
    names = {p.name for p in out.iterdir()}
    assert names == {"own.html", "own.csv", "own.json", "own_key.png", "own_bars.png", "members"}
    before = (out / "own.html").read_bytes()
    with pytest.raises(FileExists):
        run(own, "--out", out)
    run(own, "--out", out, "--force")
    assert (out / "own.html").read_bytes() == before


def test_several_studies_make_one_page(own, tmp_path):
    other = tmp_path / "swept.toml"
    other.write_text(SWEPT)
    out = tmp_path / "out"
    result = run(own, other, "--out", out, "--jobs", 2)
    assert "swept: all -1 1 staccato: " in result.stderr
    assert (out / "index.html").is_file()
    assert not (out / "own.html").exists()
    assert (out / "swept.csv").is_file()


def test_json(own):
    data = json.loads(run(own, "--json").stdout)["own"]
    assert data["findings"][0]["outcome"] == "agrees"
    assert data["table"][0]["variant"] == "many"


def test_command_refuses(own, tmp_path):
    assert run(code=2).exit_code == 2
    assert isinstance(run("wires", code=1).exception, InvalidParameter)
    second = tmp_path / "second.toml"
    second.write_text(OWN)
    assert "two studies have the name own" in str(run(own, second, code=1).exception)
    file = tmp_path / "file"
    file.write_text("")
    assert run(own, "--out", file, code=2).exit_code == 2


@pytest.mark.slow
def test_all_studies_on_one_page(tmp_path):
    run("all", "--out", tmp_path / "studies")
    html = (tmp_path / "studies" / "index.html").read_text()
    assert html.count("<section") == len(packaged_studies())
    assert len(html) < 8_000_000


def test_studies_run_side_by_side(own):
    made = [load_study(own), Study.from_dict(load_dict(SWEPT))]
    calls = []
    results = run_studies(made, progress=lambda *call: calls.append(call))
    assert [r.study.name for r in results] == ["own", "swept"]
    assert calls[-1][:2] == (13, 13)


def test_study_of_the_documentation_runs():
    page = Path(__file__).parents[3] / "docs" / "howto" / "run_studies.md"
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert len(blocks) == 1
    result = study(load_dict(blocks[0]), progress=False)
    assert [f.outcome for f in result.findings] == ["agrees"]
    assert set(result.table["status"]) == {"done"}
    assert result.table["restitution"].between(0.5, 1.0).all()
    panel = result.study.spec.figures["hammer"].panels[0]
    pair = result.series(panel, next(iter(result.outcomes)))
    assert pair is not None
    assert pair.shape[0] == 2


def test_documentation_counts_the_findings():
    docs = Path(__file__).parents[3] / "docs"
    text = (docs / "validation" / "studies.md").read_text(encoding="utf-8")
    for name, (thesis, own) in OUTCOMES.items():
        row = re.search(rf"^\| `{name}` \|.*$", text, re.MULTILINE)
        assert row is not None, name
        cells = [c.strip() for c in row.group().split("|")[3:10]]
        wanted = [*(thesis.count(letter) for letter in "APDN"), *(own.count(c) for c in "APD")]
        assert [int(c or 0) for c in cells] == wanted, name
    validation = (docs / "validation" / "thesis.md").read_text("utf-8")
    thesis, own = ("".join(pair[i] for pair in OUTCOMES.values()) for i in (0, 1))
    for letters in (thesis, own):
        counts = [letters.count(letter) for letter in "APD"]
        words = "{} agree, {} hold in part of the cases, {} disagree".format(*counts)
        assert f"Of {len(letters)} " in validation
        assert words in " ".join(validation.split())


def test_a_finding_is_judged_over_an_axis():
    study_of = load_dict(SWEPT)
    study_of["sweep"]["axis"][0]["values"] = [3, 4, 5]
    study_of["variants"]["some"]["only"] = {"modes": [3, 4]}
    study_of["findings"] = [
        {"says": "in part", "over": "modes", "check": "string_modes(all, modes, 1.0) < 4.5"},
        {
            "says": "everywhere",
            "claim": "thesis",
            "over": "modes",
            "check": "string_modes(all, modes, 2.0) > 2",
            "size": "string_modes(all, modes, 2.0)",
        },
        {"says": "nowhere", "over": "modes", "check": "string_modes(all, modes, 1.0) > 9"},
        {"says": "where it ran", "over": "modes", "check": "string_modes(some, modes, 1.0) > 3.5"},
        {"says": "never ran", "over": "push", "check": "string_modes(some, 5, push) > 0"},
        {"says": "one size", "over": "modes", "size": "string_modes(all, modes, 1.0)",
         "thesis": 4.0, "within": 0.1},
    ]  # fmt: skip
    # A number that tells the point of the sweep: how many modes took part.
    study_of["numbers"] = {"string_modes": {"value": "rhs / rhs + 0 * steps"}}
    made = Study.from_dict(study_of)
    from feltmb.run.study import StudyResult
    from feltmb.run.sweep import Outcome

    outcomes = {
        case: Outcome("done", "", {"string_modes": float(case.point[0])}) for case in made.cases()
    }
    result = StudyResult(made, outcomes)
    found = [(f.outcome, f.held, f.of) for f in result.findings]
    assert found == [
        ("depends", 2, 3),
        ("agrees", 3, 3),
        ("disagrees", 0, 3),
        ("depends", 1, 2),
        ("not tested", 0, 0),
        ("depends", 1, 3),
    ]
    everywhere, where = result.findings[1], result.findings[3]
    assert (everywhere.claim, everywhere.low, everywhere.high) == ("thesis", 3.0, 5.0)
    assert finding_sizes(everywhere)[0] == "3 to 5"
    assert where.reason == "not tested at 1 of 3: some 5 1 staccato did not run"
    assert [outcome_text(f) for f in result.findings[:2]] == ["depends, 2 of 3", "agrees, 3 of 3"]
    assert list(by_claim(result.findings, "somebody")) == ["claims of: somebody", "own findings"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('says = "Minus one mode."', 'says = "x"\nover = "mode"', "axis 'mode' is none of modes"),
        ("steps(all, -1, 2.0)", "steps(all, modes, 2.0)", "'modes' is no variant"),
        ('output = "key_front.y"', 'output = "key_front.y"\nonly = { mode = [3] }', "axis 'mode'"),
        ('says = "Minus one mode."', 'says = "x"\nclaim = "mine"', "expected 'thesis' or 'own'"),
    ],
)
def test_faults_of_findings_over_an_axis_are_named(old, new, message):
    assert old in SWEPT
    with pytest.raises(InvalidParameter, match=message):
        Study.from_dict(load_dict(SWEPT.replace(old, new)))


def test_a_panel_shows_the_points_that_it_names():
    study_of = load_dict(SWEPT)
    study_of["sweep"]["axis"][0]["values"] = [3, 5]
    study_of["figures"]["key"]["panels"][0]["only"] = {"modes": [3], "push": [1.0]}
    result = study(study_of, progress=False)
    panel = result.study.spec.figures["key"].panels[0]
    shown = {c for c in result.outcomes if result.series(panel, c) is not None}
    assert {(c.variant, c.point) for c in shown} == {("all", (3, 1.0)), ("some", (3, 1.0))}
    labels = [t.get_text() for t in result.figures["key"].legends[0].get_texts()]
    assert labels == ["all", "some"]


def test_outlines_are_the_packaged_studies():
    outlines = {s.name: s for s in study_outlines()}
    assert list(outlines) == packaged_studies()
    for name in ("contact-law", packaged_studies()[0]):
        whole = load_study(name)
        assert outlines[name].spec == whole.spec
        assert outlines[name].cases() == whole.cases()
