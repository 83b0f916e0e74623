"""Formulas and lists of studies."""

import pytest

import feltmb
from feltmb.cli import main
from feltmb.run.study.expression import Formula


def refused(call, *parts):
    """Message of the InvalidParameter that ``call`` raises."""
    with pytest.raises(feltmb.InvalidParameter) as caught:
        call()
    for part in parts:
        assert part in str(caught.value)
    return str(caught.value)


def test_word_of_a_formula_beyond_floats():
    # OverflowError: int too large to convert to float
    refused(lambda: Formula(f"peak({10**400})"), "is no formula")


def test_list_names_the_studies(capsys):
    # feltmb list said nothing of them
    with pytest.raises(SystemExit):
        main(["list"])
    listed = capsys.readouterr().out
    assert all(name in listed for name in feltmb.packaged_studies())
