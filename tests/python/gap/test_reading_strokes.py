"""Measured files as instruments and trackers write them."""

import pytest

from feltmb.cli import main


def command(*arguments):
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    return stop.value.code


def put(folder, text, name="a.csv", encoding="utf-8"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def test_new_prints_how_to_join_two_files(tmp_path, capsys):
    path = put(tmp_path, "time [s],hammer_tip.x [mm]\n0,1\n1,2\n2,3\n")
    assert command("gap", "new", str(path), "--model", "steinway45") == 0
    assert "has no input of the model. If another file" in capsys.readouterr().err
