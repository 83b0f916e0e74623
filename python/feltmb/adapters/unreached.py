"""Let-off and strike that no record of a diagnosis reaches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feltmb.adapters.simulator import Simulator
from feltmb.data import Record

__all__ = ["unreached"]

#: Smallest distance of two parts that certainly do not touch, whatever the tolerances [m].
CLEAR = 0.5e-3


def unreached(simulator: Simulator, records: Sequence[Record]) -> str:
    """Sentence about the let-off and the strike if the tabulated mechanism never reaches them.

    Empty if a record reaches them or comes near, and if a record cannot be simulated.

    Parameters
    ----------
    simulator
        Simulator of the tabulated mechanism.
    records
        All records, as far as they are compared.
    """
    config = simulator.action.config
    roles = config.reading
    toe = config.events.get(roles.touch.toe or "")
    contacts = {
        "let-off": toe.contact if toe is not None else None,
        "strike": roles.strike_contact,
    }
    numbers = {name: f"{n:02d}" for name, n in contacts.items() if isinstance(n, int)}
    nearest = dict.fromkeys(numbers, -np.inf)
    for record in records:
        result = simulator.run(record, simulator.base) if numbers else None
        if result is None:
            return ""
        data = np.asarray(result.data)
        for name, number in numbers.items():
            if f"contact{number}.compression" in result.names:
                own = data[:, list(result.names).index(f"contact{number}.compression")]
                nearest[name] = max(nearest[name], float(np.max(own)))
            else:
                nearest[name] = np.inf
        if min(nearest.values()) >= -CLEAR:
            return ""
    missing = {name: -e for name, e in nearest.items() if e < -CLEAR}
    if not missing:
        return ""
    apart = " and the ".join(
        f"{name} (contact {numbers[name]} stays {1e3 * gap:.2g} mm open)"
        for name, gap in missing.items()
    )
    return (
        f"no record reaches the {apart}, by the tabulated numbers: what acts from there on only, "
        "such as a part that is out of regulation, cannot be found in these records; add a stroke "
        "that goes further"
    )
