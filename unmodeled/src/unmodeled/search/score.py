"""First-order gains of causes that a set lacks, with all other unknowns projected out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.search.evidence import Fitted, prior_of, system, weights
from unmodeled.search.linear import Ask, evaluate
from unmodeled.search.problem import RELEASED, Member, Members, Problem

__all__ = ["Directions", "Score", "by_record", "directions", "scores"]

#: Number of causes whose derivatives are computed at a further fit.
LIKELY = 24


@dataclass(frozen=True)
class Score:
    """A cause that a set lacks."""

    cause: int
    shape: Any
    gain: float
    """Gain to first order [log evidence], parameters refitted."""
    step: float
    """Magnitude to first order, in expected magnitudes [1]; within the bounds of the cause."""
    columns: tuple[Array, ...] = ()
    """Derivatives of the residuals by the magnitude, by record, (n, m); (): they are not used,
    because their sign is wrong."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Derivatives of the residuals by the magnitudes of causes that a set lacks."""

    further: Members
    """The causes, each with all shapes."""
    by_further: tuple[Array, ...]
    """By record, (n, m, c)."""


def directions(problem: Problem, fitted: Fitted, near: Directions | None = None) -> Directions:
    """Directions of the causes that a set lacks.

    Parameters
    ----------
    problem, fitted
        The problem and the set.
    near
        Directions at another fit. If derivatives are not cheap, only those of the causes are
        computed that gain most with these: they differ little between fits.
    """
    further = tuple(
        Member(i, shape)
        for i, cause in enumerate(problem.causes)
        if cause.effect is not None and i not in fitted.causes
        for shape in cause.effect.shapes
    )
    if near is not None and not problem.model.cheap_derivatives:
        gains: dict[int, float] = {}
        slope, curvature, _ = _products(problem, fitted, near)
        for m, b, a in zip(near.further, slope, curvature, strict=True):
            if m.cause in fitted.causes:
                continue
            gains[m.cause] = max(gains.get(m.cause, 0.0), float(b * b / a) if a > 0.0 else 0.0)
        likely = sorted(gains, key=lambda i: -gains[i])[:LIKELY]
        further = tuple(m for m in further if m.cause in likely)
    ask = Ask(fitted.members, fitted.point, problem.fit, further, by_global=False, rough=True)
    linears = evaluate(problem, [ask])[0]
    return Directions(further, tuple(x.by_further for x in linears))


