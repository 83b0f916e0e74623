"""A keyboard for people: picture, table of keys, page."""

from __future__ import annotations

import base64
import io
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from feltmb.keyboard.balance import Balance, standard_curves

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Array = npt.NDArray[np.float64]


def sentences(balance: Balance) -> list[str]:
    """What the weights say, one sentence a number."""
    found, residual = balance.summary(), balance.residual.dropna()

    def told(name: str, what: str, digits: int = 1, unit: str = " gf") -> str:
        n = found[name]
        if not n["count"]:
            return ""
        mean, std = f"{n['mean']:.{digits}f}", f"{n['std']:.{digits}f}"
        span = f"{n['min']:.{digits}f} to {n['max']:.{digits}f}"
        return f"{what} {mean} ± {std}{unit} on {n['count']:.0f} keys ({span}{unit})."

    out = [
        told("balance", "Of down weight D and up weight U, the balance weight (D + U) / 2 is"),
        told("friction", "The friction (D - U) / 2 is"),
        told("ratio", "The strike weight ratio is", 2, ""),
        told("spring", "Support springs take off"),
        told("played", "The balance as played is") if found["spring"]["count"] else "",
    ]
    if len(residual):
        near = int((residual.abs() <= 3.0).sum())
        out.append(
            f"The weights predict the balance: {near} of {len(residual)} keys within 3 gf, "
            f"standard deviation {residual.std():.2f} gf. At the front of a sharp, all that "
            f"the key lifts is {100 * (balance.sharp_factor - 1):.1f} % heavier."
        )
    return [text for text in out if text]


def key_table(balance: Balance) -> pd.DataFrame:
    """All numbers of all keys, measured and computed, with units in the heads."""
    import pandas as pd

    table = pd.concat([balance.keyboard.frame, balance.frame.drop(columns="whippen")], axis=1)
    reasons: dict[int, list[str]] = {}
    for o in balance.outliers:
        reasons.setdefault(o.key, []).append(f"{o.what}: {o.reason}")
    table["told"] = ["; ".join(reasons.get(k, [])) for k in table.index]
    plain = ("note", "sharp", "told")
    heads = {c: f"{c} [{'1' if 'ratio' in c else 'g'}]" for c in table if c not in plain}
    return table.rename(columns=heads).dropna(axis="columns", how="all")


