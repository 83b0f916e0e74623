"""Shared by all tests of unmodeled."""

import gc
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


def pytest_collection_finish():
    """The modules and tests stay to the end: walking through them again and again takes 7 %."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


@pytest.fixture(scope="session")
def root():
    """Top folder of the repository."""
    return ROOT
