"""Held-out proof: the effect of a change on records that were not used in the fit.

Start states and the sensor nuisances of a record are estimated again. For gaps in units of the
channels, parameters and magnitudes are fixed. For the comparison of models they have the
uncertainty of the fit. The score is the log predictive density of every segment, given the segments
before it, which is a proper score. A more flexible model does not win by fitting noise. A correct
model is not refuted because a held-out record determines its parameters better than the fit did.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, null_space
from scipy.special import logsumexp

from feltmb.data import Array
from feltmb.fit.linearize import Linear, Place
from feltmb.fit.model import Model
from feltmb.fit.observe import machine_candidates
from feltmb.fit.problem import Point, Problem, solve_scaled
from feltmb.fit.segmented_records import SegmentedRecord, segment_record
from feltmb.fit.solve import (
    SAME,
    Fit,
    FitSettings,
    estimate_states,
    limit_of_noise,
    polish,
)
from feltmb.fit.starts import from_other_starts
from feltmb.fit.watch import current
from feltmb.gap.criteria import FORM_ERROR
from feltmb.gap.evidence import forms_of, with_form

__all__ = [
    "SEGMENTED_LEVEL",
    "HeldOut",
    "Outcome",
    "Predicted",
    "evaluate",
    "expected_gain",
    "explained_share",
    "held_out_gain",
    "metric_of",
    "one_run",
    "outputs_by_segment",
    "residuals_by_segment",
    "second_start",
]


#: Log predictive density of a segment that cannot be linearized.
NO_DENSITY = -1e6
#: Continuity defect of the segmented gap and of predictions, as a share of the spread of the
#: states. With exact continuity, a linearization of a chaotic machine would predict that a
#: friction of 1e-7 N is detectable. The linearization is not valid that far.
SEGMENTED_LEVEL = 0.01
#: Smallest continuity defect of held-out densities. With tighter defects, the states of a strike
#: have many local minima: the densities of one model and record differed by 70. With larger ones,
#: the states follow what an effect does.
HELD_OUT_LEVEL = 1e-3
#: Log posterior probability below which an error of form is not considered for held-out records.
LEAST_WEIGHT = math.log(1e-3)
#: Largest number of steps to the likeliest parameters of held-out records, and the shares of a step
#: that are tried.
STEPS, SHARES = 12, (1.0, 0.5, 0.25, 0.1, 0.03)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of one model for the held-out segmented records."""

    fit: Fit
    settings: FitSettings
    model: Fit
    """The fit of the model to the fitted records."""
    predicted: Predicted | None = None
    """None if nothing was predicted: the records were fitted."""

    @property
    def density(self) -> Array:
        """Log predictive density of the segments of all segmented records, (segments,)."""
        return np.zeros(0) if self.predicted is None else self.predicted.density

    @property
    def explains(self) -> bool:
        """Whether the model explains the records, with parameters that the fit permits."""
        return self.fit.explains if self.predicted is None else self.predicted.explains

    @property
    def total(self) -> float:
        """Log predictive density of all records."""
        return float(np.sum(self.density))

    @property
    def simulated(self) -> bool:
        """Whether the simulations succeeded; one that fails proves nothing."""
        seen = np.isfinite(self.density) & (self.density > NO_DENSITY)
        return bool(np.isfinite(self.fit.cost) and np.all(seen))

    @cached_property
    def segmented(self) -> tuple[Array, ...]:
        """Residual by record, (n, ny) in units of the channels, with re-estimated start states."""
        fit = self.fit
        if fit.defect_sd.size and not np.isclose(SEGMENTED_LEVEL, fit.level):
            fit = polish(fit.problem, fit.point, SEGMENTED_LEVEL, self.settings)
        return tuple(residuals_by_segment(fit))

    @cached_property
    def tight(self) -> Fit:
        """Residual with tightly connected segments: their start states are those of one run."""
        fit, tightest = self.fit, self.settings.levels[-1]
        if fit.defect_sd.size and fit.level > tightest:
            settings = replace(self.settings, chain=True)
            tight = polish(fit.problem, fit.point, tightest, settings)
            fit = tight if tight.cost < np.inf else fit
        return fit

    @cached_property
    def open_loop(self) -> tuple[Array, ...]:
        """Residual of one simulation of the whole record from the first state."""
        return tuple(one_run(self.tight))

    def part(self, rows: slice) -> Outcome:
        """Result for a part of the records."""
        fit = self.fit
        problem = replace(fit.problem, segmented_records=fit.problem.segmented_records[rows])
        point = replace(fit.point, places=fit.point.places[rows], memo={})
        return replace(self, fit=replace(fit, problem=problem, point=point))

    def gap(
        self, segmented_records: Sequence[SegmentedRecord], which: str, only: int | None = None
    ) -> float:
        """Whitened root mean square over all channels, of all records or of one [sigma]."""
        total, count = self.squares(segmented_records, which, only)
        return float(np.sqrt(total / max(count, 1)))

    def squares(
        self, segmented_records: Sequence[SegmentedRecord], which: str, only: int | None = None
    ) -> tuple[float, int]:
        """Whitened sum of squares (infinite if a simulation fails), and the number of samples."""
        total, count = 0.0, 0
        pairs = list(zip(segmented_records, getattr(self, which), strict=True))
        for segmented, residual in pairs if only is None else [pairs[only]]:
            measured = np.isfinite(segmented.record.output_array(self.fit.problem.model.outputs))
            good = np.isfinite(residual)
            if np.any(measured & ~good):
                return float("inf"), count
            for c in range(good.shape[1]):
                seen = good[:, c]
                total += float(np.sum((residual[seen, c] / segmented.sd[seen, c]) ** 2))
            count += int(good.sum())
        return total, count


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out segmented records, with the continuity defects at which the fit converged."""

    segmented_records: tuple[SegmentedRecord, ...]
    state_scale: Array
    sensed: tuple[SegmentedRecord, ...]
    """The records with the noise of the sensors only: the unit and noise floor of gaps."""


def evaluate(
    held: HeldOut,
    model: Fit,
    settings: FitSettings,
    *,
    like: Outcome | None = None,
) -> Outcome:
    """Evaluate a fitted model on held-out segmented records.

    The continuity defects are those of the fit, or ``HELD_OUT_LEVEL`` if that is larger.
    ``like``: the result of another model, which is a second start for this one.
    """
    base = replace(
        model.problem,
        segmented_records=held.segmented_records,
        frozen=True,
        state_scale=held.state_scale if held.state_scale.size else None,
    )
    way = replace(settings, chain=True)
    level = max(model.level, HELD_OUT_LEVEL)
    fit = polish(base, _converge(base, model, level), level, way)
    fit = from_other_starts(fit, way) if like is None else from_other_starts(fit, way, most=1)
    found = Outcome(fit, settings, model, predict(base, fit, model))
    if fit.defect_sd.size:
        found = _with_larger_defects(found, fit.point)
    return found if like is None else second_start(found, like)


def _with_larger_defects(found: Outcome, start: Point) -> Outcome:
    """The result, or one with larger continuity defects if the records need them.

    Continuity defects that were right for the fitted records may be too tight for another motion,
    for example with a repeated impact. Models could then not be compared. Larger defects have a
    cost.
    """
    if found.explains:
        return found
    looser = [v for v in found.settings.levels if 1.5 * found.fit.level < v < 1.0]
    for level in looser:
        if current().must_end():
            break
        found = _better(found, start, level)
    return found


def second_start(found: Outcome, like: Outcome) -> Outcome:
    """The result with the states of another model as a second start, if that is better.

    The states of tightly connected segments may be in a local minimum, which the records do not
    reveal: they are explained, but less well than by the other model. Without states, the search
    for the likeliest parameters is repeated from those of the other model, if that one explains the
    records, unless this one does and its search converged.
    """
    if not found.fit.defect_sd.size:
        if like.predicted is None or not like.predicted.explains:
            return found
        return _from_parameters(found, like.predicted.likeliest)
    start = _carried(found, like)
    return _with_larger_defects(_better(found, start, found.fit.level), start)


def _from_parameters(found: Outcome, start: Point) -> Outcome:
    """The result, or that of a search from other parameters if its density is larger."""
    own = found.predicted
    if own is None or (own.explains and own.converged):
        return found
    predicted = predict(found.fit.problem, found.fit, found.model, start)
    return replace(found, predicted=predicted) if np.sum(predicted.density) > found.total else found


def _carried(found: Outcome, like: Outcome) -> Point:
    """Start states of another model, with the parameters and magnitudes of this one."""
    included = found.fit.problem.included
    point = like.fit.problem.carry(like.fit.point, included, found.model.point.magnitudes)
    return replace(point, theta=found.model.point.theta, memo={})


def _better(found: Outcome, start: Point, level: float) -> Outcome:
    """The result, or that of a fit from other start states if its density is larger."""
    way = replace(found.settings, chain=True)
    fit = polish(found.fit.problem, start, level, way)
    predicted = predict(fit.problem, fit, found.model)
    if not np.sum(predicted.density) > found.total:
        return found
    return replace(found, fit=fit, predicted=predicted)


def expected_gain(
    held: HeldOut, before: Outcome, after: Outcome, settings: FitSettings, inflation: float
) -> tuple[float, float]:
    """Held-out gain of ``after`` over ``before`` if ``after`` is true: mean, standard deviation.

    With the predictive distributions N(m, S) of the two models and d = m_after - m_before, the mean
    is Q = d^T S_before^-1 d / 2, the difference of the densities of ``before`` at the outputs that
    the two models predict. (If S_after differs from S_before, the mean is larger.) The variance is
    2 Q by the noise, and 4 Q^2 / z^2 by the error of the fitted magnitudes, if z is their distance
    from zero in standard deviations.
    """
    densities = []
    for outcome in (before, after):
        base = replace(before.fit.problem, segmented_records=_predicted(held, outcome))
        way = replace(settings, chain=True)
        fit = polish(base, replace(before.fit.point, memo={}), before.fit.level, way)
        found = Outcome(fit, settings, before.model, predict(base, fit, before.model))
        if not fit.defect_sd.size:
            found = _from_parameters(found, outcome.fit.point)
        densities.append(found.total)
    mean = max(0.0, densities[0] - densities[1]) / inflation
    known = {t.name for t in before.fit.included}
    own = [k for k, t in enumerate(after.fit.included) if t.name not in known]
    covariance, first = after.model.covariance, len(after.model.problem.free)
    # Fitted records that do not show a magnitude leave its variance infinite.
    own = [k for k in own if np.isfinite(covariance[first + k, first + k])]
    at = first + np.array(own, dtype=np.intp)
    size = after.model.point.magnitudes[own]
    certain = float(size @ solve_scaled(covariance[np.ix_(at, at)], size)) / inflation
    return mean, math.sqrt(2.0 * mean + 4.0 * mean**2 / max(certain, 1.0))


def explained_share(before: float, after: float) -> float:
    """Share of a squared held-out gap above the noise that is explained [1]; gaps [sigma]."""
    return (before**2 - after**2) / (before**2 - 1.0)


def _predicted(held: HeldOut, outcome: Outcome) -> tuple[SegmentedRecord, ...]:
    """The held-out records with the outputs that a model predicts."""
    problem = replace(outcome.fit.problem, segmented_records=held.segmented_records)
    return tuple(
        replace(segmented, measured=np.where(segmented.valid, outputs, np.nan))
        for segmented, outputs in _by_segment(replace(outcome.fit, problem=problem))
    )


@dataclass(frozen=True, eq=False)
class _Likeliest:
    """Where the held-out records and the posterior of the fitted ones are most likely together."""

    point: Point
    linears: list[Linear]
    units: Array
    """Columns are in standard deviations, so that the prior of all of them is N(0, I)."""
    moved: Array
    """Distance of the globals from the fitted ones, in these units."""
    squares: float
    """Sum of squares, with the square of the distance from the fitted globals."""
    converged: bool = False
    """Whether the linear model promises no larger gain at another point."""


def _likeliest(
    base: Problem, fit: Fit, model: Fit, start: Point | None, inexact: NDArray[np.intp]
) -> _Likeliest:
    """Gauss-Newton search from the fitted parameters, or from other ones.

    Where a part is caught in one simulation and missed in another, a derivative at the fitted
    parameters tells nothing of the outputs at other parameters that the fit permits.
    """
    loose = replace(base, frozen=False)
    count = len(loose.free) + len(loose.included)
    nuisances = np.array([sd for s in base.segmented_records for _, _, sd in s.nuisances])
    root, inverse = _roots(model.covariance)
    units = block_diag(root, np.diag(nuisances))
    inverse = block_diag(inverse, np.diag(1.0 / np.maximum(nuisances, 1e-300)))
    origin, point, steps = fit.point, fit.point, 0
    if start is not None:
        point = replace(point, theta=start.theta, places=start.places, memo={})

    def distance(at: Point) -> Array:
        by_theta, by_magnitude = at.theta - origin.theta, at.magnitudes - origin.magnitudes
        own = [place.nuisances for place in at.places]
        return np.asarray(inverse @ np.concatenate([by_theta[loose.free], by_magnitude, *own]))

    while True:
        linears = with_form(loose, point, loose.linear(point), inexact, FORM_ERROR)
        moved = distance(point)
        total = base.cost_at(point, fit.defect_sd, linears)[0] + moved[:count] @ moved[:count]
        here = _Likeliest(point, linears, units, moved, float(total))
        if not np.isfinite(total):
            return here
        normal = loose.normal(point, linears, fit.defect_sd)
        matrix, right = np.eye(len(units)), -moved
        for chain, own in zip(normal.chains, normal.columns, strict=True):
            matrix, right = _added(matrix, right, np.sum(chain.grams, axis=0), units[own])
        if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(right))):
            return here
        step = _step_within(matrix, right, units[:count], *loose.room(point))
        if float(right @ step) < 2.0 * SAME:
            return replace(here, converged=True)
        if steps == STEPS or current().must_end():
            return here
        for share in SHARES:
            tried = loose.moved(point, normal, units @ (share * step))
            far = distance(tried)[:count]
            if base.cost(tried, fit.defect_sd, linears)[0] + far @ far < total:
                break
        else:
            return here
        point, steps = tried, steps + 1


def _added(height: Array, right: Array, gram: Array, units: Array) -> tuple[Array, Array]:
    """Normal equations with those of further residuals, in the given units."""
    return height + units.T @ gram[:-1, :-1] @ units, right + units.T @ gram[:-1, -1]


def _step_within(matrix: Array, right: Array, units: Array, low: Array, high: Array) -> Array:
    """Newton step of normal equations; a global at a limit does not cross it.

    ``units``: globals by variable, (globals, n). ``low``, ``high``: distances to the limits.
    """
    fixed = np.zeros(low.size, dtype=bool)
    while True:
        rows = units[fixed] / np.linalg.norm(units[fixed], axis=1, keepdims=True)
        free = null_space(rows) if fixed.any() else np.eye(right.size)
        step = np.asarray(free @ solve_scaled(free.T @ matrix @ free, free.T @ right))
        moves = units @ step
        beyond = ~fixed & (((low >= 0.0) & (moves < 0.0)) | ((high <= 0.0) & (moves > 0.0)))
        if not beyond.any():
            return step
        fixed |= beyond


def _roots(covariance: Array) -> tuple[Array, Array]:
    """Square root of a covariance, and its inverse; zero for what has no finite variance."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    known = np.isfinite(sd)
    sd = np.where(known, sd, 1.0)
    inner = covariance / np.outer(sd, sd)
    inner[~known] = inner[:, ~known] = 0.0
    inner[~known, ~known] = 1.0
    values, vectors = np.linalg.eigh(inner)
    size = np.sqrt(np.maximum(values, 0.0))
    shown = values > 1e-14 * np.max(values, initial=0.0)
    root = (vectors * size) * sd[:, None]
    inverse = (vectors / np.where(shown, size, np.inf)).T / sd
    root[~known] = inverse[:, ~known] = 0.0
    return root, inverse


