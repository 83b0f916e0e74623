"""``feltmb show``: a mechanism as tables."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import (
    console,
    force_option,
    json_option,
    load_with_settings,
    new_table,
    print_json,
    save_figure,
    say,
    say_written,
    set_option,
)
from feltmb.cli.completing import actions


@click.command("show")
@click.argument("action", shell_complete=actions)
@set_option
@click.option("--values", is_flag=True, help="List every number with its unit and source.")
@click.option("--toml", is_flag=True, help="Print the mechanism file with the changes of --set.")
@click.option(
    "--plot",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw the mechanism at rest (PNG).",
)
@click.option(
    "--graph",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Write the linear graph of the mechanism as text for Graphviz (.dot).",
)
@force_option
@json_option
def command(
    action: str,
    settings: tuple[str, ...],
    values: bool,
    toml: bool,
    plot: Path | None,
    graph: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Show bodies, joints, contacts, springs and string of ACTION, with units and sources."""
    from feltmb.files import check_suffix, write_text
    from feltmb.mechanism.parameters import bare_numbers

    mechanism = load_with_settings(action, settings)
    if toml:
        say(mechanism.to_toml())
    elif as_json:
        print_json(
            {
                "name": mechanism.name,
                "hash": mechanism.hash,
                "coordinates": mechanism.coordinates,
                "rest_pose": dict(
                    zip(mechanism.coordinates, mechanism.rest_pose.tolist(), strict=True)
                ),
                "values": [
                    {"path": p, "value": v, "unit": u, "source": s}
                    for p, v, u, s in mechanism.quantities()
                ],
            }
        )
    elif values:
        table = new_table(
            f"{mechanism.name}: values", "path", "value", "unit", "source", whole=(0,)
        )
        bare = {
            p.path.removesuffix(".x").removesuffix(".y"): p.unit for p, _ in bare_numbers(mechanism)
        }
        for path, value, unit, source in mechanism.quantities():
            note = "no unit in the file: SI" if path in bare else source
            table.add_row(path, f"{value}", bare.get(path, unit), note)
        console().print(table)
    else:
        _tables(mechanism)
    if plot is not None:
        from feltmb.graphics.plot import mechanism as draw

        save_figure(draw(mechanism), plot, force=force)
    if graph is not None:
        from feltmb.graphics.graph import graph as linear_graph

        check_suffix(graph, ".dot")
        say_written(write_text(graph, linear_graph(mechanism).to_dot(), force=force))


#: Shown properties of a spring: word before the number, and field.
_SPRING = (
    ("", "stiffness"),
    ("from ", "rest_angle"),
    ("damping ", "damping"),
    ("play ", "clearance"),
)


def _tables(mechanism: object) -> None:
    from feltmb.mechanism import Action, Spring
    from feltmb.mechanism.to_core import with_leads
    from feltmb.units.quantity import unit_of

    assert isinstance(mechanism, Action)
    config = mechanism.config
    screen = console()
    screen.print(f"{config.name}: {config.about}")
    if config.source.cite:
        screen.print(f"source: {config.source.cite}")
    screen.print(f"hash {mechanism.hash[:16]}")

    table = new_table(
        "bodies", "name", "joint to", "coordinate", "mass [g]", "inertia [kg mm^2]", right=(3, 4)
    )
    for name in config.bodies:
        body = with_leads(config, name)
        mass, inertia = body.mass, body.inertia
        if body.kind == "beam":
            assert body.length is not None
            assert body.density is not None
            assert body.area is not None
            mass = body.density * body.area * body.length
            inertia = mass * body.length**2 / 12
        table.add_row(
            name,
            f"{body.joint} on {body.parent}",
            body.coordinate or "-",
            f"{mass * 1e3:.4g}",
            f"{inertia * 1e6:.4g}",
        )
    screen.print(table)
    for name, lead in config.leads.items():
        screen.print(f"lead {name}: {1e3 * lead.mass:g} g at {1e3 * lead.position:g} mm")
    if config.source.note:
        screen.print(config.source.note)
    if config.screws:
        screen.print(f"screws for --set, such as capstan+=0.5turn: {', '.join(config.screws)}")

    rest = mechanism.rest_pose
    table = new_table("rest pose", "coordinate", "value", "unit", right=(1,))
    unit_of_coordinate = dict(
        zip(mechanism.coordinates, mechanism.mechanism.coordinate_units, strict=True)
    )
    for name, value in zip(mechanism.coordinates, rest, strict=True):
        table.add_row(name, f"{value:.7g}", unit_of_coordinate[name])
    screen.print(table)

    from feltmb.run.simulate import evaluate

    state = evaluate(mechanism, rest, [0.0] * len(rest)).contacts
    table = new_table(
        "contacts", "no", "where", "pair", "law", "gap at rest [mm]", "force [N]", right=(4, 5)
    )
    for key, contact in config.contacts.items():
        row = state.loc[int(key)]
        table.add_row(
            key,
            contact.label,
            "-".join(contact.surfaces),
            contact.law if contact.enabled else "off",
            f"{-1e3 * row['compression']:.3f}",
            f"{row['normal_force']:.3f}",
        )
    screen.print(table)

    table = new_table("springs and straps", "name", "acts on", "data")
    for name, spring in config.springs.items():
        joint = "prismatic" if unit_of_coordinate[spring.coordinate] == "m" else "revolute"
        text = ", ".join(
            f"{word}{getattr(spring, field):.4g} {unit_of(Spring, field, joint)}"
            for word, field in _SPRING
            if getattr(spring, field) or field in ("stiffness", "rest_angle")
        )
        table.add_row(name, spring.coordinate, text if spring.enabled else "off")
    for name, strap in config.straps.items():
        text = f"free length {1e3 * strap.free_length:.4g} mm, cubic"
        table.add_row(name, f"{strap.body_a}, {strap.body_b}", text if strap.enabled else "off")
    if table.row_count:
        screen.print(table)
    string = config.string
    if string is not None:
        strings = f"{string.count} equal strings, each " if string.count > 1 else ""
        screen.print(
            f"string: {string.kind}, {strings}{string.modes} modes, {string.tension:g} N, "
            f"{string.length:g} m, {1e3 * string.linear_density:g} g/m, "
            f"damping ratio {string.damping_ratio:g}",
        )
        if string.other_surfaces:
            lines = {string.surface, *string.other_surfaces}
            touching = [
                f"{key} {contact.label}".strip()
                for key, contact in config.contacts.items()
                if contact.enabled and lines.intersection(contact.surfaces)
            ]
            screen.print(f"  touched by contacts {', '.join(touching) or 'none'}")
