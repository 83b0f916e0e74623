"""``feltmb validate``: check input files."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import console, json_option, print_json


@click.command("validate")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--no-rest-pose", is_flag=True, help="Do not solve for the rest pose.")
@json_option
def command(files: tuple[Path, ...], no_rest_pose: bool, as_json: bool) -> None:
    """Check mechanisms (TOML), strokes (TOML or CSV) or saved runs (NetCDF).

    All faults of a file are listed at once; for a mechanism the rest pose is found too.
    """
    from feltmb.cli.common import complain
    from feltmb.errors import FeltmbError, InvalidParameter
    from feltmb.files import is_file, read_toml, why_missing
    from feltmb.mechanism import load_action
    from feltmb.run.results import load_run
    from feltmb.run.stroke import load_stroke

    screen = console()
    bad = 0
    found: list[dict[str, object]] = []
    for path in files:
        try:
            if not is_file(path):
                raise InvalidParameter(f"{path}: {why_missing(path)}")
            if path.suffix == ".csv":
                stroke = load_stroke(path)
                text = f"{stroke.kind} stroke, {len(stroke.time)} rows, {stroke.duration:g} s"
            elif path.suffix in (".nc", ".h5"):
                run = load_run(path)
                text = f"run of {run.provenance.get('action')}, {len(run.time)} samples"
            elif {"ramp", "pulse", "knots"} & set(read_toml(path)):
                stroke = load_stroke(path)
                text = f"{stroke.kind} stroke, {len(stroke.time)} knots, {stroke.duration:g} s"
            else:
                action = load_action(path)
                text = f"mechanism, {len(action.coordinates)} coordinates"
                if not no_rest_pose:
                    iterations = action.rest_iterations
                    text += f", comes to rest ({iterations} iterations)"
            found.append({"file": str(path), "ok": True, "text": text})
            if not as_json:
                screen.print(f"{path}: ok: {text}")
        except FeltmbError as error:
            found.append({"file": str(path), "ok": False, "text": str(error)})
            if not as_json:
                complain(str(error))
            bad += 1
    if as_json:
        print_json(found)
    if bad:
        raise InvalidParameter(f"{bad} of {len(files)} files have faults")
