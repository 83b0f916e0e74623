"""Steps of a fit: the direction within bounds, the radius of trust, and old derivatives."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from unmodeled.search.evidence import NormalEquations, Prior
from unmodeled.search.steps import STALE, Box, Freshness, Move, TrustRadius

NONE = np.zeros((0, 0))
#: Residuals b - A x of two unknowns and their prior of weight 1.
A, B = np.array([[3.0, 1.0], [1.0, 2.0], [0.0, 1.0]]), np.array([4.0, -3.0, 1.0])
PRIOR = Prior(np.ones(2), np.zeros(2, dtype=bool))


def equations(x, locals_=()):
    return NormalEquations(A.T @ A, A.T @ (B - A @ x), NONE, NONE, np.zeros(0), locals_, 0.0)


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((-9.0, -9.0), (9.0, 9.0)),
        ((-9.0, -9.0), (0.5, 9.0)),
        ((-9.0, -0.2), (9.0, 9.0)),
        ((-9.0, -0.2), (0.5, 9.0)),
    ],
)
@pytest.mark.parametrize("start", [(0.0, 0.0), (0.4, 0.3)])
def test_a_step_without_damping_is_the_minimum_within_the_bounds(low, high, start):
    x = np.array(start)
    move = Box(np.array(low), np.array(high)).move(equations(x), PRIOR, x, 0.0)
    both = np.vstack([A, np.eye(2)]), np.append(B, [0.0, 0.0])
    best = lsq_linear(*both, bounds=(low, high), tol=1e-14).x
    np.testing.assert_allclose(x + move.step, best, atol=1e-7)


def test_a_step_promises_what_a_linear_model_gains():
    x = np.array([0.4, 0.3])
    inner, coupling, target = np.array([[2.0]]), np.array([[0.5, 0.0]]), np.array([0.6])
    box = Box(np.full(2, -9.0), np.full(2, 9.0))
    free = box.move(equations(x), PRIOR, x, 0.0)

    def half(at):
        return 0.5 * (np.sum((B - A @ at) ** 2) + at @ at)

    gained = half(x) - half(x + free.step)
    # The curvature of the prior is left out.
    assert free.promised == pytest.approx(gained + 0.5 * free.step @ free.step)
    local = box.move(equations(x, ((inner, coupling, target),)), PRIOR, x, 0.0)
    np.testing.assert_allclose(local.local[0], (0.6 - 0.5 * local.step[0]) / 2.0)
    assert local.promised - free.promised == pytest.approx(0.5 * 0.6**2 / 2.0)


def move_of(length, damping=1e-3):
    x = np.zeros(2)
    return Move(equations(x), PRIOR, x, np.array([0.5 * length, -length]), [], damping)


@pytest.mark.parametrize(
    ("trials", "radius", "far"),
    [
        ([(1.0, 1e-3, True)], 2.0, False),  # within what is trusted
        ([(2.0, 1e-3, True)], 4.0, False),
        ([(2.0, 0.1, True)], 4.0, True),  # it was shortened, and gains: the fit is on its way
        ([(2.0, 0.1, False)], 0.8, False),
        ([(2.0, 0.1, False), (0.8, 0.5, True)], 1.6, False),
        ([(2.0, 0.1, True), (4.0, 0.2, True)], 8.0, True),
        ([(2.0, 0.1, True), (1.0, 1e-3, True)], 4.0, False),
    ],
)
def test_what_is_trusted_follows_the_success(trials, radius, far):
    trust = TrustRadius()
    for length, damping, gains in trials:
        move = move_of(length, damping)
        (trust.accepted if gains else trust.rejected)(move)
    assert (trust.radius, trust.far) == (pytest.approx(radius), far)


@pytest.mark.parametrize(("free", "damped"), [(1.0, False), (2.2, False), (2.3, True), (1e4, True)])
def test_the_least_damping_is_taken_that_is_short_enough(free, damped):
    tried = []

    def move(damping):
        tried.append(damping)
        return move_of(free / (1.0 + damping), damping)

    found = TrustRadius().within(move)
    assert (found.damping > 1e-3) is damped
    assert found.length <= 2.2
    assert found.length >= min(free, 0.05)
    assert tried == sorted(tried)


@pytest.mark.parametrize(
    ("cheap", "gains", "asked", "stale"),
    [
        (True, [], True, False),
        (True, [None], False, False),  # a trial failed: the next one may fail too
        (True, [None, 5.0], True, False),
        (False, [], False, False),
        (False, [6.0], False, True),  # as promised: they are used again
        (False, [4.0], False, False),
        (False, [6.0, None], False, True),
        (False, [6.0, 4.0], False, False),
    ],
)
def test_derivatives_serve_again_while_steps_gain_what_they_promise(cheap, gains, asked, stale):
    fresh = Freshness(cheap)
    for gain in gains:
        if gain is None:
            fresh.rejected()
        else:
            fresh.accepted(gain, promised=10.0)
    assert (fresh.asked, fresh.stale) == (asked, stale)
    assert [t for t in range(7) if fresh.due(t)] == [STALE] * stale
    fresh.renewed()
    assert not fresh.stale
