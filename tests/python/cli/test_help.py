"""The help of every command: ranges of numbers, lines of lists that are whole, 80 columns."""

import click
import pytest
from calls import command
from click.testing import CliRunner

from feltmb.cli import cli


def commands(command=cli, name="feltmb"):
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for child in command.list_commands(context):
            yield from commands(command.get_command(context, child), f"{name} {child}")


ALL = dict(commands())


def test_numbers_say_their_range():
    plain = {
        (name, parameter.name)
        for name, command in ALL.items()
        for parameter in command.params
        if parameter.type in (click.FLOAT, click.INT)
    }
    assert plain == set()


@pytest.mark.parametrize("name", ALL)
def test_help_is_whole_and_fits(name):
    words = [*name.split()[1:], "--help"]
    text = CliRunner().invoke(cli, words, terminal_width=80, max_content_width=80).output
    assert text.startswith("Usage: ")
    assert max(map(len, text.splitlines())) <= 80
    lists = text.partition("\nCommands:\n")[2]
    assert "..." not in lists


@pytest.mark.parametrize("text", ["nan", "inf", "-inf"])
def test_numbers_are_finite(text):
    result = CliRunner().invoke(cli, ["stroke", "steinway45", "forte", "--duration", text])
    assert result.exit_code == 2
    assert f"got '{text}', expected a finite number" in result.output


def test_a_null_character_is_refused(capsys):
    from feltmb.cli import main

    with pytest.raises(SystemExit) as stop:
        main(["show", "a\0b"])
    assert stop.value.code == 2
    assert "null character" in capsys.readouterr().err


def test_help_of_the_actuator_writes_a_mass_with_its_unit():
    told = command("actuator", "--help").output
    assert "tip.mass=0.05" not in told
    assert "tip.mass=1.5g" in told
    from feltmb.action.actuator import load_actuator

    assert load_actuator("wood").with_values({"tip.mass": "1.5g"}).config.tip.mass == 0.0015
