"""What a diagnosis found: where, which, how far, next, and the model with effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter, no_such
from feltmb.fit import Candidate, Jobs, Model
from feltmb.fit.observe import observe_jobs

__all__ = [
    "Advice",
    "AsItIs",
    "Calibrated",
    "Closest",
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
    """The model explains the records within noise and repeatability, with its tabulated numbers."""
    CALIBRATED = "NO STRUCTURAL GAP, CALIBRATED"
    """So it does once the parameters of ``report.calibrated`` have moved; nothing is missing."""
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


#: Verdicts by which model and named effects explain the records.
EXPLAINED = frozenset({Verdict.NO_GAP, Verdict.CALIBRATED, Verdict.NAMED})
#: Verdicts that ask for no cause outside the model.
QUIET = frozenset({Verdict.NO_GAP, Verdict.CALIBRATED, Verdict.TOO_WEAK})


@dataclass(frozen=True, kw_only=True)
class AsItIs:
    """The gap of the model with its tabulated numbers in one channel, before any fit."""

    channel: str
    unit: str
    gap: float
    """Root mean square over all records [unit]; infinite where the simulation fails."""
    noise: float
    """Of the sensor [unit]."""
    multiple: float
    """``gap / noise`` [1]"""
    spread: float
    """Standard deviation of what was measured [unit]."""
    failed: tuple[str, ...] = ()
    """Records that the model cannot simulate to their end."""

    @property
    def worse_than_constant(self) -> bool:
        """Whether a constant would be nearer to the records than the model is."""
        return self.gap > self.spread


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """A parameter that the fit moved by more than two posterior standard deviations."""

    name: str
    component: str
    part: str
    """What people call it."""
    unit: str
    tabulated: float
    """From [unit]."""
    value: float
    """To [unit]."""
    sd: float
    """Posterior standard deviation [unit]."""
    low: float
    """95 % interval [unit]."""
    high: float
    deviations: float
    """How far it moved, in posterior standard deviations."""
    prior_deviations: float | None
    """The same in those of its prior; None: nothing was known of it."""
    at_limit: bool
    """Whether it sits at a limit that it may not pass."""
    share: float
    """Share of the squared gap of the tabulated model that it explains, all records [1]; NaN: not
    computed, or there is no gap above the noise."""
    sure: bool
    """Whether it moved further than noise alone moves one of all parameters (``alpha``)."""
    alone: float = math.nan
    """What the records alone say, where its tolerance holds it back [unit]; else NaN."""
    alone_sd: float = math.nan
    """Standard deviation of that [unit]."""
    beyond: bool = False
    """Whether it is beyond its tolerance; see :func:`~feltmb.gap.tolerance.beyond_tolerance`."""
    text: str = ""
    """How far it moved, in a sentence."""

    @property
    def notes(self) -> str:
        """Its tolerance and its share of the gap, in brackets."""
        notes = []
        if self.prior_deviations is not None:
            far = abs(self.prior_deviations)
            notes.append("within its tolerance" if far <= 1.0 else f"{far:.1f} times its tolerance")
        if math.isfinite(self.share):
            notes.append(f"{self.share:.0%} of the gap")
        if not self.sure:
            notes.append("may be chance")
        return f" ({', '.join(notes)})" if notes else ""


@dataclass(frozen=True, kw_only=True)
class Closest:
    """The tested set that is closest to the held-out records if no effect is proven."""

    effects: tuple[str, ...]
    magnitudes: tuple[float, ...]
    """[units of the effects]"""
    units: tuple[str, ...]
    closed: float
    """Share of the held-out gap of the fitted model that it would close [1]."""
    low: float
    """95 % interval."""
    high: float
    why: str
    """Why it is not proven."""


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
    remains: tuple[LedgerCell, ...] = ()
    """The ledger of the model with what was named; empty where nothing was."""


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
    magnitude: float
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
    """Smallest magnitude that these records can show [unit]; inf: they show none."""
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
        raise no_such("ranked effect", name, (row.effect for row in self.effects))


#: A sum of squares below that of the fit by more than this is reported: twice the log evidence
#: within which two fits count as one.
LOWER = 1.0


@dataclass(frozen=True, kw_only=True)
class Profile:
    """How the least sum of squares rises beside the fitted magnitude of an effect."""

    effect: str
    unit: str
    magnitude: float
    """Fitted [unit]."""
    sd: float
    """Posterior standard deviation by the linear model of the fit [unit]."""
    values: tuple[float, ...]
    """Magnitudes at which all else was fitted again, the fitted one among them [unit]."""
    rises: tuple[float, ...]
    """Rise of the sum of squares there [1]; below 0: the fit had not come to its minimum."""
    low: float
    """95 % interval, where the rise is 3.84 [unit]; infinite: not reached within 3 ``sd``."""
    high: float
    complete: bool = True
    """False: it was stopped before all values were fitted."""

    @property
    def text(self) -> str:
        """The interval in a sentence."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        ends = [
            f"{end:.4g}{unit}" if math.isfinite(end) else f"beyond {edge:.4g}{unit}"
            for end, edge in ((self.low, self.values[0]), (self.high, self.values[-1]))
        ]
        text = (
            f"{self.effect}: {self.magnitude:.4g}{unit}, 95 % interval by profile from {ends[0]} "
            f"to {ends[1]} (by standard deviations from {self.magnitude - 1.96 * self.sd:.4g} to "
            f"{self.magnitude + 1.96 * self.sd:.4g}{unit})"
        )
        if not self.complete:
            text += "; it was stopped before its end"
        lowest = min(self.rises)
        if lowest < -LOWER:
            at = self.values[self.rises.index(lowest)]
            text += (
                f"; the fit was not at its minimum: at {at:.4g}{unit} the sum of squares is lower "
                f"by {-lowest:.2g}"
            )
        return text


