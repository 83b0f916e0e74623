"""Causes of some records: the laws and parameters of a problem in each of their scopes.

The scopes of a law have its odds together, so that many of them are no more probable than few. The
scores of all scopes need no simulation: the derivatives of the law in all records are those of each
scope in its records, and zero elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from unmodeled.data import Record
from unmodeled.errors import InvalidParameter
from unmodeled.models.model import Effect, Parameter
from unmodeled.models.subject import Subject
from unmodeled.search.problem import RELEASED, Cause, Local, Problem

#: Least number of records whose differences are random, or a course.
MANY = 4
#: What a size of each record means, and what to do about it.
DIFFERS = "Each record has a size of its own, as other subjects, specimens or loads have."
LOOK = "Find what differs between the records, and state it by record."
#: Name of the condition of a record that tells its start on a clock of all records.
START = "start"


def scopes_of(starts: Sequence[float]) -> list[tuple[float, ...]]:
    """Shares of a law in each record: in one record, the first ones, the last ones, and growing.

    ``starts``: times at which the records begin.
    """
    count = len(starts)
    if count < 2:
        return []
    runs = [range(k, k + 1) for k in range(count)]
    runs += [range(k) for k in range(2, count)]
    runs += [range(k, count) for k in range(1, count - 1)]
    shares = [tuple(float(k in run) for k in range(count)) for run in runs]
    if count >= MANY:
        since = [t - min(starts) for t in starts]
        shares.append(tuple(t / max(since) for t in since))
    return list(dict.fromkeys(shares))


def starts_of(records: Sequence[Record]) -> list[float]:
    """Times at which records begin: those that all of them state, or their order."""
    stated = [r.conditions.get(START) for r in records]
    known = [float(t) for t in stated if isinstance(t, int | float)]
    return known if len(set(known)) == len(records) else [float(k) for k in range(len(records))]


def with_scopes(problem: Problem, records: Sequence[Record], then: Sequence[str] = ()) -> Problem:
    """The problem with the causes of some of its measured records.

    Parameters
    ----------
    problem
        Problem whose causes act in all records.
    records
        The measured records, in their order.
    then
        Names of those after a change, the only scope then; (): there may be any.

    Raises
    ------
    InvalidParameter
        There are no such records, or no others.
    """
    names = [r.name for r in records]
    scopes = scopes_of(starts_of(records))
    if then:
        if not set(then) < set(names):
            raise InvalidParameter(
                f"then: got {', '.join(then)}, expected some of the records, and not all: "
                f"{', '.join(names)}"
            )
        scopes = [tuple(float(name in then) for name in names)]
    if not scopes:
        return problem
    causes = list(problem.causes)
    each = len(problem.fit) >= MANY - 1 and not then
    for i, (cause, effect) in enumerate(_with_effects(problem)):
        if effect is None:
            continue
        own = Cause(
            "",
            cause.component,
            effect,
            log_odds=cause.log_odds - math.log(len(scopes) + each),
            family=i,
        )
        for shares in scopes:
            here = tuple(n for n, share in zip(names, shares, strict=True) if share)
            course = not set(shares) <= {0.0, 1.0}
            scope = replace(
                effect.about.scope,
                records=here,
                shares=tuple(filter(None, shares)) if course else (),
            )
            name = f"{cause.name}{scope.where}"
            causes.append(replace(own, name=name, shares=shares, scope=scope))
        if each and not cause.of_records:
            local = Local("own", len(causes), 0.0, effect.scale)
            scope = replace(effect.about.scope, each=True)
            name = f"{cause.name} in each record"
            effect = replace(effect, mechanism=DIFFERS, remedy=LOOK)
            causes.append(replace(own, name=name, effect=effect, local=local, scope=scope))
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
