"""``feltmb regulate``, ``touch``, ``repeat``, ``wear``, ``symptom``: what a technician does."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feltmb.cli.completing import actions, packaged
from feltmb.cli.settings import SET, load_with_settings
from unmodeled.cli.options import (
    FORCE,
    FileName,
    FolderName,
    Number,
    argument,
    declare,
    option,
    pairs,
    picture,
    positive,
)
from unmodeled.cli.screen import (
    check_targets,
    complain,
    console,
    print_json,
    save_figure,
    save_text,
    say_written,
    show,
    table,
    working,
)

if TYPE_CHECKING:
    from feltmb.action.regulate import Regulation
    from feltmb.action.repetition import Repetition
    from feltmb.action.touch import Touch, TouchRow
    from feltmb.action.wearing import Wear

#: Millimeters of an inch.
INCH = 25.4
INCHES = option("Print inches beside millimeters.")

# --- regulation ----------------------------------------------------------------------------------


@declare("regulate")
def regulate(
    action: str = argument(complete=actions),
    targets: str | None = option(
        "Packaged name or TOML file; default: the packaged targets of the mechanism's name.",
        metavar="FILE",
        complete=packaged("regulation"),
    ),
    own: tuple[str, ...] = option(
        "Target of a step, such as let-off=4mm or key-dip=10mm.",
        words="--target",
        metavar="STEP=VALUE",
    ),
    out: Path | None = option(
        "Write the regulated mechanism, with its provenance, to this TOML file.", FileName(".toml")
    ),
    inch: bool = INCHES,
    settings: tuple[str, ...] = SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Regulate ACTION: key dip, strike, lost motion, let-off, damper, backcheck.

    Each step measures one value and turns one screw. The steps are repeated until all targets are
    met. If a target cannot be met, the table gives the reason, no file is written, and the exit
    code is 1.
    """
    from feltmb.action.regulate import default_targets, load_targets, regulate
    from unmodeled.errors import Error

    mechanism = load_with_settings(action, settings)
    wanted = load_targets(targets) if targets is not None else None
    if own:
        wanted = (wanted or default_targets(mechanism)).with_targets(
            pairs("--target", own, "STEP=VALUE, such as let-off=4mm")
        )
    check_targets(out, force=force)
    with working("measuring") as progress:
        result = regulate(mechanism, wanted, progress=progress)
    if as_json:
        print_json(result.as_dict())
    else:
        screen = console()
        screen.print(regulation_table(result, inch=inch))
        turned = screw_table(result) if result.provenance["screws"] else "No screw was turned."
        screen.print(turned)
        for row in result.table:
            if row.before is None and row.holds:
                screen.print(f"{row.name} could not be measured before: {row.why}.")
        for note in result.notes:
            screen.print(f"Note: {note}.")
    if not result.converged:
        *others, last = [
            f"{row.name}: target {row.target} {row.unit}".rstrip() + f" is not met: {row.why}"
            for row in result.unmet
        ]
        for other in others:
            complain(other)
        raise Error(f"{last}\nnothing was written" if out is not None else last)
    save_text(out, result.to_toml, force=force)


