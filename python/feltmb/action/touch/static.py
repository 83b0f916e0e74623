"""Static touch: a slow press and release without inertia, and the values that follow from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feltmb.mechanism import Action
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.run.quasistatic import PressPath, SimulatedPress

    Array = npt.NDArray[np.float64]


#: Row spacing of the static path [m]; margin of the window for the weights [m]; force at its end
#: [N].
STEP, MARGIN, BOTTOM_FORCE = 2.5e-5, 5e-4, 10.0
#: Force under which a pressed dip is measured [N]: a weight of 250 g.
FIRM = 0.25 * 9.80665
REGULATE = "the action is not regulated: feltmb regulate sets its screws"


@dataclass(frozen=True, eq=False)
class StaticTouch:
    """Slow press and release without inertia, friction saturated.

    Let-off distance, dip and aftertouch are in :class:`Distances`. Forces at the finger [N];
    travels of the finger's point on the key from rest [m]; NaN: not reached, see ``notes``.
    """

    down_weight: float  #: mean force of the press in the window, damper off the string
    up_weight: float  #: mean force of the release in the window, damper off the string
    down_weight_most: float  #: largest force of the press in the window
    up_weight_least: float  #: smallest force of the release in the window
    down_weight_damper: (
        float  #: force of the press just before the toe meets the button, damper included
    )
    window: tuple[float, float]  #: first and last travel of the window for the weights
    take_up: float  #: travel at which the jack meets the hammer
    damper_start: float | None  #: hammer travel (share) when the spoon meets the damper lever
    let_off_force: float  #: largest force up to the let-off
    let_off_travel: float  #: travel at which the jack slips out
    bottom_travel: float  #: travel at which the key meets the front punching
    press: PressPath  #: path to the bottom, damper included
    release: PressPath  #: path of the release
    lifted_press: PressPath  #: path within the window, damper off the string
    lifted_release: PressPath
    notes: tuple[str, ...] = ()  #: what could not be measured, and why

    @property
    def end(self) -> float:
        """Travel at which the key meets the front punching, or else at which the press ends."""
        return self.bottom_travel if self.has_bottom else float(self.press.travel[-1])

    @property
    def has_bottom(self) -> bool:
        """Whether the key meets its punching."""
        return math.isfinite(self.bottom_travel)

    @property
    def has_let_off(self) -> bool:
        """Whether the jack slips off the hammer."""
        return math.isfinite(self.let_off_travel)

    @property
    def friction(self) -> float:
        """(down-weight - up-weight) / 2 [N]."""
        return 0.5 * (self.down_weight - self.up_weight)

    @property
    def balance_weight(self) -> float:
        """(down-weight + up-weight) / 2 [N]."""
        return 0.5 * (self.down_weight + self.up_weight)


def roles_of(action: Action) -> dict[str, int]:
    """Contacts by their function, as stated in ``[reading]`` of the mechanism file."""
    events, reading = action.config.events, action.config.reading
    found: dict[str, int | None] = {
        "strike": reading.strike_contact,
        "let_off": reading.let_off_contact,
    }
    touch = reading.touch
    for role, name in (("damper", touch.damper), ("toe", touch.toe), ("bottom", touch.landing)):
        rule = None if name is None else events[name]
        found[role] = rule.contact if rule is not None and isinstance(rule.contact, int) else None
    missing = [role for role, number in found.items() if number is None and role != "damper"]
    if action.config.finger is None:
        missing.append("finger")
    if touch.start is None:
        missing.append("start")
    if missing:
        raise InvalidParameter(
            f"touch: mechanism {action.name!r} does not say what is {', '.join(missing)}; "
            "needed are [finger], reading.strike_contact, reading.let_off_contact, and "
            "reading.touch with the events start, landing and toe, each of one contact"
        )
    return {role: number for role, number in found.items() if number is not None}


def _follow(press: Any, targets: Array, stop: Callable[[Any], bool] | None = None) -> PressPath:
    from feltmb.run.quasistatic import path_of

    rows: list[tuple[float, float, Array, dict[int, tuple[float, float]]]] = []
    jumps: list[int] = []
    for target in targets:
        press.advance(float(target))
        if press.jumped:
            jumps.append(len(rows))
        rows.append((press.travel, press.force, press.q, press.state()))
        if stop is not None and stop(press):
            break
    return path_of(rows, jumps, press.evaluations)


@checked
def static_touch(action: Action, *, most_travel: float = 0.02) -> StaticTouch:
    """Slow press and release at the key front; see ``docs/howto/measure_touch.md``.

    Raises
    ------
    ModelError
        There is no equilibrium beyond some travel.
    Error
        The jack does not meet the hammer or the button, so that nothing can be measured.
    """
    import numpy as np

    from feltmb.run.quasistatic import SlowPress

    roles = roles_of(action)
    strike, let_off, bottom = roles["strike"], roles["let_off"], roles["bottom"]
    grid = np.arange(0.0, most_travel, STEP)
    press = SlowPress(action, friction="saturated")
    down = _follow(press, grid, lambda p: bool(p.force > BOTTOM_FORCE))
    release = _follow(press, down.travel[::-1])
    take_up = _met(down, let_off)
    toe = down.when(roles["toe"])
    dip = down.when(bottom)
    if take_up is None or toe is None:
        what = "the hammer" if take_up is None else "the let-off button"
        raise Error(
            f"touch of {action.name!r}: the jack does not meet {what} in a press; {REGULATE}"
        )
    notes = []
    end_of_press = float(down.travel[-1]) if dip is None else dip
    if dip is None:
        dip = math.nan
        notes.append(
            f"the key does not reach its front punching in a press up to {BOTTOM_FORCE:g} N "
            "(hammer blocked on the string?)"
        )
    if take_up == 0.0:
        notes.append("the jack lifts the hammer off its rail at rest: there is no lost motion")
    opened = (roles["damper"],) if "damper" in roles else ()
    lifted = SlowPress(action, friction="saturated", open_contacts=opened)
    # The path reverses where the toe meets the button; friction has then reversed before the
    # window.
    lifted_down = _follow(lifted, grid, lambda p: bool(p.state()[roles["toe"]][0] <= 0.0))
    lifted_up = _follow(lifted, lifted_down.travel[::-1])
    starts, ends = _met(lifted_down, let_off), lifted_down.when(roles["toe"])
    if starts is None or ends is None or not starts + MARGIN < ends - MARGIN:
        raise Error(
            f"touch of {action.name!r}: there is no travel between the take-up of the hammer at "
            f"{1e3 * take_up:.2f} mm and the jack toe at {1e3 * toe:.2f} mm to take weights in"
        )
    window = (starts + MARGIN, ends - MARGIN)
    forces = lifted_down.force[_within(lifted_down, window)]
    back = lifted_up.force[_within(lifted_up, window)]
    row, tripped = _let_off(down, toe, end_of_press)
    if not tripped:
        notes.append("the jack does not slip off the hammer: there is no let-off")
    let_off_travel = float(down.travel[row]) if tripped else math.nan
    damper_start, down_damper = None, math.nan
    if "damper" in roles:
        start = down.when(roles["damper"])
        if start is not None:
            damper_start = 1.0 - down.at(down.gap[strike], start) / float(down.gap[strike][0])
            # Just before the toe meets the button, the damper is off the string if its lift begins
            # early enough.
            down_damper = down.at(down.force, toe - 0.5 * MARGIN)
    return StaticTouch(
        down_weight=float(np.mean(forces)),
        up_weight=float(np.mean(back)),
        down_weight_most=float(np.max(forces)),
        up_weight_least=float(np.min(back)),
        down_weight_damper=down_damper,
        window=window,
        take_up=take_up,
        damper_start=damper_start,
        let_off_force=float(down.force[row]) if tripped else math.nan,
        let_off_travel=let_off_travel,
        bottom_travel=dip,
        press=down,
        release=release,
        lifted_press=lifted_down,
        lifted_release=lifted_up,
        notes=(*notes, REGULATE) if notes else (),
    )


@dataclass(frozen=True)
class Distances:
    """What a technician measures with a ruler, as ``feltmb regulate`` does [m].

    The figure in ``docs/howto/regulate_an_action.md`` shows them. NaN: there is no let-off, or the
    key does not reach its punching.
    """

    blow: float  #: hammer to string at rest
    let_off: float  #: hammer to string where they are closest in a press at 10 mm/s
    dip: float  #: key front to its punching at rest
    dip_pressed: float  #: descent of the key front under 250 gf; the felt yields
    aftertouch: float  #: key front to its punching at the let-off

    @property
    def let_off_dip(self) -> float:
        """Dip at the let-off [m]."""
        return self.dip - self.aftertouch


def distances(action: Action, static: StaticTouch, slow: SimulatedPress) -> Distances:
    """Blow, let-off, dip and aftertouch of an action, from its slow presses."""
    roles = roles_of(action)
    bottom, gap = roles["bottom"], static.press.gap
    measurable = static.has_let_off and static.has_bottom
    path = static.press
    firm = (path.travel >= static.end) & (path.force >= FIRM)
    pressed = float(gap[bottom][0] - gap[bottom][firm][0]) if firm.any() else math.nan
    return Distances(
        blow=float(gap[roles["strike"]][0]),
        let_off=slow.closest,
        dip=float(gap[bottom][0]),
        dip_pressed=pressed,
        aftertouch=slow.left(bottom) if measurable else math.nan,
    )


def _met(path: PressPath, contact: int) -> float | None:
    """Travel at which a contact closes [m]; 0 if it is closed at rest, None if it never closes."""
    return 0.0 if path.gap[contact][0] <= 0.0 else path.when(contact)


def _within(path: PressPath, window: tuple[float, float]) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = (path.travel >= window[0]) & (path.travel <= window[1])
    return inside


def _let_off(path: PressPath, toe: float, dip: float) -> tuple[int, bool]:
    """Row of the force peak before the let-off, and whether there was a let-off.

    The let-off is a jump of the path, or else a drop of the force before the key reaches the
    bottom.
    """
    import numpy as np

    first = int(np.searchsorted(path.travel, toe))
    jumps = [row for row in path.jumps if row > first]
    end = jumps[0] if jumps else int(np.searchsorted(path.travel, dip))
    if end <= first:
        return first, False
    row = first + int(np.argmax(path.force[first:end]))
    fell = bool(np.min(path.force[row:end]) < 0.9 * path.force[row])
    return row, bool(jumps) or fell
