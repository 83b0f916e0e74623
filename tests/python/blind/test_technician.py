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
        ({"coulomb_friction.butt": 2.1e-3}, [True, True, True]),
        ({"joint_friction.butt": 1.15}, [True, True, True]),
        ({"coulomb_friction.butt": 2.1e-3, "input_delay": 2.1e-4}, [True, True, True, True]),
        ({"coulomb_friction.butt": 2.1e-3, "input_delay": 9e-4}, [False, True, True, True]),
        ({"coulomb_friction.butt": 2.1e-3, "coulomb_friction.key": 1e-3}, [False, True, True]),
        ({}, [False, False, False]),
    ],
)
def test_a_parameter_and_the_effect_on_it_are_one_answer(tmp_path, changes, right):
    rows = [{"name": n, "size": v} for n, v in changes.items()]
    text = "The friction of the hammer butt joint differs by 120 %.\n\nChanges"
    assert [a.right for a in told(tmp_path, "friction", rows, text)] == right


def told(folder, fault, rows, text):
    report = {"changes": rows, "parameters": [{"name": "joint_friction.butt", "value": 1.2}]}
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")
    (folder / "report.txt").write_text(text, encoding="utf-8")
    return list(technician.told(folder, technician.FAULTS[fault]))


def test_an_equivalent_of_the_right_parameter_is_an_answer(tmp_path):
    text = "Either the stiffness of the butt spring or the friction of the hammer butt differs."
    spring = {"name": "spring.butt_spring", "size": -0.14}
    rows = [{"name": "joint_friction.butt", "size": -0.2, "equivalents": [spring]}]
    assert all(a.right for a in told(tmp_path, "spring", rows, text))
    assert not all(a.right for a in told(tmp_path, "spring", rows, "No cause is missing."))


@pytest.mark.slow
@pytest.mark.parametrize("names", [("regulation",), ("lead",), ("friction", "customer")])
def test_slow_chapters(tmp_path, names):
    found = technician.run(names, tmp_path)
    assert [(name, a.what, a.found, a.truth) for name, a in found if not a.right] == []
