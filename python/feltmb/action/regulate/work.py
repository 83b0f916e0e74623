"""Performs a regulation and returns its result."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from feltmb import _core
from feltmb.action.regulate.measuring import Bench, CannotMeasure
from feltmb.action.regulate.screws import Screws
from feltmb.action.regulate.solving import solve
from feltmb.action.regulate.targets import MEASURES, Step, Targets, default_targets, load_targets
from feltmb.mechanism import Action, load_action
from feltmb.mechanism.values import tidy
from feltmb.mechanism.workshop import move_text, turns_of
from unmodeled.arguments import checked


@dataclass(frozen=True)
class Row:
    """One step of a regulation."""

    letter: str
    name: str
    measure: str
    target: str  #: target, in ``unit``: a number or a range
    before: float | None  #: measured before the regulation, in ``unit``; None: not possible
    after: float | None  #: measured after the regulation, in ``unit``
    unit: str  #: unit of target, before and after
    screw: str  #: name of the screw; empty if the step only checks
    path: str  #: path of the value that the screw changes
    turned: float  #: turn of the screw in ``turn_unit``, along its direction
    turn_unit: str  #: unit of the turn: mm or deg
    turns: float | None  #: turns of the thread, positive; None: the screw has no thread
    turn_word: str  #: direction of the turns, such as up; empty without a thread
    value_before: str  #: value of the screw in the file, with its unit; empty without a screw
    value_after: str
    holds: bool
    why: str  #: reason why the target is not met, or why ``before`` is not available

    @property
    def moved(self) -> str:
        """The turn as text, such as ``+0.400 mm = 0.57 turn up``."""
        turns = None if self.turns is None else (self.turns, self.turn_word)
        return move_text(self.turned, self.turn_unit, turns)


@dataclass(frozen=True, eq=False)
class Regulation:
    """Result of a regulation.

    Attributes
    ----------
    table : tuple of Row
        One row for each step, in the order of the targets.
    action : Action
        The regulated mechanism; the given object itself if no screw was turned.
    rounds : int
        Number of rounds through all steps. In the last round, all targets were met.
    converged : bool
        Whether all targets are met simultaneously.
    counts : dict
        Number of computed rest poses, slow presses and strokes.
    provenance : dict
        Data set and its hash, targets, version, and the turn of each screw.
    notes : tuple of str
        An aftertouch beyond 1 to 2 mm that the targets do not ask for.
    """

    table: tuple[Row, ...]
    action: Action
    rounds: int
    converged: bool
    counts: dict[str, int]
    provenance: dict[str, Any]
    notes: tuple[str, ...] = ()

    @property
    def unmet(self) -> tuple[Row, ...]:
        """Rows whose target is not met."""
        return tuple(row for row in self.table if not row.holds)

    def to_toml(self) -> str:
        """Text of a file that defines the regulated mechanism, with its provenance at the top."""
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
                lines.append(f"  {row.screw}: {row.path} by {row.moved}")
        lines += self.notes
        return "".join(f"# {line}\n" for line in lines) + "\n" + self.action.to_toml()

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {
            "steps": [dict(vars(row)) for row in self.table],
            "rounds": self.rounds,
            "converged": self.converged,
            "counts": dict(self.counts),
            "notes": list(self.notes),
            "provenance": self.provenance,
        }


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"


def _round(
    number: int,
    bench: Bench,
    screws: Screws,
    targets: Targets,
    after: list[float | None],
    reasons: list[str],
    say: Callable[[str], object],
) -> tuple[bool, bool]:
    """Measure each step and turn its screw; whether a screw was turned, and whether all hold."""
    turned, holding = False, True
    for i, step in enumerate(targets.steps):
        after[i], reasons[i] = _try_measure(bench, screws.apply(screws.turns), step)
        if step.holds(after[i]):
            continue
        holding = False
        if step.screw is None:
            reasons[i] = reasons[i] or "; ".join(filter(None, (_ONLY_CHECKED, step.note)))
            continue
        say(f"round {number}: {step.name}, turning {step.screw.name}")

        def measured(turn: float, i: int = i, step: Step = step) -> float:
            turns = [*screws.turns[:i], turn, *screws.turns[i + 1 :]]
            return bench.measure(screws.apply(turns), step)

        solved = solve(step, screws.turns[i], measured, after[i])
        if solved.turn is None:
            reasons[i] = solved.why
        elif solved.turn != screws.turns[i]:
            screws.turns[i] = solved.turn
            turned = True
    return turned, holding


@checked
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
        Targets, or their name or path for :func:`load_targets`; default: the packaged targets for
        the name of the mechanism (``steinway45_printed`` uses the targets of ``steinway45``).
    progress
        Function that is called with a line of text before each solve.

    Returns
    -------
    Regulation
        Returned also if a target cannot be met: then ``converged`` is false, ``unmet`` lists the
        rows with reasons, and the screws of these rows are not turned.

    Raises
    ------
    InvalidParameter
        The targets do not suit the mechanism.
    """
    if isinstance(action, str):
        action = load_action(action)
    if targets is None:
        targets = default_targets(action)
    elif not isinstance(targets, Targets):
        targets = load_targets(targets)
    say = progress or (lambda _text: None)
    bench = Bench()
    screws = Screws(action, targets.steps)
    n = len(targets.steps)
    before: list[float | None] = [None] * n
    first_reasons = [""] * n
    for i, step in enumerate(targets.steps):
        say(f"measuring: {step.name}")
        before[i], first_reasons[i] = _try_measure(bench, action, step)
    after = list(before)
    reasons = list(first_reasons)
    rounds = 0
    turned, holding = True, False
    while rounds < targets.rounds and turned and not holding:
        rounds += 1
        turned, holding = _round(rounds, bench, screws, targets, after, reasons, say)
    # Measure again: the last round may have ended with a turn of a screw.
    plain = screws.apply(screws.turns)
    for i, step in enumerate(targets.steps):
        after[i], why = _try_measure(bench, plain, step)
        if step.holds(after[i]):
            reasons[i] = ""
        else:
            reasons[i] = reasons[i] or why or f"does not settle within {targets.rounds} rounds"
    rows = tuple(
        _row(
            step,
            before[i],
            after[i],
            screws.turns[i],
            reasons[i] or first_reasons[i],
            [screws.value(step.screw, a) if step.screw else "" for a in (action, plain)],
            action,
        )
        for i, step in enumerate(targets.steps)
    )
    provenance = _provenance(action, targets, rows)
    regulated = _with_provenance(screws, targets, provenance)
    notes = _aftertouch_notes(bench, plain, targets)
    holding = all(row.holds for row in rows)
    return Regulation(rows, regulated, rounds, holding, bench.counts, provenance, notes)


