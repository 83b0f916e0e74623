"""Wear of an action: each felt, friction and spring changed alone, against what a technician reads.

The parts are found in the mechanism, and changed by the effects that any mechanism may have
(``params/effects/mechanism.toml``). ``docs/howto/find_wear.md`` defines each number.
"""

from __future__ import annotations

import contextlib
import fnmatch
import math
import multiprocessing
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.action.regulate import Targets, default_targets
from feltmb.action.regulate.screws import Screws
from feltmb.action.repetition import highest_rate, key_travel, with_finger
from feltmb.action.touch import distances, static_touch
from feltmb.adapters import Entry, action_with_effects, load_library
from feltmb.mechanism import Action, MechanismFile, load_action
from feltmb.mechanism.workshop import turns_of
from feltmb.run.sweep import Progress, ProgressBar
from feltmb.run.sweep.members import default_jobs
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import read_json

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

GRAM = 9.80665e-3  # N, weight of one gram

#: Number -> text, unit for people, its size in SI units.
NUMBERS: dict[str, tuple[str, str, float]] = {
    "let_off": ("let-off", "mm", 1e-3),
    "aftertouch": ("aftertouch", "mm", 1e-3),
    "check": ("check distance", "mm", 1e-3),
    "down_weight": ("down weight", "g", GRAM),
    "repetition": ("repetition", "1/s", 1.0),
    "impact_speed": ("impact speed", "m/s", 1.0),
    "up_weight": ("up weight", "g", GRAM),
    "twice": ("soft strikes that strike twice", "%", 0.01),
    "caught": ("soft strike until the hammer stands in check", "ms", 1e-3),
    "hammer_return": ("hammer back after the release", "ms", 1e-3),
    "return_force": ("largest force of the return", "N", 1.0),
}
#: The numbers of the table and picture of :func:`wear`.
WEAR_NUMBERS = tuple(NUMBERS)[:6]

#: Largest forces of the finger in soft, held presses [N]; time in which they rise, and of all [s].
SOFT, RISEN, HELD = (1.4, 1.5, 1.6, 1.8, 2.0, 2.3, 2.6, 3.0), 0.03, 0.5
#: Strokes of the strike and of the release, and the begin of the release [s].
STRIKE, RELEASE, RELEASED = "piano", "press_release", 0.45
#: When the finger lets a held press of 4 N go, with 3 N upward [s].
LET_GO = 0.22
#: A hammer that moves by less, and is held in this last time, stands in check [m, s].
SWING, STANDS = 3e-3, 0.02
#: Part of the range of a screw in the targets by which it is turned.
TURN = 0.1

THINNER, HARDER, FRICTION, SPRING, SCREW = "thinner", "harder", "friction", "spring", "screw"
TIGHT, MISSING = "tight", "missing"


@dataclass(frozen=True)
class Variant:
    """One changed part."""

    part: str  #: as its label in the mechanism file
    kind: str  #: thinner, harder, friction, spring, tight, missing or screw
    change: str  #: as text: "0.2 mm thinner"
    amount: float  #: of the change, in SI units or as a share
    remedy: str  #: what to do about it
    unit: str = "1"  #: SI unit of the amount
    turns: float = 0.0  #: turns of the screw; 0: it has no thread
    word: str = ""  #: direction of the turn, such as up


# ---------------------------------------------------------------- the numbers of one mechanism


@checked
def measure(action: Action) -> dict[str, float]:
    """Numbers of :data:`NUMBERS` in their units; NaN: it does not exist in this mechanism.

    Parameters
    ----------
    action
        Mechanism that names the contacts that :func:`feltmb.touch` needs.
    """
    found = dict.fromkeys(NUMBERS, math.nan)

    def _repetition(action: Action) -> dict[str, float]:
        return {"repetition": highest_rate(action, key_travel(action)).rate}

    for part in (_static, _strike, _soft, _release, _return, _repetition):
        try:
            found |= part(action)
        except InvalidParameter:
            raise
        except Error:  # no let-off, no strike: the number does not exist
            continue
    return {name: found[name] / NUMBERS[name][2] for name in NUMBERS}


