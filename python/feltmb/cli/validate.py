"""``feltmb validate``: check input files."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
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


@click.command("validate")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--no-rest-pose", is_flag=True, help="Do not compute the rest pose.")
@json_option
def command(files: tuple[Path, ...], no_rest_pose: bool, as_json: bool) -> None:
    """Check mechanisms (TOML), strokes (TOML or CSV) or saved runs (NetCDF).

    All faults of a file are listed together. For a mechanism the rest pose is also computed. A
    warning is given if an infinite line carries a contact beyond its body in this pose.
    """
    from feltmb.cli.common import complain
    from feltmb.errors import FeltmbError, InvalidParameter
    from feltmb.files import is_file, read_toml, why_missing
    from feltmb.mechanism import load_action
    from feltmb.run.reach import unreached_lines
    from feltmb.run.results import load_run
    from feltmb.run.stroke import load_stroke

    screen = console()
    bad = 0
    found: list[dict[str, object]] = []
    for path in files:
        warnings: list[str] = []
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
                if not no_rest_pose:
                    iterations = action.rest_iterations
                    text += f", comes to rest ({iterations} iterations)"
                    warnings = unreached_lines(action)
            found.append({"file": str(path), "ok": True, "text": text})
            if warnings:
                found[-1]["warnings"] = warnings
            if not as_json:
                screen.print(f"{path}: ok: {text}")
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
