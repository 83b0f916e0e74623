"""How far a withheld effect exceeds what the tolerances can compensate.

The scales of :mod:`blind.action_calibration` choose magnitudes before there is a case: one
linearization at drawing values, columns of the model. Where an effect is nearly the same as a
tolerance, or large, they promise more than any engine could see. Here the tolerances of the
generator's own machine are fitted to what the effect does, without noise, so that nothing of the
engine and nothing of its model's run is in it:

    nc^2 = min over p, z of |W (y(with) - y(p) - D z)|^2 + |(p - p0) / sd|^2 + |z|^2,

p0 the case's own tolerances, D run-to-run variability with the noise of the measured force, W the
whitening by the sensors' noise. In the view "motion" the measured motion is one of the outputs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from feltmb.fit.segmented_records import SegmentedRecord

from blind import action_truth as truth
from blind.action_calibration import to_record, white_columns, whole_segmented
from feltmb.data import Array
from feltmb.run.stroke import Stroke, table_stroke

__all__ = ["Compensated", "Compensation", "compensations", "noncentralities"]

#: Samples of the force that the sensor shows [1/s].
FINE = 16000.0
#: Steps of the fit along the same columns, each one run of every stroke, and how often columns are
#: taken anew where it stops.
ITERATIONS, RENEWALS = 20, 8
#: Damping of a step after one that failed, and the one beyond which the columns do not hold.
LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e3
#: Step of the difference by the magnitude of an effect, of its natural magnitude.
DIFFERENCE = 0.05


@dataclass(frozen=True, eq=False)
class _Stroke:
    """One stroke without the effect, with the tolerances of the case."""

    name: str
    length: float
    segmented: SegmentedRecord
    columns: Array
    """Whitened derivatives by tolerances, in standard deviations."""
    variability: Array
    """Whitened derivatives by this record's run-to-run variability, in standard deviations."""


@functools.cache
def _fixed(view: str) -> tuple[Any, ...]:
    from feltmb.adapters import mechanism_model

    action, base, library, outputs = truth.setup()
    channels = truth.watched(view, outputs)
    model = mechanism_model(action, channels=channels, rtol=1e-6, workers=1)[0]
    return base, library, outputs, model


def noncentralities(case: truth.Case) -> list[float | None]:
    """Noncentrality of every part of a case, without the other parts [1].

    An upper bound, because the fit may end above its minimum. None if it could not be computed. In
    the view "whole" only the part until shortly after the blow counts: what follows is chaotic, and
    the number is what the view "force" would have.
    """
    out: list[float | None] = []
    for fit in compensations(case):
        try:
            out.append(None if fit is None else fit().fit().noncentrality)
        except Exception:
            out.append(None)
    return out


def compensations(case: truth.Case) -> list[Callable[[], Compensation] | None]:
    """For every part of a case, what makes its fit, without the other parts.

    None for all of them if the case is not a valid mechanism: it has no records either.
    """
    if not case.parts:
        return []
    if case.view == "whole":
        case = replace(case, view="force")
    bare = replace(case, parts=())
    try:
        strokes = [_stroke(bare, name) for name in truth.FIT]
    except Exception:
        return [None for _ in case.parts]
    return [
        functools.partial(Compensation, replace(case, parts=(part,)), bare, strokes)
        for part in case.parts
    ]


def _view(
    case: truth.Case, name: str, length: float | None = None, played: Stroke | None = None
) -> dict[str, Array]:
    """Ideal view of a stroke."""
    base, library, outputs, _ = _fixed(case.view)
    return truth.record(
        base, library, case, name, outputs, rtol=1e-7, ideal=True, length=length, played=played
    )[0]


def _shown(case: truth.Case, name: str) -> Stroke | None:
    """Stroke that the force sensor of a case shows; None: the one that was played."""
    played, _ = truth.command(name, case)
    time = np.linspace(0.0, played.duration, int(played.duration * FINE) + 1)
    shown = truth.shown_force(played, case, time)
    if np.array_equal(shown, played.at(time)):
        return None
    return table_stroke(time.tolist(), shown.tolist(), duration=played.duration, name=name)


