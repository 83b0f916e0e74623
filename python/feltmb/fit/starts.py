"""Start states of records that a fit does not find: other starts, one record at a time.

A record in which parts meet or part can have several local minima over its start states, also if it
is divided into segments: the hammer may rest on the jack or hang above it by less than a camera
sees, and all that follows differs. The fit then explains the records, but less well than it could.
So the states of a record are fitted again from other first states, with the parameters unchanged,
which takes a few simulations of one record: from the expected first state, and from ones that are
drawn near it and near the fitted one. Every other time the record is simulated from there as a
whole. The search ends if the best states were reached from several starts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import Place
from feltmb.fit.problem import Point, Problem
from feltmb.fit.solve import SAME, Fit, FitSettings, chained, finish, polish
from feltmb.fit.watch import current

__all__ = ["from_other_starts"]

#: Standard deviation of the drawn states, as a share of their prior standard deviation (without a
#: prior, of their spread).
NEAR = 0.1
#: Level of continuity defects from which the states are tightened again.
LOOSE = 1e-3
#: Largest number of starts of a record, and of those that reach the best states before the search
#: ends.
MOST, REACHED = 8, 2


def from_other_starts(fit: Fit, settings: FitSettings, most: int = MOST) -> Fit:
    """The fit, or the fit from other start states of its records if that is better.

    Parameters
    ----------
    fit
        A fit with continuity defects; another fit is returned unchanged.
    settings
        Settings of the fit.
    most
        Largest number of starts of a record; 1: the expected first state only.

    Returns
    -------
    Fit
        The fit with the larger log evidence.
    """
    point = _scattered(fit.problem, fit.point, fit.level, settings, most)
    if point is fit.point:
        return fit
    other = polish(fit.problem, point, fit.level, settings)
    better = other.cost >= 0.0 and other.log_evidence > fit.log_evidence + SAME
    return replace(other, notes=fit.notes) if better else fit


def _scattered(
    problem: Problem, point: Point, level: float, settings: FitSettings, most: int
) -> Point:
    """The point with better states of its records at the same parameters, or the point itself."""
    scale = problem.scale(point)
    if not scale.size:
        return point
    places = list(point.places)
    for i, segmented in enumerate(problem.segmented_records):
        if current().must_end():
            break
        one = replace(
            problem,
            segmented_records=(segmented,),
            frozen=True,
            state_scale=scale,
        )
        mean, sd = problem.start_prior(segmented)
        known = np.isfinite(sd)
        expected = np.where(known, mean, places[i].starts[0])
        width = NEAR * np.where(known, sd, scale)
        if np.any(width > 0.0):
            found = _searched(one, point, places[i], expected, width, level, settings, i, most)
            places[i] = places[i] if found is None else found
    if all(a is b for a, b in zip(places, point.places, strict=True)):
        return point
    return replace(point, places=tuple(places), memo={})


def _searched(
    one: Problem,
    point: Point,
    place: Place,
    expected: Array,
    width: Array,
    level: float,
    settings: FitSettings,
    number: int,
    most: int,
) -> Place | None:
    """Better states of one record than ``place``, or None."""

    def polished(start: Array, *, whole: bool) -> Fit:
        starts = place.starts.copy()
        starts[0] = start
        at = replace(point, places=(replace(place, starts=starts),), memo={})
        if whole:
            at = chained(one, at)
        if level < LOOSE:
            at = replace(polish(one, at, LOOSE, way).point, memo={})
        return polish(one, at, level, way)

    # The draws of a record do not depend on those of the others.
    generator = np.random.default_rng((settings.seed, number))
    way = replace(settings, iterations=15, chain=False, worth=np.inf)
    at = replace(point, places=(place,), memo={})
    best = finish(one, at, level, level * one.scale(at)).log_evidence
    reached, found = 0, None
    for k in range(most):
        if current().must_end():
            break
        near = expected if k % 4 == 0 else place.starts[0]
        drawn = width * generator.standard_normal(width.size) if k else 0.0
        tried = polished(near + drawn, whole=k % 2 == 0)
        if not 0.0 <= tried.cost < np.inf:
            continue  # a simulation from there diverges
        if tried.log_evidence > best + SAME:
            best, reached, found = tried.log_evidence, 0, tried.point.places[0]
        elif tried.log_evidence > best - SAME:
            reached += 1
            if reached == REACHED:
                break
    return found
