"""Held-out densities: segment by segment they are predictions; what is known costs nothing."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.fit.filter import reduce_chain
from feltmb.fit.linearize import Linear
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Candidate, Effect, State
from feltmb.gap.proof import HeldOut, evaluate
from feltmb.gap.refine import refit

_spec = importlib.util.spec_from_file_location("gap_models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)


def gaussian(value, mean, cover):
    """Log density but for the constant of its dimension."""
    left = value - mean
    return -0.5 * (left @ np.linalg.solve(cover, left) + np.linalg.slogdet(cover)[1])


def test_heads_are_the_densities_of_the_beginnings():
    draw = np.random.default_rng(7).standard_normal
    segments, m, nx, mi = 4, 6, 2, 2
    linear = Linear(
        residual=draw((segments, m)),
        by_state=draw((segments, m, nx)),
        by_global=np.zeros((segments, m, 0)),
        by_input=draw((segments, m, mi)),
        gap=draw((segments - 1, nx)),
        ends_by_state=draw((segments, nx, nx)),
        ends_by_global=np.zeros((segments, nx, 0)),
        ends_by_input=draw((segments, nx, mi)),
        good=np.ones(segments, dtype=bool),
    )
    gap_sd, start, start_sd = np.array([0.3, 0.02]), np.array([0.1, -0.2]), np.array([0.5, 2.0])
    chain = reduce_chain(linear, gap_sd, start, start_sd, keep_heads=True)

    # Forwards: every state as a mean and columns of unit normal numbers.
    width = nx + segments * (mi + nx)
    mean, columns = start.copy(), np.zeros((nx, width))
    columns[:, :nx] = np.diag(start_sd)
    means, rows = [], []
    so_far = -np.sum(np.log(start_sd))
    for w in range(segments):
        at = nx + w * (mi + nx)
        here = linear.by_state[w] @ columns
        here[:, at : at + mi] += linear.by_input[w]
        means.append(linear.by_state[w] @ mean)
        rows.append(here)
        seen = np.concatenate(rows)
        grams, log_dets = chain.heads
        found = so_far - 0.5 * grams[w][-1, -1] - log_dets[w]
        expected = gaussian(
            linear.residual[: w + 1].ravel(),
            np.concatenate(means),
            seen @ seen.T + np.eye(len(seen)),
        )
        assert found == pytest.approx(expected, rel=1e-9)
        if w == segments - 1:
            break
        so_far += -0.5 * chain.grams[w][-1, -1] - chain.log_dets[w] - np.sum(np.log(gap_sd))
        mean = linear.ends_by_state[w] @ mean + linear.gap[w]
        columns = linear.ends_by_state[w] @ columns
        columns[:, at : at + mi] += linear.ends_by_input[w]
        columns[:, at + mi : at + mi + nx] += np.diag(gap_sd)


@pytest.fixture(scope="module")
def fitted():
    noise = {"q": Noise(1e-4)}
    fit = fit_problem(
        Problem(
            models.NOMINAL,
            tuple(
                segment_record(models.NOMINAL, models.record(f"r{i}", 1.0, i), noise, 0.4)
                for i in range(2)
            ),
        )
    )
    assert fit.explains
    return fit, segment_record(models.NOMINAL, models.record("held", 1.0, 9), noise, 0.4)


def density(fit, *segmented_records):
    held = HeldOut(
        segmented_records=segmented_records,
        state_scale=fit.problem.scale(fit.point),
        sensed=segmented_records,
    )
    return evaluate(held, fit, FitSettings(), segmented_level=fit.level).density


def test_what_a_segment_is_worth_does_not_depend_on_what_follows(fitted):
    fit, segmented = fitted
    whole, begun = (
        density(fit, segmented),
        density(fit, segmented.until(segmented.record.samples // 2)),
    )
    assert whole[:2] == pytest.approx(begun[:2], abs=0.01)
    assert begun[3:] == pytest.approx(0.0, abs=1e-9)  # nothing is measured there


def test_a_memory_that_starts_known_costs_nothing(fitted):
    fit, segmented = fitted
    idle = Effect(
        name="idle",
        component="spring",
        unit="N/m",
        scale=1.0,
        hidden=(State(name="memory", hidden=True, scale=0.01, start_sd=0.0),),
        rate=lambda t, x, u, p, size, shape: {
            "v": -size * x.memory / p.m,
            "memory": (x.q - x.memory) / 0.05,
        },
    )
    with_idle = refit(fit, (Candidate(idle),), np.zeros(1), FitSettings())
    with_idle = replace(with_idle, level=fit.level)
    gain = np.sum(density(with_idle, segmented)) - np.sum(density(fit, segmented))
    assert abs(gain) < 5.0
