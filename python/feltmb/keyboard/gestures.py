"""Strokes of a finger: struck, pressed, staccato, repeated, half returned; and what they strike.

A gesture is a finger that moves as prescribed; the hammer speed that it makes is found by
inversion: a table of simulated strokes, from which the finger speed for a hammer speed is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from feltmb.mechanism import Action
from feltmb.run.batch import simulate_many
from feltmb.run.stroke import Stroke, motion_stroke
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter, no_such

if TYPE_CHECKING:
    from feltmb.run.results import Run

#: Kind -> share of the gestures of a set.
KINDS = {"struck": 0.3, "pressed": 0.3, "staccato": 0.15, "repeated": 0.15, "half return": 0.1}
#: A kind that is made if it is asked for: after a press, the key is pressed again from within the
#: aftertouch, where the jack has not come back. The hammer may stir; mostly it does not strike.
AFTERTOUCH = "aftertouch"
#: Kinds of several presses: least and largest share of the depth that the finger goes back.
RETURNS = {"repeated": (1.0, 1.0), "half return": (0.5, 0.75), AFTERTOUCH: (0.05, 0.3)}
#: Displacement of the finger in a press: time to this power.
POWERS = {"struck": 1.0, "pressed": 2.0}
#: Finger speeds at the key bottom, of which the table of an inversion is made [m/s].
SPEEDS = tuple(np.geomspace(0.05, 1.6, 18).tolist())
START, AFTER = 0.02, 0.12  # s, before the first press and after the last release
#: The finger goes this much below the rest of the key [m]; its pad and the punching yield.
DEPTH = 0.0115
UP_SPEED = 0.25  # m/s, speed of the finger upward
RATE = 8000.0  # Hz, samples of a run
#: Fields of a strike that are the truth: time [s] and speed at the string [m/s].
TRUTH = ("impact_time", "impact_speed")


@dataclass(frozen=True)
class Press:
    """One press of a gesture.

    Attributes
    ----------
    speed : float
        Speed of the finger at the key bottom [m/s].
    power : float
        1: constant speed, struck; 2: constant acceleration, pressed.
    hold : float
        Time at the key bottom [s].
    back : float
        Share of the depth that the finger returns afterward [1].
    up : float
        Speed of the return [m/s].
    start : float
        Earliest start of the press [s]; default: as soon as the finger is back.
    """

    speed: float
    power: float = 1.0
    hold: float = 0.1
    back: float = 1.0
    up: float = UP_SPEED
    start: float = 0.0


@checked
def gesture(presses: Sequence[Press], name: str = "gesture") -> Stroke:
    """Motion of a finger through presses, one after the other.

    Parameters
    ----------
    presses
        At least one.
    name
        Name of the stroke.
    """
    if not presses:
        raise InvalidParameter("gesture: got no press, expected at least one")
    time, depth = [0.0], [0.0]
    for press in presses:
        start = max(press.start, START, time[-1] + 0.002)
        way = DEPTH - depth[-1]
        steps = np.linspace(0.0, 1.0, 9)
        time += (start + steps * press.power * way / press.speed).tolist()
        depth += (depth[-1] + way * steps**press.power).tolist()
        end = time[-1] + max(press.hold, 0.001)
        time += [end, end + press.back * DEPTH / press.up]
        depth += [DEPTH, DEPTH * (1.0 - press.back)]
    return motion_stroke(
        time, depth, interpolation="monotone", duration=time[-1] + AFTER, name=name
    )


def truth_of(run: Run) -> list[tuple[float, float]]:
    """Time [s] and speed at the string [m/s] of each strike of a run."""
    return [(row[TRUTH[0]], row[TRUTH[1]]) for row in run.strike_list]


def run_all(
    action: Action,
    strokes: Iterable[Stroke],
    take: Callable[[int, Run], object],
    jobs: int | None = None,
) -> None:
    """Simulate strokes in order; one that fails ends the call with its error."""

    def given(index: int, outcome: Run | Error) -> None:
        if isinstance(outcome, Error):
            raise outcome
        take(index, outcome)

    simulate_many(((action, s) for s in strokes), given, jobs=jobs, output_rate=RATE)


Tables = Mapping[float, tuple[tuple[float, ...], tuple[float, ...]]]
#: Tables of the actions of this process, by their hash: they take seconds.
_TABLES: dict[str, Tables] = {}


@dataclass(frozen=True, eq=False)
class Inversion:
    """Hammer speeds of simulated strokes of an action, and the finger speeds for them."""

    action: Action

    @cached_property
    def tables(self) -> Tables:
        """Power of a press -> hammer speeds, increasing, and finger speeds [m/s]."""
        if self.action.hash not in _TABLES:
            _TABLES[self.action.hash] = self._simulated()
        return _TABLES[self.action.hash]

    def _simulated(self) -> Tables:
        plan = [(power, speed) for power in POWERS.values() for speed in SPEEDS]
        found: dict[float, list[tuple[float, float]]] = {p: [] for p in POWERS.values()}

        def take(index: int, run: Run) -> None:
            power, speed = plan[index]
            strikes = truth_of(run)
            if strikes and (not found[power] or strikes[0][1] > 1.02 * found[power][-1][0]):
                found[power].append((strikes[0][1], speed))

        run_all(self.action, (gesture([Press(s, p, 0.1)]) for p, s in plan), take)
        if any(len(pairs) < 4 for pairs in found.values()):
            raise InvalidParameter(
                f"action {self.action.name!r}: its hammer reaches the string in too few strokes; "
                "regulate it first"
            )
        return {
            power: (tuple(h for h, _ in pairs), tuple(f for _, f in pairs))
            for power, pairs in found.items()
        }

    def limits(self, power: float = 1.0) -> tuple[float, float]:
        """Softest and fastest hammer speed of the table [m/s]."""
        hammer = self.tables[power][0]
        return hammer[0], hammer[-1]

    def finger_speed(self, speed: float, power: float = 1.0) -> float:
        """Speed of the finger for a hammer speed [m/s], within the limits of the table."""
        hammer, finger = self.tables[power]
        return float(np.exp(np.interp(np.log(speed), np.log(hammer), np.log(finger))))


@dataclass(frozen=True, eq=False)
class Gesture:
    """A gesture of a set: its kind, its presses, the hammer speeds that were aimed at [m/s]."""

    kind: str
    presses: tuple[Press, ...]
    aimed: tuple[float, ...]

    @property
    def stroke(self) -> Stroke:
        """The motion of the finger."""
        return gesture(self.presses, self.kind)


def random_gestures(
    inversion: Inversion, count: int, seed: int = 0, kinds: Sequence[str] = ()
) -> Iterator[Gesture]:
    """Random gestures from ppp to fff, the same for the same seed.

    Parameters
    ----------
    inversion
        Inversion of the action that is played.
    count
        Number of gestures.
    seed
        Seed of the random numbers.
    kinds
        Kinds of gestures, with equal shares; none: ``KINDS`` with theirs.
    """
    names = list(kinds) or list(KINDS)
    for name in names:
        if name not in (*KINDS, AFTERTOUCH):
            raise no_such("kind of stroke", name, [*KINDS, AFTERTOUCH])
    shares = [KINDS[n] for n in names] if not kinds else None
    for each in np.random.SeedSequence(seed).spawn(count):
        rng = np.random.default_rng(each)
        kind = names[rng.choice(len(names), p=shares)]
        number = int(rng.integers(2, 6)) if kind in RETURNS else 1
        power = POWERS.get(kind, 1.0 if rng.random() < 0.5 else 2.0)
        low, high = np.log(inversion.limits(power))
        level = rng.uniform(low, high)
        presses, aimed = [], []
        for _ in range(number):
            speed = float(np.exp(np.clip(level + rng.normal(0.0, 0.15), low, high)))
            hold, back, up = rng.uniform(0.05, 0.15), 1.0, rng.uniform(0.15, 0.4)
            if kind == "staccato":
                hold, up = 0.0, rng.uniform(0.3, 0.8)
            elif number > 1:
                hold = rng.uniform(0.02, 0.06)
                low_back, high_back = RETURNS[kind]
                back = rng.uniform(low_back, high_back) if low_back < high_back else 1.0
            aimed.append(speed)
            finger = inversion.finger_speed(speed, power)
            presses.append(Press(finger, power, float(hold), float(back), float(up)))
        yield Gesture(kind, tuple(presses), tuple(aimed))
