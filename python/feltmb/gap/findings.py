"""Result types of a diagnosis: place, causes, held-out gap, advice, and the model with effects."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter, no_such
from feltmb.fit import Candidate, Model
from feltmb.fit.model import LAWS
from feltmb.fit.observe import observe_whole
from feltmb.gap.criteria import NO_GAP_RATIO
from feltmb.units import readable_unit, unit_suffix

__all__ = [
    "Advice",
    "AsItIs",
    "Calibrated",
    "Closest",
    "ComponentRow",
    "EventRow",
    "Findings",
    "GapRow",
    "GivenValue",
    "HowFar",
    "LedgerCell",
    "ModelWithEffects",
    "NotTested",
    "Ranked",
    "RankedSet",
    "RecordError",
    "VaryingLaw",
    "Verdict",
    "Where",
    "Which",
    "listed",
    "sentence",
]


class Verdict(StrEnum):
    """Verdict of a diagnosis."""

    NO_GAP = "NO GAP"
    """The tabulated model explains the records within noise and run-to-run variability."""
    CALIBRATED = "NO STRUCTURAL GAP, CALIBRATED"
    """The model explains the records with the fitted values in ``report.calibrated``; no effect is
    missing."""
    NAMED = "NAMED"
    """The effects in ``report.named`` explain the gap; held-out records prove them, or do not
    excite them, which the statement then tells."""
    ONE_OF = "ONE OF"
    """One effect of ``report.one_of`` explains the gap; the records cannot determine which."""
    NAMED_RESIDUAL = "NAMED + RESIDUAL REMAINS"
    """As NAMED, but a significant gap remains that no tested effect explains."""
    UNKNOWN = "UNKNOWN"
    """There is a gap, and no tested effect explains it."""
    TOO_WEAK = "TOO WEAK"
    """There is a sign of a gap, but it is not significant, or no held-out record can prove it."""
    DATA_PROBLEM = "DATA PROBLEM"
    """Faults of sensors, inputs or clocks explain the gap at least as well as effects in the
    machine."""
    NOT_COMPLETE = "NOT COMPLETE"
    """The diagnosis was stopped before it could say one of the above."""


#: Verdicts with which the model and its effects explain the records.
EXPLAINED = frozenset({Verdict.NO_GAP, Verdict.CALIBRATED, Verdict.NAMED, Verdict.ONE_OF})
#: Verdicts that need no cause outside the model.
QUIET = frozenset({Verdict.NO_GAP, Verdict.CALIBRATED, Verdict.TOO_WEAK, Verdict.NOT_COMPLETE})


@dataclass(frozen=True, kw_only=True)
class AsItIs:
    """Gap of the model with its tabulated numbers in one channel, before any fit."""

    channel: str
    unit: str
    gap: float
    """Root mean square over all records [unit]; infinite if a simulation fails."""
    noise: float
    """Standard deviation of the noise of the sensor [unit]."""
    multiple: float
    """``gap / noise`` [1]"""
    spread: float
    """Standard deviation of the measured signal [unit]; NaN: no record has more than one value."""
    failed: tuple[str, ...] = ()
    """Records that the model cannot simulate to the end."""

    @property
    def worse_than_constant(self) -> bool:
        """Whether a constant would be closer to the records than the model."""
        return self.gap > self.spread


@dataclass(frozen=True, kw_only=True)
class GivenValue:
    """A value that the model was given beside its table.

    It is the magnitude of an effect that is a part of the model, or a parameter that was measured
    by a test of its part.
    """

    name: str
    component: str
    unit: str
    tabulated: float
    """Value without the test [unit]; of an effect 0."""
    tolerance: float
    """Its standard deviation [unit]; of an effect inf."""
    given: float
    """Value before the fit, for example of a test of the part [unit]."""
    given_sd: float
    """Its standard deviation [unit]; inf: nothing was known."""
    value: float
    """Fitted value [unit]."""
    low: float
    """Lower end of the 95 % interval [unit]."""
    high: float
    effect: bool
    """Whether it is the magnitude of an effect."""
    differs: bool
    """Whether the fitted value differs from the table: an effect from zero, at the family-wise
    level ``alpha``; a parameter by more than ``TOLERATED`` deviations of table and fit."""
    refuted: bool
    """Whether the records contradict the test, so that the fit does not use it."""
    text: str
    """Name, value and test as text, with 95 % intervals."""

    @property
    def remark(self) -> str:
        """What follows from the value, as text after the value; may be empty."""
        if self.refuted:
            return "; the records contradict the test, which is not used"
        if self.differs:
            return ""
        if self.effect:
            return "; not distinguishable from zero"
        return "" if math.isinf(self.tolerance) else "; agrees with its table"


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """A parameter that the fit changed by more than two posterior standard deviations."""

    name: str
    component: str
    part: str
    """Name of the part for people."""
    unit: str
    tabulated: float
    """Tabulated value [unit]."""
    value: float
    """Fitted value [unit]."""
    sd: float
    """Posterior standard deviation [unit]."""
    low: float
    """Lower end of the 95 % interval [unit]."""
    high: float
    deviations: float
    """Change in posterior standard deviations."""
    prior_deviations: float | None
    """Change in prior standard deviations; None: the parameter has no prior."""
    at_limit: bool
    """Whether the value is at a limit of the parameter."""
    share: float
    """Share of the squared gap of the tabulated model that the change explains, all records [1];
    NaN: not computed, or no gap above the noise."""
    sure: bool
    """Whether the change is significant at the family-wise level ``alpha`` over all parameters."""
    alone: float = math.nan
    """Estimate from the records alone, if the tolerance holds the fitted value back [unit]; else
    NaN."""
    alone_sd: float = math.nan
    """Standard deviation of ``alone`` [unit]."""
    origin: Literal["tabulated", "measured"] = "tabulated"
    """Where ``tabulated`` is from: a table, or a test of the part."""
    beyond: bool = False
    """Whether the value exceeds its tolerance; see
    :func:`~feltmb.gap.tolerance.beyond_tolerance`."""
    converged: bool = True
    """False: the fit was ended early, and the interval is that of its present point."""
    text: str = ""
    """Description of the change in one sentence."""

    @property
    def notes(self) -> str:
        """Tolerance and share of the gap, in brackets."""
        notes = []
        if self.prior_deviations is not None:
            far = abs(self.prior_deviations)
            what = "its tolerance" if self.origin == "tabulated" else "the uncertainty of its test"
            notes.append(f"within {what}" if far <= 1.0 else f"{far:.1f} times {what}")
        if math.isfinite(self.share):
            notes.append(f"{self.share:.0%} of the gap")
        if not self.sure:
            notes.append("may be chance")
        return f" ({', '.join(notes)})" if notes else ""


class ClosedShare:
    """Texts of a result with the fields ``closed``, ``low`` and ``high``."""

    closed: float
    low: float
    high: float

    @property
    def gap_in_noise(self) -> float:
        """Gap that is to be closed, over the noise [1]."""
        raise NotImplementedError

    @property
    def no_gap(self) -> bool:
        """Whether the gap is hardly above the noise: its closed share is then meaningless."""
        return self.gap_in_noise < NO_GAP_RATIO

    def closing(self, subject: str, gap: str, verb: str = "closes") -> str:
        """Clause: what a set of effects closes of a gap, such as "the held-out gap"."""
        if self.no_gap:
            return f"{gap} is hardly above the noise, so that there is nothing to close"
        return f"{subject} {verb} {self.closed_text} of {gap} ({self.band_text})"

    @property
    def undetermined(self) -> bool:
        """Whether the 95 % interval of ``closed`` contains both 0 % and 100 %."""
        return round(self.low, 2) <= 0.0 and round(self.high, 2) >= 1.0

    @property
    def closed_text(self) -> str:
        """Closed share as text; an interval that excludes nothing has no best value."""
        if self.no_gap:
            return "nothing (no gap above noise)"
        return "an undetermined share" if self.undetermined else f"{self.closed:.0%}"

    @property
    def band_text(self) -> str:
        """95 % interval of the closed share as text."""
        return f"95% from {self.low:.0%} to {self.high:.0%}"


@dataclass(frozen=True, kw_only=True)
class Closest(ClosedShare):
    """The tested set that is closest to the held-out records if no effect is proven."""

    effects: tuple[str, ...]
    magnitudes: tuple[float, ...]
    """Magnitude of each effect [units of the effects]."""
    units: tuple[str, ...]
    closed: float
    """Share of the held-out gap of the fitted model that the set would close [1]; see
    :class:`GapRow`."""
    low: float
    """Lower end of the 95 % interval of ``closed`` [1]."""
    high: float
    gap: float
    """This gap [noise standard deviations]."""
    why: str
    """Reason why it is not proven."""

    @property
    def gap_in_noise(self) -> float:
        """Gap that is to be closed, over the noise [1]."""
        return self.gap


@dataclass(frozen=True, kw_only=True)
class LedgerCell:
    """Residual of one channel in one time segment."""

    record: str
    channel: str
    start: float
    """Start of the segment [s]."""
    end: float
    """End of the segment [s]."""
    samples: int
    rms: float
    """Root mean square of the residual [unit of the channel]."""
    sigma: float
    """Root mean square that noise alone would leave [unit]."""
    z: float
    """(chi2 - n) / sqrt(2 n), where n is the effective number of samples."""
    p: float
    significant: bool
    """Significance according to Benjamini-Yekutieli over all cells."""
    lag1: float
    """Autocorrelation of the whitened residual at a lag of one bin."""


@dataclass(frozen=True, kw_only=True)
class EventRow:
    """One event of one channel: time and speed of the machine compared with the model."""

    record: str
    event: str
    channel: str
    time: float
    """Measured time of the event; without an event of the model, time of a steepest change of the
    simulated output [s]."""
    delay: float
    """Measured minus simulated time [s]."""
    delay_se: float
    speed: float
    """Measured speed at the event [unit/s]."""
    speed_error: float
    """Measured minus simulated speed [unit/s]."""
    speed_error_se: float
    significant: bool


@dataclass(frozen=True, kw_only=True)
class ComponentRow:
    """A port of the model, and whether an unknown force acts there."""

    component: str
    port: str
    unit: str
    statistic: float
    """Standardized variance-component score."""
    p: float
    significant: bool
    explained: float
    """Share of the gap that a force at this port could explain [1]."""
    trace: Mapping[str, Mapping[str, list[float]]] = field(default_factory=dict)
    """Record -> {"time", "force", "sd"} for the strongest places."""
    signature: str = ""
    """Likely form of the force (sign of speed, loop, ...)."""

    @property
    def text(self) -> str:
        """What a force there would explain; of a sum of squares like that of noise, no share."""
        force = f"An unknown force at {self.component}"
        if self.explained < 0.005:
            return f"{force} is significant"
        return f"{force} would explain {self.explained:.0%} of the gap of the model"


def sentence(clause: str) -> str:
    """A clause as a sentence."""
    return f"{clause[:1].upper()}{clause[1:]}."


def listed(names: Iterable[str]) -> str:
    """Names as a part of a sentence: "a", "a and b", "a, b and c"."""
    items = list(names)
    return ", ".join(items[:-1]) + " and " + items[-1] if len(items) > 1 else "".join(items)


#: Gain of log evidence above which its size does not matter.
MUCH = 1000.0


@dataclass(frozen=True, kw_only=True)
class VaryingLaw:
    """A parameter that varies between the segments of the records: its law is not exact."""

    parameter: str
    """Name of the parameter."""
    label: str
    """Its name in sentences."""
    unit: str
    sd: float
    """Standard deviation of its deviations, beside the given ``process_sd`` [unit]."""

    @property
    def text(self) -> str:
        """Name and size."""
        factor, shown = readable_unit(self.sd, self.unit)
        return f"{self.label} (±{factor * self.sd:.2g}{unit_suffix(shown)})"


@dataclass(frozen=True, kw_only=True)
class RecordError:
    """Gain or offset of one sensor in one record alone, which would explain most of the gap."""

    record: str
    channel: str
    kind: str
    """"gain" or "offset"."""
    size: float
    """Relative gain [1], or offset [unit]."""
    unit: str
    gain: float
    """Gain of log evidence of the model [1]."""

    @property
    def text(self) -> str:
        """A sentence."""
        if self.kind == "gain":
            what = f"{100 * abs(self.size):.2g} % too {'large' if self.size > 0.0 else 'small'}"
            if abs(self.size) > 0.5:
                what = f"{1.0 + self.size:.3g} times as large as the true value"
        else:
            factor, shown = readable_unit(self.size, self.unit)
            what = f"shifted by {factor * self.size:.3g}{unit_suffix(shown)}"
        size = f"{self.gain:.0f}" if self.gain < MUCH else f"more than {MUCH:.0f}"
        return (
            f"If {self.channel} were {what} in the record {self.record} alone, the model would "
            f"gain {size} units of log evidence: check this sensor in this record."
        )


@dataclass(frozen=True, kw_only=True)
class Where:
    """Where the gap lies."""

    ledger: tuple[LedgerCell, ...]
    events: tuple[EventRow, ...]
    components: tuple[ComponentRow, ...]
    onset: Mapping[str, float]
    """Record -> start of the gap [s], for records that have one: the time at which the accepted
    effects begin to show in the model, or else at which the sum of squares exceeds its expectation.
    """
    split: Mapping[str, Mapping[str, float]]
    """Channel -> shares of the squared gap: "time", "amplitude", "rest" [1]."""
    remains: tuple[LedgerCell, ...] = ()
    """The residuals of the model with the named effects; empty if no effect is named."""
    varying: tuple[VaryingLaw, ...] = ()
    """Laws of the model without effects with an error of form that would explain the gap, the
    strongest first."""
    varying_gain: float = 0.0
    """Gain of log evidence if these laws vary [1]."""
    one_record: RecordError | None = None
    """A sensor that differs in one record alone, if that would explain most of the gap."""

    @property
    def hints(self) -> tuple[str, ...]:
        """Sentences about what would explain the gap without an effect."""
        texts = (self.one_record.text if self.one_record else "", self.varying_text)
        return tuple(text for text in texts if text)

    @property
    def varying_text(self) -> str:
        """Sentence about the laws with an error of form; empty if there are none."""
        names = [law.text for law in self.varying]
        if not names:
            return ""
        gain = self.varying_gain
        size = f"{gain:.0f}" if gain < MUCH else f"more than {MUCH:.0f}"
        one = len(names) == 1
        return (
            f"If {listed(names)} varied within the records, the model would gain {size} units of "
            f"log evidence: the form of {'its law' if one else 'their laws'} may be wrong, or "
            f"{'it depends' if one else 'they depend'} on a quantity that the model does not have."
        )


@dataclass(frozen=True, kw_only=True)
class ShapeNumber:
    """One number of the shape of an effect."""

    name: str
    value: float
    low: float
    """Lower end of the 95 % interval; the value itself if it was not fitted."""
    high: float


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """One candidate effect in the ranking."""

    effect: str
    component: str
    mechanism: str
    kind: str
    unit: str
    shape: Any
    magnitude: float
    """Refitted magnitude if ``refitted``, else the estimate after one step from the model fit
    [unit]."""
    sd: float
    low: float
    """Lower end of the 95 % interval [unit]."""
    high: float
    refitted: bool
    statistic: float
    """Score test T, ~ chi2 with 1 degree of freedom if the effect is absent [1]."""
    robust: float
    """Score test with the cluster-robust variance [1]."""
    p: float
    """Family-wise p value over all effects, shapes and sets."""
    posterior: float
    """Posterior probability that the effect is part of the cause [1]."""
    noncentrality: float
    """Signal-to-noise ratio at its scale: expected sqrt(T) for magnitude = scale [1]."""
    smallest: float
    """Smallest magnitude that these records can detect [unit]; inf: none."""
    confusable: tuple[str, ...]
    """Effects that these records cannot distinguish from it."""
    named: bool
    converged: bool = True
    """False: its fit was ended early, and the interval is that of its present point."""
    remedy: str = ""
    numbers: tuple[ShapeNumber, ...] = ()
    """Numbers of the shape of the effect."""


@dataclass(frozen=True, kw_only=True)
class RankedSet:
    """A set of effects."""

    effects: tuple[str, ...]
    magnitudes: tuple[float, ...]
    statistic: float
    evidence: float
    """Log evidence relative to the model (natural logarithm)."""
    posterior: float
    refitted: bool


@dataclass(frozen=True, kw_only=True)
class Which:
    """Ranked effects and sets."""

    effects: tuple[Ranked, ...]
    sets: tuple[RankedSet, ...]
    none: float
    """Posterior probability that the model without effects suffices [1]."""
    other: float
    """Posterior probability of a cause that is not in the library [1]."""
    classes: tuple[tuple[str, ...], ...]
    """Groups of effects that these records cannot distinguish."""
    form: float = 0.0
    """Error of form in the intervals of laws, as a share of the magnitude (``Options.form``)
    [1]."""

    @property
    def form_note(self) -> str:
        """Sentence about the error of form in the intervals; empty if they have none."""
        if self.form == 0.0 or not any(r.refitted and r.kind in LAWS for r in self.effects):
            return ""
        return (
            "No law of force is exact: the 95 % interval of its magnitude is at least "
            f"±{196.0 * self.form:.2g} % (--form {self.form:g}), and the intervals of parameters "
            "contain what this changes."
        )

    def __getitem__(self, name: str) -> Ranked:
        for row in self.effects:
            if row.effect == name:
                return row
        raise no_such("ranked effect", name, (row.effect for row in self.effects))


#: If a fit of the profile is better than the original fit by more than this, it is reported. The
#: value is twice the difference of log evidence below which two fits count as equal.
LOWER = 1.0


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Profile of the magnitude of an effect: least sum of squares at fixed magnitudes."""

    effect: str
    unit: str
    magnitude: float
    """Fitted magnitude [unit]."""
    sd: float
    """Posterior standard deviation according to the linear model of the fit [unit]."""
    values: tuple[float, ...]
    """Magnitudes at which everything else was fitted again, the fitted one included [unit]."""
    rises: tuple[float, ...]
    """Rise of the sum of squares at ``values`` [1]; below 0: the original fit was not at the
    minimum."""
    low: float
    """Lower end of the 95 % interval: the rise is 3.84 there [unit]; infinite: not reached within 3
    ``sd``."""
    high: float
    complete: bool = True
    """False: the computation was stopped before all values were fitted."""

    @property
    def text(self) -> str:
        """Sentence about the interval."""
        unit = unit_suffix(self.unit)
        ends = [
            f"{end:.4g}{unit}" if math.isfinite(end) else f"beyond {edge:.4g}{unit}"
            for end, edge in ((self.low, self.values[0]), (self.high, self.values[-1]))
        ]
        text = (
            f"{self.effect}: {self.magnitude:.4g}{unit}, 95 % interval by profile from {ends[0]} "
            f"to {ends[1]} (by standard deviations from {self.magnitude - 1.96 * self.sd:.4g} to "
            f"{self.magnitude + 1.96 * self.sd:.4g}{unit}), both without the error of form of a law"
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
class GapRow(ClosedShare):
    """Gap on held-out data in one metric."""

    metric: str
    """"segmented", "open loop" or "speed" (of the residual in the metric of :class:`HowFar`)."""
    channel: str
    unit: str
    before: float
    """Gap of the model with fitted parameters [unit]."""
    after: float
    """Gap of the model with fitted parameters and named effects [unit]."""
    noise: float
    closed: float
    """Closed share of the gap above the noise [1]: (before - max(after, noise)) / (before - noise),
    at most 1, and negative if the gap grows; 0 if the gap before is not above the noise."""
    low: float
    """Lower end of the 95 % interval of ``closed``, by block bootstrap [1]."""
    high: float
    p: float
    """One-sided p value of the hypothesis that the effects do not improve held-out data."""
    tabulated: float = math.nan
    """Gap of the model with tabulated parameters [unit]; NaN: not computed."""

    @property
    def gap_in_noise(self) -> float:
        """Gap that is to be closed, over the noise [1]."""
        return self.before / self.noise


@dataclass(frozen=True, kw_only=True)
class HowFar(ClosedShare):
    """Reduction of the gap on held-out data."""

    rows: tuple[GapRow, ...]
    waterfall: tuple[tuple[str, float], ...]
    """Bars of the waterfall: ("as tabulated", gap), ("calibration", reduction by the fit of the
    parameters), then each accepted effect with its order-free (Shapley) share, then ("unexplained",
    rest), ("noise", noise and run-to-run variability); in units of ``waterfall_unit``."""
    tabulated: float
    """Gap of the model with tabulated parameters, all channels together [``waterfall_unit``]."""
    before: float
    """Gap with fitted parameters [``waterfall_unit``]."""
    after: float
    """Gap with fitted parameters and named effects [``waterfall_unit``]."""
    waterfall_unit: str
    metric: str
    """Metric of the waterfall and of ``closed``: "open loop" or "segmented"."""
    closed: float
    """Closed share of the held-out gap in ``metric``, all channels together [1]; see
    :class:`GapRow`."""
    low: float
    high: float
    records: tuple[str, ...]
    """Names of the held-out records."""
    per_record: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Record -> (before, after): gaps in ``metric`` [``waterfall_unit``]."""

    @property
    def gap_in_noise(self) -> float:
        """Gap that is to be closed, over the noise [1]."""
        return self.before


@dataclass(frozen=True, kw_only=True)
class Advice:
    """A next step, for example an experiment that would separate confused effects."""

    text: str
    separates: tuple[str, str] = ("", "")
    """The two effects that an experiment would separate."""
    confusion_now: float = math.nan
    """Present probability of confusing the two effects [1]."""
    confusion_then: float = math.nan


@dataclass(frozen=True, kw_only=True)
class NotTested:
    """An effect that was not tested, and the reason."""

    name: str
    why: str


@dataclass(frozen=True, kw_only=True)
class ModelWithEffects:
    """The model with fitted parameters and effects, ready for simulation."""

    original: Model
    """The diagnosed model, without fitted parameters and effects."""
    theta: Array
    included: tuple[Candidate, ...]
    magnitudes: Array
    starts: Mapping[str, Array] = field(default_factory=dict)
    """Fitted start state by record; in the order of ``original.states(included)``."""
    provenance: str = ""
    """Text that identifies the diagnosis, for files."""

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each fitted parameter by name."""
        return {p.name: float(v) for p, v in zip(self.original.parameters, self.theta, strict=True)}

    @property
    def effects(self) -> dict[str, float]:
        """Magnitude of each effect by name."""
        return {t.name: float(v) for t, v in zip(self.included, self.magnitudes, strict=True)}

    @property
    def at_limits(self) -> tuple[str, ...]:
        """Titles of parameters that moved to a limit of their range, names of effects at one."""
        parameters = zip(self.original.parameters, self.theta, strict=True)
        titles = [p.title for p, v in parameters if v != p.value and not p.lower < v < p.upper]
        effects = zip(self.included, self.magnitudes, strict=True)
        reached = [t.name for t, v in effects if not t.effect.bounds[0] < v < t.effect.bounds[1]]
        return (*titles, *reached)

    @checked
    def simulate(self, record: Record, start: Array | None = None) -> dict[str, Array]:
        """Simulate a whole record from a start state; returns the outputs by name.

        The default start state is the fitted one of the record, else the mean of its prior.
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
        outputs = observe_whole(
            self.original, record, self.theta, start, self.included, self.magnitudes
        )
        return {name: outputs[:, i] for i, name in enumerate(self.original.outputs)}

    @checked
    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the model with fitted parameters and effects to a file that can be loaded again.

        Raises
        ------
        InvalidParameter
            The model does not come from a file, or the file format cannot represent an effect.
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
    """The verdict in one or two sentences."""
    named: tuple[str, ...]
    """Named effects (verdicts NAMED and NAMED + RESIDUAL REMAINS)."""
    one_of: tuple[str, ...]
    """Effects that cannot be distinguished, one of which acts: alone (verdict ONE OF), or in
    addition to the named ones. A mere possibility is in the statement only."""
    confidence: float
    """Posterior probability of the statement [1]; NaN: the diagnosis is not complete."""
    as_it_is: tuple[AsItIs, ...]
    """Gap of the model with tabulated numbers, by channel. It does not depend on the tested
    effects."""
    calibrated: tuple[Calibrated, ...]
    """Parameters that the fit changed, sorted by their share of the gap, largest first."""
    given: tuple[GivenValue, ...]
    """Tests of parts, and effects that are a part of the diagnosed model; see
    :func:`feltmb.gap.with_measured`."""
    closest: Closest | None
    """The closest tested set if no effect is named; None: no tested set is closer than the
    model."""
    where: Where
    which: Which
    how_far: HowFar
    next: tuple[Advice, ...]
    model: ModelWithEffects
    """The model with fitted parameters and named effects."""
    fitted: ModelWithEffects
    """The model with fitted parameters only."""
    tabulated: ModelWithEffects
    """The tabulated model, with the start states that fit the records best."""
    not_tested: tuple[NotTested, ...]
    refused: tuple[NotTested, ...]
    """Effects of the best set that are not named, and why: held-out records did not confirm them,
    or their probability is too low."""
    fit: Any
    """Fit of the model (:class:`feltmb.fit.Fit`)."""
    checks: Any
    """Result of the data checks (:class:`feltmb.gap.DataChecks`)."""
    profiles: tuple[Profile, ...] = ()
    """Profiles of the magnitudes of named effects, if requested (``Options(profile=True)``)."""
    no_profile: str = ""
    """Reason why a requested profile is missing."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time per stage [s]; not written to files, because their bytes must depend on the input
    alone."""
    stopped: str = ""
    """Stage in which the diagnosis was stopped, and why; empty: it was completed."""
    resumed: str = ""
    """What was reused of an interrupted diagnosis, or why nothing was; empty without a folder
    (``Options.resume``). Not written to files, because their bytes must depend on the input
    alone."""
    fits: Path | None = None
    """Folder of the finished fits, below ``Options.resume``; not written to files."""

    @property
    def not_tested_by_reason(self) -> list[tuple[str, list[str]]]:
        """Reasons why effects were not tested, and the names of these effects; most first."""
        groups: dict[str, list[str]] = {}
        for n in self.not_tested:
            groups.setdefault(n.why, []).append(n.name)
        return sorted(groups.items(), key=lambda group: -len(group[1]))

    @property
    def no_step(self) -> str:
        """What a report says if it has no next step."""
        if self.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED):
            return "Nothing: the model explains these records."
        return "No step is known that would tell more."

    @property
    def remaining_cells(self) -> tuple[LedgerCell, ...]:
        """Channels and times in which the final model leaves more than noise."""
        cells = self.where.remains if self.model.included else self.where.ledger
        return tuple(c for c in cells if c.significant)