def _outputs(case: truth.Case, view: Mapping[str, Array]) -> Array:
    """Outputs of the model in a view, (n, ny)."""
    named = {"finger.displacement": "displacement"}
    return np.stack([view[named.get(o, o)] for o in _fixed(case.view)[3].outputs], axis=-1)


def _stroke(bare: truth.Case, name: str) -> _Stroke:
    model = _fixed(bare.view)[3]
    view = _view(bare, name)
    length = len(next(iter(view.values()))) / truth.RATE
    (record,), _ = model.driven([to_record(name, view)])
    segmented = whole_segmented(model, record)
    variability = model.with_variability([record], truth.VARIATION).variabilities[name].columns
    white = segmented.whiten(variability[None]).reshape(-1, variability.shape[2])
    columns = _columns(bare, segmented)
    return _Stroke(name, length, segmented, columns, white)


def _columns(case: truth.Case, segmented: SegmentedRecord) -> Array:
    """Whitened derivatives of a stroke by all tolerances, in standard deviations.

    They are those of the model at the tolerances of the case. They only steer the fit: its sum of
    squares is that of the machine.
    """
    model = _fixed(case.view)[3]
    theta = np.array([case.tolerances.get(p.name, 0.0) for p in model.parameters])
    return white_columns(model, segmented, theta)


@dataclass(frozen=True, eq=False)
class Compensated:
    """End of a fit: what tolerances, and one effect, leave of what a part does."""

    cost: float
    """Smallest sum of squares that was found [1]."""
    moved: Array
    """Change of the tolerances [standard deviations]."""
    rival: truth.Part | None
    """The effect with its fitted magnitude."""

    @property
    def noncentrality(self) -> float:
        """Root of the sum of squares [1]."""
        return math.sqrt(max(self.cost, 0.0))


