"""Virtual regulation: turn the screws of an action until it does what a technician asks for.

Steps A to F of thesis section 4.2.3. Each step measures one thing, at rest, in a slow press or
after a simulated blow, and turns one screw, a bracketed one-dimensional solve. The steps follow
one another in the order of the targets file and are repeated until all hold at once.
``load_targets`` reads the file, :func:`regulate` does the work.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from feltmb import _core, params
from feltmb.config import Action, load_action
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.files import is_file, read_toml
from feltmb.quantity import SI, Schema, fault_lines, fault_text, parse_scalar, shortened
from feltmb.units import conversion_factor

if TYPE_CHECKING:
    from feltmb.quasistatic import SimulatedPress

__all__ = [
    "MEASURES",
    "Regulation",
    "Row",
    "Screw",
    "Step",
    "Targets",
    "load_targets",
    "packaged_targets",
    "regulate",
]

#: measure -> (SI unit, unit for people, its factor, what is measured)
MEASURES: dict[str, tuple[str, str, float, str]] = {
    "rest_gap": ("m", "mm", 1e3, "distance of the surfaces of a contact at rest"),
    "rest_force": ("N", "N", 1.0, "normal force of a contact at rest"),
    "simulated_press": ("m", "mm", 1e3, "closest approach of hammer and string, slow press"),
    "static_press": ("m", "mm", 1e3, "the same without inertia"),
    "simulated_start": ("1", "", 1.0, "part of the blow done when a contact closes, slow press"),
    "check_distance": ("m", "mm", 1e3, "hammer in the backcheck to the string after a stroke"),
}
MeasureName = Literal[
    "rest_gap",
    "rest_force",
    "simulated_press",
    "static_press",
    "simulated_start",
    "check_distance",
]

#: A hammer that swings more than this in check is not at rest [m].
MOST_SWING = 1e-3
#: Screws are turned in steps of these [m, rad].
SMALLEST = {"m": 1e-8, "rad": 1e-7}


class Screw(Schema):
    """A value of the mechanism file that a step may change."""

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
        """SI unit of a turn: m for a point that is moved, rad for an angle."""
        return "rad" if self.direction is None else "m"


def _direction(node: object) -> object:
    if isinstance(node, list) and len(node) == 2 and all(isinstance(v, (int, float)) for v in node):
        length = math.hypot(float(node[0]), float(node[1]))
        if not abs(length - 1.0) < 1e-3:
            raise ValueError(f"got {node!r} of length {length:g}, expected a direction of length 1")
        return (node[0] / length, node[1] / length)
    return node


def _turn(node: object) -> float:
    """A length [m] or an angle [rad]."""
    try:
        return parse_scalar(node, "m")
    except ValueError as error:
        if "does not measure" not in str(error):
            raise
        return parse_scalar(node, "rad")


class Step(Schema):
    """One thing that is measured, and the screw that sets it (none: it is only checked).

    ``speed`` and ``travel`` are of the finger in a slow press, ``friction`` of ``static_press``.
    """

    letter: str = ""
    name: str
    note: str = ""
    measure: MeasureName
    contact: int | None = None
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
        """Targets have the unit of their measure."""
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
        if self.measure in ("rest_gap", "rest_force", "simulated_start") and self.contact is None:
            raise ValueError(f"measure {self.measure!r} needs a contact")
        if self.screw is not None and not self.screw.low < 0.0 < self.screw.high:
            raise ValueError("bounds of a screw must lie on both sides of zero")
        return self

    def error(self, value: float) -> float:
        """How far a measured value is off, SI; zero inside a range."""
        if self.target is not None:
            return value - self.target
        if self.low is not None and value < self.low:
            return value - self.low
        if self.high is not None and value > self.high:
            return value - self.high
        return 0.0

    def holds(self, value: float | None) -> bool:
        """Whether a measured value is what is asked for."""
        return value is not None and abs(self.error(value)) <= (self.tolerance or 0.0)

    @property
    def wanted(self) -> str:
        """Target in the unit for people."""
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
    about: str = ""
    cite: str = ""
    rounds: Annotated[int, Field(ge=1, le=100)] = 8
    steps: Annotated[list[Step], Field(min_length=1)]


def packaged_targets() -> list[str]:
    """Names of the targets files that come with the package."""
    return params.names("regulation")


def load_targets(name_or_path: str | Path) -> Targets:
    """Read targets: the name of a packaged file, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        Listing all faults at once.
    """
    text = str(name_or_path)
    path = (
        params.folder("regulation") / f"{text}.toml" if text in packaged_targets() else Path(text)
    )
    if not is_file(path):
        raise InvalidParameter(
            f"targets {shortened(repr(text))} are unknown; "
            f"packaged are {', '.join(packaged_targets())}; or give the path of a TOML file"
        )
    try:
        return Targets.model_validate(read_toml(path))
    except ValidationError as error:
        raise InvalidParameter(fault_text(path.name, fault_lines(error, Targets))) from None


def _default_targets(action: Action) -> Targets:
    name = action.name
    while name:
        if name in packaged_targets():
            return load_targets(name)
        name = name.rpartition("_")[0]
    raise InvalidParameter(
        f"there are no packaged targets for mechanism {action.name!r}; give targets "
        f"(packaged are {', '.join(packaged_targets())})"
    )


# --- result --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One step of a regulation."""

    letter: str
    name: str
    measure: str
    target: str  #: in ``unit``: a number or a range
    before: float | None  #: measured on the action as it was given, in ``unit``; None: not possible
    after: float | None  #: on the regulated action, in ``unit``
    unit: str  #: of target, before and after
    screw: str  #: name of the screw, empty if the step only checks
    path: str  #: of the value that it changes
    turned: float  #: in ``turn_unit``, along the direction of the screw
    turn_unit: str  #: mm or deg
    holds: bool
    why: str  #: why it does not hold, or why ``before`` could not be measured


