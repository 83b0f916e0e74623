"""What the attributes of a report, a comparison or a blind test hold: numbers and codes.

Users read them and never make them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import AnyNumber, checked
from unmodeled.data import Array
from unmodeled.models.model import UserUnit
from unmodeled.models.subject import NOTHING, Subject
from unmodeled.search.ledger import Finding, listed

__all__ = [
    "OUTCOMES",
    "Case",
    "Cell",
    "Change",
    "Channel",
    "Compared",
    "Event",
    "Finding",
    "Hint",
    "NamedCause",
    "ParameterValue",
    "Place",
    "Reason",
    "Result",
    "SetOfCauses",
    "Trace",
    "Without",
]

#: Version of the JSON form of a result.
VERSION = 3
#: Deviation of a parameter, in standard deviations of its prior, up to which it is within its
#: tolerance.
TOLERANCE = 2.0
#: Share of a residual that is no improvement.
NO_GAIN = 0.01


class Verdict(Enum):
    """What a diagnosis says."""

    NO_GAP = "no gap"
    """The tabulated model already agrees with the records."""
    CALIBRATED = "calibrated"
    """With parameters within their tolerances, the model agrees."""
    NAMED = "named"
    """One or more causes are named."""
    ONE_OF = "one of"
    """One of a class of causes is missing; the records do not tell which one."""
    SUPPORTED = "supported"
    """Causes predict records that were not fitted better for sure; whether they are the ones is not
    sure."""
    UNKNOWN = "unknown"
    """A material residual remains, and no cause explains it."""


class Reason(Enum):
    """Why a verdict is what it is."""

    NOISE_NOT_STATED = "no noise of the sensor is stated"
    DIFFERS_BETWEEN_RECORDS = "the magnitude differs between records"
    WORSE_THAN_MEAN = "the mean predicts held-out records better"
    NO_HELD_OUT_GAIN = "held-out records are not predicted better"
    NOT_PREDICTED = "held-out records are not predicted"
    CALIBRATION_PREDICTS_WORSE = "the calibrated model predicts held-out records worse"
    NOTHING_INSIDE = "no listed effect acts inside the model"
    NOT_COMPLETE = "the search was ended before its end"
    INTERRUPTED = "the search was interrupted"


@dataclass(frozen=True)
class Channel:
    """Residuals of one output, as rms in its unit; NaN: no held-out record shows it."""

    name: str
    unit: str
    noise: float
    """Noise of the sensor; if no sensor states it, the part of what the best set leaves that
    neighboring samples do not share; NaN: it is not known."""
    motion: float
    """Rms of the measured values about their mean, by record."""
    tabulated: float
    """Residual of the tabulated model."""
    calibrated: float
    """Residual after a fit of the parameters."""
    explained: float
    """Residual with the named causes, or with the most probable set."""
    held_out_calibrated: float = float("nan")
    held_out_explained: float = float("nan")
    good_enough: float = 0.0
    """Residual that does not matter."""
    fitted_explained: float = float("nan")
    """Residual with the named causes in the records that were fitted before the held-out ones were
    predicted."""

    @checked
    def share(self, residual: AnyNumber) -> float:
        """A residual as a share of the motion [1]."""
        return residual / self.motion if self.motion > 0.0 else math.nan

    @property
    def limit(self) -> float:
        """Largest residual that does not matter: twice the noise, or good_enough."""
        return max(2.0 * float(np.nan_to_num(self.noise)), self.good_enough, 1e-300)

    @property
    def material(self) -> bool:
        """Whether the unexplained residual matters."""
        return self.explained > self.limit


def worst_of(channels: Sequence[Channel]) -> int:
    """Index of the channel that the calibrated model misses most, else the tabulated model.

    A channel of which only the noise is missed is the worst one only if all are so.
    """

    def badness(c: Channel) -> tuple[float, float]:
        calibrated, tabulated = c.calibrated / c.limit, c.tabulated / c.limit
        return max(calibrated, 1.0), tabulated if math.isfinite(tabulated) else math.inf

    return max(range(len(channels)), key=lambda k: badness(channels[k]))


@dataclass(frozen=True)
class ParameterValue:
    """A fitted parameter of the model."""

    name: str
    title: str
    unit: str
    tabulated: float
    sd: float
    """Standard deviation of the prior."""
    value: float
    low: float
    """Lower end of the 95 % interval."""
    high: float
    relative: bool = False
    """Whether the value is a relative deviation."""
    user_unit: UserUnit | None = None

    @property
    def moved(self) -> bool:
        """Whether the interval excludes the tabulated value."""
        return not self.low <= self.tabulated <= self.high

    def as_cause(self) -> NamedCause:
        """The parameter in the form of a cause."""
        return NamedCause(
            self.name,
            "",
            self.unit,
            self.value,
            self.low,
            self.high,
            math.nan,
            parameter=True,
            changes=self.name,
            kind="parameter",
            user_unit=self.user_unit,
            subject=Subject("parameter"),
        )

    @property
    def tolerances(self) -> float:
        """Deviation from the tabulated value in standard deviations of the prior [1]."""
        return abs(self.value - self.tabulated) / self.sd if self.sd > 0.0 else 0.0


@dataclass(frozen=True)
class NamedCause:
    """A cause with its magnitude in the set in which it is most probable."""

    cause: str
    component: str
    unit: str
    magnitude: float
    low: float
    """Lower end of the 95 % interval."""
    high: float
    probability: float
    """Posterior probability that it is missing [1]."""
    shape: Any = None
    shape_names: tuple[str, ...] = ()
    by_record: tuple[float, ...] = ()
    """Magnitude in each fitted record by itself."""
    parameter: bool = False
    """Whether it is a parameter outside its tolerance; the magnitude is its value."""
    mechanism: str = ""
    remedy: str = ""
    changes: str = ""
    """Parameter of the model that is this cause, also under the name of an effect; "": none."""
    ratio: float = 1.0
    """Change of this parameter per magnitude of the effect that is its other name."""
    kind: str = "force"
    """Kind of the effect; "parameter", or "sensor" also for an error of each record."""
    title: str = ""
    """What is added, or with its article what changes; "": the name."""
    relative: bool = False
    """Whether the magnitude is a share of a number of the model."""
    user_unit: UserUnit | None = None
    subject: Subject = NOTHING
    """What it is about; the report makes its sentences from it."""
    mark: str = ""
    """Its mark, or that of the cause whose equivalent it is: a value of :class:`Mark`."""


@dataclass(frozen=True)
class Without:
    """Residuals with the set of the answer and without one of its changes.

    Without an effect, all parameters are fitted again: they cannot do what it does. Without a
    parameter, the others follow to first order.
    """

    name: str
    """Name of the cause or of the parameter."""
    before: tuple[float, ...]
    """Rms without it by channel [its unit]; infinite: the simulation fails."""
    after: tuple[float, ...]
    """With all changes [its unit]."""
    beside: tuple[str, ...] = ()
    """Causes that are left out too: alone, each of them takes less than what matters."""


def takes_over(channels: Sequence[Channel], without: Without) -> float:
    """What a change takes away, over what matters; in some channel [1]."""
    return _taken(channels, without.before, without.after)[2]


def _taken(
    channels: Sequence[Channel], before: Sequence[float], after: Sequence[float]
) -> tuple[int, float, float]:
    """The channel in which a change is seen best, what it takes away, over what matters."""
    taken = [math.sqrt(max(b * b - a * a, 0.0)) for b, a in zip(before, after, strict=True)]
    # Noise is in both residuals: what their difference is compared with has none.
    least = [max(c.good_enough, 1e-300) for c in channels]
    ratio = max(t / v for t, v in zip(taken, least, strict=True))
    k = max(range(len(taken)), key=lambda k: taken[k] / channels[k].limit)
    return k, taken[k], ratio


Tier = Literal["named", "one of", "supported", "fitted", "small", "unsure"]


@dataclass(frozen=True)
class Change:
    """A change of the model, of a sensor, an input or a clock, that the records ask for."""

    name: str
    """Name of the cause or of the parameter."""
    title: str
    """What is added, or with its article what changes."""
    component: str
    kind: str
    """Kind of the effect, or "parameter"."""
    tier: Tier
    """``named``: the records tell it from all listed causes; ``one of``: not from its equivalents;
    ``supported``: it predicts held-out records better, whether it is the cause or not; ``fitted``:
    a parameter whose interval excludes its tabulated value; ``small``: it is probable, and takes
    away less than what matters; ``unsure``: a part of the fit, and none of these."""
    unit: str
    size: float
    """Change of the parameter, or magnitude of the effect [unit]."""
    low: float
    """Lower end of the 95 % interval [unit]."""
    high: float
    tabulated: float
    """Value of the parameter before the change [unit]; 0 for an effect."""
    relative: bool
    """Whether the size is a share of the tabulated number."""
    user_unit: UserUnit | None
    tolerances: float
    """Size in standard deviations of the prior [1]; NaN: it is no parameter with a tolerance."""
    probability: float
    """Posterior probability [1]; NaN: a parameter is fitted, not searched."""
    channel: str = ""
    """Output of which it takes away most."""
    before: float = math.nan
    """Residual without the change, as a share of the motion of this output [1]."""
    after: float = math.nan
    """Residual with all changes [1]."""
    beside: tuple[str, ...] = ()
    """Changes that ``before`` is without, too."""
    takes: float = math.nan
    """Rms of what it takes away [1]; NaN: it is not known."""
    matters: bool = True
    """Whether it takes away more than what does not matter in some output."""
    shape: Any = None
    shape_names: tuple[str, ...] = ()
    by_record: tuple[float, ...] = ()
    """Magnitude in each fitted record by itself [unit]."""
    records: tuple[str, ...] = ()
    """Names of these records, if the change is an error that each record has by itself."""
    mechanism: str = ""
    remedy: str = ""
    subject: Subject = NOTHING
    """What it is about."""
    equivalents: tuple[Change, ...] = ()
    """Changes that fit as well."""

    @property
    def within(self) -> bool | None:
        """Whether a parameter is within its tolerance; None: it has none."""
        return None if math.isnan(self.tolerances) else self.tolerances <= TOLERANCE


@dataclass(frozen=True)
class SetOfCauses:
    """One fitted set of causes."""

    causes: tuple[str, ...]
    probability: float
    residual: tuple[float, ...]
    """Rms of the residual by channel [its unit]."""
    magnitudes: tuple[float, ...] = ()
    """By cause [its unit]; the value of a parameter, NaN for an error of each record."""


@dataclass(frozen=True)
class Cell:
    """Residual of one channel in a part of a record, as rms in the unit of the channel."""

    record: str
    channel: str
    start: float
    """[s]"""
    end: float
    """[s]"""
    since: str
    """Event of the model with which the part begins; "" if there is none."""
    calibrated: float
    explained: float


@dataclass(frozen=True)
class Event:
    """Delay of one channel at an event of the model."""

    record: str
    event: str
    channel: str
    time: float
    """[s]"""
    delay: float
    """Delay of the record against the calibrated model [s]."""
    delay_explained: float
    """With the causes of the answer [s]."""
    delay_sd: float


@dataclass(frozen=True)
class Place:
    """A place where something unknown would explain the residual that remains with the answer."""

    name: str
    """A port of the model, or a component of the listed effects."""
    port: bool
    """Port: any force that depends on time; component: its effects, other ones in each record."""
    left: tuple[float, ...]
    """Residual that would remain, by channel, corrected for the freedom of the force [its unit]."""
    gain: float
    """Gain of log evidence."""
    resembles: tuple[tuple[str, float], ...] = ()
    """Laws that the force resembles, with the shares of the force that they explain [1]."""
    force: tuple[tuple[float, ...], ...] = ()
    """Position, speed, and the force at them, at points along the records; (): a component."""
    units: tuple[str, ...] = ()
    """Units of these three."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Residual of the worst channel over time in one record [its unit]; NaN: not measured."""

    record: str
    held_out: bool
    time: Array
    calibrated: Array
    explained: Array


