"""Dynamic touch: simulated pressed and struck strikes, and relations within a family of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from feltmb.mechanism import Action
from unmodeled.errors import Error, InvalidParameter

RISE = 0.020  # s, rise time of the force of a pressed strike
START = 0.020  # s, start of the finger's motion


@dataclass(frozen=True)
class Strike:
    """One simulated strike."""

    kind: str  #: pressed or struck
    level: float  #: force level [N] or finger speed [m/s]
    hammer_speed: float | None  #: impact speed at the contact [m/s]; None: string not reached
    key_speed: float | None  #: largest speed of the key front before the contact [m/s]
    travel_time: float | None  #: key start (0.1 mm) to string contact [s]
    bottom_after_start: float | None  #: key start to key bottom [s]
    bottom_after_string: float | None  #: string contact to key bottom [s]
    failure: str = ""  #: reason why there is no result


def simulate_strike(action: Action, kind: str, level: float, dip: float) -> Strike:
    """Simulate a strike of a kind at a level; ``dip`` is the key travel to the punching [m]."""
    import numpy as np

    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import motion_stroke, ramp_stroke

    if kind == "pressed":
        stroke = ramp_stroke(level, START, RISE, duration=0.45, name=f"pressed {level:g} N")
    else:
        # The finger moves until 1 mm below the position at which the key meets its punching.
        end = START + (dip + 1e-3) / level
        stroke = motion_stroke(
            [START, end],
            [0.0, dip + 1e-3],
            interpolation="linear",
            duration=end + 0.08,
            name=f"struck {level:g} m/s",
        )
    try:
        run = simulate(action, stroke, ledger=False, output_rate=5000.0)
    except InvalidParameter:
        raise
    except Error as error:
        return Strike(kind, level, None, None, None, None, None, str(error))
    s = run.summary
    named = action.config.reading.touch
    start, hit = s.get(f"{named.start}_time"), s.get("impact_time")
    land = s.get(f"{named.landing}_time")
    if hit is None or start is None:
        return Strike(
            kind, level, None, None, None, None, None, "the hammer does not reach the string"
        )
    point = action.config.reading.key_point
    speed = None
    if point is not None:
        speed = float(np.max(-run[f"{point}.vy"][run.time <= hit]))
    return Strike(
        kind,
        level,
        s["impact_speed"],
        speed,
        hit - start,
        None if land is None else land - start,
        None if land is None else land - hit,
    )


def fit_travel_time(strikes: Sequence[Strike]) -> tuple[float, float, float] | None:
    """A and b of travel time = a v^b by least squares of logarithms, and the largest residual."""
    import numpy as np

    pairs = [(b.hammer_speed, b.travel_time) for b in strikes if b.hammer_speed and b.travel_time]
    if len(pairs) < 3:
        return None
    v, t = np.log(np.array(pairs)).T
    b, log_a = np.polyfit(v, t, 1)
    worst = float(np.max(np.abs(np.exp(log_a + b * v - t) - 1.0)))
    return float(np.exp(log_a)), float(b), worst


def at_speed(strikes: Sequence[Strike], field: str, speed: float) -> float | None:
    """A value of a family at an impact speed, interpolated over the logarithm of the speed."""
    import numpy as np

    pairs = sorted(
        (b.hammer_speed, getattr(b, field))
        for b in strikes
        if b.hammer_speed and getattr(b, field) is not None
    )
    if not pairs or not pairs[0][0] <= speed <= pairs[-1][0]:
        return None
    v, y = np.array(pairs, dtype=float).T
    return float(np.interp(math.log(speed), np.log(v), y))
