"""``feltmb fiber models, structure, contacts``: properties of fiber networks."""

from __future__ import annotations

import math
from typing import Any

import click

from feltmb.cli.common import (
    FRACTION,
    NOT_NEGATIVE,
    POSITIVE,
    Number,
    caution,
    diameter_option,
    positive,
    say,
)
from feltmb.cli.completing import fiber_laws
from feltmb.cli.fiber.group import fiber, guard, print_table, seed_option


@fiber.command(name="models", short_help="List the laws, or the parameters of law NAME.")
@click.argument("name", required=False, shell_complete=fiber_laws)
@guard
def models_command(name: str | None) -> None:
    """List the laws, or the parameters of law NAME with unit, range and meaning."""
    from feltmb.errors import InvalidParameter
    from feltmb.fiber import history_models, models

    laws = {**models(), **history_models()}
    if name is None:
        print_table(
            "Compression laws",
            ["law", "what", "source"],
            [[k, d.title, d.source] for k, d in models().items()],
            words=3,
        )
        print_table(
            "Laws with history",
            ["law", "what", "source"],
            [[k, d.title, d.source] for k, d in history_models().items()],
            words=3,
        )
        return
    if name not in laws:
        raise InvalidParameter(f'models: NAME = "{name}", must be one of {", ".join(laws)}')
    law = laws[name]
    say(f"{law.title}\nsource: {law.source}\nvalid: {law.validity}")
    rows = []
    for p in law.parameters:
        default = "v_f0" if p.name == "v_random" and name != "bending_chain" else "required"
        if not math.isnan(p.default):
            default = f"{p.default:.4g}"
        elif p.name == "v_random" and name == "bending_chain":
            default = "isotropic"
        rows.append([p.name, p.unit or "-", default, f"{p.low:.3g} to {p.high:.3g}", p.meaning])
    print_table("Parameters", ["name", "unit", "default", "range", "meaning"], rows, words=5)


@fiber.command(
    name="structure", short_help="Structural numbers after uniaxial compression by RATIO."
)
@click.argument("ratio", type=Number(1e-3, 1e6), nargs=-1, required=True)
@click.option(
    "--network",
    "n",
    type=click.IntRange(1, 10_000_000),
    help="Also estimate the numbers from a random network of N fibers.",
)
@seed_option
@click.option(
    "--spread",
    type=click.IntRange(0, 100_000),
    default=0,
    show_default=True,
    help="Diffusion steps.",
)
@guard
def structure_command(ratio: tuple[float, ...], n: int | None, seed: int, spread: int) -> None:
    """Structural numbers after uniaxial compression by RATIO = v_f / v_random."""
    from feltmb.fiber import network, structure

    names = ["f", "n3", "e3", "K3", "M3"]
    rows = []
    made = network(n, seed, spread) if n is not None else None
    for r in ratio:
        s = structure(r)
        rows.append([f"{r:g}", *(f"{getattr(s, k):.9f}" for k in names)])
        if made is not None:
            e = made.deform(r).structure()
            rows.append(["  sampled", *(f"{getattr(e, k):.5f}" for k in names)])
            rows.append(["  +-", *(f"{e.error[k]:.5f}" for k in names)])
    print_table("Structural numbers [-]", ["R", "f", "<n3^4>", "<e3^4>", "K3", "M3"], rows)


@fiber.command(
    name="contacts", short_help="Mean free length and contacts per volume by every model."
)
@click.option(
    "--v-f",
    type=FRACTION,
    required=True,
    callback=caution("v_f"),
    help="Volume fraction [-].",
)
@diameter_option
@click.option("--ratio", type=POSITIVE, default=1.0, show_default=True, help="R = v_f/v_random.")
@click.option(
    "--gamma",
    type=POSITIVE,
    default=math.pi / 2,
    show_default="pi/2",
    callback=caution("gamma"),
    help="Blocked length per contact over d_f (binomial).",
)
@click.option(
    "--diameter-cv",
    type=NOT_NEGATIVE,
    default=0.0,
    show_default=True,
    help="Coefficient of variation of the diameters.",
)
@click.option(
    "--length",
    type=positive("m"),
    callback=caution("length"),
    help="Mean fiber length [m]: also the numbers per fiber.",
)
@click.option(
    "--length-cv",
    type=Number(0, 3),
    default=0.0,
    show_default=True,
    help="Coefficient of variation of the lengths (gamma distribution).",
)
@guard
def contacts_command(
    v_f: float,
    d_f: float,
    ratio: float,
    gamma: float,
    diameter_cv: float,
    length: float | None,
    length_cv: float,
) -> None:
    """Mean free length and contacts per volume by every model."""
    from feltmb.fiber import contact_count, contacts_per_volume, mean_free_length

    names: tuple[str, ...] = (
        "van_wyk",
        "van_wyk_tube",
        "komori_makishima",
        "pan",
        "poisson",
        "binomial",
        "toll",
    )
    if diameter_cv != 0:
        names = ("komori_makishima", "poisson", "toll")
    rows = []
    for name in names:
        extra: dict[str, Any] = {"gamma": gamma} if name == "binomial" else {}
        extra["diameter_cv"] = diameter_cv
        free = mean_free_length(name, v_f, d_f, ratio=ratio, **extra)
        number = contacts_per_volume(name, v_f, d_f, ratio=ratio, **extra)
        rows.append([name, f"{free * 1e6:.4f}", f"{free / d_f:.4f}", f"{number * 1e-9:.6g}"])
    print_table(
        f"Contacts at v_f = {v_f:g}, d_f = {d_f * 1e6:g} um, R = {ratio:g}",
        ["model", "free length [um]", "over d_f [-]", "contacts [1/mm^3]"],
        rows,
    )
    say("toll counts a contact on both of its fibers (eq. 3.51), the others once.")
    if diameter_cv != 0:
        say("the other models have no distribution of diameters.")
    if length is not None:
        rows = []
        for name in ("poisson", "binomial"):
            extra = {"gamma": gamma} if name == "binomial" else {}
            c = contact_count(name, v_f, d_f, length, ratio=ratio, length_cv=length_cv, **extra)
            rows.append(
                [name, f"{c.mean:.4f}", f"{math.sqrt(c.variance):.4f}", f"{c.probability[0]:.3e}"]
            )
        print_table(
            f"Contacts on a fiber of {length * 1e3:g} mm",
            ["model", "mean", "standard deviation", "probability of none"],
            rows,
        )
