"""The list of work that makes a keyboard even: hammers, support springs, lead, friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feltmb.keyboard.balance import Balance
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    import pandas as pd

#: Where lead is added, and where the key is pressed, from the balance pin [m]: `grand_action`.
LEAD_AT, FRONT = 0.140, 0.225
#: Least change that is worth the work [g].
HAMMER, SPRING, BALANCE = 0.2, 2.0, 1.0


@checked
def list_of_work(
    balance: Balance,
    *,
    target: float | None = None,
    lead_at: float = LEAD_AT,
    front: float = FRONT,
) -> pd.DataFrame:
    """List what makes the keyboard even, key by key, in the order of the work.

    Hammers go to the smooth curve of the strike weights, support springs to that of their lift,
    then lead brings the balance as played to its smooth curve or to ``target``.

    Parameters
    ----------
    balance
        Weights that were analyzed.
    target
        Wanted balance as played [g]; default: its smooth curve.
    lead_at
        Distance of the lead from the balance pin [m].
    front
        Distance of the point where a natural is pressed and weighed [m]; that of a sharp is shorter
        by the factor of the levers.

    Returns
    -------
    DataFrame
        Columns ``key``, ``note``, ``part``, ``change`` [g] (of the strike weight, of the lift
        of the spring, of the lead) and ``work``, a sentence.
    """
    import pandas as pd

    if not 0.0 < lead_at <= 1.1 * front:
        raise InvalidParameter(
            f"lead_at: got {lead_at:g} m, expected a place on the key, above 0 and at most "
            f"{1.1 * front:g} m from the balance pin"
        )
    if target is not None and not 10.0 <= target <= 100.0:
        raise InvalidParameter(f"target: got {target:g} g, expected a balance of 10 to 100 g")
    frame, strike = balance.frame, balance.keyboard.frame["strike_weight"]
    rough = {o.key: o for o in balance.outliers if o.what == "friction"}
    wanted = frame["played_curve"] if target is None else pd.Series(target, frame.index)
    rows: list[tuple[int, str, str, float, str]] = []
    for key, row in frame.iterrows():
        note = str(row["note"])
        if key in rough:
            over = row["friction"] - row["friction_curve"]
            rows.append((key, note, "friction", -over, f"ease, {over:.1f} gf less friction"))
        played = float(row["played"])
        hammer = float(row["strike_curve"] - strike[key])
        if abs(hammer) >= HAMMER:
            done = "file off" if hammer < 0 else "add"
            rows.append((key, note, "hammer", hammer, f"{done} {abs(hammer):.1f} g"))
            played += float(row["ratio_curve"]) * hammer
        spring = float(row["spring_curve"] - row["spring"])
        if abs(spring) >= SPRING:
            done = "stronger" if spring > 0 else "weaker"
            rows.append((key, note, "spring", spring, f"{done} by {abs(spring):.0f} gf at the key"))
            played -= spring
        excess = played - float(wanted[key])
        if abs(excess) >= BALANCE:
            lever = balance.sharp_factor if row["sharp"] else 1.0
            lead = excess * front / lever / lead_at
            where = f"{1e3 * lead_at:.0f} mm"
            done = f"add {lead:.1f} g of lead at {where} in front of the balance pin"
            if lead < 0:
                done = f"take out {-lead:.1f} g of lead at {where}, or add it there behind the pin"
            rows.append((key, note, "lead", lead, done))
    made = pd.DataFrame(rows, columns=["key", "note", "part", "change", "work"])
    return made.astype({"key": int, "change": float})
