"""Calls that several tests make: refused functions, commands, short strokes."""

import pytest
from click.testing import CliRunner

import feltmb
from feltmb.cli import cli, main
from unmodeled.errors import Error


def refused(call, *parts):
    """Message of the InvalidParameter that ``call`` raises; it contains ``parts``."""
    with pytest.raises(feltmb.InvalidParameter) as caught:
        call()
    for part in parts:
        assert part in str(caught.value)
    return str(caught.value)


def command(*arguments):
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def refusal(*arguments):
    """Message of a command that is refused."""
    done = command(*arguments)
    assert done.exit_code != 0
    assert isinstance(done.exception, (Error, SystemExit)), done.exception
    return str(done.exception) + done.output


def stroke_command(*arguments):
    """Run ``feltmb stroke`` and return its exit code."""
    with pytest.raises(SystemExit) as caught:
        main(["stroke", *map(str, arguments)])
    return caught.value.code


def short_strike(path, name):
    path.write_text(f'schema = 1\nname = "{name}"\nduration = 0.002\n[ramp]\nforce = 1.0\n'
                    "start = 0.0\nramp = 0.001\n")  # fmt: skip
    return path
