"""What all commands have in common: options, JSON, tables at 80 columns, no color when piped."""

import json
import os
import subprocess
import sys

import click
import pytest

import feltmb
from feltmb.cli import cli, main


def commands(command=cli, path=()):
    """Every command with its path."""
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            yield from commands(command.get_command(context, name), (*path, name))
    else:
        yield path, command


ALL = dict(commands())


def options(command):
    return {name for p in command.params if isinstance(p, click.Option) for name in p.opts}


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_every_command_speaks_json_and_has_a_help(path):
    command = ALL[path]
    assert "--json" in options(command)
    assert command.help
    first = command.help.strip().splitlines()[0]
    assert first[0].isupper()
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, (path, parameter.opts)
            assert parameter.help.strip().endswith("."), (path, parameter.opts)


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_files_are_written_by_one_pair_of_options(path):
    found = options(ALL[path])
    assert "--output" not in found
    # The demo replaces its own files; the bench goes on with its own.
    if "--out" in found and path not in {("demo",), ("gap", "blind")}:
        assert {"-o", "--force"} <= found


def called(capsys, *arguments):
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    said = capsys.readouterr()
    return end.value.code, said.out, said.err


@pytest.mark.parametrize(
    "arguments",
    [
        ["list"],
        ["show", "steinway45"],
    ],
)
def test_json_is_all_of_stdout(capsys, arguments):
    code, out, _ = called(capsys, *arguments, "--json")
    assert code == 0
    assert json.loads(out)


def test_json_of_tables_holds_numbers(capsys):
    sizes = ["--thickness", "6mm", "--area", "constant:100mm^2"]
    code, out, _ = called(capsys, "felt", "envelope", "synthetic_hammer", *sizes, "--json")
    assert code == 0
    (table,) = json.loads(out)["tables"]
    assert isinstance(table["rows"][0]["loading [N]"], float)


def test_json_of_writers_names_the_files(capsys, tmp_path):
    path = tmp_path / "m.toml"
    code, out, err = called(capsys, "new", str(path), "--json")
    assert code == 0
    assert json.loads(out) == {"written": [str(path)]}
    assert "wrote" in err
    code, out, err = called(capsys, "new", str(path), "--json")
    assert code == 2
    assert out == ""
    assert "exists already" in err


def test_json_of_validate_tells_every_file(capsys, tmp_path):
    good, bad = tmp_path / "a.toml", tmp_path / "b.toml"
    called(capsys, "new", str(good))
    bad.write_text("schema = 1\n")
    code, out, _ = called(capsys, "validate", str(good), str(bad), "--json")
    assert code == 2
    found = json.loads(out)
    assert [f["ok"] for f in found] == [True, False]
    assert "is neither a stroke nor a mechanism" in found[1]["text"]


@pytest.mark.parametrize(
    "arguments",
    [["list"], ["show", "steinway45"], ["-h"]],
)
def test_piped_tables_are_plain_and_fit_80_columns(arguments):
    done = subprocess.run(
        [sys.executable, "-m", "feltmb", *arguments],
        capture_output=True,
        text=True,
        check=True,
        env={**__import__("os").environ, "COLUMNS": "80"},
    )
    assert "\x1b" not in done.stdout + done.stderr
    assert max(len(line) for line in done.stdout.splitlines()) <= 80


@pytest.mark.parametrize(
    ("arguments", "limit"),
    [
        (["felt", "contact", "x.csv", "--points", "1000000000000"], "100000"),
        (["fiber", "simulate", "x", "--fibers", "1000000000000"], "100000"),
        (["stroke", "steinway45", "forte", "--output-rate", "1e15"], "the limit is"),
    ],
)
def test_sizes_beyond_reason_are_refused_with_the_limit(capsys, arguments, limit):
    # taken until the memory ended: "not enough memory"
    code, out, err = called(capsys, *arguments)
    assert code == 2
    assert limit in err
    assert out == ""


def test_a_sweep_beyond_reason_is_refused_with_the_limit(data):
    # walked through 1e9 points before the first simulation
    mass = {"from": 0.01, "to": 0.02, "count": 10_000}
    with pytest.raises(
        feltmb.InvalidParameter, match="grid of 100000000 points; the limit is 1000"
    ):
        feltmb.sweep(str(data / "pendulum.toml"), "forte", {"arm.mass": mass, "arm.inertia": mass})
    with pytest.raises(feltmb.InvalidParameter, match="a count of 1 to 1000000"):
        feltmb.sweep(str(data / "pendulum.toml"), "forte", {"arm.mass": mass | {"count": 10**12}})


def run_feltmb(*arguments, columns=None, **variables):
    environment = {k: v for k, v in os.environ.items() if k != "COLUMNS"} | variables
    if columns is not None:
        environment["COLUMNS"] = str(columns)
    return subprocess.run(
        [sys.executable, "-m", "feltmb", *arguments],
        capture_output=True, text=True, check=False, env=environment,
    )  # fmt: skip


def test_a_piped_table_breaks_no_name():
    # at 80 columns "bodies.balance_slider.friction.threshold_spe" and "ed" were two lines
    out = run_feltmb("show", "steinway45", "--values").stdout
    assert " bodies.balance_slider.friction.threshold_speed " in out
    assert "standard value, as in the thesis's mechanism" in out
    narrow = run_feltmb("show", "steinway45", "--values", columns=80).stdout
    assert max(len(line) for line in narrow.splitlines()) <= 80
    assert " bodies.balance_slider.friction.threshold_speed " in narrow


@pytest.mark.parametrize(
    ("words", "expected"),
    [("feltmb g", "gap"), ("feltmb gap d", "diagnose"), ("feltmb stroke --pl", "--plot"),
     ("feltmb stroke --method c", "cvode")],
)  # fmt: skip
def test_the_shell_completes(words, expected):
    count = str(len(words.split()) - 1)
    done = run_feltmb(_FELTMB_COMPLETE="bash_complete", COMP_WORDS=words, COMP_CWORD=count)
    assert f"plain,{expected}" in done.stdout.splitlines()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["view"], "feltmb: Missing argument 'RUNS...'."),
        (["strok"], "feltmb: No such command 'strok'. Did you mean 'stroke'?"),
        (["stroke", "--rtol", "x"], "feltmb: Invalid value for '--rtol'"),
    ],
)
def test_wrong_calls_are_told_like_all_else(capsys, arguments, text):
    code, out, err = called(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("Usage: feltmb")
    assert text in err


@pytest.mark.parametrize(
    ("contact", "text"),
    [
        ("steinway45:99", "contact '99' of steinway45 does not exist: expected one of 01, 02,"),
        ("steinway45", "'steinway45' names no contact: expected one of 01, 02,"),
        ("nothing:06", "'nothing:06' is no mechanism"),
    ],
)
def test_felt_fit_does_not_speak_of_audits(capsys, contact, text):
    arguments = ["--area", "constant:4cm^2", "--fibers", "synthetic_hammer"]
    code, _, err = called(capsys, "felt", "fit", contact, *arguments)
    assert code == 2
    assert text in err
    assert "audit" not in err
    assert "--all" not in err
