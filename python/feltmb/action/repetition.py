"""Repetition of an action: the highest rate at which every press is a note, and why not beyond it.

A finger with a mass and a limited force presses the key faster and faster.
``docs/howto/test_repetition.md`` defines each quantity.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass
from functools import cached_property
from threading import Event
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

#: Largest force of a soft and a firm finger [N]; share of the key travel that the key returns.
FORCES, RETURNS = (4.0, 10.0), (1.0, 0.75, 0.5)
#: Force that lifts the finger [N], its mass at the tip [kg], time in which its force changes [s].
LIFT, MASS, RISE = 3.0, 0.02, 8e-3
#: Rate of the first press [1/s], growth from press to press, and rate at which the test ends.
LOWEST, GROWTH, HIGHEST = 3.0, 1.04, 16.0
#: Presses of a run, after which it is looked at.
PART = 4
#: A note: the hammer came back by this share of its way from the string, the jack drives it with
#: this share of the impulse of the first press, and it strikes with this speed [m/s].
BACK, DRIVEN, AUDIBLE = 2.0 / 3.0, 0.25, 0.5
#: A key that is lower than the lifted finger by more than this has not come back [m].
LATE = 1e-3
#: Distance of the finger's tip from its joint, radius of the tip [m].
ARM, TIP = 0.09, 1e-3
#: Names of the finger in the mechanism that it plays.
_FINGER, _HAND = "playing finger", "playing hand"

#: Reasons of a failed press, as a sentence.
REASONS = {
    "key too slow": "the key is not back at the finger when the press begins",
    "hammer not back": f"the hammer has come back by less than {100.0 * BACK:.0f} % of its way",
    "jack not back": "the jack is not back under the hammer when the press begins",
    "weak": f"the hammer strikes with less than {AUDIBLE:g} m/s",
    "interrupted": "the test was interrupted",
    "": "no press fails up to this rate",
}


@dataclass(frozen=True)
class Repeated:
    """Highest rate for one force of the finger and one return of the key."""

    force: float  #: largest force of the finger [N]
    key_return: float  #: share of the key travel that the key may return [1]
    rate: float  #: highest rate up to which every press is a note [1/s]; 0: none
    press: int  #: number of the first press that failed, from 1; 0: none
    reason: str  #: key of :data:`REASONS`
    impact_speed: float  #: impact speed of the first press [m/s]
    weakest: float  #: smallest impact speed of the notes [m/s]
    least_back: float  #: smallest way of the hammer back from the string, as a share of the whole

    @property
    def sentence(self) -> str:
        """The reason as a sentence."""
        return REASONS[self.reason]

    @property
    def rate_text(self) -> str:
        """The rate for people."""
        return f"{self.rate:.1f}" if self.rate else f"below {LOWEST:g}"


@dataclass(frozen=True)
class _Press:
    """One press of a run."""

    start: float  #: [s]
    rate: float  #: [1/s]
    speed: float  #: impact speed [m/s]; 0: none
    back: float  #: way of the hammer back from the string before, as a share of the whole
    reason: str  #: "": it is a note


@dataclass(frozen=True, eq=False)
class Repetition:
    """Result of :func:`repeat`.

    Attributes
    ----------
    rows : tuple of Repeated
        One for each force of the finger and return of the key.
    travel : float
        Key travel to the punching [m].
    """

    action: Action
    rows: tuple[Repeated, ...]
    travel: float

    @property
    def interrupted(self) -> bool:
        """Whether the test was interrupted."""
        return any(row.reason == "interrupted" for row in self.rows)

    @cached_property
    def frame(self) -> pd.DataFrame:
        """One row for each force of the finger and return of the key; see :class:`Repeated`."""
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
            "rows": rows,
        }

    def plot(self) -> Figure:
        """Highest rates with their reasons, and the presses before the first failure."""
        import numpy as np

        from unmodeled.style import BLUE, CYCLE, GRAY, PALE, RED, head_line, new_figure, style_axes

        figure = new_figure(9.0, 6.4)
        top, bottom = figure.subplots(2, 1, height_ratios=(0.5 + 0.28 * len(self.rows), 2.6))
        forces = sorted({row.force for row in self.rows})
        shown = sorted(self.rows, key=lambda r: (r.force, r.key_return), reverse=True)
        for y, row in enumerate(shown):
            top.barh(y, row.rate, color=CYCLE[forces.index(row.force)], height=0.6)
            top.text(row.rate + 0.15, y, f"{row.rate_text} /s; {row.sentence}", va="center", size=8)
        labels = [f"{r.force:g} N, key returns {1e3 * r.key_return * self.travel:.1f} mm"
                  for r in shown]  # fmt: skip
        top.set_yticks(range(len(shown)), labels)
        most = max(row.rate for row in shown)
        top.set_xlim(0.0, 3.2 * max(most, 2.0))
        top.set_xticks(range(0, int(most) + 2, 2))
        style_axes(top, "presses per second", "", "highest rate up to which every press is a note")
        top.grid(visible=False, axis="y")  # a line through the texts
        failed = [row for row in self.rows if row.press]
        if failed:
            row = min(failed, key=lambda r: r.press)
            runs = list(_runs(self.action, row.force, row.key_return, self.travel, HIGHEST))
            time, depth, gap, begins = [], [], [], []
            begin = 0.0
            for run, presses in runs[-2:]:
                time.append(1e3 * (begin + run.time))
                depth.append(1e3 * _depth(self.action, run))
                gap.append(-1e3 * run[_strike(self.action)])
                begins += [1e3 * (begin + p.start) for p in presses]
                last = [p.reason for p in presses]
                begin += run.time[-1]
            bottom.plot(np.hstack(time), np.hstack(depth), color=BLUE, label="key, below rest")
            bottom.plot(np.hstack(time), np.hstack(gap), color=RED, label="hammer to string")
            for at in begins:
                bottom.axvline(at, color=GRAY, lw=0.7, ls=":")
            place = len(begins) - len(last) + next(i for i, why in enumerate(last) if why)
            ends = [*begins[1:], 1e3 * begin]
            bottom.axvspan(begins[place], ends[place], color=PALE, alpha=0.5, lw=0,
                           label="the press that fails")  # fmt: skip
            bottom.set_ylim(-1.0, float(np.max(np.hstack(gap))) + 8.0)
            bottom.legend(fontsize=8, frameon=False, loc="upper right", ncols=3)
            style_axes(bottom, "time [ms]", "distance [mm]",
                       f"{row.force:g} N, beyond {row.rate_text}/s: {row.sentence}")  # fmt: skip
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
    run = simulate(
        action, ramp_stroke(10.0, 0.02, 0.3, duration=0.35), ledger=False, output_rate=2000.0
    )
    landed = run.summary.get(f"{action.config.reading.touch.landing}_time")
    if landed is None:
        raise Error(f"{action.name!r}: the key does not reach its punching with 10 N; {REGULATE}")
    return float(np.interp(landed, run.time, run[_key(action)][0] - run[_key(action)]))


def _key(action: Action) -> str:
    return f"{action.config.reading.key_point}.y"


def _strike(action: Action) -> str:
    return f"contact{roles_of(action)['strike']:02d}.compression"


def _depth(action: Action, run: Run) -> Any:
    """Depth of the key point below its rest without a finger [m]."""
    return _rest(action)[1] - run[_key(action)]


def _rest(action: Action) -> tuple[float, float]:
    """Place of the key point at rest [m]."""
    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import ramp_stroke

    run = simulate(action, ramp_stroke(0.0), duration=1e-3, ledger=False)
    point = action.config.reading.key_point
    return float(run[f"{point}.x"][0]), float(run[f"{point}.y"][0])


# ---------------------------------------------------------------- the finger


def with_finger(action: Action, height: float = 0.0) -> Action:
    """The mechanism with a finger of :data:`MASS` that turns back at a depth of the key [m].

    The finger turns about a joint that carries its weight, so that muscles only move it. Its force
    is the input. A hand above it stops the lifted finger.
    """
    finger, at = action.config.finger, _rest(action)
    assert finger is not None  # roles_of needs one
    down = [d / math.hypot(*finger.direction) for d in finger.direction]
    side, up = (-down[1], down[0]), [-d for d in down]

    def place(along: float, below: float = 0.0) -> list[float]:
        return [along * s + below * d for s, d in zip(side, down, strict=True)]

    raw = action.raw
    raw["bodies"][_FINGER] = {
        "joint": "revolute",
        "coordinate": f"{_FINGER}.angle",
        "position": [a + b for a, b in zip(at, place(ARM), strict=True)],
        "mass": MASS,
        "inertia": MASS * ARM**2,
    }
    # Without a force, the angle of the finger above the key would be undetermined at rest.
    raw.setdefault("springs", {})[_FINGER] = {
        "coordinate": f"{_FINGER}.angle", "stiffness": 1e-4, "rest_angle": 0.0
    }  # fmt: skip
    raw["surfaces"] |= {
        _FINGER: {"body": _FINGER, "kind": "circle", "point": place(-ARM, -TIP), "radius": TIP},
        f"{_FINGER} key": {
            "body": finger.body, "kind": "line", "point": list(finger.point), "normal": up
        },
        _HAND: {
            "body": "ground", "kind": "line", "normal": down,
            "point": [a + b for a, b in zip(at, place(0.0, height - 2.0 * TIP), strict=True)],
        },
    }  # fmt: skip
    pad = finger.pad.hunt_crossley
    skin = {name: float(getattr(pad, name)) for name in ("stiffness", "exponent", "damping")}
    first = 1 + max(map(int, raw["contacts"]))
    for number, other, law in ((first, f"{_FINGER} key", skin), (first + 1, _HAND, _STOP)):
        raw["contacts"][f"{number:02d}"] = {
            "surfaces": [_FINGER, other], "law": "hunt_crossley", "hunt_crossley": law
        }  # fmt: skip
    for lead in raw.get("leads", {}).values():
        lead["body"] = lead.get("body") or finger.body
    raw["finger"] |= {"body": _FINGER, "point": place(-ARM)}
    played = Action(raw, action.origin)
    return played.with_laws(action.laws) if action.laws else played


#: The hand above the finger: stiff, and without a rebound.
_STOP = {"stiffness": 1e6, "exponent": 1.5, "damping": 20.0}


def _stroke(rates: Sequence[float], force: float, *, first: bool) -> tuple[Stroke, list[float]]:
    """Presses of the finger, and their starts [s]: it presses for a half of each period."""
    from feltmb.run.stroke import table_stroke

    time, value, starts = [0.0], [-LIFT], []
    start = 0.02 if first else 1e-4
    for rate in rates:
        turn = start + 0.5 / rate
        time += [start, start + RISE, turn, turn + RISE]
        value += [-LIFT, force, force, -LIFT]
        starts.append(start)
        start += 1.0 / rate
    return table_stroke(time, value, interpolation="linear", duration=start - 1e-4), starts


def _runs(
    action: Action, force: float, key_return: float, travel: float, highest: float
) -> Iterator[tuple[Run, list[_Press]]]:
    """Runs of a few presses each, one after the other, until a press fails."""
    from feltmb.run.simulate import simulate

    height = (1.0 - key_return) * travel
    played = with_finger(action, height)
    count = 1 + math.ceil(math.log(highest / LOWEST) / math.log(GROWTH) - 1e-9)
    rates = [min(LOWEST * GROWTH**k, highest) for k in range(count)]
    run: Run | None = None
    judge = _Judge(action, height)
    for k in range(0, count, PART):
        own = rates[k : k + PART]
        stroke, starts = _stroke(own, force, first=run is None)
        run = simulate(played, stroke, start=run, ledger=False, output_rate=2000.0)
        presses = judge.presses(run, own, starts)
        yield run, presses
        if any(press.reason for press in presses):
            return


class _Judge:
    """Tells notes from failed presses, from run to run."""

    def __init__(self, action: Action, height: float) -> None:
        self.roles, self.key = roles_of(action), _key(action)
        self.lifted = _rest(action)[1] - height
        self.strike = _strike(action)
        self.whole = self.impulse = 0.0
        self.most = math.inf  # the first press begins at rest

    def presses(self, run: Run, rates: Sequence[float], starts: list[float]) -> list[_Press]:
        """The presses of a run."""
        import numpy as np

        strikes = run.strikes
        times = np.asarray(strikes.get("impact_time", ()), dtype=float)
        impacts = np.asarray(strikes.get("impact_speed", ()), dtype=float)
        jack = run[f"contact{self.roles['let_off']:02d}.force"]
        gap = -run[self.strike]
        if not self.whole:
            self.whole = float(gap[0])
        out, begin = [], 0.0  # from here on, the hammer comes back
        for rate, start, end in zip(rates, starts, [*starts[1:], run.time[-1]], strict=True):
            own = (times >= start) & (times < end)
            hit = float(times[own][np.argmax(impacts[own])]) if own.any() else end
            before = (run.time >= start) & (run.time <= hit)
            most = max(self.most, float(np.max(gap[(run.time >= begin) & (run.time <= hit)])))
            impulse = float(np.sum(jack[before]))
            self.impulse = self.impulse or impulse
            back = min(1.0, most / self.whole)
            speed = float(np.max(impacts[own], initial=0.0))
            late = self.lifted - float(np.interp(start, run.time, run[self.key]))
            reason = ""
            if speed < AUDIBLE or back < BACK or impulse < DRIVEN * self.impulse:
                if late > LATE:
                    reason = "key too slow"
                elif back < BACK:
                    reason = "hammer not back"
                else:
                    reason = "weak" if impulse >= DRIVEN * self.impulse else "jack not back"
            out.append(_Press(start, rate, speed, back, reason))
            begin, self.most = hit, 0.0
        self.most = float(np.max(gap[run.time >= begin]))
        return out


# ---------------------------------------------------------------- the highest rate


def highest_rate(
    action: Action,
    travel: float,
    force: float = 10.0,
    key_return: float = 1.0,
    *,
    highest: float = HIGHEST,
    stop: Event | None = None,
) -> Repeated:
    """Press faster and faster until a press is no note.

    Parameters
    ----------
    travel
        Key travel to the punching [m], see :func:`key_travel`.
    force
        Largest force of the finger [N].
    key_return
        Share of the key travel that the key may return [1].
    highest
        Rate at which the test ends [1/s].
    stop
        Event that interrupts the test.
    """
    presses: list[_Press] = []
    interrupted = stop is not None and stop.is_set()
    if not interrupted:
        for _, found in _runs(action, force, key_return, travel, highest):
            presses += found
            if stop is not None and stop.is_set():
                interrupted = True
                break
    if presses and presses[0].reason == "weak":
        raise Error(
            f"{action.name!r}: a single press with {force:g} N does not strike with {AUDIBLE:g} "
            "m/s; press harder, or regulate the action"
        )
    bad = next((k for k, press in enumerate(presses) if press.reason), len(presses))
    good = presses[:bad]
    failed = presses[bad].reason if bad < len(presses) else "interrupted" if interrupted else ""
    return Repeated(
        force=force,
        key_return=key_return,
        rate=good[-1].rate if len(good) > 1 else 0.0,
        press=bad + 1 if bad < len(presses) else 0,
        reason=failed,
        impact_speed=presses[0].speed if presses else math.nan,
        weakest=min((p.speed for p in good[1:]), default=math.nan),
        least_back=min((p.back for p in good[1:]), default=math.nan),
    )


@checked
def repeat(
    action: Action | str,
    *,
    forces: Sequence[float] = FORCES,
    returns: Sequence[float] = RETURNS,
    highest: float = HIGHEST,
) -> Repetition:
    """Find the highest rate up to which every press of the key is a note.

    An interrupt (Ctrl-C) ends the test; the result has what was found until then.

    Parameters
    ----------
    action
        Mechanism, or its name for :func:`load_action`.
    forces
        Largest forces of the finger [N], > 0: soft and firm.
    returns
        Shares of the key travel that the key may return between presses, 0 < share <= 1.
    highest
        Rate at which the test ends [1/s], above 3, at most 30.

    Raises
    ------
    InvalidParameter
        A number is out of range, or the mechanism does not name the required contacts.
    Error
        A single press does not strike, or the key does not reach its punching.
    """
    if isinstance(action, str):
        action = load_action(action)
    for name, values, most in (("forces", forces, 100.0), ("returns", returns, 1.0)):
        if not values or not all(math.isfinite(v) and 0.0 < v <= most for v in values):
            raise InvalidParameter(f"repeat: {name} = {list(values)!r}, expected > 0 to {most:g}")
    if not LOWEST < highest <= 30.0:
        raise InvalidParameter(
            f"repeat: highest = {highest:g} 1/s, expected more than {LOWEST:g}, at most 30 1/s"
        )
    travel = key_travel(action)
    jobs = [(f, r) for f in sorted(forces) for r in sorted(returns, reverse=True)]
    stop = Event()
    with ThreadPoolExecutor() as pool:
        found = [
            pool.submit(highest_rate, action, travel, f, r, highest=highest, stop=stop)
            for f, r in jobs
        ]
        try:
            wait(found)
        except KeyboardInterrupt:
            stop.set()
        return Repetition(action, tuple(future.result() for future in found), travel)
