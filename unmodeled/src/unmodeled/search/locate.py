"""Where the gap is: parts of records, events, and places where an unknown force would explain it.

A place is tested with patterns that it can add to the outputs: the response to a force with any
course in time (a Gaussian process, Matern 3/2), or the effects of a component, with other
magnitudes in each record. Their coefficients are standard normal unknowns of the record, as those
of the noise of inputs, so that the evidence of :mod:`unmodeled.search.evidence` judges them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from unmodeled.data import Array
from unmodeled.fit.observe import motion, observe_all
from unmodeled.models.model import Jobs, Port
from unmodeled.search.evidence import Fitted, log_evidence, prior_of, system
from unmodeled.search.fit import noise_left
from unmodeled.search.linear import (
    EvaluationRequest,
    Linear,
    Point,
    magnitudes_at,
    shapes_of,
    start_states,
    theta_at,
)
from unmodeled.search.problem import Local, Observed, Problem, rms_of
from unmodeled.search.result import Cell, Event, Place
from unmodeled.search.score import directions

#: Number of parts of a record of a model without events, and smallest number of samples of a part.
PARTS, SHORTEST = 6, 8
#: Knots of a force over a record, and the length of its correlation [spacings of the knots].
KNOTS, LENGTH = 40, 1.5
#: Expected sizes of what acts at a place that are tried, in its scale.
SIZES = (0.01, 0.1, 1.0, 10.0)
#: Number of places that are kept, and smallest share of a force that a law which it resembles has.
PLACES, ALIKE = 4, 0.3


def _measured(observed: Observed) -> Array:
    return np.where(observed.valid, observed.measured, np.nan)


def _events_of(problem: Problem, observed: Observed) -> list[tuple[str, float]]:
    outputs = dict(zip(problem.names, _measured(observed).T, strict=True))
    return sorted(problem.model.events(observed.record, outputs), key=lambda e: e[1])


def cells(problem: Problem, alone: Fitted, best: Fitted) -> tuple[Cell, ...]:
    """Residuals by record, part between events, and channel, without and with the told causes."""
    out = []
    for r, o in enumerate(problem.fit):
        time, n = o.record.time, o.end
        marks = [("", 0)]
        for name, moment in _events_of(problem, o):
            index = int(np.searchsorted(time, moment))
            if marks[-1][1] + SHORTEST <= index <= n - SHORTEST:
                marks.append((name, index))
        if len(marks) == 1:
            marks = [("", k * n // PARTS) for k in range(PARTS)]
        pair = [s.linears[r].residual * o.sd for s in (alone, best)]
        for (since, first), (_, last) in zip(marks, [*marks[1:], ("", n)], strict=True):
            for c, channel in enumerate(problem.names):
                good = o.valid[first:last, c]
                if good.sum() < 2:
                    continue
                rms = [float(np.sqrt(np.mean(x[first:last, c][good] ** 2))) for x in pair]
                span = float(time[first]), float(time[last - 1])
                out.append(Cell(o.record.name, channel, *span, since, *rms))
    return tuple(out)


def events(problem: Problem, alone: Fitted, best: Fitted) -> tuple[Event, ...]:
    """Delays of the records near the events of the model, by local regression."""
    out = []
    for r, o in enumerate(problem.fit):
        time, known = o.record.time, _events_of(problem, o)
        at = np.searchsorted(time, [t for _, t in known]).clip(max=time.size - 1)
        for k, (name, moment) in enumerate(known):
            apart = np.abs(np.delete(at, k) - at[k]) // 2
            reach = int(min([time.size // 20, *apart[apart > 0]]))
            near = slice(max(0, int(at[k]) - reach), int(at[k]) + reach + 1)
            for c, channel in enumerate(problem.names):
                good = o.valid[near, c]
                if good.sum() < SHORTEST:
                    continue
                sd = float(np.sqrt(np.mean(o.sd[near, c][good] ** 2)))
                e, x = (s.linears[r].residual[near, c][good] * o.sd[near, c][good]
                        for s in (alone, best))  # fmt: skip
                slope = np.gradient(o.measured[near, c][good] - x, time[near][good])
                if not (power := float(slope @ slope)) > 0.0:
                    continue
                delay = -float(e @ slope) / power
                if abs(delay) > np.ptp(time[near]):  # a part at rest has no delay
                    continue
                out.append(
                    Event(
                        record=o.record.name,
                        event=name,
                        channel=channel,
                        time=moment,
                        delay=delay,
                        delay_explained=-float(x @ slope) / power,
                        delay_sd=sd / power**0.5,
                    )
                )
    return tuple(out)


def most_different(problem: Problem, one: Fitted, other: Fitted) -> str:
    """Record in which two sets differ most, by sample."""
    rms = [
        float(np.mean(((a.residual - b.residual) / one.noise) ** 2))
        for a, b in zip(one.linears, other.linears, strict=True)
    ]
    return problem.fit[int(np.argmax(rms))].record.name


def places(problem: Problem, fitted: Fitted) -> tuple[Place, ...]:
    """Places where something unknown would explain what a set leaves, best explanation first.

    Ports of the model; without ports, the components of the listed effects.
    """
    with np.errstate(all="ignore"):
        tested = [
            (*_tested(problem, fitted, patterns, name, port), port)
            for name, patterns, port in _patterns(problem, fitted)
        ]
        found = sorted((f for f in tested if f[0].gain > 0.0), key=lambda f: -f[0].gain)[:PLACES]
        if found and (port := found[0][2]) is not None:
            first, values, _ = found[0]
            forces = [port.scale * (_smooth() @ v) for v in values]
            path = _force_path(problem, fitted, forces, port)
            if path is not None:
                units = {s.name: s.unit for s in problem.model.states()}
                first = replace(
                    first,
                    resembles=_likeness(*path),
                    force=tuple(tuple(float(x) for x in row) for row in path[[1, 2, 0]]),
                    units=(units.get(port.position, "1"), units.get(port.speed, "1"), port.unit),
                )
            found[0] = first, values, port
    return tuple(f[0] for f in found)


def _patterns(problem: Problem, fitted: Fitted) -> Iterator[tuple[str, list[Array], Port | None]]:
    """Places with the patterns that they add to the outputs, by record: ports, or components."""
    if problem.model.ports:
        responses = _responses(problem, fitted)
        for j, port in enumerate(problem.model.ports):
            yield port.name, [x[:, :, j] @ _smooth() for x in responses], port
        return
    seen = directions(problem, fitted)
    groups: dict[str, list[int]] = {}
    for k, m in enumerate(seen.further):
        groups.setdefault(problem.causes[m.cause].component, []).append(k)
    for name, own in groups.items():
        yield name, [x[:, :, own] for x in seen.by_further], None


def _smooth() -> Array:
    """Forces at the knots, one for each standard normal coefficient (Matern 3/2), (k, k)."""
    knots = np.arange(KNOTS)
    apart = np.abs(np.subtract.outer(knots, knots)) * np.sqrt(3.0) / LENGTH
    return np.linalg.cholesky((1.0 + apart) * np.exp(-apart) + 1e-9 * np.eye(KNOTS))


def _jobs(problem: Problem, fitted: Fitted, r: int, count: int) -> Jobs:
    """Equal simulations of a record."""
    ask = EvaluationRequest(fitted.members, fitted.point, problem.fit)
    sizes = magnitudes_at(problem, fitted.members, fitted.point.x, problem.fit[r])
    return Jobs(
        theta=np.tile(theta_at(problem, fitted.point.x), (count, 1)),
        starts=np.tile(start_states(problem, ask, r), (count, 1)),
        included=shapes_of(problem, fitted.members, fitted.point.x),
        magnitudes=np.tile(sizes, (count, 1)),
    )


def _responses(problem: Problem, fitted: Fitted) -> list[Array]:
    """Responses of the readings to knots of a force at each port, in its scale, by record.

    (n, m, ports, KNOTS), in units of the noise of the sensors.
    """
    ports, columns, step = problem.model.ports, list(problem.channels), 1e-3
    count = len(ports) * KNOTS
    scale = step * np.repeat([p.scale for p in ports], KNOTS)
    forces = np.vstack([np.zeros(count), np.diag(scale)]).reshape(-1, len(ports), KNOTS)
    out = []
    for r, o in enumerate(problem.fit):
        jobs = replace(_jobs(problem, fitted, r, 1 + count), forces=forces)
        y = observe_all(problem.model, [(o.record, jobs)])[0][:, :, columns]
        change = np.moveaxis(y[1:] - y[0], 0, -1) / step
        tame = np.where(o.valid[..., None] & np.isfinite(change), change / o.sd[..., None], 0.0)
        out.append(tame.reshape(*tame.shape[:2], len(ports), KNOTS))
    return out


def _tested(
    problem: Problem,
    fitted: Fitted,
    patterns: Sequence[Array],
    name: str,
    port: Port | None,
) -> tuple[Place, list[Array]]:
    """A place with its evidence, and the coefficients of its patterns by record."""
    at = [len(o.local) for o in problem.fit]
    linears = tuple(
        Linear(
            x.residual,
            x.by_global,
            np.concatenate([x.by_local[..., :k], p, x.by_local[..., k:]], axis=2),
            np.zeros((*x.residual.shape, 0)),
        )
        for x, p, k in zip(fitted.linears, patterns, at, strict=True)
    )
    point = Point(
        fitted.point.x,
        tuple(
            np.insert(v, k, np.zeros(p.shape[2]))
            for v, p, k in zip(fitted.point.local, patterns, at, strict=True)
        ),
    )
    best, coefficients = Place(name, port is not None, (), 0.0), []
    every = np.ones(len(problem.channels))
    for size in SIZES:
        wider = replace(
            problem,
            fit=tuple(
                replace(o, local=(*o.local, *[Local("mode", 0, 0.0, 1.0, size**-2)] * p.shape[2]))
                for o, p in zip(problem.fit, patterns, strict=True)
            ),
        )
        forced, taken = _explained(wider, replace(fitted, point=point, linears=linears))
        gain = log_evidence(wider, forced, every) - log_evidence(problem, fitted, every)
        if np.isfinite(gain) and gain > best.gain:
            left = rms_of(problem.fit, (x.residual for x in forced.linears)) / np.sqrt(1.0 - taken)
            best = replace(best, left=tuple(float(v) for v in left), gain=float(gain))
            coefficients = [
                v[k : k + p.shape[2]]
                for v, p, k in zip(forced.point.local, patterns, at, strict=True)
            ]
    return best, coefficients


def _explained(problem: Problem, fitted: Fitted, rounds: int = 4) -> tuple[Fitted, float]:
    """Fit of the unknowns to first order, and the share of the samples that it took.

    It begins as if the place explained everything but the noise of the sensors.
    """
    prior, base, taken = prior_of(problem, fitted.members), fitted, 0.0
    now, noise = fitted, np.ones_like(fitted.noise)
    for _ in range(rounds):
        own = system(problem, problem.fit, base.members, base.point, base.linears, noise, 1.0)
        weight = prior.weights(base.point.x)
        matrix = own.matrix + np.diag(weight)
        step = np.linalg.solve(matrix, own.right - weight * base.point.x)
        local = [np.linalg.solve(a, target - b @ step) for a, b, target in own.locals]
        linears = tuple(
            replace(x, residual=x.residual - x.by_global @ step - x.by_local @ d)
            for x, d in zip(base.linears, local, strict=True)
        )
        free = float(step.size)
        for (inner, _, _), o, values in zip(own.locals, problem.fit, base.point.local, strict=True):
            weights_of = np.zeros(values.size)
            weights_of[: len(o.local)] = [q.weight for q in o.local]
            free += values.size - float(np.diag(np.linalg.inv(inner)) @ weights_of)
        taken = min(max(free, 0.0) / float(problem.samples.sum()), 0.5)
        point = Point(
            base.point.x + step,
            tuple(v + d for v, d in zip(base.point.local, local, strict=True)),
        )
        now = Fitted(base.members, point, linears, noise_left(problem, linears, taken))
        noise = now.noise
    return now, taken


def _force_path(
    problem: Problem, fitted: Fitted, forces: Sequence[Array], port: Port
) -> Array | None:
    """Force, position and speed at the knots of all records, (3, k); None: a simulation fails."""
    names = [s.name for s in problem.model.states()]
    found = []
    for r, (o, force) in enumerate(zip(problem.fit, forces, strict=True)):
        path = motion(problem.model, o.record, _jobs(problem, fitted, r, 1))
        if path is None:
            return None
        stops = np.linspace(0, o.end - 1, KNOTS).astype(int)
        x = path[stops]
        there = [x[:, names.index(n)] if n in names else 0.0 * x[:, 0]
                 for n in (port.position, port.speed)]  # fmt: skip
        at = o.record.time[stops] - o.record.time[0]
        span = o.record.time[-1] - o.record.time[0]
        found.append(np.array([np.interp(at / span, np.linspace(0, 1, KNOTS), force), *there]))
    return np.concatenate(found, axis=1)


def _likeness(force: Array, q: Array, v: Array) -> tuple[tuple[str, float], ...]:
    """Laws of position and speed that a force resembles, with the share that each explains.

    Parts that are proportional to position or speed are removed from force and law first: the
    parameters of the model have taken them up. A law of the speed must act against the motion.
    """
    laws = {
        "sign of the speed": np.sign(v),
        "speed times its magnitude": v * np.abs(v),
        "position squared": q**2,
        "position cubed": q**3,
        "constant": np.ones_like(q),
    }
    taken = np.column_stack([q, v])

    def rest(x: Array) -> Array:
        return np.asarray(x - taken @ np.linalg.lstsq(taken, x, rcond=1e-10)[0])

    goal, shares = rest(force), []
    whole = float(goal @ goal)
    if not whole > 1e-18 * float(force @ force):  # position and speed explain all of it
        return ()
    for law, values in laws.items():
        own = rest(values)
        size, product = float(own @ own), float(own @ goal)
        # Without their linear parts, the laws of the speed differ in their sign only.
        if size > 1e-9 * float(values @ values) and ("speed" not in law or product < 0.0):
            shares.append((law, product**2 / (size * whole)))
    return tuple(s for s in sorted(shares, key=lambda s: -s[1])[:2] if s[1] > ALIKE)
