"""``feltmb list``, ``show``, ``validate``, ``new``, ``fmu``, ``live``, ``page``."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from feltmb.cli.completing import actions
from feltmb.cli.settings import SET, load_with_settings
from unmodeled.cli.options import (
    FORCE,
    Number,
    argument,
    count,
    declare,
    option,
)
from unmodeled.cli.screen import (
    complain,
    console,
    print_json,
    save_figure,
    save_text,
    say,
    say_written,
    show,
    warn,
)

if TYPE_CHECKING:
    from feltmb.mechanism import Action

ONE_NOTE = (
    "Every mechanism here is one note: 40 of 88 (middle C) of one upright piano, steinway45 and "
    "its variants, unless its name has another; grand_action is a grand from literature. Another "
    "note, piano or machine needs a file of its own: feltmb new FILE.toml writes a template."
)


@declare("list")
def listing(*, as_json: bool) -> None:
    """List packaged mechanisms, strokes, felts, hammers, laws and accepted units."""
    from feltmb import params
    from feltmb._core import fiber  # the package of this name imports readers and fits
    from feltmb.contact import HAMMERS, LAWS, hammer
    from feltmb.run.stroke import load_stroke, packaged_strokes
    from unmodeled.units import ACCEPTED_UNITS

    actions, actuators, felts = (params.texts("about", k) for k in ("", "actuators", "felts"))
    fibers = {law.name: law.title for law in fiber.law_descriptions()}
    hammers = [*HAMMERS.values(), *(hammer(f"stulov:{n}") for n in (1, 28, 40, 64, 88))]
    strokes = {name: load_stroke(name) for name in packaged_strokes()}
    if as_json:
        print_json(
            {
                "actions": actions,
                "sources": params.sources(),
                "actuators": actuators,
                "strokes": {n: s.as_dict() for n, s in strokes.items()},
                "laws": LAWS,
                "felts": felts,
                "hammers": [asdict(one) for one in hammers],
                "fiber_laws": fibers,
                "units": sorted(ACCEPTED_UNITS),
            }
        )
        return
    show("mechanisms", "name | about", actions.items())
    console().print(ONE_NOTE)
    show("sources of their numbers", "name | source", params.sources().items())
    show("actuators", "name | about", actuators.items())
    rows = []
    for name, stroke in strokes.items():
        factor, unit = (1e3, "mm") if stroke.unit == "m" else (1.0, stroke.unit)
        top = f"{max(stroke.value) * factor:g} {unit}"
        rows.append((name, stroke.kind, top, f"{stroke.duration:g} s"))
    show("strokes", "name | input | >largest | >length", rows)
    show("contact laws (contacts.NN.law)", "name | about", LAWS.items())
    show("felts", "name | about", felts.items())
    show(
        "hammers (feltmb.contact.hammer; stulov:1 to stulov:88 by key)",
        "name | >stiffness [N/m^p] | >exponent | >mass [g] | source",
        [
            (h.name, f"{h.stiffness:.4g}", f"{h.exponent:g}",
             "-" if h.mass is None else f"{1e3 * h.mass:g}", h.source)
            for h in hammers
        ],
    )  # fmt: skip
    show("laws of fiber masses", "name | about", fibers.items())
    console().print("units: " + " ".join(sorted(u for u in ACCEPTED_UNITS if u != "1")))


# --- a mechanism as tables -----------------------------------------------------------------------


@declare("show")
def showing(
    action: str = argument(complete=actions),
    settings: tuple[str, ...] = SET,
    values: bool = option("List every number with its unit and source."),
    toml: bool = option("Print the mechanism file with the changes of --set."),
    plot: Path | None = option("Draw the mechanism at rest (PNG).", metavar="FILE"),
    graph: Path | None = option(
        "Write the linear graph of the mechanism as text for Graphviz (.dot).", metavar="FILE"
    ),
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Show bodies, joints, contacts, springs and string of ACTION, with units and sources."""
    mechanism = load_with_settings(action, settings)
    if toml:
        say(mechanism.to_toml())
    elif as_json:
        rest = zip(mechanism.coordinates, mechanism.rest_pose.tolist(), strict=True)
        print_json(
            {
                "name": mechanism.name,
                "hash": mechanism.hash,
                "coordinates": mechanism.coordinates,
                "rest_pose": dict(rest),
                "values": [
                    {"path": p, "value": v, "unit": u, "source": s}
                    for p, v, u, s in mechanism.quantities()
                ],
            }
        )
    elif values:
        _show_values(mechanism)
    else:
        _show_mechanism(mechanism)
    if plot is not None:
        from feltmb.graphics.plot import mechanism as draw

        save_figure(plot, lambda: draw(mechanism), force=force)
    if graph is not None:
        from feltmb.graphics.graph import graph as linear_graph
        from unmodeled.files import check_suffix

        check_suffix(graph, ".dot")
        save_text(graph, linear_graph(mechanism).to_dot(), force=force)