@dataclass(frozen=True, eq=False)
class Regulation:
    """What a regulation did.

    Attributes
    ----------
    table : tuple of Row
        One row a step, in the order of the targets.
    action : Action
        The regulated mechanism; the very one that was given if no screw was turned.
    rounds : int
        Times the steps were gone through, the last one finding that all hold.
    converged : bool
        All steps hold at once.
    counts : dict
        Number of rest poses, slow presses and strokes that were computed.
    provenance : dict
        Data set and its hash, targets, version, and what each screw was turned by.
    """

    table: tuple[Row, ...]
    action: Action
    rounds: int
    converged: bool
    counts: dict[str, int]
    provenance: dict[str, Any]

    @property
    def unmet(self) -> tuple[Row, ...]:
        """Rows that do not hold."""
        return tuple(row for row in self.table if not row.holds)

    def to_toml(self) -> str:
        """Text of a file that loads as the regulated mechanism, its provenance in front."""
        lines = [
            f"Regulated by feltmb {self.provenance['version']}.",
            f"Data set {self.provenance['action']}, hash {self.provenance['hash']}.",
            f"Targets {self.provenance['targets']}: {self.provenance['about']}.",
        ]
        for row in self.table:
            state = "" if row.holds else " NOT REACHED"
            lines.append(
                f"{row.letter} {row.name}: target {row.target} {row.unit}, before "
                f"{_number(row.before)}, after {_number(row.after)} {row.unit}{state}".rstrip()
            )
            if row.screw and row.turned:
                lines.append(f"  {row.screw}: {row.path} by {row.turned:+.5g} {row.turn_unit}")
        return "".join(f"# {line}\n" for line in lines) + "\n" + self.action.to_toml()

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {
            "steps": [dict(vars(row)) for row in self.table],
            "rounds": self.rounds,
            "converged": self.converged,
            "counts": dict(self.counts),
            "provenance": self.provenance,
        }


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"


# --- measuring -----------------------------------------------------------------------------------


class _CannotMeasure(FeltmbError):
    """The procedure has no result on this action; the message says why."""


