"""A simulator of a user: a cart on a spring that a force drives."""

from __future__ import annotations

import math

import numpy as np


def cart(time, inputs, parameters):
    """Position of the cart [m] at all times; dry friction opposes its motion."""
    mass, damping, dry = (parameters[n] for n in ("mass", "damping", "dry_friction"))
    force, x, v, position = inputs["force"], 0.0, 0.0, [0.0]
    for i in range(len(time) - 1):
        h = (time[i + 1] - time[i]) / 10
        for j in range(10):
            now = force[i] + (j + 0.5) / 10 * (force[i + 1] - force[i])
            v += h / mass * (now - 40.0 * x - damping * v)
            v = math.copysign(max(abs(v) - h / mass * dry, 0.0), v)  # friction never turns it
            x += h * v
        position.append(x)
    return {"x": np.array(position)}