def _static(action: Action) -> dict[str, float]:
    from feltmb.run.quasistatic import simulated_press

    static = static_touch(action)
    found = distances(action, static, simulated_press(action, travel=static.end + 1.2e-3))
    return {
        "let_off": found.let_off if static.has_let_off else math.nan,
        "aftertouch": found.aftertouch,
        "down_weight": static.down_weight,
        "up_weight": static.up_weight,
    }


def _strike(action: Action) -> dict[str, float]:
    from feltmb.run.simulate import simulate

    summary = simulate(action, STRIKE, ledger=False, output_rate=2000.0).summary
    names = {"impact_speed": "impact_speed", "check": "check_gap"}
    return {name: float(summary.get(key, math.nan)) for name, key in names.items()}


def _soft(action: Action) -> dict[str, float]:
    """Soft, held presses: share of them that strike twice, and the longest time until the check."""
    import numpy as np

    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import table_stroke

    reading, played, strikes, times = action.config.reading, with_finger(action), [], []
    for force in SOFT:
        stroke = table_stroke([0.0, RISEN], [0.0, force], interpolation="linear", duration=HELD)
        run = simulate(played, stroke, ledger=False, output_rate=2000.0)
        hit = run.summary.get("impact_time")
        if hit is None:
            continue
        strikes.append(len(run.strikes))
        held = np.sum([run[f"contact{c:02d}.force"] for c in reading.check_contacts], axis=0) > 0.0
        gap = run[f"contact{reading.strike_contact:02d}.compression"]
        caught = np.any(held & (run.time > run.time[-1] - STANDS))
        moves = run.time[(np.abs(gap - gap[-1]) > SWING) | ~caught]
        times.append(max(0.0, float(moves[-1]) - hit))
    return {
        "twice": float(np.mean(np.array(strikes) > 1)) if strikes else math.nan,
        "caught": max(times, default=math.nan),
    }


def _release(action: Action) -> dict[str, float]:
    import numpy as np

    from feltmb.run.simulate import simulate

    run = simulate(action, RELEASE, ledger=False, output_rate=2000.0)
    strike, after = action.config.reading.strike_contact, run.time > RELEASED
    forces = [
        np.max(run[f"contact{int(c):02d}.force"][after])
        for c, contact in action.config.contacts.items()
        if int(c) != strike and contact.enabled
    ]
    return {"return_force": float(max(forces, default=math.nan))}


def _return(action: Action) -> dict[str, float]:
    """Time from the release of a held press until the hammer is back by 80 % of its blow."""
    from feltmb.run.simulate import simulate
    from feltmb.run.stroke import table_stroke

    time, force = [0.0, 0.02, 0.028, LET_GO, LET_GO + 8e-3], [-3.0, -3.0, 4.0, 4.0, -3.0]
    stroke = table_stroke(time, force, interpolation="linear", duration=LET_GO + 0.5)
    run = simulate(with_finger(action), stroke, ledger=False, output_rate=2000.0)
    gap = -run[f"contact{action.config.reading.strike_contact:02d}.compression"]
    near = run.time[gap < 0.8 * gap[0]]
    return {"hammer_return": float(near[-1]) - LET_GO if near.size else math.nan}


# ---------------------------------------------------------------- the changed mechanisms


