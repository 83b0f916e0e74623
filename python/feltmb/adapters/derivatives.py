"""Derivatives of simulated records by forward sensitivities; those at the last points are cached.

The variational equation is integrated together with the stroke, by all variables in one pass
(:mod:`feltmb.run.sensitivity`). The derivative of the equations by a parameter follows from
mechanisms with a shifted parameter. The stroke starts at rest; where the rest pose depends on the
parameters, the chain rule adds this dependence. An effect with states of a law (creeping felt) is
in a pass at a tiny magnitude. For one with other states (a compliant pivot), which are stiff at
small magnitudes, a one-sided difference is used at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any, Literal

import numpy as np

from feltmb import _core
from feltmb.adapters.changes import Entry
from feltmb.adapters.simulator import (
    FORCE,
    VERSIONS,
    Drive,
    MechanismSimulator,
    Variant,
    at_times,
    key_of,
    output_rate,
    start_state,
)
from unmodeled.data import Array, Record
from unmodeled.errors import Error
from unmodeled.fit import Candidate, Sensitivity, SensitivityRequest
from unmodeled.fit.running import Latest

#: Number of points whose derivatives are cached: a score needs more derivatives at the end of a
#: fit.
POINTS = 8
#: Smallest step of the magnitude of an effect with states of its own, as a share of its scale.
EFFECT_STEP = 0.2
#: Relative tolerance of a derivative by an unknown of a fit. Before a strike, nine of ten
#: derivatives are correct to 1e-3 of their largest value.
TOLERANCE = 3e-3
#: The same for requests of rough derivatives, in half the time: nine of ten are correct to 2 to 8 %
#: rms.
ROUGH = 3e-2
#: Shift of a parameter or magnitude as a share of its scale. The errors by curvature and by
#: rounding of the rest pose are then below 1e-5 of a derivative.
SHIFT = 1e-5
#: Share of a change of the inputs by which the input is shifted. A motion enters the equations
#: through the place of the finger, which is not linear.
INPUT_SHIFT = 1e-4

#: Variable of differentiation: index of a parameter, an effect, or the hash of a change of inputs.
Variable = int | Candidate
#: States that an effect adds: none, those of laws of contacts, or others.
Added = Literal["", "law", "other"]


class Derivatives:
    """Derivatives of the outputs of a simulator.

    Parameters
    ----------
    simulator
        It simulates the mechanism.
    """

    def __init__(self, simulator: MechanismSimulator):
        self.simulator = simulator
        self.passes = 0
        """Number of integrations of derivatives so far."""
        self._points: Latest[tuple[object, ...], dict[Variable, Array]] = Latest(POINTS)
        self._states: Latest[tuple[object, ...], Added] = Latest(VERSIONS)

    def place(self, request: SensitivityRequest) -> tuple[object, ...]:
        """Key of the derivatives of a request: its record, its point, and their tolerance."""
        key = key_of(request.record, request.theta, request.included, request.sizes)
        return request.record.excitation, key, request.rough

    def of(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """Outputs (n, ny) and their derivatives, by effects at their magnitude, or else at zero.

        If the simulation fails, the outputs are NaN and the derivatives zero.

        Parameters
        ----------
        requests
            The points and the variables of differentiation.
        """
        # What is cached is found before the threads start: results do not depend on their order.
        # Requests of one call share their points, also if these are more than are kept.
        places = [self.place(request) for request in requests]
        points = {place: self._points.get(place, dict) for place in dict.fromkeys(places)}
        tasks = [(request, points[place]) for request, place in zip(requests, places, strict=True)]
        return self.simulator.in_parallel(
            lambda task: self._of(*task), tasks, lambda task: id(task[1])
        )

    def _of(self, request: SensitivityRequest, known: dict[Variable, Array]) -> Sensitivity:
        """Outputs and derivatives; ``known``: those at this point, new ones are added."""
        included, simulator = request.included, self.simulator
        every = range(len(simulator.parameters))
        parameters = [*(every if request.by_theta is None else request.by_theta)]
        effects = (*included, *request.candidates)
        changes = {_digest(change): change for change in request.input_changes}
        outputs = simulator.motion(request.record, request.theta, included, request.sizes)
        if outputs is None:
            outputs = np.full((request.record.samples, len(simulator.outputs)), np.nan)
            zero = np.zeros_like(outputs)
            known = dict.fromkeys([*parameters, *effects, *changes], zero)
        else:
            lacking = replace(
                request,
                by_theta=[i for i in parameters if i not in known],
                candidates=tuple(c for c in effects if c not in known),
                input_changes=tuple(v for key, v in changes.items() if key not in known),
            )
            self._complete(known, lacking, outputs)

        def columns(variables: Sequence[Variable]) -> Array:
            none = np.zeros((*outputs.shape, 0))
            return np.stack([known[v] for v in variables], axis=-1) if variables else none

        return Sensitivity(
            outputs=outputs,
            d_theta=columns(parameters),
            d_magnitudes=columns(included),
            d_starts=columns(()),
            d_candidates=columns(request.candidates),
            d_inputs=columns([_digest(change) for change in request.input_changes]),
        )

    def _complete(
        self, known: dict[Variable, Array], lacking: SensitivityRequest, outputs: Array
    ) -> None:
        """Add the derivatives by the variables of a request to those that are known."""
        if not (lacking.by_theta or lacking.candidates or lacking.input_changes):
            return
        fresh, included = lacking.candidates, lacking.included
        added = {c: self._added(lacking.record, c) for c in (*included, *fresh)}
        live = [k for k, c in enumerate(included) if lacking.sizes[k] != 0.0 or not added[c]]
        inside = replace(
            lacking,
            included=tuple(included[k] for k in live),
            magnitudes=lacking.sizes[live],
            candidates=tuple(c for c in fresh if c not in included and not added[c]),
        )
        known |= self._integrated(inside, outputs) | known
        inside = replace(inside, by_theta=(), candidates=(), input_changes=())
        for group in _apart([c for c in fresh if added[c] == "law" and c not in known]):
            shifts = [_shift(0.0, c.effect.scale, c.effect.bounds[1]) for c in group]
            begun = replace(
                inside,
                included=(*inside.included, *group),
                magnitudes=np.append(inside.sizes, shifts),
            )
            known |= self._integrated(begun, outputs) | known
        rest = [c for c in fresh if c not in known]
        found = self.simulator.in_parallel(lambda c: self._difference(inside, c, outputs), rest)
        known |= dict(zip(rest, found, strict=True))

    def _added(self, record: Record, candidate: Candidate) -> Added:
        """What states an effect adds, see :func:`added_states`."""
        key = (candidate, tuple(sorted(record.conditions.items())))
        return self._states.get(key, lambda: added_states(self.simulator, record, candidate))

    def _integrated(self, request: SensitivityRequest, outputs: Array) -> dict[Variable, Array]:
        """Derivatives by parameters, effects and changes of the inputs, from one pass."""
        variables: list[Variable] = [
            *(request.by_theta or ()),
            *request.included,
            *request.candidates,
            *map(_digest, request.input_changes),
        ]
        if not variables:
            return {}
        self.passes += 1
        tolerance = ROUGH if request.rough else TOLERANCE
        found = forward_sensitivities(self.simulator, request, tolerance=tolerance)
        if found is None:
            found = np.full((*outputs.shape, len(variables)), np.nan)
        return {variable: found[..., k] for k, variable in enumerate(variables)}

    def _difference(
        self, request: SensitivityRequest, candidate: Candidate, outputs: Array
    ) -> Array:
        """Derivative at zero by an effect with states of its own."""
        step = max(candidate.effect.step, EFFECT_STEP) * candidate.effect.scale
        if step > candidate.effect.bounds[1]:
            step = -step
        included = (*request.included, candidate)
        sizes = np.append(request.sizes, step)
        motion = self.simulator.motion(request.record, request.theta, included, sizes)
        return np.full_like(outputs, np.nan) if motion is None else (motion - outputs) / step


def _digest(change: Mapping[str, Array]) -> int:
    """Key of a change of inputs."""
    return hash(tuple((name, value.tobytes()) for name, value in change.items()))


# --------------------------------------------------------------------------------- one pass


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


def added_states(simulator: MechanismSimulator, record: Record, candidate: Candidate) -> Added:
    """Whether a candidate adds states to a mechanism: none, those of laws, or others."""
    effect = candidate.effect
    if not isinstance(effect.data, Entry):
        return "other"
    theta = np.zeros(len(simulator.parameters))
    shift = np.array([_shift(0.0, effect.scale, effect.bounds[1])])
    try:
        base = simulator.version(record, theta, (), np.zeros(0)).states
        moved = simulator.version(record, theta, (candidate,), shift).states
    except Error:
        return "other"
    return "" if base == moved else "law" if base[::2] == moved[::2] else "other"


def _apart(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Groups of effects of different components: no law has the states of two."""
    of: dict[str, list[Candidate]] = {}
    for c in candidates:
        of.setdefault(c.effect.component, []).append(c)
    return [[c for c in group if c is not None] for group in zip_longest(*of.values())]


