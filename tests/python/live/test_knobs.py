"""Knobs: what they move, in the units of the file, and that all of them can be turned."""

import pytest

import feltmb
from feltmb.live.knobs import Bench
from feltmb.live.measured import diagnosis_message, knob_of, tint_of
from feltmb.live.states import MOST_KNOTS, Asked, Playing
from unmodeled import Effect, Report, Verdict
from unmodeled.errors import InvalidParameter
from unmodeled.page.uploads import Uploads
from unmodeled.search.result import (
    Channel,
    NamedCause,
    ParameterValue,
    Result,
    SetOfCauses,
    Without,
)


@pytest.fixture(scope="module")
def bench():
    return Bench(feltmb.load_action("steinway45"))


def test_every_screw_of_the_targets_and_every_tolerance_is_a_knob(bench):
    steps = [s.name for s in bench.targets.steps if s.screw]
    assert [f"screw.{name}" in bench.knobs for name in steps] == [True] * len(steps)
    moved = {frozenset(c.path for c in k.changes) for k in bench.knobs.values()}
    for entry in bench.library.tolerances:
        assert frozenset(c.path for c in entry.changes) in moved, entry.name


def test_every_knob_turns_to_its_ends_and_back(bench):
    for knob in bench.knobs.values():
        assert knob.low <= 0.0 <= knob.high
        assert bench.values({knob.name: 0.0}, {}) == {}
        ends = [m for m in (knob.low, knob.high) if m]
        for magnitude in ends:
            values = bench.values({knob.name: magnitude}, {})
            assert values
            bench.action.with_values(values)


def test_values_are_those_of_set_in_the_units_of_the_file(bench):
    values = bench.values({"screw.let-off": 5e-4, "screw.check distance": 0.01}, {})
    assert values["surfaces.Gp10.point.y"] == "77.5 mm"
    number, unit = values["bodies.wire.angle"].split()
    assert (float(number), unit) == (pytest.approx(75.5 + 0.572957795), "deg")
    changed = bench.action.with_values(values)
    point = bench.action.config.surfaces["Gp10"].point
    assert changed.config.surfaces["Gp10"].point[1] == pytest.approx(point[1] + 5e-4)


def test_a_direction_turns_both_coordinates(bench):
    values = bench.values({"screw.damper starts": 1e-3}, {})
    normal = bench.action.config.surfaces["Dp2"].normal
    for axis, before, part in zip("xy", (6.4, -51.0), normal, strict=True):
        number, unit = values[f"surfaces.Dp2.point.{axis}"].split()
        assert (float(number), unit) == (pytest.approx(before + part, abs=1e-3), "mm")


def test_two_knobs_of_one_number_combine(bench):
    both = bench.values({"felt.06": 0.1, "felt_hardening.06": 0.1}, {})
    one = bench.values({"felt_hardening.06": 0.1}, {})
    path = "contacts.06.loading.a"
    assert both[path] == pytest.approx(1.1 * one[path])


def test_all_faults_at_once(bench):
    with pytest.raises(InvalidParameter) as told:
        bench.values({"screw.none": 1.0}, {"bodies.key.color": 1.0})
    assert "screw.none" in str(told.value)
    assert "bodies.key.color" in str(told.value)


@pytest.mark.parametrize("name", ["pendulum", "hammer_string", "mass_spring"])
def test_other_machines_have_knobs_and_say_what_is_missing(name, root):
    bench = Bench(feltmb.load_action(root / "tests" / "data" / f"{name}.toml"))
    assert any(k.startswith("mass.") for k in bench.knobs)
    assert any("regulation targets" in note for note in bench.notes)


def test_what_a_diagnosis_names_is_a_knob(bench):
    assert knob_of(bench, "felt.06") == "felt.06"
    assert knob_of(bench, "capstan_height") == "screw.lost motion"
    assert knob_of(bench, "let_off_button") == "screw.let-off"
    assert knob_of(bench, "input_delay") == ""