@dataclass(frozen=True, eq=False)
class Result:
    """Result of a diagnosis."""

    verdict: Verdict
    reasons: tuple[Reason, ...]
    channels: tuple[Channel, ...]
    named: tuple[NamedCause, ...]
    classes: tuple[tuple[NamedCause, ...], ...]
    """Each class: one of its members is missing."""
    parameters: tuple[ParameterValue, ...]
    """Fitted parameters, with the causes of the answer."""
    sets: tuple[SetOfCauses, ...]
    """Fitted sets, the most probable first."""
    held_out_gain: tuple[float, float, float] | None = None
    """Ratio of the rms residuals of held-out records with and without the causes of the answer, and
    its 95 % interval [1]; None: no cause is in the answer."""
    nothing: float = 1.0
    """Posterior probability that no listed cause is missing [1]."""
    not_tried: tuple[str, ...] = ()
    """Causes that no fitted set contains, most promising first."""
    causes: int = 0
    """Number of causes that were to be tried."""
    supported: tuple[NamedCause, ...] = ()
    """Causes that are not named, each of which surely improves the prediction of held-out records,
    together with the others."""
    small: tuple[tuple[NamedCause, ...], ...] = ()
    """Causes that take away less than what matters, with equivalents."""
    unsure: tuple[tuple[NamedCause, ...], ...] = ()
    """Other causes of the set of the answer, with equivalents."""
    findings: tuple[Finding, ...] = ()
    """The ledger: one line for each candidate."""
    drawn: float = math.nan
    """Probability that all parameters deviate by their tolerances; else few do [1]."""
    complete: bool = True
    needed: float = math.nan
    """Estimated time of a complete search [s], if this one ended before its end; else NaN."""
    notes: tuple[str, ...] = ()
    rounds: int = 0
    """Rounds of simulations that all fits took."""
    seconds: float = 0.0
    records: tuple[str, ...] = ()
    """Names of the records in the order of ``NamedCause.by_record``."""
    cells: tuple[Cell, ...] = ()
    """Ledger of the residual."""
    events: tuple[Event, ...] = ()
    places: tuple[Place, ...] = ()
    """Best explanation of what remains first; () if what remains does not matter."""
    apart: tuple[str, ...] = ()
    """For each class, the record in which its first two members differ most."""
    reported: tuple[str, ...] = ()
    """Causes of the set of the answer."""
    changed: tuple[tuple[ParameterValue, ...], ...] = ()
    """Parameters that surely changed, each with the equivalents that could stand for it."""
    without: tuple[Without, ...] = ()
    """What is left without each of these causes and parameters."""
    unknowns: tuple[str, ...] = ()
    """Fitted parameters and magnitudes of the reported set."""
    correlation: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    """Correlation of the unknowns."""
    traces: tuple[Trace, ...] = field(default=(), repr=False)

    @property
    def refused(self) -> tuple[str, ...]:
        """Causes that left the set because their size differs between records."""
        return tuple(f.cause for f in self.findings if f.codes[:1] == ("differs",))

    @cached_property
    def changes(self) -> tuple[Change, ...]:
        """The answer: what changes, by how much, and what it takes away.

        What the model does not allow comes first: effects, errors of the records, and parameters
        outside their tolerances; then those that are not sure; then parameters within their
        tolerances, then what is small, and last what is unsure. Among each, the change that takes
        away most is the first.

        If the verdict is UNKNOWN, parameters may imitate what is not known: they are only in
        ``parameters``.
        """
        found = [self._change(n, "named") for n in self.named]
        found += [self._change(n, "supported") for n in self.supported]
        tiers: tuple[tuple[Tier, tuple[tuple[NamedCause, ...], ...]], ...] = (
            ("one of", self.classes), ("small", self.small), ("unsure", self.unsure))  # fmt: skip
        for tier, groups in tiers:
            for group in groups:
                first, *others = (self._change(n, tier) for n in group)
                found.append(replace(first, equivalents=tuple(others)))
        known = {c.name for first in found for c in (first, *first.equivalents)}
        changed = self.changed if self.verdict is not Verdict.UNKNOWN else ()
        for alike in changed:
            if alike and not known & {p.name for p in alike}:
                first, *others = (self._change(p.as_cause(), "fitted", p) for p in alike)
                if first.before < (1.0 + NO_GAIN) * first.after:
                    continue  # it is in the table of parameters
                found.append(replace(first, equivalents=tuple(others)))
        order = {"supported": 1, "small": 3, "unsure": 4}

        def place(c: Change) -> tuple[int, float]:
            within = (2 if c.within is True else 0) if c.matters else 3
            within = within if c.tier == "fitted" else 0
            unknown = 0.0 if c.tier == "fitted" else math.inf
            rank = max(order.get(c.tier, 0), within)
            return rank, -float(np.nan_to_num(c.takes, nan=unknown))

        return tuple(sorted(found, key=place))

    @checked
    def finding(self, name: str) -> Finding:
        """The line of the ledger of a candidate.

        Parameters
        ----------
        name
            Name of a candidate.

        Raises
        ------
        InvalidParameter
            There is no candidate of this name.
        """
        return listed(self.findings, name)

    def _change(self, n: NamedCause, tier: Tier, p: ParameterValue | None = None) -> Change:
        """A change with what it takes away of the channel where this matters most."""
        p = p or next((p for p in self.parameters if p.name == n.changes), None)
        found = Change(
            name=n.cause,
            component=n.component,
            tier=tier,
            probability=n.probability,
            shape=n.shape,
            shape_names=n.shape_names,
            records=self.records if n.subject.scope.each else (),
            subject=n.subject,
            mechanism=n.mechanism,
            remedy=n.remedy,
            **(_of_effect(n) if p is None else _of_parameter(n, p)),
        )
        if n.subject.scope.records:
            found = replace(found, by_record=())
        left = next((w for w in self.without if w.name == n.cause), None)
        if left is None:
            return found
        k, taken, ratio = _taken(self.channels, left.before, left.after)
        c = self.channels[k]
        return replace(
            found,
            channel=c.name,
            before=c.share(left.before[k]),
            after=c.share(left.after[k]),
            beside=left.beside,
            takes=c.share(taken),
            matters=ratio > 1.0,
        )

    @cached_property
    def worst(self) -> Channel:
        """The channel that the calibrated model misses most."""
        return self.channels[worst_of(self.channels)]

    def as_dict(self) -> dict[str, Any]:
        """Codes and numbers as JSON types: NaN is None, an infinite number is a text."""
        own: dict[str, Any] = plain(self) | {"changes": plain(self.changes)}
        return {"format": "unmodeled diagnosis", "version": VERSION} | own

    def to_json(self) -> str:
        """The result as a JSON text; ``seconds`` apart, equal input gives equal text."""
        return json.dumps(self.as_dict(), indent=1, ensure_ascii=False) + "\n"


