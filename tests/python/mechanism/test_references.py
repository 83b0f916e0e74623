"""Files that a mechanism names: beside it, below it, nowhere else."""

from pathlib import Path

import pytest
from calls import refused

import feltmb

DATA = Path(__file__).parents[2] / "data"


@pytest.mark.parametrize("name", ["../base.toml", "/etc/passwd.toml", "a/../../base.toml"])
def test_references_stay_beside_their_file(tmp_path, name):
    (tmp_path / "base.toml").write_text((DATA / "pendulum.toml").read_text())
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "mine.toml").write_text(f'schema = 1\nname = "a"\nextends = "{name}"\n')
    refused(lambda: feltmb.load_action(inner / "mine.toml"), "extends", "in the folder of this")
    (inner / "felt.toml").write_text(f'schema = 1\n[contacts.01]\nlaw = {{ felt = "{name}" }}\n')
    refused(lambda: feltmb.load_action(inner / "felt.toml"), "felt", "in the folder of this")


def test_extends_may_lead_to_a_folder_below(tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "base.toml").write_text((DATA / "pendulum.toml").read_text())
    mine = tmp_path / "mine.toml"
    mine.write_text('schema = 1\nname = "mine"\nextends = "below/base.toml"\n')
    assert feltmb.load_action(mine).name == "mine"


def test_files_that_extend_one_another_without_end(tmp_path):
    # RecursionError
    for i in range(60):
        (tmp_path / f"{i}.toml").write_text(f'schema = 1\nname = "a"\nextends = "{i + 1}.toml"\n')
    refused(lambda: feltmb.load_action(tmp_path / "0.toml"), "more than 20 files")


def test_a_run_cannot_name_a_file_of_published_numbers(pendulum):
    from feltmb.run.published import compare_with_published

    run = feltmb.simulate(pendulum, "staccato", 0.001)
    run.provenance["action"] = "../../../tests/data/pendulum"
    assert compare_with_published(run) == []


def test_a_run_cannot_name_a_felt_in_a_file(pendulum):
    from feltmb.graphics.plot.readings import run_action

    run = feltmb.simulate(pendulum, "staccato", 0.001)
    run.provenance["toml"] = '[contacts.01]\nmicromechanical = { felt = "/etc/x.toml" }\n'
    refused(lambda: run_action(run), "a saved run names no file")


@pytest.mark.parametrize("name", ["../outside.mech", "/outside.mech", "sub/../../x"])
def test_extends_of_any_ending_stays_beside_its_file(tmp_path, name):
    (tmp_path / "inner").mkdir()
    (tmp_path / "outside.mech").write_text("schema = 1")
    path = tmp_path / "inner" / "a.toml"
    path.write_text(f'schema = 1\nname = "a"\nextends = "{name}"\n')
    refused(lambda: feltmb.load_action(path), "in the folder of this file or below")
