"""Weak-constraint multiple shooting: the fit of a model, with or without effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from feltmb.data import Array
from feltmb.files import digest_of, package_digest
from feltmb.fit.linearize import InputColumns, Linear, Place
from feltmb.fit.model import Candidate, Jobs, Model
from feltmb.fit.observe import machine_candidates, observe_jobs
from feltmb.fit.problem import Normal, Point, Problem
from feltmb.fit.recursive import assimilate
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.together import each
from feltmb.fit.watch import current

__all__ = [
    "Fit",
    "FitSettings",
    "Interval",
    "at_level",
    "chained",
    "estimate_states",
    "finish",
    "fit_problem",
    "polish",
]

Progress = Callable[[str, int, int], None]
#: Where the fit is poor, a gain below this share of the misfit is not worth a simulation.
COARSE = 3e-5
#: Share of what a linear model promised that must have come, for it to say where a fit will end.
TRUSTED = 0.5
#: Shares of the records that a fit without gaps is led along, steps at each, and the sum of squares
#: over the number of samples from which it is.
HORIZONS, LED, NEAR = (0.5, 0.65, 0.8, 0.9), 5, 4.0
#: Prior standard deviations from which a parameter makes a fit doubtful, and the factors of the
#: noise at which a doubtful one is tempered.
BEYOND_PRIOR, TEMPERATURES = 3.3, (30.0, 10.0, 5.0, 2.5)
#: Log evidence within which two fits are one.
SAME = 0.5
#: Continuity defect where the process noise says what a segment may depart, as a share of the scale
#: of a state, and of a state that vibrates as a share of its spread along the records.
TIGHT, PHASE = 0.03, 0.1
#: Note of a fit that came down with the noise.
ANNEALED = "fitted from much noise to little"


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How hard a fit tries."""

    levels: tuple[float, ...] = (1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    """Gaps between segments that are tried, as shares of the spread of the states; the one with
    the largest marginal likelihood is kept."""
    iterations: int = 40
    decrement: float = 0.02
    """A step that can lower the sum of squares by less than this ends the search."""
    restarts: int = 3
    seed: int = 0
    chain: bool = False
    """Whether a poor fit is tried again from one simulation through all segments."""
    worth: float = np.inf
    """Sum of squares that another fit has. Where there are no continuity defects, a search ends,
    unfinished, at a point whose linear model does not promise to get below it, if the step before
    brought what its own had promised."""

    def coarser(self, decrement: float, iterations: int | None = None) -> FitSettings:
        """For a fit on the way to another: this decrement at least, other iterations if given."""
        return replace(
            self,
            decrement=max(self.decrement, decrement),
            iterations=self.iterations if iterations is None else iterations,
        )


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A fitted number with its uncertainty."""

    name: str
    unit: str
    value: float
    sd: float
    low: float
    """95 % interval, cut at the limits."""
    high: float
    prior: float
    prior_sd: float
    at_limit: bool
    contraction: float
    """1 - (sd / prior sd)^2: what the data say beyond the prior [1]; 1 without a prior."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fit of a problem."""

    problem: Problem
    point: Point
    level: float
    """Gap between segments, as a share of the spread of the states."""
    gap_sd: Array
    cost: float
    """Sum of squares with priors and gaps."""
    chi2: float
    """Sum of squares of the innovations."""
    dof: float
    log_evidence: float
    """Laplace approximation, up to a constant that all fits to the same records share."""
    levels: tuple[tuple[float, float], ...]
    """Log marginal likelihood by level."""
    converged: bool
    notes: tuple[str, ...]
    linears: tuple[Linear, ...] = field(repr=False)
    normal: Normal = field(repr=False)

    @property
    def explains(self) -> bool:
        """Whether the sum of squares is that of noise, within four standard deviations."""
        return bool(self.chi2 < self.dof + 4.0 * np.sqrt(2.0 * self.dof))

    @property
    def included(self) -> tuple[Candidate, ...]:
        """Effects that are part of the fit."""
        return self.problem.included

    @property
    def covariance(self) -> Array:
        """Covariance of the shared globals (free parameters, then magnitudes)."""
        count = len(self.problem.free) + len(self.included)
        total = inverse_scaled(self.normal.matrix)
        return np.asarray(total[:count, :count])

    @property
    def prior_deviation(self) -> Array:
        """Free parameters that have a prior: distance from it in its standard deviations."""
        everything = self.problem.model.parameters
        known = [i for i in self.problem.free if np.isfinite(everything[i].sd)]
        far = [(self.point.theta[i] - everything[i].value) / everything[i].sd for i in known]
        return np.array(far, dtype=np.float64)

    def intervals(self) -> tuple[Interval, ...]:
        """Parameters and magnitudes with 95 % intervals."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
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
        for (name, unit, value, prior, prior_sd, low, high), s in zip(rows, sd, strict=True):
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
                    at_limit=bool(np.isclose(value, low) or np.isclose(value, high)),
                    contraction=float(1.0 - (s / prior_sd) ** 2) if prior_sd > 0.0 else 0.0,
                )
            )
        return tuple(out)


def inverse_scaled(matrix: Array) -> Array:
    """Inverse of a symmetric matrix; infinite variance where nothing supports a number."""
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
    gap_sd: Array,
    settings: FitSettings,
    iterations: int,
) -> tuple[Point, float, list[Linear], bool]:
    """Minimize from a point, or take the result from the store of the problem."""
    if problem.store is None:
        return _minimize(problem, point, gap_sd, settings, iterations)
    linears = problem.linear(point)
    cost, parts = problem.cost_at(point, gap_sd, linears)
    key = digest_of(
        package_digest(),  # another code may find another minimum
        cost,
        *parts,
        point.theta,
        point.magnitudes,
        gap_sd,
        iterations,
        settings.decrement,
        settings.worth,
        problem.frozen,
        settings.chain,
        [(t.name, t.shape) for t in problem.included],
        [(p.name, p.value, p.sd, p.lower, p.upper) for p in problem.model.parameters],
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
    found, cost, linears, converged = _minimize(problem, point, gap_sd, settings, iterations)
    if current().stopping():  # it may have been cut short
        return found, cost, linears, converged
    arrays = {"theta": found.theta, "magnitudes": found.magnitudes}
    arrays |= {"cost": np.array(cost), "converged": np.array(float(converged))}
    for i, place in enumerate(found.places):
        arrays |= {f"starts{i}": place.starts, f"nuisances{i}": place.nuisances}
    for i, linear in enumerate(linears):
        arrays |= {f"by_input{i}": linear.by_input, f"ends_by_input{i}": linear.ends_by_input}
    problem.store.put(key, {}, arrays)
    return found, cost, linears, converged


def _minimize(
    problem: Problem,
    point: Point,
    gap_sd: Array,
    settings: FitSettings,
    iterations: int,
) -> tuple[Point, float, list[Linear], bool]:
    """Levenberg-Marquardt with damping of its own for every segment."""
    linears = problem.linear(point)
    cost, parts = problem.cost_at(point, gap_sd, linears)
    samples = problem.samples
    # Sums of squares of different gaps do not compare.
    worth = np.inf if gap_sd.size else settings.worth
    lam = 1e-4
    damping = [np.zeros(s.count) for s in problem.segmented_records]
    trusted = False
    for _ in range(iterations):
        if current().stopping():
            return point, cost, linears, False
        accepted = False
        for _ in range(8):
            used = [d if np.any(d) else None for d in damping]
            normal = problem.normal(point, linears, gap_sd, used)
            attempt, gain = problem.step(point, normal, lam, linears)
            # The gain of the states is within the chains: what is left of the residual.
            left = sum(float(np.sum(c.grams[:, -1, -1])) for c in normal.chains)
            predicted = cost - left + gain - _priors(problem, point)
            least = max(settings.decrement, COARSE * max(cost - 4.0 * samples, 0.0))
            if predicted < least:
                return point, cost, linears, True
            # Damped steps promise less than there is; far off, so does any linear model.
            if trusted and lam < 1e-2 and cost - predicted > worth:
                return point, cost, linears, False
            new, new_parts = problem.cost(attempt, gap_sd, linears)
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
        trusted = cost - new > TRUSTED * predicted
        point = attempt
        lam /= 8.0
        for d in damping:
            d /= 10.0
            d[d < 1e-6] = 0.0
        # Near the end the columns of the input noise change no more.
        near = cost - new < 0.05 * new
        linears = problem.linear(point, known=linears if near else None)
        cost, parts = problem.cost_at(point, gap_sd, linears)
        if done:
            return point, cost, linears, True
    return point, cost, linears, False


def _priors(problem: Problem, point: Point) -> float:
    """Part of the cost that is in no segment."""
    total = 0.0
    if not problem.frozen:
        for i in problem.free:
            p = problem.model.parameters[i]
            total += float(((point.theta[i] - p.value) / p.sd) ** 2)
    for segmented, place in zip(problem.segmented_records, point.places, strict=True):
        for (_, _, sd), value in zip(segmented.nuisances, place.nuisances, strict=True):
            total += (value / sd) ** 2
    return total


def _evidence(problem: Problem, normal: Normal, cost: float, gap_sd: Array) -> float:
    """Log marginal likelihood over states, inputs and parameters (Laplace)."""
    value = -0.5 * cost
    for segmented, chain in zip(problem.segmented_records, normal.chains, strict=True):
        value -= float(np.sum(chain.log_dets))
        # Norm of the prior of the first state: without it every hidden state that starts known
        # would cost an effect -log(1e-12) = 28 units of log evidence a record.
        _, sd = problem.start_prior(segmented)
        value -= float(np.sum(np.log(np.maximum(sd[np.isfinite(sd)], 1e-12))))
        if gap_sd.size:
            value -= (segmented.count - 1) * float(np.sum(np.log(gap_sd)))
    return value


def _finish(
    problem: Problem,
    point: Point,
    level: float,
    gap_sd: Array,
    cost: float,
    linears: list[Linear],
    converged: bool,
    notes: tuple[str, ...],
    levels: tuple[tuple[float, float], ...],
) -> Fit:
    normal = problem.normal(point, linears, gap_sd)
    chi2, dof = 0.0, 0.0
    states = len(gap_sd)
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
        gap_sd=gap_sd,
        cost=cost,
        chi2=chi2,
        dof=max(dof, 1.0),
        log_evidence=_evidence(problem, normal, cost, gap_sd),
        levels=levels,
        converged=converged,
        notes=notes,
        linears=tuple(linears),
        normal=normal,
    )


def finish(problem: Problem, point: Point, level: float, gap_sd: Array) -> Fit:
    """A fit that is taken as it is, without a search."""
    linears = problem.linear(point)
    cost, _ = problem.cost_at(point, gap_sd, linears)
    return _finish(problem, point, level, gap_sd, cost, linears, True, (), ())


def polish(problem: Problem, point: Point, level: float, settings: FitSettings) -> Fit:
    """Fit from a good start at one level."""
    gap_sd = level * problem.scale(point)
    found, cost, linears, converged = _optimize(
        problem, point, gap_sd, settings, settings.iterations
    )
    if settings.chain and gap_sd.size and level < 0.1:
        bar = problem.samples + 4.0 * np.sqrt(2.0 * problem.samples)
        # A chain of segments can be stuck where one simulation from the first state is not.
        for _ in range(2):
            if cost < bar:
                break
            closed = chained(problem, found)
            if not problem.cost(closed, gap_sd, linears)[0] < 1e6 * cost:
                break
            other = _optimize(problem, closed, gap_sd, settings, settings.iterations)
            if not other[1] < cost - 0.5:
                break
            found, cost, linears, converged = other
    return _finish(problem, found, level, gap_sd, cost, linears, converged, (), ())


def chained(problem: Problem, point: Point) -> Point:
    """The point whose segments start where the segment before ends."""

    def of(model: Model, at: tuple[SegmentedRecord, Place]) -> Place:
        segmented, place = at
        starts = place.starts.copy()
        held = None if place.memory is None else list(place.memory)
        for w in range(segmented.count - 1):
            one = slice(w, w + 1)
            jobs = Jobs.at_point(
                point.theta,
                segmented.segments[one],
                starts[one],
                problem.included,
                point.magnitudes,
                None if held is None else (held[w],),
            )
            run = observe_jobs(model, segmented.record, jobs)
            if np.all(np.isfinite(run.ends[0])):
                starts[w + 1] = run.ends[0]
            if held is not None and run.memory is not None:
                held[w + 1] = run.memory[0]
        return Place(starts, place.nuisances, None if held is None else tuple(held))

    places = each(
        problem.model, of, list(zip(problem.segmented_records, point.places, strict=True))
    )
    return replace(point, places=tuple(places), memo={})


def at_level(
    problem: Problem,
    point: Point,
    level: float,
    scale: Array | None,
    settings: FitSettings,
    iterations: int,
) -> Fit:
    """Fit at one level of a descent; segments that are stuck there would be stuck below as well."""
    gap_sd = level * (problem.scale(point) if scale is None else scale)
    found, cost, linears, converged = _optimize(problem, point, gap_sd, settings, iterations)
    fit = _finish(problem, found, level, gap_sd, cost, linears, converged, (), ())
    fixed = fit if scale is None else replace(fit, problem=replace(problem, state_scale=scale))
    tried = _rescue(fixed, settings)
    return tried if tried.cost < cost else fit


def _led(problem: Problem, point: Point, settings: FitSettings) -> Point:
    """A point from which a fit without gaps ends in the right valley.

    One simulation from start to end is no longer nearly linear in anything once a mechanism lets
    go earlier or later than the machine did, and a fit to all of it at once may go to where no
    parameter is plausible. So the beginnings of the records are fitted first, then more and more
    of them.
    """
    gap_sd = np.zeros(0)
    if problem.cost_at(point, gap_sd, problem.linear(point))[0] < NEAR * problem.samples:
        return point
    way = settings.coarser(0.3)
    for share in HORIZONS:
        segmented_records = tuple(s.until(share) for s in problem.segmented_records)
        point, _, _, _ = _optimize(
            replace(problem, segmented_records=segmented_records),
            replace(point, memo={}),
            gap_sd,
            way,
            LED,
        )
    return replace(point, memo={})


def _descend(
    problem: Problem, point: Point, settings: FitSettings, progress: Progress | None, label: str
) -> tuple[Fit, Point, float]:
    """From loose to tight gaps; keep the level with the largest marginal likelihood.

    Also the point and the sum of squares at the loosest.
    """
    if not problem.model.states(machine_candidates(problem.included)):
        known = all(np.isfinite(problem.model.parameters[i].sd) for i in problem.free)
        if known:
            fit = polish(problem, _led(problem, point, settings), 1.0, settings)
        else:  # a beginning may say nothing of a parameter that no prior holds
            fit = polish(problem, point, 1.0, settings)
            if not fit.explains:
                led = polish(problem, _led(problem, point, settings), 1.0, settings)
                fit = led if led.cost < fit.cost else fit
        return fit, fit.point, fit.cost
    levels = settings.levels
    if all(s.count == 1 for s in problem.segmented_records):
        levels = levels[-1:]  # there are no gaps
    best: tuple[float, float, Point] | None = None
    scale: Array | None = None
    loose, loosest = point, 0.0
    table: list[tuple[float, float]] = []
    poor = 0
    # A level that is left unfinished leads into a wrong valley of the next.
    way = settings.coarser(0.3)
    for i, level in enumerate(levels):
        if progress is not None:
            progress(label, i, len(levels))
        tried = at_level(problem, point, level, scale, way, 40 if i == 0 else 20)
        if not tried.converged and i > 0:
            # Half way first: a gap that closes too fast tears a motion that hits something.
            between = float(np.sqrt(level * levels[i - 1]))
            softly = at_level(problem, point, between, scale, way, 20)
            again = at_level(problem, softly.point, level, scale, way, 20)
            if again.cost < tried.cost:
                tried = again
        point, linears = tried.point, list(tried.linears)
        if scale is None:  # after the first level the states are those of the machine
            scale = problem.scale(point)
        gap_sd = level * scale
        cost, _ = problem.cost_at(point, gap_sd, linears)
        if i == 0:
            loose, loosest = point, cost
        value = _evidence(problem, problem.normal(point, linears, gap_sd), cost, gap_sd)
        table.append((level, value))
        if best is None or value > best[0]:
            best, poor = (value, level, point), 0
        else:
            poor += 1
        if poor >= 2 or current().stopping():
            break
    assert best is not None
    fixed = replace(problem, state_scale=scale)
    fit = polish(fixed, best[2], best[1], settings)
    return replace(fit, levels=tuple(table)), loose, loosest


def _annealed(fit: Fit, settings: FitSettings) -> Fit:
    """A doubtful fit without gaps once more, from the priors, with noise that is lowered by steps.

    Under much noise only the plain parts of a motion count, and the priors hold what they do not
    show; what is fine is fitted from there. The better of the two is kept.
    """
    problem = fit.problem
    if current().stopping():
        return fit
    point = problem.start()
    for factor in TEMPERATURES:
        tempered = replace(
            problem,
            segmented_records=tuple(s.with_scaled_noise(factor) for s in problem.segmented_records),
        )
        point = polish(tempered, replace(point, memo={}), fit.level, settings).point
    again = polish(problem, replace(point, memo={}), fit.level, settings)
    if not again.cost < fit.cost - 1.0:
        return fit
    return replace(again, levels=fit.levels, notes=(*fit.notes, ANNEALED))


def _stuck(fit: Fit) -> list[Array]:
    """Segments whose misfit stands far above the others': a state may sit in a wrong valley."""
    zs = []
    for segmented, chain in zip(fit.problem.segmented_records, fit.normal.chains, strict=True):
        n = np.maximum(segmented.samples.sum(axis=1), 1.0)
        zs.append((chain.grams[:, -1, -1] - n) / np.sqrt(2.0 * n))
    everything = np.concatenate(zs)
    typical = float(np.median(everything))
    spread = 1.4826 * float(np.median(np.abs(everything - typical))) + 1.0
    return [(z > typical + 12.0 * spread) & (z > 15.0) for z in zs]


def _rescue(fit: Fit, settings: FitSettings) -> Fit:
    """Restart stuck segments from the end of the segment before, or from its neighbors' mean."""
    for attempt in range(2):
        stuck = _stuck(fit)
        if not any(s.any() for s in stuck) or not fit.gap_sd.size:
            return fit
        places = []
        for i, (place, bad) in enumerate(zip(fit.point.places, stuck, strict=True)):
            starts = place.starts.copy()
            linear = fit.linears[i]
            ends = starts[1:] + linear.gap
            for w in np.flatnonzero(bad):
                # The misfit of a segment may come from its own start or from that of the next.
                for v in (w, w + 1):
                    if 0 < v < len(starts):
                        if attempt == 0:
                            starts[v] = ends[v - 1]
                        elif v + 1 < len(starts):
                            starts[v] = 0.5 * (starts[v - 1] + starts[v + 1])
            places.append(Place(starts, place.nuisances, place.memory))
        again = polish(
            fit.problem, replace(fit.point, places=tuple(places), memo={}), fit.level, settings
        )
        if again.cost < fit.cost - 1.0:
            fit = replace(again, levels=fit.levels, notes=(*fit.notes, "segments restarted"))
    return fit


def estimate_states(problem: Problem, point: Point, level: float) -> Point:
    """Start states of records at given parameters, to start a fit at a level from."""
    if not problem.model.states():
        return point
    if problem.model.recursive:
        fixed, gap_sd = _tied(problem, point)
        return assimilate(fixed, point, gap_sd, held=True)
    quick, loose = FitSettings(iterations=8, decrement=0.3), 1.0
    while loose > 1.001 * level:
        point = at_level(problem, point, loose, None, quick, 8).point
        loose /= 10.0
    return point


def _tied(problem: Problem, point: Point) -> tuple[Problem, Array]:
    """A problem with the states' scales of its process noise, and its continuity defects."""
    states = problem.model.states(machine_candidates(problem.included))
    gap_sd = TIGHT * np.array([s.scale for s in states])
    spread = np.std(np.vstack([p.starts for p in point.places]), axis=0)
    vibrating = np.array([s.vibrates for s in states])
    gap_sd[vibrating] = np.maximum(gap_sd, PHASE * spread)[vibrating]
    if problem.state_scale is not None:  # that of another fit to the same records
        gap_sd[: len(problem.state_scale)] = TIGHT * problem.state_scale
    return replace(problem, state_scale=gap_sd / TIGHT), gap_sd


def _followed(
    problem: Problem,
    settings: FitSettings,
    point: Point | None,
    progress: Progress | None,
    label: str,
) -> Fit:
    """Fit from states and parameters that are estimated along the records.

    See :mod:`feltmb.fit.recursive`. Continuity is tight from the beginning: what unknown forces do
    in a segment is the process noise of its laws. States that vibrate lose their phase.
    """
    start = point or problem.start()
    fixed, gap_sd = _tied(problem, start)
    if point is None:
        for i, held in enumerate((problem.frozen, True)):
            if progress is not None:
                progress(label, i, 3)
            start = assimilate(fixed, start, gap_sd, held=held)
    return polish(fixed, start, TIGHT, settings)


def fit_problem(
    problem: Problem,
    settings: FitSettings | None = None,
    *,
    point: Point | None = None,
    progress: Progress | None = None,
    label: str = "fit",
) -> Fit:
    """Fit a problem from its priors.

    Gaps go from loose to tight; the level with the largest marginal likelihood is kept. A fit that
    is not good is tried again from other starts, so that a stuck fit is not taken for a gap:
    segments of large residual are restarted from their neighbors, and the parameters from draws of
    their priors, until the best fit is reached a second time.
    """
    settings = settings or FitSettings()
    if problem.model.recursive:
        return _followed(problem, settings, point, progress, label)
    first = point or problem.start()
    fit, loose, loosest = _descend(problem, first, settings, progress, label)
    fit = _rescue(fit, settings)
    sound = (
        fit.explains and fit.converged and not np.any(np.abs(fit.prior_deviation) > BEYOND_PRIOR)
    )
    if not fit.gap_sd.size and not problem.frozen and not sound:
        fit = _annealed(fit, settings)
    if fit.explains and fit.converged:
        return fit
    free = [i for i in problem.free]
    if not free or not fit.gap_sd.size or problem.frozen:
        return fit
    if loosest < problem.samples + 4.0 * np.sqrt(2.0 * problem.samples):
        return fit  # segment by segment the model can follow: no other start would change that
    generator = np.random.default_rng(settings.seed)
    way = settings.coarser(0.3)

    def loosened(point: Point) -> Fit:
        return at_level(fit.problem, point, settings.levels[0], None, way, 40)

    lowest = loosened(replace(loose, memo={})).cost if settings.restarts else 0.0
    for i in range(settings.restarts):
        if current().stopping():
            break
        theta = fit.point.theta.copy()
        for j in free:
            p = problem.model.parameters[j]
            sd = p.sd if np.isfinite(p.sd) else 0.3 * p.size
            theta[j] = np.clip(theta[j] + sd * generator.standard_normal(), p.lower, p.upper)
        name = f"{label}, restart {i + 1}"
        if progress is not None:
            progress(name, 0, len(settings.levels))
        # A start that ends no lower with the loosest gaps ends no lower with tight ones.
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
