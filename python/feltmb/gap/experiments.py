"""Next experiments: the run or sensor that would separate effects which the records confuse.

The model with fitted parameters predicts each experiment. Its contribution to the signatures of the
two rivals is added to the contribution of the existing records:

    G = E' M E over all rows,   P(confuse) = Phi(-1/2 |e_a - e_b| phi)   (see feltmb.gap.advise)

Only the normal equations of the new run are computed; those of the records are reused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array, Record, Sensor
from feltmb.errors import FeltmbError
from feltmb.fit.model import Candidate, Model
from feltmb.fit.problem import Normal, Point, solve_scaled
from feltmb.fit.segmented_records import Noise, SegmentedRecord, segment_record
from feltmb.fit.solve import Fit
from feltmb.gap.acceptance import Accepted
from feltmb.gap.advise import confused
from feltmb.gap.criteria import BETTER_SENSOR, CONFUSED, WORTH_TELLING
from feltmb.gap.findings import Advice
from feltmb.gap.planning import planned
from feltmb.gap.search import Search

__all__ = ["advise"]

#: Number of rivals that get advice.
MOST_RIVALS = 3
#: Variations of a record: name, factor of the inputs, factor of the time.
WAYS = (
    ("the same again", 1.0, 1.0),
    ("half the input", 0.5, 1.0),
    ("twice the input", 2.0, 1.0),
    ("twice as fast", 1.0, 0.5),
    ("half as fast", 1.0, 2.0),
)


@dataclass(frozen=True)
class _Attempt:
    """An experiment and the confusion that would remain after it."""

    text: str
    then: float


def advise(search: Search, accepted: Accepted) -> tuple[Advice, ...]:
    """The best of several experiments for each alternative to the accepted set."""
    best = accepted.best
    if best is None:
        return ()
    fit = search.tight_fit or search.model_fit
    out = []
    for rival in accepted.rivals[:MOST_RIVALS]:
        own = [t for t in best.fit.included if t.name not in rival.names]
        other = [t for t in rival.fit.included if t.name not in best.names]
        if not own or not other:
            continue
        a, b = own[0], other[0]
        size = float(best.fit.point.magnitudes[best.names.index(a.name)])
        out.append(_advice(fit, a, b, abs(size)))
    return tuple(out)


def _advice(fit: Fit, a: Candidate, b: Candidate, size: float) -> Advice:
    base = fit.problem.normal(fit.point, fit.problem.linear(fit.point, (a, b)), fit.gap_sd)
    shared = _eliminated(base)
    now = _confusion(shared, a, b, size)
    if now < WORTH_TELLING:
        text = (
            f"the noise of these records would not confuse {a.name} with {b.name}: another form of "
            "one of them, or another cause, hides the difference"
        )
        return Advice(text=text, separates=(a.name, b.name), confusion_now=now, confusion_then=now)
    trials = []
    for text, segmented in _plans(fit):
        more = _of_one(fit, segmented, (a, b))
        if more is not None:
            trials.append(_Attempt(text, _confusion(shared + more, a, b, size)))
    chosen = min(trials, key=lambda t: t.then, default=None)
    if chosen is None or now - chosen.then < WORTH_TELLING:
        text = (
            "no tested variant (the same runs again, harder, softer, faster, slower, "
            f"low-noise sensors) separates {a.name} from {b.name}: measure another point or "
            "quantity, or test one of the parts by itself"
        )
        return Advice(text=text, separates=(a.name, b.name), confusion_now=now, confusion_then=now)
    text = (
        f"{chosen.text}: the probability of confusing {a.name} with {b.name} falls from "
        f"{now:.0%} to {chosen.then:.0%}"
    )
    if chosen.then > CONFUSED:
        text += "; no tested experiment is better: test one of the parts by itself"
    return Advice(
        text=text, separates=(a.name, b.name), confusion_now=now, confusion_then=chosen.then
    )


def _plans(fit: Fit) -> Iterator[tuple[str, SegmentedRecord]]:
    """Experiments similar to the records: varied inputs, less noise, more sensors."""
    model = fit.problem.model
    segmented_records = fit.problem.segmented_records
    for segmented in segmented_records:
        record = segmented.record
        for what, strength, stretch in WAYS:
            if record.input_mode == "motion" and strength != 1.0:
                continue  # a displacement is limited by stops: it can be made faster but not larger
            changed = replace(
                record,
                name=f"{record.name}, {what}",
                time=record.time[0] + (record.time - record.time[0]) * stretch,
                inputs={k: v * strength for k, v in record.inputs.items()},
            )
            seen = _predicted(fit, segmented, changed, record.sensors)
            if seen is not None:
                yield f"record {record.name} once more, {what}", seen
    first = segmented_records[0]
    for name, sensor in first.record.sensors.items():
        if name not in model.outputs or sensor.sigma is None:
            continue
        better = {**first.record.sensors, name: replace(sensor, sigma=sensor.sigma / BETTER_SENSOR)}
        seen = _predicted(fit, first, first.record, better)
        if seen is not None:
            yield f"record {first.record.name} with a third of the noise of {name}", seen
    for name in model.outputs:
        if name not in first.record.outputs:
            further = {**first.record.sensors, name: Sensor(name=name)}
            seen = _predicted(fit, first, first.record, further)
            if seen is not None:
                yield f"record {first.record.name} with {name} measured as well", seen


def _predicted(
    fit: Fit, like: SegmentedRecord, record: Record, sensors: Mapping[str, Sensor]
) -> SegmentedRecord | None:
    """Prediction of the experiment by the fitted model; None if it cannot be simulated."""
    model: Model = fit.problem.model
    try:
        plan = planned(model, record, sensors, fit.point.theta)
    except FeltmbError:
        return None
    noise = {
        n: like.noise[model.outputs.index(n)]
        if n in like.record.outputs
        else Noise(1e-3 * (float(np.std(plan.outputs[n])) or 1.0))
        for n in plan.outputs
    }
    for name, sensor in plan.sensors.items():
        before = like.record.sensors.get(name)
        if before is not None and sensor.sigma is not None and before.sigma:
            share = sensor.sigma / before.sigma
            noise[name] = replace(noise[name], sigma=noise[name].sigma * share)
    return segment_record(model, plan, noise, None, like.segments)


def _of_one(
    fit: Fit, segmented: SegmentedRecord, included: tuple[Candidate, Candidate]
) -> Array | None:
    """Normal equations of one planned run for the parameters and the two effects."""
    problem = replace(fit.problem, segmented_records=(segmented,), included=(), store=None)
    point: Point = problem.start(theta=fit.point.theta)
    gap_sd = fit.level * problem.scale(point)
    normal = problem.normal(point, problem.linear(point, included), gap_sd)
    reduced = _eliminated(normal)
    for c, i in enumerate(problem.free):  # the records already contain the priors
        sd = problem.model.parameters[i].sd
        if np.isfinite(sd):
            reduced[c, c] -= 1.0 / sd**2
    return reduced if np.all(np.isfinite(reduced)) else None


def _eliminated(normal: Normal) -> Array:
    """Matrix of the shared parameters; the sensor nuisances of the records are projected out."""
    own, rest = slice(0, normal.shared), slice(normal.shared, None)
    matrix = normal.matrix
    if matrix.shape[0] == normal.shared:
        return np.array(matrix)
    coupling = matrix[rest, own]
    absorbed = solve_scaled(matrix[rest, rest], coupling)
    return np.asarray(matrix[own, own] - coupling.T @ absorbed)


def _confusion(matrix: Array, a: Candidate, b: Candidate, size: float) -> float:
    """Probability of mistaking a for b at a magnitude of a [its unit]; the two last globals."""
    at = matrix.shape[0] - 2
    s, e = slice(0, at), slice(at, None)
    absorbed = solve_scaled(matrix[s, s], matrix[s, e])
    scale = np.array([a.effect.scale, b.effect.scale])
    gram = (matrix[e, e] - matrix[s, e].T @ absorbed) * np.outer(scale, scale)
    return float(confused(gram, np.array([size / scale[0], 0.0]))[0, 1])
