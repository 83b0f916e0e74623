"""Whether the steps of an integrator, and what it takes an input to be between samples, are heard.

A difference is *heard* where it stands out of the noise of the sensors: its noncentrality
sqrt(sum((dy / sigma)^2)) over all samples. What is heard would be named as a cause.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from feltmb.data import Record
from feltmb.fit.model import Job, Lanes, Model, Parameter, Simulated
from feltmb.fit.together import each

__all__ = ["BETWEEN", "Stepped", "refined", "resolved"]

#: Name of the parameter of an input that says how much of a spline it is between its samples.
BETWEEN = "between."
#: Noncentrality up to which steps are fine enough, from which an explicit number of them is spoken
#: of, and from which it is estimated how an input runs between its samples.
FINE, LOUD, HEARD = 1.0, 3.0, 1.0
#: Error of the steps, as a share of what the effects of a model do, up to which it is their form.
FORM = 0.001
#: Substeps at most.
MOST = 16
#: Samples of a window, of a record and number of records that are looked at.
WINDOW, LONGEST, RECORDS = 64, 1500, 4


class Stepped(Model):
    """A model that is integrated in steps of the samples."""

    inputs: tuple[str, ...]
    """Names of the inputs."""
    substeps: int | None
    """Steps a sample; None: as many as it takes."""
    hold: str
    """What an input is between its samples."""


M = TypeVar("M", bound=Stepped)


def resolved(model: M, records: Sequence[Record]) -> tuple[M, list[str]]:
    """A copy with substeps that are fine enough, and inputs whose run is estimated if it is heard.

    Also what is to be told of it.
    """
    out = copy.copy(model)
    notes: list[str] = []
    seen = [_part(r) for r in records[:RECORDS] if all(n in r.inputs for n in model.inputs)]
    more = sum(r.samples for r in records) / max(1, sum(r.samples for r in seen))

    def heard(one: M, other: M) -> float:
        return float(np.sqrt(more * _heard(one, other, _jobs(other, seen))))

    if model.substeps is None:
        out.substeps, loud = _substeps(out, 1, heard)
        advice = "method='rosenbrock' suits stiff systems"
    else:
        loud = heard(out, _with_substeps(out, 2 * model.substeps))
        advice = "give more of them, or None: as many as it takes"
    if loud > LOUD:
        notes.append(
            f"model {model.name}: substeps = {out.substeps}: half the step changes the outputs by "
            f"{loud:.3g} times their noise, which looks like a cause; {advice}"
        )
    if model.hold == "auto":
        straight, smooth = copy.copy(out), copy.copy(out)
        straight.hold, smooth.hold = "linear", "spline"
        out.hold = "linear"
        if model.inputs and heard(straight, smooth) > HEARD:
            out.hold = "between"
            out.parameters = model.parameters + tuple(
                Parameter(
                    name=f"{BETWEEN}{n}", value=0.5, sd=0.5, lower=-1.0, upper=2.0, component=n
                )
                for n in model.inputs
            )
    return out, notes


def refined(model: M, jobs: Sequence[Job]) -> M:
    """The model with substeps that are fine enough for some lanes; itself if it has them.

    An error that is small beside what the terms of the lanes do is their form.
    """
    bare = [(record, replace(lanes, sizes=0.0 * lanes.sizes)) for record, lanes in jobs]
    done = np.sqrt(_squares(model.simulate_all(jobs), model.simulate_all(bare), model, jobs))
    fine = max(FINE, FORM * done) if np.isfinite(done) else FINE

    def heard(one: M, other: M) -> float:
        return float(np.sqrt(_heard(one, other, jobs)))

    now = model.substeps or 1
    substeps, _ = _substeps(model, now, heard, fine)
    return model if substeps == now else _with_substeps(model, substeps)


def _part(record: Record) -> Record:
    return record if record.samples <= LONGEST else record.cut(0, LONGEST)


def _with_substeps(model: M, substeps: int) -> M:
    out = copy.copy(model)
    out.substeps = substeps
    return out


def _substeps(
    model: M,
    substeps: int,
    heard: Callable[[M, M], float],
    fine: float = FINE,
) -> tuple[int, float]:
    """Fewest substeps whose halves are not heard, from some on, and how loud they are."""
    while True:
        loud = heard(_with_substeps(model, substeps), _with_substeps(model, 2 * substeps))
        if loud <= fine or substeps >= MOST:
            return substeps, loud
        substeps *= 2


def _jobs(model: Model, records: Sequence[Record]) -> list[Job]:
    """Windows of records from starts on the model's own way."""
    theta = np.array([p.value for p in model.parameters])
    windows = [_windows(r) for r in records]
    starts = each(model, lambda m, at: m.guess(*at), list(zip(records, windows, strict=True)))
    return [
        (r, Lanes.at_point(theta, w, x, (), np.zeros(0)))
        for r, w, x in zip(records, windows, starts, strict=True)
    ]


def _windows(record: Record) -> NDArray[np.intp]:
    edges = np.unique([*range(0, record.samples - 1, WINDOW), record.samples - 1])
    return np.column_stack([edges[:-1], edges[1:]])


def _heard(one: Model, other: Model, jobs: Sequence[Job]) -> float:
    """Sum of squares of the difference of two models; infinite where one of them fails."""
    return _squares(one.simulate_all(jobs), other.simulate_all(jobs), one, jobs)


def _squares(
    ones: Sequence[Simulated], others: Sequence[Simulated], model: Model, jobs: Sequence[Job]
) -> float:
    """Sum of squares of the difference of two simulations over the noise."""
    total = 0.0
    for (record, lanes), a, b in zip(jobs, ones, others, strict=True):
        length = (lanes.windows[:, 1] - lanes.windows[:, 0])[:, None]
        inside = np.arange(a.outputs.shape[1]) <= length
        for c, name in enumerate(model.outputs):
            sensor = record.sensors.get(name)
            if name in record.outputs and sensor is not None and sensor.sigma:
                one, other = (run.outputs[:, :, c][inside] for run in (a, b))
                part = (one - other) / sensor.sigma
                part[~np.isfinite(one) & ~np.isfinite(other)] = 0.0  # it fails with any steps
                total += float(np.sum(np.where(np.isfinite(part), part, np.inf) ** 2))
    return total