def forward_sensitivities(
    simulator: MechanismSimulator, request: SensitivityRequest, *, tolerance: float
) -> Array | None:
    """Derivatives of the outputs over a record.

    Parameters
    ----------
    simulator
        Simulator of the mechanism.
    request
        Point and variables of differentiation. Included effects with states of their own must have
        a magnitude that is not zero; the candidates have none (:func:`added_states`).
    tolerance
        Relative tolerance of a derivative [1].

    Returns
    -------
    Array or None
        (n, ny, d) by parameters, magnitudes of the included effects, magnitudes of the candidates,
        and factors of the changes, in this order. None if the integration or a shift failed.
    """
    record = request.record
    try:
        base = simulator.version(record, request.theta, request.included, request.sizes)
        drive = simulator.drives.of(record)
        there = _Version(base, drive)
        columns = _columns(simulator, request, there)
        columns += _input_columns(simulator, record, request.input_changes, there)
        segment = _segment(simulator, columns, there)
        rest = _at_rest(simulator, columns) if drive.motion else None
    except Error:
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
    except (Error, RuntimeError, ValueError):
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
    simulator: MechanismSimulator, request: SensitivityRequest, base: _Version
) -> list[_Column]:
    """Variables with one-sided differences: their curvature error is below 1e-5 of a derivative."""
    theta, included, magnitudes = request.theta, request.included, request.sizes
    candidates = request.candidates

    def column(
        name: str,
        moved: Array,
        more: tuple[Candidate, ...],
        sizes: Array,
        shift: float,
        scale: float,
    ) -> _Column:
        version = simulator.version(request.record, moved, more, sizes)
        return _Column(name, _Version(version, base.drive), base, shift, scale)

    out = []
    for i in request.by_theta or ():
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
