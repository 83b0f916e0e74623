"""Touch of an action: what the finger feels, slowly and in blows.

Static: a press and a release without inertia at the key front, hence down-weight, up-weight,
friction, balance weight, let-off, key dip and aftertouch. Dynamic: two families of blows, pressed
(a force that rises within 20 ms and stays) and struck (a finger of constant speed that hits the
key), hence hammer speed, travel time and key-bottom time. ``docs/touch.md`` defines each number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb import _core, params
from feltmb.config import Action, load_action
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.files import read_toml, write_file
from feltmb.units import conversion_factor

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd

    from feltmb.quasistatic import PressPath, SimulatedPress

    Array = npt.NDArray[np.float64]

__all__ = ["Blow", "StaticTouch", "Touch", "TouchRow", "touch"]

GRAM_FORCE = 9.80665e-3  # N
#: Force levels of the pressed blows [N] and finger speeds of the struck ones [m/s].
FORCES = (1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 35.0)
SPEEDS = (0.05, 0.08, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)
RISE = 0.020  # s, of the force of a pressed blow
START = 0.020  # s, when the finger begins
#: Impact speeds of the thesis's piano and forte blow [m/s].
PIANO, FORTE = 1.06, 3.36
#: Rows of the static path [m]; margin of the window for the weights [m]; force at its end [N].
STEP, MARGIN, BOTTOM_FORCE = 2.5e-5, 5e-4, 10.0


@dataclass(frozen=True, eq=False)
class StaticTouch:
    """Slow press and release without inertia, friction saturated.

    Forces in N at the finger, travels in m of the finger's point on the key from rest.
    """

    down_weight: float  #: mean force of the press in the window, damper lifted
    up_weight: float  #: mean force of the release in the window, damper lifted
    down_weight_most: float  #: largest force of the press in the window
    up_weight_least: float  #: smallest force of the release in the window
    down_weight_damper: (
        float  #: force of the press just before the toe meets the button, damper in action
    )
    window: tuple[float, float]  #: travels between which the weights are taken
    take_up: float  #: travel at which the jack meets the butt
    damper_start: float | None  #: part of the blow done when the spoon meets the damper lever
    let_off_force: float  #: largest force up to the let-off
    let_off_travel: float  #: travel at which the jack slips out
    let_off_gap: float  #: hammer to string there, without inertia
    key_dip: float  #: travel at which the key meets the front punching
    aftertouch: float  #: key_dip - let_off_travel
    press: PressPath  #: to the bottom, the damper in action
    release: PressPath  #: back again
    lifted_press: PressPath  #: the same within the window, damper lifted
    lifted_release: PressPath

    @property
    def friction(self) -> float:
        """(down-weight - up-weight) / 2 [N]."""
        return 0.5 * (self.down_weight - self.up_weight)

    @property
    def balance_weight(self) -> float:
        """(down-weight + up-weight) / 2 [N]."""
        return 0.5 * (self.down_weight + self.up_weight)


@dataclass(frozen=True)
class Blow:
    """One simulated blow."""

    kind: str  #: pressed or struck
    level: float  #: force level [N] or finger speed [m/s]
    hammer_speed: float | None  #: at the string [m/s]; None: it does not reach the string
    key_speed: float | None  #: largest speed of the key front up to then [m/s]
    travel_time: float | None  #: key start (0.1 mm) to string contact [s]
    bottom_after_start: float | None  #: key start to key bottom [s]
    bottom_after_string: float | None  #: string contact to key bottom [s]
    failure: str = ""  #: why there is no result


@dataclass(frozen=True)
class TouchRow:
    """One number of the touch beside a published one."""

    key: str
    name: str
    value: float | None  #: in ``unit``
    unit: str
    low: float | None = None  #: published range
    high: float | None = None
    published: float | None = None  #: a single published number
    source: str = ""

    @property
    def verdict(self) -> str:
        """``inside``, ``below`` or ``above`` a range; the difference from a number; else empty."""
        if self.value is None:
            return ""
        if self.low is not None and self.high is not None:
            if self.value < self.low:
                return "below"
            return "above" if self.value > self.high else "inside"
        if self.published is not None:
            unit = "" if self.unit == "1" else f" {self.unit}"
            return f"{round(self.value - self.published, 2) + 0.0:+.3g}{unit}"
        return ""


@dataclass(frozen=True, eq=False)
class Touch:
    """Touch of an action.

    Attributes
    ----------
    rows : tuple of TouchRow
        The table: ours beside published numbers.
    static : StaticTouch
        Slow press and release.
    slow : SimulatedPress
        Simulated press and release at 10 mm/s, for comparison.
    blows : tuple of Blow
        Pressed, then struck, by level.
    fits : dict
        By kind of blow, a [s] and b of travel time = a v^b, v the hammer speed in m/s, and the
        largest relative residual.
    """

    action: Action
    rows: tuple[TouchRow, ...]
    static: StaticTouch
    slow: SimulatedPress
    blows: tuple[Blow, ...]
    fits: dict[str, tuple[float, float, float]]

    def __getitem__(self, key: str) -> float | None:
        """Value of a row by key, in the unit of the row."""
        for row in self.rows:
            if row.key == key:
                return row.value
        raise InvalidParameter(f"touch has no {key!r}; keys are {', '.join(self.keys())}")

    def keys(self) -> list[str]:
        """Keys of the rows."""
        return [row.key for row in self.rows]

    @cached_property
    def curve(self) -> pd.DataFrame:
        """Force against travel.

        Columns: ``branch`` (press, release, press_lifted, release_lifted: the damper lifted),
        ``travel`` [m], ``force`` [N], ``hammer_gap`` [m].
        """
        import pandas as pd

        strike = self.action.config.summary.strike_contact
        assert strike is not None
        parts = []
        for name, path in _branches(self.static):
            parts.append(
                pd.DataFrame(
                    {
                        "branch": name,
                        "travel": path.travel,
                        "force": path.force,
                        "hammer_gap": path.gap[strike],
                    }
                )
            )
        return pd.concat(parts, ignore_index=True)

    @cached_property
    def blow_table(self) -> pd.DataFrame:
        """One row a blow, SI units; see :class:`Blow`."""
        import pandas as pd

        return pd.DataFrame([vars(blow) for blow in self.blows])

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        curve = {
            name: {"travel": path.travel.tolist(), "force": path.force.tolist()}
            for name, path in _branches(self.static)
        }
        return {
            "action": self.action.name,
            "hash": self.action.hash,
            "version": _core.__version__,
            "rows": [{**vars(row), "verdict": row.verdict} for row in self.rows],
            "window": list(self.static.window),
            "curve": curve,
            "blows": [dict(vars(blow)) for blow in self.blows],
            "fits": {
                kind: {"a": a, "b": b, "largest_residual": worst}
                for kind, (a, b, worst) in self.fits.items()
            },
        }

    def plot(self, folder: str | Path, *, force: bool = False) -> list[Path]:
        """Draw ``touch_static.png`` and ``touch_dynamic.png`` in a folder."""
        folder = Path(folder)
        written = []
        for name, figure in (
            ("touch_static", static_figure(self)),
            ("touch_dynamic", dynamic_figure(self)),
        ):

            def save(path: Path, figure: Any = figure) -> None:
                figure.savefig(path, dpi=150)

            written.append(write_file(folder / f"{name}.png", save, force=force))
        return written


def _branches(static: StaticTouch) -> list[tuple[str, PressPath]]:
    return [
        ("press", static.press),
        ("release", static.release),
        ("press_lifted", static.lifted_press),
        ("release_lifted", static.lifted_release),
    ]


# --- static --------------------------------------------------------------------------------------


def _roles(action: Action) -> dict[str, int]:
    """Contacts by what they do; from the events and the summary roles of the mechanism file."""
    events, summary = action.config.events, action.config.summary
    found: dict[str, int | None] = {
        "strike": summary.strike_contact,
        "let_off": summary.let_off_contact,
    }
    for role, name in (("damper", "damper_start"), ("toe", "jack_toe"), ("bottom", "key_landing")):
        rule = events.get(name)
        found[role] = rule.contact if rule is not None and isinstance(rule.contact, int) else None
    missing = [role for role, number in found.items() if number is None and role != "damper"]
    if action.config.finger is None:
        missing.append("finger")
    if missing:
        raise InvalidParameter(
            f"touch: mechanism {action.name!r} does not say which contact is {', '.join(missing)}; "
            f"needed are [finger], summary.strike_contact, summary.let_off_contact and the events "
            f"jack_toe and key_landing"
        )
    return {role: number for role, number in found.items() if number is not None}


def _follow(press: Any, targets: Array, stop: Callable[[Any], bool] | None = None) -> PressPath:
    from feltmb.quasistatic import path_of

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


def static_touch(action: Action, *, most_travel: float = 0.02) -> StaticTouch:
    """Slow press and release at the key front; see ``docs/touch.md``.

    Raises
    ------
    ModelError
        No equilibrium beyond some travel.
    FeltmbError
        The jack does not meet the butt or the button, or does not let off, so that there is
        nothing to measure.
    """
    import numpy as np

    from feltmb.quasistatic import SlowPress

    roles = _roles(action)
    strike, let_off, bottom = roles["strike"], roles["let_off"], roles["bottom"]
    grid = np.arange(0.0, most_travel, STEP)
    press = SlowPress(action, friction="saturated")
    down = _follow(press, grid, lambda p: bool(p.force > BOTTOM_FORCE))
    release = _follow(press, down.travel[::-1])
    take_up = down.when(let_off)
    toe = down.when(roles["toe"])
    dip = down.when(bottom)
    if take_up is None or toe is None:
        what = "the butt" if take_up is None else "the let-off button"
        raise FeltmbError(f"touch of {action.name!r}: the jack does not meet {what} in a press")
    if dip is None:
        raise FeltmbError(
            f"touch of {action.name!r}: the key does not reach its front punching in a press up to "
            f"{BOTTOM_FORCE:g} N (hammer blocked on the string?)"
        )
    opened = (roles["damper"],) if "damper" in roles else ()
    lifted = SlowPress(action, friction="saturated", open_contacts=opened)
    # It turns where the toe meets the button, so that friction has turned over before the window.
    lifted_down = _follow(lifted, grid, lambda p: bool(p.state()[roles["toe"]][0] <= 0.0))
    lifted_up = _follow(lifted, lifted_down.travel[::-1])
    starts, ends = lifted_down.when(let_off), lifted_down.when(roles["toe"])
    if starts is None or ends is None or not starts + MARGIN < ends - MARGIN:
        raise FeltmbError(
            f"touch of {action.name!r}: there is no travel between the take-up of the hammer at "
            f"{1e3 * take_up:.2f} mm and the jack toe at {1e3 * toe:.2f} mm to take weights in"
        )
    window = (starts + MARGIN, ends - MARGIN)
    forces = lifted_down.force[_within(lifted_down, window)]
    back = lifted_up.force[_within(lifted_up, window)]
    row, end, tripped = _let_off(down, toe, dip)
    if not tripped:
        raise FeltmbError(f"touch of {action.name!r}: the jack does not slip out of the butt")
    damper_start, down_damper = None, math.nan
    if "damper" in roles:
        start = down.when(roles["damper"])
        if start is not None:
            damper_start = 1.0 - down.at(down.gap[strike], start) / float(down.gap[strike][0])
            # Just before the toe the damper is off the string, if it starts in time.
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
        let_off_force=float(down.force[row]),
        let_off_travel=float(down.travel[row]),
        let_off_gap=float(np.min(down.gap[strike][:end])),
        key_dip=dip,
        aftertouch=dip - float(down.travel[row]),
        press=down,
        release=release,
        lifted_press=lifted_down,
        lifted_release=lifted_up,
    )


def _within(path: PressPath, window: tuple[float, float]) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = (path.travel >= window[0]) & (path.travel <= window[1])
    return inside


def _let_off(path: PressPath, toe: float, dip: float) -> tuple[int, int, bool]:
    """Row of the force peak, first row after the let-off, and whether the jack let go.

    It lets go where the path jumps, or else where the force falls before the key bottoms.
    """
    import numpy as np

    first = int(np.searchsorted(path.travel, toe))
    jumps = [row for row in path.jumps if row > first]
    end = jumps[0] if jumps else int(np.searchsorted(path.travel, dip))
    if end <= first:
        return first, first + 1, False
    row = first + int(np.argmax(path.force[first:end]))
    fell = bool(np.min(path.force[row:end]) < 0.9 * path.force[row])
    return row, end, bool(jumps) or fell


# --- dynamic -------------------------------------------------------------------------------------


def _blow(action: Action, kind: str, level: float, dip: float) -> Blow:
    import numpy as np

    from feltmb.simulate import simulate
    from feltmb.stroke import motion_stroke, ramp_stroke

    if kind == "pressed":
        stroke = ramp_stroke(level, START, RISE, duration=0.45, name=f"pressed {level:g} N")
    else:
        # The finger goes on until 1 mm below where the key meets its punching.
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
    except FeltmbError as error:
        return Blow(kind, level, None, None, None, None, None, str(error))
    s = run.summary
    start, hit = s.get("key_start_time"), s.get("string_contact_on_time")
    land = s.get("key_landing_time")
    if hit is None or start is None:
        return Blow(
            kind, level, None, None, None, None, None, "the hammer does not reach the string"
        )
    point = action.config.summary.key_point
    speed = None
    if point is not None:
        speed = float(np.max(-run[f"{point}.vy"][run.time <= hit]))
    return Blow(
        kind,
        level,
        s["impact_speed"],
        speed,
        hit - start,
        None if land is None else land - start,
        None if land is None else land - hit,
    )


def _fit(blows: Sequence[Blow]) -> tuple[float, float, float] | None:
    """A and b of travel time = a v^b, least squares in the logarithms; largest residual."""
    import numpy as np

    pairs = [(b.hammer_speed, b.travel_time) for b in blows if b.hammer_speed and b.travel_time]
    if len(pairs) < 3:
        return None
    v, t = np.log(np.array(pairs)).T
    b, log_a = np.polyfit(v, t, 1)
    worst = float(np.max(np.abs(np.exp(log_a + b * v - t) - 1.0)))
    return float(np.exp(log_a)), float(b), worst


def _at_speed(blows: Sequence[Blow], field: str, speed: float) -> float | None:
    """A number of a family at a hammer speed, interpolated in its logarithm."""
    import numpy as np

    pairs = sorted(
        (b.hammer_speed, getattr(b, field))
        for b in blows
        if b.hammer_speed and getattr(b, field) is not None
    )
    if not pairs or not pairs[0][0] <= speed <= pairs[-1][0]:
        return None
    v, y = np.array(pairs, dtype=float).T
    return float(np.interp(math.log(speed), np.log(v), y))


# --- all of it -----------------------------------------------------------------------------------


def touch(
    action: Action | str,
    *,
    forces: Sequence[float] = FORCES,
    speeds: Sequence[float] = SPEEDS,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> Touch:
    """Measure the touch of an action.

    Parameters
    ----------
    action
        Mechanism, or its name for :func:`load_action`.
    forces
        Levels of the pressed blows [N], > 0.
    speeds
        Finger speeds of the struck blows [m/s], > 0.
    executor
        Runs the blows; default: threads, one a core.
    progress
        Called with a line of text now and then.

    Raises
    ------
    InvalidParameter
        A level is not > 0, or the mechanism does not name the contacts that are looked at.
    FeltmbError
        The action cannot be measured, for example because its hammer is blocked.
    """
    from feltmb.quasistatic import simulated_press

    if isinstance(action, str):
        action = load_action(action)
    for name, levels in (("forces", forces), ("speeds", speeds)):
        for level in levels:
            if not (math.isfinite(level) and level > 0):
                raise InvalidParameter(f"touch: {name} holds {level!r}, must be > 0")
    say = progress or (lambda _text: None)
    say("slow press and release")
    static = static_touch(action)
    dip = static.key_dip
    say(f"{len(forces) + len(speeds)} blows")
    jobs = [("pressed", f) for f in sorted(forces)] + [("struck", v) for v in sorted(speeds)]
    pool = executor if executor is not None else ThreadPoolExecutor()
    try:
        slow_future = pool.submit(simulated_press, action, travel=dip + 1.2e-3, release=True)
        futures = [pool.submit(_blow, action, kind, level, dip) for kind, level in jobs]
        slow = slow_future.result()
        blows = tuple(future.result() for future in futures)
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)
    fits = {}
    for kind in ("pressed", "struck"):
        fit = _fit([b for b in blows if b.kind == kind])
        if fit is not None:
            fits[kind] = fit
    rows = _rows(action, static, slow, blows, fits)
    return Touch(action, rows, static, slow, blows, fits)


def _rows(
    action: Action,
    static: StaticTouch,
    slow: SimulatedPress,
    blows: tuple[Blow, ...],
    fits: dict[str, tuple[float, float, float]],
) -> tuple[TouchRow, ...]:
    roles = _roles(action)
    strike, bottom = roles["strike"], roles["bottom"]
    pressed = [b for b in blows if b.kind == "pressed" and b.hammer_speed]
    struck = [b for b in blows if b.kind == "struck" and b.hammer_speed]
    landed = [b for b in (*pressed, *struck) if b.bottom_after_string is not None]
    after_start = [b.bottom_after_start for b in landed if b.bottom_after_start is not None]
    by_speed = sorted(landed, key=lambda b: b.hammer_speed or 0.0)
    rows: list[tuple[str, str, float | None, str, str]] = [
        ("down_weight", "down-weight", static.down_weight, "N", "gf"),
        ("up_weight", "up-weight", static.up_weight, "N", "gf"),
        ("friction", "friction (DW-UW)/2", static.friction, "N", "gf"),
        ("balance_weight", "balance (DW+UW)/2", static.balance_weight, "N", "gf"),
        (
            "down_weight_most",
            "largest press force",
            static.down_weight_most,
            "N",
            "gf",
        ),
        ("up_weight_least", "least release force", static.up_weight_least, "N", "gf"),
        (
            "down_weight_damper",
            "press, damper off",
            static.down_weight_damper,
            "N",
            "gf",
        ),
        ("let_off_force", "let-off force peak", static.let_off_force, "N", "gf"),
        ("blow", "hammer blow", float(static.press.gap[strike][0]), "m", "mm"),
        ("let_off_distance", "let-off distance", slow.closest, "m", "mm"),
        ("let_off_gap_static", "same without inertia", static.let_off_gap, "m", "mm"),
        ("damper_start", "damper start / blow", static.damper_start, "1", "1"),
        ("let_off_travel", "travel at let-off", static.let_off_travel, "m", "mm"),
        ("key_dip", "key dip", float(static.press.gap[bottom][0]), "m", "mm"),
        ("key_travel", "travel at punching", static.key_dip, "m", "mm"),
        ("aftertouch", "aftertouch", static.aftertouch, "m", "mm"),
        (
            "bottom_after_start_fastest",
            "bottom-start, least",
            min(after_start, default=None),
            "s",
            "ms",
        ),
        (
            "bottom_after_start_slowest",
            "bottom-start, most",
            max(after_start, default=None),
            "s",
            "ms",
        ),
        (
            "bottom_after_string_softest",
            "bottom-string, soft",
            by_speed[0].bottom_after_string if by_speed else None,
            "s",
            "ms",
        ),
        (
            "bottom_after_string_loudest",
            "bottom-string, loud",
            by_speed[-1].bottom_after_string if by_speed else None,
            "s",
            "ms",
        ),
        (
            "bottom_after_string_piano",
            f"same, pressed {PIANO:g} m/s",
            _at_speed(pressed, "bottom_after_string", PIANO),
            "s",
            "ms",
        ),
        (
            "bottom_after_string_forte",
            f"same, pressed {FORTE:g} m/s",
            _at_speed(pressed, "bottom_after_string", FORTE),
            "s",
            "ms",
        ),
    ]
    for kind in ("pressed", "struck"):
        a, b, _ = fits.get(kind, (None, None, None))
        rows.append((f"travel_time_factor_{kind}", f"travel 1 m/s, {kind}", a, "s", "ms"))
        rows.append((f"travel_time_exponent_{kind}", f"exponent, {kind}", b, "1", "1"))
    shorter = None
    if "pressed" in fits and "struck" in fits:
        shorter = sum(
            sign * fits[kind][0] * 2.0 ** fits[kind][1]
            for kind, sign in (("pressed", 1.0), ("struck", -1.0))
        )
    rows.append(("struck_shorter", "struck shorter, 2 m/s", shorter, "s", "ms"))
    published = _published()
    out = []
    for key, name, value, si, unit in rows:
        beside = published.get(key, {})
        scale = 1.0 / conversion_factor(unit, si)
        missing = value is None or not math.isfinite(value)
        out.append(
            TouchRow(
                key,
                name,
                None if missing or value is None else value * scale,
                unit,
                beside.get("low"),
                beside.get("high"),
                beside.get("value"),
                str(beside.get("source", "")),
            )
        )
    return tuple(out)


def _published() -> dict[str, dict[str, Any]]:
    path = params.folder("touch") / "published.toml"
    return {row["key"]: row for row in read_toml(path)["values"]}


# --- pictures ------------------------------------------------------------------------------------

PRESS, RELEASE, LIFTED, MUTED = "#0b5394", "#b45f06", "#38761d", "#777777"


def static_figure(result: Touch) -> Any:
    """Force against travel: press and release, let-off and key bottom marked."""
    from matplotlib.figure import Figure

    s = result.static
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    slow = result.slow
    axes.plot(
        1e3 * slow.travel, slow.force, color=MUTED, lw=0.7, label="simulated at 10 mm/s", zorder=1
    )
    axes.plot(1e3 * s.press.travel, s.press.force, color=PRESS, lw=1.8, label="press")
    axes.plot(1e3 * s.release.travel, s.release.force, color=RELEASE, lw=1.8, label="release")
    label = "damper lifted"
    for path in (s.lifted_press, s.lifted_release):
        axes.plot(1e3 * path.travel, path.force, color=LIFTED, lw=1.2, ls="--", label=label)
        label = "_"
    low, high = (1e3 * w for w in s.window)
    axes.axvspan(low, high, color=LIFTED, alpha=0.07, lw=0)
    for y in (s.down_weight, s.up_weight):
        axes.hlines(y, low, high, color=LIFTED, lw=0.8, ls=":")
    axes.text(
        low + 0.1,
        0.03,
        f"window of the weights: DW {s.down_weight:.2f} N, UW {s.up_weight:.2f} N",
        color=LIFTED,
        fontsize=8,
    )
    top = 1.5 * s.let_off_force
    axes.plot([1e3 * s.let_off_travel], [s.let_off_force], "o", color=PRESS, ms=6)
    axes.annotate(
        f"let-off\n{s.let_off_force:.2f} N at {1e3 * s.let_off_travel:.2f} mm",
        (1e3 * s.let_off_travel, s.let_off_force),
        xytext=(-14, 16),
        textcoords="offset points",
        ha="right",
        fontsize=9,
        color=PRESS,
        arrowprops={"arrowstyle": "-", "color": PRESS, "lw": 0.7},
    )
    axes.axvline(1e3 * s.key_dip, color="k", lw=0.7, ls="-.")
    axes.text(
        1e3 * s.key_dip + 0.08,
        0.03 * top,
        "key meets\npunching",
        fontsize=8,
        va="bottom",
        ha="left",
    )
    axes.set_xlim(0.0, 1e3 * s.press.travel[-1] + 0.8)
    axes.set_ylim(0.0, top)
    axes.set_xlabel("travel of the key front, mm")
    axes.set_ylabel("force at the key front, N")
    axes.set_title(f"{result.action.name}: static touch", loc="left")
    axes.legend(loc="upper left", frameon=False, fontsize=9)
    gram = axes.secondary_yaxis("right", functions=(_to_gram, _from_gram))
    gram.set_ylabel("gram-force")
    return figure


def _to_gram(force: Any) -> Any:
    return force / GRAM_FORCE


def _from_gram(weight: Any) -> Any:
    return weight * GRAM_FORCE


def dynamic_figure(result: Touch) -> Any:
    """Hammer speed, key-bottom time and travel time of the families of blows."""
    import numpy as np
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter

    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    panels = figure.subplots(2, 2)
    families = [
        (kind, color, marker, [b for b in result.blows if b.kind == kind and b.hammer_speed])
        for kind, color, marker in (("pressed", PRESS, "o"), ("struck", RELEASE, "s"))
    ]

    def columns(blows: list[Blow], x: str, y: str) -> tuple[list[float], list[float]]:
        rows = [(getattr(b, x), getattr(b, y)) for b in blows]
        rows = [(p, q) for p, q in rows if p is not None and q is not None]
        return [p for p, _ in rows], [q for _, q in rows]

    kind, color, marker, blows = families[0]
    axes = panels[0, 0]
    axes.plot(*columns(blows, "level", "hammer_speed"), marker=marker, color=color)
    axes.set_xlabel("force level of a pressed blow, N")
    axes = panels[0, 1]
    for kind, color, marker, blows in families:
        axes.plot(*columns(blows, "key_speed", "hammer_speed"), marker, color=color, label=kind)
    axes.set_xlabel("largest key front speed, m/s")
    for axes in (panels[0, 0], panels[0, 1]):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylabel("hammer speed at the string, m/s")
    panels[0, 1].legend(frameon=False, fontsize=9)
    axes = panels[1, 0]
    for kind, color, marker, blows in families:
        v, y = columns(blows, "hammer_speed", "bottom_after_string")
        axes.plot(v, [1e3 * t for t in y], marker=marker, lw=0.8, color=color, label=kind)
    axes.axhspan(-4.0, 35.0, color=MUTED, alpha=0.12, lw=0, label="grands, published range")
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set_ylim(-8.0, 50.0)
    axes.set_xscale("log")
    axes.set_xlabel("hammer speed at the string, m/s")
    axes.set_ylabel("key bottom after string contact, ms")
    axes.legend(frameon=False, fontsize=9, loc="upper right")
    axes = panels[1, 1]
    everything: list[float] = []
    for kind, color, marker, blows in families:
        v, y = columns(blows, "hammer_speed", "travel_time")
        everything += v
        axes.plot(v, [1e3 * t for t in y], marker, color=color, label=kind)
        if kind in result.fits and v:
            a, b, _ = result.fits[kind]
            x = np.geomspace(min(v), max(v), 60)
            axes.plot(
                x, 1e3 * a * x**b, color=color, lw=0.9, label=f"{1e3 * a:.0f} ms $v^{{{b:.2f}}}$"
            )
    published = _published()
    if everything:
        x = np.geomspace(min(everything), max(everything), 60)
        a, b = (published[f"travel_time_{k}_pressed"]["value"] for k in ("factor", "exponent"))
        axes.plot(x, a * x**b, color=MUTED, ls="--", lw=0.9, label="grands, " + _law(a, b))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("hammer speed at the string, m/s")
    axes.set_ylabel("travel time, ms")
    axes.legend(frameon=False, fontsize=9)
    plain = FuncFormatter(lambda value, _pos: f"{value:g}")
    for axes in panels.ravel():
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_formatter(plain)
                axis.set_minor_formatter(FuncFormatter(_some_minor))
        axes.grid(True, which="major", lw=0.3)
    figure.suptitle(f"{result.action.name}: blows", x=0.01, ha="left")
    return figure


def _law(factor: float, exponent: float) -> str:
    return f"{factor:.0f} ms $v^{{{exponent:.2f}}}$"


def _some_minor(value: float, _pos: int) -> str:
    """Label 2 and 5 between the decades."""
    lead = f"{value:e}"[0]
    return f"{value:g}" if lead in "25" else ""
