"""Repetition of an action: the highest rate at which every press of the key strikes, and why.

A finger presses the key at a constant speed, holds it for half a period, lifts, and waits at the
height to which the key may return. ``docs/howto/test_repetition.md`` defines each quantity.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from feltmb.action.touch.static import REGULATE, roles_of
from feltmb.mechanism import Action, load_action
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from feltmb.run.results import Run
    from feltmb.run.stroke import Stroke

__all__ = ["REASONS", "Repeated", "Repetition", "highest_rate", "key_travel", "repeat"]

#: Finger speeds of a soft and a hard press [m/s]; share of the key travel that the key returns.
SPEEDS, RETURNS = (0.15, 0.5), (1.0, 0.75, 0.5)
PRESSES = 5
#: First rate, step of the search upward, and resolution of the answer [1/s].
LOWEST, STEP, RESOLUTION = 2.0, 2.0, 0.25
HIGHEST = 16.0
START = 0.02  # s, first press
LIFT = 0.5  # m/s, speed of the lifting finger
BEYOND = 1e-3  # m, travel of the finger beyond the contact with the punching
#: A key that is lower than the waiting finger by more than this has not come back [m].
LATE = 1e-3
#: A press strikes if it reaches this share of the impact speed of the first press, and if the jack
#: drives it with this share of the impulse of the first press.
WEAK, DRIVEN = 0.5, 0.25

#: Reasons of a failed press, as a sentence.
REASONS = {
    "key too slow": "the key is not back at the finger when the next press begins",
    "jack not back": "the jack is not back under the hammer when the next press begins",
    "not caught": "the hammer was not caught in check and is still on its way",
    "weak": "the hammer does not reach half the impact speed of the first press",
    "finger": "a press at this finger speed lasts longer than the period",
    "": "no press fails up to this rate",
}


@dataclass(frozen=True)
class Repeated:
    """Highest rate for one finger speed and one return of the key."""

    speed: float  #: speed of the pressing finger [m/s]
    key_return: float  #: share of the key travel that the key may return [1]
    rate: float  #: highest rate at which every press strikes [1/s]; 0: none of the rates
    failed_rate: float  #: lowest rate that failed [1/s]; NaN: none failed
    press: int  #: number of the first press that failed, from 1; 0: none
    reason: str  #: key of :data:`REASONS`
    impact_speed: float  #: impact speed of the first press [m/s]
    weakest: float  #: smallest impact speed of the presses at ``rate`` [m/s]

    @property
    def sentence(self) -> str:
        """The reason as a sentence."""
        text = REASONS[self.reason]
        return f"press {self.press}: {text}" if self.press else text

    @property
    def rate_text(self) -> str:
        """The rate for people."""
        return f"{self.rate:.4g}" if self.rate else f"below {LOWEST:g}"


@dataclass(frozen=True)
class _Presses:
    """Presses of one run: impact speeds, and the first that failed."""

    speeds: tuple[float, ...]
    press: int = 0
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Repetition:
    """Result of :func:`repeat`.

    Attributes
    ----------
    rows : tuple of Repeated
        One for each finger speed and return of the key.
    travel : float
        Key travel to the punching [m].
    """

    action: Action
    rows: tuple[Repeated, ...]
    travel: float
    presses: int

    @cached_property
    def frame(self) -> pd.DataFrame:
        """One row for each finger speed and return of the key, SI units; see :class:`Repeated`."""
        import pandas as pd

        return pd.DataFrame([asdict(row) | {"sentence": row.sentence} for row in self.rows])

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; numbers that do not exist are None."""
        rows = [
            {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(r).items()}
            | {"sentence": r.sentence}
            for r in self.rows
        ]
        return {
            "action": self.action.name,
            "hash": self.action.hash,
            "key_travel": self.travel,
            "presses": self.presses,
            "rows": rows,
        }

    def plot(self) -> Figure:
        """Highest rates with their reasons, and the run with the first failure."""
        import numpy as np

        from unmodeled.style import BLUE, CYCLE, GRAY, PALE, RED, head_line, new_figure, style_axes

        figure = new_figure(9.0, 6.4)
        top, bottom = figure.subplots(2, 1, height_ratios=(0.5 + 0.28 * len(self.rows), 2.6))
        speeds = sorted({row.speed for row in self.rows})
        shown = sorted(self.rows, key=lambda r: (r.speed, r.key_return), reverse=True)
        for y, row in enumerate(shown):
            top.barh(y, row.rate, color=CYCLE[speeds.index(row.speed)], height=0.6)
            top.text(row.rate + 0.15, y, f"{row.rate_text} /s; {row.sentence}", va="center", size=8)
        labels = [f"{r.speed:g} m/s, key returns {1e3 * r.key_return * self.travel:.1f} mm"
                  for r in shown]  # fmt: skip
        top.set_yticks(range(len(shown)), labels)
        most = max(row.rate for row in shown)
        top.set_xlim(0.0, 3.2 * max(most, 2.0))
        top.set_xticks(range(0, int(most) + 2, 2))
        style_axes(top, "presses per second", "", "highest rate at which every press strikes")
        top.grid(visible=False, axis="y")  # a line through the texts
        failed = [row for row in self.rows if row.press]
        if failed:
            row = min(failed, key=lambda r: r.failed_rate)
            run = _run(
                self.action, row.failed_rate, row.speed, row.key_return, self.travel, self.presses
            )
            assert run is not None
            roles, begin = roles_of(self.action), START + (row.press - 1) / row.failed_rate
            first = max(0.0, begin - 1.5 / row.failed_rate)
            time = 1e3 * run.time
            bottom.plot(time, 1e3 * _depth(self.action, run), color=BLUE, label="key, below rest")
            gap = -run[f"contact{roles['strike']:02d}.compression"]
            bottom.plot(time, 1e3 * gap, color=RED, label="hammer to string")
            bottom.axvspan(1e3 * begin, 1e3 * (begin + 1 / row.failed_rate), color=PALE, alpha=0.5,
                           lw=0, label="the press that fails")  # fmt: skip
            for k in range(self.presses):
                bottom.axvline(1e3 * (START + k / row.failed_rate), color=GRAY, lw=0.7, ls=":")
            last = min(run.time[-1], begin + 1.3 / row.failed_rate)
            bottom.set_xlim(1e3 * first, 1e3 * last)
            inside = (run.time >= first) & (run.time <= last)
            bottom.set_ylim(-1.0, 1e3 * float(np.max(gap[inside])) + 4.0)
            bottom.legend(fontsize=8, frameon=False, loc="upper right", ncols=3)
            title = f"{row.speed:g} m/s, {row.failed_rate:.4g}/s: {row.sentence}"
            style_axes(bottom, "time [ms]", "distance [mm]", title)
        else:
            bottom.set_axis_off()
        head_line(figure, f"{self.action.name}: repetition", 12.0, "normal")
        return figure


