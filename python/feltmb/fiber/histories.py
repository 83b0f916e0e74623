"""Laws with memory from the literature, for comparison with felt."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from feltmb.fiber.laws import law, models
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]


def history_models() -> dict[str, Any]:
    """Describe every law with history: name -> title, source, validity, parameters."""
    return {d.name: d for d in _core.history_descriptions()}


@checked
def history(
    model: str,
    time: ArrayLike,
    compression: ArrayLike,
    /,
    *,
    rate: ArrayLike | None = None,
    spring: str = "van_wyk",
    **params: ArrayLike,
) -> Array:
    """Stress or force of a law with history along a path of compression.

    Parameters
    ----------
    model
        ``"dunlop"``, ``"stamm_kelvin"``, ``"maxwell"`` (compression is engineering strain, result a
        stress [Pa]); ``"stulov"``, ``"stulov_differential"``, ``"hunt_crossley"``,
        ``"lankarani_nikravesh"`` (compression [m], result a force [N]). Or the name of any
        compression law: then the result is its pressure, which has no memory.
    time
        Times [s], strictly increasing.
    compression
        Compression, of the same length as ``time``; positive in compression.
    rate
        Time derivative of the compression; default: ``numpy.gradient``.
    spring
        Compression law of the springs of ``dunlop`` and ``stamm_kelvin``.
    params
        Parameters of the model, numbers or lists (one value per unit), and of the spring. ``time``
        is one of ``stulov``, so that the path is given by position.

    Returns
    -------
    ndarray
        Stress [Pa] or force [N], never negative.
    """
    t = np.asarray(time, dtype=float)
    x = np.asarray(compression, dtype=float)
    if t.ndim != 1 or t.shape != x.shape or len(t) < 2:
        raise InvalidParameter(
            f"history law: time has shape {t.shape}, compression {x.shape}, expected two equal "
            "one-dimensional arrays of at least 2 samples"
        )
    known = history_models()
    if model in models() and model not in known:
        numbers = {k: float(np.asarray(v)) for k, v in params.items()}
        plain = law(model, **numbers)
        stress: Array = plain.pressure(plain.v_f0 / (1.0 - np.maximum(x, 0.0)))
        return stress
    own = {p.name for p in known[model].parameters} if model in known else set()
    lists = {k: np.atleast_1d(np.asarray(v, dtype=float)).tolist() for k, v in params.items()}
    made: Any = None
    if model in ("dunlop", "stamm_kelvin"):
        made = law(spring, **{k: v[0] for k, v in lists.items() if k not in own})
        lists = {k: v for k, v in lists.items() if k in own}
    speed = np.gradient(x, t) if rate is None else np.asarray(rate, dtype=float)
    result: Array = _core.run_history(model, lists, made, t, x, speed)
    return result
