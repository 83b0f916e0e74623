"""Derivatives of the outputs of an ``Equations`` from its variational equations.

The integrator evaluates the rates at the states of its stages. Here the rates of the changed
simulations of finite differences are evaluated at these states, all samples at once. Their
differences are the derivatives of the rates, and these give the derivative of each step of the
integrator: a linear recurrence from sample to sample. Only this recurrence, and the hidden states
of candidates, are loops over samples.

The derivative of a rate that jumps, such as np.sign, misses the jump. Therefore the difference of
two more simulations, with changed parameters and start states, is compared with its prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from unmodeled.data import Array, Integers
from unmodeled.errors import Error
from unmodeled.fit.coordinates import Rate
from unmodeled.fit.integrate import GAMMA, Steps, integrate, solved
from unmodeled.fit.model import (
    Batch,
    Candidate,
    Jobs,
    Sensitivity,
    SensitivityRequest,
    changed_jobs,
    changed_runs,
    sensitivity_of,
)

__all__ = ["variational_sensitivities"]

#: Step of differences by states, relative to their scales.
STATE_STEP = 1e-5
#: Largest difference between a simulated change and its prediction, relative to the change.
SMALL = 0.1
#: Number of samples at which the rate of an effect is tried with arrays of shapes.
TRIED = 16
#: Numbers of the rates of changed simulations that are computed at once.
BLOCK = 1_000_000
#: Values of rows, (..., values, rows, j), at the samples j: ``(steps, j, states)``.
Function = Callable[[Steps, Integers, Array], Array]
#: A column: rows with their weights, and the row from which each differs; None: zero.
Column = list[tuple[int, float, int | None]]


def variational_sensitivities(
    model: Any, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity | None]:
    """Outputs and derivatives, one result per request.

    None: the right-hand side jumps, so that the request needs differences of simulations.
    """
    known: dict[object, bool] = model._smooth
    keys = [tuple((c.effect.name, _octaves(c.shape)) for c in r.included) for r in requests]
    steady = [i for i, key in enumerate(keys) if known.get(key, True)]
    if len(steady) < len(requests):
        rest = iter(variational_sensitivities(model, [requests[i] for i in steady]))
        return [next(rest) if i in steady else None for i in range(len(requests))]
    if not requests:
        return []
    # One request decides for all with the same included effects: the test takes two simulations.
    tested = {key: i for i, key in reversed(list(enumerate(keys))) if key not in known}
    moves = {key: _moves(model, requests[i]) for key, i in tested.items()}
    moved = [(requests[i].record, moves[key][0]) for key, i in tested.items()]
    variation = _Variation(model, [replace(r, by_starts=True) for r in requests], moved)
    found = variation.results()
    two_of = variation.run.runs[len(requests) :]
    for (key, i), two in zip(tested.items(), two_of, strict=True):
        known[key] = _predicts(model, found[i], two, moves[key][1])
    return [
        _asked(request, s) if known[key] else None
        for request, s, key in zip(requests, found, keys, strict=True)
    ]


def _octaves(shape: Any) -> tuple[object, ...]:
    """A shape with its numbers rounded to powers of two: those of a fit change little."""
    row = shape if isinstance(shape, tuple) else (shape,)
    return tuple(
        (v > 0.0, round(math.log2(abs(v)))) if isinstance(v, float) and v != 0.0 else v for v in row
    )


def _moves(model: Any, request: SensitivityRequest) -> tuple[Jobs, Array]:
    """Two simulations with opposite changes of parameters, magnitudes and start states.

    Also returns the differences between the two, in the order of the variables of differentiation.
    At a limit, both change the value to the permitted side.
    """
    jobs, columns = changed_jobs(model, replace(request, by_starts=True))
    table = np.hstack([jobs.theta, jobs.magnitudes, jobs.starts])
    pairs = np.array([[row for row, _ in entry] for entry in columns])
    pairs = np.random.default_rng(0).permuted(pairs, axis=1)
    changes = table[pairs] - table[0]  # (columns, 2, all)
    ends = np.cumsum([jobs.theta.shape[1], jobs.magnitudes.shape[1]])
    theta, sizes, starts = np.split(table[0] + changes.sum(axis=0), ends, axis=1)
    two = replace(jobs, theta=theta, magnitudes=sizes, starts=starts)
    return two, (changes[:, 0] - changes[:, 1]).sum(axis=1)


def _predicts(model: Any, s: Sensitivity, two: Array, changes: Array) -> bool:
    """Whether the derivatives predict the difference of the outputs of two changed simulations.

    Outputs that are rates show each steep part of a rate itself. They are left out if there are
    others.
    """
    columns = np.concatenate([s.d_theta, s.d_magnitudes, s.d_starts], axis=-1)
    change = two[0] - two[1]
    error = change - columns @ changes
    good = np.isfinite(change)
    if np.any(good & ~np.isfinite(error)):
        return False
    change, error, y = (np.where(good, v, 0.0) for v in (change, error, s.outputs))
    allowed = SMALL**2 * np.sum(change**2, axis=0) + 1e-18 * np.sum(y**2, axis=0)
    agrees = np.sum(error**2, axis=0) <= allowed
    steady = [o for o, of in enumerate(model._outputs.values()) if not isinstance(of, Rate)]
    return bool(np.all(agrees[steady] if steady else agrees))


def _asked(request: SensitivityRequest, s: Sensitivity) -> Sensitivity:
    """The result without derivatives that were only needed for its test."""
    if request.by_starts:
        return s
    return replace(s, d_starts=s.d_starts[..., :0])


class _Variation:
    """Derivatives along the motions of requests.

    The rows are changed simulations at the states of these motions: first those of the model, then
    those of the candidates, whose rates are taken alone, and last a row of zeros. A column is a
    weighted sum of the differences of rows: first the derivatives by the states, then those by the
    variables of differentiation.
    """

    def __init__(self, model: Any, requests: Sequence[SensitivityRequest], moved: Sequence[Batch]):
        self.model, self.requests = model, requests
        self.longest = max(r.record.samples for r in requests)
        self.base = len(model.states())
        self.size = max(r.start.size for r in requests)
        points = [(r.record, r.jobs()) for r in requests]
        self.run = integrate(model, [*points, *moved], keep=len(points))
        self.samples = np.moveaxis(self.run.samples, 0, -1)
        """States at the samples, (states, requests, longest)."""
        steps, x = Steps(model, points, self.longest), self.samples[..., :-1]
        stages = steps.after(np.arange(self.longest - 1), x.reshape(len(x), -1))[1]
        self.stages = stages.reshape(*stages.shape[:3], *x.shape[1:])
        """States at the stages, (substeps, stages, states, requests, longest - 1)."""
        self.time = steps.clock.time.T
        self.columns: list[list[Column]] = []
        self._add_changes()
        self._add_candidates()
        shape, zero = (2, len(requests), max(map(len, self.columns))), len(self.of)
        self.rows, self.others = np.full(shape, zero), np.full(shape, zero)
        self.weights = np.zeros(shape)
        for i, columns in enumerate(self.columns):
            for c, column in enumerate(columns):
                for k, (row, weight, other) in enumerate(column):
                    self.rows[k, i, c], self.weights[k, i, c] = row, weight
                    self.others[k, i, c] = zero if other is None else other

    # ------------------------------------------------------------------------- rows and columns

    def _add_changes(self) -> None:
        """Rows of the model, and the columns of each request; those of candidates stay empty."""
        batches: list[Batch] = []
        of: list[int] = []
        offsets: list[Array] = []
        for i, r in enumerate(self.requests):
            own, found = changed_runs(self.model, replace(r, candidates=()), STATE_STEP)
            firsts = len(of) + np.cumsum([0, *(jobs.count for _, jobs in own)])
            batches += own
            of += [i] * int(firsts[-1] - firsts[0])
            offsets += [_longer(x - r.start, self.size) for _, q in own for x in q.starts]
            rows = [[(firsts[b] + k, w, firsts[0]) for b, k, w in column] for column in found]
            starts = self._starts(r)
            none: list[Column] = [[] for _ in range(self.size)]
            by_states = [*rows[starts], *none][: self.size]
            candidates: list[Column] = [[] for _ in r.candidates]
            rows[starts] = [*none[: r.start.size], *candidates]
            self.columns.append(by_states + rows)
        self.changed = Steps(self.model, batches, self.longest)
        self.of, self.offsets = np.array(of), np.array(offsets).T
        """Request of each row, and changes of the states."""

    def _starts(self, request: SensitivityRequest) -> slice:
        """Places of the start states among the variables of differentiation."""
        first = len(request.parameters_of(self.model)) + len(request.included)
        return slice(first, first + request.start.size)

    def _add_candidates(self) -> None:
        """Rows of the candidates at two magnitudes, and their columns.

        Equal ones follow each other, and those with hidden states are the first.
        """
        places = [(i, c) for i, r in enumerate(self.requests) for c in range(len(r.candidates))]
        places.sort(key=lambda place: _kind(self.requests[place[0]].candidates[place[1]]))
        batches: list[Batch] = []
        of: list[int] = []
        for i, c in places:
            r = self.requests[i]
            t = r.candidates[c]
            offsets = self.model._offsets(t.effect, 0.0)
            first = len(self.of) + len(of)
            self.columns[i][self.size + self._starts(r).stop + c] = [
                (first + k, weight, None) for k, (_, weight) in enumerate(offsets)
            ]
            jobs = Jobs(
                theta=np.tile(r.theta, (len(offsets), 1)),
                starts=np.tile([s.start for s in self.model.states((t,))], (len(offsets), 1)),
                included=(t,),
                magnitudes=np.array([[size] for size, _ in offsets]),
            )
            batches.append((r.record, jobs))
            of += [i] * len(offsets)
        self.candidates = np.arange(len(self.of), len(self.of) + len(of))
        """Rows of the candidates."""
        self.of = np.append(self.of, of).astype(np.intp)
        self.alone = Steps(self.model, batches, self.longest, own=False) if batches else None
        self._remember(batches)

    def _remember(self, batches: Sequence[Batch]) -> None:
        """Integrate the hidden states of the candidates at magnitude zero.

        They are driven by the motions alone.
        """
        stages, base = self.stages, self.base
        hidden, rows = self.alone.equations.size - base if self.alone else 0, len(self.candidates)
        self.at_samples = np.zeros((hidden, rows, self.longest))
        self.at_stages = np.zeros((*stages.shape[:2], hidden, rows, self.longest - 1))
        own = [
            (record, replace(jobs, magnitudes=0.0 * jobs.magnitudes))
            for record, jobs in batches
            if jobs.included[0].effect.hidden
        ]
        if not own:
            return
        x = np.hstack([_longer(jobs.starts.T, base + hidden) for _, jobs in own])
        count = x.shape[1]
        motions = np.moveaxis(stages[:, :, :base, self.of[self.candidates[:count]]], -1, 0)
        steps = self._steps_of_hidden(own, x, motions)
        self.at_samples[:, :count] = x[base:, :, None]
        for j, motion in enumerate(motions):
            x, passed = steps.after(np.array([j]), x, motion)
            self.at_stages[..., :count, j] = passed[:, :, base:]
            self.at_samples[:, :count, j + 1] = x[base:]

    def _steps_of_hidden(self, batches: Sequence[Batch], x: Array, motions: Array) -> Steps:
        """Steps with all shapes of an effect as arrays, if its rate is the same with them."""
        one = Steps(self.model, batches, self.longest, own=False)
        try:
            steps = Steps(self.model, _with_arrays(batches), self.longest, own=False)
            for j in range(0, self.longest - 1, max(1, self.longest // TRIED)):
                end, other = (s.after(np.array([j]), x, motions[j])[0] for s in (one, steps))
                if not np.allclose(end, other, rtol=1e-9, equal_nan=True):
                    return one
        except (Error, ValueError):  # shapes that are no numbers, or a rate without arrays
            return one
        return steps

    # ------------------------------------------------------------------------------ derivatives

    def _derived(self, of: Function, j: Integers, motions: Array, memory: Array) -> Array:
        """Derivatives of a function of rows, (requests, j, ..., values, columns).

        ``motions``: states at the samples j, (..., states, requests, j); ``memory``: hidden states
        of the candidates, (..., hidden, rows, j).
        """
        alone = len(self.candidates)
        x = motions[..., self.of[: len(self.of) - alone], :] + self.offsets[..., None]
        values = of(self.changed, j, x)
        *outer, count, _, n = values.shape
        rest = np.zeros((*outer, count, alone + 1, n))
        if self.alone:
            own_motions = motions[..., : self.base, self.of[self.candidates], :]
            own = of(self.alone, j, np.concatenate([own_motions, memory], axis=-3))
            rest[..., : own.shape[-3], :-1, :] = own
        values, total = np.concatenate([values, rest], axis=-2), np.zeros(())
        for row, other, weight in zip(self.rows, self.others, self.weights, strict=True):
            change = values[..., row, :] - values[..., other, :]
            total = total + weight[..., None] * change
        by = np.moveaxis(total, (-3, -1), (0, 1))  # (requests, j, ..., values, columns)
        return np.ascontiguousarray(by)

    def _steps(self, by: Array, h: Array) -> Array:
        """Changes of the derivatives over the samples, (requests, j, states, columns).

        They are those by the derivatives at the sample, followed by what is added to them. ``by``:
        derivatives of the rates at the stages; ``h``: steps.
        """
        n, h = self.size, h[..., None, None]
        step: Array
        total = np.zeros(())
        for s in range(by.shape[2]):
            own = by[:, :, s]
            first = own[:, :, 0]
            if self.model.method == "rk4":
                step, stage = first.copy(), first
                for k, share, weight in ((1, 0.5, 2.0), (2, 0.5, 2.0), (3, 1.0, 1.0)):
                    stage = own[:, :, k] + share * h * (own[:, :, k, :, :n] @ stage)
                    step += weight * stage
                step *= h / 6.0
            else:
                matrix = np.eye(n) - GAMMA * h * first[..., :n]
                k1 = solved(matrix, first)
                k2 = own[:, :, 1] + h * (own[:, :, 1, :, :n] @ k1) - 2.0 * k1
                step = h * (1.5 * k1 + 0.5 * solved(matrix, k2))
            total = step if s == 0 else total + step + step[..., :n] @ total
        return total

    def results(self) -> list[Sensitivity]:
        """Outputs and derivatives by request."""
        n, requests, run = self.size, self.requests, self.run
        columns = self.weights.shape[-1] - n
        d = np.zeros((len(requests), self.longest, len(self.model.outputs), columns))
        s = np.zeros((len(requests), n, columns))
        for i, r in enumerate(requests):
            s[i, : r.start.size, self._starts(r)] = np.eye(r.start.size)
        substeps, stages = self.stages.shape[:2]
        block = max(1, BLOCK // (len(self.of) * n * substeps * stages))
        for first in range(0, self.longest, block):
            j = np.arange(first, min(first + block, self.longest))
            ahead = j[j < self.longest - 1]
            if len(ahead):
                by = self._derived(
                    Steps.slopes, ahead, self.stages[..., ahead], self.at_stages[..., ahead]
                )
                h = (self.time[:, ahead + 1] - self.time[:, ahead]) / substeps
                changes = np.ascontiguousarray(np.moveaxis(self._steps(by, h), 1, 0))
            path = np.empty((len(j), *s.shape))
            for k in range(len(j)):
                path[k] = s
                if k < len(ahead):
                    s = s + changes[k, ..., :n] @ s + changes[k, ..., n:]
            by = self._derived(Steps.outputs, j, self.samples[..., j], self.at_samples[..., j])
            d[:, j] = by[..., :n] @ np.moveaxis(path, 1, 0) + by[..., n:]
        return [
            sensitivity_of(self.model, r, run[0], own[: run.shape[1]])
            for r, run, own in zip(requests, run.runs, d, strict=False)
        ]


def _kind(candidate: Candidate) -> tuple[bool, int, str]:
    return not candidate.effect.hidden, id(candidate.effect), repr(candidate.shape)


def _longer(values: Array, count: int) -> Array:
    """Values with zeros for further rows."""
    return np.pad(values, [(0, count - len(values))] + [(0, 0)] * (values.ndim - 1))


def _with_arrays(batches: Sequence[Batch]) -> list[Batch]:
    """Batches of candidates whose shapes are those of all jobs with the same effect.

    Raises
    ------
    ValueError
        A shape is no number.
    """
    shapes: dict[int, list[Any]] = {}
    for _, jobs in batches:
        (t,) = jobs.included
        numbers = t.shape if isinstance(t.shape, tuple) else (t.shape,)
        if not all(isinstance(v, float) for v in numbers):
            raise ValueError
        shapes.setdefault(id(t.effect), []).extend([t.shape] * jobs.count)
    arrays = {key: np.array(rows).T for key, rows in shapes.items()}
    found = {key: tuple(rows) if rows.ndim == 2 else rows for key, rows in arrays.items()}
    return [
        (record, replace(jobs, included=(replace(t, shape=found[id(t.effect)]),)))
        for record, jobs in batches
        for t in jobs.included
    ]
