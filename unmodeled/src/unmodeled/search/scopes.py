"""Causes of some records: the laws and parameters of a problem in each of their scopes.

The scopes of a law have its odds together, so that many of them are no more probable than few. The
scores of all scopes need no simulation: the derivatives of the law in all records are those of each
scope in its records, and zero elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from unmodeled.errors import InvalidParameter
from unmodeled.models.model import Effect, Parameter
from unmodeled.models.subject import Subject
from unmodeled.search.problem import RELEASED, Cause, Problem


def scopes_of(count: int) -> list[frozenset[int]]:
    """Sets of records in which a law may act: one record, the first ones, the last ones."""
    if count < 2:
        return []
    runs = [range(k, k + 1) for k in range(count)]
    runs += [range(k) for k in range(2, count)]
    runs += [range(k, count) for k in range(1, count - 1)]
    return list(dict.fromkeys(frozenset(run) for run in runs))


def with_scopes(problem: Problem, names: Sequence[str], then: Sequence[str] = ()) -> Problem:
    """The problem with the causes of some of its measured records.

    Parameters
    ----------
    problem
        Problem whose causes act in all records.
    names
        Names of the measured records, in their order.
    then
        Names of those after a change, the only scope then; (): there may be any.

    Raises
    ------
    InvalidParameter
        There are no such records, or no others.
    """
    scopes = scopes_of(len(names))
    if then:
        if not set(then) < set(names):
            raise InvalidParameter(
                f"then: got {', '.join(then)}, expected some of the records, and not all: "
                f"{', '.join(names)}"
            )
        scopes = [frozenset(k for k, name in enumerate(names) if name in then)]
    if not scopes:
        return problem
    causes = list(problem.causes)
    for i, (cause, effect) in enumerate(_with_effects(problem)):
        if effect is None:
            continue
        for records in scopes:
            here = tuple(names[k] for k in sorted(records))
            scope = replace(effect.about.scope, records=here)
            causes.append(
                Cause(
                    f"{cause.name}{scope.where}",
                    cause.component,
                    effect,
                    log_odds=cause.log_odds - math.log(len(scopes)),
                    records=records,
                    scope=scope,
                    family=i,
                )
            )
    return replace(problem, causes=tuple(causes))


def _with_effects(problem: Problem) -> Iterator[tuple[Cause, Effect | None]]:
    """Causes with the effect that they are in some records; None: they have no such scopes."""
    for cause in problem.causes:
        effect = cause.effect
        if cause.parameter is not None:
            effect = _difference(problem.model.parameters[cause.parameter], cause)
        yield cause, effect


def _difference(p: Parameter, cause: Cause) -> Effect:
    """A parameter that has another value in some records."""
    assert cause.parameter is not None
    label = p.label or f"the parameter {p.name}"
    return Effect(
        name=p.name,
        component=cause.component,
        label=label,
        subject=Subject("parameter", component=cause.component, label=label),
        unit=p.unit,
        kind="parameter",
        scale=RELEASED * p.sd,
        lower=p.lower - p.value,
        upper=p.upper - p.value,
        relative=p.relative,
        moves=cause.parameter,
        mechanism="It has another value than in the other records.",
        remedy="Look for what was changed between the records.",
    )
