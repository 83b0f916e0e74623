"""Derivatives of the outputs of a mechanism by forward sensitivities, all in one pass.

The variational equation is integrated together with the stroke (:mod:`feltmb.run.sensitivity`). The
derivative of the equations by a parameter follows from mechanisms with a shifted parameter. The
stroke starts at rest; where the rest pose depends on the parameters, the chain rule adds this
dependence. Effects with states of their own (compliant pivots, creeping felt) are left to finite
differences while their magnitude is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feltmb import _core
from feltmb.adapters.drives import FORCE, Drive, start_state
from feltmb.adapters.library import Entry
from feltmb.adapters.sampling import at_times, output_rate
from feltmb.adapters.simulator import MechanismSimulator
from feltmb.adapters.variants import Variant
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError
from feltmb.fit import Candidate

__all__ = ["OperatingPoint", "can_differentiate", "forward_sensitivities"]

#: Shift of a parameter or magnitude as a share of its scale. The errors by curvature and by
#: rounding of the rest pose are then below 1e-5 of a derivative.
SHIFT = 1e-5
#: Share of a change of the inputs by which the input is shifted. A motion enters the equations
#: through the place of the finger, which is not linear.
INPUT_SHIFT = 1e-4


@dataclass(frozen=True)
class _Version:
    """A version of the mechanism with its input."""

    variant: Variant
    drive: Drive


@dataclass(frozen=True)
class _Column:
    """One variable of differentiation: the base, and a version with a shifted variable."""

    name: str
    moved: _Version
    base: _Version
    shift: float
    scale: float

    def derivative(self, pick: Callable[[_Version], Any]) -> Array:
        """Derivative of a quantity of a version by this variable."""
        return np.asarray((np.asarray(pick(self.moved)) - pick(self.base)) / self.shift)

    def parameter(self) -> _core.SensitivityParameter:
        """The variable as the core takes it."""
        parts = ((self.moved, self.shift, 1.0 / self.shift), (self.base, 0.0, -1.0 / self.shift))
        versions = [
            _core.Perturbed(v.variant.mechanism, v.drive.input, shift, weight)
            for v, shift, weight in parts
        ]
        return _core.SensitivityParameter(self.name, versions, self.scale)


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """Place at which a record is differentiated."""

    record: Record
    """Record whose inputs drive the mechanism."""
    theta: Array
    """Parameters of the mechanism [their units], (p,)."""
    included: tuple[Candidate, ...]
    """Effects that are part of the mechanism."""
    magnitudes: Array
    """Their magnitudes [their units], (k,)."""


def can_differentiate(simulator: MechanismSimulator, record: Record, candidate: Candidate) -> bool:
    """Whether the candidate adds no states to the mechanism."""
    effect = candidate.effect
    if not isinstance(effect.data, Entry):
        return False
    theta = np.zeros(len(simulator.parameters))
    shift = np.array([_shift(0.0, effect.scale, effect.bounds[1])])
    try:
        base = simulator.version(record, theta, (), np.zeros(0))
        moved = simulator.version(record, theta, (candidate,), shift)
    except FeltmbError:
        return False
    return base.states == moved.states


def forward_sensitivities(
    simulator: MechanismSimulator,
    at: OperatingPoint,
    by_theta: Sequence[int],
    candidates: tuple[Candidate, ...] = (),
    input_changes: Sequence[Mapping[str, Array]] = (),
    *,
    tolerance: float,
) -> Array | None:
    """Derivatives of the outputs over a record.

    Parameters
    ----------
    simulator
        Simulator of the mechanism.
    at
        Where it is differentiated. Included effects with states of their own must have a magnitude
        that is not zero.
    by_theta
        Indices of parameters.
    candidates
        Further effects at magnitude zero; :func:`can_differentiate` holds for all of them.
    input_changes
        Changes of the recorded inputs, {input: (n,)} [unit of the input].
    tolerance
        Relative tolerance of a derivative [1].

    Returns
    -------
    Array or None
        (n, ny, d) by parameters, magnitudes of the included effects, magnitudes of the candidates,
        and factors of the changes, in this order. None if the integration or a shift failed.
    """
    record = at.record
    try:
        base = simulator.version(record, at.theta, at.included, at.magnitudes)
        drive = simulator.drives.of(record)
        there = _Version(base, drive)
        columns = _columns(simulator, at, by_theta, candidates, there)
        columns += _input_columns(simulator, record, input_changes, there)
        segment = _segment(simulator, columns, there)
        rest = _at_rest(simulator, columns) if drive.motion else None
    except FeltmbError:
        return None
    options = _core.SensitivityOptions()
    simulation = _core.SimulationOptions()
    simulation.rtol = simulator.rtol
    options.simulation = simulation
    options.tolerance = tolerance
    options.output_rate = output_rate(record.time - record.time[0])
    index = {name: i for i, (name, _, _) in enumerate(_core.observables(base.mechanism))}
    options.outputs = [index[o] for o in simulator.outputs]
    options.threads = simulator.workers
    parameters = [c.parameter() for c in columns]
    try:
        (result,) = _core.sensitivities(base.mechanism, drive.input, parameters, [segment], options)
    except (FeltmbError, RuntimeError, ValueError):
        return None
    if result.run.status != "done":
        return None
    gradient = np.asarray(result.gradient)[..., : len(columns)]
    if rest is None:
        rest = gradient[0] * (np.array(simulator.outputs) != FORCE)[:, None]
    return at_times(result.time, gradient, record.time - record.time[0]) - rest


def _segment(
    simulator: MechanismSimulator, columns: Sequence[_Column], base: _Version
) -> _core.SensitivitySegment:
    """The record from its start; with a motion, with the start state and its derivatives."""
    end = float(base.drive.time[-1] - base.drive.time[0])
    if not base.drive.motion:
        return _core.SensitivitySegment(0.0, end)  # the core finds the rest pose

    def start_of(v: _Version) -> Array:
        return start_state(simulator.action, v.variant, v.drive)

    state = start_of(base)
    moves = np.zeros((state.size, len(columns)))
    for c, column in enumerate(columns):
        moves[:, c] = column.derivative(start_of)
    none = np.zeros((state.size, 0))
    return _core.SensitivitySegment(0.0, end, list(state), list(base.variant.memory), none, moves)


def _at_rest(simulator: MechanismSimulator, columns: Sequence[_Column]) -> Array:
    """Derivatives (ny, d) of the outputs at rest."""
    rest = np.zeros((len(simulator.outputs), len(columns)))
    for k, column in enumerate(columns):
        rest[:, k] = column.derivative(
            lambda v: [simulator.at_rest(v.variant, o) for o in simulator.outputs]
        )
    return rest


def _shift(value: float, scale: float, upper: float) -> float:
    """Shift of a variable that stays below its upper bound."""
    return SHIFT * scale if value + SHIFT * scale <= upper else -SHIFT * scale


def _columns(
    simulator: MechanismSimulator,
    at: OperatingPoint,
    by_theta: Sequence[int],
    candidates: tuple[Candidate, ...],
    base: _Version,
) -> list[_Column]:
    """Variables with one-sided differences: their curvature error is below 1e-5 of a derivative."""
    theta, included, magnitudes = at.theta, at.included, at.magnitudes

    def column(
        name: str,
        moved: Array,
        more: tuple[Candidate, ...],
        sizes: Array,
        shift: float,
        scale: float,
    ) -> _Column:
        version = simulator.version(at.record, moved, more, sizes)
        return _Column(name, _Version(version, base.drive), base, shift, scale)

    out = []
    for i in by_theta:
        p = simulator.parameters[i]
        shift = _shift(theta[i], p.size, p.upper)
        moved = theta.copy()
        moved[i] += shift
        out.append(column(p.name, moved, included, magnitudes, shift, p.size))
    for k, candidate in enumerate((*included, *candidates)):
        known = k < len(included)
        more = included if known else (*included, candidate)
        sizes = magnitudes.copy() if known else np.append(magnitudes, 0.0)
        place = k if known else -1
        scale = candidate.effect.scale
        shift = _shift(float(sizes[place]), scale, candidate.effect.bounds[1])
        sizes[place] += shift
        out.append(column(candidate.name, theta, more, sizes, shift, scale))
    return out


def _input_columns(
    simulator: MechanismSimulator,
    record: Record,
    changes: Sequence[Mapping[str, Array]],
    base: _Version,
) -> list[_Column]:
    """Changes of the inputs as variables; a noisy motion is smoothed before and after a change."""
    out = []
    for k, change in enumerate(changes):
        added = {name: record.inputs[name] + value for name, value in change.items()}
        whole = simulator.drives.of(record.with_inputs(added)).value - base.drive.value
        near = replace(base.drive, value=base.drive.value + INPUT_SHIFT * whole)
        moved = _Version(base.variant, near)
        out.append(_Column(f"input change {k}", moved, base, INPUT_SHIFT, 1.0))
    return out
