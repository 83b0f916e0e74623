"""Contact laws on their own: force from any compression history, for use outside a mechanism.

``law(name, **parameters)`` makes a law by the name that mechanism files use. A law knows
compression, rate and its own history, and nothing of bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb import _core
from feltmb.errors import InvalidParameter

if TYPE_CHECKING:
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

__all__ = ["Law", "law"]


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


def _curve(name: str, value: Sequence[float]) -> _core.ExponentialCurve:
    if not isinstance(value, (list, tuple, np.ndarray)) or len(value) != 3:
        raise InvalidParameter(
            f"law: {name} = {value!r}, expected (a [N/m], b [1/m], c [N/m]) of eq. 4.21"
        )
    return _core.ExponentialCurve(*(float(v) for v in value))


#: Numbers of the law with memory, whatever its envelope.
_MEMORY = (
    "kappa",
    "recovery_time",
    "creep_stiffness",
    "creep_damping",
    "rate_amplitude",
    "rate_time",
)


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
        arrays [m, N, N], with ``kappa`` and the options ``closing_compression, recovery_time,
        creep_stiffness, creep_damping, rate_amplitude, rate_time``; ``"micromechanical"``:
        ``felt`` (name, file or :class:`feltmb.felt.FeltMaterial`), ``thickness`` [m], ``area``
        (such as :class:`feltmb.felt.CrossedCylinders`, or a table as in a mechanism file),
        ``compression`` (``"even"`` or ``"columns"``), and the same options.

    Raises
    ------
    InvalidParameter
        The name is unknown, a parameter is missing, unknown or out of range.
    """
    given = dict(parameters)

    def take(key: str, *default: Any) -> Any:
        if key in given:
            return given.pop(key)
        if default:
            return default[0]
        raise InvalidParameter(f"law {name!r}: parameter {key!r} is missing")

    core: Any
    if name in ("guarded", "printed", "mean"):
        curves: dict[str, Any] = {k: _curve(k, take(k)) for k in ("loading", "unloading")}
        if name == "mean":
            core = _core.MeanCurve(**curves)
        else:
            width: dict[str, Any] = {
                key: float(given.pop(key))
                for key in ("hysteresis", "rate_amplitude", "rate_time")
                if key in given
            }
            core = _core.ExponentialPair(
                **curves, alpha=float(take("alpha", 100.0)), guarded=name == "guarded", **width
            )
    elif name == "hunt_crossley":
        core = _core.HuntCrossley(
            stiffness=take("stiffness"),
            exponent=take("exponent", 1.5),
            damping=take("damping", 0.0),
        )
    elif name == "stulov":
        core = _core.Stulov(
            stiffness=take("stiffness"),
            exponent=take("exponent"),
            amplitude=take("amplitude"),
            time=take("time"),
        )
    elif name == "felt_memory":
        if "envelope" in given:
            compression, loading, unloading = take("envelope")
            envelope = _core.Envelope.from_table(
                [float(v) for v in compression],
                [float(v) for v in loading],
                [float(v) for v in unloading],
            )
        else:
            envelope = _core.Envelope.from_curves(
                _curve("loading", take("loading")),
                _curve("unloading", take("unloading")),
                float(take("closing_compression", 0.0)),
            )
        options = {key: float(given.pop(key)) for key in _MEMORY if key in given}
        core = _core.FeltMemory(envelope=envelope, **options)
    elif name == "micromechanical":
        from feltmb.layer import layer_parameters

        layer = layer_parameters(**given)
        given.clear()
        core = _core.FeltMemory(
            envelope=layer.envelope, **{key: getattr(layer, key) for key in _MEMORY}
        )
    else:
        raise InvalidParameter(
            f"law {name!r} is unknown; known are guarded, printed, mean, hunt_crossley, stulov, "
            "felt_memory, micromechanical"
        )
    if given:
        raise InvalidParameter(f"law {name!r}: unknown parameter {', '.join(sorted(given))}")
    return Law(_core.ContactLaw(core), name)