@dataclass
class _Bench:
    """Measures steps, and remembers what was simulated of each action."""

    counts: dict[str, int] = field(
        default_factory=lambda: {"rest poses": 0, "slow presses": 0, "strokes": 0}
    )
    _rests: dict[str, dict[int, tuple[float, float]]] = field(default_factory=dict)
    _presses: dict[tuple[str, float, float], SimulatedPress] = field(default_factory=dict)
    _values: dict[tuple[str, str], float] = field(default_factory=dict)

    def measure(self, action: Action, step: Step) -> float:
        """Value in SI units.

        Raises
        ------
        _CannotMeasure
            The action does not do what the step measures.
        """
        key = (action.hash, step.model_dump_json(exclude={"screw", "target", "tolerance"}))
        if key not in self._values:
            try:
                self._values[key] = getattr(self, f"_{step.measure}")(action, step)
            except _CannotMeasure:
                raise
            except InvalidParameter:
                raise
            except FeltmbError as error:
                raise _CannotMeasure(str(error)) from None
        return self._values[key]

    def _rest(self, action: Action) -> dict[int, tuple[float, float]]:
        if action.hash not in self._rests:
            import numpy as np

            from feltmb.simulate import evaluate

            self.counts["rest poses"] += 1
            pose = action.rest_pose
            table = evaluate(action, pose, np.zeros_like(pose))._rows
            self._rests[action.hash] = {int(r[0]): (-float(r[1]), float(r[3])) for r in table}
        return self._rests[action.hash]

    def _contact(self, action: Action, number: int | None) -> tuple[float, float]:
        rest = self._rest(action)
        if number not in rest:
            known = ", ".join(str(n) for n in sorted(rest))
            raise InvalidParameter(f"targets: there is no contact {number}; contacts are {known}")
        return rest[number]

    def _rest_gap(self, action: Action, step: Step) -> float:
        return self._contact(action, step.contact)[0]

    def _rest_force(self, action: Action, step: Step) -> float:
        return self._contact(action, step.contact)[1]

    def _press(self, action: Action, step: Step) -> SimulatedPress:
        from feltmb.quasistatic import simulated_press

        key = (action.hash, step.speed, step.travel)
        if key not in self._presses:
            self.counts["slow presses"] += 1
            self._presses.clear()  # one is enough: let-off and damper follow one another
            self._presses[key] = simulated_press(action, speed=step.speed, travel=step.travel)
        return self._presses[key]

    def _simulated_press(self, action: Action, step: Step) -> float:
        return self._press(action, step).closest

    def _static_press(self, action: Action, step: Step) -> float:
        from feltmb.quasistatic import static_let_off

        self.counts["slow presses"] += 1
        return static_let_off(
            action, travel=step.travel, speed=step.speed, friction=step.friction
        ).gap

    def _simulated_start(self, action: Action, step: Step) -> float:
        self._contact(action, step.contact)
        assert step.contact is not None
        gap = self._press(action, step).gap_when(step.contact)
        if gap is None:
            raise _CannotMeasure(
                f"contact {step.contact} does not close in a press of {1e3 * step.travel:g} mm"
            )
        strike = action.config.summary.strike_contact
        return 1.0 - gap / self._contact(action, strike)[0]

    def _check_distance(self, action: Action, step: Step) -> float:
        from feltmb.simulate import simulate

        self.counts["strokes"] += 1
        summary = simulate(action, step.stroke, ledger=False, output_rate=2000.0).summary
        if "check_gap" not in summary:
            raise _CannotMeasure(f"the backcheck does not hold the hammer after {step.stroke}")
        if summary["check_gap_swing"] > MOST_SWING:
            raise _CannotMeasure(
                f"the hammer swings by {1e3 * summary['check_gap_swing']:.3g} mm in check at the "
                f"end of {step.stroke}"
            )
        return summary["check_gap"]


# --- screws --------------------------------------------------------------------------------------


