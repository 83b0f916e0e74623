"""``feltmb keyboard``: weights of 88 keys, and ground truth for sensors of keyboards."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from feltmb.cli.completing import actions
from unmodeled.cli.options import (
    FORCE,
    FileName,
    Number,
    Quantity,
    argument,
    count,
    declare,
    option,
    picture,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    console,
    print_json,
    save_figure,
    save_text,
    say_written,
    show,
    working,
)

if TYPE_CHECKING:
    from feltmb.keyboard import Balance

__all__ = ["command"]


class _Keyboard(click.Group):
    """Group whose command ``weights`` need not be named: ``feltmb keyboard FILE``."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        named = args[0] in self.commands or args[0].startswith("-")
        return super().resolve_command(ctx, args if named else ["weights", *args])


@click.group(cls=_Keyboard, context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Weights of the keys of a keyboard, and ground truth for its sensors.

    feltmb keyboard FILE is short for feltmb keyboard weights FILE.
    """


RATIO = option("Key ratio of keys without a measured one; default: 0.5.", Number(0.3, 0.8))
WHIPPEN = option(
    "Whippen radius weight of keys without a measured one [kg], such as 19.5g; default: 18.5 g.",
    Quantity("kg", 0.005, 0.04),
    words="--whippen",
)


def _analyzed(file: Path, key_ratio: float | None, whippen: float | None) -> Balance:
    from feltmb.keyboard import analyze, read_keyboard

    weight = None if whippen is None else 1e3 * whippen
    return analyze(read_keyboard(file), key_ratio=key_ratio, whippen_weight=weight)


@declare("weights", command)
def weights(
    file: Path = argument(),
    key_ratio: float | None = RATIO,
    whippen: float | None = WHIPPEN,
    target: float | None = option(
        "Wanted balance as played [kg], such as 38g; default: the smooth curve.",
        Quantity("kg", 0.01, 0.1),
    ),
    lead_at: float = option(
        "Distance of added lead from the balance pin [m].", positive("m"), 0.14
    ),
    image: Path | None = picture("Draw all weights over the keys."),
    out: Path | None = option(
        "Write the page (.html), all numbers (.csv), or the weights for Piano Touch Lab (.json).",
        FileName(".html", ".csv", ".json"),
        metavar="FILE",
    ),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Balance, friction and strike weight ratio of each key of FILE, and the list of work.

    FILE is a CSV file with one row a key (key, down weight, up weight, front weight, strike weight,
    and optionally down weight with support spring, key ratio), or JSON of Piano Touch Lab.
    """
    from feltmb.keyboard.report import draw, html_page, key_table, sentences
    from feltmb.keyboard.work import list_of_work

    check_targets(out, pictures=(image,), force=force)
    balance = _analyzed(file, key_ratio, whippen)
    wanted = None if target is None else 1e3 * target
    work = list_of_work(balance, target=wanted, lead_at=lead_at)
    if as_json:
        outliers = [vars(o) for o in balance.outliers]
        print_json(
            {
                "summary": balance.summary(),
                "notes": list(balance.notes),
                "outliers": outliers,
                "work": work.to_dict("records"),
            }
        )
    else:
        screen = console()
        for text in (*sentences(balance), *(f"Note: {n}." for n in balance.notes)):
            screen.print(text)
        if balance.outliers:
            show(
                "keys that stand out",
                ">key | note | what | >measured g | >curve g | reason",
                [
                    (str(o.key), balance.frame.at[o.key, "note"], o.what, f"{o.value:.1f}",
                     f"{o.curve:.1f}", o.reason)
                    for o in balance.outliers
                ],
            )  # fmt: skip
        show(
            "list of work",
            ">key | note | part | work",
            [(str(r.key), r.note, r.part, r.work) for r in work.itertuples()],
        )
    if out is not None and out.suffix.lower() == ".json":
        say_written(balance.keyboard.write(out, force=force))
    elif out is not None and out.suffix.lower() == ".csv":
        save_text(out, key_table(balance).to_csv(float_format="%.4g"), force=force)
    else:
        save_text(out, lambda: html_page(balance, work), force=force)
    save_figure(image, lambda: draw(balance), force=force)


@declare("action", command)
def action(
    file: Path = argument(),
    key: int = argument(count(1, 108)),
    base: str = option(
        "Action whose lengths and felts are used.",
        default="grand_action",
        metavar="ACTION",
        complete=actions,
    ),
    key_ratio: float | None = RATIO,
    whippen: float | None = WHIPPEN,
    out: Path | None = option("Mechanism file to be written.", FileName(".toml")),
    force: bool = FORCE,
) -> None:
    """Set up the action of the key KEY of FILE, for touch and strokes.

    Strike weight, strike weight ratio, balance as played and friction are those of the key.
    Lengths, felts and screws are those of a packaged action, which is regulated again.
    """
    from feltmb.keyboard import action_of_key

    check_targets(out, force=force)
    balance = _analyzed(file, key_ratio, whippen)
    with working("measuring") as progress:
        made = action_of_key(balance, key, base, progress=progress)
    show(
        f"action of key {key}, {balance.frame.at[key, 'note']}",
        "| >keyboard | >action",
        [(name, f"{v:.2f}", f"{made.reached[name]:.2f}") for name, v in made.wanted.items()],
        "; ".join(("weights in g", *made.notes)),
    )
    save_text(out, made.to_toml, force=force)
