"""A first call of every effect that is written in Python: its faults are told before the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.nominal import Effect, Lanes, Nominal, Term
from feltmb.fit.observe import machine_terms, observe_lanes

__all__ = ["try_effects"]

#: Samples that are simulated: enough for a filter of a sensor.
SAMPLES = 32


def try_effects(nominal: Nominal, effects: Sequence[Effect], record: Record) -> None:
    """Simulate the beginning of a record without effects, then with each, at its expected size.

    Raises
    ------
    InvalidParameter
        The model cannot be simulated, or effects whose callable raises or returns what cannot be
        used, all of them.
    """
    try:
        bare = observe_lanes(nominal, record, _begin(nominal, None, record)).outputs
    except InvalidParameter:
        raise
    except Exception as error:  # whatever a callable of the user raises
        raise InvalidParameter(f"model {nominal.name}: {_told(error)}") from error
    faults = []
    for e in effects:
        if e.rate is None and e.observe is None and e.excite is None:
            continue
        for shape in e.shapes:
            fault = _fault(nominal, Term(e, shape), record, bare)
            if fault:
                faults.append(f"{e.name}: {fault}")
                break
    if faults:
        raise InvalidParameter("effects: " + "; ".join(faults))


def _fault(nominal: Nominal, term: Term, record: Record, bare: Array) -> str:
    """What is wrong with a term, or nothing; ``bare``: outputs without it."""
    e = term.effect
    try:
        if e.excite is not None:
            # The changed record checks names and lengths; a whole run would cost too much.
            record.with_inputs(e.excite(record, _size(e), term.shape))
            same = record.with_inputs(e.excite(record, 0.0, term.shape))
            moved = [n for n, v in record.inputs.items() if not _alike(same.inputs[n], v)]
            return f"at size zero it changes the input {', '.join(moved)}" if moved else ""
        lanes = _begin(nominal, term, record)
        observe_lanes(nominal, record, lanes)
        zero = observe_lanes(nominal, record, replace(lanes, sizes=0.0 * lanes.sizes)).outputs
        if not _alike(zero, bare):
            return "at size zero it is not the nominal: what it adds must vanish with its size"
    except InvalidParameter as error:
        return str(error).removeprefix(f"effect {e.name}: ")
    except Exception as error:  # whatever a callable of the user raises
        what = "rate" if e.rate is not None else "observe" if e.observe is not None else "excite"
        return f"its {what} raises {_told(error)}"
    return ""


def _told(error: Exception) -> str:
    """An error of a user's callable, with what it mostly comes from."""
    text = f"{type(error).__name__}: {error}"
    if "truth value of an array" in text or "only length-1 arrays" in text:
        text += " (it is called with whole arrays: use np.where, np.maximum, np.sin)"
    return text


def _alike(one: Array, other: Array) -> bool:
    """Equal but for rounding."""
    finite = np.abs(other[np.isfinite(other)])
    size = float(np.max(finite)) if finite.size else 0.0
    return bool(np.allclose(one, other, rtol=1e-9, atol=1e-9 * size, equal_nan=True))


def _begin(nominal: Nominal, term: Term | None, record: Record) -> Lanes:
    """A few samples in three lanes: so many that a wrong shape does not fit by chance."""
    last = min(SAMPLES, record.samples) - 1
    terms = () if term is None else (term,)
    starts: Array = np.array([[s.start for s in nominal.states(machine_terms(terms))]] * 3)
    return Lanes(
        theta=np.array([[p.value for p in nominal.parameters]] * 3),
        windows=np.array([[0, last]] * 3),
        starts=starts.reshape(3, -1),
        terms=terms,
        sizes=np.array([[_size(t.effect) for t in terms]] * 3),
    )


def _size(effect: Effect) -> float:
    """The expected size, on the side that is permitted."""
    size = -effect.scale if effect.sign < 0 else effect.scale
    return float(np.clip(size, *effect.bounds))
