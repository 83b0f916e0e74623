"""Forte strokes of parameter sets: done with a closed ledger, refused, or failed with a reason."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import parameter_sets

FAST = 16


def check(found):
    wrong = [o for o in found if o.status == "wrong"]
    assert not wrong, f"{len(wrong)} of {len(found)}: {wrong[:5]}"
    print(parameter_sets.table(found))
    assert any(o.status == "done" for o in found)


def test_some_sets():
    check(parameter_sets.outcomes(0, FAST))


@pytest.mark.slow
def test_many_sets():
    check(parameter_sets.outcomes(1000, 500))
