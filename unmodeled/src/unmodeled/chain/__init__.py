"""One chain from a quantity to its reading: errors of sensors and inputs, with derivatives.

A *fault* changes a signal by its size, and at size 0 it changes nothing. The known errors of a
sensor, the unknown ones of a record, the causes of :mod:`unmodeled.library` and the removal of
errors from a record are faults of this folder. A further one is one file here, or anywhere, that
calls :func:`register`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unmodeled.errors import InvalidParameter, no_such

__all__ = [
    "Fault",
    "Link",
    "Signal",
    "fault_of",
    "faults",
    "register",
    "through",
    "true_value",
]

Array = NDArray[np.float64]
#: Largest number of steps by which a fault is removed, and the relative accuracy.
STEPS, ACCURACY = 200, 1e-13


#: A record: its times, its outputs and its start count.
Run = Any


@dataclass(frozen=True, eq=False)
class Signal:
    """Typical values of a channel or an input."""

    name: str
    values: Array
    interval: float = 1.0
    """Time step [s]."""
    unit: str = "1"
    is_input: bool = False

    @property
    def size(self) -> float:
        """Typical size of the values."""
        return float(np.nanquantile(np.abs(self.values), 0.98)) or 1.0


class Fault:
    """An error of a sensor or an input: one row of the chain.

    A row has a ``name`` and :meth:`act`. What the other methods are by default suits an error that
    is linear in its size and adds to the signal or multiplies it.
    """

    name: str
    unit: str = "1"
    """Unit of the size; "": that of the signal."""
    place: float = 5.0
    """Place in the chain: lag 1, delay 2, gain 3, offset 4, others 5."""
    common: bool = False
    """Whether the channels of a record with one uncertainty have one size, as those of a clock."""
    stated: bool = True
    """Whether a sensor may state its size without a shape."""
    sensor: tuple[str, str] | None = None
    """Mechanism and remedy in a report; None: it is no candidate of a sensor."""
    input: tuple[str, str] | None = None
    """The same for an input."""
    drive: bool = False
    """Whether an input has it in its drive; else its record has it."""
    each: tuple[str, str] | None = None
    """What differs between records, and the remedy; None: it is no candidate in each record."""
    always: bool = False
    """Whether it is such a candidate without the same error of all records among the effects,
    because it resembles no parameter."""

    def act(self, run: Run, y: Array, size: Any, shape: Any = None) -> Array:
        """Readings of signals ``y``, (b, n)."""
        raise NotImplementedError

    def by_size(self, run: Run, y: Array, size: float, shape: Any = None) -> Array:
        """Derivative of the readings by the size, (b, n)."""
        del size
        return self.act(run, y, 1.0, shape) - y

    def push(self, run: Run, y: Array, size: float, shape: Any, change: Array) -> Array:
        """Change of the readings for small changes of the signal, (k, n); ``y`` is (1, n)."""
        return self.act(run, change, size, shape) - self.act(run, 0.0 * y, size, shape)

    def undo(self, run: Run, reading: Array, size: float, shape: Any = None) -> Array:
        """Signals from readings, (b, n): by repeated correction."""
        y, most = reading, float(np.max(np.abs(reading), initial=0.0))
        for _ in range(STEPS):
            left = reading - self.act(run, y, size, shape)
            y = y + left
            if not np.any(np.abs(left) > ACCURACY * most):
                return y
        raise InvalidParameter(f"{self.name} = {size:g}: it loses the signal, and is not removed")

    def noise(self, run: Run, size: float) -> float:
        """Factor of white noise by :meth:`undo`."""
        del run, size
        return 1.0

    def fields(self, signal: Signal) -> dict[str, Any]:
        """Fields of its effect on a signal, such as the scale."""
        del signal
        return {"scale": 0.05}

    def suits(self, signal: Signal) -> bool:
        """Whether a signal with these values may have it."""
        del signal
        return True

    def of(self, signal: Signal) -> Fault:
        """The fault of a signal, with numbers that follow from its values."""
        del signal
        return self

    def at(self, channel: str) -> Fault:
        """The fault of a channel of a record, whose readings it may use."""
        del channel
        return self


_FAULTS: dict[str, Fault] = {}


def register(fault: Fault) -> Fault:
    """Add a fault to the chain."""
    _FAULTS[fault.name] = fault
    return fault


def faults() -> Mapping[str, Fault]:
    """All faults by name, in the order of the chain."""
    return dict(sorted(_FAULTS.items(), key=lambda row: row[1].place))


def fault_of(name: str) -> Fault:
    """The fault of a name.

    Raises
    ------
    InvalidParameter
        There is none.
    """
    if name not in _FAULTS:
        raise no_such("fault of a sensor", name, _FAULTS)
    return _FAULTS[name]


@dataclass(frozen=True, eq=False)
class Link:
    """A fault of channels: called as the ``observe`` of an effect."""

    fault: Fault
    channels: Sequence[int] | None = None
    """Indices; None: all channels."""
    own: Sequence[Fault] = ()
    """The fault of each of these channels, if they differ."""

    def __call__(self, run: Run, outputs: Array, sizes: Array, shape: Any = None) -> Array:
        """Readings, (B, n, ny), for the sizes of B jobs."""
        out = outputs.copy()
        for size in np.unique(sizes[sizes != 0.0]):
            rows = np.flatnonzero(sizes == size)
            for c, fault in self._places(outputs):
                out[rows, :, c] = fault.act(run, outputs[rows, :, c], float(size), shape)
        return out

    def _places(self, outputs: Array) -> list[tuple[int, Fault]]:
        channels = range(outputs.shape[-1]) if self.channels is None else self.channels
        return [*zip(channels, self.own or [self.fault] * len(channels), strict=True)]

    def by_size(self, run: Run, outputs: Array, size: float, shape: Any) -> Array:
        """Derivative of the readings by the size, (n, ny)."""
        out = np.zeros_like(outputs)
        for c, fault in self._places(outputs):
            out[:, c] = fault.by_size(run, outputs[None, :, c], size, shape)[0]
        return out

    def push(self, run: Run, outputs: Array, size: float, shape: Any, columns: Array) -> Array:
        """Derivatives of the readings, (n, ny, k), from those of the outputs."""
        out = columns.copy()
        for c, fault in self._places(outputs) if size != 0.0 and columns.shape[-1] else ():
            own = fault.push(run, outputs[None, :, c], size, shape, columns[:, c].T)
            out[:, c] = own.T
        return out


def through(
    links: Sequence[tuple[Any, float, Any]], run: Run, outputs: Array, columns: Array
) -> tuple[Array, Array]:
    """Readings, and their derivatives, followed by those by the size of each link.

    Parameters
    ----------
    links
        Links, or what has their methods, with their sizes and shapes, in their order.
    run
        Record.
    outputs, columns
        Outputs, (n, ny), and their derivatives, (n, ny, k).
    """
    parts = [columns]
    for link, size, shape in links:
        by_size = link.by_size(run, outputs, size, shape)
        if size != 0.0:
            parts = [link.push(run, outputs, size, shape, np.concatenate(parts, axis=2))]
            outputs = link(run, outputs[None], np.array([size]), shape)[0]
        parts.append(by_size[..., None])
    return outputs, np.concatenate(parts, axis=2)


def true_value(run: Run, reading: Array, known: Mapping[str, float], shape: Any = None) -> Array:
    """A signal from its reading, (n,), without known errors.

    reading(t) = gain * low_pass(y)(t - delay) + offset

    A reading that is too large has a gain error > 0 (gain = 1 + error), and one that is late has a
    delay > 0, for outputs as well as inputs.

    Parameters
    ----------
    run
        Record of the reading.
    reading
        Values [unit of the signal].
    known
        Size by name of the fault.
    shape
        Shape of each fault, such as "smooth" for a delay of a signal without jumps.
    """
    out = np.array(reading, dtype=np.float64)[None]
    for name, fault in reversed([*faults().items()]):
        if known.get(name, 0.0) != 0.0:
            out = fault.undo(run, out, known[name], shape)
    return np.asarray(out[0])


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
