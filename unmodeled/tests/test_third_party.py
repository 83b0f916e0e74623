"""A package of a third party adds a simulator and a format of files by its entry points."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from unmodeled import loading
from unmodeled.cli import cli
from unmodeled.data import logs

PACKAGE = Path(__file__).resolve().parents[2] / "examples" / "third_party"


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The package as an installer leaves it: its module, and metadata with its entry points."""
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text("utf-8"))["project"]
    metadata = tmp_path / f"servo_lab-{project['version']}.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    groups = project["entry-points"].items()
    lines = [f"[{g}]\n{n} = {of}" for g, points in groups for n, of in points.items()]
    (metadata / "entry_points.txt").write_text("\n".join(lines))
    for place in (PACKAGE, tmp_path):
        monkeypatch.syspath_prepend(str(place))
    caches = (loading.extensions.cache_clear, logs._installed.cache_clear)
    for clear in caches:
        clear()
    yield tmp_path
    for clear in caches:
        clear()
    sys.modules.pop("servo_lab", None)


def write_runs(folder: Path) -> list[str]:
    """Runs of a servo whose gain is 6 % larger than stated."""
    from servo_lab import simulated

    time, files = np.arange(150) * 0.01, []
    for k in range(2):
        goal = 0.5 * np.sin(time * (3.0 + k)) * np.sin(time * (1.0 + 0.5 * k) + k)
        (angle,) = simulated(time, goal, np.array([[63.6, 2.0, 0.05]]))
        angle += 2e-4 * np.random.default_rng(k).standard_normal(time.size)
        files.append(str(folder / f"run_{k}.servo"))
        np.savetxt(files[-1], np.column_stack([time, np.degrees(goal), np.degrees(angle)]))
    return files


def test_its_model_and_its_files_are_fitted_by_their_names(installed):
    done = CliRunner().invoke(cli, ["fit", "servo-lab", *write_runs(installed), "--json"])
    assert done.exit_code == 0, done.output
    found = {p["name"]: p for p in json.loads(done.stdout)["parameters"]}
    assert 60.5 < found["gain"]["low"] < 63.6 < found["gain"]["high"] < 66.5


def test_a_bad_file_of_it_is_one_message(installed):
    (installed / "bad.servo").write_text("1 2\n")
    done = CliRunner().invoke(cli, ["diagnose", "servo-lab", str(installed / "bad.servo")])
    assert done.exit_code != 0
    assert "expected rows of time, goal and angle" in str(done.exception) + done.output
