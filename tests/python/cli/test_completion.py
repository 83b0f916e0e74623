"""Completion in the shell: names of packaged data, of laws and of effects."""

import pytest
from click.shell_completion import BashComplete

from feltmb import load_action, simulate
from feltmb.cli import cli, completing
from feltmb.mechanism import apply_values


def completed(line, monkeypatch):
    """What bash would offer for the last word of a line."""
    words = line.split(" ")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    complete = BashComplete(cli, {}, "feltmb", "_FELTMB_COMPLETE")
    return [item.value for item in complete.get_completions(words[1:-1], words[-1])]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("feltmb stroke steinway45_f", ["steinway45_felt", "steinway45_felt_hammer"]),
        ("feltmb stroke steinway45 fo", ["forte", "forte_finger"]),
        ("feltmb stroke steinway45 --actuator al", ["aluminum"]),
        ("feltmb regulate steinway45 --targets steinway45_s", ["steinway45_shipped"]),
        ("feltmb felt envelope synthetic_h", ["synthetic_hammer"]),
        ("feltmb fiber fit --model van", ["van_wyk"]),
        ("feltmb gap diagnose steinway45 a.csv --include coulomb_friction.w", None),
        ("feltmb gap diagnose own.py a.csv --include coulomb", []),
    ],
)
def test_names_are_completed(line, wanted, monkeypatch):
    found = completed(line, monkeypatch)
    if "--include" in line:
        assert found == (["coulomb_friction.whippen"] if wanted is None else wanted)
        return
    # The word itself stands for files: shells list them where no name fits.
    assert found == [line.split(" ")[-1], *wanted]


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
