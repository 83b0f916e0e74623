"""What a diagnosis found: where, which, how far, next, and the model with effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit import Candidate, Jobs, Model
from feltmb.fit.observe import observe_jobs

__all__ = [
    "Advice",
    "ComponentRow",
    "EventRow",
    "Findings",
    "GapRow",
    "HowFar",
    "LedgerCell",
    "ModelWithEffects",
    "NotTested",
    "Ranked",
    "RankedSet",
    "Verdict",
    "Where",
    "Which",
]


class Verdict(StrEnum):
    """What the engine commits itself to."""

    NO_GAP = "NO GAP"
    """The model explains the records within noise and repeatability."""
    NAMED = "NAMED"
    """The effects in ``report.named`` explain the gap, proven on held-out data."""
    ONE_OF = "ONE OF"
    """One effect of ``report.one_of`` does; these records cannot tell which."""
    NAMED_UNKNOWN_REST = "NAMED + RESIDUAL REMAINS"
    """As NAMED, but a significant gap is left that nothing tested explains."""
    UNKNOWN = "UNKNOWN"
    """There is a gap, and nothing tested explains it."""
    TOO_WEAK = "TOO WEAK"
    """A hint that does not reach significance, or no held-out record can prove it."""
    DATA_PROBLEM = "DATA PROBLEM"
    """Sensors, inputs or clocks explain it at least as well as the machine does."""


@dataclass(frozen=True, kw_only=True)
class LedgerCell:
    """One channel in one time segment."""

    record: str
    channel: str
    start: float
    """[s]"""
    end: float
    """[s]"""
    samples: int
    rms: float
    """Residual [unit of the channel]."""
    sigma: float
    """What noise alone would leave [unit]."""
    z: float
    """(chi2 - n) / sqrt(2 n), n the effective number of samples."""
    p: float
    significant: bool
    """By Benjamini-Yekutieli over all cells."""
    lag1: float
    """Autocorrelation of the whitened residual over one bin."""


@dataclass(frozen=True, kw_only=True)
class EventRow:
    """One event of one channel: how much earlier or faster the machine is than the model."""

    record: str
    event: str
    channel: str
    time: float
    """Measured [s]."""
    delay: float
    """Measured minus simulated time [s]."""
    delay_se: float
    speed: float
    """Measured [unit/s]."""
    speed_error: float
    """Measured minus simulated [unit/s]."""
    speed_error_se: float
    significant: bool


@dataclass(frozen=True, kw_only=True)
class ComponentRow:
    """A place in the machine, and whether an unknown force acts there."""

    component: str
    port: str
    unit: str
    statistic: float
    """Variance-component score, standardized."""
    p: float
    significant: bool
    explained: float
    """Share of the gap that such a force could explain [1]."""
    trace: Mapping[str, Mapping[str, list[float]]] = field(default_factory=dict)
    """Record -> {"time", "force", "sd", "position", "speed"} for the strongest places."""
    signature: str = ""
    """What the trace looks like (sign of speed, loop, ...)."""


@dataclass(frozen=True, kw_only=True)
class Where:
    """Where the gap lies."""

    ledger: tuple[LedgerCell, ...]
    events: tuple[EventRow, ...]
    components: tuple[ComponentRow, ...]
    onset: Mapping[str, float]
    """Record -> first moment of the gap [s], only records that have one: where the accepted effects
    begin to show in the model, or else where the sum of squares exceeds its expectation."""
    split: Mapping[str, Mapping[str, float]]
    """Channel -> shares of the squared gap: "time", "amplitude", "rest" [1]."""


@dataclass(frozen=True, kw_only=True)
class ShapeNumber:
    """One number of the shape of an effect."""

    name: str
    value: float
    low: float
    """95 % interval; the value itself where it was not fitted."""
    high: float


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """One candidate."""

    effect: str
    component: str
    mechanism: str
    kind: str
    unit: str
    shape: Any
    size: float
    """Refitted if ``refitted``, else one step from the model fit [unit]."""
    sd: float
    low: float
    """95 % interval."""
    high: float
    refitted: bool
    statistic: float
    """Score test T, ~ chi2 with 1 degree of freedom if the effect is absent."""
    robust: float
    """The same with the cluster-robust variance."""
    p: float
    """Family-wise, over all effects, shapes and sets."""
    posterior: float
    """Probability that it is part of the cause."""
    noncentrality: float
    """Detectability at its scale: expected sqrt(T) at magnitude = scale."""
    smallest: float
    """Smallest magnitude that these records can show [unit]."""
    confusable: tuple[str, ...]
    """Effects that these records cannot tell from it."""
    named: bool
    remedy: str = ""
    numbers: tuple[ShapeNumber, ...] = ()
    """Numbers of the shape."""


@dataclass(frozen=True, kw_only=True)
class RankedSet:
    """A set of effects."""

    effects: tuple[str, ...]
    magnitudes: tuple[float, ...]
    statistic: float
    evidence: float
    """Log evidence against the model."""
    posterior: float
    refitted: bool


@dataclass(frozen=True, kw_only=True)
class Which:
    """Ranked effects and sets."""

    effects: tuple[Ranked, ...]
    sets: tuple[RankedSet, ...]
    none: float
    """Posterior of: the model suffices."""
    other: float
    """Posterior of: something that is not in the library."""
    classes: tuple[tuple[str, ...], ...]
    """Effects that these records cannot tell apart."""

    def __getitem__(self, name: str) -> Ranked:
        for row in self.effects:
            if row.effect == name:
                return row
        raise KeyError(name)


@dataclass(frozen=True, kw_only=True)
class GapRow:
    """A gap on held-out data by one metric."""

    metric: str
    """"segmented", "open loop", "with speed" or "events"."""
    channel: str
    unit: str
    before: float
    after: float
    noise: float
    closed: float
    """(before - after) / (before - noise) [1]"""
    low: float
    """95 % interval of ``closed`` by block bootstrap."""
    high: float
    p: float
    """One-sided: the effect does not improve held-out data."""


@dataclass(frozen=True, kw_only=True)
class HowFar:
    """How far the gap shrinks on held-out data."""

    rows: tuple[GapRow, ...]
    waterfall: tuple[tuple[str, float], ...]
    """("model", gap), then every accepted effect with its order-free (Shapley) share, then
    ("unexplained", rest), ("noise", noise and repeatability); in units of ``waterfall_unit``."""
    waterfall_unit: str
    metric: str
    """Metric of the waterfall and of ``closed``: "open loop" or "segmented"."""
    closed: float
    """Share of the segmented held-out gap that is closed, all channels together [1]."""
    low: float
    high: float
    records: tuple[str, ...]
    """Held-out records."""
    per_record: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Record -> (before, after), segmented, whitened."""