@dataclass
class _Screws:
    """The screws of an action and by how much each has been turned [m, rad]."""

    base: Action
    steps: list[Step]
    turns: list[float] = field(init=False)

    def __post_init__(self) -> None:
        self.turns = [0.0] * len(self.steps)
        faults = []
        for step in self.steps:
            if step.screw is not None:
                try:
                    self._position(step.screw)
                except InvalidParameter as error:
                    faults.append(f"step {step.name!r}: {error}")
        if faults:
            raise InvalidParameter("\n".join(faults))

    def _position(self, screw: Screw) -> tuple[Any, str, tuple[float, float] | None]:
        """Raw entry, its unit and the direction of a screw."""
        node: Any = self.base.raw
        parts = screw.path.split(".")
        if parts[0] in node.get("bodies", {}):
            parts = ["bodies", *parts]
        for part in parts:
            if not isinstance(node, Mapping) or part not in node:
                raise InvalidParameter(
                    f"screw {screw.path!r} is no value of mechanism {self.base.name!r}"
                )
            node = node[part]
        direction = screw.direction
        if direction == "normal":
            surface = self.base.config.surfaces.get(parts[1]) if parts[0] == "surfaces" else None
            if surface is None or surface.normal is None:
                raise InvalidParameter(f"screw {screw.path!r}: has no normal to move along")
            direction = surface.normal
        default = "rad" if direction is None else "m"
        unit = str(node.get("unit", default)) if isinstance(node, Mapping) else default
        value = node.get("value") if isinstance(node, Mapping) else node
        if direction is None:
            value = parse_scalar(node, "rad")
        elif not (isinstance(value, list) and len(value) == 2):
            raise InvalidParameter(f"screw {screw.path!r}: a direction needs a point to move")
        if isinstance(node, str):
            unit = default
        return (dict(node) if isinstance(node, Mapping) else {"value": value}), unit, direction

    def apply(self, turns: list[float], describe: Callable[[int], str] | None = None) -> Action:
        """The action with its screws turned; ``describe`` gives a note for a step."""
        values: dict[str, Any] = {}
        for i, (step, turn) in enumerate(zip(self.steps, turns, strict=True)):
            if step.screw is None or turn == 0.0:
                continue
            entry, unit, direction = self._position(step.screw)
            path = step.screw.path
            new = values.get(path, entry)
            factor = 1.0 / conversion_factor(unit, step.screw.unit)
            if direction is None:
                if path not in values:
                    new = {**entry, "value": parse_scalar(entry, "rad") * factor}
                new = {**new, "value": _tidy(float(new["value"]) + turn * factor)}
            else:
                new = {
                    **new,
                    "value": [
                        _tidy(float(v) + turn * d * factor)
                        for v, d in zip(new["value"], direction, strict=True)
                    ],
                }
            new["unit"] = unit
            new["status"] = "regulated"
            if describe is not None:
                old = str(new.get("note", ""))
                new["note"] = f"{old}; {describe(i)}" if old else describe(i)
            values[path] = new
        return self.base.with_values(values) if values else self.base


def _tidy(value: float) -> float:
    return float(f"{value:.12g}")


# --- the work ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Solved:
    """Turn that meets a step, or why there is none."""

    turn: float | None
    why: str = ""


def _solve(
    step: Step, start: float, measure: Callable[[float], float], first: float | None
) -> _Solved:
    """Turn at which the step holds, between the bounds of its screw."""
    from scipy.optimize import brentq

    screw = step.screw
    assert screw is not None
    assert step.tolerance is not None
    smallest = SMALLEST[screw.unit]
    fine = 0.25 * step.tolerance
    tried: dict[float, float] = {}
    failures: list[str] = []

    def error(turn: float) -> float | None:
        turn = round(turn / smallest) * smallest
        if turn not in tried:
            try:
                tried[turn] = step.error(measure(turn))
            except _CannotMeasure as failure:
                failures.append(str(failure))
                return None
        value = tried[turn]
        return 0.0 if abs(value) <= fine else value

    if first is not None:
        tried[round(start / smallest) * smallest] = step.error(first)
    bracket = _bracket(screw, start, error)
    if bracket is None:
        return _Solved(None, _unreachable(step, tried, failures))
    a, b = bracket
    if a != b:

        def root(turn: float) -> float:
            value = error(turn)
            if value is None:
                raise _CannotMeasure(failures[-1])
            return value

        try:
            a = float(brentq(root, a, b, xtol=smallest, rtol=1e-12, maxiter=60))
        except _CannotMeasure as failure:
            return _Solved(None, f"cannot be measured on the way: {failure}")
    turn = round(a / smallest) * smallest
    value = error(turn)
    if value is None or abs(value) > step.tolerance:
        _, unit, factor, _ = MEASURES[step.measure]
        under = [e for e in tried.values() if e < 0.0]
        over = [e for e in tried.values() if e >= 0.0]
        near = [max(under, default=math.nan), min(over, default=math.nan)]
        ends = " and ".join(f"{((step.target or 0.0) + e) * factor:.5g}" for e in near)
        return _Solved(None, f"the measure jumps over the target, between {ends} {unit}".rstrip())
    return _Solved(turn)


