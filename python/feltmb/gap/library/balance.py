"""Candidates of a force balance that is linear in its parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from feltmb.data import Array
from feltmb.fit import Effect


def for_force_balance(
    position: str, speed: str, *, force: float, travel: float, pace: float, unit: str = "N"
) -> tuple[Effect, ...]:
    """Candidates of a measured force balance that is linear in its parameters.

    The model is a :class:`~feltmb.fit.LinearModel`, and the records have ``position`` and ``speed``
    among their inputs. ``force``, ``travel`` and ``pace`` are typical magnitudes.

    Parameters
    ----------
    position
        Channel of the position.
    speed
        Channel of the speed.
    force
        Typical force [N].
    travel
        Typical displacement [m].
    pace
        Typical speed [m/s].
    unit
        Unit of the force.
    """

    def effect(
        name: str,
        mechanism: str,
        column: Callable[[Array, Array, Any], Array],
        scale: float,
        unit_of: str,
        sign: int = 0,
        shapes: tuple[Any, ...] = (None,),
        shape_names: tuple[str, ...] = (),
    ) -> Effect:
        return Effect(
            name=name,
            component="guide" if "friction" in name else "drive",
            unit=unit_of,
            scale=scale,
            sign=sign,  # type: ignore[arg-type]
            shapes=shapes,
            shape_names=shape_names,
            mechanism=mechanism,
            regressor=lambda r, s: column(r.inputs[position], r.inputs[speed], s),
        )

    part = 0.1 * force
    return (
        effect(
            "dry friction",
            "A force of constant magnitude acts against the motion.",
            lambda q, v, v0: np.tanh(v / v0),
            part,
            unit,
            1,
            (0.003 * pace, 0.03 * pace),
            ("v_0 [m/s]",),
        ),
        effect(
            "one-sided friction",
            "Dry friction differs between the directions.",
            lambda q, v, v0: np.abs(np.tanh(v / v0)),
            part,
            unit,
            0,
            (0.003 * pace, 0.03 * pace),
            ("v_0 [m/s]",),
        ),
        effect(
            "Stribeck friction",
            "Friction is larger at low speed than in full motion.",
            lambda q, v, s: np.exp(-((v / s[0]) ** 2)) * np.tanh(v / s[1]),
            part,
            unit,
            1,
            ((0.05 * pace, 0.003 * pace), (0.3 * pace, 0.01 * pace)),
            ("v_s [m/s]", "v_0 [m/s]"),
        ),
        effect(
            "quadratic friction",
            "Drag grows with the square of the speed.",
            lambda q, v, s: v * np.abs(v),
            part / pace**2,
            f"{unit} s^2/m^2",
            1,
        ),
        effect(
            "constant force",
            "A constant force acts that the model lacks.",
            lambda q, v, s: np.ones_like(q),
            part,
            unit,
        ),
        effect(
            "linear stiffness",
            "A spring acts that the model lacks.",
            lambda q, v, s: q,
            part / travel,
            f"{unit}/m",
        ),
        effect(
            "cubic stiffness",
            "A spring that the model lacks hardens (magnitude above 0) or softens (below 0).",
            lambda q, v, s: q**3,
            part / travel**3,
            f"{unit}/m^3",
        ),
        effect(
            "friction along the travel",
            "Dry friction changes along the guide.",
            lambda q, v, v0: q * np.tanh(v / v0),
            part / travel,
            f"{unit}/m",
            0,
            (0.01 * pace,),
            ("v_0 [m/s]",),
        ),
    )
