"""The diagnosis, step by step: compare, prepare, fit, search, predict held-out records, judge."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from unmodeled.arguments import checked
from unmodeled.blas import one_thread
from unmodeled.data import Record
from unmodeled.fit.measured import untested
from unmodeled.fit.observe import excited
from unmodeled.library.defaults import chosen_effects
from unmodeled.models.elsewhere import cached, resumed, running
from unmodeled.models.model import Effect, Model
from unmodeled.pictures.laws import laws
from unmodeled.pictures.motions import motions_of
from unmodeled.report import Report, explained_model
from unmodeled.report.case import Given
from unmodeled.search.compare import compared, refuse
from unmodeled.search.linear import EvaluationRequest, request_at
from unmodeled.search.options import Options
from unmodeled.search.problem import Problem
from unmodeled.search.progress import Limit, Meter, Progress
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.result import Reason
from unmodeled.search.search import Searched, search
from unmodeled.search.variation import varies, with_variation
from unmodeled.search.verdict import judge

#: Share of the limit of time after which no fit goes on; the rest is for the verdict.
FITS = 0.85


@checked
def diagnose(
    model: Model,
    effects: Sequence[Effect | str] | None,
    records: Sequence[Record] | Record,
    *,
    then: Sequence[Record] | Record = (),
    exclude: Sequence[str] | str = (),
    hold_out: Sequence[str] | str | None = None,
    options: Options | None = None,
    progress: Callable[[Progress], None] | None = None,
    executor: Any = None,
    cache: str | Path | None = None,
) -> Report:
    """Find the effects that a model lacks.

    Parameters
    ----------
    model
        Model of the machine.
    effects
        Effects that it may lack, or names and patterns of the default ones; None: all default
        ones, see :func:`candidates`. Those of parts that were tested (:func:`with_measured`) are
        omitted.
    records
        Measured runs; at least one.
    then
        Measured runs after a change of the machine: what differs between the two series is told.
        Those with the name of an earlier run get the name with "after".
    exclude
        Names, patterns, or components of effects that are not tested.
    hold_out
        Names of the records that are not fitted; default: those with the role "held_out", else
        every third of three or more records, else every second block of each record. ``()``: no
        record is held out.
    options
        Options; default: ``Options()``.
    progress
        Is called with the stage, the share of the work that is done, and the time that is left;
        default: nothing is called. If it raises :class:`Stop`, the search ends as at its limit of
        time.
    executor, cache
        Executor of the runs, and folder of finished runs, from which an interrupted diagnosis
        continues: see :func:`unmodeled.models.running`.

    Returns
    -------
    Report
        Verdict with named causes or classes, magnitudes, and residuals.

    Raises
    ------
    InvalidParameter, DataError
        Model, effects and records do not fit together.
    Stop, KeyboardInterrupt
        ``progress`` raised it, or Ctrl-C came, before there was a fit of the model.

    Examples
    --------
    A line with an offset of 0.3 m that its model lacks, in two records with a noise of 1 mm:

    >>> import numpy as np
    >>> from unmodeled import Record, Sensor, Simulator, diagnose
    >>> def line(time, inputs, p):
    ...     return {"x": p["gain"] * inputs["F"] + p["offset"]}
    >>> model = Simulator(
    ...     line, parameters={"gain": (2.0, 0.1, "m/N")}, unknown={"offset": "m"},
    ...     inputs={"F": "N"}, outputs={"x": "m"},
    ... )
    >>> time, rng = np.linspace(0.0, 1.0, 60), np.random.default_rng(0)
    >>> records = []
    >>> for k in (1, 2):
    ...     force = k * np.sin(7.0 * time + k)
    ...     x = 2.1 * force + 0.3 + 1e-3 * rng.standard_normal(60)
    ...     sensor = Sensor(name="x", unit="m", sigma=1e-3)
    ...     records.append(Record(name=f"r{k}", time=time, inputs={"F": force}, outputs={"x": x},
    ...                           sensors={"x": sensor}))
    >>> report = diagnose(model, None, records, exclude=["sensor*", "input*"])
    >>> [(c.cause, round(c.magnitude, 2), c.unit) for c in report.named]
    [('offset', 0.3, 'm')]
    """
    options = options or Options()
    if executor is not None or cache is not None:
        model = running(model, executor=executor, cache=cache)
    began = time.monotonic()
    given = (records,) if isinstance(records, Record) else tuple(records)
    if after := _after(given, (then,) if isinstance(then, Record) else tuple(then)):
        given, options = (*given, *after), replace(options, then=tuple(r.name for r in after))
    meter = Meter(progress, FITS * options.seconds)
    with one_thread(), _interrupted(model):
        meter.stage("prepare")
        ready = ready_records(model, given)
        found, chosen = chosen_effects(ready.model, ready.records, effects, exclude)
        tested = untested(found, ready.model)
        before = compared(ready)
        refuse(before)
        problem = prepare(ready, tested, hold_out, options)
        by_us = hold_out is None and not any(r.role == "held_out" for r in ready.records)
        notes = (
            *_clocks(problem),
            *_servos(problem, options),
            *before.notes,
            *(h.text for h in before.hints),
        )
        problem = replace(problem, notes=())
        if varies(problem):
            problem = with_variation(problem)
        meter.stage("fit")
        searched = search(problem, options, meter.stage, meter.step)
        needed = meter.needed
        check = Limit(began + FITS * options.seconds, meter.step, most=options.rounds)
        check.steps = searched.rounds
        result = judge(searched, options, time.monotonic() - began, meter.stage, check)
        split = _split(searched.problem) if by_us else ()
        told = (*_doubts(searched), *chosen, *split, *notes, *result.notes)
        result = replace(result, notes=told, rounds=check.steps)
        if not result.complete:
            late = Reason.INTERRUPTED not in result.reasons and options.rounds is None
            least = 2.0 * options.seconds if late else time.monotonic() - began
            result = replace(result, needed=max(needed, least))
        report = Report.of(result)
        _add_pictures(report, searched)
        meter.stage("done")
    report.cached = cached(ready.model)
    report.model = explained_model(ready.model, tested, result)
    report.case = Given(model, ready, tested, given, hold_out, options)
    return report


def _add_pictures(report: Report, searched: Searched) -> None:
    """Add the motions and the evidence of the changes."""
    if searched.answer is None:
        return
    problem, alone, best = searched.answer
    held_out = {o.record.name for o in searched.problem.held_out}
    report.motions = motions_of(problem, alone, best, report.changes, held_out)
    report.laws = laws(problem, best, report.changes)


def _after(before: Sequence[Record], then: Sequence[Record]) -> tuple[Record, ...]:
    """Records after a change, with names of their own."""
    taken = {r.name for r in before}
    return tuple(replace(r, name=f"{r.name} after") if r.name in taken else r for r in then)


@contextmanager
def _interrupted(model: Model) -> Iterator[None]:
    """A block whose Ctrl-C is told in one sentence: the search answers it if it has a fit."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"before there was an answer: {resumed(model)}") from None


