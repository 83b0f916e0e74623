"""The command touch: numbers before and after a change."""

import re
import sys
from types import SimpleNamespace

from click.testing import CliRunner

from feltmb.action.touch import Touch, TouchRow
from feltmb.cli import cli


def _call(*arguments):
    result = CliRunner(env={"COLUMNS": "80"}).invoke(cli, [str(a) for a in arguments])
    return result, str(result.exception or "")


def test_touch_shows_before_and_after(monkeypatch):
    def fake(action, **_):
        weight = 50.0 + 100.0 * action.config.bodies["key"].friction.viscous
        rows = (TouchRow("a", "down-weight", weight, "gf"), TouchRow("b", "key dip", None, "mm"))
        return Touch(action, rows, SimpleNamespace(window=(0.0, 0.0)), None, (), {})

    monkeypatch.setattr(sys.modules["feltmb.action.touch"], "touch", fake)
    plain = _call("touch", "steinway45")[0].stdout
    assert "here" in plain
    assert "before" not in plain
    changed = _call("touch", "steinway45", "--set", "bodies.key.friction.viscous=0.3")[0].stdout
    assert "before" in changed
    assert "after" in changed
    assert re.search(r"down-weight +50\.0 +80\.0 +gf", changed)
    other = _call("touch", "steinway45", "--before", "steinway45_printed")[0].stdout
    assert "touch of steinway45, before: steinway45_printed" in other
