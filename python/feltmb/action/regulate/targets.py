"""Targets of a regulation: steps, their measured quantities, and the screws that set them."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from feltmb import params
from feltmb.mechanism import Action
from feltmb.quantities import SI
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.files import read_toml
from unmodeled.units.quantity import Schema, parse_scalar, validated

#: measure -> (SI unit, unit for people, its factor, description)
MEASURES: dict[str, tuple[str, str, float, str]] = {
    "rest_gap": ("m", "mm", 1e3, "distance of the surfaces of a contact at rest"),
    "rest_force": ("N", "N", 1.0, "normal force of a contact at rest"),
    "simulated_press": ("m", "mm", 1e3, "closest approach of hammer and string, slow press"),
    "static_press": ("m", "mm", 1e3, "the same without inertia"),
    "simulated_start": ("1", "", 1.0, "part of the blow done when a contact closes, slow press"),
    "aftertouch": ("m", "mm", 1e3, "key front to its punching at the let-off, slow press"),
    "drop": ("m", "mm", 1e3, "fall of the hammer after the let-off, key down, slow press"),
    "check_distance": ("m", "mm", 1e3, "hammer in the backcheck to the string after a stroke"),
    "spring_force": ("N", "gf", 1e3 / 9.80665, "force of a spring at rest, at a point of its part"),
}
_OF_CONTACT = ("rest_gap", "rest_force", "simulated_start", "aftertouch")
MeasureName = Literal[
    "rest_gap",
    "rest_force",
    "simulated_press",
    "static_press",
    "simulated_start",
    "aftertouch",
    "drop",
    "check_distance",
    "spring_force",
]


class Screw(Schema):
    """A value of the mechanism file that a step can change."""

    name: str
    path: str
    direction: Annotated[
        Literal["normal"] | tuple[float, float] | None, BeforeValidator(lambda n: _direction(n))
    ] = None
    low: Annotated[float, BeforeValidator(lambda n: _turn(n))]
    high: Annotated[float, BeforeValidator(lambda n: _turn(n))]
    gain: float | None = None

    @property
    def unit(self) -> str:
        """SI unit of a turn: m for the displacement of a point, rad for an angle."""
        return "rad" if self.direction is None else "m"


def _direction(node: object) -> object:
    if isinstance(node, list) and len(node) == 2 and all(isinstance(v, (int, float)) for v in node):
        length = math.hypot(float(node[0]), float(node[1]))
        if not abs(length - 1.0) < 1e-3:
            raise ValueError(f"got {node!r} of length {length:g}, expected a direction of length 1")
        return (node[0] / length, node[1] / length)
    return node


def _turn(node: object) -> float:
    """Convert a length [m] or an angle [rad]."""
    try:
        return parse_scalar(node, "m")
    except ValueError as error:
        if "does not measure" not in str(error):
            raise
        return parse_scalar(node, "rad")


@checked
class Step(Schema):
    """One measured quantity and its screw; without a screw, the value is only checked.

    ``speed`` and ``travel`` are the finger's in a slow press; ``friction`` is an option of
    ``static_press``; ``spring_force`` is that of ``spring`` at the tracking point ``point``.
    """

    letter: str = ""
    name: str
    note: str = ""
    measure: MeasureName
    contact: int | None = None
    spring: str | None = None
    point: str | None = None
    stroke: str = "piano"
    speed: Annotated[float, BeforeValidator(lambda n: _speed(n)), Field(gt=0)] = 0.010
    travel: Annotated[float, SI("m"), Field(gt=0)] = 0.012
    friction: Literal["law", "saturated", "breakaway", "none"] = "breakaway"
    target: float | None = None
    tolerance: Annotated[float, Field(gt=0)] | None = None
    low: float | None = None
    high: float | None = None
    screw: Screw | None = None

    @model_validator(mode="before")
    @classmethod
    def _quantities(cls, node: Any) -> Any:
        """Convert targets to the unit of their quantity."""
        measure = node.get("measure") if isinstance(node, Mapping) else None
        if not isinstance(measure, str) or measure not in MEASURES:
            return node
        unit = MEASURES[measure][0]
        out = dict(node)
        for key in ("target", "tolerance", "low", "high"):
            if key in out:
                try:
                    out[key] = parse_scalar(out[key], unit)
                except ValueError as error:
                    raise ValueError(f"{key}: {error}") from None
        return out

    @model_validator(mode="after")
    def _complete(self) -> Step:
        if self.screw is not None and (self.target is None or self.tolerance is None):
            raise ValueError("a step with a screw needs target and tolerance")
        if self.target is not None and self.tolerance is None:
            raise ValueError("a target needs a tolerance")
        if self.target is None and self.low is None and self.high is None:
            raise ValueError("give target and tolerance, or low and high")
        if self.target is not None and (self.low is not None or self.high is not None):
            raise ValueError("give either a target or low and high")
        if self.measure in _OF_CONTACT and self.contact is None:
            raise ValueError(f"measure {self.measure!r} needs a contact")
        if self.measure == "spring_force" and None in (self.spring, self.point):
            raise ValueError("measure 'spring_force' needs a spring and a point")
        if self.screw is not None and not self.screw.low < 0.0 < self.screw.high:
            raise ValueError("bounds of a screw must lie on both sides of zero")
        return self

    def error(self, value: float) -> float:
        """Difference from the target, SI; zero within a range."""
        if self.target is not None:
            return value - self.target
        if self.low is not None and value < self.low:
            return value - self.low
        if self.high is not None and value > self.high:
            return value - self.high
        return 0.0

    def holds(self, value: float | None) -> bool:
        """Whether a measured value meets the target."""
        return value is not None and abs(self.error(value)) <= (self.tolerance or 0.0)

    @property
    def wanted(self) -> str:
        """Target in the unit for people, as text."""
        _, _, factor, _ = MEASURES[self.measure]
        if self.target is not None:
            return f"{self.target * factor:g}"
        if self.low is None:
            return f"<= {(self.high or 0.0) * factor:g}"
        if self.high is None:
            return f">= {self.low * factor:g}"
        return f"{self.low * factor:g} to {self.high * factor:g}"


def _speed(node: object) -> float:
    return parse_scalar(node, "m/s")


class Targets(Schema):
    """A targets file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    extends: str = ""
    about: str = ""
    cite: str = ""
    rounds: Annotated[int, Field(ge=1, le=100)] = 8
    steps: Annotated[list[Step], Field(min_length=1)]

    @checked
    def with_targets(self, targets: Mapping[str, str]) -> Targets:
        """Copy of the steps with other targets.

        Parameters
        ----------
        targets
            Target by the name of a step, or by its letter if the letter is unique:
            ``{"let-off": "4 mm"}``. A number without a unit is in SI units. The target of a step
            with a range has the form ``"0.01 N to 0.2 N"``.

        Raises
        ------
        InvalidParameter
            A step or a quantity is invalid; all faults are in one message.
        """
        steps, faults = list(self.steps), []
        for name, text in targets.items():
            try:
                i = self._find(name)
                steps[i] = _with_target(steps[i], text)
            except ValueError as error:
                faults.append(f"target {shortened(repr(name))}: {error}")
        if faults:
            raise InvalidParameter("\n".join(faults))
        changed = ", ".join(f"{name} = {text}" for name, text in targets.items())
        name = f"{self.name} with {changed}" if targets else self.name
        return self.model_copy(update={"steps": steps, "name": name})

    def _find(self, name: str) -> int:
        wanted = _plain(name)
        by_name = [i for i, step in enumerate(self.steps) if _plain(step.name) == wanted]
        by_letter = [i for i, step in enumerate(self.steps) if _plain(step.letter) == wanted]
        for found in (by_name, by_letter):
            if len(found) == 1:
                return found[0]
        names = ", ".join(step.name for step in self.steps)
        if by_name or by_letter:
            raise ValueError(f"names {len(by_name or by_letter)} steps; steps are {names}")
        known = {_plain(step.name): step.name for step in self.steps}
        near = difflib.get_close_matches(wanted, known, n=1)
        hint = f"did you mean {known[near[0]]!r}? " if near else ""
        raise ValueError(f"there is no such step; {hint}steps are {names}")


