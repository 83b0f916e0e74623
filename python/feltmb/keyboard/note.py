"""The action of one key of a keyboard: the packaged action with the weights of that key."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feltmb.action.regulate import regulate
from feltmb.action.touch.static import StaticTouch, static_touch
from feltmb.action.touch.strikes import simulate_strike
from feltmb.action.touch.weights import weights
from feltmb.keyboard.balance import Balance
from feltmb.mechanism import Action, load_action
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter

if TYPE_CHECKING:
    import pandas as pd

GRAM = 9.80665e-3  # N, weight of one gram
#: Strike weight ratio and key ratio of `grand_action`: ratio ~ key ratio to this power.
POWER = 2.8
#: Ratio and weights are met within this share, and this many grams.
CLOSE, WITHIN = 0.01, 0.3
ROUNDS = 4
#: Keys whose touch is simulated; force of their press [N].
TEN_KEYS = (4, 13, 22, 31, 40, 49, 58, 67, 76, 85)
PRESS = 5.0


@dataclass(frozen=True, eq=False)
class KeyAction:
    """Action of one key, regulated, and what its slow press weighs.

    Attributes
    ----------
    action : Action
    key : int
    touch : StaticTouch
    wanted, reached : mapping
        Strike weight, balance and friction [g] and strike weight ratio [1] of the keyboard, and of
        the action.
    notes : tuple of str
        What could not be met, or was interpolated.
    """

    action: Action
    key: int
    touch: StaticTouch
    wanted: Mapping[str, float]
    reached: Mapping[str, float]
    notes: tuple[str, ...]

    def to_toml(self) -> str:
        """Text of a mechanism file."""
        lines = [
            f"Key {self.key} of a keyboard: {n} wanted {v:.2f}, reached {self.reached[n]:.2f}"
            for n, v in self.wanted.items()
        ]
        return "".join(f"# {x}\n" for x in (*lines, *self.notes)) + "\n" + self.action.to_toml()


@checked
def action_of_key(
    balance: Balance,
    key: int,
    action: Action | str = "grand_action",
    *,
    progress: Callable[[str], None] | None = None,
) -> KeyAction:
    """Set up the action of a key: hammer, key ratio, front weight and friction of the keyboard.

    Felts, lengths and screws are those of ``action``. It is regulated to the targets of its name,
    because a new hammer and a new ratio need it. Weights that were not measured are those of the
    smooth curves. A support spring is represented by the front weight that takes off as much.

    Parameters
    ----------
    balance
        Weights that were analyzed.
    key
        Number of the key, from 1.
    action
        Action whose geometry and felts are used; it must be of a kind that lies, such as a grand.
    progress
        Function that :func:`feltmb.regulate` calls.

    Raises
    ------
    InvalidParameter
        There is no such key, or its weights are not known.
    Error
        The action cannot be regulated with these weights.
    """
    base = load_action(action) if isinstance(action, str) else action
    wanted, notes = _wanted(balance, key)
    here = _measured(base)
    if here["share"] < 0.5:
        raise InvalidParameter(
            f"action {base.name!r}: its hammer hangs, so that a strike weight ratio does not "
            "describe it; expected an action whose shanks lie, such as grand_action"
        )
    ratio, power, reached = here["key ratio"], POWER, here
    for _ in range(ROUNDS):
        ratio *= (wanted["strike weight ratio"] / reached["strike weight ratio"]) ** (1.0 / power)
        words = {"strike_weight": f"{wanted['strike weight']!r} g", "key_ratio": ratio}
        done = regulate(base.with_values(words), progress=progress)
        if not done.converged:
            steps = ", ".join(f"{row.name} ({row.why})" for row in done.unmet)
            raise Error(
                f"key {key}: {base.name!r} with a strike weight of {wanted['strike weight']:.2f} "
                f"g and a key ratio of {ratio:.3f} cannot be regulated: {steps}"
            )
        former, reached = reached, _measured(done.action)
        if abs(reached["strike weight ratio"] / wanted["strike weight ratio"] - 1.0) < CLOSE:
            break
        step = math.log(reached["key ratio"] / former["key ratio"])
        rise = math.log(reached["strike weight ratio"] / former["strike weight ratio"])
        power = rise / step if step and 1.0 < rise / step < 6.0 else POWER
    else:
        notes.append(f"the strike weight ratio is {reached['strike weight ratio']:.2f}")
    made = _weighed(done.action, wanted, reached)
    touch = static_touch(made)
    reached = _measured(made, touch)
    return KeyAction(
        made, key, touch, wanted, {name: reached[name] for name in wanted}, tuple(notes)
    )


@checked
def touch_of_keys(
    balance: Balance,
    keys: Sequence[int] = TEN_KEYS,
    action: Action | str = "grand_action",
    *,
    progress: Callable[[str], None] | None = None,
) -> pd.DataFrame:
    """How some keys feel: the action of each key, pressed slowly, and pressed with 5 N.

    Parameters
    ----------
    balance
        Weights that were analyzed, such as those after the work.
    keys
        Numbers of the keys, from 1.
    action
        Action whose geometry and felts are used.
    progress
        Function that is called with what is done.

    Returns
    -------
    DataFrame
        One row a key: ``note``, ``down_weight``, ``up_weight`` and ``let_off_force`` [gf], and
        ``hammer_speed`` [m/s], the speed at the string after a press with a force of 5 N that rises
        in 20 ms; NaN: the hammer does not reach the string.
    """
    import pandas as pd

    rows = {}
    for key in dict.fromkeys(keys):
        if progress is not None:
            progress(f"key {key}")
        made = action_of_key(balance, key, action)
        felt = made.touch
        speed = simulate_strike(made.action, "pressed", PRESS, felt.end).hammer_speed
        rows[key] = {
            "note": balance.frame.at[key, "note"],
            "down_weight": felt.down_weight / GRAM,
            "up_weight": felt.up_weight / GRAM,
            "let_off_force": felt.let_off_force / GRAM,
            "hammer_speed": math.nan if speed is None else speed,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("key")


def _wanted(balance: Balance, key: int) -> tuple[dict[str, float], list[str]]:
    frame = balance.frame
    if key not in frame.index:
        raise InvalidParameter(f"key: got {key}, expected 1 to {len(frame)}")
    row, notes, wanted = frame.loc[key], [], {}
    strike = balance.keyboard.frame["strike_weight"]
    for name, value, curve in (
        ("strike weight", strike[key], row["strike_curve"]),
        ("strike weight ratio", row["ratio"], row["ratio_curve"]),
        ("balance", row["played"], row["played_curve"]),
        ("friction", row["friction"], row["friction_curve"]),
    ):
        wanted[name] = float(curve if math.isnan(value) else value)
        if math.isnan(wanted[name]):
            raise InvalidParameter(
                f"key {key}: the {name} is not known; expected front and strike weights"
            )
        if math.isnan(value):
            notes.append(f"{name}: not measured, that of the smooth curve")
    return wanted, notes


def _measured(action: Action, touch: StaticTouch | None = None) -> dict[str, float]:
    """Numbers of an action as a keyboard has them, weights in g."""
    static = static_touch(action) if touch is None else touch
    found = weights(action, static)
    if found is None:
        raise InvalidParameter(f"action {action.name!r}: its file does not say what is weighed")
    return {
        "strike weight": 1e3 * found.strike_weight,
        "strike weight ratio": found.hammer_share * found.action_ratio,
        "key ratio": found.key_ratio,
        "share": found.hammer_share,
        "balance": static.balance_weight / GRAM,
        "friction": static.friction / GRAM,
    }


def _weighed(action: Action, wanted: Mapping[str, float], here: Mapping[str, float]) -> Action:
    """The action with friction of its joints and front weight of its key as wanted."""
    finger = action.config.finger
    assert finger is not None
    for _ in range(ROUNDS):
        more = wanted["friction"] / here["friction"]
        lighter = (here["balance"] - wanted["balance"]) * 1e-3  # kg at the finger
        body = action.config.bodies[finger.body]
        x = body.center_of_mass[0] + lighter * finger.point[0] / body.mass
        changes: dict[str, Any] = {f"bodies.{finger.body}.center_of_mass.x": f"{1e3 * x!r} mm"}
        for name, each in action.config.bodies.items():
            if each.friction is not None and each.friction.amplitude:
                changes[f"bodies.{name}.friction.amplitude *="] = more
        action = action.with_values(changes)
        here = _measured(action)
        off = max(abs(here[n] - wanted[n]) for n in ("friction", "balance"))
        if off < WITHIN:
            break
    return action
