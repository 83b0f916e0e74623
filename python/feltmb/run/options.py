"""Options of a simulation, shared by ``simulate``, ``simulate_many`` and sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened


@checked
@dataclass(frozen=True)
class RunOptions:
    """Options of a simulation.

    ``feltmb.simulate(action, stroke, rtol=1e-8)`` is short for ``feltmb.simulate(action, stroke,
    options=RunOptions(rtol=1e-8))``. Batches and sweeps have the same options. Their ledger is off
    by default.

    Attributes
    ----------
    duration : float or None
        Simulated time [s]; default: the stroke's own.
    rtol : float
        Relative tolerance of the integrator, 1e-13 to 1e-2. The absolute tolerance of each state
        follows from it: rtol times 0.2 mm and 0.2 m/s at the contacts.
    method : str
        "cvode": CVODES integrates all states; "modal": the vibration of a free string is computed
        exactly and separately; "auto": modal for a string with modes. CVODES (BDF) includes the
        modes of the string. ``"modal"`` does not integrate a string without contact, for any
        frequencies and damping. The methods agree within their errors; ``run.stats["method"]`` is
        the method that was used.
    output_rate : float
        Sample rate of the outputs [Hz]. Events and the largest force of the impact are found with
        dense output and do not depend on it.
    ledger : bool
        Whether work and dissipation are integrated with the motion (``run.energy``).
    events : bool
        Whether contact openings and closings are found (``run.events``, and most of
        ``run.summary``).
    summary_only : bool
        Whether outputs are sampled only over the last 10 ms, which the summary needs. This is
        faster for comparisons of thousands of strokes. A run that stops early then has no samples.
    error : float or None
        Instead of ``rtol``: largest error of a contact force relative to its peak, for a strike of
        50 ms on a string. It is in (0, 0.1], and the tolerance of the method follows from it
        (``run.provenance["options"]``). The error limit holds for a hammer on a string. A whole
        action with bounces may have a larger error: compare with a tenth of the value.
    max_wall : float or None
        Limit of the wall time [s]; the simulated part is kept.
    max_step : float or None
        Largest step [s].
    max_order : int or None
        Largest order of the BDF, 1 to 5; default: chosen from the lightly damped modes of strings
        and members (docs/explanation/model.md, "Integrator").
    ledger_limit : float or None
        A run fails if the energy balance error exceeds this fraction of the exchanged energy;
        default: 0.1. The error is ``run.energy["residual_relative"]``. Without a ledger there is no
        limit. A large value, for example 1e9, also means no limit.
    """

    duration: float | None = None
    rtol: float = 1e-6
    method: str = "auto"
    output_rate: float = 10_000.0
    ledger: bool = True
    events: bool = True
    summary_only: bool = False
    error: float | None = None
    max_wall: float | None = None
    max_step: float | None = None
    max_order: int | None = None
    ledger_limit: float | None = None

    def __post_init__(self) -> None:
        check_options({name: getattr(self, name) for name in ("max_wall", "max_step", "max_order")})

    def changed(self) -> dict[str, Any]:
        """Names and values of the options that differ from the defaults."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {f.name: values[f.name] for f in fields(self) if values[f.name] != f.default}


ALL_OPTIONS = tuple(f.name for f in fields(RunOptions))
#: Options of a sweep.
OPTIONS = tuple(name for name in ALL_OPTIONS if name not in ("summary_only", "error"))
#: Optional limits that must be above zero, by unit.
_LIMITS = {"max_wall": "s", "max_step": "s"}


def options_given(options: RunOptions | Mapping[str, Any] | None) -> dict[str, Any]:
    """Options by name, without those that have their default."""
    return options.changed() if isinstance(options, RunOptions) else dict(options or {})


def check_options(options: Mapping[str, Any], *, known: tuple[str, ...] | None = None) -> None:
    """Reject invalid options.

    Parameters
    ----------
    options
        Values by name; None means the default.
    known
        Permitted names; default: any.

    Raises
    ------
    InvalidParameter
        A name is unknown, ``max_wall`` or ``max_step`` is not a finite number above zero, or
        ``max_order`` is not an integer of 1 to 5.
    """
    for name in options:
        if known is not None and name not in known:
            raise InvalidParameter(
                f"option {shortened(repr(name))} is unknown; there are {', '.join(known)}"
            )
    for name, unit in _LIMITS.items():
        value = options.get(name)
        if value is not None and not (_is_number(value) and 0.0 < float(value) < math.inf):
            got = f"{float(value):g}" if _is_number(value) else shortened(repr(value))
            raise InvalidParameter(
                f"{name} = {got} {unit}, must be a finite number > 0; leave it out for no limit"
            )
    order = options.get("max_order")
    if order is not None and not (_is_number(order) and float(order) in (1, 2, 3, 4, 5)):
        raise InvalidParameter(
            f"max_order = {shortened(repr(order))}, must be a whole number of 1 to 5; leave it out "
            "to have it chosen"
        )


def _is_number(value: Any) -> bool:
    if isinstance(value, (bool, str, bytes)):
        return False
    try:
        float(value)
    except (TypeError, ValueError, OverflowError):
        return False
    return True
