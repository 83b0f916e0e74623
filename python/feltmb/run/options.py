"""Options of a simulation: known names, and values that make sense, checked in one place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from feltmb.errors import InvalidParameter
from feltmb.units.quantity import shortened

__all__ = ["OPTIONS", "check_options"]

#: Options of ``feltmb.simulate`` that a sweep and a study take.
OPTIONS = (
    "duration",
    "rtol",
    "output_rate",
    "ledger",
    "events",
    "max_wall",
    "max_step",
    "max_order",
    "ledger_limit",
    "method",
)
#: Limits that are either a number above zero or absent, by unit.
_LIMITS = {"max_wall": "s", "max_step": "s"}


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
