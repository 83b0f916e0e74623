"""Tests whether the errors of an integrator and of the input interpolation are detectable.

A difference is *detectable* if its noncentrality sqrt(sum((dy / sigma)^2)) over all samples is
large compared with the noise of the sensors. A diagnosis would attribute a detectable error to an
effect.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from feltmb.data import Record
from feltmb.fit.model import INTERPOLATION, Batch, Jobs, Model, Parameter
from feltmb.fit.noise import Noise

__all__ = ["BETWEEN", "Stepped", "resolved"]

#: Prefix of the parameter of an input that is the share of a spline in its interpolation.
BETWEEN = "between."
#: Noncentralities: steps are small enough below the first; specified steps cause a warning above
#: the second; the interpolation of an input is estimated above the third.
FINE, NOISY, DETECTABLE = 1.0, 3.0, 1.0
#: Largest number of substeps.
MOST = 16
#: Number of samples of a record, and of records, that are tested.
LONGEST, RECORDS = 1500, 4


class Stepped(Model):
    """A model that is integrated with fixed steps between samples."""

    inputs: tuple[str, ...]
    """Names of the inputs."""
    substeps: int | None
    """Steps per sample; None: as many as needed."""
    hold: str
    """Interpolation of the inputs between samples."""


M = TypeVar("M", bound=Stepped)


def resolved(model: M, records: Sequence[Record]) -> tuple[M, list[str]]:
    """A copy with sufficient substeps; the interpolation of inputs is estimated if detectable.

    Also returns notes for the report.
    """
    out = copy.copy(model)
    notes: list[str] = []
    seen = [_part(r) for r in records[:RECORDS] if all(n in r.inputs for n in model.inputs)]
    more = sum(r.samples for r in records) / max(1, sum(r.samples for r in seen))

    def difference_in_noise(one: M, other: M) -> float:
        return float(np.sqrt(more * _noise_distance(one, other, _jobs(other, seen))))

    if model.substeps is None:
        out.substeps, noisy = _substeps(out, 1, difference_in_noise)
        advice = "method='rosenbrock' suits stiff systems"
    else:
        noisy = difference_in_noise(out, _with_substeps(out, 2 * model.substeps))
        advice = "increase them, or use None to choose them automatically"
    if noisy > NOISY:
        notes.append(
            f"model {model.name}: substeps = {out.substeps}: half the step changes the outputs by "
            f"{noisy:.3g} times their noise, which can look like an effect; {advice}"
        )
    if model.hold == "auto":
        straight, smooth = copy.copy(out), copy.copy(out)
        straight.hold, smooth.hold = "linear", "spline"
        out.hold = "linear"
        if model.inputs and difference_in_noise(straight, smooth) > DETECTABLE:
            out.hold = "between"
            out.parameters = model.parameters + tuple(
                Parameter(
                    name=f"{BETWEEN}{n}",
                    value=0.5,
                    sd=0.5,
                    lower=-1.0,
                    upper=2.0,
                    component=INTERPOLATION,
                    label=f"interpolation of {n} between samples",
                )
                for n in model.inputs
            )
    return out, notes


def _part(record: Record) -> Record:
    return record if record.samples <= LONGEST else record.cut(0, LONGEST)


def _with_substeps(model: M, substeps: int) -> M:
    out = copy.copy(model)
    out.substeps = substeps
    return out


def _substeps(
    model: M,
    substeps: int,
    difference_in_noise: Callable[[M, M], float],
) -> tuple[int, float]:
    """Smallest doubled number of substeps whose error is not detectable, and the error."""
    while True:
        noisy = difference_in_noise(
            _with_substeps(model, substeps), _with_substeps(model, 2 * substeps)
        )
        if noisy <= FINE or substeps >= MOST:
            return substeps, noisy
        substeps *= 2


def _jobs(model: Model, records: Sequence[Record]) -> list[Batch]:
    """One simulation of each record from its expected start."""
    theta = np.array([p.value for p in model.parameters])
    batches = []
    for r in records:
        mean = {} if r.start is None else r.start.mean
        start = np.array([mean.get(s.name, s.start) for s in model.states()])
        batches.append((r, Jobs(theta=theta[None], starts=start[None])))
    return batches


def _noise_distance(one: Model, other: Model, batches: Sequence[Batch]) -> float:
    """Sum of squares of the difference of two models in noise; infinite if one of them fails."""
    total = 0.0
    runs = zip(batches, one.simulate_all(batches), other.simulate_all(batches), strict=True)
    for (record, _), a, b in runs:
        for c, name in enumerate(one.outputs):
            sensor = record.sensors.get(name)
            if name in record.outputs and sensor is not None and sensor.sigma:
                y, z = a[0, :, c], b[0, :, c]
                with np.errstate(over="ignore", invalid="ignore"):
                    noise = Noise(sensor.sigma, relative=sensor.relative_sigma)
                    part = (y - z) / noise.sd(y)
                    part[~np.isfinite(y) & ~np.isfinite(z)] = 0.0  # both simulations fail
                    total += float(np.sum(np.where(np.isfinite(part), part, np.inf) ** 2))
    return total