def _value(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def regulation_table(result: Regulation, *, inch: bool = False) -> Any:
    """Table of each step: target, before and after."""

    def unit(unit: str, value: float | None) -> str:
        told = inch and unit == "mm" and value is not None
        return f"mm = {value / INCH:.3f} in" if told and value is not None else unit

    counts = ", ".join(f"{number} {what}" for what, number in result.counts.items())
    rounds = f"{result.rounds} round" + ("" if result.rounds == 1 else "s")
    rows = [
        (r.letter, r.name, r.target, _value(r.before), _value(r.after), unit(r.unit, r.after),
         "holds" if r.holds else "NOT MET")
        for r in result.table
    ]  # fmt: skip
    return table(
        f"regulation of {result.provenance['action']}",
        "| step | >target | >before | >after | unit |",
        rows,
        f"{rounds}; {counts}; targets {result.provenance['targets']}",
    )


def screw_table(result: Regulation) -> Any:
    """Table of the turned screws and their changes."""
    rows = [
        (r.name, r.screw, r.moved, r.path, r.value_before, r.value_after)
        for r in result.table
        if r.screw and r.turned
    ]
    return table("screws", "step | screw | >turned | value changed | before | after", rows)


# --- touch ---------------------------------------------------------------------------------------


@declare("touch")
def touch(
    action: str = argument(complete=actions),
    folder: Path | None = option(
        "Draw touch_static.png and touch_dynamic.png in this folder; with --set or --before, of "
        "both mechanisms.",
        FolderName(),
        words="--plot",
    ),
    before: str | None = option(
        "Mechanism for comparison; default with --set: ACTION without changes.",
        metavar="ACTION",
        complete=actions,
    ),
    inch: bool = INCHES,
    settings: tuple[str, ...] = SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Compute the touch of ACTION: weights of a slow press and release, and series of strikes.

    Static values are computed without inertia. Pressed and struck strikes are simulated in threads.
    The table contains published ranges, most of them of grand pianos. With --set or --before it
    shows the values of both mechanisms.
    """
    from feltmb.action.touch import touch
    from unmodeled.files import check_writable, make_folder

    mechanism = load_with_settings(action, settings)
    if before is None and settings:
        before = action
    former = load_with_settings(before) if before is not None else None
    if folder is not None:
        make_folder(folder)
        for name in ("touch_static.png", "touch_dynamic.png"):
            check_writable(folder / name, force=force)
    with working("measuring") as progress:
        earlier = touch(former, progress=progress) if former is not None else None
        result = touch(mechanism, progress=progress)
    if as_json:
        print_json(result.as_dict() | ({} if earlier is None else {"before": earlier.as_dict()}))
    else:
        _print_touch(result, earlier, inch=inch)
    if folder is not None:
        for path in result.plot(folder, before=earlier, force=force):
            say_written(path)


def _print_touch(result: Touch, earlier: Touch | None, *, inch: bool) -> None:
    screen = console()
    screen.print(touch_table(result, earlier, inch=inch))
    if result.weights is not None:
        share = result.weights.hammer_share
        screen.print(
            f"The key carries the share {share:.2f} of strike weight times hammer / key "
            "travel. A level shank gives about 1; that of an upright stands, and its hammer "
            "hangs on the center pin."
        )
    screen.print(strike_table(result))
    for note in result.static.notes:
        screen.print(f"Note: {note}")
    for i, source in enumerate(_sources(result), start=1):
        screen.print(f"[{i}] {source}")
    for strike in result.strikes:
        if strike.failure:
            unit = "N" if strike.kind == "pressed" else "m/s"
            screen.print(f"{strike.kind} {strike.level:g} {unit}: {strike.failure}")


def _sources(result: Touch) -> list[str]:
    return list(dict.fromkeys(row.source for row in result.rows if row.source))


def touch_table(result: Touch, before: Touch | None = None, *, inch: bool = False) -> Any:
    """Simulated and published values, forces in gram-force; ``before``: of another mechanism."""
    title = f"touch of {result.action.name}"
    if before is not None and before.action.name != result.action.name:
        title += f", before: {before.action.name}"
    low, high = (1e3 * w for w in result.static.window)
    return table(
        title,
        f"| {'>here' if before is None else '>before | >after'} | unit | >published | |",
        [_touch_cells(row, result, before, inch=inch) for row in result.rows],
        f"weights: mean over {low:.2f} to {high:.2f} mm of key travel, damper lifted; "
        "empty: nothing published",
    )


def _touch_cells(row: TouchRow, result: Touch, before: Touch | None, *, inch: bool) -> list[str]:
    from feltmb.action.touch.pictures import GRAM_FORCE

    digits = row.digits
    unit = "" if row.unit == "1" else row.unit
    numbers = [_value(row.value, digits)]
    if before is not None:
        numbers.insert(
            0, next((_value(r.value, digits) for r in before.rows if r.key == row.key), "-")
        )
    elif row.value is not None and row.unit == "gf":
        unit = f"gf = {row.value * GRAM_FORCE:.3f} N"
    if inch and row.value is not None and row.unit == "mm":
        unit = f"mm = {row.value / INCH:.3f} in"
    published = "" if row.published is None else f"{row.published:g}"
    if row.low is not None and row.high is not None:
        published = f"{row.low:g} to {row.high:g}"
    source = f"[{_sources(result).index(row.source) + 1}]" if row.source else ""
    return [row.name, *numbers, unit, published, row.verdict, source]


def strike_table(result: Touch) -> Any:
    """Table with one row per strike."""

    def cell(value: float | None, factor: float, digits: int) -> str:
        return _value(None if value is None else value * factor, digits)

    rows = [
        (
            strike.kind,
            f"{strike.level:g}",
            "N" if strike.kind == "pressed" else "m/s",
            cell(strike.hammer_speed, 1.0, 3),
            cell(strike.key_speed, 1.0, 3),
            cell(strike.travel_time, 1e3, 1),
            cell(strike.bottom_after_string, 1e3, 1),
        )
        for strike in result.strikes
    ]
    fits = ", ".join(
        f"{kind} {1e3 * a:.1f} ms v^{b:.3f} (to {100 * worst:.0f} %)"
        for kind, (a, b, worst) in result.fits.items()
    )
    heads = "| >level | unit | >impact m/s | >key m/s | >travel ms | >bottom - string ms"
    return table("strikes", heads, rows, f"travel time: {fits}" if fits else None)


# --- repetition ----------------------------------------------------------------------------------


@declare("repeat")
def repeat(
    action: str = argument(complete=actions),
    forces: tuple[float, ...] = option(
        "Largest force of the finger [N]; default: 4 (soft) and 10 (firm).",
        positive("N"),
        words="--finger",
    ),
    returns: tuple[float, ...] = option(
        "Share of the key travel that the key returns between presses, such as 50%; default: "
        "100 %, 75 %, 50 %.",
        Number(0, 1, min_open=True),
        words="--return",
    ),
    highest: float = option(
        "Rate at which the test ends, presses per second.", Number(3, 30, min_open=True), 16.0
    ),
    image: Path | None = picture(
        "Draw the rates with their reasons, and the run with the first failure."
    ),
    settings: tuple[str, ...] = SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Find the highest rate up to which every press of the key of ACTION is a note.

    A finger with a mass and a limited force presses faster and faster. The table tells why the
    first press fails: the key is too slow, the hammer has not come back, or the jack is not back
    under the hammer. Ctrl-C ends the test with what was found until then.
    """
    from feltmb.action.repetition import FORCES, RETURNS, repeat

    check_targets(pictures=(image,), force=force)
    result = repeat(
        load_with_settings(action, settings),
        forces=forces or FORCES,
        returns=returns or RETURNS,
        highest=highest,
    )
    if as_json:
        print_json(result.as_dict())
    else:
        console().print(repetition_table(result))
    if result.interrupted:
        raise KeyboardInterrupt("the rows that say so are lower bounds")
    save_figure(image, result.plot, force=force)


def repetition_table(result: Repetition) -> Any:
    """Highest rates with their reasons."""
    from feltmb.action.repetition import AUDIBLE, BACK, MASS

    rows = [
        (
            f"{row.force:g}",
            f"{1e3 * row.key_return * result.travel:.1f}",
            row.rate_text,
            *("-" if math.isnan(v) else f"{v:.2f}" for v in (row.impact_speed, row.weakest)),
            row.sentence,
        )
        for row in result.rows
    ]
    return table(
        f"repetition of {result.action.name}",
        ">finger N | >key returns mm | >highest rate 1/s | >first strike m/s | "
        ">weakest strike m/s | above this rate",
        rows,
        f"finger of {1e3 * MASS:g} g; a press is a note if the hammer came back by "
        f"{100.0 * BACK:.0f} % of its way and strikes with {AUDIBLE:g} m/s",
    )


# --- wear and symptoms ---------------------------------------------------------------------------


@declare("wear")
def wear(
    action: str = argument(complete=actions),
    parts: tuple[str, ...] = option(
        "Part of the mechanism, such as '*jack*'; default: all, which takes minutes.",
        words="--part",
        metavar="PATTERN",
    ),
    screws: bool = option("Also turn each screw of the regulation both ways."),
    image: Path | None = picture("Draw all changes in one picture."),
    out: Path | None = option(
        "Write all numbers as a table (CSV) or as JSON.", FileName(".csv", ".json"), metavar="FILE"
    ),
    settings: tuple[str, ...] = SET,
    force: bool = FORCE,
    *,
    as_json: bool,
) -> None:
    """Change each part of ACTION alone, and measure the regulation, touch and repetition.

    Each felt is 0.2 and 0.5 mm thinner, or 20 % harder; each friction is doubled; each spring is
    20 % weaker; each bushing is swollen; each strap is missing.
    """
    from feltmb.action.wearing import wear

    check_targets(out, pictures=(image,), force=force)
    result = wear(load_with_settings(action, settings), parts=parts, screws=screws)
    if as_json:
        print_json(result.as_dict())
    else:
        console().print(wear_table(result))
    if out is not None and out.suffix.lower() == ".csv":
        save_text(out, result.frame.to_csv(index=False), force=force)
    else:
        text = json.dumps(result.as_dict(), indent=1, ensure_ascii=False) + "\n"
        save_text(out, text, force=force)
    save_figure(image, result.plot, force=force)


def wear_table(result: Wear) -> Any:
    """Numbers of the mechanism, and their changes by each variant."""
    from feltmb.action.wearing import MATTERS, NUMBERS, WEAR_NUMBERS

    def text(name: str, value: float, sign: str = "") -> str:
        if not math.isfinite(value):
            return "none"
        places = max(0, 1 - math.floor(math.log10(MATTERS[name])))
        shown = f"{round(value, places) + 0.0:{sign}.{places}f}"
        return "" if sign and not float(shown) else shown

    def rows() -> Iterator[list[str]]:
        yield ["as it is", "", *(text(n, result.base[n]) for n in WEAR_NUMBERS)]
        for variant, numbers in result.rows:
            changes = (text(n, numbers[n] - result.base[n], "+") for n in WEAR_NUMBERS)
            yield [variant.part, variant.change, *changes]

    heads = " | ".join(f">{NUMBERS[n][0]} {NUMBERS[n][1]}" for n in WEAR_NUMBERS)
    return table(
        f"wear of {result.name}",
        f"part | change | {heads}",
        rows(),
        "first row: numbers; then their changes; empty: no change; none: the number no longer "
        "exists",
    )


def _symptoms(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> list[str]:
    from feltmb.action.symptoms import load_symptoms

    return [name for name in load_symptoms() if name.startswith(incomplete)]


@declare("symptom")
def symptom(
    name: str | None = argument(complete=_symptoms),
    table: Path | None = option(
        "Table of your own action: feltmb wear ACTION --screws -o FILE.json; default: that of the "
        "packaged steinway45_leaded.",
        click.Path(dir_okay=False, path_type=Path),
        words="--wear",
        metavar="FILE",
    ),
    *,
    as_json: bool,
) -> None:
    """List the symptoms of an action, or show the causes of the symptom NAME.

    The causes are in order of likelihood, computed by simulation with each part changed alone.
    """
    from feltmb.action.symptoms import load_symptoms, packaged_wear, symptom
    from feltmb.action.wearing import Wear

    wear = packaged_wear() if table is None else Wear.read(table)
    if name is None:
        known = load_symptoms()
        if as_json:
            print_json({key: d.model_dump() for key, d in known.items()})
        else:
            listed = [(key, d.what, ", ".join(d.also)) for key, d in known.items()]
            show("symptoms", "name | what it is | also called", listed)
        return
    found = symptom(name, wear)
    if as_json:
        print_json(found.as_dict())
        return
    screen = console()
    for line in (found.what, f"Test: {found.test}", _numbers(found, wear.name)):
        screen.print(line)
    rows = [(c.part, c.change, f"{100.0 * c.share:.0f} %", c.remedy) for c in found.causes]
    if found.beyond:
        rows.append(("not in the model", "", f"{100.0 * found.beyond_share:.0f} %", "See below"))
    show(f"causes of {found.name}", "part | change that suffices | >likelihood | what to do", rows)
    if found.screws:
        screen.print(f"Screws that take it back: {'; '.join(found.screws)}.")
    if found.beyond:
        screen.print(f"Not in the model, look for it as well: {'; '.join(found.beyond)}.")


def _numbers(found: Any, action: str) -> str:
    there = found.value >= found.limit if found.worse == "more" else found.value <= found.limit
    text = f"Number: {found.number}, {found.value:.3g} {found.unit} in {action}; "
    if there:
        return f"{text}this action has the symptom already (limit {found.limit:.3g} {found.unit})."
    return f"{text}the symptom is {found.worse} than {found.limit:.3g} {found.unit}."
