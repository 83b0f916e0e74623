"""Derivatives of simulated records; those at the last few points are cached.

They are integrated together with the motion, all in one pass (see :mod:`feltmb.adapters.forward`).
For an effect with states of its own at magnitude zero, a one-sided difference is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.adapters.aliases import Alias
from feltmb.adapters.forward import OperatingPoint, can_differentiate, forward_sensitivities
from feltmb.adapters.library import Entry
from feltmb.adapters.simulator import MechanismSimulator, key_of
from feltmb.data import Array, Record
from feltmb.fit import Candidate
from feltmb.fit.latest import Latest

__all__ = ["Derivatives", "SimulatedPoint"]

#: Number of points whose derivatives are cached: a score needs more derivatives at the end of a
#: fit.
POINTS = 8
#: Smallest step of the magnitude of an effect with states of its own, as a share of its scale.
EFFECT_STEP = 0.2
#: Relative tolerance of a derivative by an unknown of a fit. Before a strike, nine of ten
#: derivatives are correct to 1e-3 of their largest value.
TOLERANCE = 3e-3
#: The same for effects that a set lacks, in half the time: nine of ten are correct to 2 to 8 % rms,
#: which their rank does not show.
ROUGH = 3e-2


@dataclass(frozen=True, eq=False)
class SimulatedPoint(OperatingPoint):
    """Operating point with the outputs (n, ny) there."""

    outputs: Array


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
        self._points: Latest[tuple[object, ...], dict[object, Array]] = Latest(POINTS)
        self._smooth: dict[tuple[object, ...], bool] = {}

    def at(
        self,
        point: SimulatedPoint,
        wanted: Sequence[int],
        effects: tuple[Candidate, ...] = (),
        changes: tuple[Mapping[str, Array], ...] = (),
    ) -> tuple[Array, Array, Array]:
        """Derivatives (n, ny, .) by parameters, by effects, and by changes of the inputs.

        Effects are at their magnitude, or at zero if they are not included. If an effect changes
        the same values as a tolerance, its derivative is computed from the derivative by the
        tolerance. Two integrations would differ slightly, and the difference would look like a
        signature of the effect.

        Parameters
        ----------
        point
            Where the record is differentiated.
        wanted
            Indices of parameters.
        effects
            Included effects and candidates.
        changes
            Changes of the recorded inputs, {input: (n,)} [unit of the input].
        """
        record, theta = point.record, point.theta
        included, magnitudes = point.included, point.magnitudes
        place = (record.excitation, key_of(record, theta, included, magnitudes))
        known = self._points.get(place, dict)
        names = [(c.name, c.shape) for c in effects]
        aliases = [self._alias(c) for c in effects]
        of_changes = {_digest(change): change for change in changes}
        needed = dict.fromkeys([*wanted, *(a.index for a in aliases if a is not None)])
        lacking = [i for i in needed if i not in known]
        fresh = tuple(
            c
            for c, name, alias in zip(effects, names, aliases, strict=True)
            if alias is None and name not in known
        )
        new_changes = {key: change for key, change in of_changes.items() if key not in known}
        if lacking or fresh or new_changes:
            live = [
                k
                for k, c in enumerate(included)
                if magnitudes[k] != 0.0 or self._is_smooth(record, c)
            ]
            inside = replace(
                point, included=tuple(included[k] for k in live), magnitudes=magnitudes[live]
            )
            beside = tuple(c for c in fresh if c not in included and self._is_smooth(record, c))
            if lacking or new_changes or any(c in included for c in fresh):
                known |= self._integrated(inside, lacking, (), new_changes, TOLERANCE)
            if beside:
                # The included effects are in this pass too, but rough: those that are known stay.
                known |= self._integrated(inside, (), beside, {}, ROUGH) | known
            rough = [c for c in fresh if (c.name, c.shape) not in known]

            def one(c: Candidate) -> None:
                known[c.name, c.shape] = self._difference(inside, c)

            self.simulator.in_parallel(one, rough)
        of = []
        for c, name, alias in zip(effects, names, aliases, strict=True):
            if alias is None:
                of.append(known[name])
                continue
            size = float(magnitudes[included.index(c)]) if c in included else 0.0
            of.append(alias.ratio(float(theta[alias.index]), size) * known[alias.index])
        none = np.zeros((*point.outputs.shape, 0))

        def columns(found: list[Array]) -> Array:
            return np.stack(found, axis=-1) if found else none

        by_changes = [known[_digest(change)] for change in changes]
        return columns([known[i] for i in wanted]), columns(of), columns(by_changes)

    def _is_smooth(self, record: Record, candidate: Candidate) -> bool:
        """Whether an effect at zero can be differentiated in the pass of the others."""
        key = (candidate.name, candidate.shape, tuple(sorted(record.conditions.items())))
        if key not in self._smooth:
            self._smooth[key] = can_differentiate(self.simulator, record, candidate)
        return self._smooth[key]

    def _alias(self, candidate: Candidate) -> Alias | None:
        entry = candidate.effect.data
        return self.simulator.alias(entry) if isinstance(entry, Entry) else None

    def _integrated(
        self,
        point: SimulatedPoint,
        wanted: Sequence[int],
        candidates: tuple[Candidate, ...],
        changes: Mapping[int, Mapping[str, Array]],
        tolerance: float,
    ) -> dict[object, Array]:
        """Derivatives by parameters, effects and changes of the inputs, from one pass."""
        effects = (*point.included, *candidates)
        names = [*wanted, *((c.name, c.shape) for c in effects), *changes]
        if not names:
            return {}
        self.passes += 1
        found = forward_sensitivities(
            self.simulator,
            point,
            wanted,
            candidates,
            tuple(changes.values()),
            tolerance=tolerance,
        )
        if found is None:
            return {name: np.full_like(point.outputs, np.nan) for name in names}
        return {name: found[..., k] for k, name in enumerate(names)}

    def _difference(self, point: SimulatedPoint, candidate: Candidate) -> Array:
        """Derivative at zero by an effect with states of its own."""
        step = max(candidate.effect.step, EFFECT_STEP) * candidate.effect.scale
        if step > candidate.effect.bounds[1]:
            step = -step
        more = (*point.included, candidate)
        sizes = np.append(point.magnitudes, step)
        motion = self.simulator.motion(point.record, point.theta, more, sizes)
        base = point.outputs
        return np.full_like(base, np.nan) if motion is None else (motion - base) / step


def _digest(change: Mapping[str, Array]) -> int:
    """Key of a change of inputs."""
    return hash(tuple((name, value.tobytes()) for name, value in change.items()))
