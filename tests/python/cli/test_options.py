"""Options with units and lists: each takes what the others take."""

import re
from pathlib import Path

import click
import pytest

from feltmb.cli import cli
from unmodeled.cli.options import ListOption, Quantity, split_list

UNIT = re.compile(r"\[(m|m\^2|s|rad|Hz|Pa|N/m|N|kg)\]")


def commands(command=cli, name="feltmb"):
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for child in command.list_commands(context):
            yield from commands(command.get_command(context, child), f"{name} {child}")


OPTIONS = [
    pytest.param(option, id=f"{name} {option.opts[-1]}")
    for name, command in commands()
    for option in command.params
    if isinstance(option, click.Option)
]


@pytest.mark.parametrize("option", OPTIONS)
def test_options_with_a_unit_take_it(option):
    kinds = getattr(option.type, "types", (option.type,))
    for kind in kinds:
        assert kind not in (click.FLOAT, click.INT)
        assert not isinstance(kind, click.FloatRange) or isinstance(kind, Quantity)
    found = UNIT.search(option.help or "")
    if found:
        for kind in kinds:
            assert isinstance(kind, Quantity)
            assert kind.unit == found.group(1)


@pytest.mark.parametrize("option", [o for o in OPTIONS if o.values[0].multiple])
def test_lists_are_taken_alike(option):
    assert isinstance(option, ListOption)
    context = click.Context(click.Command("any"))
    if isinstance(option.type, Quantity):
        assert option.type_cast_value(context, ("0.1,0.2", "0.3")) == (0.1, 0.2, 0.3)
        return
    together = option.type_cast_value(context, ("first=1,second=2", "third=3"))
    kind = Path if isinstance(option.type, click.Path) and option.type.type is Path else str
    assert together == (kind("first=1"), kind("second=2"), kind("third=3"))


@pytest.mark.parametrize(
    ("text", "items"),
    [
        ("a,b", ["a", "b"]),
        ("a , b", ["a", "b"]),
        ("channels=key,hammer", ["channels=key,hammer"]),
        ("channels=key,hammer,rtol=1e-3", ["channels=key,hammer", "rtol=1e-3"]),
        ('law={name="x", felt="y"}', ['law={name="x", felt="y"}']),
        ("contacts.*.law=mean,p=[1, 2]", ["contacts.*.law=mean", "p=[1, 2]"]),
    ],
)
def test_what_a_list_is(text, items):
    assert split_list(text) == items


def test_an_empty_item_is_refused():
    with pytest.raises(ValueError, match="none of them empty"):
        split_list("a,,b")