@dataclass(frozen=True, kw_only=True)
class GapRow:
    """A gap on held-out data by one metric."""

    metric: str
    """"segmented", "open loop", "with speed" or "events"."""
    channel: str
    unit: str
    before: float
    """Model with fitted parameters [unit]."""
    after: float
    """The same with what was named [unit]."""
    noise: float
    closed: float
    """(before - after) / (before - noise) [1]"""
    low: float
    """95 % interval of ``closed`` by block bootstrap."""
    high: float
    p: float
    """One-sided: the effect does not improve held-out data."""
    tabulated: float = math.nan
    """Model with tabulated parameters [unit]; NaN: not computed."""


@dataclass(frozen=True, kw_only=True)
class HowFar:
    """How far the gap shrinks on held-out data."""

    rows: tuple[GapRow, ...]
    waterfall: tuple[tuple[str, float], ...]
    """("as tabulated", gap), ("calibration", what the fit of the parameters brings), then every
    accepted effect with its order-free (Shapley) share, then ("unexplained", rest), ("noise",
    noise and repeatability); in units of ``waterfall_unit``."""
    tabulated: float
    """Gap of the model with tabulated parameters, all channels together [``waterfall_unit``]."""
    before: float
    """The same with fitted parameters."""
    after: float
    """The same with what was named."""
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
    """Next step, or an experiment that would separate confused effects."""

    text: str
    separates: tuple[str, str] = ("", "")
    """Rivals that an experiment would separate."""
    confusion_now: float = math.nan
    """Probability to take one for the other, now [1]."""
    confusion_then: float = math.nan


@dataclass(frozen=True, kw_only=True)
class NotTested:
    """Something that was not tested, and why."""

    name: str
    why: str


@dataclass(frozen=True, kw_only=True)
class ModelWithEffects:
    """The model with the effects that were named, ready to simulate."""

    original: Model
    """What was diagnosed: the model with neither fitted parameters nor effects."""
    theta: Array
    included: tuple[Candidate, ...]
    magnitudes: Array
    starts: Mapping[str, Array] = field(default_factory=dict)
    """Start state that the fit found, by record; order of ``original.states(included)``."""
    provenance: str = ""
    """Which diagnosis the numbers are from, for files."""

    @property
    def parameters(self) -> dict[str, float]:
        """Fitted parameters by name."""
        return {p.name: float(v) for p, v in zip(self.original.parameters, self.theta, strict=True)}

    @property
    def effects(self) -> dict[str, float]:
        """Magnitudes by name of the effect."""
        return {t.name: float(v) for t, v in zip(self.included, self.magnitudes, strict=True)}

    @checked
    def simulate(self, record: Record, start: Array | None = None) -> dict[str, Array]:
        """Outputs over a whole record, by name, from a start state.

        Default: the state that the fit found for the record, else the mean of its prior.
        """
        states = self.original.states(self.included)
        if start is None:
            start = self.starts.get(record.name)
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
        outputs = observe_jobs(self.original, record, jobs).outputs[0]
        return {name: outputs[:, i] for i, name in enumerate(self.original.outputs)}

    @checked
    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the model with fitted parameters and effects into a file that loads again.

        Raises
        ------
        InvalidParameter
            The model is not made from a file, or an effect has no place in one.
        """
        return self.original.write(
            Path(path),
            self.theta,
            self.included,
            self.magnitudes,
            provenance=self.provenance,
            force=force,
        )


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
    as_it_is: tuple[AsItIs, ...]
    """The gap of the model with tabulated numbers, by channel; the same whatever effects are
    tested."""
    calibrated: tuple[Calibrated, ...]
    """What the fit of the parameters moved, largest share of the gap first."""
    closest: Closest | None
    """What came closest where nothing was named; None: no tested set comes closer."""
    where: Where
    which: Which
    how_far: HowFar
    next: tuple[Advice, ...]
    model: ModelWithEffects
    """With fitted parameters and what was named."""
    fitted: ModelWithEffects
    """With fitted parameters alone."""
    tabulated: ModelWithEffects
    """As it is, from the start states that suit it best."""
    not_tested: tuple[NotTested, ...]
    refused: tuple[NotTested, ...]
    """Effects of the best set that are not named, and why: held-out records did not confirm them,
    or their probability is too low."""
    fit: Any
    """The fit of the model (:class:`feltmb.fit.Fit`)."""
    checks: Any
    """What the data checks found (:class:`feltmb.gap.DataChecks`)."""
    profiles: tuple[Profile, ...] = ()
    """Of the magnitudes of named effects, where asked for (``Options(profile=True)``)."""
    no_profile: str = ""
    """Why there is none, though it was asked for."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time per stage; left out of the files, whose bytes depend on the input alone."""
    stopped: str = ""
    """Stage in which it was stopped, and why; empty: it came to its end."""
