"""The complete touch of an action, and its comparison with published values."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.action.touch.pictures import dynamic_figure, static_figure
from feltmb.action.touch.published import published_numbers
from feltmb.action.touch.static import StaticTouch, distances, static_touch
from feltmb.action.touch.strikes import Strike, at_speed, fit_travel_time, simulate_strike
from feltmb.action.touch.weights import Weights, weights
from feltmb.mechanism import Action, load_action
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, no_such
from unmodeled.files import make_folder, write_file
from unmodeled.units import conversion_factor, unit_suffix

if TYPE_CHECKING:
    import pandas as pd

    from feltmb.run.quasistatic import PressPath, SimulatedPress


#: Force levels of the pressed strikes [N]; finger speeds of the struck strikes [m/s].
FORCES = (1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 35.0)
SPEEDS = (0.05, 0.08, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)

#: Impact speeds of the piano and forte strikes of the thesis [m/s].
PIANO, FORTE = 1.06, 3.36


@dataclass(frozen=True)
class TouchRow:
    """One value of the touch and a published one."""

    key: str
    name: str
    value: float | None  #: value in ``unit``
    unit: str
    low: float | None = None  #: published range
    high: float | None = None
    published: float | None = None  #: a single published value
    source: str = ""

    @property
    def digits(self) -> int:
        """Decimals with which the value is printed and compared."""
        return {"mm": 2, "1": 3}.get(self.unit, 1)

    @property
    def verdict(self) -> str:
        """``inside``, ``below`` or ``above`` a range; the difference from a value; else empty."""
        if self.value is None:
            return ""
        if self.low is not None and self.high is not None:
            shown = round(self.value, self.digits)
            if shown < self.low:
                return "below"
            return "above" if shown > self.high else "inside"
        if self.published is not None:
            unit = unit_suffix(self.unit)
            return f"{round(self.value - self.published, 2) + 0.0:+.3g}{unit}"
        return ""


@dataclass(frozen=True, eq=False)
class Touch:
    """Touch of an action.

    Attributes
    ----------
    rows : tuple of TouchRow
        Table of simulated and published values.
    static : StaticTouch
        Slow press and release.
    slow : SimulatedPress
        Simulated press and release at 10 mm/s, for comparison.
    strikes : tuple of Strike
        Pressed, then struck strikes, sorted by level.
    fits : dict
        By kind of strike: a [s] and b of travel time = a v^b, where v is the impact speed in m/s,
        and the largest relative residual.
    weights : Weights or None
        Weights of parts and the parts of the balance weight; None if the file does not say which
        parts are weighed (``reading.weights``).
    """

    action: Action
    rows: tuple[TouchRow, ...]
    static: StaticTouch
    slow: SimulatedPress
    strikes: tuple[Strike, ...]
    fits: dict[str, tuple[float, float, float]]
    weights: Weights | None = None

    def __getitem__(self, key: str) -> float | None:
        """Value of a row by key, in the unit of the row."""
        for row in self.rows:
            if row.key == key:
                return row.value
        raise no_such("row", key, self.keys())

    def keys(self) -> list[str]:
        """Keys of the rows."""
        return [row.key for row in self.rows]

    @cached_property
    def curve(self) -> pd.DataFrame:
        """Force as a function of travel.

        Columns: ``branch`` (press, release, press_lifted, release_lifted; "lifted" means that the
        damper is off the string), ``travel`` [m], ``force`` [N], ``hammer_gap`` [m].
        """
        import pandas as pd

        strike = self.action.config.reading.strike_contact
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
    def strike_table(self) -> pd.DataFrame:
        """One row for each strike, SI units; see :class:`Strike`."""
        import pandas as pd

        return pd.DataFrame([vars(strike) for strike in self.strikes])

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
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
            "notes": list(self.static.notes),
            "curve": curve,
            "strikes": [dict(vars(strike)) for strike in self.strikes],
            "fits": {
                kind: {"a": a, "b": b, "largest_residual": worst}
                for kind, (a, b, worst) in self.fits.items()
            },
        }

    @checked
    def plot(
        self, folder: str | Path, *, before: Touch | None = None, force: bool = False
    ) -> list[Path]:
        """Write ``touch_static.png`` and ``touch_dynamic.png`` to a folder.

        Parameters
        ----------
        folder
            Folder of the pictures.
        before
            Touch of another mechanism, such as the one before a change; drawn in the same pictures.
        force
            Overwrite existing files.
        """
        folder = make_folder(folder)
        title = _title(self, before)
        former = None if before is None else before.static
        ruled = distances(self.action, self.static, self.slow)
        hits = None if before is None else (before.strikes, before.fits)
        written = []
        for name, figure in (
            ("touch_static", static_figure(title, self.static, self.slow, ruled, former)),
            ("touch_dynamic", dynamic_figure(title, self.strikes, self.fits, hits)),
        ):

            def save(path: Path, figure: Any = figure) -> None:
                figure.savefig(path, dpi=150)

            written.append(write_file(folder / f"{name}.png", save, force=force))
        return written


def _title(touch: Touch, before: Touch | None) -> str:
    """Name of the mechanism, and of the one before if it has another name."""
    name = touch.action.name
    if before is None or before.action.name == name:
        return name
    return f"{name} (before: {before.action.name})"


def _branches(static: StaticTouch) -> list[tuple[str, PressPath]]:
    return [
        ("press", static.press),
        ("release", static.release),
        ("press_lifted", static.lifted_press),
        ("release_lifted", static.lifted_release),
    ]


@checked
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
        Levels of the pressed strikes [N], > 0.
    speeds
        Finger speeds of the struck strikes [m/s], > 0.
    executor
        Executor of the strikes; default: threads, one per core.
    progress
        Function that is called with a line of text now and then.

    Raises
    ------
    InvalidParameter
        A level is not > 0, or the mechanism does not name the required contacts.
    Error
        The action cannot be measured, for example because its hammer is blocked.
    """
    from feltmb.run.quasistatic import simulated_press

    if isinstance(action, str):
        action = load_action(action)
    for name, levels in (("forces", forces), ("speeds", speeds)):
        for level in levels:
            if not (math.isfinite(level) and level > 0):
                raise InvalidParameter(f"touch: {name} holds {level!r}, must be > 0")
    say = progress or (lambda _text: None)
    say("slow press and release")
    static = static_touch(action)
    dip = static.end
    say(f"{len(forces) + len(speeds)} strikes")
    jobs = [("pressed", f) for f in sorted(forces)] + [("struck", v) for v in sorted(speeds)]
    pool = executor if executor is not None else ThreadPoolExecutor()
    try:
        slow_future = pool.submit(simulated_press, action, travel=dip + 1.2e-3, release=True)
        futures = [pool.submit(simulate_strike, action, kind, level, dip) for kind, level in jobs]
        slow = slow_future.result()
        strikes = tuple(future.result() for future in futures)
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)
    fits = {}
    for kind in ("pressed", "struck"):
        fit = fit_travel_time([b for b in strikes if b.kind == kind])
        if fit is not None:
            fits[kind] = fit
    weighed = weights(action, static)
    rows = _rows(action, static, slow, strikes, fits, weighed)
    return Touch(action, rows, static, slow, strikes, fits, weighed)


