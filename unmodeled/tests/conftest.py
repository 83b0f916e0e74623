"""Shared by all tests of unmodeled."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import pytest

ROOT = Path(__file__).resolve().parents[2]

# The benches use unmodeled and are no part of it.
sys.path.insert(0, str(ROOT / "bench"))


def pytest_configure(config):
    """Random examples of each property: few by default, many where slow tests run too."""
    from hypothesis import settings

    few = config.getoption("markexpr") == "not slow"
    settings.register_profile("unmodeled", max_examples=25 if few else 200, deadline=None)
    settings.load_profile("unmodeled")


@pytest.fixture(scope="session")
def root():
    """Top folder of the repository."""
    return ROOT
