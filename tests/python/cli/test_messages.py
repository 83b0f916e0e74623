"""Messages and output: printable, short, in one place; a closed pipe is no fault."""

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from calls import refused

import feltmb
from feltmb.cli import main

DATA = Path(__file__).parents[2] / "data"


def folder(path):
    path.mkdir()


ODD = "a\x1b]0;owned\x07b\x9bc\u202ed"


@pytest.mark.parametrize("odd", ["\x1b", "\x9b", "\u202e", "\u2066", "\x7f", "\r", "\u200f"])
def test_names_with_control_characters_are_refused(tmp_path, odd):
    text = (DATA / "pendulum.toml").read_text()
    path = tmp_path / "a.toml"
    code = f"\\u{ord(odd):04x}"
    for change in (
        text.replace('name = "', f'name = "{code}', 1),
        text + f'\n[points."p{code}"]\nbody = "arm"\npoint = [0.0, 0.0]\n',
        text + f'\n[points.p]\nbody = "arm"\npoint = [0.0, 0.0]\nlabel = "{code}"\n',
    ):
        assert change != text
        path.write_text(change)
        said = refused(lambda: feltmb.load_action(path), f"U+{ord(odd):04X}")
        assert odd not in said


def test_messages_are_printable_and_short():
    error = feltmb.InvalidParameter(f"file {ODD * 100_000}: bad\nsecond line")
    said = str(error)
    assert said.isprintable() or set(said) - {"\n"} <= {c for c in said if c.isprintable()}
    assert len(said) < 5000
    assert "cut" in said
    assert str(feltmb.InvalidParameter("short\ttext\nof two lines é")).endswith("lines é")


def test_the_end_of_a_long_line_is_kept():
    said = str(feltmb.DataError(f"{'a' * 3000}: there is no such file"))
    assert said.endswith(": there is no such file")
    assert len(said) < 1100


@pytest.mark.parametrize(
    "words",
    [
        ["validate", "{file}"],
        ["show", "{file}"],
        ["stroke", "{file}", "piano"],
        ["stroke", "steinway45", "{file}"],
        ["validate", "{run}"],
        ["plot", "{run}", "--compare", ODD],
        ["gap", "diagnose", ODD, "{file}"],
        ["felt", "audit", ODD],
        ["list", ODD],
        [ODD],
    ],
)
def test_no_command_prints_control_characters(tmp_path, run_file, monkeypatch, words):
    path = tmp_path / f"{ODD.replace('/', '')}.toml"
    path.write_text('schema = 1\nname = "\\u001b\\u009b\\u202e"\n"\\u001b[2J" = 1\n')
    with h5py.File(run_file, "a") as file:
        for key, value in {"message": ODD, "status": ODD}.items():
            del file.attrs[key]
            file.attrs[key] = ODD + value
        told = json.loads(file.attrs["provenance"]) | {"action": ODD}
        file.attrs["provenance"] = json.dumps(told)
    words = [w.format(file=path, run=run_file) if "{" in w else w for w in words]
    monkeypatch.chdir(tmp_path)
    out = io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(out),
        contextlib.suppress(SystemExit),
    ):
        main(words)
    said = out.getvalue()
    assert said
    for letter in ODD + "\x1b\x9b\u202e":
        assert letter.isprintable() or letter not in said, said


def test_tables_and_lines_are_printed_at_one_place():
    folder = Path(feltmb.__file__).parent / "cli"
    direct = [
        p.name
        for p in folder.rglob("*.py")
        if p.name not in ("screen.py", "__init__.py")
        and ("click.echo(" in p.read_text() or "import Console" in p.read_text())
    ]
    assert not direct


def test_tables_show_escapes(capsys):
    from unmodeled.cli.screen import console, say
    from unmodeled.tables import new_table

    table = new_table(ODD, ODD)
    table.add_row(ODD)
    console().print(table)
    console().print(ODD)
    say(ODD)
    said = capsys.readouterr().out
    assert all(c.isprintable() or c == "\n" for c in said)
    assert "\\u001b" in said


def test_a_closed_pipe_ends_a_command_quietly():
    process = subprocess.Popen(
        [sys.executable, "-m", "feltmb", "list", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(60) == 0
