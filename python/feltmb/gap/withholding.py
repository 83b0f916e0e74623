"""Tests a diagnosis on the user's own machine: the effects of the library are withheld in turn.

Each case draws the parameters of the model from their priors and gives the simulated machine one
effect of the library, with a magnitude from its prior. The inputs are those of the user, and the
noise is that of the user's sensors. The diagnosis only gets the records. Machine and model share
their equations, so that the result is an upper bound: a real machine differs from its model in more
than one effect.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from feltmb._core import __version__
from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import DataError, FeltmbError, InvalidParameter
from feltmb.files import Store, digest_of, make_folder, package_digest
from feltmb.fit.model import Candidate, Effect, Model, Parameter
from feltmb.fit.observe import observe_whole
from feltmb.fit.problem import Problem
from feltmb.fit.shift import shifted
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap.checks import DataChecks, check_against, with_sigma
from feltmb.gap.criteria import CLEAR_SIGNAL
from feltmb.gap.diagnosis import diagnose
from feltmb.gap.findings import QUIET, Findings, Verdict
from feltmb.gap.judged_data import prepare
from feltmb.gap.options import Options

__all__ = ["OUTCOMES", "Withheld", "WithheldCase", "outcome_of", "withhold"]

#: Possible outcomes of a case, best first.
OUTCOMES = ("right", "residual", "class", "unknown", "silent", "wrong", "failed")

Progress = Callable[[int, int, "WithheldCase"], None]


@checked
@dataclass(frozen=True, kw_only=True)
class WithheldCase:
    """One withheld effect and its diagnosis."""

    number: int
    effect: str
    """Name of the effect; empty: nothing was withheld."""
    magnitude: float
    """True magnitude [unit]."""
    unit: str
    signal_to_noise: float
    """Norm of the change of the records by the effect, in standard deviations of the noise [1]."""
    outcome: str
    """One of :data:`OUTCOMES`, see :func:`outcome_of`."""
    verdict: str
    named: tuple[str, ...]
    one_of: tuple[str, ...]
    first: str
    """First effect of the ranking."""
    confidence: float | None
    """Confidence of the diagnosis [1]; None: the diagnosis failed."""
    seconds: float
    error: str = ""
    """Message of a failed diagnosis."""


@checked
@dataclass(frozen=True, kw_only=True)
class Withheld:
    """Cases of :func:`withhold`, and how often the diagnosis was right."""

    cases: tuple[WithheldCase, ...]

    def share(self, outcome: str, *, clear: bool = True) -> tuple[float, float, float, int]:
        """Share of an outcome among cases with an effect, 95 % interval (Wilson), cases.

        Parameters
        ----------
        outcome
            One of :data:`OUTCOMES`.
        clear
            Only cases whose effect has a signal-to-noise ratio of at least 5.
        """
        chosen = [
            c for c in self.cases if c.effect and (not clear or c.signal_to_noise >= CLEAR_SIGNAL)
        ]
        return _share([c.outcome == outcome for c in chosen])

    @property
    def false_alarms(self) -> tuple[float, float, float, int]:
        """Share of the cases without an effect in which the diagnosis claimed a gap."""
        return _share([c.outcome != "right" for c in self.cases if not c.effect])

    def rows(self) -> list[dict[str, Any]]:
        """One row per effect: cases, median signal-to-noise ratio, number of each outcome."""
        out = []
        for name in dict.fromkeys(c.effect for c in sorted(self.cases, key=lambda c: c.number)):
            own = [c for c in self.cases if c.effect == name]
            row: dict[str, Any] = {"effect": name, "cases": len(own)}
            row["signal_to_noise"] = float(np.median([c.signal_to_noise for c in own]))
            row |= {word: sum(c.outcome == word for c in own) for word in OUTCOMES}
            out.append(row)
        return out

    def as_dict(self) -> dict[str, Any]:
        """Results as plain data for JSON."""
        shares = {word: self.share(word) for word in OUTCOMES}
        return {
            "feltmb": __version__,
            "false_alarms": _plain(self.false_alarms),
            "clear": {word: _plain(value) for word, value in shares.items()},
            "rows": self.rows(),
            "cases": [asdict(c) for c in self.cases],
        }


def _share(hits: Sequence[bool]) -> tuple[float, float, float, int]:
    from scipy.stats import binomtest

    if not hits:
        return math.nan, math.nan, math.nan, 0
    interval = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    return sum(hits) / len(hits), float(interval.low), float(interval.high), len(hits)


def _plain(share: tuple[float, float, float, int]) -> dict[str, float | int | None]:
    value, low, high, cases = share
    numbers = {"share": value, "low": low, "high": high}
    return {k: None if math.isnan(v) else v for k, v in numbers.items()} | {"cases": cases}


def outcome_of(effect: str, report: Findings) -> str:
    """Classify the result of a diagnosis, given the withheld effect.

    ``right``: only the effect is named; without an effect, no gap is claimed. ``residual``: the
    effect is named and a residual remains, although nothing else was withheld. ``class``: the
    effect is one of several that cannot be distinguished. ``unknown``: a gap is claimed, but no
    name. ``silent``: no gap is claimed. ``wrong``: a wrong effect is named, or a gap is claimed
    without an effect.
    """
    silent = report.verdict in QUIET
    if not effect:
        return "right" if silent else "wrong"
    if report.named:
        if set(report.named) != {effect}:
            return "wrong"
        return "residual" if report.verdict == Verdict.NAMED_RESIDUAL else "right"
    if report.one_of:
        return "class" if effect in report.one_of else "wrong"
    if silent:
        return "silent"
    return "unknown" if report.verdict == Verdict.UNKNOWN else "wrong"


@checked
def withhold(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    *,
    cases: int | None = None,
    seed: int = 0,
    only: Sequence[str] | None = None,
    hold_out: Sequence[str] | None = None,
    options: Options | None = None,
    folder: str | Path | None = None,
    progress: Progress | None = None,
) -> Withheld:
    """Withhold effects of a library in turn and count how often the diagnosis is correct.

    Parameters
    ----------
    model, effects, records
        As in :func:`feltmb.gap.diagnose`. Inputs, times, sensors and noise of the records are used;
        the measured outputs are replaced.
    cases
        Number of cases; default: one without an effect and one for each effect, in turn.
    seed
        Seed of all random numbers, together with the number of the case.
    only
        Names of the effects that are withheld; default: all. The diagnosis always gets all effects.
    hold_out
        Held-out records, as in :func:`feltmb.gap.diagnose`.
    options
        Options of the diagnosis.
    folder
        Folder for finished cases, one file each; finished cases are not computed again.
    progress
        ``progress(done, total, case)`` is called after every case.

    Raises
    ------
    InvalidParameter
        Arguments are out of range, or the folder holds cases of other arguments.
    DataError
        The records cannot be used.
    """
    known = {e.name: e for e in effects}
    chosen = list(known) if only is None else list(only)
    unknown = [n for n in chosen if n not in known]
    if unknown:
        raise InvalidParameter(
            f"only: no effect {', '.join(unknown)}; there are {', '.join(known) or 'none'}"
        )
    if len(known) < len(effects):
        raise InvalidParameter("effects: two of them have the same name")
    missing = [h for h in hold_out or () if h not in [r.name for r in records]]
    if missing:
        raise InvalidParameter(
            f"hold_out: no record {', '.join(missing)}; there are "
            f"{', '.join(r.name for r in records)}"
        )
    turns = ["", *chosen]
    total = len(turns) if cases is None else cases
    if not 1 <= total <= 100_000 or seed < 0:
        raise InvalidParameter(
            f"cases = {total}, seed = {seed}: expected 1 to 100000 and a number >= 0"
        )
    options = options or Options()
    machine = _Machine.of(model, records)
    store = None
    if folder is not None:
        digest = _digest(machine, effects, records, seed, turns, hold_out, options)
        store = Store(make_folder(folder), digest)
    done = []
    for number in range(total):
        case = None if store is None else _case_of(store, number)
        if case is None:
            effect = known.get(turns[number % len(turns)])
            case = _run(machine, effects, effect, number, seed, hold_out, options)
            if store is not None:
                store.put(f"case_{number}", asdict(case))
        done.append(case)
        if progress is not None:
            progress(number + 1, total, case)
    return Withheld(cases=tuple(done))


def _run(
    machine: _Machine,
    effects: Sequence[Effect],
    effect: Effect | None,
    number: int,
    seed: int,
    hold_out: Sequence[str] | None,
    options: Options,
) -> WithheldCase:
    rng = np.random.default_rng([seed, number])
    begin = time.perf_counter()
    magnitude, ratio, error = 0.0, 0.0, ""
    report: Findings | None = None
    try:
        candidate, magnitude = (None, 0.0) if effect is None else _drawn(effect, rng)
        shown, ratio = machine.records_with(candidate, magnitude, rng)
        report = diagnose(machine.model, effects, shown, hold_out, options)
    except FeltmbError as fault:
        error = str(fault)
    name = "" if effect is None else effect.name
    ranking = () if report is None else report.which.effects
    return WithheldCase(
        number=number,
        effect=name,
        magnitude=magnitude,
        unit="" if effect is None else effect.unit,
        signal_to_noise=ratio,
        outcome="failed" if report is None else outcome_of(name, report),
        verdict="" if report is None else str(report.verdict),
        named=() if report is None else tuple(report.named),
        one_of=() if report is None else tuple(report.one_of),
        first=ranking[0].effect if ranking else "",
        confidence=None if report is None else float(report.confidence),
        seconds=time.perf_counter() - begin,
        error=error,
    )


def _drawn(effect: Effect, rng: np.random.Generator) -> tuple[Candidate, float]:
    """A shape of an effect, and a magnitude from its prior: normal, within its limits."""
    shape = effect.shapes[int(rng.integers(len(effect.shapes)))]
    low, high = effect.bounds
    magnitude = float(effect.scale * rng.standard_normal())
    if not low <= magnitude <= high:  # half-normal distribution
        magnitude = -magnitude
    return Candidate(effect, shape), float(np.clip(magnitude, low, high))


def _within(p: Parameter, z: float) -> float:
    """Parameter value at z prior standard deviations, within limits; unchanged without a prior."""
    sd = p.sd if math.isfinite(p.sd) else 0.0
    return min(max(p.value + sd * z, p.lower), p.upper)


@dataclass(frozen=True)
class _Machine:
    """A model that generates records instead of measurements."""

    model: Model
    records: tuple[Record, ...]
    starts: tuple[Array, ...]
    """States at the first sample of each record."""
    free: tuple[Array, ...]
    """Prior standard deviations of the start states."""
    noise: DataChecks

    @classmethod
    def of(cls, model: Model, records: Sequence[Record]) -> _Machine:
        model.forget()
        records, _ = model.driven(records)
        checks = check_against(model, records)
        for record in records:
            for name, sensor in record.sensors.items():
                values = record.outputs[name]
                different = np.unique(values[np.isfinite(values)])
                if sensor.sigma is None and different.size < 2:
                    raise DataError(
                        f"record {record.name}: nothing was measured of {name}, and its sensor "
                        "has no noise; expected sigma, or a measured record"
                    )
        with_noise = [with_sigma(r, checks.noise(r.name)) for r in records]
        ready = model.ready(with_noise)
        states = ready.model.states(())
        starts, free = [], []
        for record in with_noise:
            prior = record.start
            mean = {} if prior is None else prior.mean
            sd = {} if prior is None else prior.sd
            starts.append(np.array([mean.get(s.name, s.start) for s in states]))
            free.append(np.array([sd.get(s.name, s.start_sd) for s in states]))
        if any(np.any(np.isinf(f)) for f in free):
            # The true start states are unknown: the states of the fitted model are used.
            segmented_records = prepare(ready.model, ready.records, checks, None)
            fit = fit_problem(Problem(ready.model, segmented_records), FitSettings(restarts=0))
            for k, place in enumerate(fit.point.places):
                wild = np.isinf(free[k])
                starts[k] = np.where(wild, place.starts[0], starts[k])
                free[k] = np.where(wild, 0.0, free[k])
        return cls(ready.model, tuple(with_noise), tuple(starts), tuple(free), checks)

    def records_with(
        self, candidate: Candidate | None, magnitude: float, rng: np.random.Generator
    ) -> tuple[list[Record], float]:
        """Records of a machine with an effect, and the signal-to-noise ratio of the effect."""
        theta = np.array([_within(p, rng.standard_normal()) for p in self.model.parameters])
        included = () if candidate is None else (candidate,)
        model = self.model.with_variability_at(theta, included, np.full(len(included), magnitude))
        shown, square = [], 0.0
        for record, start, free in zip(self.records, self.starts, self.free, strict=True):
            first = start + free * rng.standard_normal(start.size)
            clean = _outputs_of(model, record, theta, first, None, 0.0)
            outputs = (
                clean
                if candidate is None
                else _outputs_of(model, record, theta, first, candidate, magnitude)
            )
            noise = self.noise.noise(record.name)
            made = {}
            for name in outputs:
                if name not in record.outputs:
                    continue
                sigma = noise[name].sd(clean[name])
                measured = np.isfinite(record.outputs[name])
                change = ((outputs[name] - clean[name]) / sigma)[measured]
                square += float(np.sum(change**2))
                seen = self._seen(record, name, outputs[name], rng)
                made[name] = np.where(measured, seen, np.nan)
            bad = [
                k
                for k, y in made.items()
                if np.any(np.isfinite(y) != np.isfinite(record.outputs[k]))
            ]
            if bad:
                raise InvalidParameter(
                    f"record {record.name}: the machine gives no number for {', '.join(bad)} "
                    "at drawn parameters"
                )
            # The noise of an input is a part of the run-to-run variability of some models.
            noisy = not model.variability_has_input_noise
            inputs = {
                k: u + noisy * record.input_sigma.get(k, 0.0) * rng.standard_normal(u.size)
                for k, u in record.inputs.items()
            }
            sensors = {k: v for k, v in record.sensors.items() if k in made}
            shown.append(replace(record, outputs=made, inputs=inputs, sensors=sensors))
        return shown, math.sqrt(square)

    def _seen(self, record: Record, name: str, y: Array, rng: np.random.Generator) -> Array:
        """Readings of a sensor with unknown errors and noise."""
        sensor = record.sensors[name]
        if sensor.delay_sd > 0.0:
            lag = np.array([sensor.delay_sd * rng.standard_normal()])
            whole = np.array([[0, record.samples - 1]])
            y = shifted(record, y[None, :], whole, lag)[0]
        y = (1.0 + sensor.gain_sd * rng.standard_normal()) * y
        y = y + sensor.offset_sd * rng.standard_normal()
        step = sensor.quantum
        noise = self.noise.noise(record.name)[name].without_rounding(step)
        y = y + noise.draw(record.time, rng, y)
        return np.round(y / step) * step if step > 0.0 else y


def _outputs_of(
    model: Model,
    record: Record,
    theta: Array,
    start: Array,
    candidate: Candidate | None,
    magnitude: float,
) -> Mapping[str, Array]:
    """Outputs of a machine without the errors of its sensors, by name."""
    included = () if candidate is None else (candidate,)
    magnitudes = np.array([magnitude] if included else [])
    hidden = [s.start for s in model.states(included)[start.size :]]
    states = np.concatenate([start, hidden])
    outputs = observe_whole(model, record, theta, states, included, magnitudes)
    return {name: outputs[:, i] for i, name in enumerate(model.outputs)}


# ---------------------------------------------------------------- finished cases


def _case_of(store: Store, number: int) -> WithheldCase | None:
    """A finished case from its file; None if the file is missing, incomplete or changed."""
    kept = store.get(f"case_{number}")
    if kept is None:
        return None
    return WithheldCase(**kept.data | {k: tuple(kept.data[k]) for k in ("named", "one_of")})


def _digest(
    machine: _Machine,
    effects: Sequence[Effect],
    records: Sequence[Record],
    seed: int,
    turns: Sequence[str],
    hold_out: Sequence[str] | None,
    options: Options,
) -> str:
    """Hash of everything that the cases depend on; equations and effects count by their results."""
    model = machine.model
    parts: list[Any] = [
        package_digest(),
        seed,
        turns,
        hold_out,
        repr(replace(options, resume=None)),
    ]
    parts += [model.name, model.outputs, repr(model.parameters), repr(model.states(()))]
    parts += [(e.name, e.scale, e.sign, e.lower, e.upper, repr(e.shapes)) for e in effects]
    for r in records:
        parts += [r.name, repr(sorted(r.sensors.items())), r.input_sigma, r.role, repr(r.start)]
        parts += [r.input_mode, r.time, r.inputs, r.outputs]
    theta = np.array([p.value for p in model.parameters])
    for k, (record, start) in enumerate(zip(machine.records, machine.starts, strict=True)):
        included = [Candidate(e, e.shapes[0]) for e in effects] if k == 0 else []
        for candidate in (None, *included):
            low, high = (0.0, 0.0) if candidate is None else candidate.effect.bounds
            magnitude = (
                0.0 if candidate is None else float(np.clip(candidate.effect.scale, low, high))
            )
            given = _outputs_of(machine.model, record, theta, start, candidate, magnitude)
            parts += [np.nan_to_num(given[name]) for name in model.outputs]
    return digest_of(*parts)