def _show_values(mechanism: Action) -> None:
    from feltmb.mechanism.parameters import bare_numbers

    bare = {
        p.path.removesuffix(".x").removesuffix(".y"): p.unit for p, _ in bare_numbers(mechanism)
    }
    show(
        f"{mechanism.name}: values",
        "=path | value | unit | source",
        [
            (p, f"{v}", bare.get(p, unit), "no unit in the file: SI" if p in bare else source)
            for p, v, unit, source in mechanism.quantities()
        ],
    )


def _show_mechanism(mechanism: Action) -> None:
    from feltmb.run.simulate import evaluate

    config, screen = mechanism.config, console()
    screen.print(f"{config.name}: {config.about}")
    if config.source.cite:
        screen.print(f"source: {config.source.cite}")
    screen.print(f"hash {mechanism.hash[:16]}")
    heads = "name | joint to | coordinate | >mass [g] | >inertia [kg mm^2]"
    show("bodies", heads, _bodies(config))
    for name, lead in config.leads.items():
        screen.print(f"lead {name}: {1e3 * lead.mass:g} g at {1e3 * lead.position:g} mm")
    if config.source.note:
        screen.print(config.source.note)
    if config.screws:
        screen.print(f"screws for --set, such as capstan+=0.5turn: {', '.join(config.screws)}")
    rest = mechanism.rest_pose
    units = mechanism.mechanism.coordinate_units
    poses = zip(mechanism.coordinates, rest, units, strict=True)
    show("rest pose", "coordinate | >value | unit", [(n, f"{v:.7g}", u) for n, v, u in poses])
    state = evaluate(mechanism, rest, [0.0] * len(rest)).contacts
    show(
        "contacts",
        "no | where | pair | law | >gap at rest [mm] | >force [N]",
        [
            (
                key,
                contact.label,
                "-".join(contact.surfaces),
                contact.law if contact.enabled else "off",
                f"{-1e3 * state.loc[int(key)]['compression']:.3f}",
                f"{state.loc[int(key)]['normal_force']:.3f}",
            )
            for key, contact in config.contacts.items()
        ],
    )
    springs = list(_springs(config, dict(zip(mechanism.coordinates, units, strict=True))))
    if springs:
        show("springs and straps", "name | acts on | data", springs)
    if config.string is not None:
        _show_string(config)


def _bodies(config: Any) -> Iterator[tuple[str, ...]]:
    from feltmb.mechanism.to_core import with_leads

    for name in config.bodies:
        body = with_leads(config, name)
        mass, inertia = body.mass, body.inertia
        if body.kind == "beam":
            assert body.length is not None
            assert body.density is not None
            assert body.area is not None
            mass = body.density * body.area * body.length
            inertia = mass * body.length**2 / 12
        joint = f"{body.joint} on {body.parent}"
        yield name, joint, body.coordinate or "-", f"{mass * 1e3:.4g}", f"{inertia * 1e6:.4g}"


#: Shown properties of a spring: word before the number, and field.
_SPRING = (
    ("", "stiffness"),
    ("from ", "rest_angle"),
    ("damping ", "damping"),
    ("play ", "clearance"),
)