def _felts(config: MechanismFile) -> list[list[str]]:
    """Contacts of one felt: they share a surface, and the other surfaces are of one body."""
    groups: list[list[str]] = []
    for name, contact in config.contacts.items():
        if not contact.enabled:
            continue
        bodies = {config.surfaces[s].body for s in contact.surfaces}
        for group in groups:
            other = config.contacts[group[0]]
            if set(other.surfaces) & set(contact.surfaces) and bodies == {
                config.surfaces[s].body for s in other.surfaces
            }:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _changes(config: MechanismFile) -> Iterator[tuple[str, str, str, float, list[str]]]:
    """Part, kind, text, amount and entries of the library of the changes of felts and springs."""
    felts = [(_label(config, group), group) for group in _felts(config)]
    for part, group in felts:
        thickness = [f"felt_thickness.{c}" for c in group]
        for amount in (2e-4, 5e-4):
            yield part, THINNER, f"{1e3 * amount:g} mm thinner", amount, thickness
        yield part, HARDER, "20 % harder", 0.2, [f"felt_stiffness.{c}" for c in group]
    doubled = [(part, [f"contact_friction.{c}" for c in group]) for part, group in felts]
    doubled += [(f"{body.label or name}, joint", [f"joint_friction.{name}"])
                for name, body in config.bodies.items()]  # fmt: skip
    for part, names in doubled:
        yield part, FRICTION, "friction doubled", 1.0, names
    for name, spring in config.springs.items():
        part = spring.label or name.replace("_", " ")
        yield part, SPRING, "20 % weaker", -0.2, [f"spring_rate.{name}"]


def variants(
    action: Action, *, screws: bool = False, targets: Targets | None = None
) -> Iterator[tuple[Variant, Action | None]]:
    """Each felt, friction, spring, bushing and strap changed alone, and the screws if wanted.

    None instead of a mechanism: it cannot be changed in this way, as a radius below zero.
    """
    library = load_library(action, "mechanism")
    entries = {e.name: e for e in (*library.tolerances, *library.effects)}
    config = action.config

    def made(
        part: str, kind: str, change: str, amount: float, names: Sequence[str]
    ) -> Iterator[tuple[Variant, Action | None]]:
        used = [(entries[n], amount, None) for n in names if n in entries]
        other: Action | None = None
        with contextlib.suppress(InvalidParameter):  # such as a radius below zero
            other = action_with_effects(action, used)
        if other is not action:
            remedy = used[0][0].remedy or _remedy(entries, names[0])
            yield Variant(part, kind, change, amount, remedy), other

    for part, kind, text, amount, names in _changes(config):
        yield from made(part, kind, text, amount, names)
    for key, bushing in config.bushings.items():
        path, more = f"bushings.{key}.tightness", bushing.swollen
        remedy = "Ease the bushing or the hole, and polish the pin."
        variant = Variant(bushing.label or key, TIGHT, f"{more:g} N tighter", more, remedy, "N")
        yield variant, action.with_values({path: f"{bushing.tightness + more} N"})
    for key, strap in config.straps.items():
        if strap.enabled:
            part = strap.label.partition(",")[0] or key.replace("_", " ")
            variant = Variant(part, MISSING, "missing", 1.0, "Renew it.")
            yield variant, action.with_values({f"straps.{key}.enabled": False})
    if screws:
        yield from _screws(action, targets)


def _label(config: MechanismFile, group: Sequence[str]) -> str:
    label = config.contacts[group[0]].label or f"contact {group[0]}"
    return label if len(group) == 1 else label.partition(",")[0]


def _remedy(entries: Mapping[str, Entry], name: str) -> str:
    """Remedy of a tolerance: that of the effect of the same joint."""
    effect = entries.get(name.replace("joint_friction", "coulomb_friction"))
    return effect.remedy if effect is not None else ""


def _screws(action: Action, targets: Targets | None) -> Iterator[tuple[Variant, Action]]:
    steps = [s for s in (targets or default_targets(action)).steps if s.screw is not None]
    bank = Screws(action, steps)
    for i, step in enumerate(steps):
        assert step.screw is not None
        for end in (step.screw.low, step.screw.high):
            turn = TURN * end
            turns = [turn if k == i else 0.0 for k in range(len(steps))]
            unit = step.screw.unit
            text = f"{1e3 * turn:+.3g} mm" if unit == "m" else f"{math.degrees(turn):+.3g}°"
            thread, word = turns_of(action.config, step.screw.path, turn) or (0.0, "")
            remedy = f"Regulate: {step.name}."
            variant = Variant(step.screw.name, SCREW, text, turn, remedy, unit, thread, word)
            yield variant, bank.apply(turns)