def _of_effect(n: NamedCause) -> dict[str, Any]:
    """What a change has of an effect or an error of the records."""
    return {
        "title": n.title or n.cause,
        "kind": n.kind,
        "unit": n.unit,
        "size": n.magnitude,
        "low": n.low,
        "high": n.high,
        "tabulated": 0.0,
        "relative": n.unit == "1" and (n.relative or n.kind in ("sensor", "input")),
        "user_unit": n.user_unit,
        "tolerances": math.nan,
        "by_record": n.by_record,
    }


def _of_parameter(n: NamedCause, p: ParameterValue) -> dict[str, Any]:
    """What a change has of a parameter, in the sense of its title."""
    at = p.tabulated if n.parameter else 0.0
    unit, ratio, user_unit = n.unit, 1.0, n.user_unit
    if n.unit == p.unit or n.ratio < 0.0:
        unit, ratio, user_unit = p.unit, n.ratio, p.user_unit
    low, high = sorted((ratio * (n.low - at), ratio * (n.high - at)))
    return {
        "title": p.title or n.cause,
        "kind": "parameter",
        "unit": unit,
        "size": ratio * (n.magnitude - at),
        "low": low,
        "high": high,
        "tabulated": at,
        "relative": unit == "1" and p.relative,
        "user_unit": user_unit,
        "tolerances": p.tolerances if 0.0 < p.sd < math.inf else math.nan,
        "by_record": tuple(ratio * v for v in n.by_record),
    }


