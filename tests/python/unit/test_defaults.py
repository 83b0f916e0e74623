"""Defaults of the command line are those of Python."""

from dataclasses import fields

import pytest

from feltmb.cli.gap import run
from feltmb.gap import Options

NAMES = {"alpha", "credibility", "form", "max_effects", "bootstrap", "seed"}


@pytest.mark.parametrize("name", sorted(NAMES))
def test_options_of_a_diagnosis_have_one_default(name):
    (option,) = [p for p in run.params if p.name == name]
    (field,) = [f for f in fields(Options) if f.name == name]
    assert option.default == field.default
