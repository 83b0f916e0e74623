"""Whole strokes as a model: single shooting with kept derivatives and a floor.

Every record is simulated in one go from rest, so that a point of the fit costs one run a record.
Derivatives are one-sided differences, a column each, and a column is kept as long as the motion has
not left the one it was taken at by more than ``TRAVEL``: a chord method whose radius is what a
camera sees, wider for a column that hardly stands out of the noise, because its error stands out
even less. Values are always simulated anew.

What differs from stroke to stroke without being a cause is the *floor*: the noise of the measured
input, small changes of felt and friction, and what a finer model would move. Its directions are
found by differences at the packaged mechanism, those that stand out of the sensors' noise become
parameters of their own record with the prior N(0, 1), and act linearly on its outputs:

    y_r(theta, phi, z_r) = y(theta, phi) + D_r z_r,    D_r D_r' = covariance of the floor.
"""

from __future__ import annotations

import copy
import fnmatch
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb.adapters.aliases import Alias
from feltmb.adapters.finer import KINDS, finer
from feltmb.adapters.latest import Latest
from feltmb.adapters.library import Entry
from feltmb.adapters.model import MechanismModel
from feltmb.adapters.shifter import Shifter
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError
from feltmb.fit import FLOOR, Lanes, Parameter, Ready, Sensitivity, Simulated, Term

__all__ = ["Floor", "StrokeModel"]

#: Motion away from where a column was taken up to which it is kept [m], for a column with the
#: noncentrality ``CLEAR`` over its natural size; in inverse proportion for others, from ``LEAST``
#: to ``MOST`` times as far. Columns that are kept too long stop a fit far from its minimum.
TRAVEL, CLEAR, LEAST, MOST = 2e-5, 20.0, 0.5, 10.0
#: The same with effects in the fit, and from score to score.
TRAVEL_LATER, TRAVEL_SCORES = 5e-5, 1.5e-3
#: Columns of one number that are kept: fits with and without an effect come back.
KEPT = 8
#: Simulated motions that are kept.
RUNS = 64
#: Step of a parameter as a share of its natural size: over a tenth of it an integrator at 1e-5
#: would be heard.
STEP = 0.25
#: The same of the size of an effect, at least.
EFFECT_STEP = 0.2
#: Directions of the floor whose noncentrality is below this are left out.
LEAST_FLOOR = 0.3
#: Stretch of input noise between knots [s]: an action averages over more than that.
KNOTS = 8e-3
#: What changes from stroke to stroke.
VARYING = ("felt.*", "joint_friction.*", "contact_friction.*")


@dataclass(frozen=True)
class Floor:
    """Directions in which a record may depart without a cause: (n, ny, k), each N(0, 1)."""

    record: Record
    columns: Array

    def covers(self, record: Record) -> bool:
        """Whether it is that of a record, or of a part of it from its beginning."""
        n = min(record.samples, self.record.samples)
        known = [self.record.time, *self.record.inputs.values()]
        given = [record.time, *record.inputs.values()]
        return self.record.inputs.keys() == record.inputs.keys() and all(
            np.array_equal(a[:n], b[:n]) for a, b in zip(known, given, strict=True)
        )


@dataclass(frozen=True)
class _Column:
    """A derivative (n, ny) and the motion at which it was taken."""

    motion: Array
    value: Array
    patience: float
    """Multiple of the travel up to which it is kept."""


@dataclass(frozen=True)
class _Scored:
    """Columns of a record that were all taken at one motion."""

    motion: Array
    parameters: dict[int, Array]
    candidates: dict[tuple[str, Any], Array]