_Row = tuple[str, str, float | None, str, str]


def _weight_rows(w: Weights | None) -> list[_Row]:
    """Rows of the weights of parts: key, name, value, SI unit, unit for people."""
    if w is None:
        return []
    rows: list[_Row] = [
        ("strike_weight", "strike weight", w.strike_weight, "kg", "g"),
        ("whippen_weight", "whippen weight", w.whippen_weight, "kg", "g"),
        ("front_weight", "front weight", w.front_weight, "kg", "g"),
        ("key_ratio", "key ratio", w.key_ratio, "1", "1"),
        ("action_ratio", "hammer / key travel", w.action_ratio, "1", "1"),
        ("hammer_share", "strike weight carried", w.hammer_share, "1", "1"),
    ]
    for name, force in w.parts.items():
        if abs(force) > LEAST:
            key = f"balance_{name.replace(' ', '_')}"
            rows.append((key, f"balance: {name.replace('_', ' ')}", force, "N", "gf"))
    return rows


#: Parts of the balance weight below this are omitted [N].
LEAST = 1e-4


def _force_rows(static: StaticTouch) -> list[_Row]:
    """Rows of the forces at the key front."""
    return [
        (key, name, getattr(static, key), "N", "gf")
        for key, name in (
            ("down_weight", "down-weight"),
            ("up_weight", "up-weight"),
            ("friction", "friction (DW-UW)/2"),
            ("balance_weight", "balance (DW+UW)/2"),
            ("down_weight_most", "largest press force"),
            ("up_weight_least", "least release force"),
            ("down_weight_damper", "press, damper off"),
            ("let_off_force", "let-off force peak"),
        )
    ]


