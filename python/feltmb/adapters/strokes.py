"""Whole strokes as a model, with exact derivatives and run-to-run variability.

Every record is simulated as a whole from rest, so that a point of the fit costs one run per record.
Derivatives are integrated together with the motion, all in one pass (see
:mod:`feltmb.adapters.forward`); those at the last few points are cached. For an effect with states
of its own at magnitude zero, a one-sided difference is used.

Differences from stroke to stroke without a cause are the *run-to-run variability*: the noise of the
measured input, small changes of felt and friction, and the discretization error. Its directions are
found by differences, first at the priors and then at the fitted parameters. Directions above the
noise of the sensors become parameters of their own record with the prior N(0, 1), with a linear
influence on its outputs:

    y_r(theta, phi, z_r) = y(theta, phi) + D_r z_r,    D_r D_r' = covariance of the variability.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb.adapters.aliases import Alias
from feltmb.adapters.drives import DISPLACEMENT
from feltmb.adapters.forward import (
    OperatingPoint,
    can_differentiate,
    forward_sensitivities,
)
from feltmb.adapters.library import Entry
from feltmb.adapters.model import MechanismModel, is_law
from feltmb.adapters.refined import KINDS, refined
from feltmb.adapters.shifter import Chosen, Shifter
from feltmb.adapters.variants import Variant
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError
from feltmb.fit import (
    VARIABILITY,
    Candidate,
    Jobs,
    Parameter,
    Ready,
    Sensitivity,
    SensitivityRequest,
    Simulated,
)
from feltmb.fit.latest import Latest
from feltmb.fit.noise import sd_of_knots

__all__ = ["RunVariability", "StrokeModel"]

#: Number of points whose derivatives are cached: a score needs more derivatives at the end of a
#: fit.
POINTS = 8
#: Number of cached simulated motions.
RUNS = 64
#: Number of cached versions of the mechanism: all of one linearization.
VERSIONS = 400
#: Smallest step of the magnitude of an effect with states of its own, as a share of its scale.
EFFECT_STEP = 0.2
#: Directions of the variability with a noncentrality below this are omitted, if there are more than
#: this number: at other parameters, other directions can matter.
LEAST_VARIABILITY, FEWEST_DIRECTIONS = 0.3, 12
#: Change of parameters in prior standard deviations, and relative change of magnitudes, up to which
#: the directions of the variability are not computed again.
NEAR = 0.2
#: Distance of the knots of input noise [s]: a camera sees averages over a longer time, an encoder
#: at the finger does not (a null case of the blind bench loses 17 units of log evidence at 8 ms).
KNOTS, KNOTS_AT_FINGER = 8e-3, 4e-3


@dataclass(frozen=True, eq=False)
class RunVariability:
    """Directions of the variability of a record: (n, ny, k), each with a factor N(0, 1)."""

    record: Record
    columns: Array
    variation: float
    """Relative standard deviation of felt and friction from stroke to stroke [1]."""
    place: tuple[Array, tuple[tuple[str, float | None], ...], Array]
    """Parameters of the mechanism, included effects and their magnitudes at which they hold."""

    def covers(self, record: Record) -> bool:
        """Whether the stroke is the input of a record, or starts with it."""
        n = min(record.samples, self.record.samples)
        known = [self.record.time, *self.record.inputs.values()]
        given = [record.time, *record.inputs.values()]
        return self.record.inputs.keys() == record.inputs.keys() and all(
            np.array_equal(a[:n], b[:n]) for a, b in zip(known, given, strict=True)
        )


class StrokeModel(MechanismModel):
    """A mechanism with records simulated as a whole from rest; see :class:`MechanismModel`.

    ``variation``: relative variation of felt and friction from stroke to stroke [1], for
    :meth:`with_variability`; None: no variability. ``chaotic`` is False: records should end soon
    after the impact, while a stroke is still a smooth function of the parameters.
    """

    def __init__(self, *args: Any, variation: float | None = 0.01, **options: Any):
        super().__init__(*args, **options)
        self.variation = variation
        self.mechanical = len(self.parameters)
        self.variabilities: dict[str, RunVariability] = {}
        self._runs: Latest[tuple[object, ...], Array | None] = Latest(RUNS)
        self._points: Latest[tuple[object, ...], dict[object, Array]] = Latest(POINTS)
        self._versions: Latest[tuple[object, ...], Variant] = Latest(VERSIONS)
        self._smooth: dict[tuple[object, ...], bool] = {}
        self.passes = 0
        """Number of integrations of derivatives so far."""

    @property
    def variability_has_input_noise(self) -> bool:  # type: ignore[override]
        """Whether the records have a run-to-run variability; it contains the noise of the force."""
        return bool(self.variabilities)

    @property
    def variability_is_tabulated(self) -> bool:  # type: ignore[override]
        """Whether the variability of at least one record is that of the tabulated parameters."""
        return any(
            not included and np.array_equal(theta, self._tabulated)
            for theta, included, _ in (v.place for v in self.variabilities.values())
        )

    @property
    def _tabulated(self) -> Array:
        return np.array([p.value for p in self.parameters[: self.mechanical]])

    def forget(self) -> None:
        """See :class:`~feltmb.fit.Model`: clears the cached derivatives."""
        self._points = Latest(POINTS)

    # --- run-to-run variability -----------------------------------------------------------

    def with_variability(
        self, records: Sequence[Record], variation: float | None = None
    ) -> StrokeModel:
        """The same model with the run-to-run variability of records.

        Parameters
        ----------
        records
            All records of the diagnosis, held-out ones included.
        variation
            Relative standard deviation of felt and friction from stroke to stroke [1]; None: the
            value of the model.

        Returns
        -------
        StrokeModel
            Model with additional parameters ``variability.RECORD.K``; the model itself if its own
            variation is None as well.
        """
        variation = self.variation if variation is None else variation
        if variation is None:
            return self
        tabulated = self._tabulated
        out = copy.copy(self)
        out.variabilities = {}
        for r in records:
            columns = self._variability(r, variation, tabulated, (), np.zeros(0))
            if columns is None:
                columns = np.zeros((r.samples, len(self.outputs), 0))
            place = tabulated, (), np.zeros(0)
            out.variabilities[r.name] = RunVariability(r, columns, variation, place)
        out.parameters = self.parameters[: self.mechanical] + tuple(
            Parameter(
                name=f"variability.{r.name}.{k + 1}", value=0.0, sd=1.0, component=VARIABILITY
            )
            for r in records
            for k in range(out.variabilities[r.name].columns.shape[2])
        )
        return out

    def with_variability_at(  # noqa: D102
        self, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> StrokeModel:
        # The motion of a refined mechanism, for example, is shifted in time with the impact.
        own, names = theta[: self.mechanical], tuple((c.name, c.shape) for c in included)
        out = copy.copy(self)
        out.variabilities = dict(self.variabilities)
        for name, known in self.variabilities.items():
            if self._near(known, own, names, magnitudes):
                continue
            count = known.columns.shape[2]
            columns = self._variability(
                known.record, known.variation, own, included, magnitudes, count
            )
            if columns is not None:
                place = own.copy(), names, magnitudes.copy()
                out.variabilities[name] = replace(known, columns=columns, place=place)
        return self if out.variabilities == self.variabilities else out

    def _near(
        self,
        known: RunVariability,
        theta: Array,
        names: tuple[tuple[str, float | None], ...],
        magnitudes: Array,
    ) -> bool:
        """Whether the directions hold at these parameters too."""
        at, included, sizes = known.place
        sd = np.array([p.sd for p in self.parameters[: self.mechanical]])
        return (
            names == included
            and bool(np.all(np.abs(theta - at) <= NEAR * sd))
            and bool(np.all(np.abs(magnitudes - sizes) <= NEAR * np.abs(sizes)))
        )

    def identity(self) -> str | None:
        """See :class:`~feltmb.fit.Model`."""
        return repr((super().identity(), self.variation))

    def ready(self, records: Sequence[Record]) -> Ready:
        """Prepare records: the part until shortly after the impact, with their variability."""
        base = super().ready(records)
        if all(
            r.name in self.variabilities and self.variabilities[r.name].covers(r)
            for r in base.records
        ):
            return base
        assert isinstance(base.model, StrokeModel)
        return replace(base, model=base.model.with_variability(base.records))

    def _variability(
        self,
        record: Record,
        variation: float,
        theta: Array,
        included: tuple[Candidate, ...],
        magnitudes: Array,
        count: int | None = None,
    ) -> Array | None:
        """The largest directions of the variability, (n, ny, k); None: the simulation failed.

        ``count``: their number k; None: all that matter beside the noise of the sensors.
        """
        base = self._motion(record, theta, included, magnitudes)
        if base is None:
            return None
        which = []
        if variation > 0.0:
            which = [i for i, e in enumerate(self.tolerances) if is_law(e)]
        changes = [
            change
            for name, sigma in record.input_sigma.items()
            if sigma > 0.0 and name in record.inputs
            for change in _input_noise(record, name)
        ]
        point = _Point(record, theta, included, magnitudes, base)
        by, _, by_noise = self._slopes(point, which, (), tuple(changes))
        columns = [variation * by[..., i] for i in range(len(which))]
        columns += [by_noise[..., k] for k in range(len(changes))]
        motions = []
        chosen = self._chosen(theta, included, magnitudes)
        for kind in KINDS:
            resolved = refined(self.action, (kind,))
            if resolved is not self.action:
                motions.append(self._motion_of(Shifter(resolved.config), chosen, record))
        columns += [np.full_like(base, np.nan) if m is None else m - base for m in motions]
        if not columns:
            return np.zeros((*base.shape, 0))
        stacked = np.stack(columns, axis=-1)
        if count is not None and not np.all(np.isfinite(stacked)):
            return None
        stacked = np.nan_to_num(stacked)
        flat = (stacked / self._noise_of(record)[None, :, None]).reshape(-1, stacked.shape[2])
        values, vectors = np.linalg.eigh(flat.T @ flat)
        if count is None:
            seen = values > 1e-12 * values[-1]
            count = min(
                int(np.sum(seen)),
                max(FEWEST_DIRECTIONS, int(np.sum(values > LEAST_VARIABILITY**2))),
            )
        return np.asarray(stacked @ vectors[:, ::-1][:, :count])

    def _noise_of(self, record: Record) -> Array:
        """Noise of the outputs; infinite if there is no sensor or its noise is unknown."""
        sigma = [record.sensors[o].sigma if o in record.sensors else None for o in self.outputs]
        return np.array([math.inf if s is None or not s < math.inf else s for s in sigma])

    # --- the interface of Model -----------------------------------------------------------------

    def simulate(self, record: Record, jobs: Jobs) -> Simulated:
        """Simulate jobs; all jobs of one version use one run from rest. Variability is added."""
        outputs = np.full((jobs.count, jobs.longest, len(self.outputs)), np.nan)
        groups: dict[bytes, list[int]] = {}
        for b in range(jobs.count):
            magnitudes = jobs.magnitudes[b] if jobs.included else np.zeros(0)
            theta = jobs.theta[b, : self.mechanical]
            groups.setdefault(self._key(record, theta, jobs.included, magnitudes), []).append(b)

        def work(rows: list[int]) -> None:
            magnitudes = jobs.magnitudes[rows[0]] if jobs.included else np.zeros(0)
            theta = jobs.theta[rows[0], : self.mechanical]
            motion = self._motion(record, theta, jobs.included, magnitudes)
            if motion is None:
                return
            for b in rows:
                i, j = (int(k) for k in jobs.segments[b])
                outputs[b, : j - i + 1] = motion[i : j + 1]
                shift = self._variability_shift(record, jobs.theta[b])
                if shift is not None:
                    outputs[b, : j - i + 1] += shift[i : j + 1]

        self.in_parallel(work, list(groups.values()))
        return Simulated(outputs=outputs, ends=np.zeros((jobs.count, 0)))

    def _variability_shift(self, record: Record, theta: Array) -> Array | None:
        at = self._variability_place(record)
        if at is None or not np.any(theta[at]):
            return None
        return np.asarray(self._variability_columns(record) @ theta[at])

    def _variability_of(self, record: Record) -> RunVariability | None:
        """Variability of a record, or of the record from which it was cut."""
        return self.variabilities.get(record.name) or self.variabilities.get(
            record.name.rpartition("[")[0]
        )

    def _variability_columns(self, record: Record) -> Array:
        """Directions of the variability over the record; zero after the time of their data."""
        variability = self._variability_of(record)
        assert variability is not None
        columns = variability.columns[: record.samples]
        more = record.samples - len(columns)
        return np.pad(columns, ((0, more), (0, 0), (0, 0))) if more else columns

    def _variability_place(self, record: Record) -> slice | None:
        at, own = self.mechanical, self._variability_of(record)
        for variability in self.variabilities.values():
            width = variability.columns.shape[2]
            if variability is own:
                return slice(at, at + width)
            at += width
        return None

    def _motion(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Array | None:
        """Outputs of the mechanism over the whole record, (n, ny); None if it failed."""
        key = self._key(record, theta, included, magnitudes)
        inputs = _digest(record.inputs)

        def make() -> Array | None:
            chosen = self._chosen(theta, included, magnitudes)
            return self._motion_of(self._shifter, chosen, record)

        return self._runs.get((record.name, inputs, key), make)

    def _motion_of(self, shifter: Shifter, chosen: Chosen, record: Record) -> Array | None:
        try:
            variant = self._workshop.build(shifter.config(chosen, record.conditions))
        except FeltmbError:
            return None
        return self.whole(record, variant)

    def sensitivities(  # noqa: D102
        self, requests: Sequence[SensitivityRequest]
    ) -> list[Sensitivity]:
        # Exact derivatives, all in one pass.
        return [self._sensitivity(request) for request in requests]

    def _sensitivity(self, request: SensitivityRequest) -> Sensitivity:
        request.check(self)
        record, theta, segments = request.record, request.theta, request.segments
        included, magnitudes = request.included, request.sizes
        candidates, wanted = request.candidates, request.parameters_of(self)
        changes = request.input_changes
        own = theta[: self.mechanical]
        w, length = len(segments), int(np.max(segments[:, 1] - segments[:, 0])) + 1
        ny = len(self.outputs)
        base = self._motion(record, own, included, magnitudes)
        none = np.zeros((w, 0))
        if base is None:
            n = (len(wanted), len(included), len(candidates), len(changes))
            bad = np.full((w, length, ny), np.nan)
            blank = [np.zeros((w, length, ny, k)) for k in n]
        else:
            shift = self._variability_shift(record, theta)
            bad = _cut(base if shift is None else base + shift, segments, length)
            inner = [i for i in wanted if i < self.mechanical]
            point = _Point(record, own, included, magnitudes, base)
            found, of, by_inputs = self._slopes(point, inner, (*included, *candidates), changes)
            by = self._with_own_variability(record, found, wanted)
            columns = (by, *np.split(of, [len(included)], -1), by_inputs)
            blank = [_cut(c, segments, length) for c in columns]
        ends = [np.zeros((w, 0, c.shape[3])) for c in blank]
        return Sensitivity(
            outputs=bad,
            ends=none,
            d_theta=blank[0],
            d_theta_ends=ends[0],
            d_magnitudes=blank[1],
            d_magnitudes_ends=ends[1],
            d_starts=np.zeros((w, length, ny, 0)),
            d_starts_ends=np.zeros((w, 0, 0)),
            d_candidates=blank[2],
            d_candidates_ends=ends[2],
            d_inputs=blank[3],
            d_inputs_ends=ends[3],
        )

    # --- derivatives ------------------------------------------------------------------------------

    def version(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Variant:
        """See :class:`~feltmb.adapters.differentiable.DifferentiableMechanism`."""
        own = theta[: self.mechanical]

        def make() -> Variant:
            chosen = self._chosen(own, included, magnitudes)
            config = self._shifter.config(chosen, record.conditions)
            return self._base if config is self.action.config else self._workshop.assemble(config)

        # All records of one linearization need the same versions.
        conditions = tuple(sorted(record.conditions.items()))
        key = (self._key(record, own, included, magnitudes), conditions)
        return self._versions.get(key, make)

    def _with_own_variability(
        self, record: Record, mechanical: Array, wanted: Sequence[int]
    ) -> Array:
        """Derivatives (n, ny, p) by parameters of the mechanism and of the variability."""
        out = np.zeros((*mechanical.shape[:2], len(wanted)))
        out[..., [c for c, i in enumerate(wanted) if i < self.mechanical]] = mechanical
        place = self._variability_place(record)
        if place is not None:
            columns = self._variability_columns(record)
            for c, i in enumerate(wanted):
                if place.start <= i < place.stop:
                    out[..., c] = columns[..., i - place.start]
        return out

    def _slopes(
        self,
        point: _Point,
        wanted: Sequence[int],
        effects: tuple[Candidate, ...],
        changes: tuple[Mapping[str, Array], ...],
    ) -> tuple[Array, Array, Array]:
        """Derivatives (n, ny, .) by parameters, by effects, and by changes of the inputs.

        Effects are at their magnitude, or at zero if they are not included. If an effect changes
        the same values as a tolerance, its derivative is computed from the derivative by the
        tolerance. Two integrations would differ slightly, and the difference would look like a
        signature of the effect.
        """
        record, theta = point.record, point.theta
        included, magnitudes = point.included, point.magnitudes
        place = (
            record.name,
            _digest(record.inputs),
            self._key(record, theta, included, magnitudes),
        )
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
            known |= self._integrated(inside, lacking, beside, new_changes)
            rough = [c for c in fresh if (c.name, c.shape) not in known]

            def one(c: Candidate) -> None:
                known[c.name, c.shape] = self._difference(inside, c)

            self.in_parallel(one, rough)
        of = []
        for c, name, alias in zip(effects, names, aliases, strict=True):
            if alias is None:
                of.append(known[name])
                continue
            size = float(magnitudes[included.index(c)]) if c in included else 0.0
            of.append(alias.ratio(float(theta[alias.index]), size) * known[alias.index])
        none = np.zeros((*point.base.shape, 0))

        def columns(found: list[Array]) -> Array:
            return np.stack(found, axis=-1) if found else none

        by_changes = [known[_digest(change)] for change in changes]
        return columns([known[i] for i in wanted]), columns(of), columns(by_changes)

    def _is_smooth(self, record: Record, candidate: Candidate) -> bool:
        """Whether an effect at zero can be differentiated in the pass of the others."""
        key = (candidate.name, candidate.shape, tuple(sorted(record.conditions.items())))
        if key not in self._smooth:
            self._smooth[key] = can_differentiate(self, record, candidate)
        return self._smooth[key]

    def _alias(self, candidate: Candidate) -> Alias | None:
        entry = candidate.effect.data
        return self.alias(entry) if isinstance(entry, Entry) else None

    def _integrated(
        self,
        point: _Point,
        wanted: Sequence[int],
        candidates: tuple[Candidate, ...],
        changes: Mapping[int, Mapping[str, Array]],
    ) -> dict[object, Array]:
        """Derivatives by parameters, effects and changes of the inputs, from one pass."""
        effects = (*point.included, *candidates)
        names = [*wanted, *((c.name, c.shape) for c in effects), *changes]
        if not names:
            return {}
        self.passes += 1
        found = forward_sensitivities(self, point, wanted, candidates, tuple(changes.values()))
        if found is None:
            return {name: np.full_like(point.base, np.nan) for name in names}
        return {name: found[..., k] for k, name in enumerate(names)}

    def _difference(self, point: _Point, candidate: Candidate) -> Array:
        """Derivative at zero by an effect with states of its own."""
        step = max(candidate.effect.step, EFFECT_STEP) * candidate.effect.scale
        if step > candidate.effect.bounds[1]:
            step = -step
        more = (*point.included, candidate)
        sizes = np.append(point.magnitudes, step)
        motion = self._motion(point.record, point.theta, more, sizes)
        return np.full_like(point.base, np.nan) if motion is None else (motion - point.base) / step


@dataclass(frozen=True, eq=False)
class _Point(OperatingPoint):
    """Operating point with the outputs (n, ny) there."""

    base: Array


def _digest(inputs: Mapping[str, Array]) -> int:
    """Key of the values of some inputs."""
    return hash(tuple((name, value.tobytes()) for name, value in inputs.items()))


def _cut(whole: Array, segments: NDArray[np.intp], length: int) -> Array:
    """A record (n, ...) divided into segments, (W, L, ...); zero after the end of a segment."""
    out = np.zeros((len(segments), length, *whole.shape[1:]))
    for w, (first, last) in enumerate(segments):
        out[w, : last - first + 1] = whole[first : last + 1]
    return out


def _input_noise(record: Record, name: str) -> list[Mapping[str, Array]]:
    """Changes of an input by one standard deviation of noise, one per knot."""
    length = float(record.time[-1] - record.time[0])
    apart = KNOTS_AT_FINGER if DISPLACEMENT in record.outputs else KNOTS
    knots = np.linspace(0.0, length, max(2, math.ceil(length / apart) + 1))
    clock = record.time - record.time[0]
    hats = np.maximum(0.0, 1.0 - np.abs(clock - knots[:, None]) / knots[1])
    sd = sd_of_knots(record, name, float(knots[1]))
    return [{name: sd * hat} for hat in hats]
