"""Contact laws: force from any history of compression, for use outside a mechanism.

``law(name, **parameters)`` makes a law by the name that mechanism files use. A law knows
compression, rate and its own history, and nothing of bodies.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb import _core
from feltmb.contact.tables import (
    CORE_LAWS,
    LAWS,
    LawInfo,
    core_envelope,
    power_faults,
    power_stiffness,
)
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shown
from unmodeled.units.quantity import parse_scalar

if TYPE_CHECKING:
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]


@checked
class Law:
    """A contact law and its memory.

    Sign convention: compression [m] is positive in contact, rate = d compression / dt [m/s], and
    the force [N] is positive in separation.
    """

    def __init__(self, core: _core.ContactLaw, name: str | None = None):
        self.core = core
        self._name = name or str(core.name)
        self._path = _core.LawPath(core)

    def __repr__(self) -> str:
        return f"Law({self.name!r})"

    @property
    def name(self) -> str:
        """Name of the law in a mechanism file."""
        return self._name

    @property
    def state(self) -> tuple[float, tuple[float, ...]]:
        """Largest remembered compression [m], and the states of the law.

        Without turning points: ``save`` has all of the memory.
        """
        return self._path.largest, tuple(self._path.state[: self.core.n_states])

    def force(
        self,
        compression: npt.ArrayLike,
        rate: npt.ArrayLike = 0.0,
        state: tuple[float, tuple[float, ...]] | None = None,
    ) -> Array:
        """Force [N] for compressions [m] and rates [m/s], with a memory (default: virgin felt).

        Parameters
        ----------
        compression
            Compression [m].
        rate
            Rate of the compression [m/s].
        state
            Memory of the felt, a value of the attribute ``state``; None: virgin felt.
        """
        largest, own = state if state is not None else (0.0, ())
        e, v = np.asarray(compression, dtype=float), np.asarray(rate, dtype=float)
        try:
            e, v = np.broadcast_arrays(e, v)
        except ValueError:
            raise InvalidParameter(
                f"force: compression has the shape {e.shape} and rate {v.shape}; expected one "
                "shape, or a number"
            ) from None
        out: Array = np.asarray(
            self.core.force(
                e,
                v,
                list(own) + [0.0] * (self.core.n_states - len(own)),
                largest,
            )
        )
        return out

    def step(self, compression: float, duration: float) -> float:
        """Change the compression to ``compression`` [m] in ``duration`` [s]; return the force [N].

        The law stores the new state; ``reset`` restores virgin felt.
        """
        if not (duration > 0.0 and np.isfinite(compression)):
            raise InvalidParameter(
                f"step: got compression {compression!r} m, duration {duration!r} s; expected a "
                "finite number and a time > 0"
            )
        return float(self._path.step(compression, duration))

    def peek(self, compression: float, duration: float) -> float:
        """Force [N] that ``step`` would return, without a change of the state."""
        return float(self._path.peek(compression, duration))

    def save(self) -> tuple[float, ...]:
        """Return the present point and all of the memory as numbers, for :meth:`restore`.

        They are the compression [m], the largest one [m], the states of the law, and the turning
        points [m] of a law that has them.
        """
        return tuple(self._path.save())

    @checked
    def restore(self, saved: Sequence[float]) -> None:
        """Return to a point that :meth:`save` gave.

        Raises
        ------
        InvalidParameter
            The numbers are not those of this law.
        """
        self._path.restore([float(number) for number in saved])

    @property
    def energy(self) -> float:
        """Stored energy at the present point [J]."""
        return float(self._path.energy(self.core))

    def reset(self) -> None:
        """Restore virgin felt."""
        self._path.reset()

    def path(self, compression: npt.ArrayLike, time: npt.ArrayLike) -> Array:
        """Force [N] for a history of compressions [m] at times [s], starting with virgin felt.

        The compression is linear between samples. ``felt_memory`` without options is integrated
        exactly: its force depends only on the sequence of compressions.
        """
        e = np.asarray(compression, dtype=float).ravel()
        t = np.asarray(time, dtype=float).ravel()
        out: Array = _core.force_along(self.core, t.tolist(), e.tolist())
        return out


@checked
def law(name: str, **parameters: Any) -> Law:
    """Make a contact law.

    Parameters
    ----------
    name
        One of :data:`feltmb.contact.LAWS`, such as ``"felt_memory"`` or ``"hunt_crossley"``.
    **parameters
        Entries of the law's table in a mechanism file: numbers in SI units, or texts with a unit
        such as ``"164000 N/mm^4.3"``; curves of thesis eq.
        4.21 as ``loading=(a, b, c)``; a loop as ``envelope=(compression, loading, unloading)``,
        arrays [m, N, N], or as its two curves. :data:`feltmb.contact.CORE_LAWS` has the fields of
        each law with unit, limits, default and meaning. ``"micromechanical"``: ``felt`` (name, file
        or :class:`feltmb.felt.FeltMaterial`), ``thickness`` [m], ``area`` (such as
        :class:`feltmb.felt.CrossedCylinders`, or a table as in a mechanism file), ``compression``
        (``"even"`` or ``"columns"``), and the numbers of ``"felt_memory"``.

    Raises
    ------
    InvalidParameter
        The name is unknown, or parameters are missing, unknown, of the wrong kind or out of range:
        all of the same sort in one message.

    Examples
    --------
    A felt of 1e9 N/m^2.5 at a compression of 1 mm, pressed slowly:

    >>> from feltmb import contact
    >>> felt = contact.law("hunt_crossley", stiffness=1e9, exponent=2.5)
    >>> round(float(felt.force(1e-3, 0.0)), 2)
    31.62
    """
    if name == "micromechanical":
        from feltmb.contact.layer import layer_parameters

        layer = layer_parameters(**parameters)
        core = _core.ContactLaw("felt_memory", envelope=layer.envelope, **layer.numbers)
        return Law(core, name)
    if name not in CORE_LAWS:
        raise InvalidParameter(f"law {name!r} is unknown; known are {', '.join(LAWS)}")
    return Law(_core.ContactLaw(name, **_core_values(CORE_LAWS[name], parameters)), name)


def _core_values(law: LawInfo, given: dict[str, Any]) -> dict[str, Any]:
    """Values of a law's fields for the core; all faults are in one message."""
    given, wrong = _in_si(law, given)
    needed, optional = _keys(law, given)
    known = {**needed, **optional}
    unknown = sorted(set(given) - set(known))
    units = {f.name: f" [{f.unit}]" for f in law.fields if f.unit not in ("", "1")}
    more = "" if unknown else f"; known are {', '.join(k + units.get(k, '') for k in known)}"
    faults = [f"parameter {k!r} is missing{more}" for k in needed if k not in given]
    if unknown:
        faults.append(f"unknown parameter {', '.join(unknown)}; known are {', '.join(known)}")
    for key, kind in known.items():
        if key in given and key not in wrong:
            faults += _fault(key, kind, given[key])
    faults += wrong.values()
    if faults:
        raise InvalidParameter("\n".join(f"law {law.name!r}: {f}" for f in faults))
    values = {key: _value(known[key], given[key]) for key in given}
    if "envelope" in optional and "envelope" not in values:
        closing = values.pop("closing_compression", None)
        values["envelope"] = core_envelope(values.pop("loading"), values.pop("unloading"), closing)
    return values