@dataclass(frozen=True)
class Compared:
    """One channel of one record beside the tabulated model."""

    record: str
    channel: str
    unit: str
    samples: int
    """Number of samples that the record and the model both have [1]."""
    motion: float
    """Rms of the record about its mean [unit]."""
    noise: float
    """Noise of the sensor [unit]."""
    stated: bool
    """Whether the noise is stated; else it is estimated from the record."""
    rms: float
    """Rms of record minus model [unit]."""
    factor: float
    """Record over model, about their means, by least squares [1]."""
    offset: float
    """Mean of the record less that of the model times the factor [unit]."""
    correlation: float
    """Correlation of record and model [1]."""
    delay: float
    """Delay of the record if it explains at least half of the squared difference [s]; else NaN."""
    delayed: float
    """Share of the squared difference that remains with this delay [1]; NaN without it."""

    @property
    def share(self) -> float:
        """Difference as a share of the motion [1]."""
        return self.rms / self.motion if self.motion > 0.0 else math.nan

    @property
    def in_noise(self) -> float:
        """Difference as a multiple of the noise [1]."""
        return self.rms / self.noise if self.noise > 0.0 else math.nan


@dataclass(frozen=True)
class Hint:
    """An error of the records, or of what is stated, that would explain a difference."""

    kind: Literal[
        "unit",
        "sign",
        "scale",
        "clock",
        "input",
        "exchange",
        "delay",
        "wrap",
        "parameter",
        "start",
        "absolute",
    ]
    channels: tuple[str, ...]
    text: str
    sure: bool = False
    """Whether nothing else explains it; a diagnosis refuses such records."""