#: Aftertouch that technicians want [m].
AFTERTOUCH = (1e-3, 2e-3)


def _aftertouch_notes(bench: Bench, action: Action, targets: Targets) -> tuple[str, ...]:
    """A sentence about an aftertouch outside of its range if no step of the targets checks it."""
    landing = action.config.events.get(action.config.reading.touch.landing or "")
    number = landing.contact if landing is not None else None
    presses = [step for step in targets.steps if step.measure in _PRESSED]
    if not isinstance(number, int) or not presses:
        return ()
    if any(step.measure == "aftertouch" for step in targets.steps):
        return ()
    asked = {"name": "aftertouch", "measure": "aftertouch", "contact": number}
    asked |= {"low": AFTERTOUCH[0], "high": AFTERTOUCH[1]}
    asked |= {"speed": presses[0].speed, "travel": presses[0].travel}
    step = Step.model_validate(asked)
    value, why = _try_measure(bench, action, step)
    value = None if value is None else round(value, 5)  # as it is printed
    if step.holds(value):
        return ()
    found = f"cannot be measured: {why}" if value is None else f"is {1e3 * value:.2f} mm"
    late = "; the key lands before the let-off" if value is not None and value < 0.0 else ""
    return (
        f"aftertouch {found}{late}; technicians want {step.wanted} mm, and no step of targets "
        f"{targets.name} asks for it",
    )


_ONLY_CHECKED = "is only checked: no screw of these targets sets it"
#: Measures of a slow press.
_PRESSED = ("simulated_press", "simulated_start")


def _try_measure(bench: Bench, action: Action, step: Step) -> tuple[float | None, str]:
    try:
        return bench.measure(action, step), ""
    except CannotMeasure as failure:
        return None, str(failure)


def _row(
    step: Step,
    before: float | None,
    after: float | None,
    turn: float,
    why: str,
    values: list[str],
    action: Action,
) -> Row:
    _, unit, factor, _ = MEASURES[step.measure]
    screw = step.screw
    per, people = (1e3, "mm")
    if screw is not None and screw.unit == "rad":
        per, people = (180.0 / math.pi, "deg")
    turns = None if screw is None else turns_of(action.config, screw.path, turn)
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
        turned=tidy(turn * per),
        turn_unit=people if screw is not None else "",
        turns=None if turns is None else turns[0],
        turn_word="" if turns is None else turns[1],
        value_before=values[0],
        value_after=values[1],
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


def _with_provenance(screws: Screws, targets: Targets, provenance: dict[str, Any]) -> Action:
    """The regulated action, with a note at each changed value."""

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
