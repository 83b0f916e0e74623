"""Models that end the program, and exit codes."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

import feltmb
import unmodeled
from feltmb.cli import main
from feltmb.cli import main as package_main


def folder(path):
    path.mkdir()


def test_a_model_that_ends_the_program(tmp_path):
    # ended with code 0 and no word
    model = tmp_path / "model.py"
    model.write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "a.csv").write_text("t,q\n0,1\n1,2\n")
    for words in (["gap", "diagnose"], ["fit"]):
        done = subprocess.run(
            [sys.executable, "-m", "feltmb", *words, "model.py", "a.csv"],
            capture_output=True, text=True, cwd=tmp_path, check=False,
        )  # fmt: skip
        assert done.returncode == 2
        assert "model.py: ends the program (exit code 0)" in done.stderr


def test_a_model_that_ends_the_program_later(tmp_path, monkeypatch, capsys):
    from feltmb import cli as package

    script = tmp_path / "late.py"
    script.write_text("import sys\ndef stop(*a, **k):\n    sys.exit(0)\n")
    space: dict[str, object] = {}
    exec(compile(script.read_text(), str(script), "exec"), space)
    monkeypatch.setattr(package.cli, "main", space["stop"])
    with pytest.raises(SystemExit) as end:
        package.main(["list"])
    assert end.value.code == 1
    assert "late.py, line 3: ends the program (exit code 0)" in capsys.readouterr().err


def test_no_command_ends_the_program_itself():
    folders = [Path(m.__file__).parent for m in (feltmb, unmodeled)]
    own = [p.name for f in folders for p in f.rglob("*.py") if "sys.exit(" in p.read_text()]
    # The end of the command lines, and that of a process of its own for a model.
    assert sorted(own) == ["apart.py", "running.py"]


def test_commands_with_codes_of_their_own_still_end_with_them(capsys):
    with pytest.raises(SystemExit) as end:
        package_main(["fiber", "law", "van_wyk", "-p", "nothing=1"])
    assert end.value.code == 2
    assert "ends the program" not in capsys.readouterr().err


def test_picture_of_unknown_kind(tmp_path, capsys):
    # ValueError: Format 'abc' is not supported
    with pytest.raises(SystemExit) as caught:
        main(["show", "steinway45", "--plot", str(tmp_path / "x.abc")])
    assert caught.value.code == 2
    assert "expected .png, .pdf or .svg" in capsys.readouterr().err


def test_version_without_an_installed_package(capsys, monkeypatch):
    # RuntimeError: 'feltmb' is not installed, from a folder of sources
    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.version", absent)
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert feltmb.__version__ in capsys.readouterr().out


def test_unreachable_pose_is_bad_input(tmp_path, capsys):
    # `feltmb stroke` exited with 1, `feltmb validate` with 2.
    action = feltmb.load_action("steinway45")
    text = feltmb.Action(
        {
            **action.raw,
            "contacts": {k: {**c, "enabled": False} for k, c in action.raw["contacts"].items()},
        }
    ).to_toml()
    path = tmp_path / "falls.toml"
    path.write_text(text)
    with pytest.raises(SystemExit) as stop:
        main(["stroke", str(path), "piano"])
    assert stop.value.code == 2
    assert "no rest pose" in capsys.readouterr().err