#: Outcomes of a case. With an effect: the answer is this effect; a class that contains it; empty,
#: and the rest does not matter, or does ("unknown"); anything else. Without an effect: the answer
#: is empty, or not. The diagnosis failed.
OUTCOMES = ("right", "class", "silent", "unknown", "wrong", "quiet", "false alarm", "none")


@dataclass(frozen=True)
class Case:
    """One withheld effect and its diagnosis."""

    number: int
    effect: str
    """Name of the effect; empty: nothing was withheld."""
    magnitude: float
    """True magnitude [unit]."""
    unit: str
    signal_to_noise: float
    """Norm of the change of the records by the effect, in standard deviations of the noise [1]."""
    outcome: str = "none"
    """One of :data:`OUTCOMES`."""
    verdict: str = ""
    answer: tuple[tuple[str, ...], ...] = ()
    """Named causes and classes; one name: a named cause."""
    covered: int = 0
    """Number of 95 % intervals of parameters and of the effect that contain the true value."""
    intervals: int = 0
    error: str = ""
    """Message of a failed diagnosis."""


def plain(value: Any) -> Any:
    """Value as JSON types; numbers to 9 digits."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [plain(v) for v in value]
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        if math.isnan(value):
            return None
        return float(f"{value:.9g}") if math.isfinite(value) else str(float(value))
    return str(value)
