"""Values that a page can change: screws, felts, masses, frictions, springs, string, any number.

A knob changes one or several numbers of the mechanism file by a magnitude; zero means no change.
Screws are from the regulation targets of the mechanism, and all others from the tolerances and
effects of its library. This module has no knowledge of pianos.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from feltmb.action.regulate.targets import Step, Targets, default_targets
from feltmb.adapters import Library, load_library
from feltmb.adapters.changes import Change, Entry, Values, applied
from feltmb.mechanism import Action
from feltmb.mechanism.values import si_factor
from unmodeled.errors import Error, InvalidParameter, shortened
from unmodeled.units import si_value

#: Order of the groups, and the prefixes of the names in each.
GROUPS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("screws", ("screw.",)),
    ("felts", ("felt",)),
    ("masses and leads", ("mass.",)),
    (
        "frictions",
        (
            *("joint_friction.", "contact_friction.", "viscous_friction."),
            *("stribeck_friction.", "backcheck_friction"),
        ),
    ),
    ("springs and straps", ("spring", "strap")),
    ("string and beams", ("string", "bending.", "damping.")),
)
#: Group of the other tolerances; lengths and angles among them are screws.
OTHER = "other tolerances"
#: Range of a knob without limits, in standard deviations or in units of its magnitude.
REACH_OF_TOLERANCE, REACH_OF_EFFECT = 4.0, 3.0


@dataclass(frozen=True)
class Knob:
    """A value that can be changed.

    Attributes
    ----------
    name, group, label
        Names for the page.
    unit
        SI unit of the magnitude; ``1``: a share of the tabulated value.
    low, high
        Limits of the magnitude, in ``unit``.
    sd
        Standard deviation of the tabulated value [``unit``]; 0: unknown.
    changes
        Changes of numbers of the file by the magnitude.
    note
        Source of the knob.
    """

    name: str
    group: str
    label: str
    unit: str
    low: float
    high: float
    sd: float
    changes: tuple[Change, ...]
    note: str = ""

    def as_dict(self, numbers: Mapping[str, tuple[float, str, str]]) -> dict[str, Any]:
        """Plain data for the page, with the tabulated values of the changed numbers."""
        return {
            "name": self.name,
            "group": self.group,
            "label": self.label,
            "unit": self.unit,
            "low": self.low,
            "high": self.high,
            "sd": self.sd,
            "note": self.note,
            "moves": [[c.path, *numbers.get(c.path, (None, "", ""))[:2]] for c in self.changes],
        }


@dataclass(frozen=True, eq=False)
class Bench:
    """A mechanism with all of its knobs."""

    action: Action
    targets: Targets | None = field(init=False)
    library: Library | None = field(init=False)
    notes: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        notes = []
        targets, library = None, None
        try:
            targets = default_targets(self.action)
        except Error:
            notes.append("There are no regulation targets for this mechanism: no screws are known.")
        try:
            library = load_library(self.action)
        except Error as error:
            notes.append(f"Its library of tolerances cannot be used: {error}")
        for name, value in (("targets", targets), ("library", library), ("notes", tuple(notes))):
            object.__setattr__(self, name, value)

    @cached_property
    def numbers(self) -> dict[str, tuple[float, str, str]]:
        """Every number of the file by path: value and unit of the file, source or status."""
        out: dict[str, tuple[float, str, str]] = {}
        for path, value, unit, source in self.action.quantities():
            if isinstance(value, list):
                for axis, v in zip("xy", value, strict=False):
                    if isinstance(v, (int, float)) and len(value) == 2:
                        out[f"{path}.{axis}"] = (float(v), unit, source)
            elif isinstance(value, (int, float)) and not isinstance(value, bool):
                out[path] = (float(value), unit, source)
        return out

    @cached_property
    def knobs(self) -> dict[str, Knob]:
        """All knobs by name, in the order of the groups."""
        found = [*self._screws(), *self._of_library()]
        order = [name for name, _ in GROUPS] + [OTHER]
        found.sort(key=lambda knob: order.index(knob.group))
        return {knob.name: knob for knob in found}

    def _screws(self) -> Iterator[Knob]:
        if self.targets is None:
            return
        for step in self.targets.steps:
            screw = step.screw
            if screw is None:
                continue
            changes = self._turn(step)
            if changes:
                yield Knob(
                    f"screw.{step.name}",
                    "screws",
                    f"{step.name}: {screw.name}",
                    screw.unit,
                    screw.low,
                    screw.high,
                    self._sd_of(changes),
                    changes,
                    step.note,
                )

    def _turn(self, step: Step) -> tuple[Change, ...]:
        """Changes by a screw; empty if this mechanism lacks its part."""
        assert step.screw is not None
        direction, path = step.screw.direction, step.screw.path
        if direction is None:
            return (Change(path=path, add=1.0),) if path in self.numbers else ()
        if direction == "normal":
            surface = self.action.config.surfaces.get(path.split(".")[1])
            if surface is None or surface.normal is None:
                return ()
            length = math.hypot(*surface.normal)
            direction = (surface.normal[0] / length, surface.normal[1] / length)
        if f"{path}.x" not in self.numbers:
            return ()
        return tuple(
            Change(path=f"{path}.{axis}", add=part)
            for axis, part in zip("xy", direction, strict=True)
            if part != 0.0
        )

    def _sd_of(self, changes: tuple[Change, ...]) -> float:
        """Standard deviation of a tolerance of the library that changes the same numbers."""
        paths = {c.path for c in changes}
        for entry in self.library.tolerances if self.library else ():
            if {c.path for c in entry.changes} & paths and entry.unit != "1":
                return entry.magnitude
        return 0.0

    def _of_library(self) -> Iterator[Knob]:
        if self.library is None:
            return
        taken: set[frozenset[str]] = {
            frozenset(c.path for c in knob.changes) for knob in self._screws()
        }
        named = {e.name for e in self.library.tolerances}
        # Of effects, only those of the known groups that no tolerance has.
        others = [e for e in self.library.effects if _group(e.name) and e.name not in named]
        tolerances = len(self.library.tolerances)
        for i, entry in enumerate((*self.library.tolerances, *others)):
            moved = frozenset(c.path for c in entry.changes)
            if not moved or moved in taken or entry.condition is not None or "*" in moved:
                continue
            if self._turns(entry):
                taken.add(moved)
                yield _knob_of(entry, tolerance=i < tolerances)

    def _turns(self, entry: Entry) -> bool:
        """Whether the file has, or accepts, the numbers that an entry changes."""
        try:
            self.action.with_values(self.values({}, {}, {entry.name: (entry, entry.magnitude)}))
        except Error:
            return False
        return True

    def values(
        self,
        knobs: Mapping[str, float],
        numbers: Mapping[str, float],
        entries: Mapping[str, tuple[Entry, float]] | None = None,
    ) -> dict[str, float | str]:
        """Numbers by path with the units of the file, as for ``--set``.

        Parameters
        ----------
        knobs
            Magnitudes by name, SI units.
        numbers
            Numbers by path, in the units of the file; they replace the values of knobs.

        Raises
        ------
        InvalidParameter
            Knobs or paths are unknown; all of them are in the message.
        """
        faults = []
        asked: list[tuple[Change, float]] = []
        for name, magnitude in knobs.items():
            knob = self.knobs.get(name)
            if knob is None:
                faults.append(f"knob {shortened(repr(name))} is unknown for {self.action.name!r}")
            else:
                asked += [(change, magnitude) for change in knob.changes]
        for entry, magnitude in (entries or {}).values():
            asked += [(change, magnitude) for change in entry.changes]
        for path in numbers:
            if path not in self.numbers:
                faults.append(f"{shortened(path)} is no number of {self.action.name!r}")
        if faults:
            raise InvalidParameter("\n".join(faults))
        moved = applied(asked, Values(self.action.config))
        out = {path: self._in_file(path, value) for path, value in moved.items()}
        out |= {path: float(value) for path, value in numbers.items()}
        return {path: self._with_unit(path, value) for path, value in out.items()}

    def changed(self, values: Mapping[str, float | str]) -> Action:
        """The mechanism with other numbers, as :meth:`values` gives them.

        Raises
        ------
        InvalidParameter
            A value is out of range.
        """
        return self.action.with_values(values) if values else self.action

    def _with_unit(self, path: str, value: float) -> float | str:
        unit = self.numbers[path][1] if path in self.numbers else ""
        return value if si_factor(None, unit) == 1.0 else f"{value!r} {unit}"

    def _in_file(self, path: str, value: float) -> float:
        """Convert a number from SI to the unit of the file, without digits of rounding errors."""
        known = self.numbers.get(path)
        unit = known[1] if known else ""
        factor = si_value(f"1 {unit}") if unit else None
        if factor:
            value = value / factor
        return float(f"{value:.12g}")


def _group(name: str) -> str | None:
    return next((g for g, starts in GROUPS if name.startswith(starts)), None)


def _label(entry: Entry) -> str:
    what = entry.name.partition(".")[0].replace("_", " ")
    return what if entry.component in what else f"{what}, {entry.component}"


def _knob_of(entry: Entry, *, tolerance: bool) -> Knob:
    """Knob of a tolerance or of an effect."""
    reach = REACH_OF_TOLERANCE if tolerance else REACH_OF_EFFECT
    low = max(entry.lower, 0.0 if entry.sign > 0 else -reach * entry.magnitude)
    high = min(entry.upper, 0.0 if entry.sign < 0 else reach * entry.magnitude)
    if any(c.scale for c in entry.changes):
        low = max(low, -0.95)
    return Knob(
        entry.name,
        _group(entry.name) or (OTHER if entry.unit == "1" else "screws"),
        entry.mechanism if tolerance else _label(entry),
        entry.unit,
        low,
        high,
        entry.magnitude if tolerance else 0.0,
        entry.changes,
        entry.source if tolerance else entry.mechanism,
    )