@dataclass(frozen=True, eq=False)
class Predicted:
    """The posterior predictive distribution of a model at held-out records."""

    density: Array
    """Log predictive density of the segments, (segments,)."""
    explains: bool
    """Whether the records agree with noise at parameters that the fit permits."""
    likeliest: Point
    """The likeliest parameters and magnitudes."""
    converged: bool
    """Whether the search for them converged."""


def predict(base: Problem, fit: Fit, model: Fit, start: Point | None = None) -> Predicted:
    """Posterior predictive distribution, averaged over errors of form of the effects.

    The weights of the errors are those of the fitted records.
    """
    forms = forms_of(model)
    found, logs = [], []
    for inexact, log_weight in zip(forms.inexact, forms.log_weights, strict=True):
        if log_weight > LEAST_WEIGHT:
            found.append(_predict(base, fit, model, start, inexact))
            logs.append(log_weight + np.cumsum(found[-1].density))
    if len(found) == 1:
        return found[0]
    best = found[int(np.argmax([total[-1] for total in logs]))]
    total = np.asarray(logsumexp(logs, axis=0))
    return replace(best, density=np.diff(total, prepend=0.0))


def _predict(
    base: Problem, fit: Fit, model: Fit, start: Point | None, inexact: NDArray[np.intp]
) -> Predicted:
    """Laplace approximation at the likeliest parameters, which are searched from ``start``."""
    at = _likeliest(base, fit, model, start, inexact)
    none = np.full(sum(s.count for s in base.segmented_records), NO_DENSITY)
    if not np.isfinite(at.squares):
        return Predicted(none, False, fit.point, False)
    normal = replace(base, frozen=False).normal(
        at.point, at.linears, fit.defect_sd, keep_heads=True
    )
    height, right, units = np.eye(len(at.units)), -at.moved, at.units
    defects = float(np.sum(np.log(fit.defect_sd))) if fit.defect_sd.size else 0.0
    known, densities, gains = 0.0, [0.0], [0.5 * float(right @ right)]
    for segmented, linear, chain, own in zip(
        base.segmented_records, at.linears, normal.chains, normal.columns, strict=True
    ):
        assert chain.heads is not None
        known += base.log_start_prior(segmented, linear)
        for gram, log_det, head, head_log_det in zip(
            chain.grams, chain.log_dets, *chain.heads, strict=True
        ):
            # All data so far, with this segment as the last one of its record.
            high, side = _added(height, right, head, units[own])
            if not np.all(np.isfinite(high)):
                return Predicted(none, False, fit.point, False)
            volume = head_log_det + 0.5 * float(np.linalg.slogdet(high)[1])
            densities.append(known - 0.5 * head[-1, -1] - volume)
            gains.append(0.5 * float(side @ solve_scaled(high, side)))
            # The same segment with its continuity defect to the next one.
            height, right = _added(height, right, gram, units[own])
            known += -0.5 * gram[-1, -1] - log_det - defects
        known += defects  # the last segment has no next one
    if gains[-1] > SAME:
        # The simulation does not have the gain of the linear model, or it is beyond a limit.
        gains[1:] = [0.0] * (len(gains) - 1)
    far = at.moved[: normal.shared]
    explains = at.squares < limit_of_noise(fit.dof) and far @ far <= limit_of_noise(far.size)
    density = np.diff(np.array(densities) + np.array(gains))
    return Predicted(density, bool(explains), at.point, at.converged)