def _bracket(
    screw: Screw,
    start: float,
    error: Callable[[float], float | None],
) -> tuple[float, float] | None:
    """Two turns with errors of opposite sign (the same turn twice: it holds); None if none."""
    here = error(start)
    span = screw.high - screw.low
    if here is None:
        # Nothing to go by: look over the whole range.
        last: tuple[float, float] | None = None
        for k in range(25):
            turn = screw.low + span * k / 24
            value = error(turn)
            if value is None:
                continue
            if value == 0.0:
                return turn, turn
            if last is not None and (last[1] < 0.0) != (value < 0.0):
                return last[0], turn
            last = (turn, value)
        return None
    if here == 0.0:
        return start, start
    if screw.gain:
        stride = -1.15 * here / screw.gain
    else:
        stride = 0.02 * span
        beside = error(min(screw.high, start + stride))
        if beside is not None and abs(beside) > abs(here):
            stride = -stride
    least = 1e-4 * span
    if abs(stride) < least:
        stride = math.copysign(least, stride)
    for way in (stride, -stride):
        found = _walk(screw, start, here, way, error)
        if found is not None:
            return found
    return None


def _walk(
    screw: Screw, start: float, here: float, stride: float, error: Callable[[float], float | None]
) -> tuple[float, float] | None:
    """Go one way in growing strides until the error changes sign or the bound is reached."""
    low, low_error = start, here
    shrinks = 0
    while True:
        turn = min(screw.high, max(screw.low, low + stride))
        if turn == low:
            return None
        value = error(turn)
        if value is None:  # not measurable there: go in smaller strides, but not for ever
            shrinks += 1
            if shrinks > 8:
                return None
            stride *= 0.4
            continue
        if value == 0.0:
            return turn, turn
        if (value < 0.0) != (low_error < 0.0):
            return low, turn
        if shrinks == 0:
            stride *= 1.8
        low, low_error = turn, value


def _unreachable(step: Step, tried: dict[float, float], failures: list[str]) -> str:
    screw = step.screw
    assert screw is not None
    assert step.target is not None
    _, unit, factor, _ = MEASURES[step.measure]
    per, people = (1e3, "mm") if screw.unit == "m" else (180.0 / math.pi, "deg")
    text = ""
    if tried:
        values = [(step.target + e) * factor for e in tried.values()]
        text = (
            f"within {screw.low * per:+g} to {screw.high * per:+g} {people} of {screw.path} it "
            f"reaches {min(values):.5g} to {max(values):.5g} {unit}".rstrip()
        )
    if failures:
        text += ("; " if text else "") + failures[-1]
    return text


