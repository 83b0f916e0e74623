"""Shared by all tests: the packaged action, files of the tests, runs made once."""

import dataclasses
import functools
import gc
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb.cli import cli

DATA = Path(__file__).resolve().parents[1] / "data"
ROOT = DATA.parents[1]

# The benches use feltmb and are no part of it.
sys.path.insert(0, str(ROOT / "bench"))
# What several tests call: calls.py, readers.py.
sys.path.insert(0, str(ROOT / "tests" / "helpers"))


#: Rigid members and one string: fast, and what the independent models of the tests describe.
RIGID = {"shank.rigid": True, "wire.rigid": True, "string.count": 1}
RIGID_STROKES = {
    "piano": feltmb.ramp_stroke(5.0, 0.083, 0.3475, duration=0.5, name="piano, rigid"),
    "forte": feltmb.ramp_stroke(25.0, 0.050, 0.0905, duration=0.4, name="forte, rigid"),
}


def pytest_configure(config):
    """Random examples of each property: few by default, many where slow tests run too."""
    from hypothesis import settings

    few = config.getoption("markexpr") == "not slow"
    settings.register_profile("feltmb", max_examples=25 if few else 200, deadline=None)
    settings.load_profile("feltmb")
    if not hasattr(config, "workerinput"):  # not again in each process of pytest-xdist
        _compile_extension()


def pytest_collection_finish():
    """The modules and tests stay to the end: walking through them again and again takes 7 %."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


def _compile_extension():
    """Compile the integrator of equations if it is missing or old, and there is a compiler."""
    import warnings

    from unmodeled.ode import compile, compiled

    if os.environ.get(compiled.OFF):
        return
    made = compile.SOURCE.with_name(compile.NAME)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of an old one
        old = compiled.library() is None
    if old or made.stat().st_mtime < compile.SOURCE.stat().st_mtime:
        try:
            compile.build()
            compiled.library.cache_clear()
        except (RuntimeError, OSError) as error:
            print(f"the integrator of equations runs in NumPy: {error}")


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
def rigid():
    """The packaged action with rigid members and one string: six coordinates."""
    return feltmb.load_action("steinway45").with_values(RIGID)


@pytest.fixture(scope="session")
def pendulum():
    """An invented mechanism, from its own file."""
    return feltmb.load_action(DATA / "pendulum.toml")


@functools.cache
def _run(values, stroke, flexible, options):
    action = feltmb.load_action("steinway45").with_values(dict(values))
    if not flexible:
        action = action.with_values(RIGID)
        stroke = RIGID_STROKES.get(stroke, stroke)
    return feltmb.simulate(action, stroke, **dict(options))


@pytest.fixture(scope="session")
def run_of():
    """run_of(stroke, values={...}, flexible=False, rtol=...): a run, made once a session.

    Of steinway45 with rigid members and one string, whose piano and forte have the ramps of the
    rigid model, or with ``flexible=True`` of the data set as it is.
    """

    def make(stroke, values=None, *, flexible=False, **options):
        given = tuple(sorted(options.items()))
        return _run(tuple((values or {}).items()), stroke, flexible, given)

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


@pytest.fixture(scope="module")
def saved(pendulum, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return feltmb.simulate(pendulum, "staccato", 0.001).save(folder / "run.nc").read_bytes()


@pytest.fixture
def run_file(saved, tmp_path):
    path = tmp_path / "run.nc"
    path.write_bytes(saved)
    return path


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """The mechanism that ``feltmb new`` writes."""
    path = tmp_path_factory.mktemp("new") / "t.toml"
    assert CliRunner().invoke(cli, ["new", str(path)]).exit_code == 0
    return path
