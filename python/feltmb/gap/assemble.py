"""Builds the rows of the report from the results of the stages of the diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from feltmb.data import Array
from feltmb.fit.model import Model
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit
from feltmb.gap.acceptance import Accepted, Posterior
from feltmb.gap.calibrate import Null
from feltmb.gap.confusion import confused_groups, confusion_if_detected
from feltmb.gap.criteria import DETECTABLE
from feltmb.gap.findings import (
    Closest,
    GapRow,
    HowFar,
    ModelWithEffects,
    Ranked,
    RankedSet,
    Which,
)
from feltmb.gap.proof import Outcome
from feltmb.gap.search import Search
from feltmb.gap.sizes import Sizes, shape_numbers, where_refitted

__all__ = ["closest_set", "how_far_rows", "ranked", "with_effects"]


def with_effects(
    model: Model, fit: Fit, starts: Mapping[str, Array], provenance: str
) -> ModelWithEffects:
    """The model with the parameters and magnitudes of a fit."""
    return ModelWithEffects(
        original=model,
        theta=fit.point.theta,
        included=fit.included,
        magnitudes=fit.point.magnitudes,
        starts=starts,
        provenance=provenance,
    )


def closest_set(
    search: Search,
    accepted: Accepted,
    segmented_records: Sequence[SegmentedRecord],
    which: str,
    seed: int,
) -> Closest | None:
    """The tested set with the smallest held-out gap; None: the model itself has the smallest."""
    before = accepted.before.gap(segmented_records, which)
    found: tuple[float, Outcome] | None = None
    for key, outcome in accepted.outcomes.items():
        gap = outcome.gap(segmented_records, which)
        if key and gap < (before if found is None else found[0]):
            found = gap, outcome
    if found is None:
        return None
    outcome = found[1]
    included = outcome.fit.included
    closed, low, high = _closed(accepted.before, outcome, segmented_records, which, seed)
    rejected = dict(accepted.rejected)
    why = "; ".join(f"{t.name}: {rejected[t.name]}" for t in included if t.name in rejected)
    if not why and search.best is None:
        why = "an unknown force would explain the fitted records better"
    return Closest(
        effects=tuple(t.name for t in included),
        magnitudes=tuple(float(m) for m in outcome.fit.point.magnitudes),
        units=tuple(t.effect.unit for t in included),
        closed=closed,
        low=low,
        high=high,
        gap=before,
        why=why,
    )


def ranked(
    search: Search,
    accepted: Accepted,
    belief: Posterior,
    null: Null,
    named: Sequence[str],
    one_of: Sequence[str],
    sizes: Sizes,
) -> Which:
    """Effects and sets, sorted by posterior probability."""
    reference = search.scores  # those of the null distribution
    magnitudes, single, robust = reference.one_step(), reference.singles(), reference.robust()
    strength = reference.strength
    names = list(dict.fromkeys(t.name for t in reference.candidates))
    weights = _by_effect(names, search, belief)
    # Refused effects keep their order.
    order = _by_effect(names, search, accepted.belief)
    classes = _classes(search)
    member = {n: c for c in classes for n in c}
    rows = []
    for name in names:
        own = [i for i, t in enumerate(reference.candidates) if t.name == name]
        i = max(own, key=lambda j: (single[j], strength[j]))
        candidate = reference.candidates[i]
        scale = candidate.effect.scale
        refitted = where_refitted(search, accepted, name)
        size = magnitudes[i] * scale
        sd = scale / strength[i] if strength[i] > 0.0 else np.inf
        shape = candidate.shape
        wide: Mapping[int, float] = {}
        if refitted is not None:
            k = refitted.names.index(name)
            shape = refitted.fit.included[k].shape
            size = float(refitted.fit.point.magnitudes[k])
            # Uncertain shapes cost simulations, and are worth them for these effects only.
            told = sizes.of(name, shapes=name in named or name in one_of)
            assert told is not None
            sd, wide = told.sd, told.shape_sd
        low, high = candidate.effect.bounds
        confused = tuple(n for n in member.get(name, ()) if n != name)
        rows.append(
            Ranked(
                effect=name,
                component=candidate.effect.component,
                mechanism=candidate.effect.mechanism,
                kind=candidate.effect.kind,
                unit=candidate.effect.unit,
                shape=shape,
                magnitude=float(size),
                sd=float(sd),
                low=float(max(size - 1.96 * sd, low)),
                high=float(min(size + 1.96 * sd, high)),
                refitted=refitted is not None,
                statistic=float(single[i]),
                robust=float(robust[i]),
                p=null.p(float(single[i])),
                posterior=float(min(weights[name], 1.0)),
                noncentrality=float(strength[i]),
                smallest=float(DETECTABLE * scale / strength[i]) if strength[i] > 0.0 else math.inf,
                confusable=confused,
                named=name in named,
                converged=refitted is None or not refitted.fit.cut,
                remedy=candidate.effect.remedy,
                numbers=shape_numbers(candidate.effect, shape, wide),
            )
        )
    # Rounding must not determine the order of equal probabilities.
    rows.sort(
        key=lambda r: (
            not r.named,
            r.effect not in one_of,
            -round(order[r.effect], 9),
            -r.statistic,
            r.effect,
        )
    )
    sets = tuple(
        RankedSet(
            effects=c.names,
            magnitudes=tuple(float(s) for s in c.fit.point.magnitudes),
            statistic=float(search.model_fit.chi2 - c.fit.chi2),
            evidence=float(c.evidence - search.model_evidence),
            posterior=w,
            refitted=True,
        )
        for c, w in zip(search.sets, belief.sets, strict=True)
    )
    return Which(
        effects=tuple(rows),
        sets=sets,
        none=belief.none,
        other=belief.other,
        classes=classes,
        form=sizes.form,
    )


def _by_effect(names: Sequence[str], search: Search, belief: Posterior) -> dict[str, float]:
    """Probability of each effect: that of all sets with it together."""
    weights = {n: 0.0 for n in names}
    for one, weight in zip(search.sets, belief.sets, strict=True):
        for n in one.names:
            weights[n] += weight
    return weights


def _classes(search: Search) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that are confused with each other, at fitted or detectable magnitudes."""
    scores = search.tight if search.tight is not None else search.scores
    magnitudes = scores.one_step()
    for best in search.sets[:1]:
        for candidate, size in zip(best.fit.included, best.fit.point.magnitudes, strict=True):
            for i, t in enumerate(scores.candidates):
                if t.name == candidate.name:
                    magnitudes[i] = float(size) / t.effect.scale
    names = [c.name if ok else "" for c, ok in zip(scores.candidates, scores.testable, strict=True)]
    gram = np.where(np.outer(scores.testable, scores.testable), scores.gram, 0.0)
    return confused_groups(names, confusion_if_detected(gram, magnitudes))


