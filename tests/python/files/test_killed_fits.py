"""Diagnoses on a full disk and in a closed folder."""

import multiprocessing
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import killing

FILES = ["remedy.toml", "report.html", "report.json", "report.txt"]


@pytest.fixture(scope="module")
def started():
    """Makes processes that have loaded what they need."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["feltmb.cli", "unmodeled", "feltmb.cli.gap", "killing"])
    return context


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    return killing.prepare(tmp_path_factory.mktemp("given"))


def outcome(started, given, folder, limit=0):
    """Exit code, and what was said on stderr."""
    here, there = started.Pipe()
    arguments = ["gap", "diagnose", *given, "--seconds", "5", "-o", str(folder)]
    process = started.Process(target=killing.work, args=(arguments, there, limit))
    process.start()
    there.close()
    try:
        code, said, _ = here.recv()
    finally:
        process.join()
    return code, said


def test_a_full_disk_gives_a_message_and_keeps_what_was_written(started, given, tmp_path):
    (tmp_path / "kept.txt").write_text("mine")
    code, said = outcome(started, given, tmp_path / "a", limit=900)
    assert code == 1, said
    assert "cannot be written: File too large" in said.splitlines()[-1]
    assert "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["kept.txt"]
    assert not [p for p in tmp_path.rglob(".feltmb*")]
    # With room it works in the same folder.
    code, said = outcome(started, given, tmp_path / "a")
    assert code == 0, said
    assert {p.name for p in (tmp_path / "a").iterdir()} >= set(FILES)


def test_a_place_that_cannot_be_written_is_told_before_the_work(started, given, tmp_path):
    # A file where a folder is needed: refused for every user, root too.
    (tmp_path / "file").write_text("mine")
    code, said = outcome(started, given, tmp_path / "file")
    assert code in (1, 2), said
    assert "cannot be written" in said or "is a file, expected a folder" in said
    assert "Traceback" not in said
    assert (tmp_path / "file").read_text() == "mine"
