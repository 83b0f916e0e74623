"""Contact laws on their own: force from any compression history, for use outside a mechanism.

``law(name, **parameters)`` makes a law by the name that mechanism files use. A law knows
compression, rate and its own history, and nothing of bodies.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb import _core
from feltmb.arguments import checked
from feltmb.errors import InvalidParameter, shown

if TYPE_CHECKING:
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

__all__ = ["Law", "law"]


@checked
class Law:
    """A contact law and its memory.

    Signs: compression [m] positive when touching, rate = d compression / dt [m/s], force [N]
    positive pushing apart.
    """

    def __init__(self, core: _core.ContactLaw, name: str | None = None):
        self.core = core
        self._name = name or str(core.name)
        self._path = _core.LawPath(core)

    def __repr__(self) -> str:
        return f"Law({self.name!r})"

    @property
    def name(self) -> str:
        """Name as in a mechanism file."""
        return self._name

    @property
    def state(self) -> tuple[float, tuple[float, ...]]:
        """Largest compression remembered [m], and the law's own states."""
        return self._path.largest, tuple(self._path.state[: self.core.n_states])

    def force(
        self,
        compression: npt.ArrayLike,
        rate: npt.ArrayLike = 0.0,
        state: tuple[float, tuple[float, ...]] | None = None,
    ) -> Array:
        """Force [N] at compressions [m] and rates [m/s], the memory as given (default: virgin)."""
        largest, own = state if state is not None else (0.0, ())
        out: Array = np.asarray(
            self.core.force(
                np.asarray(compression, dtype=float),
                np.asarray(rate, dtype=float),
                list(own) + [0.0] * (self.core.n_states - len(own)),
                largest,
            )
        )
        return out

    def step(self, compression: float, duration: float) -> float:
        """Move to ``compression`` [m] within ``duration`` [s] and return the force [N] there.

        The law remembers; ``reset`` makes the felt virgin again.
        """
        if not (duration > 0.0 and np.isfinite(compression)):
            raise InvalidParameter(
                f"step: got compression {compression!r} m, duration {duration!r} s; expected a "
                "finite number and a time > 0"
            )
        return float(self._path.step(compression, duration))

    def peek(self, compression: float, duration: float) -> float:
        """Force [N] that ``step`` would return, without taking the step."""
        return float(self._path.peek(compression, duration))

    def reset(self) -> None:
        """Forget everything."""
        self._path.reset()

    def path(self, compression: npt.ArrayLike, time: npt.ArrayLike) -> Array:
        """Force [N] along a compression history [m] at times [s], beginning with virgin felt.

        Linear between samples. ``felt_memory`` without options is advanced exactly: its force
        depends on the sequence of compressions alone.
        """
        e = np.asarray(compression, dtype=float).ravel()
        t = np.asarray(time, dtype=float).ravel()
        out: Array = _core.force_along(self.core, t.tolist(), e.tolist())
        return out


#: Numbers of the law with memory, whatever its envelope.
_MEMORY = (
    "kappa",
    "wiping_out",
    "recovery_time",
    "creep_stiffness",
    "creep_damping",
    "rate_amplitude",
    "rate_time",
)
_WIDTH = ("hysteresis", "rate_amplitude", "rate_time")
_CURVES = ("loading", "unloading")
#: What the laws cannot do without, and what they may be given.
_NEEDED: dict[str, tuple[str, ...]] = {
    "guarded": _CURVES,
    "printed": _CURVES,
    "mean": _CURVES,
    "hunt_crossley": ("stiffness",),
    "stulov": ("stiffness", "exponent", "amplitude", "time"),
    "felt_memory": _CURVES,
}
_OPTIONAL: dict[str, tuple[str, ...]] = {
    "guarded": ("alpha", *_WIDTH),
    "printed": ("alpha", *_WIDTH),
    "mean": (),
    "hunt_crossley": ("exponent", "damping"),
    "stulov": (),
    "felt_memory": ("envelope", "closing_compression", *_MEMORY),
}


