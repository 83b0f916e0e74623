"""Shared by all tests: the packaged action, files of the tests, runs made once."""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

import feltmb

DATA = Path(__file__).resolve().parents[1] / "data"
ROOT = DATA.parents[1]


@pytest.fixture(scope="session")
def data():
    """Folder of the tests' own mechanisms."""
    return DATA


@pytest.fixture(scope="session")
def root():
    """Top folder of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def action():
    """The packaged action."""
    return feltmb.load_action("steinway45")


@pytest.fixture(scope="session")
def pendulum():
    """An invented mechanism, from its own file."""
    return feltmb.load_action(DATA / "pendulum.toml")


@functools.cache
def _run(values, stroke, options):
    action = feltmb.load_action("steinway45")
    if values:
        action = action.with_values(dict(values))
    return feltmb.simulate(action, stroke, **dict(options))


@pytest.fixture(scope="session")
def run_of():
    """run_of(stroke, values={...}, rtol=...): a run of steinway45, made once a session."""

    def make(stroke, values=None, **options):
        return _run(tuple((values or {}).items()), stroke, tuple(sorted(options.items())))

    return make


@pytest.fixture(scope="session")
def state_of():
    """state_of(action, q, qd): something to start from, with the string at rest."""

    def make(action, q, qd, string=None):
        still = feltmb.ramp_stroke(0.0, duration=1e-7)
        run = feltmb.simulate(action, still, events=False, ledger=False)
        rest = np.zeros(2 * action.mechanism.total_modes) if string is None else string
        return dataclasses.replace(run, end_state=np.concatenate([q, qd, rest]))

    return make
