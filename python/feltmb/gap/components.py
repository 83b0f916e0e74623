"""Locates the gap in the machine: tests and recovers unknown forces at the ports of a model.

At every port an unknown force w(t) is assumed: a Gaussian process (Matern 3/2), given by a few
knots in each segment. With H its effect on the reduced rows of the segment (feltmb.fit.filter), u =
H'r and G = H'H, the variance-component score is

    U = 1/2 sum over segments (u' C u - tr(C G)),   Var U = 1/2 sum tr((C G)^2),

and the estimate of the force is (C^-1 / s^2 + G)^-1 u, where s^2 maximizes the likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from feltmb.data import Array
from feltmb.fit.filter import reduce_chain
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Jobs, Port
from feltmb.fit.observe import observe_jobs
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import Fit
from feltmb.gap.criteria import SECOND_SIGNATURE, SIGNATURE
from feltmb.gap.findings import ComponentRow

__all__ = ["component_table"]

KNOTS = 5
TRACES = 3


@dataclass(frozen=True, eq=False)
class _Seen:
    """Products of one port in one segmented record, by segment."""

    u: Array
    """(W, m)"""
    g: Array
    """(W, m, m)"""


@dataclass(frozen=True, eq=False)
class _Tested:
    """Test of one port for an unknown force, for one fit."""

    fit: Fit
    parts: list[_Seen]
    z: float
    variance: float
    gain: float
    """Gain of log likelihood by the force."""
    explained: float

    @property
    def p(self) -> float:
        """Probability of at least this gain by chance."""
        return float(stats.chi2.sf(2.0 * self.gain, 1) / 2.0) if self.gain > 0.0 else 0.5


def component_table(fit: Fit, tight: Fit | None, alpha: float) -> tuple[ComponentRow, ...]:
    """Test every port of the model for an unknown force; the strongest row is first.

    Parameters
    ----------
    fit
        The model fitted with continuity defects as large as it needs.
    tight
        The model fitted with the tightest continuity defects. Loose defects absorb a weak force, so
        that the test is done with both fits. The force is recovered from the loose fit if it is
        significant there, because the states of that fit are closer to the machine.
    """
    ports = fit.problem.model.ports
    if not ports or not fit.defect_sd.size:
        return ()
    knots = np.arange(KNOTS) / (KNOTS - 1)
    near = np.abs(knots[:, None] - knots[None, :]) * np.sqrt(3.0) / 0.5
    prior = (1.0 + near) * np.exp(-near)
    tables = [_tested(f, prior) for f in (fit, tight) if f is not None]
    best = [max(tested, key=lambda x: x.gain) for tested in zip(*tables, strict=True)]
    order = sorted(range(len(ports)), key=lambda j: (-best[j].gain, -best[j].z, ports[j].name))
    out = []
    for rank, j in enumerate(order):
        port, row = ports[j], best[j]
        significant = row.p < alpha / len(ports)
        trace: Mapping[str, Mapping[str, list[float]]] = {}
        signature = ""
        if rank < TRACES and significant:
            loose = tables[0][j]
            clear = loose.p < alpha / len(ports)
            shown = loose if clear else row
            trace, signature = _recover(shown.fit, port, shown.parts, shown.variance, prior)
            # In a fit that cannot follow the records, the force has the form of the errors of the
            # states.
            signature = signature if clear else "too weak to determine its form"
        out.append(
            ComponentRow(
                component=port.component,
                port=port.name,
                unit=port.unit,
                statistic=row.z,
                p=row.p,
                significant=significant,
                explained=row.explained,
                trace=trace,
                signature=signature,
            )
        )
    return tuple(out)


def _tested(fit: Fit, prior: Array) -> list[_Tested]:
    """Test all ports with one fit."""
    ports = fit.problem.model.ports
    seen: list[list[_Seen]] = [[] for _ in ports]
    excess = 0.0
    for i, segmented in enumerate(fit.problem.segmented_records):
        linear, count = _with_forces(fit, i)
        mean, sd = fit.problem.start_prior(segmented)
        chain = reduce_chain(linear, fit.defect_sd, mean - fit.point.places[i].starts[0], sd)
        first = chain.grams.shape[1] - 1 - count
        for j in range(len(ports)):
            own = slice(first + j * KNOTS, first + (j + 1) * KNOTS)
            seen[j].append(_Seen(chain.grams[:, own, -1], chain.grams[:, own, own]))
        excess += float(np.sum(chain.grams[:, -1, -1] - segmented.samples.sum(axis=1)))
    out = []
    for parts in seen:
        u = np.vstack([p.u for p in parts])
        g = np.concatenate([p.g for p in parts])
        cg = prior @ g
        score = 0.5 * (np.einsum("wi,ij,wj->", u, prior, u) - np.einsum("wii->", cg))
        spread = np.sqrt(0.5 * np.einsum("wij,wji->", cg, cg))
        z = float(score / spread) if spread > 0.0 else 0.0
        variance, gain, fall = _best_variance(u, g, prior)
        explained = float(np.clip(fall / excess, 0.0, 1.0)) if excess > 0.0 else 0.0
        out.append(_Tested(fit, parts, z, variance, gain, explained))
    return out


def _with_forces(fit: Fit, i: int) -> tuple[Linear, int]:
    """Linearization of a segmented record; the knots of all port forces are added columns."""
    problem, segmented, place = fit.problem, fit.problem.segmented_records[i], fit.point.places[i]
    ports = problem.model.ports
    versions = 1 + len(ports) * KNOTS
    forces = np.zeros((versions, segmented.count, len(ports), KNOTS))
    for j, port in enumerate(ports):
        for k in range(KNOTS):
            forces[1 + j * KNOTS + k, :, j, k] = 1e-3 * port.scale
    jobs = Jobs(
        theta=np.tile(fit.point.theta, (versions * segmented.count, 1)),
        segments=np.tile(segmented.segments, (versions, 1)),
        starts=np.tile(place.starts, (versions, 1)),
        included=problem.included,
        magnitudes=np.tile(fit.point.magnitudes, (versions * segmented.count, 1)),
        forces=forces.reshape(versions * segmented.count, len(ports), KNOTS),
    )
    run = observe_jobs(problem.model, segmented.record, jobs)
    outputs = run.outputs.reshape(versions, segmented.count, -1, len(problem.model.outputs))
    ends = run.ends.reshape(versions, segmented.count, -1)
    change = np.moveaxis(outputs[1:] - outputs[0], 0, -1) / 1e-3
    change_ends = np.moveaxis(ends[1:] - ends[0], 0, -1) / 1e-3
    white = segmented.whiten(np.nan_to_num(change)).reshape(segmented.count, -1, versions - 1)
    linear = fit.linears[i]
    return (
        replace(
            linear,
            by_global=np.concatenate([linear.by_global, white], axis=2),
            ends_by_global=np.concatenate(
                [linear.ends_by_global, np.nan_to_num(change_ends)], axis=2
            ),
        ),
        versions - 1,
    )


def _best_variance(u: Array, g: Array, prior: Array) -> tuple[float, float, float]:
    """Most likely variance, its gain of log likelihood, and its drop of the sum of squares."""
    size = float(np.einsum("wii->", prior @ g)) / max(len(u), 1)
    if not size > 0.0:
        return 0.0, 0.0, 0.0
    root = np.linalg.cholesky(prior + 1e-10 * np.eye(len(prior)))
    v = u @ root
    h = root.T @ g @ root
    best = (0.0, 0.0, 0.0)
    for variance in np.logspace(-3, 8, 45) / size:
        inner = np.eye(len(prior)) + variance * h
        _, log_det = np.linalg.slogdet(inner)
        solved = np.linalg.solve(inner, v[..., None])[..., 0]
        fall = variance * float(np.sum(v * solved))
        gain = 0.5 * fall - 0.5 * float(np.sum(log_det))
        if gain > best[1]:
            best = (float(variance), gain, fall)
    return best


def _recover(
    fit: Fit, port: Port, parts: list[_Seen], variance: float, prior: Array
) -> tuple[dict[str, dict[str, list[float]]], str]:
    """Estimated force over time by record, and its form relative to position and speed."""
    states = [s.name for s in fit.problem.model.states()]
    inverse = np.linalg.inv(prior + 1e-8 * np.eye(len(prior))) / variance
    traces: dict[str, dict[str, list[float]]] = {}
    seen = []
    for i, (segmented, part) in enumerate(zip(fit.problem.segmented_records, parts, strict=True)):
        cover = np.linalg.inv(inverse + part.g)
        value = np.einsum("wij,wj->wi", cover, part.u) * port.scale
        sd = np.sqrt(np.maximum(np.einsum("wii->wi", cover), 0.0)) * port.scale
        time = _knot_times(segmented)
        traces[segmented.record.name] = {
            "time": [float(t) for t in time.ravel()],
            "force": [float(v) for v in value.ravel()],
            "sd": [float(s) for s in sd.ravel()],
        }
        there = _at_knots(fit, i)
        columns = [value, sd]
        for name in (port.position, port.speed):
            columns.append(there[..., states.index(name)] if name in states else 0.0 * value)
        seen.append(np.stack(columns, axis=-1).reshape(-1, 4))
    return traces, _likeness(np.concatenate(seen))


def _at_knots(fit: Fit, i: int) -> Array:
    """States of a segmented record at the knots of every segment, (W, KNOTS, nx)."""
    segmented, place = fit.problem.segmented_records[i], fit.point.places[i]
    length = segmented.segments[:, 1] - segmented.segments[:, 0]
    out = np.repeat(place.starts[:, None, :], KNOTS, axis=1)
    for k in range(1, KNOTS):
        segments = segmented.segments.copy()
        segments[:, 1] = segments[:, 0] + np.maximum(1, length * k // (KNOTS - 1))
        jobs = Jobs.at_point(
            fit.point.theta, segments, place.starts, fit.included, fit.point.magnitudes
        )
        out[:, k] = observe_jobs(fit.problem.model, segmented.record, jobs).ends
    return out


def _likeness(seen: Array) -> str:
    """Describe the form of a force; columns: force, its standard deviation, position, speed (n, 4).

    The parameters of the model have absorbed the part of the force that is proportional to position
    or speed. Other laws are therefore compared without such a part.
    """
    force, sd, q, v = seen[np.all(np.isfinite(seen), axis=1) & (seen[:, 1] > 0.0)].T
    weight = 1.0 / np.maximum(sd, 1e-300)
    taken = np.column_stack([q * weight, v * weight])
    shares = []
    for name, law, linear in (
        ("a constant", np.ones_like(q), True),
        ("the position", q, True),
        ("the speed", v, True),
        ("position squared", q**2, False),
        ("the cube of the position", q**3, False),
        ("the sign of the speed", np.sign(v), False),
        ("speed times its magnitude", v * np.abs(v), False),
    ):
        shape, trace = law * weight, force * weight
        if not linear:
            shape, trace = (
                a - taken @ np.linalg.lstsq(taken, a, rcond=None)[0] for a in (shape, trace)
            )
        size, power = float(shape @ shape), float(trace @ trace)
        if size > 1e-12 * float((law * weight) @ (law * weight)) and power > 0.0:
            shares.append((float(shape @ trace) ** 2 / (size * power), name))
    shares.sort(reverse=True)
    if not shares or shares[0][0] < SIGNATURE:
        return "no simple form"
    near = [s for s in shares if s[0] > SECOND_SIGNATURE * shares[0][0]][:2]
    return "most like " + " or ".join(f"{name} ({share:.0%} of it)" for share, name in near)


def _knot_times(segmented: SegmentedRecord) -> Array:
    first = segmented.record.time[segmented.segments[:, 0]]
    last = segmented.record.time[segmented.segments[:, 1]]
    return np.asarray(first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, KNOTS))
