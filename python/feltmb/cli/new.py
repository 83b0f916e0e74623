"""``feltmb new``: a commented template."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import click

from feltmb.cli.common import force_option, say_written, tables_as_json


@click.command("new")
@click.argument("path", type=click.Path(path_type=Path))
@force_option
@tables_as_json
def command(path: Path, force: bool) -> None:
    """Write a commented mechanism file to PATH: a pendulum hammer on felt, ready to run."""
    from feltmb.errors import InvalidParameter
    from feltmb.files import write_text

    if path.suffix != ".toml":
        raise InvalidParameter(f"new: got {str(path)!r}, expected a name that ends in .toml")
    template = resources.files("feltmb") / "params" / "template.toml.txt"
    say_written(write_text(path, template.read_text(encoding="utf-8"), force=force))
