"""Hysteresis of Bouc and Wen with both of its numbers free."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.fit import Effect, Named, State
from unmodeled.library.forces import Part, Scales, on, product

#: Largest stretch, in typical travels: a law that softens while it loads would grow without end.
LONGEST = 20.0
#: The second number of the shape is ``AWAY + gamma / beta``, which is positive.
AWAY = 2.0


def bouc_wen(c: Part, *, scale: float, travel: float) -> Effect:
    """Hysteresis of Bouc (1967) and Wen (1976): a spring with a slip that depends on its force.

    ``F = k z, dz/dt = v - beta |v| z - gamma v |z|``.

    The shape is (beta, 2 + gamma / beta). A branch that loads has the slope 1 - (beta + gamma)
    ``|z|``, one that unloads 1 + (beta - gamma) ``|z|``: with gamma = beta a spring in series with
    a slip, with gamma < -beta a loop that stiffens (pinching). The hidden state is z.

    Parameters
    ----------
    c
        Coordinate, or coupling of two coordinates, on which the effect acts.
    scale
        Stiffness k of the branch that one would expect [N/m or N m/rad].
    travel
        Typical displacement [m or rad], from which values of beta follow.
    """

    def rate(t: Any, x: Named, u: Named, p: Named, size: Any, shape: Any) -> Mapping[str, Array]:
        beta, ratio = shape
        _, v = c.motion(x)
        z = np.clip(x["bouc_wen.stretch"], -LONGEST * travel, LONGEST * travel)
        gamma = beta * (ratio - AWAY)
        change = v - beta * np.abs(v) * z - gamma * v * np.abs(z)
        return {**c.push(-size * z, t, x, u, p), "bouc_wen.stretch": change}

    return on(
        c,
        "Bouc-Wen hysteresis",
        unit=product((c.unit, 1), (c.travel_unit, -1)),
        scale=scale,
        sign=1,
        kind="state",
        mechanism="Force depends on the past motion, along loops that widen or pinch.",
        shapes=tuple((b / travel, r) for b in (0.3, 1.5) for r in (0.7, 2.5)),
        shape_names=(f"beta [1/{c.travel_unit}]", "2 + gamma / beta"),
        remedy="Use a law with memory.",
        hidden=(State(name="bouc_wen.stretch", hidden=True, scale=travel, start_sd=0.3 * travel),),
        rate=rate,
    )


FOR_COORDINATE: tuple[Callable[[Part, Scales], Effect], ...] = (
    lambda c, s: bouc_wen(c, scale=0.3 * s.force / s.travel, travel=s.travel),
)