def _springs(config: Any, units: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    from feltmb.mechanism import Spring
    from feltmb.quantities import unit_of

    for name, spring in config.springs.items():
        joint = "prismatic" if units[spring.coordinate] == "m" else "revolute"
        text = ", ".join(
            f"{word}{getattr(spring, field):.4g} {unit_of(Spring, field, joint)}"
            for word, field in _SPRING
            if getattr(spring, field) or field in ("stiffness", "rest_angle")
        )
        yield name, spring.coordinate, text if spring.enabled else "off"
    for name, strap in config.straps.items():
        text = f"free length {1e3 * strap.free_length:.4g} mm, cubic"
        yield name, f"{strap.body_a}, {strap.body_b}", text if strap.enabled else "off"


def _show_string(config: Any) -> None:
    string, screen = config.string, console()
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


# --- files ---------------------------------------------------------------------------------------

#: Numbers without a unit that are listed.
LISTED = 6


@declare("validate")
def validate(
    files: tuple[Path, ...] = argument(),
    no_rest_pose: bool = option("Do not compute the rest pose."),
    *,
    as_json: bool,
) -> None:
    """Check mechanisms (TOML), strokes (TOML or CSV) or saved runs (NetCDF).

    All faults of a file are listed together. For a mechanism the rest pose is also computed. A
    warning is given if an infinite line carries a contact beyond its body in this pose. Numbers
    without a unit are listed with the SI unit that they have, with a warning if the file gives
    another unit to the same quantity elsewhere.
    """
    from unmodeled.errors import Error, InvalidParameter

    found: list[dict[str, Any]] = []
    for path in files:
        try:
            text, bare, warnings = _checked(path, rest=not no_rest_pose)
        except Error as error:
            found.append({"file": str(path), "ok": False, "text": str(error)})
            if not as_json:
                complain(str(error))
            continue
        more = {key: value for key, value in (("warnings", warnings), ("si", bare)) if value}
        found.append({"file": str(path), "ok": True, "text": text} | more)
        if not as_json:
            console().print(f"{path}: ok: {text}")
            if bare:
                console().print(in_si(bare, str(path)))
            warn(warnings, str(path))
    if as_json:
        print_json(found)
    bad = sum(not each["ok"] for each in found)
    if bad:
        raise InvalidParameter(f"{bad} of {len(files)} files have faults")


def _checked(path: Path, *, rest: bool) -> tuple[str, list[str], list[str]]:
    """What a file is; its numbers without a unit; warnings."""
    from feltmb.mechanism import load_action
    from feltmb.mechanism.parameters import notes_of_bare_numbers
    from feltmb.run.reach import unreached_lines
    from feltmb.run.results import load_run
    from feltmb.run.stroke import load_stroke
    from unmodeled.errors import InvalidParameter
    from unmodeled.files import is_file, read_toml, why_missing

    if not is_file(path):
        raise InvalidParameter(f"{path}: {why_missing(path)}")
    if path.suffix in (".nc", ".h5"):
        run = load_run(path)
        return f"run of {run.provenance.get('action')}, {len(run.time)} samples", [], []
    if path.suffix == ".csv" or _is_stroke(path, read_toml(path)):
        stroke = load_stroke(path)
        points = f"{len(stroke.time)} {'rows' if path.suffix == '.csv' else 'knots'}"
        return f"{stroke.kind} stroke, {points}, {stroke.duration:g} s", [], []
    action = load_action(path)
    text = f"mechanism, {len(action.coordinates)} coordinates"
    bare, warnings = notes_of_bare_numbers(action)
    if rest:
        text += f", comes to rest ({action.rest_iterations} iterations)"
        warnings += unreached_lines(action)
    return text, bare, warnings


def _is_stroke(path: Path, tables: Mapping[str, object]) -> bool:
    """Whether a file is a stroke: it has keys that only strokes, or only mechanisms, have."""
    from feltmb.mechanism import MechanismFile
    from feltmb.run.stroke.files import STROKE_KEYS
    from unmodeled.errors import InvalidParameter

    common = STROKE_KEYS & set(MechanismFile.model_fields)
    stroke = STROKE_KEYS - common
    mechanism = {*MechanismFile.model_fields, "extends", "values"} - common

    def number(known: set[str]) -> int:
        return sum(bool(difflib.get_close_matches(key, known, n=1, cutoff=0.7)) for key in tables)

    strokes, mechanisms = number(stroke), number(mechanism)
    if not strokes and not mechanisms:
        raise InvalidParameter(
            f"{path}: is neither a stroke nor a mechanism: a stroke has one of ramp, pulse, knots, "
            "a mechanism has bodies or extends"
        )
    return strokes > mechanisms


def in_si(bare: Sequence[str], file: str) -> str:
    """Text that lists numbers without a unit."""
    more = len(bare) - LISTED
    rest = f"; and {more} more: feltmb show {file} --values" if more > 0 else ""
    return f"numbers without a unit are in SI units: {'; '.join(bare[:LISTED])}{rest}"


@declare("new")
def new(path: Path = argument(), force: bool = FORCE) -> None:
    """Write a commented mechanism file to PATH: a pendulum hammer on felt, ready to run.

    `unmodeled new` writes the file that describes a measured file.
    """
    from unmodeled.errors import InvalidParameter

    if path.suffix != ".toml":
        raise InvalidParameter(f"new: got {str(path)!r}, expected a name that ends in .toml")
    template = resources.files("feltmb") / "params" / "template.toml.txt"
    save_text(path, template.read_text(encoding="utf-8"), force=force)


# --- other programs ------------------------------------------------------------------------------


@declare("fmu")
def fmu(
    action: str = argument(complete=actions),
    settings: tuple[str, ...] = SET,
    out: Path = option("The unit (.fmu).", metavar="FILE", required=True),
    fmi: Literal["3.0", "2.0"] = option(
        "Version of the interface.", click.Choice(["3.0", "2.0"]), "3.0"
    ),
    drive: Any = option(
        "Kind of the input; default: force, or torque of a mechanism with a motor.",
        click.Choice(["force", "motion", "key_motion", "torque", "motor_motion"]),
        words="--input",
    ),
    hold: Any = option(
        "Interpolation of the input over a step; default: linear for a motion, else zero "
        "(constant).",
        click.Choice(["zero", "linear"]),
    ),
    parameters: tuple[str, ...] = option(
        "Numbers that become parameters, such as 'contacts.06.*'; default: all.",
        words="--parameter",
        metavar="PATTERN",
    ),
    rtol: float = option("Relative tolerance.", Number(1e-13, 1e-2), 1e-6),
    force: bool = FORCE,
) -> None:
    """Export ACTION as a co-simulation unit (FMI). Its binary needs no Python."""
    from feltmb.run.fmu import export_fmu

    written = export_fmu(
        load_with_settings(action, settings),
        out,
        version=fmi,
        drive=drive,
        hold=hold,
        parameters=parameters or "*",
        rtol=rtol,
        force=force,
    )
    say_written(written)


@declare("live")
def live(
    mechanism: str = argument(complete=actions, default="steinway45_leaded"),
    records: tuple[Path, ...] = argument(
        click.Path(path_type=Path, exists=True, dir_okay=False), required=False
    ),
    no_browser: bool = option("Print the address without opening a browser."),
    port: int = option("Port on this computer; 0: a free port.", count(0, 65535), 0),
    *,
    as_json: bool,
) -> None:
    """Change and simulate MECHANISM in a browser, and compare it with RECORDS.

    MECHANISM is a packaged mechanism or a TOML file. The page reloads the file when you edit it.
    The address is secret and works only on this computer. Ctrl-C stops the server.
    """
    from feltmb.live import serve

    def say_address(address: str) -> None:
        if as_json:
            print_json({"address": address})
        else:
            say(address)

    serve(mechanism, records, browser=not no_browser, port=port, say=say_address)


@declare("page")
def page(
    action: str = argument(complete=actions),
    settings: tuple[str, ...] = SET,
    out: Path = option("The page (.html).", metavar="FILE", required=True),
    force: bool = FORCE,
) -> None:
    """Write ACTION as one HTML file that simulates in the browser. Users install nothing."""
    from feltmb.live.page import export_page

    say_written(export_page(load_with_settings(action, settings), out, force=force))
