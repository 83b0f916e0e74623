"""Weak-constraint multiple shooting: fits a model, with or without effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from feltmb.data import Array
from feltmb.files import digest_of, package_digest
from feltmb.fit.linearize import InputColumns, Linear, Place
from feltmb.fit.model import Candidate, Jobs, Model, by_segment
from feltmb.fit.observe import machine_candidates, observe_all
from feltmb.fit.problem import Normal, Point, Problem
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.watch import Say, current

__all__ = [
    "NOT_CONVERGED",
    "Fit",
    "FitSettings",
    "Interval",
    "at_level",
    "chained",
    "estimate_states",
    "evidence_at",
    "finish",
    "fit_problem",
    "limit_of_noise",
    "model_with_variability",
    "polish",
    "relaxed",
    "with_variability",
]

#: If the fit is poor, a gain below this share of the sum of squares is not worth a simulation.
COARSE = 3e-5
#: Trust region of a fit without continuity defects, in units of ``Problem.reach``: first, largest
#: and smallest radius. At the smallest radius without a gain, the fit ends.
RADIUS, WIDEST, NARROWEST = 3.0, 64.0, 1e-4
#: Length of the step across a jump of the sum of squares, in the same units; how often such a step
#: is tried; iterations on the other side.
ACROSS, CROSSINGS, BEYOND = 1.0, 4, 15
#: Ratios of actual to predicted gain above which a step is accepted, and above which it is good.
TAKEN, GOOD = 0.1, 0.6
#: Number of consecutive samples whose mean square decides whether the model follows a record.
ROW = 5
#: Text in place of the interval of a number whose fit was ended early.
NOT_CONVERGED = "not converged"
#: Two fits whose log evidence differs by less are equal.
SAME = 0.5


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of a fit."""

    levels: tuple[float, ...] = (1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    """Continuity defects that are tried, as shares of the spread of the states; the level with the
    largest marginal likelihood is used."""
    iterations: int = 40
    decrement: float = 0.02
    """The search ends if a step can reduce the sum of squares by less than this."""
    restarts: int = 3
    """Largest number of other starts of a poor fit with continuity defects, and of other paths
    along the records of a fit without defects."""
    seed: int = 0
    chain: bool = False
    """Whether a poor fit with continuity defects below a tenth is also started from one simulation
    through all segments. :func:`fit_problem` always does this."""
    jumps: bool = True
    """Whether a fit without continuity defects that ends at a jump of the sum of squares goes on
    from the other side."""
    worth: float = np.inf
    """Sum of squares of a competing fit. A search without continuity defects ends, unfinished, if
    its linear model predicts no smaller value, provided that the prediction for the previous step
    was correct."""

    def coarser(self, decrement: float, iterations: int | None = None) -> FitSettings:
        """Settings of an intermediate fit: at least this decrement, other iterations if given."""
        return replace(
            self,
            jumps=False,
            decrement=max(self.decrement, decrement),
            iterations=self.iterations if iterations is None else iterations,
        )


#: Standard deviations within which a sum of squares agrees with noise.
FAR = 4.0


def limit_of_noise(count: float) -> float:
    """Largest sum of squares of so many numbers that agrees with noise."""
    return float(count + FAR * np.sqrt(2.0 * count))


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A fitted value with its uncertainty."""

    name: str
    unit: str
    value: float
    sd: float
    """With ``form_sd``."""
    low: float
    """Lower end of the 95 % interval, within the limits."""
    high: float
    prior: float
    prior_sd: float
    at_limit: bool
    contraction: float
    """1 - (sd / prior sd)^2 without ``form_sd`` [1]: information of the data relative to the
    prior; 1 without a prior."""
    converged: bool = True
    """False: the fit was ended early, and the interval is that of its present point."""
    form_sd: float = 0.0
    """Standard deviation that errors in the form of included laws add."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Result of fitting a problem."""

    problem: Problem
    point: Point
    level: float
    """Continuity defect as a share of the spread of the states."""
    defect_sd: Array
    cost: float
    """Sum of squares including priors and continuity defects."""
    chi2: float
    """Sum of squares of the innovations."""
    dof: float
    log_evidence: float
    """Laplace approximation, up to a constant that is equal for all fits to the same records."""
    converged: bool
    notes: tuple[str, ...]
    linears: tuple[Linear, ...] = field(repr=False)
    normal: Normal = field(repr=False)
    cut: bool = False
    """Whether its time was over before it converged."""

    @property
    def explains(self) -> bool:
        """Whether the sum of squares agrees with noise within four standard deviations."""
        return bool(self.chi2 < limit_of_noise(self.dof))

    @property
    def plausible(self) -> bool:
        """Whether the fit explains the records with parameters that their joint prior permits."""
        return self.explains and self.within_priors

    @property
    def within_priors(self) -> bool:
        """Whether the parameters agree jointly with their priors, within four deviations."""
        far = self.prior_deviation
        return float(far @ far) <= limit_of_noise(far.size)

    @property
    def included(self) -> tuple[Candidate, ...]:
        """Included effects."""
        return self.problem.included

    @property
    def machine_effects(self) -> tuple[tuple[Candidate, ...], Array]:
        """Included effects of the machine, and their magnitudes [their units]."""
        which = machine_candidates(self.included)
        return which, np.array([self.point.magnitudes[self.included.index(t)] for t in which])

    def in_problem(self, problem: Problem) -> Fit:
        """The fit, unchanged, as a start in another problem."""
        return replace(self, problem=problem, point=replace(self.point, memo={}))

    @property
    def covariance(self) -> Array:
        """Covariance of the shared globals (free parameters, then magnitudes)."""
        count = len(self.problem.free) + len(self.included)
        total = inverse_scaled(self.normal.matrix)
        return np.asarray(total[:count, :count])

    @property
    def prior_deviation(self) -> Array:
        """Distance of the free parameters that have a prior from it, in standard deviations."""
        everything = self.problem.model.parameters
        known = [i for i in self.problem.free if np.isfinite(everything[i].sd)]
        far = [(self.point.theta[i] - everything[i].value) / everything[i].sd for i in known]
        return np.array(far, dtype=np.float64)

    def intervals(
        self, covariance: Array | None = None, by_form: Array | None = None
    ) -> tuple[Interval, ...]:
        """Parameters and magnitudes with 95 % intervals.

        Parameters
        ----------
        covariance
            Covariance to be used instead of ``self.covariance``, for example with uncertain shapes.
        by_form
            Covariance that the errors of form of the included laws add.
        """
        noise = self.covariance if covariance is None else covariance
        added = np.zeros_like(noise) if by_form is None else by_form
        own = np.sqrt(np.maximum(np.diag(noise), 0.0))
        form = np.sqrt(np.maximum(np.diag(added), 0.0))
        out = []
        rows = [
            (p.name, p.unit, self.point.theta[i], p.value, p.sd, p.lower, p.upper)
            for i, p in enumerate(self.problem.model.parameters)
            if i in self.problem.free
        ]
        rows += [
            (t.name, t.effect.unit, self.point.magnitudes[k], 0.0, np.inf, *t.effect.bounds)
            for k, t in enumerate(self.included)
        ]
        for row, noise_sd, form_sd in zip(rows, own, form, strict=True):
            name, unit, value, prior, prior_sd, low, high = row
            s = math.hypot(noise_sd, form_sd)
            out.append(
                Interval(
                    name=name,
                    unit=unit,
                    value=float(value),
                    sd=float(s),
                    low=float(max(value - 1.96 * s, low)),
                    high=float(min(value + 1.96 * s, high)),
                    prior=float(prior),
                    prior_sd=float(prior_sd),
                    at_limit=not low < value < high,
                    contraction=(
                        float(1.0 - (noise_sd / prior_sd) ** 2)
                        if prior_sd > 0.0 and np.isfinite(noise_sd)
                        else 0.0
                    ),
                    form_sd=float(form_sd),
                    converged=not self.cut,
                )
            )
        return tuple(out)


def inverse_scaled(matrix: Array) -> Array:
    """Inverse of a symmetric matrix; undetermined directions have infinite variance."""
    n = matrix.shape[0]
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    seen = size > 1e-150
    out = np.full((n, n), 0.0)
    out[~seen, ~seen] = np.inf
    if seen.any():
        scaled = matrix[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(values, 1e-11 * values[-1])
        inverse = (vectors / values) @ vectors.T
        out[np.ix_(seen, seen)] = inverse / np.outer(size[seen], size[seen])
    return out


def _optimize(
    problem: Problem,
    point: Point,
    defect_sd: Array,
    settings: FitSettings,
    iterations: int,
) -> tuple[Point, float, list[Linear], bool]:
    """Minimize from a point, or read the result from the store of the problem."""
    minimize = _minimize if defect_sd.size else _minimize_whole
    if problem.store is None:
        return minimize(problem, point, defect_sd, settings, iterations)
    linears = problem.linear(point)
    cost, parts = problem.cost_at(point, defect_sd, linears)
    key = digest_of(
        package_digest(),  # another version of the code may find another minimum
        cost,
        *parts,
        *(x.by_global for x in linears),  # versions of a model may differ in derivatives only
        point.theta,
        point.magnitudes,
        defect_sd,
        iterations,
        settings.decrement,
        settings.worth,
        problem.frozen,
        settings.chain,
        [(t.name, t.shape) for t in problem.included],
        [(p.name, p.value, p.sd, p.lower, p.upper, p.process_sd) for p in problem.model.parameters],
        *problem.room(point),
    )
    kept = problem.store.get(key)
    if kept is not None:
        known = kept.arrays
        places = tuple(
            Place(known[f"starts{i}"], known[f"nuisances{i}"])
            for i in range(len(problem.segmented_records))
        )
        found = Point(known["theta"], known["magnitudes"], places)
        noise = [
            InputColumns(known[f"by_input{i}"], known[f"ends_by_input{i}"])
            for i in range(len(problem.segmented_records))
        ]
        linears = problem.linear(found, known=noise)
        return found, float(known["cost"]), linears, bool(known["converged"])
    found, cost, linears, converged = minimize(problem, point, defect_sd, settings, iterations)
    if current().must_end():  # the search may have been stopped
        return found, cost, linears, converged
    arrays = {"theta": found.theta, "magnitudes": found.magnitudes}
    arrays |= {"cost": np.array(cost), "converged": np.array(float(converged))}
    for i, place in enumerate(found.places):
        arrays |= {f"starts{i}": place.starts, f"nuisances{i}": place.nuisances}
    for i, linear in enumerate(linears):
        arrays |= {f"by_input{i}": linear.by_input, f"ends_by_input{i}": linear.ends_by_input}
    problem.store.put(key, {"effects": sorted(t.name for t in problem.included)}, arrays)
    return found, cost, linears, converged


def _minimize(
    problem: Problem,
    point: Point,
    defect_sd: Array,
    settings: FitSettings,
    iterations: int,
) -> tuple[Point, float, list[Linear], bool]:
    """Levenberg-Marquardt with separate damping for every segment."""
    linears = problem.linear(point)
    cost, parts = problem.cost_at(point, defect_sd, linears)
    samples = problem.samples
    lam = 1e-4
    damping = [np.zeros(s.count) for s in problem.segmented_records]
    with current().keeping():
        for _ in range(iterations):
            accepted = False
            for _ in range(8):
                used = [d if np.any(d) else None for d in damping]
                normal = problem.normal(point, linears, defect_sd, used)
                scaled = lam * np.diag(normal.matrix)
                attempt, gain = problem.step(point, normal, scaled)
                predicted = cost - relaxed(problem, point, normal) + gain
                least = max(settings.decrement, COARSE * max(cost - 4.0 * samples, 0.0))
                if predicted < least:
                    return point, cost, linears, True
                new, new_parts = problem.cost(attempt, defect_sd, linears)
                if new < cost:
                    accepted = True
                    break
                lam = max(lam, 1e-4) * 6.0
                for d, a, b in zip(damping, parts, new_parts, strict=True):
                    worse = ~(b <= a + 1e-9)
                    d[worse] = np.maximum(d[worse] * 8.0, 1e-3)
            if not accepted:
                return point, cost, linears, False
            done = cost - new < least and predicted < 50.0 * least
            lam /= 8.0
            for d in damping:
                d /= 10.0
                d[d < 1e-6] = 0.0
            # Near the minimum, the derivatives by the input noise hardly change.
            near = cost - new < 0.05 * new
            linears, point = problem.linear(attempt, known=linears if near else None), attempt
            cost, parts = problem.cost_at(point, defect_sd, linears)
            if done:
                return point, cost, linears, True
    return point, cost, linears, False


def _minimize_whole(
    problem: Problem,
    point: Point,
    defect_sd: Array,
    settings: FitSettings,
    iterations: int,
) -> tuple[Point, float, list[Linear], bool]:
    """Gauss-Newton steps in a trust region, for records that are simulated as a whole.

    The region is a sphere in prior standard deviations, because plausible values are within some of
    them. A simulation costs a tenth of the derivatives. If a step gives the predicted gain, a step
    of twice the length is therefore tried.
    """
    linears = problem.linear(point)
    cost, _ = problem.cost_at(point, defect_sd, linears)
    radius, trusted = RADIUS, False
    with current().keeping():
        for _ in range(iterations):
            normal = problem.normal(point, linears, defect_sd)
            promised = normal.gain(problem.newton(point, normal))
            least = max(settings.decrement, COARSE * max(cost - 4.0 * problem.samples, 0.0))
            if promised < least:
                return point, cost, linears, True
            # Far from the minimum, a linear model cannot predict the result of a fit.
            if trusted and cost - promised > settings.worth:
                return point, cost, linears, False
            best: tuple[float, Point, float, float] | None = None
            failed = np.inf  # length of the last step that was not accepted
            while radius > NARROWEST:
                delta, length = _within(problem, point, normal, radius)
                gain = normal.gain(delta)
                if gain < least or (best is not None and length < 1.01 * best[3]):
                    break
                attempt = problem.moved(point, normal, delta)
                new, _ = problem.cost(attempt, defect_sd, linears)
                ratio = (cost - new) / gain
                if best is None and not ratio > TAKEN:
                    radius, failed = min(radius, length) * (0.5 if ratio > -1.0 else 0.2), length
                    continue
                if best is None or new < best[0]:
                    best = (new, attempt, ratio, length)
                    if (
                        ratio > GOOD
                        and length > 0.9 * radius
                        and radius < min(WIDEST, 0.5 * failed)
                    ):
                        radius *= 2.0
                        continue
                break
            if best is None:  # nothing is lower within the region: a minimum or a jump
                return point, cost, linears, promised < 1.0
            new, better, ratio, length = best
            trusted = ratio > GOOD
            done = cost - new < least
            radius = (
                max(radius, 2.0 * length)
                if ratio > GOOD
                else length * (1.0 if ratio > 0.3 else 0.5)
            )
            linears, point = problem.linear(better), better
            cost, _ = problem.cost_at(point, defect_sd, linears)
            if done:
                return point, cost, linears, True
    return point, cost, linears, False


def _within(problem: Problem, point: Point, normal: Normal, radius: float) -> tuple[Array, float]:
    """The best step that is not longer than a radius, and its length."""
    weight = np.zeros(normal.right.size)
    reach = problem.reach
    weight[: reach.size] = reach**-2.0

    def at(damping: Array | float) -> tuple[Array, float]:
        delta = problem.newton(point, normal, damping)
        return delta, float(np.sqrt(weight @ delta**2))

    found = at(0.0)
    low, high = -8.0, 14.0  # logarithms of damping factors
    while found[1] > radius and high - low > 0.02:
        middle = 0.5 * (low + high)
        tried = at(10.0**middle * weight)
        if tried[1] > radius:
            low = middle
            continue
        high = middle
        if high - low <= 0.02 or tried[1] > 0.9 * radius:
            return tried
    return found if found[1] <= radius else at(10.0**high * weight)


def relaxed(problem: Problem, point: Point, normal: Normal) -> float:
    """Sum of squares after a step of the states alone, to first order."""
    # The chains contain the gain by the states; this is the remaining residual.
    left = sum(float(np.sum(c.grams[:, -1, -1])) for c in normal.chains)
    return left + problem.prior_cost(point)


def evidence_at(
    problem: Problem, normal: Normal, cost: float, defect_sd: Array, linears: Sequence[Linear]
) -> float:
    """Log marginal likelihood over states and inputs at given parameters (Laplace)."""
    value = -0.5 * cost
    for segmented, chain, linear in zip(
        problem.segmented_records, normal.chains, linears, strict=True
    ):
        value -= float(np.sum(chain.log_dets))
        value += problem.log_start_prior(segmented, linear)
        if defect_sd.size:
            value -= (segmented.count - 1) * float(np.sum(np.log(defect_sd)))
    return value


def _finish(
    problem: Problem,
    point: Point,
    level: float,
    defect_sd: Array,
    cost: float,
    linears: list[Linear],
    converged: bool,
) -> Fit:
    normal = problem.normal(point, linears, defect_sd)
    chi2, dof = 0.0, 0.0
    states = len(defect_sd)
    step = problem.newton(point, normal) if not problem.frozen else None
    for segmented, chain, own in zip(
        problem.segmented_records, normal.chains, normal.columns, strict=True
    ):
        change = np.zeros(own.size) if step is None else step[own]
        tail = np.append(-change, 1.0)
        chi2 += float(np.einsum("i,wij,j->", tail, chain.grams, tail))
        dof += float(segmented.samples.sum())
        _, sd = problem.start_prior(segmented)
        dof -= min(states, int(np.sum(~np.isfinite(sd))))
    if not problem.frozen:
        dof -= sum(1 for i in problem.free if np.isinf(problem.model.parameters[i].sd))
        dof -= len(problem.included)
    return Fit(
        problem=problem,
        point=point,
        level=level,
        defect_sd=defect_sd,
        cost=cost,
        chi2=chi2,
        dof=max(dof, 1.0),
        log_evidence=evidence_at(problem, normal, cost, defect_sd, linears),
        converged=converged,
        notes=(),
        linears=tuple(linears),
        normal=normal,
        cut=not converged and current().must_end(),
    )


def finish(problem: Problem, point: Point, level: float, defect_sd: Array) -> Fit:
    """Make a fit of a point without a search."""
    linears = problem.linear(point)
    cost, _ = problem.cost_at(point, defect_sd, linears)
    return _finish(problem, point, level, defect_sd, cost, linears, True)


def polish(problem: Problem, point: Point, level: float, settings: FitSettings) -> Fit:
    """Fit from a good start at one level."""
    defect_sd = level * problem.scale(point)
    found, cost, linears, converged = _optimize(
        problem, point, defect_sd, settings, settings.iterations
    )
    if settings.chain and defect_sd.size and level < 0.1:
        bar = limit_of_noise(problem.samples)
        # A chain of segments may be in a local minimum that one simulation from the first state
        # avoids.
        for _ in range(2):
            if cost < bar or current().must_end():
                break
            closed = chained(problem, found)
            if not problem.cost(closed, defect_sd, linears)[0] < 1e6 * cost:
                break
            other = _optimize(problem, closed, defect_sd, settings, settings.iterations)
            if not other[1] < cost - 0.5:
                break
            found, cost, linears, converged = other
    return _finish(problem, found, level, defect_sd, cost, linears, converged)


def chained(problem: Problem, point: Point) -> Point:
    """Point whose segments start at the end of the previous segment."""
    segmented = problem.segmented_records
    starts = [place.starts.copy() for place in point.places]
    for w, which in by_segment([s.count - 1 for s in segmented]):
        one = slice(w, w + 1)
        batches = []
        for i in which:
            jobs = Jobs.at_point(
                point.theta,
                segmented[i].segments[one],
                starts[i][one],
                problem.included,
                point.magnitudes,
            )
            batches.append((segmented[i].record, jobs))
        for i, run in zip(which, observe_all(problem.model, batches), strict=True):
            if np.all(np.isfinite(run.ends[0])):
                starts[i][w + 1] = run.ends[0]
    places = tuple(replace(place, starts=x) for x, place in zip(starts, point.places, strict=True))
    return replace(point, places=places, memo={})


def at_level(
    problem: Problem,
    point: Point,
    level: float,
    scale: Array | None,
    settings: FitSettings,
    iterations: int,
) -> Fit:
    """Fit at one level; segments in a local minimum are corrected before the next level."""
    defect_sd = level * (problem.scale(point) if scale is None else scale)
    found, cost, linears, converged = _optimize(problem, point, defect_sd, settings, iterations)
    fit = _finish(problem, found, level, defect_sd, cost, linears, converged)
    fixed = fit if scale is None else replace(fit, problem=replace(problem, state_scale=scale))
    tried = _rescue(fixed, settings)
    return tried if tried.cost < cost else fit


#: Largest mean square of the innovations up to which the model follows a record, on the first path
#: and on the second path along a single record.
FOLLOWED, FOLLOWED_FURTHER = 9.0, 25.0
#: Iterations per stage of a path, and the smallest extension per stage, as a share of a record.
STAGE, ONWARD = 8, 1.0 / 64.0
#: Log evidence by which two ends of the same minimum may differ.
REACHED = 2.0


#: Gain of a step below which a beginning of the records is fitted well enough to follow them
#: further, as a share of the noise of all samples.
FOLLOWING = 0.01


def _led(
    problem: Problem,
    point: Point,
    settings: FitSettings,
    limit: float = FOLLOWED,
    tell: Callable[[str], None] | None = None,
) -> Point:
    """Start point from which a fit without continuity defects reaches the right local minimum.

    If a mechanism releases a part earlier or later than the machine did, or strikes at another
    speed, one simulation from start to end is no longer nearly linear in any parameter. A fit to
    the whole record may then reach implausible parameters. Each record is therefore fitted only as
    far as the model follows it; the part after that contains no usable information yet. With the
    fitted parameters the model follows it further, and the fit is repeated.
    """
    defect_sd = np.zeros(0)
    way = settings.coarser(max(0.5, FOLLOWING * problem.samples))
    lengths = np.array([s.record.samples for s in problem.segmented_records])
    until, onward = np.zeros_like(lengths), ONWARD
    while not current().must_end():
        followed = [
            _agrees_until(s, residual, limit)
            for s, (_, residual, _) in zip(
                problem.segmented_records, problem.predict(point), strict=True
            )
        ]
        onward = ONWARD if np.all(followed >= until) else 2.0 * onward
        least = np.maximum(2.0, onward * lengths)
        until = np.minimum(lengths, np.maximum(until, followed) + least.astype(int))
        if tell is not None:
            tell(f", {np.sum(until) / np.sum(lengths):.0%} of the records")
        if np.all(until == lengths):
            break
        beginnings = tuple(
            s.until(int(n)) for s, n in zip(problem.segmented_records, until, strict=True)
        )
        point = _optimize(
            replace(problem, segmented_records=beginnings),
            replace(point, memo={}),
            defect_sd,
            way,
            STAGE,
        )[0]
        point = replace(point, memo={})
    return point


def _agrees_until(segmented: SegmentedRecord, residual: Array, followed: float) -> int:
    """Number of samples from the first one up to which the model follows a record.

    ``residual``: whitened residual, (W, m); NaN or infinite where the simulation failed.
    """
    samples = segmented.record.samples
    at = segmented.segments[:, :1] + np.arange(segmented.measured.shape[1])
    at = np.minimum(at, samples - 1).ravel()
    with np.errstate(invalid="ignore", over="ignore"):
        squares = residual.reshape(segmented.measured.shape) ** 2
    row = np.ones(ROW)
    total = np.convolve(np.bincount(at, squares.sum(axis=2).ravel(), samples), row)[:samples]
    seen = (segmented.weight > 0.0).sum(axis=2).ravel()
    count = np.convolve(np.bincount(at, seen, samples), row)[:samples]
    lost = np.flatnonzero(~(total <= followed * np.maximum(count, 1.0)))
    return int(lost.min()) if lost.size else samples


def _descend(
    problem: Problem, point: Point, settings: FitSettings, progress: Say | None, label: str
) -> tuple[Fit, Point, float]:
    """Fit from loose to tight continuity defects; keep the level of largest marginal likelihood.

    Also returns the point and the sum of squares at the loosest level.
    """
    levels = settings.levels
    if all(s.count == 1 for s in problem.segmented_records):
        levels = levels[-1:]  # there are no continuity defects
    best: tuple[float, float, Point] | None = None
    scale: Array | None = None
    loose, loosest = point, 0.0
    poor = 0
    # An unfinished level leads to a wrong local minimum of the next level.
    way = settings.coarser(0.3)
    for i, level in enumerate(levels):
        if progress is not None:
            progress(label, i, len(levels))
        tried = at_level(problem, point, level, scale, way, 40 if i == 0 else 20)
        if not tried.converged and i > 0:
            # Half of the way first: tightening too fast loses convergence across impacts.
            between = float(np.sqrt(level * levels[i - 1]))
            softly = at_level(problem, point, between, scale, way, 20)
            again = at_level(problem, softly.point, level, scale, way, 20)
            if again.cost < tried.cost:
                tried = again
        point, linears = tried.point, list(tried.linears)
        if scale is None:  # after the first level the states are close to the machine
            scale = problem.scale(point)
        defect_sd = level * scale
        cost, _ = problem.cost_at(point, defect_sd, linears)
        if i == 0:
            loose, loosest = point, cost
        normal = problem.normal(point, linears, defect_sd)
        value = evidence_at(problem, normal, cost, defect_sd, linears)
        if best is None or value > best[0]:
            best, poor = (value, level, point), 0
        else:
            poor += 1
        if poor >= 2 or current().must_end():
            break
    assert best is not None
    fixed = replace(problem, state_scale=scale)
    fit = polish(fixed, best[2], best[1], settings)
    return fit, loose, loosest


def _stuck(fit: Fit) -> list[Array]:
    """Segments with a very large residual, whose state may be in a wrong local minimum."""
    zs = []
    for segmented, chain in zip(fit.problem.segmented_records, fit.normal.chains, strict=True):
        n = np.maximum(segmented.samples.sum(axis=1), 1.0)
        zs.append((chain.grams[:, -1, -1] - n) / np.sqrt(2.0 * n))
    everything = np.concatenate(zs)
    typical = float(np.median(everything))
    spread = 1.4826 * float(np.median(np.abs(everything - typical))) + 1.0
    return [(z > typical + 12.0 * spread) & (z > 15.0) for z in zs]


def _rescue(fit: Fit, settings: FitSettings) -> Fit:
    """Restart bad segments from the end of the previous segment, or the mean of the neighbors."""
    for attempt in range(2):
        stuck = _stuck(fit)
        if not any(s.any() for s in stuck) or not fit.defect_sd.size:
            return fit
        places = []
        for i, (place, bad) in enumerate(zip(fit.point.places, stuck, strict=True)):
            starts = place.starts.copy()
            linear = fit.linears[i]
            ends = starts[1:] + linear.defect
            for w in np.flatnonzero(bad):
                # The residual of a segment may be caused by its own start or by that of the next
                # one.
                for v in (w, w + 1):
                    if 0 < v < len(starts):
                        if attempt == 0:
                            starts[v] = ends[v - 1]
                        elif v + 1 < len(starts):
                            starts[v] = 0.5 * (starts[v - 1] + starts[v + 1])
            places.append(replace(place, starts=starts))
        again = polish(
            fit.problem, replace(fit.point, places=tuple(places), memo={}), fit.level, settings
        )
        if again.cost < fit.cost - 1.0:
            fit = replace(again, notes=(*fit.notes, "segments restarted"))
    return fit


def model_with_variability(fit: Fit) -> Model:
    """The model of a fit, with the run-to-run variability of its records at the parameters."""
    return fit.problem.model.with_variability_at(fit.point.theta, *fit.machine_effects)


def with_variability(fit: Fit, settings: FitSettings, *, near: Fit | None = None) -> Fit:
    """Repeat a fit that explains the records, with the run-to-run variability at its parameters.

    ``near``: another fit that explains the records, whose parameters are used in its place.
    """
    of = fit if near is None else near
    if current().stopping() or not of.explains:
        return fit
    model = model_with_variability(of)
    if model is fit.problem.model or current().stopping():
        return fit
    problem = replace(fit.problem, model=model)
    again = polish(problem, replace(fit.point, memo={}), fit.level, settings)
    return replace(again, notes=fit.notes)


def estimate_states(problem: Problem, point: Point, level: float) -> Point:
    """Estimate start states at given parameters, as the start of a fit at a level."""
    if not problem.model.states():
        return point
    quick, loose = FitSettings(iterations=8, decrement=0.3), 1.0
    while loose > 1.001 * level and not current().must_end():
        point = at_level(problem, point, loose, None, quick, 8).point
        loose /= 10.0
    return point


def _across_jumps(fit: Fit, settings: FitSettings) -> Fit:
    """Continue a fit that explains the records but ends where the sum of squares jumps.

    Where a part is just caught or just missed, or where friction just holds, no shorter step is
    better, although the derivatives promise it. The search goes on from the other side, whatever
    the value there is. The lower of both ends is the result.
    """
    brief = replace(settings, iterations=min(settings.iterations, BEYOND))
    for _ in range(CROSSINGS if settings.jumps else 0):
        if fit.converged or not fit.explains or current().must_end():
            break
        problem, point, linears = fit.problem, fit.point, list(fit.linears)
        delta, length = _within(problem, point, fit.normal, ACROSS)
        if not length > 0.0:
            break
        # Derivatives by differences are wrong across a jump: they give the direction at most. What
        # has no unit of length (run-to-run variability, nuisances) is not part of the length.
        reach = problem.reach
        delta[: reach.size][np.isfinite(reach)] *= ACROSS / length
        beyond = problem.moved(point, fit.normal, delta)
        if not np.isfinite(problem.cost(beyond, fit.defect_sd, linears)[0]):
            break
        other = polish(problem, replace(beyond, memo={}), fit.level, brief)
        if not other.cost < fit.cost - SAME:
            break
        fit = other
    return fit


def _led_without(
    problem: Problem,
    point: Point,
    settings: FitSettings,
    left_out: int,
    tell: Callable[[str], None] | None = None,
) -> Point:
    """As :func:`_led`, but one record joins only when the others are fitted.

    A record whose events the model puts at other times can hold a fit in a wrong local minimum. The
    other records determine most parameters; then the model follows that record too.
    """
    records = problem.segmented_records
    part = replace(
        problem, segmented_records=tuple(s for i, s in enumerate(records) if i != left_out)
    )
    places = tuple(p for i, p in enumerate(point.places) if i != left_out)
    start = _led(part, replace(point, places=places, memo={}), settings, tell=tell)
    others = polish(part, replace(start, memo={}), 1.0, settings.coarser(0.5)).point
    joined = [*others.places]
    joined.insert(left_out, point.places[left_out])
    return _led(problem, replace(others, places=tuple(joined), memo={}), settings, tell=tell)


def _worst_record(fit: Fit, left_out: Sequence[int]) -> int | None:
    """Number of the record with the largest mean square of the residual; None: all are left out."""
    squares = []
    pairs = zip(fit.problem.segmented_records, fit.problem.predict(fit.point), strict=True)
    for i, (segmented, (_, residual, _)) in enumerate(pairs):
        with np.errstate(invalid="ignore", over="ignore"):
            value = float(np.sum(residual**2)) / max(int(np.count_nonzero(segmented.weight)), 1)
        if i not in left_out:
            squares.append((value if np.isfinite(value) else np.inf, -i))
    return -max(squares)[1] if squares else None


def _fit_whole(problem: Problem, point: Point, settings: FitSettings, progress: Say | None) -> Fit:
    """Fit records that are simulated as a whole, along several paths, and keep the best end.

    The first path leads along all records. On each further one, the record that the best end
    explains worst joins last. The search ends when two paths reach the best end and it explains the
    records, or when ``restarts`` records, or all of them, have joined last. A single record has a
    second path with another limit.
    """
    starts: list[Point] = []
    ends: list[Fit] = []

    def tell(share: str = "") -> None:
        if progress is not None:
            progress(f"start {len(ends) + 1}{share}", 0, 0)

    def descend(start: Point) -> None:
        tell()
        if not any(np.array_equal(start.theta, known.theta) for known in starts):
            starts.append(start)
            fit = _across_jumps(polish(problem, start, 1.0, settings), settings)
            if not fit.cost >= 0.0:
                fit = replace(fit, cost=np.inf, log_evidence=-np.inf)
            ends.append(fit)
            if progress is not None:
                current().fitted(fit.chi2 / fit.dof)

    def best() -> Fit:
        return min(ends, key=lambda fit: fit.cost)

    if not problem.has_priors:
        # A beginning may contain no information about a parameter without a prior.
        descend(point)
        if best().explains:
            return best()
    descend(_led(problem, point, settings, tell=tell))
    if settings.restarts == 0 or not problem.has_priors:
        return best()
    if len(problem.segmented_records) == 1:
        if not current().must_end():
            descend(_led(problem, point, settings, FOLLOWED_FURTHER, tell))
        return best()
    left_out: list[int] = []
    while len(left_out) < settings.restarts and not current().must_end():
        reached = [fit for fit in ends if fit.cost < best().cost + 2.0 * REACHED]
        if len(reached) > 1 and best().explains:
            break
        worst = _worst_record(best(), left_out)
        if worst is None:
            break
        left_out.append(worst)
        descend(_led_without(problem, point, settings, worst, tell))
    return best()


def fit_problem(
    problem: Problem,
    settings: FitSettings | None = None,
    *,
    point: Point | None = None,
    progress: Say | None = None,
    label: str = "fit",
) -> Fit:
    """Fit a problem, starting from its priors.

    Records that are simulated as a whole are first fitted as far as the model follows them (see
    :func:`_led`), and fits that explain them continue across jumps (see :func:`_across_jumps`).
    With segments, continuity defects decrease from loose to tight, and the level with the largest
    marginal likelihood is used. If such a fit is poor, it is repeated from other starts, so that a
    local minimum is not mistaken for a gap: from one simulation through all segments, and segments
    with a large residual from their neighbors. Parameters are drawn from their priors until the
    best fit is reached a second time.
    """
    settings = replace(settings or FitSettings(), chain=True)
    first = point or problem.start()
    if not problem.model.states(machine_candidates(problem.included)):
        return _fit_whole(problem, first, settings, progress)
    fit, loose, loosest = _descend(problem, first, settings, progress, label)
    fit = _rescue(fit, settings)
    if fit.explains and fit.converged:
        return fit
    free = [i for i in problem.free]
    if not free or problem.frozen:
        return fit
    if loosest < limit_of_noise(problem.samples):
        return fit  # with segments the model can follow: no other start would change that
    generator = np.random.default_rng(settings.seed)
    way = settings.coarser(0.3)

    def loosened(point: Point) -> Fit:
        return at_level(fit.problem, point, settings.levels[0], None, way, 40)

    lowest = loosened(replace(loose, memo={})).cost if settings.restarts else 0.0
    for i in range(settings.restarts):
        if current().must_end():
            break
        theta = fit.point.theta.copy()
        for j in free:
            p = problem.model.parameters[j]
            sd = p.sd if np.isfinite(p.sd) else 0.3 * p.size
            theta[j] = np.clip(theta[j] + sd * generator.standard_normal(), p.lower, p.upper)
        name = f"{label}, restart {i + 1}"
        if progress is not None:
            progress(name, 0, len(settings.levels))
        # A start that is not better with the loosest defects is not better with tight ones.
        tried = loosened(replace(loose, theta=theta, memo={}))
        if tried.cost > lowest + 2.0 * SAME:
            continue
        if tried.cost > lowest - 2.0 * SAME:
            break  # reached from two starts
        lowest = tried.cost
        attempt, _, _ = _descend(
            fit.problem, replace(tried.point, memo={}), settings, progress, name
        )
        if attempt.log_evidence > fit.log_evidence + SAME:
            fit = replace(attempt, notes=(*fit.notes, f"restart {i + 1} was better"))
        elif attempt.log_evidence > fit.log_evidence - SAME:
            break  # reached from two starts
    return fit
