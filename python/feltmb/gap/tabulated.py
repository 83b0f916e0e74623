"""The model with its tabulated values, and the changes by calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from feltmb.data import Array
from feltmb.fit.model import Model, Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import (
    NOT_CONVERGED,
    Fit,
    FitSettings,
    Interval,
    chained,
    estimate_states,
    polish,
)
from feltmb.fit.watch import current
from feltmb.gap.criteria import MOVED, TOLERATED
from feltmb.gap.digits import digits
from feltmb.gap.findings import AsItIs, Calibrated, GivenValue
from feltmb.gap.proof import Outcome, one_run, residuals_by_segment
from feltmb.gap.spread import Spread
from feltmb.gap.tolerance import beyond_tolerance, of_the_machine, sd_of_change
from feltmb.units import readable_unit, unit_suffix

__all__ = [
    "as_it_is",
    "calibrated_rows",
    "fitted_starts",
    "found_starts",
    "given_values",
    "moved_together",
    "of_the_machine",
    "outcome_at",
    "tabulated_outcome",
    "unknown_starts",
]

#: If the prior standard deviation of a start state exceeds this share of its scale, the start is
#: estimated first.
KNOWN_START = 0.3
#: Number of parameters whose share of the gap is computed; each costs two simulations of the
#: records.
SHARED = 16


def tabulated_outcome(
    model: Model,
    segmented_records: Sequence[SegmentedRecord],
    settings: FitSettings,
) -> Outcome:
    """The model with its tabulated values on records, before any fit.

    Start states and sensor nuisances are not parameters of the machine. They are estimated, as for
    every model that is compared. Effects are not included.
    """
    theta = np.array([p.value for p in model.parameters], dtype=np.float64)
    return outcome_at(model, segmented_records, theta, settings)


def outcome_at(
    model: Model,
    segmented_records: Sequence[SegmentedRecord],
    theta: Array,
    settings: FitSettings,
) -> Outcome:
    """The model with given parameters on records; start states and nuisances are estimated."""
    problem = Problem(model, tuple(segmented_records), frozen=True)
    point = problem.start(theta=theta)
    tightest = settings.levels[-1]
    quick = settings.coarser(0.3, iterations=8)
    if model.states():
        if not np.any(unknown_starts(problem)):
            point = chained(problem, point)  # one simulation gives the gap
        else:
            point = estimate_states(problem, point, tightest)
    fit = polish(problem, point, tightest, replace(quick, chain=True))
    return Outcome(fit, settings.coarser(0.3), fit)


def unknown_starts(problem: Problem) -> NDArray[np.bool_]:
    """States whose start one of the records knows too badly to simulate from it, (nx,)."""
    most = KNOWN_START * np.array([s.scale for s in problem.model.states()])
    sds = np.array([problem.start_prior(s)[1] for s in problem.segmented_records])
    return np.asarray(np.any(sds > most, axis=0))


def as_it_is(outcome: Outcome, which: str) -> tuple[AsItIs, ...]:
    """The gap of a model in each channel, all records together."""
    segmented_records = outcome.fit.problem.segmented_records
    rows = []
    for c, name in enumerate(outcome.fit.problem.model.outputs):
        own = [
            (s, r)
            for s, r in zip(segmented_records, getattr(outcome, which), strict=True)
            if name in s.record.outputs
        ]
        if not own:
            continue
        rest, spread, noise, failed = [], [], [], []
        for s, r in own:
            measured = s.record.outputs[name]
            known = np.isfinite(measured)
            if not known.any():
                continue
            rest.append(r[known, c])
            spread.append(measured[known] - np.mean(measured[known]))
            noise.append(s.sd[known, c])
            if not np.all(np.isfinite(r[known, c])):
                failed.append(s.record.name)
        if not rest:
            continue
        gap = math.inf if failed else float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))
        sigma = float(np.sqrt(np.mean(np.concatenate(noise) ** 2)))
        rows.append(
            AsItIs(
                channel=name,
                unit=own[0][0].record.sensors[name].unit,
                gap=gap,
                noise=sigma,
                multiple=gap / sigma,
                spread=float(np.sqrt(np.mean(np.concatenate(spread) ** 2)))
                if max(x.size for x in spread) > 1
                else math.nan,
                failed=tuple(failed),
            )
        )
    return tuple(rows)


def moved_together(fit: Fit, wide: Spread, alpha: float) -> bool:
    """Whether the fit changed the parameters, jointly, by more than noise and errors of form would.

    A Wald test of the tabulated values with the posterior covariance. If they are the true ones, a
    direction that the records determine counts as one degree of freedom, and one that only its
    prior determines as none. The statistic is then a sum of chi-square variables weighted with
    the contraction of each direction. Its distribution is approximated by that of Satterthwaite
    (1946), a scaled chi-square with equal mean and variance. Parameters of run-to-run variability
    are not properties of the machine and are omitted.
    """
    rows = of_the_machine(fit, wide)
    interval = np.array([_deviations(i) for _, _, _, i in rows])
    sd = np.array([i.sd for _, _, _, i in rows])
    known = np.isfinite(sd) & (sd > 0.0)
    if not known.any():
        return False
    at = np.array([k for k, _, _, _ in rows])[known]
    correlation = wide.total[np.ix_(at, at)] / np.outer(sd[known], sd[known])
    values, vectors = np.linalg.eigh(correlation)
    kept = values > 1e-9 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    statistic = float(np.sum((root.T @ interval[known] / values[kept]) ** 2))
    by_prior = (sd / np.array([p.sd for _, _, p, _ in rows]))[known]
    weight = np.clip(1.0 - np.linalg.eigvalsh(root.T * by_prior**2 @ root), 0.0, 1.0)
    square = float(weight @ weight)
    if not square > 0.0:
        return False
    scale = square / float(np.sum(weight))
    freedom = float(np.sum(weight)) ** 2 / square
    return bool(stats.chi2.sf(statistic / scale, freedom) < alpha)


def calibrated_rows(
    fit: Fit,
    wide: Spread,
    before: Sequence[Outcome],
    after: Sequence[Outcome],
    which: str,
    alpha: float,
) -> tuple[Calibrated, ...]:
    """Parameters that a fit changed by more than two posterior deviations, largest share first.

    Parameters
    ----------
    fit, wide
        A fit and its uncertainty.
    before, after
        The model with tabulated and with fitted values, on the records whose gap is divided among
        the parameters. These are all records, because a parameter may have little influence on the
        held-out ones. ``before`` contains the tolerances.
    alpha
        Family-wise probability that noise alone changes one of the parameters this much.
    """
    told = before[0].fit.problem.model.parameters
    rows = [(i, told[i], interval) for _, i, _, interval in of_the_machine(fit, wide)]
    bar = float(stats.norm.isf(0.5 * alpha / max(len(rows), 1)))
    moved = [r for r in rows if abs(_deviations(r[2])) > MOVED]
    moved.sort(key=lambda r: -abs(_deviations(r[2])))
    shares = _shares([i for i, _, _ in moved[:SHARED]], fit, before, after, which)
    out = [
        _row(p, interval, shares.get(i, math.nan), sure=abs(_deviations(interval)) > bar)
        for i, p, interval in moved
    ]
    out.sort(key=lambda r: (math.isnan(r.share), -(0.0 if math.isnan(r.share) else r.share)))
    return tuple(out)


def _deviations(interval: Interval) -> float:
    """Distance from the tabulated value in posterior standard deviations."""
    return (interval.value - interval.prior) / max(interval.sd, 1e-300)


def _row(p: Parameter, interval: Interval, share: float, *, sure: bool) -> Calibrated:
    alone, alone_sd = _alone(p, interval)
    far = (interval.value - interval.prior) / p.sd if np.isfinite(p.sd) else None
    row = Calibrated(
        name=p.name,
        component=p.component,
        part=p.label or p.component or p.name,
        unit=p.unit,
        tabulated=interval.prior,
        value=interval.value,
        sd=interval.sd,
        low=interval.low,
        high=interval.high,
        deviations=_deviations(interval),
        prior_deviations=far,
        at_limit=interval.at_limit,
        share=share,
        sure=sure,
        origin="tabulated" if p.before is None else "measured",
        alone=alone,
        alone_sd=alone_sd,
        beyond=far is not None and beyond_tolerance(interval, p.sd),
        converged=interval.converged,
    )
    return replace(row, text=_text(p, row))


def _alone(p: Parameter, interval: Interval) -> tuple[float, float]:
    """Estimate from the records alone if the tolerance holds a parameter back; else NaN."""
    seen = interval.contraction
    if not (0.0 < interval.prior_sd < math.inf and seen > 0.0):
        return math.nan, math.nan
    moved = interval.value - interval.prior
    alone = float(np.clip(interval.prior + moved / seen, p.lower, p.upper))
    far = abs(moved) > MOVED * sd_of_change(interval, interval.prior_sd)
    if not far or interval.low <= alone <= interval.high:
        return math.nan, math.nan
    return alone, interval.sd / math.sqrt(seen)


def _text(p: Parameter, row: Calibrated) -> str:
    """Sentence about the change of a parameter."""
    subject = p.label or f"Parameter {p.name}" + (f" ({p.component})" if p.component else "")
    if row.prior_deviations is None:
        unit = unit_suffix(p.unit)
        places = digits(row.value, row.sd, 3)
        about = f" ± {1.96 * row.sd:.2g}{unit}" if row.converged else f"{unit} ({NOT_CONVERGED})"
        return f"{subject} is {row.value:.{places}g}{about}, of which nothing was known before"
    change, wide = row.value - row.tabulated, 1.96 * row.sd if row.converged else math.nan
    word = p.words[change > 0.0]
    by, shown = 1.0, p.unit if p.unit != "1" else ""
    if p.relative or row.tabulated != 0.0:
        by, shown = 100.0 / (1.0 if p.relative else abs(row.tabulated)), "%"
    elif p.unit == "m":
        by, shown = 1e3, "mm"
    elif p.unit == "rad":
        by, shown = math.degrees(1.0), "deg"
    text = f"{subject} is {_amount(change * by, wide * by, shown)} {word} than {row.origin}"
    if not row.converged:
        return f"{text} ({NOT_CONVERGED})"
    if row.at_limit:
        return f"{text} (at its limit)"
    if not math.isnan(row.alone):
        alone = _amount((row.alone - row.tabulated) * by, 1.96 * row.alone_sd * by, shown)
        holds = "test" if row.origin == "measured" else "tolerance"
        text += f" (its {holds} holds it back; the records alone say {alone})"
    return text


def given_values(fit: Fit, wide: Spread, given: Model, alpha: float) -> tuple[GivenValue, ...]:
    """Tests of parts, and effects that are a part of the model, with the values of a fit.

    Parameters
    ----------
    fit, wide
        Fit of the model, and its uncertainty.
    given
        The model before the fit, which has the tests as its priors.
    alpha
        Family-wise probability that the magnitude of an effect seems to differ from zero though it
        does not.
    """
    own = {t.name for t in given.own_effects}
    bar = float(stats.norm.isf(0.5 * alpha / max(len(own), 1)))
    out = []
    for _, i, fitted, interval in of_the_machine(fit, wide):
        p = given.parameters[i]
        if p.name in own:
            differs = abs(interval.value) > bar * max(interval.sd, 1e-300)
            before = replace(p, value=0.0, sd=math.inf)
        elif p.before is not None:
            # The fit does not use the table, so that both uncertainties add.
            before = p.before
            spread = math.hypot(before.sd, interval.sd)
            differs = abs(interval.value - before.value) > TOLERATED * spread
        else:
            continue
        out.append(
            GivenValue(
                name=p.name,
                component=p.component,
                unit=p.unit,
                tabulated=before.value,
                tolerance=before.sd,
                given=p.value,
                given_sd=p.sd,
                value=interval.value,
                low=interval.low,
                high=interval.high,
                effect=p.name in own,
                differs=differs,
                refuted=p.before is not None and fitted.sd > p.sd,
                text=_given_text(p, interval, effect=p.name in own),
            )
        )
    return tuple(out)


def _given_text(p: Parameter, interval: Interval, *, effect: bool) -> str:
    """Name, fitted value, table and test, all in one unit, with half their 95 % intervals."""
    known = [("", interval.value, interval.sd)]
    if p.before is not None and not effect:
        known.append(("table ", p.before.value, p.before.sd))
    if p.before is not None:
        known.append(("test ", p.value, p.sd))
    if p.relative:
        by, shown = 100.0, "%"
    else:
        by, shown = readable_unit(max(abs(value) for _, value, _ in known), p.unit)
    texts = []
    for what, value, sd in known:
        wide = f" ± {by * 1.96 * sd:.2g}" if 0.0 < sd < math.inf else ""
        if not (what or interval.converged):
            wide = ""
        texts.append(f"{what}{by * value:.{digits(value, sd, 3)}g}{wide}{unit_suffix(shown)}")
    about = "95 %" if interval.converged else NOT_CONVERGED
    return f"{p.name} of {texts[0]} ({', '.join([about, *texts[1:]])})"


def _amount(change: float, wide: float, unit: str) -> str:
    """A change with half its 95 % interval, rounded to the digits that the interval supports."""
    if not (math.isfinite(wide) and wide > 0.0):
        return f"{abs(change):.3g} {unit}".strip()
    places = min(max(0, 1 - math.floor(math.log10(wide))), 9)
    if wide >= 10.0:
        places = 0
    return f"{abs(change):.{places}f} ± {wide:.{places}f} {unit}".strip()


def _shares(
    which: Sequence[int],
    fit: Fit,
    before: Sequence[Outcome],
    after: Sequence[Outcome],
    metric: str,
) -> dict[int, float]:
    """Share of the squared gap that each parameter explains.

    The mean of two values, at least 0 each: the gain of the parameter if it is changed first, and
    if it is changed last. Parameters that can replace each other thus share what they explain
    together. One that compensates another explains nothing if it is changed first. After a stop,
    those of the last parameters may be missing.
    """
    if not which:
        return {}
    first, last = _together(before, metric), _together(after, metric)
    if not (math.isfinite(first) and first > 1.0):
        return {}
    old = before[0].fit.point.theta
    out = {}
    with current().keeping():
        for i in which:
            current().beat()
            alone, without = old.copy(), fit.point.theta.copy()
            alone[i] = fit.point.theta[i]
            without[i] = old[i]
            a = _together([_moved_to(o, alone, metric) for o in before], metric)
            b = _together([_moved_to(o, without, metric) for o in after], metric)
            gains = [first - a] if math.isfinite(a) else []
            gains += [b - last] if math.isfinite(b) else []
            if gains:
                mean = float(np.mean(np.maximum(gains, 0.0)))
                out[i] = min(mean / (first - 1.0), 1.0)
    return out


def _together(outcomes: Sequence[Outcome], metric: str) -> float:
    """Squared gap over the records of several outcomes [sigma^2]."""
    parts = [o.squares(o.fit.problem.segmented_records, metric) for o in outcomes]
    return sum(p[0] for p in parts) / max(sum(p[1] for p in parts), 1)


def _moved_to(outcome: Outcome, theta: Array, metric: str) -> Outcome:
    """The outcome with other parameters and the same start states."""
    fit = outcome.tight
    moved = replace(fit, point=replace(fit.point, theta=theta, memo={}))
    seen = one_run(moved) if metric == "open_loop" else residuals_by_segment(moved)
    other = replace(outcome, fit=moved)
    vars(other)[metric] = tuple(seen)  # replaces states that would be estimated again
    return other


def fitted_starts(fit: Fit, tight: Fit | None, settings: FitSettings) -> dict[str, Array]:
    """Start states from which a single simulation follows each record of a fit.

    ``tight``: the fit with the tightest continuity defects, whose start states are close.
    """
    if not fit.defect_sd.size:
        return found_starts(fit)
    near = fit if tight is None else tight
    point = replace(fit.point, places=near.point.places, memo={})
    frozen = replace(fit.problem, frozen=True)
    quick = replace(settings.coarser(0.3, iterations=8), chain=tight is None)
    found = polish(frozen, point, settings.levels[-1], quick)
    return found_starts(found if np.isfinite(found.cost) else fit)


def found_starts(*fits: Fit) -> dict[str, Array]:
    """Fitted start state by record; the first block of a record is used."""
    out: dict[str, Array] = {}
    for fit in fits:
        if not fit.defect_sd.size and not any(p.starts.size for p in fit.point.places):
            continue
        for s, place in zip(fit.problem.segmented_records, fit.point.places, strict=True):
            out.setdefault(s.record.name, place.starts[0])
            whole = s.record.whole
            if s.record.name.startswith(f"{whole}[1/"):
                out.setdefault(whole, place.starts[0])
    return out