def _converge(problem: Problem, model: Fit, level: float) -> Point:
    """Start states of new records: from loose continuity defects to a level of them."""
    point = problem.start(magnitudes=model.point.magnitudes, theta=model.point.theta)
    extra = [t for t in machine_candidates(problem.included) if t.effect.hidden]
    if extra:
        bare = problem.with_candidates(())
        bare_point = Point(point.theta, np.zeros(0), point.places)
        nx = len(problem.model.states())
        cut = tuple(replace(p, starts=p.starts[:, :nx]) for p in point.places)
        point = bare.carry(
            Point(bare_point.theta, np.zeros(0), cut), problem.included, model.point.magnitudes
        )
    return estimate_states(problem, point, level)


def _by_segment(fit: Fit) -> Iterator[tuple[SegmentedRecord, Array]]:
    """Records with their outputs, (W, L, ny), where each segment starts from its own state."""
    seen = fit.problem.predict(fit.point)
    for segmented, (outputs, _, _) in zip(fit.problem.segmented_records, seen, strict=True):
        yield segmented, outputs


def metric_of(model: Model) -> str:
    """Metric of a gap: "open_loop", one run a record, or "segmented" if such runs are chaotic."""
    return "segmented" if model.chaotic else "open_loop"


def outputs_by_segment(fit: Fit) -> list[Array]:
    """Outputs by record, (n, ny), where each segment starts from its own state."""
    return [segmented.joined(outputs) for segmented, outputs in _by_segment(fit)]


def residuals_by_segment(fit: Fit) -> list[Array]:
    """Residual by record, (n, ny), where each segment starts from its own state."""
    return [s.joined(s.measured - outputs) for s, outputs in _by_segment(fit)]


def one_run(fit: Fit) -> list[Array]:
    """Residual by record, (n, ny), of one simulation from the first start state."""
    whole = []
    for segmented in fit.problem.segmented_records:
        ends = np.array([[0, segmented.record.samples - 1]])
        own = segment_record(fit.problem.model, segmented.record, {}, None, ends)
        whole.append(replace(own, nuisances=segmented.nuisances))
    places = tuple(Place(p.starts[:1], p.nuisances) for p in fit.point.places)
    problem = replace(fit.problem, segmented_records=tuple(whole))
    seen = problem.predict(replace(fit.point, places=places))
    return [(s.measured - outputs)[0] for s, (outputs, _, _) in zip(whole, seen, strict=True)]


def held_out_gain(before: Outcome, after: Outcome) -> float:
    """Gain of the sum of log predictive densities of held-out records.

    Segments that one of the models cannot simulate do not count.
    """
    gain = after.density - before.density
    return float(np.sum(gain[np.isfinite(gain)]))
