"""Defaults of the command line are those of Python."""

from dataclasses import fields

from feltmb.cli.gap import run
from feltmb.gap import Options


def test_options_of_a_diagnosis_have_one_default():
    own = {f.name: f.default for f in fields(Options)}
    given = {p.name: p.default for p in run.params if p.name in own and not p.multiple}
    assert given
    assert given == {name: own[name] for name in given}
