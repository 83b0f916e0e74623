"""Hints for unknown keys."""

import difflib

import pytest

from feltmb.mechanism import load_action
from unmodeled.errors import InvalidParameter
from unmodeled.units import quantity


def test_hints_are_made_only_for_faults_that_are_told(monkeypatch, tmp_path):
    asked = []
    kept = difflib.get_close_matches

    def counted(*args, **kwargs):
        asked.append(args[0])
        return kept(*args, **kwargs)

    monkeypatch.setattr(quantity.difflib, "get_close_matches", counted)
    path = tmp_path / "many.toml"
    path.write_text('name = "many"\n' + "".join(f"[t{i}]\na = 1\n" for i in range(3000)))
    with pytest.raises(InvalidParameter, match="3002 faults") as told:
        load_action(path)
    assert len(asked) <= quantity.MOST_FAULTS
    assert "t5: unknown key" in str(told.value)
