"""A diagnosis as a problem: model, causes that it may lack, records, and the noise of sensors.

All values are immutable. Unknowns are counted in their prior scales: parameters in standard
deviations, magnitudes in expected magnitudes. Unknowns that are common to all records are *global*;
start states, errors of sensors, and noise of inputs are *local* to their record.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.data import Array, Record
from unmodeled.models.model import Candidate, Effect, Model
from unmodeled.models.subject import EVERYWHERE, Scope, Subject, SubjectKind

#: Expected deviation of a parameter outside its tolerance, in standard deviations of its prior.
RELEASED = 5.0
#: Scales of a start state that is not known: as good as any value.
UNKNOWN_START = 1e3
#: Deviation of a parameter that keeps its tabulated value, in standard deviations of its prior.
NARROW = 0.1
#: Share of the motion below which nothing is compared: a simulation is not more exact.
SIMULATED = 0.01
#: Number of samples as which a discrepancy counts for a name, and for the search: it also collects
#: sets that predict better without being surely the cause.
STRICT, TRUSTED = 20.0, 60.0


@dataclass(frozen=True)
class Local:
    """One unknown of a single record."""

    kind: str
    """"start", "mode", "own" or a fault of a sensor (:mod:`unmodeled.chain`)."""
    index: int
    """Index of the state, of the mode, of the cause with an own size, or of the (first) channel."""
    mean: float
    """Prior mean [unit of the unknown]."""
    scale: float
    """Unit in which it is counted [unit of the unknown]."""
    weight: float = 1.0
    """Square of the scale over the standard deviation of the prior [1]."""
    channels: tuple[int, ...] = ()
    """Channels of a sensor with this error, as those with one clock."""

    @property
    def unknown(self) -> bool:
        """Whether it is a start state that is not known."""
        return self.kind == "start" and self.weight < 1e-4


@dataclass(frozen=True)
class Cause:
    """Something that the model may lack.

    It is an effect, a parameter outside its tolerance, or an unknown of each record.
    """

    name: str
    component: str
    effect: Effect | None = None
    parameter: int | None = None
    """Index of the parameter in ``model.parameters``."""
    local: Local | None = None
    """Unknown that each record has: an error of a sensor that differs from record to record."""
    log_odds: float = 0.0
    """Log of the prior odds that it exists."""
    alias: Effect | None = None
    """Effect that changes the same number as the parameter, and whose name the cause has."""
    channel: str = ""
    """Channel of the error of each record."""
    shares: tuple[float, ...] = ()
    """Share of its size that acts in each measured record; (): all of it in all."""
    scope: Scope = EVERYWHERE
    """The same by name."""
    family: int = -1
    """Index of the cause of all records with the same law; -1: it is this one."""

    @property
    def records(self) -> frozenset[int]:
        """Numbers of the measured records in which it acts; none: in all."""
        return frozenset(k for k, share in enumerate(self.shares) if share)

    def acts_in(self, observed: Observed | None) -> float:
        """Share of its size that acts in a record; None: in one where everything acts."""
        if not self.shares or observed is None:
            return 1.0
        return self.shares[observed.number] if observed.number >= 0 else 0.0

    @cached_property
    def common(self) -> float:
        """Scale of what it is in all records [its unit]; 0: a parameter that each has by itself.

        The parameter is itself what its values have in common.
        """
        if self.effect is None or (self.local is not None and self.effect.moves is not None):
            return 0.0
        return self.effect.scale

    @property
    def subject(self) -> Subject:
        """What it is about."""
        if (words := self.effect or self.alias) is not None:
            return replace(words.about, scope=self.scope) if self.family >= 0 else words.about
        if self.local is None:
            return Subject("parameter", component=self.component)
        kind: SubjectKind = "sensor" if self.channel else "clock"
        return Subject(kind, self.local.kind, self.channel, self.component, scope=Scope(each=True))

    @property
    def of_parameter(self) -> bool:
        """Whether it is a parameter, in all records or in some."""
        return self.parameter is not None or (
            self.effect is not None and self.effect.moves is not None
        )

    @property
    def of_records(self) -> bool:
        """Whether it is an error of the records: of a sensor or of a recorded input."""
        if self.effect is None:
            return self.local is not None
        return self.effect.kind in ("sensor", "input")

    @property
    def bounds(self) -> tuple[float, float]:
        """Limits of the magnitude in expected magnitudes [1]."""
        if self.effect is None:
            return -math.inf, math.inf
        low, high = self.effect.bounds
        return low / self.effect.scale, high / self.effect.scale

    @property
    def one_sided(self) -> bool:
        """Whether the magnitude has one sign only."""
        return 0.0 in self.bounds


@dataclass(frozen=True)
class Member:
    """A cause as a member of a set, with the shape from which its fit starts."""

    cause: int
    """Index in ``problem.causes``."""
    shape: Any = None


#: A set of causes, in the order of ``problem.causes``.
Members = tuple[Member, ...]


@dataclass(frozen=True, eq=False)
class Observed:
    """A record, prepared for a comparison with the outputs of the model."""

    record: Record
    measured: Array
    """Measured values by channel of the problem, (n, m); 0 where ``valid`` is False."""
    valid: NDArray[np.bool_]
    """(n, m)"""
    sd: Array
    """Standard deviation of the noise of the sensors [units of the channels], (n, m)."""
    local: tuple[Local, ...] = ()
    """Unknowns of the record, besides the hidden states of included effects."""
    modes: Array | None = None
    """Outputs by the noise of inputs and by variation from record to record: one pattern for each
    standard normal coefficient [units of the channels], (n, m, q)."""
    after: int = 0
    """Number of samples after the end of the record (``unmodeled.search.records.AFTER``)."""
    number: int = -1
    """Index of the measured record of which it is a part."""

    @property
    def end(self) -> int:
        """Number of samples of the measured record."""
        return self.record.samples - self.after

    @property
    def as_measured(self) -> Record:
        """The record without the samples after its end."""
        return self.record.cut(0, self.end)

    def first(self, share: float) -> Observed:
        """The first share of the record; at least ten samples."""
        time = self.record.time
        count = max(int((time - time[0] <= share * (time[-1] - time[0])).sum()), 10)
        if count >= self.record.samples:
            return self
        return replace(
            self,
            record=self.record.cut(0, count),
            measured=self.measured[:count],
            valid=self.valid[:count],
            sd=self.sd[:count],
            modes=None if self.modes is None else self.modes[:count],
            after=max(0, count - self.end),
        )

    @cached_property
    def samples(self) -> Array:
        """Number of measured values by channel, (m,)."""
        return np.asarray(self.valid.sum(axis=0), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Problem:
    """Model, causes, and records."""

    model: Model
    causes: tuple[Cause, ...]
    fit: tuple[Observed, ...]
    held_out: tuple[Observed, ...]
    channels: tuple[int, ...]
    """Outputs of the model that a record shows, as indices in ``model.outputs``."""
    noise_estimated: bool = False
    """Whether the noise of all sensors is estimated, because no record states it."""
    notes: tuple[str, ...] = ()
    """Assumptions about the records, for the report."""
    discrepancy_samples: float = TRUSTED
    """Number of samples as which a discrepancy of the model counts, in all channels together,
    besides those that the unknown starts take up [1]."""
    narrow: frozenset[int] = frozenset()
    """Parameters that keep their tabulated values, as indices of the free ones."""

    @cached_property
    def discrepancy_samples_with_starts(self) -> float:
        """``discrepancy_samples``, and one sample for each start state that is not known [1]."""
        return self.discrepancy_samples + sum(q.unknown for o in self.fit for q in o.local)

    @cached_property
    def locals_known(
        self,
    ) -> dict[tuple[tuple[int, ...], int], tuple[Observed, tuple[Local, ...]]]:
        """Unknowns of records in sets; the records are kept so that their ids stay theirs."""
        return {}

    @cached_property
    def free(self) -> list[int]:
        """Indices of the parameters that are fitted."""
        return [i for i, p in enumerate(self.model.parameters) if p.sd > 0.0]

    @cached_property
    def tabulated(self) -> Array:
        """Values of all parameters [their units], (p,)."""
        return np.array([p.value for p in self.model.parameters], dtype=np.float64)

    @cached_property
    def unit(self) -> Array:
        """Units in which the free parameters are counted [their units]."""
        return np.array([self.model.parameters[i].size for i in self.free], dtype=np.float64)

    @cached_property
    def prior(self) -> Array:
        """Weights of the priors of the free parameters [1]: 1, nearly 0 without a prior."""
        sd = np.array([self.model.parameters[i].sd for i in self.free], dtype=np.float64)
        known = np.where(np.isfinite(sd), sd, UNKNOWN_START * self.unit)
        known[list(self.narrow)] *= NARROW
        return np.asarray((self.unit / known) ** 2)

    @cached_property
    def parameter_bounds(self) -> tuple[Array, Array]:
        """Lower and upper limits of the free parameters, in their units of counting."""
        own = [self.model.parameters[i] for i in self.free]
        at, unit = self.tabulated[self.free], self.unit
        low = (np.array([p.lower for p in own]) - at) / unit
        high = (np.array([p.upper for p in own]) - at) / unit
        return low, high

    @cached_property
    def samples(self) -> Array:
        """Number of measured values of the fitted records by channel, (m,)."""
        return np.asarray(sum(o.samples for o in self.fit))

    @cached_property
    def motion(self) -> Array:
        """Rms of each channel about its mean in the fitted records [its unit], (m,)."""
        return spread(self.fit)

    @cached_property
    def compared(self) -> Array:
        """Rms of what a residual of each channel is compared with [its unit], (m,).

        It is the motion, or input minus output where a controller leads the output to an input.
        """
        out = self.motion.copy()
        for c, name in enumerate(self.names):
            goal = self.model.follows.get(name)
            if goal is None or not all(goal in o.record.inputs for o in self.fit):
                continue
            gaps = [o.record.inputs[goal] - o.measured[:, c] for o in self.fit]
            known = np.concatenate([g[o.valid[:, c]] for g, o in zip(gaps, self.fit, strict=True)])
            if known.size:
                out[c] = min(out[c], float(np.sqrt(np.mean(known**2))))
        return np.asarray(np.maximum(out, SIMULATED * self.motion))

    @cached_property
    def noise(self) -> Array:
        """Rms of the noise of the sensors in the fitted records [units of the channels], (m,)."""
        total = sum((np.where(o.valid, o.sd, 0.0) ** 2).sum(axis=0) for o in self.fit)
        return np.asarray(np.sqrt(total / np.maximum(self.samples, 1.0)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(self.model.outputs[c] for c in self.channels)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the channels."""
        sensors = {n: s for o in self.fit for n, s in o.record.sensors.items()}
        return tuple(self.model.units.get(n, sensors[n].unit) for n in self.names)

    def candidates(self, members: Members) -> tuple[Candidate, ...]:
        """The effects of a set as candidates of the model; parameters are none."""
        return tuple(c for m in members if (c := self._candidate(m)) is not None)

    def _candidate(self, member: Member) -> Candidate | None:
        if member not in self._candidates:
            effect = self.causes[member.cause].effect
            self._candidates[member] = Candidate(effect, member.shape) if effect else None
        return self._candidates[member]

    @cached_property
    def _candidates(self) -> dict[Member, Candidate | None]:
        """Candidates of members that were asked for."""
        return {}

    def locals_of(self, members: Members) -> tuple[Local, ...]:
        """The unknowns of each record that a set adds."""
        return tuple(q for m in members if (q := self.causes[m.cause].local) is not None)

    @cached_property
    def scopes(self) -> dict[tuple[float, ...], dict[int, int]]:
        """Causes of some records: by shares and by the law of all records; (): each its own."""
        found: dict[tuple[float, ...], dict[int, int]] = {}
        for i, c in enumerate(self.causes):
            if c.family >= 0:
                found.setdefault(c.shares, {})[c.family] = i
        return found

    def log_odds_of(self, causes: Iterable[int]) -> float:
        """Log prior odds of a set. What makes records differ happens once: a scope costs once."""
        total, known = 0.0, set()
        for cause in (self.causes[i] for i in causes):
            scope = cause.shares, cause.local is None
            law = self.causes[cause.family] if cause.family >= 0 and scope in known else cause
            total += law.log_odds
            known |= {scope} if cause.family >= 0 else set()
        return total

    def families_of(self, causes: Iterable[int]) -> set[int]:
        """The laws of causes, whatever their scopes."""
        return {f if (f := self.causes[i].family) >= 0 else i for i in causes}

    def scales_in(self, members: Members, observed: Observed | None) -> Array:
        """Scales of the effects of a set in a record [their units]: 0 where one does not act."""
        own = [c for m in members if (c := self.causes[m.cause]).effect is not None]
        return np.array([c.common * c.acts_in(observed) for c in own])

    def effects_of(self, members: Members) -> list[Effect]:
        """The effects of a set."""
        return [e for m in members if (e := self.causes[m.cause].effect) is not None]

    def released(self, members: Members) -> NDArray[np.bool_]:
        """Whether a free parameter may be outside its tolerance in a set, (p,)."""
        own = {self.causes[m.cause].parameter for m in members}
        return np.array([i in own for i in self.free], dtype=bool)


def spread(records: Sequence[Observed]) -> Array:
    """Rms of each channel about its mean in each record [its unit], (m,)."""
    total, count = np.zeros(records[0].sd.shape[1]), np.zeros(records[0].sd.shape[1])
    for o in records:
        n = np.maximum(o.samples, 1.0)
        about = np.where(o.valid, o.measured - o.measured.sum(axis=0) / n, 0.0)
        total += (about**2).sum(axis=0)
        count += o.samples
    return np.asarray(np.sqrt(total / np.maximum(count, 1.0)))


def rms_of(records: Sequence[Observed], residuals: Iterable[Array]) -> Array:
    """Rms of residuals by channel [its unit], (m,); they are in units of the noise, (n, m)."""
    squares = sum(((x * o.sd) ** 2).sum(axis=0) for x, o in zip(residuals, records, strict=True))
    return np.asarray(np.sqrt(squares / np.maximum(sum(o.samples for o in records), 1.0)))
