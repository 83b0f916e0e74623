"""Computes the turn of a screw that meets a target, by a bracketed solve in one dimension."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from feltmb.action.regulate.measuring import CannotMeasure
from feltmb.action.regulate.targets import MEASURES, Screw, Step

#: Steps of the turn of a screw [m, rad].
SMALLEST = {"m": 1e-8, "rad": 1e-7}


@dataclass(frozen=True)
class Solved:
    """Turn that meets the target, or the reason why there is none."""

    turn: float | None
    why: str = ""


def solve(
    step: Step, start: float, measure: Callable[[float], float], first: float | None
) -> Solved:
    """Turn within the limits of a screw at which its step meets the target."""
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
            except CannotMeasure as failure:
                failures.append(str(failure))
                return None
        value = tried[turn]
        return 0.0 if abs(value) <= fine else value

    if first is not None:
        tried[round(start / smallest) * smallest] = step.error(first)
    bracket = _bracket(screw, start, error)
    if bracket is None:
        return Solved(None, _unreachable(step, tried, failures))
    a, b = bracket
    if a != b:

        def root(turn: float) -> float:
            value = error(turn)
            if value is None:
                raise CannotMeasure(failures[-1])
            return value

        try:
            a = float(brentq(root, a, b, xtol=smallest, rtol=1e-12, maxiter=60))
        except CannotMeasure as failure:
            return Solved(None, f"cannot be measured on the way: {failure}")
    turn = round(a / smallest) * smallest
    value = error(turn)
    if value is None or abs(value) > step.tolerance:
        _, unit, factor, _ = MEASURES[step.measure]
        under = [e for e in tried.values() if e < 0.0]
        over = [e for e in tried.values() if e >= 0.0]
        near = [max(under, default=math.nan), min(over, default=math.nan)]
        ends = " and ".join(f"{((step.target or 0.0) + e) * factor:.5g}" for e in near)
        return Solved(None, f"the measure jumps over the target, between {ends} {unit}".rstrip())
    return Solved(turn)


def _bracket(
    screw: Screw,
    start: float,
    error: Callable[[float], float | None],
) -> tuple[float, float] | None:
    """Two turns with errors of opposite sign; equal if the target is met; None if not found."""
    here = error(start)
    span = screw.high - screw.low
    if here is None:
        # Without a start value: search the whole range.
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
    """Increase the turn in growing steps until the error changes sign or the limit is reached."""
    low, low_error = start, here
    shrinks = 0
    while True:
        turn = min(screw.high, max(screw.low, low + stride))
        if turn == low:
            return None
        value = error(turn)
        if value is None:  # not measurable: smaller steps, a limited number of times
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
