"""``feltmb validate``: check input files."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from feltmb.cli.common import console, json_option, print_json


def _is_stroke(path: Path, tables: Mapping[str, object]) -> bool:
    """Whether a file is a stroke: it has keys that only strokes, or only mechanisms, have."""
    from feltmb.errors import InvalidParameter
    from feltmb.mechanism import MechanismFile
    from feltmb.run.stroke.files import STROKE_KEYS

    common = STROKE_KEYS & set(MechanismFile.model_fields)
    stroke = STROKE_KEYS - common
    mechanism = {*MechanismFile.model_fields, "extends", "values"} - common

    def count(known: set[str]) -> int:
        return sum(bool(difflib.get_close_matches(key, known, n=1, cutoff=0.7)) for key in tables)

    strokes, mechanisms = count(stroke), count(mechanism)
    if not strokes and not mechanisms:
        raise InvalidParameter(
            f"{path}: is neither a stroke nor a mechanism: a stroke has one of ramp, pulse, knots, "
            "a mechanism has bodies or extends"
        )
    return strokes > mechanisms


#: Numbers without a unit that are listed.
LISTED = 6


def in_si(bare: Sequence[str], file: str) -> str:
    """Text that lists numbers without a unit."""
    more = len(bare) - LISTED
    rest = f"; and {more} more: feltmb show {file} --values" if more > 0 else ""
    return f"numbers without a unit are in SI units: {'; '.join(bare[:LISTED])}{rest}"


@click.command("validate")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--no-rest-pose", is_flag=True, help="Do not compute the rest pose.")
@json_option
def command(files: tuple[Path, ...], no_rest_pose: bool, as_json: bool) -> None:
    """Check mechanisms (TOML), strokes (TOML or CSV) or saved runs (NetCDF).

    All faults of a file are listed together. For a mechanism the rest pose is also computed. A
    warning is given if an infinite line carries a contact beyond its body in this pose. Numbers
    without a unit are listed with the SI unit that they have, with a warning if the file gives
    another unit to the same quantity elsewhere.
    """
    from feltmb.cli.common import complain
    from feltmb.errors import FeltmbError, InvalidParameter
    from feltmb.files import is_file, read_toml, why_missing
    from feltmb.mechanism import load_action
    from feltmb.mechanism.parameters import told_bare_numbers
    from feltmb.run.reach import unreached_lines
    from feltmb.run.results import load_run
    from feltmb.run.stroke import load_stroke

    screen = console()
    bad = 0
    found: list[dict[str, object]] = []
    for path in files:
        warnings: list[str] = []
        bare: list[str] = []
        try:
            if not is_file(path):
                raise InvalidParameter(f"{path}: {why_missing(path)}")
            if path.suffix == ".csv":
                stroke = load_stroke(path)
                text = f"{stroke.kind} stroke, {len(stroke.time)} rows, {stroke.duration:g} s"
            elif path.suffix in (".nc", ".h5"):
                run = load_run(path)
                text = f"run of {run.provenance.get('action')}, {len(run.time)} samples"
            elif _is_stroke(path, read_toml(path)):
                stroke = load_stroke(path)
                text = f"{stroke.kind} stroke, {len(stroke.time)} knots, {stroke.duration:g} s"
            else:
                action = load_action(path)
                text = f"mechanism, {len(action.coordinates)} coordinates"
                bare, warnings = told_bare_numbers(action)
                if not no_rest_pose:
                    iterations = action.rest_iterations
                    text += f", comes to rest ({iterations} iterations)"
                    warnings += unreached_lines(action)
            found.append({"file": str(path), "ok": True, "text": text})
            if warnings:
                found[-1]["warnings"] = warnings
            if bare:
                found[-1]["si"] = bare
            if not as_json:
                screen.print(f"{path}: ok: {text}")
                if bare:
                    screen.print(in_si(bare, str(path)))
                for warning in warnings:
                    complain(f"warning: {path}: {warning}")
        except FeltmbError as error:
            found.append({"file": str(path), "ok": False, "text": str(error)})
            if not as_json:
                complain(str(error))
            bad += 1
    if as_json:
        print_json(found)
    if bad:
        raise InvalidParameter(f"{bad} of {len(files)} files have faults")
