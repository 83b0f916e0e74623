"""Detectability of effects before any measurement, and experiments that separate the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record, Sensor
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit.calling import calling
from feltmb.fit.model import Effect, Model
from feltmb.fit.noise import Noise, noise_of
from feltmb.fit.observe import observe_whole
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import FitSettings, finish
from feltmb.gap.advise import confused_groups, confusion_at
from feltmb.gap.checks import faults_against, with_sigma
from feltmb.gap.criteria import DETECTABLE, WORTH_TELLING
from feltmb.gap.measured import open_effects
from feltmb.gap.score import Scores, all_candidates, score_fit
from feltmb.gap.smoke_test import try_effects

__all__ = [
    "Experiment",
    "Plan",
    "Planned",
    "noncentrality",
    "plan",
    "planned",
    "planned_scores",
]


@dataclass(frozen=True, kw_only=True)
class Planned:
    """Information of planned records about one effect."""

    effect: str
    component: str
    unit: str
    scale: float
    smallest: float
    """Smallest detectable magnitude [unit]; inf: not detectable."""
    surviving: float
    """Share of its signature (amplitude) that parameters and nuisances cannot imitate [1]."""
    rival: str
    """Effect with which it would most often be confused."""
    confusion: float
    """Probability of this confusion, at the larger of its scale and its smallest detectable
    magnitude [1]."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A further record or sensor, and its benefit."""

    name: str
    kind: str
    """"record" or "sensor"."""
    worst: float
    """Largest remaining confusion [1]."""
    mean: float
    """Mean over the effects of their largest confusion [1]."""
    gains: tuple[tuple[str, str, float, float], ...]
    """Pairs that it separates: (effect, rival, confusion before, after), largest gain first."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Result of :func:`plan`."""

    effects: tuple[Planned, ...]
    classes: tuple[tuple[str, ...], ...]
    """Effects that cannot be distinguished (confusion above one in ten)."""
    unseen: tuple[str, ...]
    """Effects without a signature of their own."""
    names: tuple[str, ...]
    confusion: tuple[tuple[float, ...], ...]
    """Probability of mistaking one effect for another, in the order of ``names``."""
    experiments: tuple[Experiment, ...]
    """Ranked, the best first."""


def planned(
    model: Model,
    record: Record,
    sensors: Mapping[str, Sensor],
    theta: Array | None = None,
) -> Record:
    """The record with the outputs of the model, without noise.

    ``theta``: parameters; None: their prior values.
    """
    prior = {} if record.start is None else record.start.mean
    start = np.array([prior.get(s.name, s.start) for s in model.states()])
    if theta is None:
        theta = np.array([p.value for p in model.parameters])
    names = [n for n in model.outputs if n in sensors]
    bare = replace(record, outputs={n: np.zeros(record.samples) for n in names}, sensors=sensors)
    outputs = observe_whole(model, bare, theta, start)
    columns = {n: outputs[:, model.outputs.index(n)] for n in names}
    for name, column in columns.items():
        if not np.all(np.isfinite(column)):
            raise InvalidParameter(f"record {record.name}: {name} could not be simulated")
    return replace(bare, outputs=columns)


def _noise(record: Record) -> dict[str, Noise]:
    out = {}
    for name, sensor in record.sensors.items():
        sigma = sensor.sigma
        if sigma is None:
            # Nothing is known: the noise is assumed to be a thousandth of the range of the output.
            sigma = 1e-3 * (float(np.std(record.outputs[name])) or 1.0)
        out[name] = noise_of(sensor, sigma, sensor.quantum)
    return out


def planned_scores(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    *,
    segment: float | None = None,
) -> Scores:
    """Score matrices of records that contain the outputs of the model."""
    segmented_records = tuple(segment_record(model, r, _noise(r), segment) for r in records)
    problem = Problem(model, segmented_records)
    point = problem.start()
    gap_sd = FitSettings().levels[-1] * problem.scale(point)
    fit = finish(problem, point, FitSettings().levels[-1], gap_sd)
    return score_fit(fit, all_candidates(effects))


def _best_shapes(scores: Scores) -> list[int]:
    """One candidate for each effect, with its most detectable shape."""
    out: dict[str, int] = {}
    for i, t in enumerate(scores.candidates):
        if t.name not in out or scores.strength[i] > scores.strength[out[t.name]]:
            out[t.name] = i
    return list(out.values())


def _matrix(scores: Scores, index: list[int]) -> Array:
    magnitudes = np.maximum(1.0, DETECTABLE / np.maximum(scores.strength, 1e-300))
    chance = confusion_at(scores, np.where(scores.testable, magnitudes, 0.0))
    return np.asarray(chance[np.ix_(index, index)])


