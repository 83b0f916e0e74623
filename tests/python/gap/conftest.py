"""What tests of the diagnosis share."""

import importlib

import pytest

from feltmb.gap.decide import decide


@pytest.fixture
def decided(monkeypatch):
    """Facts of every decision that a diagnosis takes, in their order."""
    seen = []
    module = importlib.import_module("feltmb.gap.diagnosis")  # the package has a function diagnose
    monkeypatch.setattr(module, "decide", lambda facts: seen.append(facts) or decide(facts))
    return seen
