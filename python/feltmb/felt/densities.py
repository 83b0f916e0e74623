"""Density, area weight, porosity and fineness of a felt, and its volume fraction and diameter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

#: Density of wool [kg/m^3] (W. E. Morton, J. W. S. Hearle, Physical Properties of Textile Fibres).
WOOL = 1310.0


@checked
def bulk(
    *,
    v_f: float | None = None,
    density: float | None = None,
    porosity: float | None = None,
    area_weight: float | None = None,
    thickness: float | None = None,
    diameter: float | None = None,
    fineness: float | None = None,
    fiber_density: float = WOOL,
) -> dict[str, float]:
    """All numbers of a felt without load from those that are known, by the names of the parameters.

    Parameters
    ----------
    v_f, density, porosity, area_weight
        Exactly one of: volume fraction [1], density [kg/m^3], share of the volume without fibers
        [1], mass per area [kg/m^2] (with ``thickness``).
    thickness
        Thickness [m].
    diameter, fineness
        Diameter [m] or mass per length [kg/m] of the fibers, or neither; 1 dtex is 1e-7 kg/m.
    fiber_density
        Density of the fibers [kg/m^3]; default: wool.

    Raises
    ------
    InvalidParameter
        The numbers do not belong together; all faults are in the message.

    Examples
    --------
    A felt of 3.4 mm with 1 kg/m^2, of wool:

    >>> from feltmb import felt
    >>> felt_ = felt.bulk(area_weight=1.0, thickness=3.4e-3)
    >>> round(felt_["density"], 1), round(felt_["porosity"], 3)
    (294.1, 0.775)
    """
    given = {
        **{"v_f": v_f, "density": density, "porosity": porosity, "area_weight": area_weight},
        **{"thickness": thickness, "diameter": diameter, "fineness": fineness},
        "fiber_density": fiber_density,
    }
    known = {name: value for name, value in given.items() if value is not None}
    if faults := [*_faults(known)]:
        raise InvalidParameter("\n".join(f"bulk: {fault}" for fault in faults))
    if "area_weight" in known:
        known["density"] = known["area_weight"] / known["thickness"]
    if "density" in known:
        known["v_f"] = known["density"] / fiber_density
    share = known.setdefault("v_f", 1.0 - known.get("porosity", 0.0))
    if not 0.0 < share < 1.0:
        raise InvalidParameter(
            f"bulk: the fibers would fill {100 * share:.4g} % of the volume, expected more than 0 "
            f"and less than 100 % (fibers of {fiber_density:g} kg/m^3)"
        )
    known |= {"density": share * fiber_density, "porosity": 1.0 - share}
    if "thickness" in known:
        known["area_weight"] = known["density"] * known["thickness"]
    if "fineness" in known:
        known["diameter"] = math.sqrt(4.0 * known["fineness"] / (math.pi * fiber_density))
    elif "diameter" in known:
        known["fineness"] = 0.25 * math.pi * known["diameter"] ** 2 * fiber_density
    return {name: known[name] for name in given if name in known}


def _faults(known: Mapping[str, float]) -> Iterator[str]:
    """Why the given numbers do not belong together."""
    for name, value in known.items():
        if not (math.isfinite(value) and value > 0.0):
            yield f"{name} = {value:g}, must be finite and > 0"
    one = [name for name in ("v_f", "density", "porosity", "area_weight") if name in known]
    if len(one) != 1:
        got = ", ".join(one) or "none"
        yield f"got {got}, expected one of v_f, density, porosity, area_weight"
    if "area_weight" in known and "thickness" not in known:
        yield "area_weight without thickness"
    if "diameter" in known and "fineness" in known:
        yield "diameter and fineness, expected one of them"
