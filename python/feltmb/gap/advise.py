"""Next experiments: the run or sensor that would separate effects which the records confuse.

The model with fitted parameters predicts each experiment. Its information about the two rivals is
added to that of the existing records (:mod:`feltmb.gap.information`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Record, Sensor
from feltmb.errors import FeltmbError
from feltmb.fit.model import Candidate
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit
from feltmb.gap.acceptance import Accepted
from feltmb.gap.criteria import BETTER_SENSOR, CONFUSED, WORTH_TELLING
from feltmb.gap.findings import Advice
from feltmb.gap.information import (
    Belief,
    Information,
    Knowledge,
    continuous,
    expected_noise,
    linearized,
    of_normal,
    planned,
)
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


def advise(search: Search, accepted: Accepted) -> tuple[Advice, ...]:
    """The best of several experiments for each alternative to the accepted set."""
    best = accepted.best
    if best is None:
        return ()
    pairs = []
    for rival in accepted.rivals[:MOST_RIVALS]:
        own = [t for t in best.fit.included if t.name not in rival.names]
        other = [t for t in rival.fit.included if t.name not in best.names]
        if own and other:
            pairs.append((own[0], other[0]))
    if not pairs:
        return ()
    sizes = {n: abs(float(s)) for n, s in zip(best.names, best.fit.point.magnitudes, strict=True)}
    return _advice(_without_effects(search.tightest, best.fit), pairs, sizes)


def _without_effects(model: Fit, best: Fit) -> Fit:
    """The fit of the model, moved to the parameters of a set and to states without defects.

    Parameters that compensate a missing effect, and the defects beside it, change the signatures.
    """
    point = best.problem.carry(best.point, (), np.zeros(0))
    if model.defect_sd.size:
        point = continuous(model.problem, point)
    return replace(model, point=replace(point, memo={}))


def _advice(
    fit: Fit, pairs: Sequence[tuple[Candidate, Candidate]], sizes: Mapping[str, float]
) -> tuple[Advice, ...]:
    """Advice for each pair of a cause and its rival. ``sizes``: magnitudes of the causes [unit]."""
    problem = fit.problem
    every = tuple(t for pair in pairs for t in pair)
    normal = problem.normal(fit.point, problem.linear(fit.point, every), fit.defect_sd)
    known = of_normal(problem.model, problem, fit.point, normal, every)
    belief = Belief(weights={t.name: 1.0 for t in every}, magnitudes=sizes)
    knowledge = Knowledge.start(problem.model, every, belief, [known])
    now = _of_pairs(knowledge)
    then = []
    if max(now) >= WORTH_TELLING:
        then = [(text, _of_pairs(knowledge.plus(i))) for text, i in _experiments(fit, every)]
    out = []
    for k, (a, b) in enumerate(pairs):
        text, chance = min(((t, c[k]) for t, c in then), key=lambda x: x[1], default=("", now[k]))
        if now[k] < WORTH_TELLING:
            chance = now[k]
            text = (
                f"the noise of these records would not confuse {a.name} with {b.name}: another "
                "form of one of them, or another cause, hides the difference"
            )
        elif now[k] - chance < WORTH_TELLING:
            chance = now[k]
            text = (
                "no tested variant (the same runs again, harder, softer, faster, slower, "
                f"low-noise sensors) separates {a.name} from {b.name}: measure another point or "
                "quantity, or test one of the parts by itself"
            )
        else:
            text += (
                f": the probability of confusing {a.name} with {b.name} falls from {now[k]:.0%} "
                f"to {chance:.0%}"
            )
            if chance > CONFUSED:
                text += "; no tested experiment is better: test one of the parts by itself"
        out.append(
            Advice(
                text=text,
                separates=(a.name, b.name),
                confusion_now=now[k],
                confusion_then=chance,
            )
        )
    return tuple(out)


def _of_pairs(knowledge: Knowledge) -> list[float]:
    """Probability of mistaking each cause for its rival, the candidate after it [1]."""
    return [float(v) for v in np.diag(knowledge.confusion(), 1)[::2]]


def _experiments(fit: Fit, candidates: tuple[Candidate, ...]) -> Iterator[tuple[str, Information]]:
    """Experiments similar to the records: varied inputs, less noise, more sensors."""
    model = fit.problem.model
    for segmented in fit.problem.segmented_records:
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
            ways: dict[str, dict[str, float]] = {f"record {record.name} once more, {what}": {}}
            yield from _told(fit, segmented, changed, record.sensors, candidates, ways)
    first = fit.problem.segmented_records[0]
    name, sensors = first.record.name, first.record.sensors
    other: dict[str, dict[str, float]] = {
        f"record {name} with a third of the noise of {n}": {n: 1.0 / BETTER_SENSOR}
        for n, sensor in sensors.items()
        if n in model.outputs and sensor.sigma is not None
    } | {
        f"record {name} with {n} measured as well": {n: 1.0}
        for n in model.outputs
        if n not in first.record.outputs
    }
    further = {n: Sensor(name=n) for n in model.outputs} | dict(sensors)
    yield from _told(fit, first, first.record, further, candidates, other)


def _told(
    fit: Fit,
    like: SegmentedRecord,
    record: Record,
    sensors: Mapping[str, Sensor],
    candidates: tuple[Candidate, ...],
    ways: Mapping[str, Mapping[str, float]],
) -> Iterator[tuple[str, Information]]:
    """Information of a planned record by each way to measure it; none if it cannot be simulated.

    ``ways``: outputs with another noise than in the record ``like``, in multiples of it.
    """
    model = fit.problem.model
    try:
        expected = planned(model, record, sensors, fit.point.theta)
    except FeltmbError:
        return
    present = dict.fromkeys(like.record.outputs, 1.0)
    noise = expected_noise(expected) | {n: like.noise[model.outputs.index(n)] for n in present}
    found = linearized(
        model,
        expected,
        candidates,
        [{**present, **way} for way in ways.values()],
        theta=fit.point.theta,
        noise=noise,
        level=fit.level,
    )
    yield from zip(ways, found or (), strict=False)
