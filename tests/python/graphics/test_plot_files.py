"""Files of pictures."""

from pathlib import Path

import pytest

import feltmb
from unmodeled.files import parse_toml

PENDULUM = (Path(__file__).resolve().parents[2] / "data" / "pendulum.toml").read_text()


@pytest.fixture(scope="module")
def run():
    stroke = feltmb.pulse_stroke(1.0, 0.0, 0.005, 0.005, duration=0.02)
    return feltmb.simulate(feltmb.Action(parse_toml(PENDULUM, "a")), stroke, output_rate=1000.0)


def test_plots_are_drawn_before_one_is_written(run, tmp_path, monkeypatch):
    from feltmb.graphics.plot import files

    def refuse(_):
        raise RuntimeError("x")

    monkeypatch.setattr(files, "PICTURES", {"motion": files.motion, "energy": refuse})
    with pytest.raises(RuntimeError):
        files.save_all(run, tmp_path / "out", "a")
    assert not (tmp_path / "out").exists()
