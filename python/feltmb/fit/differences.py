"""Derivatives of a nominal by batched differences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Array, Record

if TYPE_CHECKING:
    from feltmb.fit.nominal import Nominal, Sensitivity, Term

__all__ = ["difference_sensitivities", "run_through"]

#: Candidates that share one simulation: it pays while the overhead of a step exceeds its work.
TOGETHER = 8


def run_through(
    nominal: Nominal,
    record: Record,
    theta: Array,
    windows: NDArray[np.intp],
    starts: Array,
    terms: tuple[Term, ...],
    sizes: Array,
    visible: int,
) -> tuple[Array, Array]:
    """Simulate windows in turn, several versions at once, hidden states passed on.

    ``starts`` (W, visible); ``sizes`` (V, k) one row a version. The visible states of a window
    come from ``starts``, its hidden ones from the end of the window before. Outputs (V, W, L, ny),
    ends (V, W, visible).
    """
    from feltmb.fit.nominal import Lanes

    versions = sizes.shape[0]
    states = nominal.states(terms)
    hidden = np.tile([s.start for s in states[visible:]], (versions, 1))
    longest = int(np.max(windows[:, 1] - windows[:, 0])) + 1
    outputs = np.full((versions, len(windows), longest, len(nominal.outputs)), np.nan)
    ends = np.full((versions, len(windows), visible), np.nan)
    for w, window in enumerate(windows):
        lanes = Lanes(
            theta=np.tile(theta, (versions, 1)),
            windows=np.tile(window, (versions, 1)),
            starts=np.hstack([np.tile(starts[w], (versions, 1)), hidden]),
            terms=terms,
            sizes=sizes,
        )
        run = nominal.simulate(record, lanes)
        outputs[:, w, : run.outputs.shape[1]] = run.outputs
        ends[:, w] = run.ends[:, :visible]
        hidden = run.ends[:, visible:]
    return outputs, ends


def difference_sensitivities(
    nominal: Nominal,
    record: Record,
    theta: Array,
    windows: NDArray[np.intp],
    starts: Array,
    terms: tuple[Term, ...],
    sizes: Array,
    *,
    by_theta: Sequence[int],
    by_starts: bool,
    candidates: tuple[Term, ...],
) -> Sensitivity:
    """Central differences by parameters, sizes and start states.

    One-sided ones of second order where a bound or the sign of an effect forbids the other side.
    """
    from feltmb.fit.nominal import Lanes, Sensitivity

    count = len(windows)
    theta = np.asarray(theta, dtype=np.float64)
    sizes = np.asarray(sizes, dtype=np.float64)
    states = nominal.states(terms)
    nx, ny = len(states), len(nominal.outputs)

    # Every row of the batch: changes of theta, sizes or start; then weights that make derivatives.
    rows_theta, rows_sizes, rows_start = [theta], [sizes], [np.zeros(nx)]
    columns: list[list[tuple[int, float]]] = []

    def add(kind: str, index: int, step: float, low: float, high: float, value: float) -> None:
        if value + step <= high and value - step >= low:
            offsets = [(step, 0.5 / step), (-step, -0.5 / step)]
        else:
            side = step if value + 2.0 * step <= high else -step
            offsets = [(side, 2.0 / side), (2.0 * side, -0.5 / side), (0.0, -1.5 / side)]
        entry = []
        for offset, weight in offsets:
            if offset == 0.0:
                entry.append((0, weight))
                continue
            t, s, x = theta.copy(), sizes.copy(), np.zeros(nx)
            {"theta": t, "sizes": s, "start": x}[kind][index] += offset
            rows_theta.append(t)
            rows_sizes.append(s)
            rows_start.append(x)
            entry.append((len(rows_theta) - 1, weight))
        columns.append(entry)

    for i in by_theta:
        p = nominal.parameters[i]
        add("theta", i, nominal.difference_step * p.size, p.lower, p.upper, theta[i])
    for i, term in enumerate(terms):
        low, high = term.effect.bounds
        step = term.effect.step * term.effect.scale
        add("sizes", i, step, low, high, sizes[i])
    if by_starts:
        for i, state in enumerate(states):
            add("start", i, 0.1 * nominal.difference_step * state.scale, -np.inf, np.inf, 0.0)

    versions = len(rows_theta)
    lanes = Lanes(
        theta=np.repeat(np.array(rows_theta), count, axis=0),
        windows=np.tile(windows, (versions, 1)),
        starts=np.tile(starts, (versions, 1)) + np.repeat(np.array(rows_start), count, axis=0),
        terms=terms,
        sizes=np.repeat(np.array(rows_sizes).reshape(versions, len(terms)), count, axis=0),
    )
    run = nominal.simulate(record, lanes)
    longest = run.outputs.shape[1]
    outputs = run.outputs.reshape(versions, count, longest, ny)
    ends = run.ends.reshape(versions, count, nx)

    def derive(all_of_it: Array, wanted: list[list[tuple[int, float]]]) -> Array:
        shape = (*all_of_it.shape[1:], len(wanted))
        out = np.zeros(shape)
        with np.errstate(invalid="ignore", over="ignore"):
            for c, entry in enumerate(wanted):
                for row, weight in entry:
                    out[..., c] += weight * (all_of_it[row] - all_of_it[0])
        return out

    a, b = len(by_theta), len(by_theta) + len(terms)
    d_candidates = np.zeros((count, longest, ny, len(candidates)))
    d_candidates_ends = np.zeros((count, nx, len(candidates)))
    for hidden in (False, True):
        group = [c for c, t in enumerate(candidates) if bool(t.effect.hidden) is hidden]
        for at in range(0, len(group), TOGETHER):
            some = group[at : at + TOGETHER]
            d_candidates[..., some], d_candidates_ends[..., some] = _candidates(
                nominal,
                record,
                theta,
                windows,
                starts,
                terms,
                sizes,
                tuple(candidates[c] for c in some),
                outputs[0],
                ends[0],
                hidden=hidden,
            )
    return Sensitivity(
        outputs=outputs[0],
        ends=ends[0],
        d_theta=derive(outputs, columns[:a]),
        d_theta_ends=derive(ends, columns[:a]),
        d_sizes=derive(outputs, columns[a:b]),
        d_sizes_ends=derive(ends, columns[a:b]),
        d_starts=derive(outputs, columns[b:]),
        d_starts_ends=derive(ends, columns[b:]),
        d_candidates=d_candidates,
        d_candidates_ends=d_candidates_ends,
    )


def _candidates(
    nominal: Nominal,
    record: Record,
    theta: Array,
    windows: NDArray[np.intp],
    starts: Array,
    terms: tuple[Term, ...],
    sizes: Array,
    some: tuple[Term, ...],
    outputs: Array,
    ends: Array,
    *,
    hidden: bool,
) -> tuple[Array, Array]:
    """Derivatives of some candidates at size zero: two lanes a window for each of them."""
    from feltmb.fit.nominal import Lanes

    rows, weights = [], []
    for c, term in enumerate(some):
        low, high = term.effect.bounds
        step = term.effect.step * term.effect.scale
        if high >= step and low <= -step:
            values, weight = (step, -step), (0.5 / step, -0.5 / step)
        else:
            side = step if high >= 2.0 * step else -step
            values, weight = (side, 2.0 * side), (2.0 / side, -0.5 / side)
        for value in values:
            row = np.zeros(len(some))
            row[c] = value
            rows.append(np.concatenate([sizes, row]))
        weights.append(weight)
    all_terms = (*terms, *some)
    count, nx, ny = len(windows), starts.shape[1], outputs.shape[2]
    versions = len(rows)
    if hidden:
        table = np.array([np.concatenate([sizes, np.zeros(len(some))]), *rows])
        y, x = run_through(nominal, record, theta, windows, starts, all_terms, table, nx)
        y, x, base_y, base_x = y[1:], x[1:], y[0], x[0]
    else:
        lanes = Lanes(
            theta=np.tile(theta, (versions * count, 1)),
            windows=np.tile(windows, (versions, 1)),
            starts=np.tile(starts, (versions, 1)),
            terms=all_terms,
            sizes=np.repeat(np.array(rows), count, axis=0),
        )
        run = nominal.simulate(record, lanes)
        y = run.outputs.reshape(versions, count, -1, ny)
        x = run.ends.reshape(versions, count, nx)
        base_y, base_x = outputs, ends
    with np.errstate(invalid="ignore", over="ignore"):
        by_lane = np.array(weights).reshape(versions)
        dy = (y - base_y) * by_lane[:, None, None, None]
        dx = (x - base_x) * by_lane[:, None, None]
    return (
        np.moveaxis(dy[0::2] + dy[1::2], 0, -1),
        np.moveaxis(dx[0::2] + dx[1::2], 0, -1),
    )