class Compensation:
    """Fit of the generator's machine without a part to the machine with it.

    All tolerances are free, and the magnitude of one effect of the library if one is told.
    ``case``: with the part alone; ``bare``: without; ``strokes``: of ``bare``.
    """

    def __init__(self, case: truth.Case, bare: truth.Case, strokes: list[_Stroke]) -> None:
        self.bare, self.strokes, self.part = bare, strokes, case.parts[0]
        self.library = _fixed(case.view)[1]
        self.targets = [_outputs(case, _view(case, s.name, s.length)) for s in strokes]
        # An error of the force sensor leaves the machine as it is. The fitted machine gets the
        # force that the sensor shows.
        self.shown = [_shown(case, s.name) for s in strokes]
        self.magnitudes = np.array([e.magnitude for e in self.library.tolerances])
        self.names = [e.name for e in self.library.tolerances]
        self.own = np.array([bare.tolerances.get(n, 0.0) for n in self.names])
        self.variability = _diagonal([s.variability for s in strokes])
        self.clean = np.linalg.inv(
            self.variability.T @ self.variability + np.eye(self.variability.shape[1])
        )

    def _at(self, p: Array, rival: truth.Part | None) -> truth.Case:
        moved = dict(zip(self.names, self.own + p * self.magnitudes, strict=True))
        return replace(self.bare, tolerances=moved, parts=() if rival is None else (rival,))

    def residual(self, p: Array, rival: truth.Part | None = None) -> Array:
        """Whitened difference at tolerances moved by ``p`` standard deviations, all strokes."""
        case, parts = self._at(p, rival), []
        for s, y, shown in zip(self.strokes, self.targets, self.shown, strict=True):
            left = y - _outputs(case, _view(case, s.name, s.length, _played(case, s.name, shown)))
            parts.append(s.segmented.whiten(left[None]).reshape(-1))
        return np.concatenate(parts)

    def _allowed(self, rival: truth.Part | None) -> bool:
        """Whether a diagnosis allows the magnitude of an effect."""
        if rival is None:
            return True
        entry = self.library.effect(rival.name)
        return bool(rival.size * entry.sign >= 0.0 and entry.lower <= rival.size <= entry.upper)

    def cost(self, r: Array, p: Array) -> float:
        """Sum of squares after run-to-run variability, which is linear, plus the priors."""
        pull = self.variability.T @ r
        return float(r @ r - pull @ self.clean @ pull + p @ p)

    def columns(
        self, p: Array, rival: truth.Part | None = None, r: Array | None = None, unit: float = 1.0
    ) -> Array:
        """Derivatives of the machine by tolerances, and by the rival's magnitude in units."""
        columns = np.vstack([_columns(self._at(p, rival), s.segmented) for s in self.strokes])
        if rival is None or r is None:
            return columns
        step = math.copysign(DIFFERENCE * unit, rival.size)
        if not self._allowed(replace(rival, size=rival.size + step)):
            step = -step
        further = self.residual(p, replace(rival, size=rival.size + step))
        return np.column_stack([columns, (r - further) / step * unit])

    def fit(
        self, rival: truth.Part | None = None, unit: float = 1.0, start: Array | None = None
    ) -> Compensated:
        """Fit from tolerances moved by ``start`` standard deviations, default 0.

        ``rival``: with the magnitude from which the fit starts; ``unit``: its natural magnitude.
        """
        count, free = self.magnitudes.size, 0 if rival is None else 1
        root = np.concatenate([np.ones(count), np.zeros(free)])  # a magnitude has no prior
        p: Array = np.zeros(count) if start is None else start
        r = self.residual(p, rival)
        best = self.cost(r, p)
        same = None if rival else _same(self.part, self.library)
        if same is not None:  # the tolerance of the same value compensates the effect exactly
            moved = self.part.size / self.magnitudes[same] * np.eye(count)[same]
            other = self.residual(moved)
            if self.cost(other, moved) < best:
                p, r, best = moved, other, self.cost(other, moved)
        for renewal in range(1 + RENEWALS):
            if not renewal and rival is None and not p.any():
                columns = np.vstack([s.columns for s in self.strokes])
            else:
                columns = self.columns(p, rival, r, unit)
            before, damping = best, 0.0
            joint = np.hstack([columns, self.variability])
            prior = np.concatenate([root, np.ones(self.variability.shape[1])])
            normal = joint.T @ joint + np.diag(prior)
            for _ in range(ITERATIONS):
                z = self.clean @ (self.variability.T @ r)
                pull = columns.T @ (r - self.variability @ z)
                pull[:count] -= p
                left = np.concatenate([pull, np.zeros(z.size)])
                damped = normal + damping * np.diag(np.diag(normal))
                step = np.linalg.solve(damped, left)
                moved = p + step[:count]
                try:
                    there = rival and replace(rival, size=rival.size + unit * step[count])
                    other = self.residual(moved, there)
                    value = self.cost(other, moved) if self._allowed(there) else math.inf
                except Exception:  # these values define no valid mechanism
                    value = math.inf
                if value < best:
                    done = best - value < 1e-3 * best + 0.05
                    p, r, best, rival = moved, other, value, there
                    damping *= 0.1
                    if done:
                        break
                else:
                    damping = max(10.0 * damping, LEAST_DAMPING)
                    if damping > MOST_DAMPING:
                        break
            if before - best < 0.02 * best + 0.1:
                break
        return Compensated(best, p, rival)


def _played(case: truth.Case, name: str, shown: Stroke | None) -> Stroke | None:
    """Stroke whose force the sensor of a case shows as ``shown``; None: the commanded stroke."""
    size = {p.name: p.size for p in case.parts}
    errors = [size.get(f"input_{kind}", 0.0) for kind in ("gain", "offset", "delay")]
    if not any(errors):
        return shown
    gain, offset, delay = errors
    plain = shown or truth.command(name, replace(case, parts=()))[0]
    time = np.linspace(0.0, plain.duration, int(plain.duration * FINE) + 1)
    force = (plain.at(time + delay) - offset) / (1.0 + gain)
    return table_stroke(time.tolist(), force.tolist(), duration=plain.duration, name=name)


def _same(part: truth.Part, library: Any) -> int | None:
    """Number of the tolerance that changes the same value as a part; None: there is none."""
    if part.form != "A":
        return None
    changes = library.effect(part.name).changes
    equal = [i for i, e in enumerate(library.tolerances) if changes and e.changes == changes]
    return equal[0] if equal else None


def _diagonal(blocks: list[Array]) -> Array:
    """Blocks along the diagonal of an otherwise empty matrix."""
    out = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row, column = 0, 0
    for b in blocks:
        out[row : row + b.shape[0], column : column + b.shape[1]] = b
        row, column = row + b.shape[0], column + b.shape[1]
    return out
