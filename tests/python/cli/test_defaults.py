"""Defaults of the command line are those of Python."""

import click
import pytest

from unmodeled import Options
from unmodeled.cli.diagnose import run


@pytest.mark.parametrize("name", ["credibility", "prior", "max_effects", "seconds"])
def test_options_of_a_diagnosis_have_one_default(name):
    (option,) = [p for p in run.params if p.name == name]
    context = click.Context(run)
    default = option.type_cast_value(context, option.get_default(context))
    assert default == getattr(Options(), name)