@dataclass(frozen=True, kw_only=True)
class Advice:
    """An experiment that would separate what is still confused."""

    text: str
    separates: tuple[str, str]
    confusion_now: float
    """Probability to take one for the other, now [1]."""
    confusion_then: float


@dataclass(frozen=True, kw_only=True)
class NotTested:
    """Something that was not tested, and why."""

    name: str
    why: str


@dataclass(frozen=True, kw_only=True)
class ModelWithEffects:
    """The model with the effects that were named, ready to simulate."""

    base: Model
    theta: Array
    included: tuple[Candidate, ...]
    magnitudes: Array

    @property
    def parameters(self) -> dict[str, float]:
        """Fitted parameters by name."""
        return {p.name: float(v) for p, v in zip(self.base.parameters, self.theta, strict=True)}

    @property
    def effects(self) -> dict[str, float]:
        """Magnitudes by name of the effect."""
        return {t.name: float(v) for t, v in zip(self.included, self.magnitudes, strict=True)}

    @checked
    def simulate(self, record: Record, start: Array | None = None) -> dict[str, Array]:
        """Outputs over a whole record, by name, from a start state (default: its prior mean)."""
        states = self.base.states(self.included)
        if start is None:
            prior = {} if record.start is None else record.start.mean
            start = np.array([prior.get(s.name, s.start) for s in states])
        start = np.asarray(start)
        if start.shape != (len(states),):
            raise InvalidParameter(
                f"start has shape {start.shape}, expected the {len(states)} states of the model"
            )
        whole = np.array([[0, record.samples - 1]])
        jobs = Jobs.at_point(
            self.theta, whole, np.asarray(start)[None, :], self.included, self.magnitudes
        )
        outputs = observe_jobs(self.base, record, jobs).outputs[0]
        return {name: outputs[:, i] for i, name in enumerate(self.base.outputs)}


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Everything that a diagnosis found; :class:`feltmb.gap.Report` writes it to files."""

    verdict: Verdict
    statement: str
    """The verdict in a sentence or two."""
    named: tuple[str, ...]
    """Effects that were named (NAMED, NAMED + RESIDUAL REMAINS)."""
    one_of: tuple[str, ...]
    """The class (ONE OF); () otherwise."""
    confidence: float
    """Posterior probability of what the verdict says [1]."""
    where: Where
    which: Which
    how_far: HowFar
    next: tuple[Advice, ...]
    model: ModelWithEffects
    not_tested: tuple[NotTested, ...]
    refused: tuple[NotTested, ...]
    """Effects that the fit asked for and held-out records did not confirm."""
    fit: Any
    """The fit of the model (:class:`feltmb.fit.Fit`)."""
    checks: Any
    """What the data checks found (:class:`feltmb.gap.DataChecks`)."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time per stage; left out of the files, whose bytes depend on the input alone."""
    stopped: str = ""
    """Stage in which it was stopped, and why; empty: it came to its end."""