def _in_si(law: LawInfo, given: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Texts with a unit as numbers in SI units, and the faults of the others by key."""
    faults = {name: f"{name}: {text}" for name, text in power_faults(law, given)}
    units = {f.name: f.unit for f in law.fields if f.kind == "number"}
    out = dict(given)
    for name, unit in units.items():
        if not isinstance(given.get(name), str):
            continue
        try:
            power = unit == "N/m^p"
            out[name] = power_stiffness(given[name]) if power else parse_scalar(given[name], unit)
        except ValueError as error:
            faults[name] = f"{name}: {error}"
    return out, faults


def _keys(law: LawInfo, given: dict[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
    """Required keys of a law, and all permitted keys with their types."""
    needed: dict[str, str] = {}
    optional: dict[str, str] = {}
    for field in law.fields:
        if field.kind != "envelope":
            (needed if field.required else optional)[field.name] = field.kind
            continue
        optional["envelope"] = "envelope"
        if "envelope" not in given:
            needed |= {"loading": "curve", "unloading": "curve"}
            optional["closing_compression"] = "number"
    return needed, optional


def _fault(key: str, kind: str, value: Any) -> list[str]:
    """Fault in the type of a value, as text; the core checks its range."""
    if kind == "curve":
        good = _numbers(value) and len(value) == 3
        expected = "(a [N/m], b [1/m], c [N/m]) of eq. 4.21"
    elif kind == "envelope":
        good = isinstance(value, (list, tuple)) and len(value) == 3
        good = good and all(map(_numbers, value)) and len(set(map(len, value))) == 1
        expected = "compression [m], loading [N] and unloading [N], arrays of one length"
    elif kind == "text":
        good, expected = isinstance(value, str), "a text"
    elif kind == "parameters":
        good = isinstance(value, Mapping) and all(map(_is_number, value.values()))
        good, expected = good and all(isinstance(k, str) for k in value), "numbers by name"
    elif kind == "list":
        good, expected = _numbers(value), "a list of numbers"
    elif kind == "function":
        good = _address(value) > 0
        expected = "a compiled function: of numba.cfunc, a ctypes function, or its address"
    else:
        good, expected = _is_number(value), "a number"
    return [] if good else [f"{key} = {shown(value)}, expected {expected}"]


def _value(kind: str, value: Any) -> Any:
    if kind == "curve":
        return _core.ExponentialCurve(*map(float, value))
    if kind == "envelope":
        return _core.Envelope.from_table(*([float(v) for v in column] for column in value))
    if kind == "text":
        return value
    if kind == "parameters":
        return {key: float(number) for key, number in value.items()}
    if kind == "list":
        return [float(number) for number in value]
    if kind == "function":
        _FUNCTIONS[_address(value)] = value
        return _address(value)
    return float(value)


#: Type of every function of ctypes.
_C_FUNCTION: Any = ctypes.CFUNCTYPE(None).__mro__[1]

#: Compiled functions of laws; they are kept, because a mechanism may live longer than its Python
#: objects.
_FUNCTIONS: dict[int, Any] = {}


def _address(function: Any) -> int:
    """Address of a compiled function; 0: not a compiled function."""
    address = getattr(function, "address", function)
    if isinstance(address, _C_FUNCTION):
        address = ctypes.cast(address, ctypes.c_void_p).value
    whole = isinstance(address, (int, np.integer)) and not isinstance(address, bool)
    return int(address) if whole else 0


def _is_number(value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.number)):
        return False
    return not isinstance(value, int) or abs(value) <= sys.float_info.max


def _numbers(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 1 and value.dtype.kind in "fiu"
    return isinstance(value, (list, tuple)) and all(map(_is_number, value))