def _doubts(searched: Searched) -> tuple[str, ...]:
    """What functions of the model give otherwise along the motions of the best set."""
    problem, best = searched.problem, searched.ranked()[0][0]
    ask = EvaluationRequest(best.members, best.point, problem.fit, derivatives=False)
    requests = [request_at(problem, ask, r) for r in range(len(problem.fit))]
    return problem.model.doubts([b for q in requests for _, b in excited(q.record, q.jobs())])


def _split(problem: Problem) -> tuple[str, ...]:
    """A note about records that are held out because nobody stated which."""
    names = ", ".join(o.record.name for o in problem.held_out)
    return (
        f"held out: {names}, chosen before any fit from the ranges of inputs and outputs "
        "(hold_out=)",
    )


def _servos(problem: Problem, options: Options) -> Iterator[str]:
    """Notes about what matters of outputs that a controller leads to an input."""
    rows = zip(problem.names, problem.units, problem.motion, problem.compared, strict=True)
    for name, unit, motion, own in rows:
        if own < motion and not {name, unit} & {*options.good_enough}:
            size = options.matters(name, unit, own)
            yield (
                f"{name}: more than {size:.2g} {unit} matters, 1 % of the rms of its goal minus "
                "it, because a servo leads it there; good_enough= states another size"
            )


def _clocks(problem: Problem) -> Iterator[str]:
    """Notes about sensors that are late together."""
    found = {
        (q.channels, q.scale)
        for o in (*problem.fit, *problem.held_out)
        for q in o.local
        if len(q.channels) > 1
    }
    for channels, sd in sorted(found):
        names = ", ".join(problem.names[c] for c in channels)
        yield (
            f"{names}: one clock, which is late by one time in each record, because they have the "
            f"same delay_sd ({sd:g} s); different values make them independent"
        )


@checked
def fit_model(
    model: Model,
    records: Sequence[Record] | Record,
    *,
    options: Options | None = None,
    progress: Callable[[Progress], None] | None = None,
    executor: Any = None,
    cache: str | Path | None = None,
) -> Report:
    """Fit the parameters of a model to all records: a diagnosis without effects.

    Errors of the records (:mod:`unmodeled.search.records`) and parameters outside their tolerances
    are considered as in a diagnosis. ``report.parameters`` has the values and their intervals,
    which allow for what the model does not explain. All parameters deviate by about their standard
    deviations (``tolerances="drawn"``), unless the options say "kept".

    Parameters
    ----------
    model
        Model of the machine.
    records
        Measured runs; at least one.
    options, progress, executor, cache
        As for :func:`diagnose`.

    Raises
    ------
    InvalidParameter, DataError
        Model and records do not fit together.
    """
    options = options or Options()
    if options.tolerances == "auto":  # a fit is not asked which few parameters changed
        options = replace(options, tolerances="drawn")
    own = {"options": options, "progress": progress, "executor": executor, "cache": cache}
    return diagnose(model, (), records, hold_out=(), **own)