def regulate(
    action: Action | str,
    targets: Targets | str | Path | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> Regulation:
    """Regulate an action.

    Parameters
    ----------
    action
        Mechanism, or its name for :func:`load_action`.
    targets
        Targets, or their name or path for :func:`load_targets`; default: the packaged ones of the
        mechanism's name (``steinway45_printed`` takes those of ``steinway45``).
    progress
        Called with a line of text before each solve.

    Returns
    -------
    Regulation
        Also when a target cannot be met: ``converged`` is false then, ``unmet`` says which and
        why, and its screw stays where it was.

    Raises
    ------
    InvalidParameter
        The targets do not fit the mechanism.
    """
    if isinstance(action, str):
        action = load_action(action)
    if targets is None:
        targets = _default_targets(action)
    elif not isinstance(targets, Targets):
        targets = load_targets(targets)
    say = progress or (lambda _text: None)
    bench = _Bench()
    screws = _Screws(action, targets.steps)
    n = len(targets.steps)
    reasons = [""] * n
    before: list[float | None] = [None] * n
    for i, step in enumerate(targets.steps):
        say(f"measuring: {step.name}")
        try:
            before[i] = bench.measure(action, step)
        except _CannotMeasure as failure:
            reasons[i] = str(failure)
    after = list(before)
    first_reasons = list(reasons)
    rounds = 0
    holding = False
    while rounds < targets.rounds and not holding:
        rounds += 1
        turned = False
        holding = True
        for i, step in enumerate(targets.steps):
            after[i], reasons[i] = _try_measure(bench, screws.apply(screws.turns), step)
            if step.holds(after[i]):
                continue
            holding = False
            if step.screw is None:
                reasons[i] = reasons[i] or "is only checked: no screw of these targets sets it"
                continue
            say(f"round {rounds}: {step.name}, turning {step.screw.name}")
            solved = _solve(
                step,
                screws.turns[i],
                lambda turn, i=i, step=step: bench.measure(  # type: ignore[misc]
                    screws.apply([*screws.turns[:i], turn, *screws.turns[i + 1 :]]), step
                ),
                after[i],
            )
            if solved.turn is None:
                reasons[i] = solved.why
            elif solved.turn != screws.turns[i]:
                screws.turns[i] = solved.turn
                turned = True
        if not turned:
            break
    # One more look: the last round may have ended with a turn.
    plain = screws.apply(screws.turns)
    for i, step in enumerate(targets.steps):
        after[i], why = _try_measure(bench, plain, step)
        if step.holds(after[i]):
            reasons[i] = ""
        else:
            reasons[i] = reasons[i] or why or f"does not settle within {targets.rounds} rounds"
    rows = tuple(
        _row(step, before[i], after[i], screws.turns[i], reasons[i] or first_reasons[i])
        for i, step in enumerate(targets.steps)
    )
    provenance = _provenance(action, targets, rows)
    regulated = _with_provenance(screws, targets, provenance)
    return Regulation(rows, regulated, rounds, all(r.holds for r in rows), bench.counts, provenance)


def _try_measure(bench: _Bench, action: Action, step: Step) -> tuple[float | None, str]:
    try:
        return bench.measure(action, step), ""
    except _CannotMeasure as failure:
        return None, str(failure)


def _row(step: Step, before: float | None, after: float | None, turn: float, why: str) -> Row:
    _, unit, factor, _ = MEASURES[step.measure]
    screw = step.screw
    per, people = (1e3, "mm")
    if screw is not None and screw.unit == "rad":
        per, people = (180.0 / math.pi, "deg")
    return Row(
        letter=step.letter,
        name=step.name,
        measure=step.measure,
        target=step.wanted,
        before=None if before is None else before * factor,
        after=None if after is None else after * factor,
        unit=unit,
        screw=screw.name if screw is not None else "",
        path=screw.path if screw is not None else "",
        turned=_tidy(turn * per),
        turn_unit=people if screw is not None else "",
        holds=step.holds(after),
        why=why,
    )


def _provenance(action: Action, targets: Targets, rows: tuple[Row, ...]) -> dict[str, Any]:
    return {
        "action": action.name,
        "hash": action.hash,
        "targets": targets.name,
        "about": targets.about,
        "cite": targets.cite,
        "version": _core.__version__,
        "screws": {
            row.path: {"turned": row.turned, "unit": row.turn_unit, "step": row.name}
            for row in rows
            if row.screw and row.turned
        },
    }


def _with_provenance(screws: _Screws, targets: Targets, provenance: dict[str, Any]) -> Action:
    """The regulated action, what was done to it written at each changed value."""

    def note(i: int) -> str:
        step = screws.steps[i]
        assert step.screw is not None
        per, unit = (1e3, "mm") if step.screw.unit == "m" else (180.0 / math.pi, "deg")
        return (
            f"regulation {step.letter} {step.name}: {screws.turns[i] * per:+.5g} {unit} from data "
            f"set {provenance['action']} {provenance['hash'][:12]}, targets {targets.name}, "
            f"feltmb {provenance['version']}"
        )

    regulated = screws.apply(screws.turns, note)
    if regulated is screws.base:
        return regulated
    about = str(regulated.raw.get("about", "")) or str(provenance["action"])
    about = about.removesuffix(", not regulated").partition("; regulated to targets ")[0]
    name = screws.base.name.removesuffix("_regulated")
    return regulated.with_values(
        {
            "name": f"{name}_regulated",
            "about": f"{about}; regulated to targets {targets.name}",
        }
    )
