"""Options of a simulation, shared by ``simulate``, ``simulate_many``, sweeps and studies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.units.quantity import shortened

__all__ = ["ALL_OPTIONS", "OPTIONS", "RunOptions", "check_options", "options_given"]


@checked
@dataclass(frozen=True)
class RunOptions:
    """Options of a simulation.

    ``feltmb.simulate(action, stroke, rtol=1e-8)`` is short for ``feltmb.simulate(action, stroke,
    options=RunOptions(rtol=1e-8))``. Batches, sweeps and studies have the same options. Their
    ledger is off by default.

    Attributes
    ----------
    duration : float or None
        [s], > 0; default: the stroke's own.
    rtol : float
        Relative tolerance of the integrator, 1e-13 to 1e-2. Absolute tolerances follow from it,
        state by state: rtol times 0.2 mm and 0.2 m/s at the contacts.
    method : str
        ``"cvode"``: all states by CVODES (BDF), the modes of the string among them. ``"modal"``:
        a string that nothing touches leaves the integrator and vibrates exactly, whatever its
        frequencies and damping; needs a string with modes. ``"auto"``: modal where there is one.
        Both agree within their errors (``run.stats["method"]`` names the one used).
    output_rate : float
        Samples a second. Events and the largest string force are found on the dense output and do
        not depend on it.
    ledger : bool
        Integrate work and dissipation along with the motion (``run.energy``).
    events : bool
        Find contact openings and closings (``run.events``, and most of ``run.summary``).
    summary_only : bool
        Sample the outputs over the last 10 ms only, which the summary needs: quicker where
        thousands of strokes are compared by their numbers. A run that stops early then has no
        samples.
    error : float or None
        In place of ``rtol``: the largest error of a contact force over its peak that is asked for,
        in (0, 0.1], after one strike on a string of 50 ms; the method's tolerance follows from it
        (``run.provenance["options"]``). It is held for a hammer on a string; a whole action, which
        bounces, may need more: compare with a tenth of it.
    max_wall : float or None
        Stop after this many seconds of wall time.
    max_step : float or None
        Largest step [s].
    max_order : int or None
        Order limit of the BDF, 1 to 5; default: chosen by the lightly damped modes of strings and
        members (docs/explanation/model.md, "Integrator").
    ledger_limit : float or None
        Largest energy balance error as a fraction of the exchanged energy, above 0;
        default 0.1 (``run.energy["residual_relative"]``). Beyond it the run has failed. Without a
        ledger nothing is known, and nothing is limited. A large number, 1e9 say, is no limit.
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
#: Options that a sweep and a study take from a file.
OPTIONS = tuple(name for name in ALL_OPTIONS if name not in ("summary_only", "error"))
#: Limits that are either a number above zero or absent, by unit.
_LIMITS = {"max_wall": "s", "max_step": "s"}


def options_given(options: RunOptions | Mapping[str, Any] | None) -> dict[str, Any]:
    """Options by name, without those at their defaults."""
    return options.changed() if isinstance(options, RunOptions) else dict(options or {})


def check_options(options: Mapping[str, Any], *, known: tuple[str, ...] | None = None) -> None:
    """Refuse options that no simulation could have.

    Parameters
    ----------
    options
        Values by name; None stands for the default.
    known
        Names that may be given; default: any.

    Raises
    ------
    InvalidParameter
        A name is unknown; ``max_wall`` or ``max_step`` is no finite number above zero;
        ``max_order`` is no whole number of 1 to 5.
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