def _products(
    problem: Problem, fitted: Fitted, seen: Directions
) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Slope and curvature by the magnitude of each cause, all other unknowns projected out.

    Also the normal equations of the set: matrix, right side, and weights of the prior.
    """
    linears = [
        replace(x, by_further=y) for x, y in zip(fitted.linears, seen.by_further, strict=True)
    ]
    # All samples count: the rank is that of the residual that a cause takes away, and where few
    # samples are effective, the prior of its magnitude would hide it.
    own = system(problem, problem.fit, fitted.members, fitted.point, linears, fitted.noise, 1.0)
    x = fitted.point.x
    weight = prior_of(problem, fitted.members).weights(x)
    inverse = np.linalg.inv(own.matrix + np.diag(weight))
    slope = own.gain - own.further @ inverse @ (own.right - weight * x)
    curvature = np.diag(own.own) + 1.25
    curvature -= np.einsum("ij,jl,il->i", own.further, inverse, own.further)
    return slope, curvature, (own.matrix, own.right, weight)


def scores(problem: Problem, fitted: Fitted, seen: Directions) -> list[Score]:
    """The best shape of each cause that a set lacks, largest gain first.

    The slope of a one-sided effect excludes nothing: at a fit whose parameters took up its action
    it may have the wrong sign.
    """
    slope, curvature, normal = _products(problem, fitted, seen)
    best: dict[int, Score] = {}
    for j, (m, b, a) in enumerate(zip(seen.further, slope, curvature, strict=True)):
        if not (np.isfinite(b) and a > 0.0):
            continue
        low, high = problem.causes[m.cause].bounds
        step = float(b / a)
        inside = low <= step <= high and step != 0.0
        start = float(np.clip(step if inside else 1.0, max(low, -3.0), min(high, 3.0)))
        gain = 0.5 * float(b * b / a)
        if m.cause not in best or gain > best[m.cause].gain:
            columns = tuple(y[:, :, j].copy() for y in seen.by_further) if inside else ()
            best[m.cause] = Score(m.cause, m.shape, gain, start, columns)
    best |= _released(problem, fitted, *normal)
    best |= _in_each_record(problem, fitted)
    return sorted(best.values(), key=lambda s: -s.gain)


def _released(
    problem: Problem, fitted: Fitted, matrix: Array, right: Array, weight: Array
) -> dict[int, Score]:
    """Scores of parameters that may be outside their tolerances."""
    x, found = fitted.point.x, {}
    prior = prior_of(problem, fitted.members)
    base = _gain(matrix, right, weight, x)
    for i, cause in enumerate(problem.causes):
        if cause.parameter is None or i in fitted.causes:
            continue
        k = problem.free.index(cause.parameter)
        wider = weight.copy()
        wider[k] = 1.25 * prior.weight[k] / RELEASED**2
        gain = _gain(matrix, right, wider, x) - base + 0.5 * (weight[k] - wider[k]) * x[k] ** 2
        found[i] = Score(i, None, float(gain), 0.0)
    return found


def _in_each_record(problem: Problem, fitted: Fitted) -> dict[int, Score]:
    """Scores of offsets of each record: at most their gain, the other unknowns fixed."""
    found = {}
    for i, cause in enumerate(problem.causes):
        if cause.local is None or i in fitted.causes:
            continue
        c, gain = cause.local.index, 0.0
        for o, linear in zip(problem.fit, fitted.linears, strict=True):
            column = np.where(o.valid[:, c], cause.local.scale / o.sd[:, c], 0.0) / fitted.noise[c]
            slope = float(column @ linear.residual[:, c]) / fitted.noise[c]
            gain += 0.5 * slope**2 / (float(column @ column) + 1.0)
        found[i] = Score(i, None, gain, 0.0)
    return found


def _gain(matrix: Array, right: Array, weight: Array, x: Array) -> float:
    """Reduction of the cost by the best step, to second order."""
    slope = right - weight * x
    return float(0.5 * slope @ np.linalg.solve(matrix + np.diag(weight), slope))


def by_record(problem: Problem, fitted: Fitted, k: int) -> tuple[Array, Array]:
    """Magnitude of one effect in each record by itself, to first order, and its covariance.

    A true effect has the same magnitude in every record; an imitation of something that no
    candidate has changes with the motion. No simulation is needed.

    Parameters
    ----------
    problem, fitted
        The problem and a fitted set.
    k
        Index among the global unknowns.

    Returns
    -------
    tuple
        Values of the unknown in its scale, (records,), and their covariance.
    """
    prior = prior_of(problem, fitted.members)
    weight = prior.weights(fitted.point.x)
    g, count = fitted.point.x.size, len(problem.fit)
    others = np.delete(np.arange(g), k)
    size = g - 1 + count
    matrix, right = np.zeros((size, size)), np.zeros(size)
    matrix[: g - 1, : g - 1] += np.diag(weight[others])
    right[: g - 1] -= weight[others] * fitted.point.x[others]
    matrix[g - 1 :, g - 1 :] += 1e-3 * np.eye(count)
    for r, (observed, linear) in enumerate(zip(problem.fit, fitted.linears, strict=True)):
        own = system(
            problem,
            (observed,),
            fitted.members,
            type(fitted.point)(fitted.point.x, (fitted.point.local[r],)),
            (linear,),
            fitted.noise,
            weights(problem, fitted, fitted),
        )
        at = np.append(np.arange(g - 1), g - 1 + r)
        order = np.append(others, k)
        matrix[np.ix_(at, at)] += own.matrix[np.ix_(order, order)]
        right[at] += own.right[order]
    covariance = np.linalg.inv(matrix)
    step = covariance @ right
    by = slice(g - 1, None)
    values: Array = fitted.point.x[k] + step[by]
    return values, np.array(covariance[by, by])