class StrokeModel(MechanismModel):
    """A mechanism whose records are simulated in one go from rest; see :class:`MechanismModel`.

    ``variation``: of felt and friction from stroke to stroke [1], for :meth:`with_floor`; None: no
    floor. ``chaotic`` is False: records should end soon after the blow, while a stroke is still a
    smooth function of the parameters.
    """

    def __init__(self, *args: Any, variation: float | None = 0.01, **options: Any):
        super().__init__(*args, **{**options, "shooting": "single"})
        self.variation = variation
        self.mechanical = len(self.parameters)
        self.floors: dict[str, Floor] = {}
        self._runs: Latest[tuple[object, ...], Array | None] = Latest(RUNS)
        self._shifter = Shifter(self.action.config)
        self._scored_at: dict[str, _Scored] = {}
        self._columns_kept: dict[tuple[object, ...], deque[_Column]] = {}
        self._displacements = [o != "finger.force" for o in self.outputs]
        self.computed = 0
        """Columns taken by differences so far."""

    def forget(self) -> None:
        """See :class:`~feltmb.fit.Model`: the columns that are kept."""
        super().forget()
        self._columns_kept.clear()
        self._scored_at.clear()

    # --- the floor --------------------------------------------------------------------------------

    def with_floor(self, records: Sequence[Record], variation: float | None = None) -> StrokeModel:
        """The same model with the floor of records.

        Parameters
        ----------
        records
            All records of the diagnosis, those that are held out as well.
        variation
            Standard deviation of felt and friction from stroke to stroke, as a share [1]; None:
            that of the model.

        Returns
        -------
        StrokeModel
            With further parameters ``floor.RECORD.K``; self if its own variation is None as well.
        """
        variation = self.variation if variation is None else variation
        if variation is None:
            return self
        out = copy.copy(self)
        out.floors = {r.name: Floor(r, self._floor(r, variation)) for r in records}
        out.parameters = self.parameters[: self.mechanical] + tuple(
            Parameter(name=f"floor.{r.name}.{k + 1}", value=0.0, sd=1.0, component=FLOOR)
            for r in records
            for k in range(out.floors[r.name].columns.shape[2])
        )
        return out

    def ready(self, records: Sequence[Record]) -> Ready:
        """Records up to shortly after the blow, with their floor where they have none."""
        base = super().ready(records)
        if all(r.name in self.floors and self.floors[r.name].covers(r) for r in base.records):
            return base
        return replace(base, model=self.with_floor(base.records))

    def _floor(self, record: Record, variation: float) -> Array:
        """Directions that stand out of the sensors' noise, (n, ny, k)."""
        base = self._motion(record, np.zeros(self.mechanical), (), np.zeros(0))
        empty = np.zeros((record.samples, len(self.outputs), 0))
        if base is None:
            return empty
        columns = []
        if variation > 0.0:
            names = [e.name for e in self.tolerances]
            which = [
                i
                for i, (name, e) in enumerate(zip(names, self.tolerances, strict=True))
                if e.unit == "1" and any(fnmatch.fnmatch(name, v) for v in VARYING)
            ]
            theta = np.zeros(self.mechanical)
            found = self._theta_columns(record, base, theta, (), np.zeros(0), which, TRAVEL)
            columns += [variation * found[..., i] for i in range(len(which))]
        for name, sigma in record.input_sigma.items():
            if sigma > 0.0 and name in record.inputs:
                columns += self._input_columns(record, base, name, sigma)
        for kind in KINDS:
            resolved = finer(self.action, (kind,))
            if resolved is not self.action:
                motion = self.whole(record, self._workshop.build(resolved.config))
                if motion is not None:
                    columns.append(motion - base)
        if not columns:
            return empty
        stacked = np.nan_to_num(np.stack(columns, axis=-1))
        flat = (stacked / self._noise_of(record)[None, :, None]).reshape(-1, stacked.shape[2])
        values, vectors = np.linalg.eigh(flat.T @ flat)
        keep = np.flatnonzero(values > LEAST_FLOOR**2)[::-1]
        return np.asarray(stacked @ vectors[:, keep])

    def _noise_of(self, record: Record) -> Array:
        """Noise of the outputs; infinite where there is no sensor, or nothing is known of it."""
        sigma = [record.sensors[o].sigma if o in record.sensors else None for o in self.outputs]
        return np.array([math.inf if s is None or not s < math.inf else s for s in sigma])

    def _input_columns(self, record: Record, base: Array, name: str, sigma: float) -> list[Array]:
        """Motion by the noise of an input: hats whose integral varies as that of the noise."""
        length = float(record.time[-1] - record.time[0])
        count = max(2, math.ceil(length / KNOTS) + 1)
        knots = np.linspace(0.0, length, count)
        tau = record.input_correlation_time.get(name, 0.0)
        sd = sigma * math.sqrt((record.interval + 2.0 * tau) / max(knots[1], record.interval))
        clock = record.time - record.time[0]
        theta = np.zeros(self.mechanical)

        def one(k: int) -> Array:
            hat = np.maximum(0.0, 1.0 - np.abs(clock - knots[k]) / knots[1])
            moved = record.with_inputs({name: record.inputs[name] + sd * hat})
            motion = self._motion(moved, theta, (), np.zeros(0))
            return np.zeros_like(base) if motion is None else motion - base

        return [one(k) for k in range(count)]

    # --- the interface of Model -----------------------------------------------------------------

    def simulate(self, record: Record, lanes: Lanes) -> Simulated:
        """Lanes of one version share one run from rest; the floor is added."""
        outputs = np.full((lanes.count, lanes.longest, len(self.outputs)), np.nan)
        groups: dict[bytes, list[int]] = {}
        for b in range(lanes.count):
            sizes = lanes.sizes[b] if lanes.terms else np.zeros(0)
            theta = lanes.theta[b, : self.mechanical]
            groups.setdefault(self._key(record, theta, lanes.terms, sizes), []).append(b)

        def work(rows: list[int]) -> None:
            sizes = lanes.sizes[rows[0]] if lanes.terms else np.zeros(0)
            theta = lanes.theta[rows[0], : self.mechanical]
            motion = self._motion(record, theta, lanes.terms, sizes)
            if motion is None:
                return
            for b in rows:
                i, j = (int(k) for k in lanes.windows[b])
                outputs[b, : j - i + 1] = motion[i : j + 1]
                shift = self._floor_shift(record, lanes.theta[b])
                if shift is not None:
                    outputs[b, : j - i + 1] += shift[i : j + 1]

        self.in_parallel(work, list(groups.values()))
        return Simulated(outputs=outputs, ends=np.zeros((lanes.count, 0)))

    def _floor_shift(self, record: Record, theta: Array) -> Array | None:
        at = self._floor_place(record)
        if at is None or not np.any(theta[at]):
            return None
        return np.asarray(self._floor_columns(record) @ theta[at])

    def _floor_of(self, record: Record) -> Floor | None:
        """The floor of a record, or of the one that it is a part of."""
        return self.floors.get(record.name) or self.floors.get(record.name.rpartition("[")[0])

    def _floor_columns(self, record: Record) -> Array:
        """Its directions over the record; none are known beyond its end."""
        floor = self._floor_of(record)
        assert floor is not None
        columns = floor.columns[: record.samples]
        more = record.samples - len(columns)
        return np.pad(columns, ((0, more), (0, 0), (0, 0))) if more else columns

    def _floor_place(self, record: Record) -> slice | None:
        at, own = self.mechanical, self._floor_of(record)
        for floor in self.floors.values():
            width = floor.columns.shape[2]
            if floor is own:
                return slice(at, at + width)
            at += width
        return None

    def _motion(
        self, record: Record, theta: Array, terms: tuple[Term, ...], sizes: Array
    ) -> Array | None:
        """Outputs of the mechanism over the whole record, (n, ny); None if it failed."""
        key = self._key(record, theta, terms, sizes)
        inputs = hash(tuple(v.tobytes() for v in record.inputs.values()))

        def make() -> Array | None:
            try:
                config = self._shifter.config(self._chosen(theta, terms, sizes), record.conditions)
                variant = self._workshop.build(config)
            except FeltmbError:
                return None
            return self.whole(record, variant)

        return self._runs.get((record.name, inputs, key), make)

    def sensitivities(
        self,
        record: Record,
        theta: Array,
        windows: NDArray[np.intp],
        starts: Array,
        terms: tuple[Term, ...] = (),
        sizes: Array | None = None,
        *,
        by_theta: Sequence[int] | None = None,
        by_starts: bool = True,
        candidates: tuple[Term, ...] = (),
    ) -> Sensitivity:
        """Derivatives, each column kept while the motion stays near the one it was taken at."""
        del starts, by_starts
        theta = np.asarray(theta, dtype=float)
        sizes = np.zeros(len(terms)) if sizes is None else np.asarray(sizes, dtype=float)
        wanted = tuple(range(len(self.parameters)) if by_theta is None else by_theta)
        own = theta[: self.mechanical]
        w, length = len(windows), int(np.max(windows[:, 1] - windows[:, 0])) + 1
        ny = len(self.outputs)
        base = self._motion(record, own, terms, sizes)
        none = np.zeros((w, 0))
        if base is None:
            n = (len(wanted), len(terms), len(candidates))
            bad = np.full((w, length, ny), np.nan)
            blank = [np.zeros((w, length, ny, k)) for k in n]
            ends = [np.zeros((w, 0, k)) for k in n]
        else:
            shift = self._floor_shift(record, theta)
            bad = _cut(base if shift is None else base + shift, windows, length)
            later = TRAVEL_LATER if terms else TRAVEL
            of = self._effect_columns(record, base, own, terms, sizes, terms, later)
            if candidates:
                by, at = self._scored(record, base, own, terms, sizes, wanted, candidates)
            else:
                by = self._by_parameters(record, base, own, terms, sizes, wanted, later)
                at = np.zeros((*base.shape, 0))
            blank = [_cut(c, windows, length) for c in (by, of, at)]
            ends = [np.zeros((w, 0, c.shape[3])) for c in blank]
        return Sensitivity(
            outputs=bad,
            ends=none,
            d_theta=blank[0],
            d_theta_ends=ends[0],
            d_sizes=blank[1],
            d_sizes_ends=ends[1],
            d_starts=np.zeros((w, length, ny, 0)),
            d_starts_ends=np.zeros((w, 0, 0)),
            d_candidates=blank[2],
            d_candidates_ends=ends[2],
        )

    # --- columns ----------------------------------------------------------------------------------

    def _scored(
        self,
        record: Record,
        base: Array,
        theta: Array,
        terms: tuple[Term, ...],
        sizes: Array,
        wanted: Sequence[int],
        candidates: tuple[Term, ...],
    ) -> tuple[Array, Array]:
        """Columns by parameters and by candidates, all taken at one motion.

        A score compares what a candidate does with what the parameters can do: columns of two
        motions would differ by what looks like a cause.
        """
        scored = self._scored_at.get(record.name)
        if scored is None or self._away(record, scored.motion, base) > TRAVEL_SCORES:
            scored = _Scored(base, {}, {})
            self._scored_at[record.name] = scored
        travel = 0.0 if not scored.parameters else TRAVEL_SCORES
        missing = [i for i in wanted if i not in scored.parameters]
        found = self._by_parameters(record, base, theta, terms, sizes, missing, travel)
        scored.parameters.update({i: found[..., k] for k, i in enumerate(missing)})
        fresh = [c for c in candidates if (c.name, c.shape) not in scored.candidates]
        own = tuple(c for c in fresh if self._alias(c) is None)
        columns = self._effect_columns(record, base, theta, terms, sizes, own, 0.0)
        scored.candidates.update({(c.name, c.shape): columns[..., k] for k, c in enumerate(own)})
        for c in fresh:
            alias = self._alias(c)
            if alias is not None and alias.index in scored.parameters:
                column = scored.parameters[alias.index]
                ratio = alias.ratio(float(theta[alias.index]), 0.0)
                scored.candidates[c.name, c.shape] = ratio * column
            elif alias is not None:
                lone = self._effect_columns(record, base, theta, terms, sizes, (c,), 0.0)
                scored.candidates[c.name, c.shape] = lone[..., 0]
        by = [scored.parameters[i] for i in wanted]
        at = [scored.candidates[c.name, c.shape] for c in candidates]
        empty = np.zeros((*base.shape, 0))
        return (
            np.stack(by, axis=-1) if by else empty,
            np.stack(at, axis=-1) if at else empty,
        )

    def _away(self, record: Record, motion: Array, base: Array) -> float:
        """Largest distance between two motions as long as something is measured [m]."""
        if motion.shape != base.shape:
            return math.inf
        seen = np.flatnonzero(np.any([np.isfinite(v) for v in record.outputs.values()], axis=0))
        away = np.abs(motion - base)[: seen[-1] + 1 if seen.size else None, self._displacements]
        return float(np.max(away)) if away.size else 0.0

    def _by_parameters(
        self,
        record: Record,
        base: Array,
        theta: Array,
        terms: tuple[Term, ...],
        sizes: Array,
        wanted: Sequence[int],
        travel: float,
    ) -> Array:
        """Columns (n, ny, p) by parameters of the mechanism and of the floor."""
        out = np.zeros((*base.shape, len(wanted)))
        inner = [c for c, i in enumerate(wanted) if i < self.mechanical]
        which = [wanted[c] for c in inner]
        out[..., inner] = self._theta_columns(record, base, theta, terms, sizes, which, travel)
        place = self._floor_place(record)
        if place is not None:
            columns = self._floor_columns(record)
            for c, i in enumerate(wanted):
                if place.start <= i < place.stop:
                    out[..., c] = columns[..., i - place.start]
        return out

    def _theta_columns(
        self,
        record: Record,
        base: Array,
        theta: Array,
        terms: tuple[Term, ...],
        sizes: Array,
        which: Sequence[int],
        travel: float,
    ) -> Array:
        out = np.zeros((*base.shape, len(which)))

        def one(c: int) -> None:
            i = which[c]
            p = self.parameters[i]

            def take() -> Array:
                h = STEP * p.size
                step = h if theta[i] + h <= p.upper or theta[i] - h < p.lower else -h
                moved = theta.copy()
                moved[i] += step
                motion = self._motion(record, moved, terms, sizes)
                return np.full_like(base, np.nan) if motion is None else (motion - base) / step

            key = (record.name, "parameter", i)
            out[..., c] = self._kept(key, record, base, travel, p.size, take)

        self.in_parallel(one, range(len(which)))
        return out

    def _effect_columns(
        self,
        record: Record,
        base: Array,
        theta: Array,
        terms: tuple[Term, ...],
        sizes: Array,
        wanted: tuple[Term, ...],
        travel: float,
    ) -> Array:
        """Columns by sizes of effects: at the size that they have, at zero if they are new.

        That of an effect that is more of a tolerance is the column of the tolerance.
        """
        out = np.zeros((*base.shape, len(wanted)))
        aliases = [self._alias(t) for t in wanted]
        which = sorted({a.index for a in aliases if a is not None})
        found = self._theta_columns(record, base, theta, terms, sizes, which, travel)
        for c, (term, alias) in enumerate(zip(wanted, aliases, strict=True)):
            if alias is not None:
                size = float(sizes[terms.index(term)]) if term in terms else 0.0
                ratio = alias.ratio(float(theta[alias.index]), size)
                out[..., c] = ratio * found[..., which.index(alias.index)]

        def one(c: int) -> None:
            term = wanted[c]
            step = max(term.effect.step, EFFECT_STEP) * term.effect.scale
            known = term in terms
            at = float(sizes[terms.index(term)]) if known else 0.0
            low, high = term.effect.bounds
            if at + step > high and at - step >= low:
                step = -step

            def take() -> Array:
                more = terms if known else (*terms, term)
                moved = sizes.copy() if known else np.append(sizes, step)
                if known:
                    moved[terms.index(term)] += step
                motion = self._motion(record, theta, more, moved)
                return np.full_like(base, np.nan) if motion is None else (motion - base) / step

            key = (record.name, "effect", term.name, term.shape)
            out[..., c] = self._kept(key, record, base, travel, term.effect.scale, take)

        self.in_parallel(one, [c for c, a in enumerate(aliases) if a is None])
        return out

    def _alias(self, term: Term) -> Alias | None:
        entry = term.effect.data
        return self.alias(entry) if isinstance(entry, Entry) else None

    def _kept(
        self,
        key: tuple[object, ...],
        record: Record,
        base: Array,
        travel: float,
        size: float,
        take: Callable[[], Array],
    ) -> Array:
        known = self._columns_kept.setdefault(key, deque(maxlen=KEPT))
        away = [self._away(record, c.motion, base) / c.patience for c in known]
        if away and min(away) <= travel:
            return known[int(np.argmin(away))].value
        value = take()
        self.computed += 1
        if not np.all(np.isfinite(value)):
            return value  # a run that failed is not remembered
        seen = float(np.linalg.norm(value / self._noise_of(record)))
        patience = min(max(LEAST, CLEAR / max(size * seen, 1e-3)), MOST)
        known.append(_Column(base, value, patience))
        return value


def _cut(whole: Array, windows: NDArray[np.intp], length: int) -> Array:
    """A record (n, ...) by windows, (W, L, ...); beyond the end of a window: zero."""
    out = np.zeros((len(windows), length, *whole.shape[1:]))
    for w, (first, last) in enumerate(windows):
        out[w, : last - first + 1] = whole[first : last + 1]
    return out
