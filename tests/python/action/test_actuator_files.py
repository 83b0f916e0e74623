"""Files of an actuator run."""

from pathlib import Path

import pytest

from unmodeled.errors import Error


def test_an_actuator_run_is_written_as_one_text_of_bytes(tmp_path, monkeypatch):
    from feltmb.action.actuator import ActuatorRun

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ActuatorRun, "_variables", lambda _: [])
    monkeypatch.setattr(ActuatorRun, "_attributes", lambda _: {})
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(Error, match="No space"):
        ActuatorRun.__new__(ActuatorRun).save(tmp_path / "a.nc")
    assert not list(tmp_path.iterdir())