def _per_channel(
    outcome: Outcome, segmented_records: Sequence[SegmentedRecord], which: str, c: int
) -> list[Array]:
    """Residual of a channel by segmented record; missing samples are omitted."""
    out = []
    for segmented, residual in zip(segmented_records, getattr(outcome, which), strict=True):
        name = outcome.fit.problem.model.outputs[c]
        if name in segmented.record.outputs:
            measured = np.isfinite(segmented.record.outputs[name])
            out.append(np.where(np.isfinite(residual[measured, c]), residual[measured, c], np.inf))
    return out


def _rms(parts: Sequence[Array]) -> float:
    total = sum(float(np.sum(p**2)) for p in parts)
    return float(np.sqrt(total / max(sum(p.size for p in parts), 1)))


def _speed(part: Array, segmented: SegmentedRecord) -> Array:
    """Time derivative of a residual after a short moving average."""
    width = max(3, int(segmented.measured.shape[1] // 12) | 1)
    if part.size < 3 * width:
        return np.zeros(0)
    smooth = np.convolve(part, np.ones(width) / width, mode="valid")
    return np.asarray((smooth[width:] - smooth[:-width]) / (width * segmented.record.interval))


def how_far_rows(
    accepted: Accepted,
    tabulated: Outcome,
    segmented_records: Sequence[SegmentedRecord],
    shares: Mapping[str, float],
    primary: str,
    seed: int,
) -> HowFar:
    """Gap on held-out data by metric and channel: tabulated, calibrated, and with effects."""
    before, after = accepted.before, accepted.after
    outputs = before.fit.problem.model.outputs
    rows = []
    for metric, which in (("segmented", "segmented"), ("open loop", "open_loop")):
        for c, name in enumerate(outputs):
            units = [
                s.record.sensors[name].unit for s in segmented_records if name in s.record.sensors
            ]
            if not units:
                continue
            old = _per_channel(before, segmented_records, which, c)
            if not sum(p.size for p in old):
                continue  # no held-out record has a value
            new = _per_channel(after, segmented_records, which, c)
            plain = _per_channel(tabulated, segmented_records, which, c)
            sigma = float(
                np.sqrt(
                    np.mean(
                        [s.rms_noise[c] ** 2 for s in segmented_records if name in s.record.outputs]
                    )
                )
            )
            rows.append(_gap_row(metric, name, units[0], plain, old, new, sigma, seed))
            if which == primary:
                used = [s for s in segmented_records if name in s.record.outputs]
                fast_plain = [_speed(p, s) for p, s in zip(plain, used, strict=True)]
                fast_old = [_speed(p, s) for p, s in zip(old, used, strict=True)]
                fast_new = [_speed(p, s) for p, s in zip(new, used, strict=True)]
                if sum(p.size for p in fast_old):
                    width = max(3, int(used[0].measured.shape[1] // 12) | 1)
                    noise = sigma * np.sqrt(2.0 / width) / (width * used[0].record.interval)
                    fast = fast_plain, fast_old, fast_new
                    rows.append(_gap_row("speed", name, f"{units[0]}/s", *fast, noise, seed))
    start, end = before.gap(segmented_records, primary), after.gap(segmented_records, primary)
    first = tabulated.gap(segmented_records, primary)
    waterfall = [("as tabulated", first)]
    if math.isfinite(first) and math.isfinite(start):
        waterfall.append(("calibration", start - first))
    waterfall += [(n, -v) for n, v in sorted(shares.items(), key=lambda kv: -kv[1])]
    waterfall += [("unexplained", max(end - 1.0, 0.0)), ("noise", min(1.0, end))]
    closed, low, high = _closed(before, after, segmented_records, primary, seed)
    per_record = {}
    for i, s in enumerate(segmented_records):
        per_record[s.record.name] = (
            before.gap(segmented_records, primary, i),
            after.gap(segmented_records, primary, i),
        )
    return HowFar(
        rows=tuple(rows),
        waterfall=tuple(waterfall),
        waterfall_unit="noise standard deviations",
        tabulated=first,
        before=start,
        after=end,
        metric=primary.replace("_", " "),
        closed=closed,
        low=low,
        high=high,
        records=tuple(s.record.name for s in segmented_records),
        per_record=per_record,
    )


def _fraction(old: float, new: float, noise: float) -> float:
    """Closed share of the gap above the noise; a residual below the noise is no more than closed.

    Such residuals occur: start states and nuisance parameters also fit some of the noise.
    """
    if not (np.isfinite(old) and np.isfinite(new)) or old <= noise:
        return 0.0
    return (old - max(new, noise)) / (old - noise)


def _blocks(parts: Sequence[Array], size: int) -> Array:
    """Sum of squares and number of samples of each block, (blocks, 2)."""
    out = []
    for p in parts:
        for at in range(0, p.size, size):
            chunk = p[at : at + size]
            out.append((float(np.sum(chunk**2)), float(chunk.size)))
    return np.array(out)


def _draws(old: Array, new: Array, noise: float, seed: int) -> tuple[float, float, float]:
    """95 % interval of the closed fraction and one-sided p, by block bootstrap."""
    generator = np.random.default_rng(seed)
    index = generator.integers(0, len(old), size=(1000, len(old)))
    size = np.sum(old[index, 1], axis=1)
    a = np.sqrt(np.sum(old[index, 0], axis=1) / size)
    b = np.sqrt(np.sum(new[index, 0], axis=1) / size)
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = np.where(a > noise, (a - np.maximum(b, noise)) / (a - noise), 0.0)
    low, high = np.quantile(np.nan_to_num(fractions), [0.025, 0.975])
    return float(low), float(high), float((1 + np.sum(b >= a)) / 1001)


def _gap_row(
    metric: str,
    channel: str,
    unit: str,
    plain: list[Array],
    old: list[Array],
    new: list[Array],
    noise: float,
    seed: int,
) -> GapRow:
    a, b = _rms(old), _rms(new)
    total = sum(p.size for p in old)
    size = max(4, total // 40)
    low = high = 0.0
    p = 1.0
    if np.isfinite(a) and np.isfinite(b):
        low, high, p = _draws(_blocks(old, size), _blocks(new, size), noise, seed)
    return GapRow(
        metric=metric,
        channel=channel,
        unit=unit,
        before=a,
        after=b,
        noise=float(noise),
        closed=_fraction(a, b, float(noise)),
        low=low,
        high=high,
        p=p,
        tabulated=_rms(plain),
    )


def _closed(
    before: Outcome,
    after: Outcome,
    segmented_records: Sequence[SegmentedRecord],
    which: str,
    seed: int,
) -> tuple[float, float, float]:
    """Closed fraction over all channels, in noise standard deviations, with its 95 % interval."""
    old: list[Array] = []
    new: list[Array] = []
    for outcome, out in ((before, old), (after, new)):
        for c, name in enumerate(before.fit.problem.model.outputs):
            own = [s for s in segmented_records if name in s.record.outputs]
            parts = _per_channel(outcome, segmented_records, which, c)
            for part, s in zip(parts, own, strict=True):
                out.append(part / s.sd[np.isfinite(s.record.outputs[name]), c])
    a, b = _rms(old), _rms(new)
    if not (np.isfinite(a) and np.isfinite(b)):
        return 0.0, 0.0, 0.0
    size = max(4, sum(p.size for p in old) // 40)
    low, high, _ = _draws(_blocks(old, size), _blocks(new, size), 1.0, seed)
    return _fraction(a, b, 1.0), low, high