def _plain(name: str) -> str:
    """A name in lower case, with equal separators between words."""
    return re.sub(r"[\s_-]+", "-", name.strip().lower())


def _with_target(step: Step, text: str) -> Step:
    unit = MEASURES[step.measure][0]
    low, sign, high = (part.strip() for part in text.partition(" to "))
    if step.target is None:
        if not sign:
            raise ValueError(f"is a range of {step.wanted}; got {text!r}, expected LOW to HIGH")
        change = {"low": parse_scalar(low, unit), "high": parse_scalar(high, unit)}
        if not change["low"] <= change["high"]:
            raise ValueError(f"got {text!r}, expected the smaller number first")
    else:
        change = {"target": parse_scalar(text, unit)}
    if not all(math.isfinite(v) for v in change.values()):
        raise ValueError(f"got {text!r}, expected a finite quantity")
    return step.model_copy(update=change)


def packaged_targets() -> list[str]:
    """Names of the packaged targets files."""
    return params.names("regulation")


@checked
def load_targets(name_or_path: str | Path) -> Targets:
    """Read targets: the name of a packaged file, or the path of a TOML file.

    A file that ``extends`` another one (a packaged name, or a path relative to it) changes the
    steps with equal names and appends its other steps.

    Raises
    ------
    InvalidParameter
        The file has faults; all of them are in the message.
    """
    path = params.find(name_or_path, "regulation", "target file")
    return validated(Targets, _tables(path, ()), path.name)


