"""Contacts, lengths and names that no mechanism has."""

from pathlib import Path

import pytest

import feltmb
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import parse_toml

PENDULUM = (Path(__file__).resolve().parents[2] / "data" / "pendulum.toml").read_text()


@pytest.mark.parametrize("contact", ["99", "99.0", "1e12", "3.5"])
def test_a_contact_that_does_not_exist_is_a_fault(contact):
    with pytest.raises(InvalidParameter):
        feltmb.Action(parse_toml(f"{PENDULUM}\n[events.e]\ncontact = {contact}\n"
                                 'change = "opens"\n', "a"))  # fmt: skip


def test_a_length_beyond_reason_is_refused():
    action = feltmb.Action(parse_toml(PENDULUM, "a"))
    name = next(iter(action.raw["points"]))
    with pytest.raises(InvalidParameter, match="1e\\+06 m"):
        action.with_values({f"points.{name}.point": [1e12, 0.0]})


def test_names_are_shortened():
    assert len(str(InvalidParameter("there is no " + "a" * 5000 + " here"))) < 230


def test_a_name_longer_than_a_file_name_can_be():
    long = "a" * 5000
    action = feltmb.Action(parse_toml(PENDULUM, "a"))
    with pytest.raises(Error):
        feltmb.felt.audit_targets(long)
    with pytest.raises(Error):
        feltmb.sweep(action, "forte", {"arm.mass": [0.1]}, folder=long)