# ---------------------------------------------------------------- the table


@dataclass(frozen=True, eq=False)
class Wear:
    """Result of :func:`wear`.

    Attributes
    ----------
    name, hash : str
        Name and hash of the mechanism.
    base : dict
        Numbers of the mechanism in the units of :data:`NUMBERS`.
    rows : tuple
        Variants with their numbers; NaN: the number does not exist any more.
    """

    name: str
    hash: str
    base: dict[str, float]
    rows: tuple[tuple[Variant, dict[str, float]], ...]

    @cached_property
    def frame(self) -> pd.DataFrame:
        """Numbers by part and change, the unchanged mechanism first; units in ``attrs``."""
        import pandas as pd

        base = Variant("as it is", "", "", 0.0, "")
        table = [
            {"part": v.part, "kind": v.kind, "change": v.change, "amount": v.amount} | numbers
            for v, numbers in ((base, self.base), *self.rows)
        ]
        frame = pd.DataFrame(table)
        frame.attrs["units"] = {name: unit for name, (_, unit, _) in NUMBERS.items()}
        return frame

    @cached_property
    def changes(self) -> pd.DataFrame:
        """Differences from the unchanged mechanism, by part and change."""
        frame = self.frame.set_index(["part", "change"])[list(NUMBERS)]
        return (frame - frame.iloc[0]).iloc[1:]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; numbers that do not exist are None."""
        return {
            "name": self.name,
            "hash": self.hash,
            "units": {name: unit for name, (_, unit, _) in NUMBERS.items()},
            "base": _plain(self.base),
            "rows": [vars(v) | {"numbers": _plain(n)} for v, n in self.rows],
        }

    @classmethod
    @checked
    def read(cls, path: str | Path) -> Wear:
        """The result in a JSON file of ``feltmb wear ACTION -o FILE.json``."""
        try:
            return cls.from_dict(read_json(Path(path)))
        except InvalidParameter as error:
            raise InvalidParameter(f"{path}: {error}") from None

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Wear:
        """The result of :meth:`as_dict`."""
        try:
            rows = [
                (
                    Variant(**{k: v for k, v in row.items() if k != "numbers"}),
                    _filled(row["numbers"]),
                )
                for row in data["rows"]
            ]
            return cls(data["name"], data["hash"], _filled(data["base"]), tuple(rows))
        except (AttributeError, KeyError, TypeError, ValueError):
            raise InvalidParameter(
                "is no table of wear, expected that of feltmb wear -o FILE.json"
            ) from None

    def plot(self) -> Figure:
        """Changes of each number by each variant, as shares of what matters of the number."""
        import numpy as np

        from unmodeled.style import head_line, new_figure

        shown = list(self.rows)
        values = np.array([[n[k] - self.base[k] for k in WEAR_NUMBERS] for _, n in shown])
        scale = np.array([MATTERS[k] for k in WEAR_NUMBERS])
        figure = new_figure(9.0, 1.6 + 0.19 * len(shown))
        ax = figure.subplots()
        image = ax.imshow(values / scale, cmap="RdBu_r", vmin=-2.0, vmax=2.0, aspect="auto")
        ax.set_facecolor("#333333")  # shows through where there is no number
        for i, row in enumerate(values):
            for j, value in enumerate(row):
                lost = not math.isfinite(value)
                dark = lost or abs(value) > 1.4 * scale[j]
                text = "none" if lost else f"{value:+.2g}" if abs(value) > 0.05 * scale[j] else ""
                ax.text(j, i, text, ha="center", va="center", size=7,
                        color="white" if dark else "black")  # fmt: skip
        heads = [
            f"{NUMBERS[k][0]}\n[{NUMBERS[k][1]}]\n{self.base[k]:.3g} ± {MATTERS[k]:g}"
            for k in WEAR_NUMBERS
        ]
        ax.set_xticks(range(len(heads)), heads, size=8)
        ax.xaxis.tick_top()
        ax.set_yticks(range(len(shown)), [f"{v.part}: {v.change}" for v, _ in shown], size=7)
        ax.tick_params(length=0)
        bar = figure.colorbar(image, ax=ax, location="bottom", fraction=0.02, pad=0.01, aspect=50)
        bar.set_label("change, as a multiple of the change that matters (±)", size=8)
        head_line(figure, f"{self.name}: what each wear changes", 12.0, "normal")
        return figure


#: Change of a number that a technician or a player notices, in its unit.
MATTERS = {
    "let_off": 0.5,
    "aftertouch": 0.5,
    "check": 3.0,
    "down_weight": 5.0,
    "repetition": 2.0,
    "impact_speed": 0.1,
    "up_weight": 5.0,
    "twice": 20.0,
    "caught": 30.0,
    "hammer_return": 20.0,
    "return_force": 3.0,
}


def _plain(numbers: Mapping[str, float]) -> dict[str, float | None]:
    return {k: float(f"{v:.5g}") if math.isfinite(v) else None for k, v in numbers.items()}


def _filled(numbers: Mapping[str, float | None]) -> dict[str, float]:
    return {k: math.nan if v is None else float(v) for k, v in numbers.items()}


@checked
def wear(
    action: Action | str,
    *,
    parts: Sequence[str] = (),
    screws: bool = False,
    targets: Targets | None = None,
    executor: Executor | None = None,
    progress: Progress | bool | None = None,
) -> Wear:
    """Change each felt, friction and spring alone, and measure what a technician reads.

    Each felt is 0.2 and 0.5 mm thinner, or 20 % harder; each friction is doubled; each spring is
    20 % weaker; each bushing is swollen; each strap is missing.

    Parameters
    ----------
    action
        Mechanism, or its name for :func:`load_action`.
    parts
        Patterns of the parts, such as ``*jack*``; default: all.
    screws
        Whether each screw of the regulation is also turned by a tenth of its range, both ways.
    targets
        Targets whose screws are turned; default: those of the mechanism.
    executor
        Executor of the measurements; default: one process per core.
    progress
        ``progress(done, total, name)``; default: a bar on a terminal; False: none.

    Raises
    ------
    InvalidParameter
        No part has such a name, or the mechanism does not name the required contacts.
    """
    if isinstance(action, str):
        action = load_action(action)
    found = list(variants(action, screws=screws, targets=targets))
    if parts:
        names = list(dict.fromkeys(v.part for v, _ in found))
        chosen = {n for n in names for p in parts if fnmatch.fnmatchcase(n, p)}
        if not chosen:
            raise InvalidParameter(
                f"wear: no part is named {', '.join(parts)}; parts are {'; '.join(names)}"
            )
        found = [(v, a) for v, a in found if v.part in chosen]
    pool = executor if executor is not None else _processes(len(found))
    rows = []
    try:
        with ProgressBar(progress, 1 + len(found), "wear") as bar:
            base = measure(action)
            bar.step("as it is")
            futures = [None if a is None else pool.submit(measure, a) for _, a in found]
            for (variant, _), future in zip(found, futures, strict=True):
                none = dict.fromkeys(NUMBERS, math.nan)
                rows.append((variant, none if future is None else future.result()))
                bar.step(f"{variant.part}: {variant.change}")
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)
    return Wear(action.name, action.hash, base, tuple(rows))


def _processes(jobs: int) -> Executor:
    """Processes: most of the time of a static press is spent in Python."""
    # With fork, notebooks and scripts without a guard of __main__ work as well.
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    return ProcessPoolExecutor(min(default_jobs(), jobs), context)
