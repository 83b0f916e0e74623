"""Rates and outputs by calls of functions of Python, for those that cannot be traced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from unmodeled.data import Array
from unmodeled.errors import InvalidParameter, shown
from unmodeled.models.coordinates import Rate
from unmodeled.models.model import BETWEEN, Candidate, Effect, Jobs
from unmodeled.ode.calling import calling
from unmodeled.ode.tape import Traced
from unmodeled.ode.traces import (
    OWN,
    Key,
    Part,
    System,
    Traces,
    Values,
    check_names,
    effect_part,
    form_of,
    keys_of,
    own_parts,
    own_trace,
    port_part,
)
from unmodeled.ode.witness import column, equal, word


class Each:
    """A function by calls: with arrays of all jobs if these give the same, else job by job."""

    def __init__(self, part: Part, together: bool):
        self.part, self.together, self.calls = part, together, 0

    def __call__(self, at: Values, count: int) -> dict[Key, Array]:
        """Values by target, (jobs,)."""
        if self.together and count > 1:
            try:
                found = {t: column(v, count) for t, v in self.part.of(at).items()}
                if self._agrees(found, at, count):
                    return found
            except (TypeError, ValueError):
                pass
            self.together = False
        rows = [self._numbers(at, b) for b in range(count)]
        return {
            t: np.array([row.get(t, 0.0) for row in rows])
            for t in dict.fromkeys(t for row in rows for t in row)
        }

    def _agrees(self, found: Mapping[Key, Array], at: Values, count: int) -> bool:
        """Whether the first and the last job have the values of single calls, at a few calls."""
        self.calls += 1
        return self.calls & (self.calls - 1) != 0 or all(
            equal(row.get(t, 0.0), float(found[t][b]) if t in found else 0.0)
            for b in (0, count - 1)
            for row in (self._numbers(at, b),)
            for t in dict.fromkeys([*row, *found])
        )

    def _numbers(self, at: Values, b: int) -> dict[Key, float]:
        with calling(self.part.what):
            found = self.part.of({k: v[b] for k, v in at.items()})
        return {t: self._number(t, v) for t, v in found.items()}

    def _number(self, target: Key, value: Any) -> float:
        if np.iscomplexobj(value):
            fault = "is complex, expected a real number"
        elif np.shape(value) not in ((), (1,)):
            fault = f"has shape {np.shape(value)}, expected a number or one value a job"
        elif np.asarray(value).dtype.kind not in "biuf":
            fault = f"is {shown(value)}, expected a number"
        else:
            return float(np.reshape(value, ()))
        raise InvalidParameter(f"{self.part.what.split(':')[0]}: {word(target)} {fault}")


class Plain:
    """Rates and outputs of jobs, by calls of the functions."""

    def __init__(self, system: System, traces: Traces, jobs: Jobs):
        self.system, self.jobs = system, jobs
        self.own, *self.shown = _each(traces, OWN, own_parts(system))
        first = len(system.states)
        self.places = {("rate", n): i for i, n in enumerate(system.names)}
        self.included: list[tuple[Each, dict[Key, int], dict[Key, int]]] = []
        for candidate in jobs.included:
            check_names(system, candidate)
            form = form_of(system, traces, candidate)
            (part,) = _each(traces, (form.effect, form.text), [effect_part(candidate)])
            names = [h.name for h in candidate.effect.hidden]
            hidden = {("x", n): first + i for i, n in enumerate(names)}
            places = self.places | {("rate", n): i for (_, n), i in hidden.items()}
            self.included.append((part, hidden, places))
            first += len(names)
        ports = system.ports if jobs.forces is not None else ()
        self.ports = [Each(port_part(system, n), together=False) for n in ports]

    def _at(self, t: Array, x: Array, u: Array) -> dict[Key, Array]:
        """Values of the inputs of the model's functions, (jobs,)."""
        system = self.system
        theta = dict(zip(system.parameters, self.jobs.theta.T, strict=True))
        held = dict(zip(system.inputs, u, strict=False))
        if system.hold == "between":
            held = {
                n: u[2 * i] + theta[BETWEEN + n] * u[2 * i + 1] for i, n in enumerate(system.inputs)
            }
        values = {"x": dict(zip(system.names, x, strict=False)), "u": held, "p": theta}
        at = {k: t if k == ("t",) else values[k[0]][k[1]] for k in keys_of(system)}
        return {k: _read_only(v) for k, v in at.items()}

    def rates(self, t: Array, x: Array, signals: Array) -> Array:
        """Rates of all states, (states, jobs)."""
        at, out = self._at(t, x, signals), np.zeros(x.shape)
        for target, value in self.own(at, t.size).items():
            out[self.places[target]] = value
        for k, (part, hidden, places) in enumerate(self.included):
            further = {key: _read_only(x[i]) for key, i in hidden.items()}
            further["size",] = _read_only(self.jobs.magnitudes[:, k])
            for target, value in part({**at, **further}, t.size).items():
                out[places[target]] += value
        forces = signals[len(signals) - len(self.ports) :]
        for port, force in zip(self.ports, forces, strict=True):
            for target, value in port({**at, ("force",): force}, t.size).items():
                out[self.places[target]] += value
        return out

    def outputs(self, t: Array, x: Array, signals: Array, slopes: Array) -> Array:
        """Outputs, (outputs, jobs)."""
        at, system = self._at(t, x, signals), self.system
        found = {k: v for part in self.shown for k, v in part(at, t.size).items()}
        out = np.empty((len(system.outputs), t.size))
        for row, (name, of) in zip(out, system.outputs.items(), strict=True):
            if isinstance(of, Rate):
                row[:] = slopes[system.names.index(of.state)]
            else:
                row[:] = at["x", of] if isinstance(of, str) else found["output", name]
        return out


def along(
    system: System, traces: Traces, at: Values, count: int, effect: Effect | None = None
) -> dict[Key, Array]:
    """Rates and outputs of a model, or rates of an effect without a shape, along a path, (count,).

    ``at``: values by key, numbers or (count,).
    """
    part, traced = own_parts(system)[0], own_trace(system, traces)
    if effect is not None:
        candidate = Candidate(effect)
        form = form_of(system, traces, candidate)
        part, traced = effect_part(candidate), traces.effects[effect, form.text]
    if isinstance(traced, Traced):
        values = traced.tape.evaluated(traced.values.values(), at)
        found = {t: values[n] for t, n in traced.values.items()}
    else:
        at = {k: np.broadcast_to(v, (count,)) for k, v in at.items()}
        found = Each(part, together=False)(at, count)
    return {t: np.array(np.broadcast_to(v, (count,))) for t, v in found.items()}


def _each(traces: Traces, key: Any, parts: Sequence[Part]) -> list[Each]:
    known = traces.compared.get(key, (False,) * len(parts))
    return [Each(p, together) for p, together in zip(parts, known, strict=True)]


def _read_only(values: Array) -> Array:
    """Values that a function cannot change."""
    view = values.view()
    view.setflags(write=False)
    return view