@checked
def law(name: str, **parameters: Any) -> Law:
    """Make a contact law.

    Parameters
    ----------
    name
        ``"guarded"``, ``"printed"``, ``"mean"``: ``loading=(a, b, c), unloading=(a, b, c)`` of
        thesis eq. 4.21, the first two with ``alpha`` [s/m], ``hysteresis`` (width of the loop),
        ``rate_amplitude`` and ``rate_time`` [s]; ``"hunt_crossley"``: ``stiffness,
        exponent, damping``; ``"stulov"``: ``stiffness, exponent, amplitude, time``;
        ``"felt_memory"``: curves as above, or ``envelope=(compression, loading, unloading)``
        arrays [m, N, N], with ``kappa``, ``wiping_out`` and the options ``closing_compression,
        recovery_time, creep_stiffness, creep_damping, rate_amplitude, rate_time``;
        ``"micromechanical"``: ``felt`` (name, file or :class:`feltmb.felt.FeltMaterial`),
        ``thickness`` [m], ``area`` (such as :class:`feltmb.felt.CrossedCylinders`, or a table as
        in a mechanism file), ``compression`` (``"even"`` or ``"columns"``), and the same options.

    Raises
    ------
    InvalidParameter
        The name is unknown, or parameters are missing, unknown, of the wrong kind or out of range:
        all of the same sort in one message.
    """
    if name == "micromechanical":
        from feltmb.contact.layer import layer_parameters

        layer = layer_parameters(**parameters)
        options = {key: getattr(layer, key) for key in _MEMORY}
        return Law(_core.ContactLaw(_core.FeltMemory(envelope=layer.envelope, **options)), name)
    if name not in _NEEDED:
        raise InvalidParameter(
            f"law {name!r} is unknown; known are {', '.join(_NEEDED)}, micromechanical"
        )
    given = _Given(name, parameters)
    core: Any
    if name == "mean":
        core = _core.MeanCurve(**given.curves())
    elif name in ("guarded", "printed"):
        options = given.numbers("alpha", *_WIDTH)
        core = _core.ExponentialPair(
            **given.curves(), **{"alpha": 100.0, **options}, guarded=name == "guarded"
        )
    elif name == "hunt_crossley":
        options = given.numbers("stiffness", "exponent", "damping")
        core = _core.HuntCrossley(**{"exponent": 1.5, "damping": 0.0, **options})
    elif name == "stulov":
        core = _core.Stulov(**given.numbers("stiffness", "exponent", "amplitude", "time"))
    else:
        options = given.numbers(*_MEMORY)
        core = _core.FeltMemory(envelope=given.envelope(), **options)
    return Law(_core.ContactLaw(core), name)


class _Given:
    """Parameters of a law as they were given; all that is wrong with them is told at once."""

    def __init__(self, name: str, parameters: dict[str, Any]):
        needed, optional = _NEEDED[name], _OPTIONAL[name]
        if "envelope" in parameters and "envelope" in optional:
            needed, optional = (), tuple(k for k in optional if k != "closing_compression")
        faults = [f"parameter {k!r} is missing" for k in needed if k not in parameters]
        unknown = sorted(set(parameters) - {*needed, *optional})
        if unknown:
            known = ", ".join((*needed, *optional))
            faults.append(f"unknown parameter {', '.join(unknown)}; known are {known}")
        for key in (*needed, *optional):
            if key in parameters:
                faults += self._fault(key, parameters[key])
        if faults:
            raise InvalidParameter("\n".join(f"law {name!r}: {f}" for f in faults))
        self.values = parameters

    @staticmethod
    def _fault(key: str, value: Any) -> list[str]:
        """What is wrong with the kind of a value; its range is the core's to check."""
        if key in ("loading", "unloading"):
            good = _numbers(value) and len(value) == 3
            expected = "(a [N/m], b [1/m], c [N/m]) of eq. 4.21"
        elif key == "envelope":
            good = isinstance(value, (list, tuple)) and len(value) == 3
            good = good and all(map(_numbers, value)) and len(set(map(len, value))) == 1
            expected = "compression [m], loading [N] and unloading [N], arrays of one length"
        else:
            good, expected = _is_number(value), "a number"
        return [] if good else [f"{key} = {shown(value)}, expected {expected}"]

    def numbers(self, *keys: str) -> dict[str, Any]:
        return {key: float(self.values[key]) for key in keys if key in self.values}

    def curves(self) -> dict[str, Any]:
        return {
            key: _core.ExponentialCurve(*map(float, self.values[key]))
            for key in ("loading", "unloading")
        }

    def envelope(self) -> _core.Envelope:
        if "envelope" in self.values:
            return _core.Envelope.from_table(
                *([float(v) for v in column] for column in self.values["envelope"])
            )
        closing = float(self.values.get("closing_compression", 0.0))
        curves = self.curves()
        return _core.Envelope.from_curves(curves["loading"], curves["unloading"], closing)


def _is_number(value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.number)):
        return False
    return not isinstance(value, int) or abs(value) <= sys.float_info.max


def _numbers(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 1 and value.dtype.kind in "fiu"
    return isinstance(value, (list, tuple)) and all(map(_is_number, value))