def key_travel(action: Action) -> float:
    """Travel of the finger's point from rest to the contact of the key with its punching [m].

    Raises
    ------
    Error
        A press with 10 N does not bring the key to its punching.
    """
    import numpy as np

    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import ramp_stroke

    roles_of(action)  # faults of the mechanism file
    stroke = ramp_stroke(10.0, START, 0.3, duration=0.35)
    run = simulate(action, stroke, ledger=False, output_rate=2000.0)
    landed = run.summary.get(f"{action.config.reading.touch.landing}_time")
    if landed is None:
        raise Error(f"{action.name!r}: the key does not reach its punching with 10 N; {REGULATE}")
    return float(np.interp(landed, run.time, _depth(action, run)))


def _depth(action: Action, run: Run) -> Any:
    """Depth of the key point below its rest [m]."""
    y = run[f"{action.config.reading.key_point}.y"]
    return y[0] - y


def _stroke(
    rate: float, speed: float, key_return: float, travel: float, presses: int
) -> Stroke | None:
    """Presses of a finger; None: the press and the lift last longer than the period."""
    from feltmb.run.stroke import motion_stroke

    period, low = 1.0 / rate, travel + BEYOND
    high = (1.0 - key_return) * travel
    time, value = [], []
    for k in range(presses):
        start, top = START + k * period, high if k else 0.0
        bottom = start + (low - top) / speed
        lift = max(bottom + 1e-3, start + 0.5 * period)
        end = lift + (low - high) / LIFT
        if end >= start + period:
            return None
        time += [start, bottom, lift, end]
        value += [top, low, low, high]
    return motion_stroke(
        time, value, interpolation="linear", duration=START + presses * period, name="repetition"
    )


def _run(
    action: Action,
    rate: float,
    speed: float,
    key_return: float,
    travel: float,
    presses: int,
    progress: Callable[[float], object] | None = None,
) -> Run | None:
    from feltmb.run.simulate import simulate

    stroke = _stroke(rate, speed, key_return, travel, presses)
    if stroke is None:
        return None
    return simulate(action, stroke, ledger=False, output_rate=2000.0, progress=progress)


