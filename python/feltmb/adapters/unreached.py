"""Let-off, strike and check that no record of a diagnosis reaches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feltmb.adapters.simulator import MechanismSimulator
from feltmb.data import Record

__all__ = ["unreached"]

#: Smallest distance of two parts that certainly do not touch, whatever the tolerances [m].
CLEAR = 0.5e-3


def unreached(simulator: MechanismSimulator, records: Sequence[Record]) -> str:
    """Sentence about the let-off, the strike and the check if no record reaches them.

    The tabulated mechanism is simulated. Empty if records reach all of them or come near, and if a
    record cannot be simulated.

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
    let_off = toe.contact if toe is not None else None
    contacts: dict[str, list[int]] = {
        "let-off": [let_off] if isinstance(let_off, int) else let_off or [],
        "strike": [roles.strike_contact] if roles.strike_contact is not None else [],
        "check": roles.check_contacts,
    }
    nearest = {name: (-np.inf, "") for name, numbers in contacts.items() if numbers}
    for record in records:
        result = simulator.run(record, simulator.base) if nearest else None
        if result is None:
            return ""
        data, names = np.asarray(result.data), list(result.names)
        for name in nearest:
            for number in (f"{n:02d}" for n in contacts[name]):
                column = f"contact{number}.compression"
                # A contact without a compression is not told.
                own = float(np.max(data[:, names.index(column)])) if column in names else np.inf
                nearest[name] = max(nearest[name], (own, number))
        if all(e >= -CLEAR for e, _ in nearest.values()):
            return ""
    apart = [
        f"the {name} (contact {number} stays {1e3 * -e:.2g} mm open)"
        for name, (e, number) in nearest.items()
        if e < -CLEAR
    ]
    if not apart:
        return ""
    held = " and is held there" if apart[-1].startswith("the check") else ""
    return (
        f"no record reaches {' and '.join(apart)}, by the tabulated numbers: what acts from there "
        "on only, such as a part that is out of regulation, cannot be found in these records; add "
        f"a stroke that goes further{held}"
    )
