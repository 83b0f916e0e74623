"""Methods of integration as tableaus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unmodeled.data import Array


@dataclass(frozen=True, eq=False)
class Method:
    """A linearly implicit Runge-Kutta method.

    ``(1 - gamma h J) k_i = f(x + h sum a_ij k_j) + sum g_ij k_j``, and the step is h sum b_i k_i.
    J is the derivative of the rates at the first stage.
    """

    inner: Array
    """a"""
    carried: Array
    """g"""
    weights: Array
    """b"""
    instants: tuple[int, ...]
    """Times of the stages, in halves of a step."""
    gamma: float = 0.0


_GAMMA = 1.0 - np.sqrt(0.5)
METHODS = {
    "rk4": Method(
        np.array([[0.0] * 4, [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        np.zeros((4, 4)),
        np.array([1.0, 2.0, 2.0, 1.0]) / 6.0,
        (0, 1, 1, 2),
    ),
    # ROS2 (Verwer et al. 1999): L-stable, of order 2 with any approximate J.
    "rosenbrock": Method(
        np.array([[0.0, 0.0], [1.0, 0.0]]),
        np.array([[0.0, 0.0], [-2.0, 0.0]]),
        np.array([1.5, 0.5]),
        (0, 2),
        float(_GAMMA),
    ),
}