def draw(balance: Balance) -> Figure:
    """Picture over the keys: weights, friction, strike weight, ratio and front weight."""
    from unmodeled.style import BLUE, GRAY, GREEN, NORMAL, ORANGE, RED, head_line, new_figure

    frame, keys = balance.frame, balance.frame.index.to_numpy(float)
    given, sharp = balance.keyboard.frame, balance.frame["sharp"].to_numpy(bool)
    figure = new_figure(9.5, 12.0)
    head_line(figure, f"{balance.keyboard.name}: weights of {len(frame)} keys")
    axes = figure.subplots(5, 1, sharex=True)
    _marks(axes[0], keys, given["down_weight"], sharp, RED, "down")
    _marks(axes[0], keys, given["up_weight"], sharp, BLUE, "up")
    _marks(axes[0], keys, frame["balance"], sharp, GRAY, "balance")
    axes[0].plot(keys, frame["balance_curve"], color=GRAY, lw=1, label="balance, from the weights")
    if frame["spring"].notna().any():
        _marks(axes[0], keys, given["down_weight_with_spring"], sharp, ORANGE, "down with spring")
    band = standard_curves("friction", keys)
    axes[1].fill_between(keys, band["low"], band["high"], color=GREEN, alpha=0.15, lw=0,
                         label="usual")  # fmt: skip
    _marks(axes[1], keys, frame["friction"], sharp, RED, "friction")
    axes[1].plot(keys, frame["friction_curve"], color=RED, lw=1)
    if frame["spring"].notna().any():
        _marks(axes[1], keys, frame["spring"], sharp, ORANGE, "support spring")
        axes[1].plot(keys, frame["spring_curve"], color=ORANGE, lw=1)
    _standards(axes[2], "strike_weight", keys, given["strike_weight"])
    _marks(axes[2], keys, given["strike_weight"], sharp, BLUE, "strike weight")
    axes[2].plot(keys, frame["strike_curve"], color=BLUE, lw=1)
    _marks(axes[3], keys, frame["ratio"], sharp, GREEN, "strike weight ratio")
    for color in (False, True):
        rows = sharp == color
        style, label = ("--", "curve, sharps") if color else ("-", "curve")
        axes[3].plot(keys[rows], frame["ratio_curve"][rows], style, color=GREEN, lw=1, label=label)
    _standards(axes[4], "front_weight", keys, given["front_weight"])
    _marks(axes[4], keys, given["front_weight"], sharp, BLUE, "front weight")
    rows = {"friction": 1, "uneven friction": 1, "balance": 0, "spring": 1, "front weight": 4}
    for o in balance.outliers:
        row = rows.get(o.what, 2)
        axes[row].annotate(
            f"{o.key}", (o.key, o.value), xytext=(6, 6), textcoords="offset points", fontsize=8,
            fontweight="bold" if o.what == "friction" else "normal",
        )  # fmt: skip
        axes[row].plot([o.key], [o.value], "o", ms=11, mfc="none", mec=RED, mew=1.6)
    texts = ("weight [gf]", "friction, spring [gf]", "strike weight [g]", "ratio [1]",
             "front weight [g]")  # fmt: skip
    for ax, text in zip(axes, texts, strict=True):
        _styled(ax, text)
    axes[-1].set_xlabel("key (filled: naturals, open: sharps; ring: stands out)", fontsize=NORMAL)
    axes[-1].set_xticks([k for k in range(1, len(frame) + 1) if (k - 4) % 12 == 0])
    axes[-1].set_xticklabels(
        [f"{k}\n{n}" for k, n in frame["note"].items() if (k - 4) % 12 == 0], fontsize=8
    )
    return figure


def _styled(ax: Axes, text: str) -> None:
    from unmodeled.style import side_legend, style_axes

    style_axes(ax, "", text)
    side_legend(ax)


def _marks(ax: Axes, keys: Array, values: pd.Series[float], sharp: Array, color: str,
           label: str) -> None:  # fmt: skip
    """Naturals as filled dots, sharps as open ones."""
    x, y, s = keys, values.to_numpy(float), sharp.astype(bool)
    ax.plot(x[~s], y[~s], "o", ms=3.6, color=color, label=label)
    ax.plot(x[s], y[s], "o", ms=3.6, mfc="white", mec=color)


def _standards(ax: Axes, what: str, keys: Array, values: pd.Series[float]) -> None:
    """The standard curves that are near the values, thin, with their level at the right end."""
    from unmodeled.style import GRAY, PALE

    y = values.to_numpy(float)
    label: str | None = "standard levels"
    for level, curve in standard_curves(what, keys).items():
        if np.isfinite(y).any() and np.nanmin(np.abs(curve - y)) < 1.0:
            ax.plot(keys, curve, color=PALE, lw=1.2, zorder=0, label=label)
            label = None
            ax.text(keys[0] - 0.6, curve[0], level, fontsize=7, color=GRAY, ha="right",
                    va="center")  # fmt: skip


def html_page(balance: Balance, work: pd.DataFrame) -> str:
    """The page: sentences, keys that stand out, picture, list of work, all numbers.

    It loads nothing.
    """
    import jinja2

    file = io.BytesIO()
    draw(balance).savefig(file, format="png", dpi=110)
    text = (resources.files("feltmb.keyboard") / "page.html").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    keys = key_table(balance).drop(columns="told").round(2)
    return environment.from_string(text).render(
        name=balance.keyboard.name,
        sentences=[*sentences(balance), *(f"Note: {n}." for n in balance.notes)],
        outliers=[(o, balance.frame.at[o.key, "note"]) for o in balance.outliers],
        picture=base64.b64encode(file.getvalue()).decode(),
        work=work.to_dict("records"),
        heads=list(keys),
        keys=keys.astype(object).where(keys.notna(), "").itertuples(),
    )