#: Pairs of entries of a step that exclude each other.
_TARGET, _RANGE = ("target",), ("low", "high")
MOST_EXTENDS = 16


def _tables(path: Path, seen: tuple[Path, ...]) -> dict[str, Any]:
    """Tables of a file, merged with the tables of the file that it extends."""
    raw = read_toml(path)
    base = raw.get("extends", "")
    if not base or not isinstance(base, str):
        return raw
    if path.resolve() in seen:
        raise InvalidParameter(f"{path}: extends {base!r}, which leads back to itself")
    if len(seen) >= MOST_EXTENDS:
        raise InvalidParameter(f"{path}: extends {base!r}; the limit is {MOST_EXTENDS} files")
    below = _tables(
        params.find(base, "regulation", "target file", beside=path.parent), (*seen, path.resolve())
    )
    steps, own = below.get("steps", []), raw.get("steps", [])
    if not isinstance(own, list) or not isinstance(steps, list):
        return {**below, **raw}
    merged = list(steps)
    for step in own:
        name = step.get("name") if isinstance(step, Mapping) else None
        at = next((i for i, s in enumerate(merged) if name and s.get("name") == name), None)
        if at is None:
            merged.append(step)
            continue
        gone = _RANGE if set(_TARGET) & set(step) else _TARGET if set(_RANGE) & set(step) else ()
        merged[at] = {**{k: v for k, v in merged[at].items() if k not in gone}, **step}
    return {**below, **raw, "steps": merged}


@checked
def default_targets(action: Action) -> Targets:
    """Packaged targets of a mechanism, by its name; for variants ``name_x``, by ``name``."""
    name = action.name
    while name:
        if name in packaged_targets():
            return load_targets(name)
        name = name.rpartition("_")[0]
    raise InvalidParameter(
        f"there are no packaged targets for mechanism {action.name!r}; give targets "
        f"(packaged are {', '.join(packaged_targets())})"
    )
