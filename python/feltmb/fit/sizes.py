"""Expected sizes of effects for which no size is stated, from trials on the records."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array, Record
from feltmb.fit.model import Candidate, Effect, Jobs, Model

__all__ = ["sized"]

#: Smallest and largest expected change of the outputs, as shares of the motion [1]; number of
#: trials of a size.
LEAST, MOST, TRIALS = 0.01, 0.3, 12
#: Largest change of the outputs, as a share of the motion, that is none [1].
NONE = 1e-9


def sized(
    model: Model, effects: Sequence[Effect], which: Collection[str], records: Sequence[Record]
) -> tuple[tuple[Effect, ...], list[str]]:
    """Effects whose expected size changes the outputs as much as model and records differ.

    An effect that acts on one side only, or on both sides alike, gets a sign.

    Parameters
    ----------
    model
        Model with all channels.
    effects
        Effects of the model.
    which
        Names of those without a size.
    records
        Measured runs.

    Returns
    -------
    The effects, and a note about each that got a size.
    """
    if not which:
        return tuple(effects), []
    record = max(records, key=lambda r: _motion(r, model.outputs))
    base = _run(model, record, None, 0.0)
    measured = record.output_array(model.outputs)
    spread = [float(np.std(y[np.isfinite(y)])) if np.isfinite(y).any() else 0.0 for y in measured.T]
    unit = np.where(np.array(spread) > 0.0, spread, np.maximum(np.std(base, axis=0), 1e-300))
    goal = min(max(_share(measured - base, unit), LEAST), MOST)
    found, notes = [], []
    for effect in effects:
        if effect.name in which:
            effect, note = _with_size(model, effect, record, base, unit, goal)
            notes.append(note)
        found.append(effect)
    return tuple(found), notes


def _motion(record: Record, names: Sequence[str]) -> float:
    return sum(float(np.nanvar(record.outputs[n])) for n in names if n in record.outputs)


def _share(change: Array, unit: Array) -> float:
    """Rms of a change in the channel that changes most, as a share of its motion."""
    squares = np.where(np.isfinite(change), change / unit, 0.0) ** 2
    return float(np.sqrt(squares.mean(axis=0).max(initial=0.0)))


def _run(model: Model, record: Record, effect: Effect | None, size: float) -> Array:
    included = () if effect is None else (Candidate(effect, effect.shapes[0]),)
    states = model.states(included)
    mean = {} if record.start is None else record.start.mean
    jobs = Jobs(
        theta=np.array([[p.value for p in model.parameters]]),
        starts=np.array([[mean.get(s.name, s.start) for s in states]]),
        included=included,
        magnitudes=np.full((1, len(included)), size),
    )
    return np.asarray(model.simulate(record, jobs)[0])


def _first(model: Model, effect: Effect, record: Record) -> float:
    """A size for the first trial: a tenth of an input or a parameter in the same unit."""
    sizes = [np.quantile(np.abs(v), 0.98) for n, v in record.inputs.items()
             if record.input_units.get(n, model.units.get(n)) == effect.unit]  # fmt: skip
    sizes += [abs(p.value) for p in model.parameters if p.unit == effect.unit]
    return 0.1 * float(max(sizes, default=0.0)) or 1.0


def _with_size(
    model: Model, effect: Effect, record: Record, base: Array, unit: Array, goal: float
) -> tuple[Effect, str]:
    low, high = effect.bounds

    def changed(size: float) -> Array | None:
        y = _run(model, record, effect, min(max(size, low), high))
        return y if np.isfinite(y).all() else None

    side = 1.0 if high > 0.0 else -1.0
    best, size = _search(changed, side, _first(model, effect, record), base, unit, goal)
    if best is None and low < 0.0 < high:
        side = -side
        best, size = _search(changed, side, _first(model, effect, record), base, unit, goal)
    if best is None:
        return effect, f"{effect.name}: no size of it changes record {record.name}"
    why = ""
    if low < 0.0 < high:
        other = changed(-side * size)
        if other is None or _share(other - base, unit) < NONE:
            why = "fails" if other is None else "has no influence"
        elif _share(other - best, unit) < NONE:
            why = "acts alike"
    if why:
        effect = replace(effect, sign=1 if side > 0.0 else -1)
        why = f", with one sign, since the other {why}"
    digits = float(f"{size:.2g}")
    return replace(effect, scale=digits), (
        f"{effect.name}: expected size {digits:g} {effect.unit}, from its influence on record "
        f"{record.name}{why}"
    )


def _search(
    changed: Callable[[float], Array | None],
    side: float,
    size: float,
    base: Array,
    unit: Array,
    goal: float,
) -> tuple[Array | None, float]:
    """The size whose change is nearest to the goal, and the outputs with it."""
    best: Array | None = None
    at, distance = 0.0, math.inf
    for _ in range(TRIALS):
        y = changed(side * size)
        share = math.nan if y is None else _share(y - base, unit)
        if y is not None and share > NONE:
            far = abs(math.log(share / goal))
            if far < distance:
                best, at, distance = y, size, far
            if far < math.log(1.5):
                break
            size *= min(max(goal / share, 1e-2), 1e2)
        else:
            size *= 0.1 if y is None else 100.0
    return best, at
