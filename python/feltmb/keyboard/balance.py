"""Balance, friction and strike weight ratio of each key, their smooth curves, and outliers.

The balance of weights is that of D. Stanwood: (D + U) / 2 + F = K W + S R, with down, up, front,
whippen radius and strike weight D, U, F, W, S, the key ratio K and the strike weight ratio R.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb import params
from feltmb.keyboard.keys import COLUMNS, Keyboard, is_sharp, note_name
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import read_toml

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd

    Array = npt.NDArray[np.float64]

#: Key ratio and whippen radius weight [g] where the file has none: those of `grand_action`.
KEY_RATIO, WHIPPEN_WEIGHT = 0.5, 18.5
#: Distance from the curve, in robust standard deviations, from which a key stands out.
FAR = 3.5
#: The smallest distance that a technician acts on; down and up weights are read to 1 g.
MATTERS = {"friction": 2.0, "balance": 3.0, "strike_weight": 0.3, "spring": 3.0,
           "front_weight": 2.5}  # fmt: skip
#: Share of a deviation of the front weight by which the balance must be off, the other way, for a
#: lead to be wrong: a lead that balances a heavy hammer leaves the balance even.
UNBALANCED = 0.5
#: Penalties that are tried, by the weight of a value: from none to a straight line.
PENALTIES = np.logspace(-2.0, 8.0, 41)
#: Fewest numbers that make a curve.
FEWEST = 8


@dataclass(frozen=True)
class Outlier:
    """A key that stands out, and why."""

    key: int
    what: str  #: friction, uneven friction, balance, strike weight, spring or front weight
    value: float  #: measured, in its unit
    curve: float  #: smooth curve there
    unit: str  #: gf, of a strike or front weight g
    reason: str


@dataclass(frozen=True, eq=False)
class Balance:
    """What the weights of a keyboard say.

    Attributes
    ----------
    keyboard : Keyboard
        The weights.
    frame : DataFrame
        One row a key: ``note``, ``sharp``, ``balance``, ``friction``, ``spring`` (what the support
        spring takes off the down weight), ``played`` (balance with the spring) [g], ``ratio``
        (strike weight ratio [1]), and the smooth ``*_curve`` of each; ``balance_curve`` is what
        front, strike and whippen weight predict with the smooth ratio, and ``front_curve`` the
        front weight that gives the smooth balance with the smooth hammers, ratio and springs.
    sharp_factor : float
        How much longer the lever of a sharp is than that of a natural [1].
    outliers : tuple of Outlier
    notes : tuple of str
        What was assumed.
    """

    keyboard: Keyboard
    frame: pd.DataFrame
    sharp_factor: float
    outliers: tuple[Outlier, ...]
    notes: tuple[str, ...]

    @cached_property
    def residual(self) -> pd.Series[float]:
        """Measured balance less that predicted by the weights [g]."""
        return self.frame["balance"] - self.frame["balance_curve"]

    def summary(self) -> dict[str, dict[str, float]]:
        """Count, mean, scatter, least and most of each number."""
        names = ("balance", "played", "friction", "ratio", "spring")
        table = self.frame[list(names)].agg(["count", "mean", "std", "min", "max"])
        return {str(k): v for k, v in table.to_dict().items()}


def standard_curves(what: str, keys: Array) -> dict[str, Array]:
    """Curves of technicians over the keys, by level [g].

    ``what`` is ``strike_weight``, ``front_weight`` or ``friction`` (``low`` and ``high``).
    """
    from scipy.interpolate import PchipInterpolator

    table: Any = read_toml(params.folder("keyboard") / "standards.toml")
    if what not in table or what in ("keys", "schema"):
        raise InvalidParameter(f"there are no standard curves of {what!r}")
    return {
        level: PchipInterpolator(table["keys"], values)(np.clip(keys, 1, 88))
        for level, values in table[what].items()
        if level != "source"
    }


def smooth_curve(values: Array, weight: Array | None = None) -> Array:
    """Smooth curve over the keys, as smooth as the marginal likelihood wants it.

    The sum of the squares of the second differences is penalized: the limit is a straight line.
    The penalty is that of the largest likelihood of the values, of which the straight line is taken
    out (G. Wahba, 1985). Generalized cross-validation, which takes chance for waves in one of some
    curves of 88 values, is not used. Keys that stand out do not pull the curve: it is fitted again
    without them.

    Parameters
    ----------
    values
        One value a key; NaN: not measured.
    weight
        Weights of the values.
    """
    weights = np.ones_like(values) if weight is None else weight
    used = np.isfinite(values) & np.isfinite(weights)
    if used.sum() < FEWEST:
        return np.full_like(values, np.nan)
    curve = values
    for _ in range(2):
        curve = _likeliest(np.where(used, values, 0.0), np.where(used, weights, 0.0))
        distance = np.abs(values - curve)
        keep = used & ~(distance > max(FAR * scatter(values - curve), 1e-9))
        if keep.sum() < FEWEST:
            break
        used = keep
    # Beyond the first and the last value, the curve keeps their level.
    ends = np.flatnonzero(used)[[0, -1]]
    return np.asarray(curve[np.clip(np.arange(values.size), *ends)])


def _likeliest(values: Array, weight: Array) -> Array:
    """The curve with the penalty of the largest marginal likelihood; weight 0: no value."""
    from scipy.linalg import cho_factor, cho_solve

    second = np.diff(np.eye(values.size), 2, axis=0)
    known = int((weight > 0.0).sum())
    rough = second.T @ second * weight.sum() / known
    best, found = np.inf, values
    for penalty in PENALTIES:
        factor = cho_factor(np.diag(weight) + penalty * rough, lower=True)
        curve = cho_solve(factor, weight * values)
        misfit = float(weight * values @ (values - curve))
        # Of values on a straight line, rounding remains.
        misfit = max(misfit, 1e-12 * float(weight @ values**2), 1e-300)
        unlikely = (
            (known - 2) * np.log(misfit)
            + 2.0 * np.log(np.diag(factor[0])).sum()
            - len(second) * np.log(penalty)
        )
        if unlikely < best:
            best, found = unlikely, curve
    return np.asarray(found)


def scatter(values: Array) -> float:
    """Robust standard deviation: that of the values that do not stand out by their median."""
    away = np.abs(values - np.nanmedian(values))
    return float(np.nanstd(values[away <= FAR * 1.4826 * np.nanmedian(away)]))


@checked
def analyze(
    keyboard: Keyboard, *, key_ratio: float | None = None, whippen_weight: float | None = None
) -> Balance:
    """Compute balance, friction and ratio of each key, their curves, and the keys that stand out.

    Parameters
    ----------
    keyboard
        Weights.
    key_ratio
        Key ratio of keys without a measured one [1]; default: 0.5, which is told.
    whippen_weight
        Whippen radius weight of keys without a measured one [g]; default: 18.5 g, which is told.
    """
    frame = keyboard.frame
    notes = list(keyboard.notes)
    filled = {}
    for name, given, usual in (
        ("key_ratio", key_ratio, KEY_RATIO),
        ("whippen_weight", whippen_weight, WHIPPEN_WEIGHT),
    ):
        column, value = COLUMNS[name], usual if given is None else given
        if not column.low <= value <= column.high:
            raise InvalidParameter(
                f"{name}: got {value:g}, expected {column.low:g} to {column.high:g} {column.unit}"
            )
        lacking = int(frame[name].isna().sum())
        if lacking and given is None:
            unit = "" if column.unit == "1" else f" {column.unit}"
            notes.append(
                f"the {column.text} of {lacking} keys was not measured and is taken as "
                f"{value:g}{unit}"
            )
        filled[name] = frame[name].fillna(value)
    out = frame[[]].copy()
    out["note"] = [note_name(k) for k in out.index]
    out["sharp"] = [is_sharp(k) for k in out.index]
    out["balance"] = (frame["down_weight"] + frame["up_weight"]) / 2
    out["friction"] = (frame["down_weight"] - frame["up_weight"]) / 2
    out["spring"] = frame["down_weight"] - frame["down_weight_with_spring"]
    out["played"] = out["balance"] - out["spring"].fillna(0.0)
    out["whippen"] = filled["key_ratio"] * filled["whippen_weight"]
    strike = frame["strike_weight"]
    out["ratio"] = (out["balance"] + frame["front_weight"] - out["whippen"]) / strike
    out["ratio"] = out["ratio"].fillna(frame["strike_weight_ratio"])
    curve, factor = _ratios(out, strike.to_numpy(), frame["front_weight"].to_numpy())
    out["ratio_curve"] = curve
    lever = np.where(out["sharp"], factor, 1.0)
    predicted = lever * out["whippen"] - frame["front_weight"]
    strike_curve = smooth_curve(strike.to_numpy())
    out["strike_curve"] = strike_curve
    out["balance_curve"] = predicted + curve * strike
    for name in ("friction", "spring", "played"):
        out[f"{name}_curve"] = smooth_curve(out[name].to_numpy())
    out["spring_curve"] = out["spring_curve"].where(out["spring"].notna())
    out["front_curve"] = (
        lever * out["whippen"]
        + curve * strike_curve
        - out["spring_curve"].fillna(0.0)
        - out["played_curve"]
    )
    if not np.isfinite(curve).any():
        notes.append(
            "front and strike weights are too few: balance and friction only, no ratio and no "
            "prediction of the balance"
        )
    outliers = tuple(_outliers(keyboard, out))
    band = standard_curves("friction", out.index.to_numpy(float))
    for word, count in (
        ("below", (out["friction"] < band["low"]).sum()),
        ("above", (out["friction"] > band["high"]).sum()),
    ):
        if count > 1:
            notes.append(f"the friction of {count} keys is {word} the usual band of a grand")
    return Balance(keyboard, out, factor, outliers, tuple(notes))


def _ratios(out: pd.DataFrame, strike: Array, front: Array) -> tuple[Array, float]:
    """Smooth strike weight ratio of each key with its color, and the factor of the sharps.

    The front of a sharp is nearer to the balance pin: all that the key lifts has a longer lever
    there, by one factor. It is estimated with the curve, in turns.
    """
    sharp = out["sharp"].to_numpy(bool)
    total = (out["balance"] + front).to_numpy()
    whippen = out["whippen"].to_numpy()
    known = np.isfinite(total) & np.isfinite(strike)
    if known.sum() < FEWEST:
        return smooth_curve(out["ratio"].to_numpy()), 1.0
    factor, curve = 1.05, strike
    for _ in range(20):
        lever = np.where(sharp, factor, 1.0)
        curve = smooth_curve((total / lever - whippen) / strike, strike**2)
        lifted = curve * strike + whippen
        rows = known & sharp
        if not rows.any():
            return curve, 1.0
        former, factor = factor, float(total[rows] @ lifted[rows] / (lifted[rows] @ lifted[rows]))
        if abs(factor - former) < 5e-4:
            break
    return curve * np.where(sharp, factor, 1.0), factor


def _outliers(keyboard: Keyboard, out: pd.DataFrame) -> Iterator[Outlier]:
    keys = out.index.to_numpy(float)
    band = standard_curves("friction", keys)
    usual = dict(zip(out.index, zip(band["low"], band["high"], strict=True), strict=True))
    uneven = out["played"] - out["played_curve"]
    for name, values, curve in (
        ("friction", out["friction"], out["friction_curve"]),
        ("balance", out["balance"], out["balance_curve"]),
        ("strike_weight", keyboard.frame["strike_weight"], out["strike_curve"]),
        ("spring", out["spring"], out["spring_curve"]),
        ("front_weight", keyboard.frame["front_weight"], out["front_curve"]),
    ):
        off = (values - curve).to_numpy()
        if not np.isfinite(off).any():
            continue
        most = max(FAR * scatter(off), MATTERS[name])
        for key, distance in zip(out.index, off, strict=True):
            low, high = usual[key]
            value = float(values[key])
            if not abs(distance) > most:
                continue
            if name == "front_weight" and -uneven[key] / distance < UNBALANCED:
                continue
            weighs = "weight" in name
            told = f"{abs(distance):.1f} {'g' if weighs else 'gf'} {_side(distance)} the curve"
            band_text = f"{low:.0f} to {high:.0f} gf"
            what, reason = {
                "friction": ("friction", f"{told}, and above the usual {band_text}: ease the key "
                             "bushings, then hammer, whippen and jack centers"),
                "balance": ("balance", f"{told} of its weights: weigh again, then look for a "
                            "capstan, knuckle or lead out of place"),
                "strike_weight": ("strike weight", f"{told}: hammer or shank differs from its "
                                  "neighbors"),
                "spring": ("spring", f"takes off {value:.1f} gf, {told}: weigh again, then set the "
                           "support spring"),
                "front_weight": ("front weight", f"{told}, and the balance {abs(uneven[key]):.1f} "
                                 f"gf {_side(uneven[key])} that of the neighbors: a lead is "
                                 f"{'too much' if distance > 0 else 'missing'} or out of place"),
            }[name]  # fmt: skip
            if name == "friction" and not (distance > 0.0 and value > high):
                what = "uneven friction"
                inside = "inside" if low <= value <= high else "outside"
                reason = f"{told}, but {inside} the usual {band_text}: weigh again"
            yield Outlier(int(key), what, value, float(curve[key]), "g" if weighs else "gf", reason)


def _side(distance: float) -> str:
    return "above" if distance > 0 else "below"