def _try(
    action: Action,
    rate: float,
    speed: float,
    key_return: float,
    travel: float,
    presses: int,
    progress: Callable[[float], object] | None,
) -> _Presses:
    """Simulate presses at a rate, and find the first one that fails."""
    import numpy as np

    run = _run(action, rate, speed, key_return, travel, presses, progress)
    if run is None:
        return _Presses((), 0, "finger")
    strikes = run.strikes
    times = np.asarray(strikes.get("impact_time", ()), dtype=float)
    impacts = np.asarray(strikes.get("impact_speed", ()), dtype=float)
    jack = run[f"contact{roles_of(action)['let_off']:02d}.force"]
    checks = [run[f"contact{c:02d}.force"] for c in action.config.reading.check_contacts]
    held = np.sum(checks, axis=0) > 0.0 if checks else np.ones(run.time.size, dtype=bool)
    depth, speeds, impulses = _depth(action, run), [], []
    for k in range(presses):
        start, end = START + k / rate, START + (k + 1) / rate
        own = (times >= start) & (times < end)
        hit = float(times[own][np.argmax(impacts[own])]) if own.any() else end
        before = (run.time >= start) & (run.time < hit)
        impulses.append(float(np.sum(jack[before])))
        found = float(np.max(impacts[own])) if own.any() else 0.0
        if k == 0 and not own.any():
            raise Error(
                f"{action.name!r}: a single press with a finger speed of {speed:g} m/s does not "
                "strike; press faster, or regulate the action"
            )
        driven = impulses[k] >= DRIVEN * impulses[0]
        speeds.append(found)
        if found >= WEAK * speeds[0] and driven:
            continue
        late = float(np.interp(start, run.time, depth)) - (1.0 - key_return) * travel
        between = (run.time >= start - 1.0 / rate) & (run.time < start)
        if late > LATE:
            reason = "key too slow"
        elif not held[between].any():
            reason = "not caught"
        else:
            reason = "weak" if driven else "jack not back"
        return _Presses(tuple(speeds), k + 1, reason)
    return _Presses(tuple(speeds))


def highest_rate(
    action: Action,
    travel: float,
    speed: float = 0.5,
    key_return: float = 1.0,
    *,
    presses: int = PRESSES,
    highest: float = HIGHEST,
    near: float | None = None,
    progress: Callable[[float], object] | None = None,
) -> Repeated:
    """Search upward in steps until a press fails, and bisect to a quarter of a press a second.

    Parameters
    ----------
    travel
        Key travel to the punching [m], see :func:`key_travel`.
    speed
        Speed of the pressing finger [m/s].
    key_return
        Share of the key travel that the key may return [1].
    presses
        Number of presses.
    highest
        Rate at which the search ends [1/s].
    near
        Expected answer [1/s], from which the search starts; default: from 2 presses a second.
    progress
        As for :func:`~feltmb.simulate`: if it returns False, the search is interrupted.
    """
    good, bad = 0.0, math.nan
    best, worst = _Presses(()), _Presses(())
    step = STEP if near is None else 0.5 * STEP
    rate = LOWEST if near is None else min(max(near, LOWEST), highest)
    while True:
        found = _try(action, rate, speed, key_return, travel, presses, progress)
        if found.reason:
            bad, worst = rate, found
        else:
            good, best = rate, found
        if math.isnan(bad):
            if rate >= highest:
                break
            rate = min(rate + step, highest)
        elif good == 0.0:
            if rate <= LOWEST:
                break
            rate = max(rate - step, LOWEST)
        elif bad - good <= RESOLUTION:
            break
        else:
            rate = 0.5 * (good + bad)
    first = (best.speeds or worst.speeds or (math.nan,))[0]
    weakest = min(best.speeds, default=math.nan)
    return Repeated(speed, key_return, good, bad, worst.press, worst.reason, first, weakest)


@checked
def repeat(
    action: Action | str,
    *,
    speeds: Sequence[float] = SPEEDS,
    returns: Sequence[float] = RETURNS,
    presses: int = PRESSES,
    highest: float = HIGHEST,
) -> Repetition:
    """Find the highest rate at which every press of the key strikes.

    Parameters
    ----------
    action
        Mechanism, or its name for :func:`load_action`.
    speeds
        Finger speeds of the presses [m/s], > 0: soft and hard.
    returns
        Shares of the key travel that the key may return between presses, 0 < share <= 1.
    presses
        Number of presses, 2 to 50.
    highest
        Rate at which the search ends [1/s], 2 to 50.

    Raises
    ------
    InvalidParameter
        A number is out of range, or the mechanism does not name the required contacts.
    Error
        A single press does not strike, or the key does not reach its punching.
    """
    if isinstance(action, str):
        action = load_action(action)
    for name, values, most in (
        ("speeds", speeds, 5.0),
        ("returns", returns, 1.0),
    ):
        if not values or not all(math.isfinite(v) and 0.0 < v <= most for v in values):
            raise InvalidParameter(f"repeat: {name} = {list(values)!r}, expected > 0 to {most:g}")
    if not 2 <= presses <= 50:
        raise InvalidParameter(f"repeat: presses = {presses}, expected 2 to 50")
    if not LOWEST <= highest <= 50.0:
        raise InvalidParameter(f"repeat: highest = {highest:g} 1/s, expected {LOWEST:g} to 50 1/s")
    travel = key_travel(action)
    jobs = [(v, r) for v in sorted(speeds) for r in sorted(returns, reverse=True)]
    stop = threading.Event()
    find = partial(
        highest_rate, presses=presses, highest=highest, progress=lambda _: not stop.is_set()
    )
    with ThreadPoolExecutor() as pool:
        found = [pool.submit(find, action, travel, v, r) for v, r in jobs]
        try:
            rows = tuple(future.result() for future in found)
        except BaseException:  # the threads do not hear of Ctrl-C
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return Repetition(action, rows, travel, presses)
