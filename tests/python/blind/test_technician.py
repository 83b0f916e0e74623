"""The technician's day: each number of the program is that of its truth."""

import pytest

from stories import technician


def test_fast_chapters(tmp_path):
    found = technician.run(technician.FAST, tmp_path)
    assert len(found) >= 5
    assert [(name, a.what, a.found, a.truth) for name, a in found if not a.right] == []


def test_files_of_camera_and_cell_are_joined(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert next(technician.measured("one", {})).right


@pytest.mark.slow
@pytest.mark.parametrize("names", [("regulation",), ("lead",), ("friction", "customer")])
def test_slow_chapters(tmp_path, names):
    found = technician.run(names, tmp_path)
    assert [(name, a.what, a.found, a.truth) for name, a in found if not a.right] == []