def test_what_a_diagnosis_tells_has_knobs_changes_and_colors(bench):
    channel = Channel("tip", "m", 1e-5, 1e-2, 4e-3, 2e-3, 1e-3)
    named = NamedCause("felt.06", "contact 06, hammer - string", "1", 0.4, 0.3, 0.5, 0.97,
                  parameter=True, changes="felt.06", remedy="Needle it.")  # fmt: skip
    one, other = (
        NamedCause(n, "input", "s", 1e-3, 1e-4, 2e-3, 0.5) for n in ("input_delay", "lag")
    )
    values = (
        ParameterValue("capstan_height", "the capstan", "m", 0.0, 2e-4, -4e-4, -7e-4, -1e-4),
        ParameterValue("let_off_button", "The let-off button", "m", 0.0, 2e-4, 8e-4, 7e-4, 9e-4),
        ParameterValue("felt.06", "felt 06", "1", 0.1, 0.1, 0.4, 0.3, 0.5),
        ParameterValue("mass.key", "the key", "1", 0.0, 0.02, 0.001, -0.01, 0.012),
    )
    sets = (SetOfCauses(("felt.06", "creep"), 0.75, (1e-3,)), SetOfCauses(("lag",), 0.25, (2e-3,)))
    left = [("felt.06", 2e-3), ("input_delay", 1.5e-3), ("lag", 1.5e-3), ("let_off_button", 3e-3)]
    without = tuple(Without(name, (before,), (1e-3,)) for name, before in left)
    result = Result(Verdict.NAMED, (), (channel,), (named,), ((one, other),), values, sets,
                    changed=((values[1],),), without=without)  # fmt: skip
    effects = (Effect(name="creep", component="felt", mechanism="It creeps."),)
    page = diagnosis_message(Report.of(result), effects, bench)
    assert page["verdict"] == "Named"
    effects = [c["effect"] for c in page["causes"]]
    assert effects == ["let_off_button", "felt.06", "input_delay", "lag"]
    first, second, third, _ = page["causes"]
    assert (first["how"], first["magnitude"]) == ("outside its tolerance", 8e-4)
    assert "takes away 28 % of the motion of tip" in first["text"]
    assert "let-off" in page["answer"]
    assert page["statement"].startswith(
        "The let-off button differs from the model by +0.80 mm (+0.70 to +0.90)"
    )
    # Its knob changes the tabulated value, so that the change is told.
    assert second["knob"] == "felt.06"
    assert second["text"].endswith("Needle it")
    changes = [second[k] for k in ("low", "magnitude", "high")]
    assert changes == pytest.approx([0.2, 0.3, 0.4])
    assert third["how"] == "one of 2"
    assert [(c["effect"], c["text"]) for c in page["candidates"]] == [("creep", "It creeps.")]
    tint = dict(zip(["ground", *bench.action.config.bodies], page["tint"], strict=True))
    # The felt takes away sqrt(4 - 1) of 4.
    assert tint["head"] == pytest.approx(0.433)
    assert tint["jack"] == 0.0


def test_parts_are_colored_by_their_share(bench):
    shares = [("contact 06, hammer - string", 0.8), ("whippen joint", 0.3), ("input", 1.0)]
    shares += [("screw.lost motion", 0.6), ("spring.jack_spring", 0.1)]
    tint = dict(zip(["ground", *bench.action.config.bodies], tint_of(bench, shares), strict=True))
    assert tint["head"] == tint["ground"] == 0.8
    assert tint["whippen"] == 0.3
    assert tint["key"] == 0.6
    assert tint["jack"] == 0.1
    assert tint["damper"] == 0.0


@pytest.mark.parametrize(
    "given",
    [
        {"kind": "packaged", "name": "no such"},
        {"kind": "press", "force": -1.0},
        {"kind": "press", "force": float("inf")},
        {"kind": "drawn", "time": [0.0] * (MOST_KNOTS + 1), "value": [0.0] * (MOST_KNOTS + 1)},
        {"kind": "fly"},
        {"kind": "press", "more": 1},
    ],
)
def test_what_cannot_be_played_is_refused(given):
    with pytest.raises(InvalidParameter):
        Asked.read({"id": 1, "playing": given})


def test_a_stroke_that_lasts_too_long_is_refused():
    long = Playing(kind="repeat", rate=1.0, count=12)
    with pytest.raises(InvalidParameter, match="at most"):
        long.stroke()


@pytest.mark.parametrize("kind", ["press", "strike", "slow", "repeat", "free"])
def test_every_way_to_play_is_a_stroke(kind):
    assert 0.0 < Playing(kind=kind).stroke().duration <= 3.0


def test_uploads_keep_a_few_files_under_names_of_its_own(tmp_path):
    from unmodeled.page.uploads import MOST_FILES

    uploads = Uploads(tmp_path)
    for k in range(MOST_FILES + 3):
        entry = uploads.add(f"../../r{k}.csv", b"time [s],u [V]\n0,1\n1,2\n")
    assert entry["name"] == f"r{MOST_FILES + 2}.csv"
    assert len(uploads.listing()) == MOST_FILES
    files = uploads.kept([f["file"] for f in uploads.listing()])
    assert len(files) == MOST_FILES
    assert all(tmp_path in path.parents for path in files)
    assert not (tmp_path.parent / "r0.csv").exists()
    with pytest.raises(InvalidParameter, match="expected a file"):
        uploads.add("page.html", b"")


def test_without_the_extra_the_message_says_what_to_install(monkeypatch):
    import sys

    from feltmb.live.server import Live
    from unmodeled.errors import Error

    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(Error, match=r"uvicorn.*pip install.*uvicorn"):
        Live("steinway45")


def test_a_file_that_comes_twice_is_there_once_and_its_toml_describes_it(tmp_path):
    uploads, data = Uploads(tmp_path), b"t,a\n0,1\n1,2\n"
    first = uploads.add("rig.csv", data)
    assert uploads.add("rig.csv", data) == first
    assert uploads.add("rig.csv", data + b"2,3\n")["file"] != first["file"]
    assert uploads.add("rig.toml", b'time_unit = "ms"\n') == {"describes": ["rig.csv"] * 2}
    assert uploads.add("late.toml", b'time_unit = "s"\n') == {"describes": []}
    late = uploads.add("late.csv", data)
    paths = list(uploads.kept([first["file"], late["file"]]))
    texts = [path.with_suffix(".toml").read_text() for path in paths]
    assert texts == ['time_unit = "ms"\n', 'time_unit = "s"\n']
    with pytest.raises(InvalidParameter, match="drop a measured file first"):
        uploads.kept([])
