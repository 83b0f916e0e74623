"""The engine of equations by itself: many jobs with derivatives, without a fit."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled.errors import DataError, InvalidParameter
from unmodeled.fit import Rate
from unmodeled.ode import Integrator

TIME = np.linspace(0.0, 2.0, 201)
FORCE = {"force": np.sin(9.0 * TIME)}
JOBS = np.array([[2.0, 40.0, 0.3], [1.5, 90.0, 0.1]])
STARTS = np.array([[0.02, 0.0], [0.0, -0.1]])


def rates(t, x, u, p):
    return x.v, (u.force - p.k * x.q - p.dry * np.tanh(x.v / 0.05)) / p.m


def spring(function=rates, **given):
    named = {"states": ["q", "v"], "parameters": ["m", "k", "dry"], "inputs": ["force"]}
    return Integrator(function, **{**named, "substeps": 4, **given})


def reference(theta, start):
    """With an adaptive method, whose inputs are linear between the samples too."""

    def slopes(t, x):
        force = np.interp(t, TIME, FORCE["force"])
        m, k, dry = theta
        return [x[1], (force - k * x[0] - dry * np.tanh(x[1] / 0.05)) / m]

    given = {"t_eval": TIME, "rtol": 1e-9, "atol": 1e-11, "max_step": 0.01}
    return solve_ivp(slopes, (0.0, 2.0), start, **given).y.T


@pytest.mark.parametrize(("method", "error"), [("rk4", 1e-6), ("rosenbrock", 1e-3)])
def test_each_job_is_the_solution_of_an_adaptive_method(method, error):
    found = spring(method=method).run(TIME, JOBS, STARTS, FORCE)
    assert found.shape == (2, 201, 2)
    for path, theta, start in zip(found, JOBS, STARTS, strict=True):
        wanted = reference(theta, start)
        assert np.abs(path - wanted).max() < error * np.abs(wanted).max()


def test_derivatives_are_those_of_small_changes():
    model = spring()
    found = model.derivatives(TIME, JOBS, STARTS, FORCE)
    np.testing.assert_array_equal(found.outputs, model.run(TIME, JOBS, STARTS, FORCE))
    for values, own in ((JOBS, found.by_parameters), (STARTS, found.by_starts)):
        for k in range(values.shape[1]):
            step = np.zeros(values.shape[1])
            step[k] = 1e-5
            pair = ((values + step, STARTS), (values - step, STARTS))
            if values is STARTS:
                pair = ((JOBS, STARTS + step), (JOBS, STARTS - step))
            one, other = (model.run(TIME, *p, FORCE) for p in pair)
            wanted = (one - other) / 2e-5
            np.testing.assert_allclose(own[..., k], wanted, atol=1e-5 * np.abs(wanted).max())


def test_one_row_serves_all_jobs_and_outputs_may_be_functions():
    model = spring(outputs={"a": Rate("v"), "energy": lambda t, x, u, p: 0.5 * p.m * x.v**2})
    found = model.run(TIME, JOBS[0], STARTS, FORCE)
    path = spring().run(TIME, JOBS[:1], STARTS, FORCE)
    np.testing.assert_allclose(found[..., 1], path[..., 1] ** 2)
    slope = np.gradient(path[1, :, 1], TIME)
    np.testing.assert_allclose(found[1, 1:-1, 0], slope[1:-1], atol=0.02 * np.abs(slope).max())


def test_what_cannot_be_traced_is_told_and_runs():
    import math

    def swing(t, x, u, p):
        return x.v, -p.k * math.sin(x.q) / p.m + 0.0 * u.force

    model = spring(swing)
    (note,) = model.notes
    assert "test_integrator.py" in note
    assert not spring().notes
    same = spring(lambda t, x, u, p: (x.v, -p.k * np.sin(x.q) / p.m + 0.0 * u.force))
    force = {"force": FORCE["force"][:21]}
    one, other = (m.derivatives(TIME[:21], JOBS, STARTS, force) for m in (model, same))
    np.testing.assert_allclose(one.outputs, other.outputs, atol=1e-12)
    scale = np.abs(other.by_parameters).max(axis=(0, 1))
    assert np.all(np.abs(one.by_parameters - other.by_parameters) <= 1e-3 * scale)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((JOBS[:, :2], STARTS), r"parameters has shape \(2, 2\), expected \(jobs, 3\): m, k, dry"),
        ((JOBS, STARTS[:, :1]), r"starts has shape \(2, 1\), expected \(jobs, 2\): q, v"),
        ((np.tile(JOBS, (2, 1)), STARTS), "parameters of 4 jobs and starts of 2"),
        ((JOBS, STARTS, {}), "input force is missing; there is none"),
        ((JOBS, STARTS, {"force": np.zeros(3)}), "3 samples"),
    ],
)
def test_bad_arrays_are_one_message(given, message):
    with pytest.raises((InvalidParameter, DataError), match=message):
        spring().run(TIME, *(*given, FORCE)[: max(3, len(given))])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"states": ["q", "q"]}, "'q' is used twice"),
        ({"outputs": {"y": "w"}}, "output y: 'w' is no state; known are q, v"),
        ({"substeps": 0}, "substeps = 0, expected a whole number >= 1"),
        ({"method": "euler"}, "method"),
    ],
)
def test_bad_names_are_one_message(given, message):
    with pytest.raises(InvalidParameter, match=message):
        spring(**given)


def test_it_loads_nothing_of_a_fit_or_a_diagnosis():
    code = (
        "import sys, unmodeled.ode; print(*(m for m in sys.modules if m.startswith('unmodeled.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    parts = {m.split(".")[1] for m in done.stdout.split()}
    assert "ode" in parts
    assert not parts & {"fit", "library", "search", "report", "diagnosis", "cli", "pictures"}
