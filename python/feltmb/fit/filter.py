"""Elimination of the start states of a chain of segments by a square-root information filter.

The segments of a record form a chain. Data depend on the start state of their own segment, and a
continuity defect connects the end of a segment to the start of the next. Each segment is reduced by
one QR factorization over (input noise, own state, next state). The remaining rows do not depend on
any state. If the model is correct, they are independent noise of variance 1, so that all tests are
sums of products of these rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feltmb.data import Array
from feltmb.fit.linearize import Linear

__all__ = ["Chain", "reduce_chain"]


@dataclass(frozen=True, eq=False)
class Chain:
    """A segmented record with its states eliminated.

    The columns are the globals of the linearization; the last column is the residual.
    """

    grams: Array
    """Products of the reduced columns, by segment (W, c, c)."""
    factors: list[tuple[Array, Array, Array]]
    """By segment: triangular matrix over (input, state), its coupling to the next state, right-hand
    sides."""
    log_dets: Array
    """Sum of the logarithms of the diagonal of the triangular matrix, by segment (W,)."""
    rows: list[Array] | None
    """Reduced rows by segment, (m, c); None: not requested."""
    leverage: list[Array] | None
    """Share of each row that the states explain, (m,); None: not requested."""
    inputs: int
    heads: tuple[Array, Array] | None = None
    """``grams`` and ``log_dets`` of every segment as if the record ended there; None: not
    requested."""

    def back(self, step: Array) -> Array:
        """Step of the start states (W, nx) that belongs to a step of the globals (c - 1,)."""
        weights = np.append(-step, 1.0)
        nxt = np.zeros(0)
        out = []
        for triangle, coupling, right in reversed(self.factors):
            rhs = right @ weights
            if nxt.size:
                rhs = rhs - coupling @ nxt
            size = triangle.shape[0]
            diagonal = np.abs(np.diag(triangle))
            if size and np.min(diagonal) <= 1e-12 * max(np.max(diagonal), 1e-300):
                solved = np.linalg.lstsq(triangle, rhs, rcond=1e-12)[0]
            else:
                solved = np.linalg.solve(triangle, rhs) if size else rhs
            nxt = solved[self.inputs :]
            out.append(nxt)
        return np.array(out[::-1])


def reduce_chain(
    linear: Linear,
    defect_sd: Array,
    start_mean: Array,
    start_sd: Array,
    damping: Array | None = None,
    *,
    keep_rows: bool = False,
    keep_heads: bool = False,
) -> Chain:
    """Eliminate the states of one segmented record.

    Parameters
    ----------
    defect_sd
        Standard deviation of the continuity defect, by state [its unit].
    start_mean, start_sd
        Prior of the first state minus its present value, and its standard deviation.
    damping
        Levenberg weights by segment, (W,), or None. They hold the states near their present values.
    """
    count, m, nx = linear.by_state.shape
    mi = linear.by_input.shape[2]
    data = np.concatenate([linear.by_global, linear.residual[..., None]], axis=2)
    c = data.shape[2]
    if nx == 0 and mi == 0:
        grams = np.einsum("wmi,wmj->wij", data, data, optimize=True)
        return Chain(
            grams=grams,
            factors=[(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, c)))] * count,
            log_dets=np.zeros(count),
            rows=list(data) if keep_rows else None,
            leverage=[np.zeros(m)] * count if keep_rows else None,
            inputs=0,
            heads=(grams, np.zeros(count)) if keep_heads else None,
        )
    grams = np.zeros((count, c, c))
    heads = (np.zeros((count, c, c)), np.zeros(count)) if keep_heads else None
    factors = []
    rows: list[Array] = []
    leverage: list[Array] = []
    known = np.isfinite(start_sd)
    carry_x = np.zeros((nx, nx))
    carry_c = np.zeros((nx, c))
    weight = 1.0 / np.maximum(start_sd[known], 1e-12)
    carry_x[known, known] = weight
    carry_c[known, -1] = weight * start_mean[known]
    log_dets = np.zeros(count)
    inverse = 1.0 / defect_sd
    for w in range(count):
        last = w == count - 1
        extra = 0 if last else nx
        pulled = damping is not None and damping[w] > 0.0
        height = m + nx + mi + extra + (nx if pulled else 0)
        x = np.zeros((height, mi + nx + extra))
        y = np.zeros((height, c))
        x[:m, :mi] = linear.by_input[w]
        x[:m, mi : mi + nx] = linear.by_state[w]
        y[:m] = data[w]
        at = m
        x[at : at + nx, mi : mi + nx] = carry_x
        y[at : at + nx] = carry_c
        at += nx
        x[at : at + mi, :mi] = np.eye(mi)
        at += mi
        if heads is not None:
            heads[0][w], heads[1][w] = _reduced(x[:at, : mi + nx], y[:at])
        if not last:
            x[at : at + nx, :mi] = -inverse[:, None] * linear.ends_by_input[w]
            x[at : at + nx, mi : mi + nx] = -inverse[:, None] * linear.ends_by_state[w]
            x[at : at + nx, mi + nx :] = np.diag(inverse)
            y[at : at + nx, :-1] = -inverse[:, None] * linear.ends_by_global[w]
            y[at : at + nx, -1] = inverse * linear.defect[w]
            at += nx
        if pulled:
            assert damping is not None
            size = np.linalg.norm(x[:at, mi : mi + nx], axis=0)
            x[at:, mi : mi + nx] = np.diag(np.sqrt(damping[w]) * np.maximum(size, 1e-12))
        q, r = np.linalg.qr(x)
        top = q.T @ y
        rest = y - q @ top
        grams[w] = rest.T @ rest
        own = mi + nx
        factors.append((r[:own, :own], r[:own, own:], top[:own]))
        diagonal = np.abs(np.diag(r))
        log_dets[w] = np.sum(np.log(np.maximum(diagonal[:own], 1e-300)))
        if not last:
            carry_x = r[own:, own:]
            carry_c = top[own:]
        if keep_rows:
            rows.append(rest[:m])
            leverage.append(np.sum(q[:m] ** 2, axis=1))
    return Chain(
        grams=grams,
        factors=factors,
        log_dets=log_dets,
        rows=rows if keep_rows else None,
        leverage=leverage if keep_rows else None,
        inputs=mi,
        heads=heads,
    )


def _reduced(x: Array, y: Array) -> tuple[Array, float]:
    """Products of the rows y without the columns of x, and the log of the diagonal of x."""
    q, r = np.linalg.qr(x)
    rest = y - q @ (q.T @ y)
    return rest.T @ rest, float(np.sum(np.log(np.maximum(np.abs(np.diag(r)), 1e-300))))
