"""The list of work that makes a keyboard even: hammers, support springs, lead, friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.keyboard.balance import Balance, standard_curves
from feltmb.keyboard.keys import Keyboard
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, near_names

if TYPE_CHECKING:
    import pandas as pd

#: Wanted values: one number, numbers of some keys, or the name of a level.
Curve = Mapping[int, float] | str | float

#: Where lead is added, and where the key is pressed, from the balance pin [m]: `grand_action`.
LEAD_AT, FRONT = 0.140, 0.225
#: Least and largest distance of a lead from the balance pin [m].
NEAR, FAR = 0.040, 0.200
#: Least change that is worth the work [g].
HAMMER, SPRING, BALANCE = 0.2, 2.0, 1.0
#: Least and largest values that a target may have [g].
LIMITS = {"target": (10.0, 100.0), "hammers": (2.0, 20.0), "fronts": (-60.0, 80.0)}


@checked
def list_of_work(
    balance: Balance,
    *,
    target: Curve | None = None,
    hammers: Curve | None = None,
    fronts: Curve | None = None,
    leads: Sequence[float] = (),
    lead_at: float = LEAD_AT,
    front: float = FRONT,
) -> pd.DataFrame:
    """List what makes the keyboard even, key by key, in the order of the work.

    Hammers go to the smooth curve of the strike weights or to ``hammers``, support springs to that
    of their lift, then lead brings the balance as played to its smooth curve or to ``target``, or
    the front weight to ``fronts``.

    A curve is one number for all keys, or numbers of some keys with lines between them (keys beyond
    the first and the last have its number), or the name of a level of D. Stanwood's charts:
    strike weights ``1`` to ``13``, front weights ``5`` to ``9``.

    Parameters
    ----------
    balance
        Weights that were analyzed.
    target
        Wanted balance as played [g]; default: its smooth curve.
    hammers
        Wanted strike weight [g]; default: its smooth curve.
    fronts
        Wanted front weight [g], in place of a balance.
    leads
        Masses of the leads at hand [g]: the heaviest one that comes to lie 40 to 200 mm from the
        balance pin is taken, because the key turns easier with lead near the pin. None: lead of any
        mass is added at ``lead_at``.
    lead_at
        Distance of the lead from the balance pin [m].
    front
        Distance of the point where a natural is pressed and weighed [m]; that of a sharp is shorter
        by the factor of the levers.

    Returns
    -------
    DataFrame
        Columns ``key``, ``note``, ``part``, ``change`` [g] (of friction, of the strike weight, of
        the lift of the spring, or the mass of a lead, negative: taken out), ``count`` of the leads,
        ``place`` [m] in front of the balance pin (of a lead; behind it: negative) and ``work``, a
        sentence.
    """
    import pandas as pd

    if not 0.0 < lead_at <= 1.1 * front:
        raise InvalidParameter(
            f"lead_at: got {lead_at:g} m, expected a place on the key, above 0 and at most "
            f"{1.1 * front:g} m from the balance pin"
        )
    if any(not 0.5 <= mass <= 50.0 for mass in leads):
        raise InvalidParameter(f"leads: got {list(leads)} g, expected masses of 0.5 to 50 g")
    if target is not None and fronts is not None:
        raise InvalidParameter("got target and fronts; lead reaches one of them")
    frame, weighed = balance.frame, balance.keyboard.frame
    rough = {o.key for o in balance.outliers if o.what == "friction"}
    wanted = frame["played_curve"] if target is None else _curve(target, "target", frame)
    strike = frame["strike_curve"] if hammers is None else _curve(hammers, "hammers", frame)
    level = None if fronts is None else _curve(fronts, "fronts", frame)
    rows: list[dict[str, Any]] = []

    def add(key: int, part: str, change: float, work: str, **more: float) -> None:
        rows.append(
            {"key": key, "note": frame.at[key, "note"], "part": part, "change": change,
             "work": work, **more}
        )  # fmt: skip

    for key, row in frame.iterrows():
        if key in rough:
            over = row["friction"] - row["friction_curve"]
            add(key, "friction", -over, f"ease, {over:.1f} gf less friction")
        played = float(row["played"])
        hammer = float(strike[key] - weighed.at[key, "strike_weight"])
        if abs(hammer) >= HAMMER:
            done = "file off" if hammer < 0 else "add"
            add(key, "hammer", hammer, f"{done} {abs(hammer):.1f} g")
            played += float(row["ratio_curve"]) * hammer
        spring = float(row["spring_curve"] - row["spring"])
        if abs(spring) >= SPRING:
            done = "stronger" if spring > 0 else "weaker"
            add(key, "spring", spring, f"{done} by {abs(spring):.0f} gf at the key")
            played -= spring
        excess = played - float(wanted[key])
        if level is not None:
            excess = float(level[key] - weighed.at[key, "front_weight"])
        if abs(excess) >= BALANCE:
            lever = balance.sharp_factor if row["sharp"] else 1.0
            mass, count, place = _lead(excess * front / lever, leads, lead_at)
            add(key, "lead", mass, _lead_work(mass, count, place), count=count, place=place)
    columns = ["key", "note", "part", "change", "count", "place", "work"]
    made = pd.DataFrame(rows, columns=columns)
    return made.astype({"key": int, "change": float, "count": float, "place": float})


def _curve(given: Curve, name: str, frame: pd.DataFrame) -> pd.Series[float]:
    """One value a key [g] of a number, of points, or of a level of D. Stanwood."""
    import pandas as pd

    keys = frame.index.to_numpy(float)
    if isinstance(given, str):
        what = {"hammers": "strike_weight", "fronts": "front_weight"}.get(name, "")
        levels = standard_curves(what, keys) if what else {}
        if given not in levels:
            raise InvalidParameter(
                f"{name}: got {given!r}, expected a number, points or one of "
                f"{', '.join(levels) or 'none'}{near_names(given, levels)}"
            )
        return pd.Series(levels[given], frame.index)
    points = dict(given) if isinstance(given, Mapping) else {1: float(given)}
    low, high = LIMITS[name]
    for key, value in points.items():
        if not low <= value <= high or not 1 <= key <= len(frame):
            raise InvalidParameter(
                f"{name}: got {value:g} g at key {key}, expected {low:g} to {high:g} g at keys 1 "
                f"to {len(frame)}"
            )
    order = sorted(points)
    if not order:
        raise InvalidParameter(f"{name}: got no points, expected one at least")
    return pd.Series(np.interp(keys, order, [points[k] for k in order]), frame.index)


def _lead(moment: float, leads: Sequence[float], lead_at: float) -> tuple[float, int, float]:
    """Mass of a lead [g], their number, their place [m] in front of the pin; moment in g m."""
    if not leads:
        return moment / lead_at, 1, lead_at
    for count in range(1, 100):
        for mass in sorted(leads, reverse=True):
            place = moment / (count * mass)
            if NEAR <= abs(place) <= FAR:
                return mass, count, place
        if count * min(leads) * NEAR > abs(moment):
            break
    # The lightest lead is too heavy even beside the pin: it lies nearer.
    return min(leads), 1, moment / min(leads)


def _lead_work(mass: float, count: int, place: float) -> str:
    where = f"{1e3 * abs(place):.0f} mm"
    if mass < 0:
        return f"take out {-mass:.1f} g of lead at {where}, or add it there behind the pin"
    some = f"{mass:.1f} g of lead" if count == 1 else f"{count} leads of {mass:.1f} g"
    return f"add {some} at {where} {'in front of' if place > 0 else 'behind'} the balance pin"


@checked
def after_work(balance: Balance, work: pd.DataFrame, *, front: float = FRONT) -> Keyboard:
    """Keyboard after the work of a list, by the balance of weights.

    Parameters
    ----------
    balance
        Weights that were analyzed.
    work
        What :func:`list_of_work` returned.
    front
        Distance of the point where a natural is pressed and weighed [m].
    """
    frame = balance.keyboard.frame.copy()
    for row in work.itertuples():
        key, change = row.key, row.change
        if row.part == "friction":
            frame.loc[key, "down_weight"] += change
            frame.loc[key, "up_weight"] -= change
            frame.loc[key, "down_weight_with_spring"] += change
            continue
        lifted = 0.0
        if row.part == "hammer":
            frame.loc[key, "strike_weight"] += change
            lifted = change * balance.frame.at[key, "ratio_curve"]
        elif row.part == "lead":
            lever = balance.sharp_factor if balance.frame.at[key, "sharp"] else 1.0
            heavier = change * row.count * row.place * lever / front
            frame.loc[key, "front_weight"] += heavier
            lifted = -heavier
        else:
            frame.loc[key, "down_weight_with_spring"] -= change
        for name in ("down_weight", "up_weight", "down_weight_with_spring"):
            frame.loc[key, name] += lifted
    return replace(balance.keyboard, name=f"{balance.keyboard.name}, after the work", frame=frame)