def _bottom_rows(strikes: tuple[Strike, ...]) -> list[_Row]:
    """Rows of the times at which the key meets its punching."""
    pressed = [b for b in strikes if b.kind == "pressed" and b.hammer_speed]
    struck = [b for b in strikes if b.kind == "struck" and b.hammer_speed]
    landed = [b for b in (*pressed, *struck) if b.bottom_after_string is not None]
    landed.sort(key=lambda b: b.hammer_speed or 0.0)
    start = [b.bottom_after_start for b in landed if b.bottom_after_start is not None]
    after = [b.bottom_after_string for b in landed] or [None]
    piano, forte = (at_speed(pressed, "bottom_after_string", v) for v in (PIANO, FORTE))
    return [
        (f"bottom_after_{key}", name, value, "s", "ms")
        for key, name, value in (
            ("start_fastest", "bottom-start, least", min(start, default=None)),
            ("start_slowest", "bottom-start, most", max(start, default=None)),
            ("string_softest", "bottom-string, soft", after[0]),
            ("string_loudest", "bottom-string, loud", after[-1]),
            ("string_piano", f"same, pressed {PIANO:g} m/s", piano),
            ("string_forte", f"same, pressed {FORTE:g} m/s", forte),
        )
    ]


def _travel_rows(fits: dict[str, tuple[float, float, float]]) -> list[_Row]:
    """Rows of the travel times, by the speed of the hammer."""
    rows: list[_Row] = []
    for kind in ("pressed", "struck"):
        a, b, _ = fits.get(kind, (None, None, None))
        rows.append((f"travel_time_factor_{kind}", f"travel 1 m/s, {kind}", a, "s", "ms"))
        rows.append((f"travel_time_exponent_{kind}", f"exponent, {kind}", b, "1", "1"))
    times = {kind: a * 2.0**b for kind, (a, b, _) in fits.items()}
    both = "pressed" in times and "struck" in times
    shorter = times["pressed"] - times["struck"] if both else None
    rows.append(("struck_shorter", "struck shorter, 2 m/s", shorter, "s", "ms"))
    return rows


def _rows(
    action: Action,
    static: StaticTouch,
    slow: SimulatedPress,
    strikes: tuple[Strike, ...],
    fits: dict[str, tuple[float, float, float]],
    weighed: Weights | None,
) -> tuple[TouchRow, ...]:
    ruled = distances(action, static, slow)
    rows: list[_Row] = [
        *_force_rows(static),
        *_weight_rows(weighed),
        ("blow", "hammer blow", ruled.blow, "m", "mm"),
        ("let_off_distance", "let-off distance", ruled.let_off, "m", "mm"),
        ("damper_start", "damper start / blow", static.damper_start, "1", "1"),
        ("let_off_travel", "dip at let-off", ruled.let_off_dip, "m", "mm"),
        ("key_dip", "key dip", ruled.dip, "m", "mm"),
        ("key_dip_pressed", "key dip under 250 gf", ruled.dip_pressed, "m", "mm"),
        ("aftertouch", "aftertouch", ruled.aftertouch, "m", "mm"),
        *_bottom_rows(strikes),
        *_travel_rows(fits),
    ]
    published = published_numbers()
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
