"""The technician's day: each number of the program is that of its truth."""

import json

import pytest

from stories import technician


def test_fast_chapters(tmp_path):
    found = technician.run(technician.FAST, tmp_path)
    assert len(found) >= 5
    assert [(name, a.what, a.found, a.truth) for name, a in found if not a.right] == []


def test_files_of_camera_and_cell_are_joined(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert next(technician.measured("one", {})).right


@pytest.mark.parametrize(
    ("changes", "right"),
    [
        ({"coulomb_friction.butt": 2.1e-3}, [True, True]),
        ({"joint_friction.butt": 1.15}, [True, True]),
        ({"coulomb_friction.butt": 2.1e-3, "input_delay": 2.1e-4}, [True, True, True]),
        ({"coulomb_friction.butt": 2.1e-3, "input_delay": 9e-4}, [False, True, True]),
        ({"coulomb_friction.butt": 2.1e-3, "coulomb_friction.key": 1e-3}, [False, True]),
        ({}, [False, False]),
    ],
)
def test_a_parameter_and_the_effect_on_it_are_one_answer(tmp_path, changes, right):
    rows = [{"name": n, "size": v} for n, v in changes.items()]
    report = {"changes": rows, "parameters": [{"name": "joint_friction.butt", "value": 1.2}]}
    (tmp_path / "report.json").write_text(json.dumps(report), encoding="utf-8")
    found = technician.told(tmp_path, *technician.FAULTS["friction"][1:])
    assert [a.right for a in found] == right


@pytest.mark.slow
@pytest.mark.parametrize("names", [("regulation",), ("lead",), ("friction", "customer")])
def test_slow_chapters(tmp_path, names):
    found = technician.run(names, tmp_path)
    assert [(name, a.what, a.found, a.truth) for name, a in found if not a.right] == []