@checked
def plan(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    *,
    channels: Sequence[str] | None = None,
    sensors: Mapping[str, Sensor] | None = None,
    experiments: Sequence[Record] = (),
    segment: float | None = None,
) -> Plan:
    """Compute which effects planned records could detect, from the model alone.

    Parameters
    ----------
    records
        Planned runs: their inputs and clock count, their outputs do not.
    channels
        Outputs that will be measured; default: those of the records.
    sensors
        Sensors by output, also of outputs that are not among the channels: these are offered as
        further sensors. An output without a sensor gets a noise of a thousandth of its range.
    experiments
        Further runs that could be made.
    """
    if not records:
        raise InvalidParameter("plan: no planned records; give inputs over time")
    wanted = list(channels) if channels is not None else list(records[0].outputs)
    unknown = [c for c in wanted if c not in model.outputs]
    if unknown or not wanted:
        raise InvalidParameter(
            f"channels: {', '.join(unknown) or 'none'} is no output of {model.name}; "
            f"there are {', '.join(model.outputs)}"
        )
    faults = faults_against(model, [*records, *experiments])
    if faults:
        raise DataError("plan: " + "; ".join(faults))
    known = dict(sensors or {})
    for r in records:
        for n, s in r.sensors.items():
            known.setdefault(n, s)
    tested = open_effects(effects, model)
    with calling(f"model {model.name}: its simulation"):
        model, records, experiments = _ready(model, records, experiments, known)
    try_effects(model, tested, records[0])

    def plan(some: Sequence[Record], names: Sequence[str]) -> list[Record]:
        seen = {n: known.get(n, Sensor(name=n)) for n in names}
        return [planned(model, r, seen) for r in some]

    now = planned_scores(model, tested, plan(records, wanted), segment=segment)
    index = _best_shapes(now)
    names = [now.candidates[i].name for i in index]
    matrix = _matrix(now, index)
    rows = []
    for k, i in enumerate(index):
        candidate = now.candidates[i]
        seen = bool(now.testable[i])
        rival = int(np.argmax(matrix[k])) if len(index) > 1 else k
        rows.append(
            Planned(
                effect=candidate.name,
                component=candidate.effect.component,
                unit=candidate.effect.unit,
                scale=candidate.effect.scale,
                smallest=float(DETECTABLE * candidate.effect.scale / now.strength[i])
                if seen
                else np.inf,
                surviving=float(np.sqrt(now.gram[i, i] / now.raw[i])) if seen else 0.0,
                rival=names[rival] if len(index) > 1 and seen else "",
                confusion=float(matrix[k, rival]) if seen else 0.5,
            )
        )
    options = [(r.name, "record", [*records, r], wanted) for r in experiments]
    options += [
        (n, "sensor", list(records), [*wanted, n]) for n in model.outputs if n not in wanted
    ]
    gained = []
    for name, kind, some, outputs in options:
        then = planned_scores(model, tested, plan(some, outputs), segment=segment)
        best = _best_shapes(then)
        after = _matrix(then, best)
        pairs = [
            (names[a], names[b], float(matrix[a, b]), float(after[a, b]))
            for a in range(len(names))
            for b in range(a)
            if matrix[a, b] - after[a, b] > WORTH_TELLING
        ]
        pairs.sort(key=lambda p: -(p[2] - p[3]))
        gained.append(
            Experiment(
                name=name,
                kind=kind,
                worst=float(np.max(after)) if after.size else 0.0,
                mean=float(np.mean(np.max(after, axis=1))) if after.size else 0.0,
                gains=tuple(pairs[:8]),
            )
        )
    gained.sort(key=lambda e: (e.mean, e.worst, e.name))
    rows.sort(key=lambda r: (r.smallest / r.scale, r.effect))
    return Plan(
        effects=tuple(rows),
        classes=confused_groups(names, matrix),
        unseen=tuple(n for n, i in zip(names, index, strict=True) if not now.testable[i]),
        names=tuple(names),
        confusion=tuple(tuple(float(v) for v in row) for row in matrix),
        experiments=tuple(gained),
    )


def _ready(
    model: Model,
    records: Sequence[Record],
    experiments: Sequence[Record],
    known: Mapping[str, Sensor],
) -> tuple[Model, Sequence[Record], Sequence[Record]]:
    """The model and all runs, prepared as for a fit, with the predicted outputs."""
    sensors = {n: known.get(n, Sensor(name=n)) for n in model.outputs}
    shown = []
    for r in (*records, *experiments):
        full = planned(model, r, sensors)
        shown.append(with_sigma(full, _noise(full)))
    ready = model.ready(shown)
    count = len(records)
    return ready.model, ready.records[:count], ready.records[count:]


@checked
def noncentrality(
    model: Model, effect: Effect, magnitude: float, records: Sequence[Record]
) -> float:
    """Expected square root of T for an effect of a given magnitude, with these records.

    The inputs and sensors of the records are used, and the most detectable shape.

    Parameters
    ----------
    model
        Model with its parameters.
    effect
        Effect whose detectability is computed.
    magnitude
        Magnitude of the effect [unit of the effect].
    records
        Records, measured or planned.
    """
    if not records:
        raise InvalidParameter("noncentrality: no planned records; give inputs over time")
    plans = [planned(model, r, r.sensors) for r in records]
    scores = planned_scores(model, [effect], plans)
    return float(np.max(np.where(scores.testable, scores.strength, 0.0)) * magnitude / effect.scale)
