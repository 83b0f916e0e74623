"""Simulates every effect once before the fit, so that faults in its Python code are found early."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.calling import calling
from feltmb.fit.model import Candidate, Effect, Jobs, Model
from feltmb.fit.observe import machine_candidates, observe_jobs

__all__ = ["divergence", "try_effects"]

#: Number of simulated samples: enough for the filter of a sensor.
SAMPLES = 32
#: Ratio of a simulated to the largest measured value above which a simulation has diverged.
DIVERGED = 1e9


def try_effects(model: Model, effects: Sequence[Effect], record: Record) -> None:
    """Simulate the first samples of a record without effects, then with each of them.

    Raises
    ------
    InvalidParameter
        The model cannot be simulated, or a callable of an effect raises or returns an invalid
        value. All faulty effects are in one message.
    """
    bare = observe_jobs(model, record, _begin(model, None, record)).outputs
    _check_numbers(model, record, bare)
    faults = []
    for e in effects:
        if (e.rate, e.observe, e.excite, e.regressor) == (None, None, None, None):
            continue
        for shape in e.shapes:
            fault = _fault(model, Candidate(e, shape), record, bare)
            if fault:
                faults.append(f"{e.name}: {fault}")
                break
    if faults:
        raise InvalidParameter("effects: " + "; ".join(faults))


def _fault(model: Model, candidate: Candidate, record: Record, bare: Array) -> str:
    """Fault of a candidate, as text; empty: none. ``bare``: outputs without it."""
    e = candidate.effect
    try:
        if e.excite is not None:
            # Changing the record checks the lengths; a whole simulation would be too slow.
            with calling("its excite"):
                change = e.excite(record, _size(e), candidate.shape)
                same = record.with_inputs(e.excite(record, 0.0, candidate.shape))
            new = [n for n in record.with_inputs(change).inputs if n not in record.inputs]
            if new:
                return (
                    f"its excite changes {new[0]!r}, which is no input of the record; known are "
                    f"{', '.join(record.inputs)}"
                )
            moved = [n for n, v in record.inputs.items() if not _alike(same.inputs[n], v)]
            return f"at magnitude zero it changes the input {', '.join(moved)}" if moved else ""
        jobs = _begin(model, candidate, record)
        seen = observe_jobs(model, record, jobs).outputs
        if _runs(bare) and not _runs(seen):
            return (
                f"at magnitude {jobs.magnitudes[0, 0]:.3g} the outputs of the model are not finite"
            )
        zero = observe_jobs(model, record, replace(jobs, magnitudes=0.0 * jobs.magnitudes)).outputs
        if not _alike(zero, bare):
            return "at magnitude zero it changes the model; its contribution must vanish"
    except InvalidParameter as error:
        return str(error).removeprefix(f"effect {e.name}: ")
    return ""


def _check_numbers(model: Model, record: Record, bare: Array) -> None:
    """Check that the model gives finite numbers at its priors, from a given or estimated start."""
    if _runs(bare) and not divergence(record, model.outputs, bare[0]):
        return
    segments = np.array([[0, min(SAMPLES, record.samples) - 1]])
    theta = np.array([p.value for p in model.parameters])
    starts = model.guess([record], [segments])[0]
    jobs = Jobs.at_point(theta, segments, starts, (), np.zeros(0))
    bare = observe_jobs(model, record, jobs).outputs
    if fault := divergence(record, model.outputs, bare[0]):
        raise InvalidParameter(f"model {model.name}, {fault}")
    if not _runs(bare):
        raise InvalidParameter(
            f"model {model.name}: at the beginning of record {record.name} all outputs are NaN or "
            "infinite, with the parameters at their priors"
        )


def divergence(record: Record, names: Sequence[str], outputs: Array) -> str:
    """Description of outputs (n, ny) that are far beyond those of the record; empty: none are.

    The first sample may be infinite: a start that is not yet estimated can be a singular point.
    """
    for i, name in enumerate(names):
        seen = record.outputs.get(name)
        if seen is None or not np.any(np.isfinite(seen)):
            continue
        most = float(np.nanmax(np.abs(seen)))
        with np.errstate(invalid="ignore"):
            far = np.flatnonzero(np.abs(outputs[1:, i]) > DIVERGED * most)
        if most > 0.0 and far.size:
            unit = record.sensors[name].unit
            return (
                f"record {record.name}: {name} of the model is beyond {DIVERGED:.0e} times the "
                f"largest measured value ({most:.3g} {unit}) after {far[0] + 1} samples. The "
                f"samples are {record.interval:.3g} s apart: is this their unit (--unit time=ms), "
                "and are the rates of the model per second? Or the model is unstable."
            )
    return ""


def _runs(outputs: Array) -> bool:
    """Whether there are finite values after the first sample."""
    later = outputs[:, 1:] if outputs.shape[1] > 1 else outputs
    return bool(np.any(np.isfinite(later)))


def _alike(one: Array, other: Array) -> bool:
    """Whether two arrays are equal except for rounding."""
    finite = np.abs(other[np.isfinite(other)])
    size = float(np.max(finite)) if finite.size else 0.0
    return bool(np.allclose(one, other, rtol=1e-9, atol=1e-9 * size, equal_nan=True))


def _begin(model: Model, candidate: Candidate | None, record: Record) -> Jobs:
    """Three jobs with a few samples each; with three, a wrong shape cannot fit by chance."""
    last = min(SAMPLES, record.samples) - 1
    included = () if candidate is None else (candidate,)
    starts: Array = np.array([[s.start for s in model.states(machine_candidates(included))]] * 3)
    return Jobs(
        theta=np.array([[p.value for p in model.parameters]] * 3),
        segments=np.array([[0, last]] * 3),
        starts=starts.reshape(3, -1),
        included=included,
        magnitudes=np.array([[_size(t.effect) for t in included]] * 3),
    )


def _size(effect: Effect) -> float:
    """Expected magnitude with a permitted sign."""
    size = -effect.scale if effect.sign < 0 else effect.scale
    return float(np.clip(size, *effect.bounds))
