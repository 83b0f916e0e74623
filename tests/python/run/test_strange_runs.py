"""Runs with strange mechanisms; gradients without end."""

import json
from pathlib import Path

import h5py
import pytest

import feltmb
from feltmb.graphics.plot.readings import run_action
from feltmb.run.reading import strike_words
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import parse_toml

PENDULUM = (Path(__file__).resolve().parents[2] / "data" / "pendulum.toml").read_text()


@pytest.mark.parametrize("options", [{"duration": 1e6}, {"tolerance": 1e-17}])
def test_a_gradient_without_end_is_refused(options):
    action = feltmb.Action(parse_toml(PENDULUM, "a"))
    with pytest.raises(InvalidParameter, match="expected at most 100 s"):
        feltmb.gradient(action, "forte", "arm.mass", ["arm.angle"], **options)


@pytest.fixture(scope="module")
def run():
    stroke = feltmb.pulse_stroke(1.0, 0.0, 0.005, 0.005, duration=0.02)
    return feltmb.simulate(feltmb.Action(parse_toml(PENDULUM, "a")), stroke, output_rate=1000.0)


@pytest.mark.parametrize("text", [
    "a" + ".a" * 200_000 + "=1",
    "contacts = 5\n[reading]\nstrike_contact = 6\n",
    "[contacts.06]\nsurfaces = 5\n[reading]\nstrike_contact = 6\n",
])  # fmt: skip
def test_a_strange_mechanism_in_a_run_is_refused_and_nothing_is_written(text, run, tmp_path):
    path = run.save(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        provenance = json.loads(file.attrs["provenance"])
        file.attrs["provenance"] = json.dumps(provenance | {"toml": text})
    strange = feltmb.load_run(path)
    assert strike_words(strange) == strike_words(strange)  # no exception
    with pytest.raises(Error):
        run_action(strange)
    assert [p.name for p in tmp_path.iterdir()] == ["a.nc"]
