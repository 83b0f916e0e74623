"""Finds and reads mechanism files, including the files that they extend."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from feltmb import params
from feltmb.fiber.material import load_material
from feltmb.mechanism.values import apply_values
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter, shortened
from unmodeled.files import MOST_EXTENDS, beside, named_file, read_toml


def packaged_actions() -> list[str]:
    """Names of the packaged mechanisms."""
    return params.names()


def resolve(name_or_path: str | Path) -> Path:
    """File of a packaged mechanism; any other path is returned unchanged."""
    if Path(name_or_path).suffix == ".py":
        raise InvalidParameter(
            f"mechanism {shortened(repr(str(name_or_path)))} is a Python file, expected a TOML "
            "file or a packaged name; a Python model is no mechanism: it cannot be exported or "
            "played, feltmb gap takes it"
        )
    return params.find(name_or_path, "", "mechanism")


@checked
def files_of(path: Path) -> tuple[Path, ...]:
    """Files of a mechanism: itself, the files that it extends, and their felts.

    As many as its faults permit to find; a missing file is included.
    """
    opened: list[Path] = []
    with contextlib.suppress(Error):
        load_raw(path, resolve, opened=opened)
    return tuple(dict.fromkeys(opened))


@checked
def load_raw(
    path: Path,
    resolve: Callable[[str], Path],
    seen: tuple[Path, ...] = (),
    opened: list[Path] | None = None,
) -> dict[str, Any]:
    """Tables of a file merged with the tables that it extends; ``resolve`` finds a base by name.

    Files are appended to ``opened`` before they are read.
    """
    if opened is not None:
        opened.append(path)
    raw = _felts_in_place(read_toml(path), path.parent, str(path), opened)
    if "extends" not in raw:
        return raw
    unknown = sorted(set(raw) - {"schema", "name", "about", "source", "extends", "values"})
    if unknown:
        raise InvalidParameter(
            f"{path}: a file with 'extends' holds name, about, source and [values] only; "
            f"got {shortened(', '.join(unknown))}"
        )
    base = raw["extends"]
    if not isinstance(base, str):
        raise InvalidParameter(
            f"{path}: extends: got {shortened(repr(base))}, expected a name or a path"
        )
    if len(seen) >= MOST_EXTENDS:
        raise InvalidParameter(
            f"{seen[0]}: extends: leads over more than {MOST_EXTENDS} files, expected fewer"
        )
    named = named_file(path.parent, base, f"{path}: extends")
    base_path = named if isinstance(named, Path) else resolve(named)
    if base_path.resolve() in [p.resolve() for p in (*seen, path)]:
        raise InvalidParameter(f"{path}: extends {base!r}, which leads back to itself")
    merged = load_raw(base_path, resolve, (*seen, path), opened)
    for key in ("name", "about", "source"):
        if key in raw:
            merged[key] = raw[key]
    values = raw.get("values", {})
    if not isinstance(values, Mapping):
        raise InvalidParameter(f"{path}: values: expected a table of dotted paths")
    for key, value in values.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            inner = f"{key}.{next(iter(value), 'KEY')}"
            raise InvalidParameter(
                f'{path}: values.{key}: got a table; write paths in quotes, such as "{inner}" = ...'
            )
    return apply_values(merged, values, str(path))


@checked
def without_paths(raw: dict[str, Any], origin: str) -> dict[str, Any]:
    """The tables, if they refer to no file: tables of a saved run contain the felts."""
    return _felts_in_place(raw, None, origin)


def _felts_in_place(
    raw: dict[str, Any], folder: Path | None, origin: str, opened: list[Path] | None = None
) -> dict[str, Any]:
    """Replace references to felt files by their tables, so that the mechanism is complete."""

    def whole(node: Any) -> Any:
        if not isinstance(node, Mapping):
            return node
        out = {key: whole(value) for key, value in node.items()}
        felt = out.get("felt")
        if isinstance(felt, str) and felt.endswith(".toml"):
            if folder is None:
                raise InvalidParameter(f"{origin}: felt {felt[:200]!r}: a saved run names no file")
            path = beside(folder, felt, f"{origin}: felt")
            if opened is not None:
                opened.append(path)
            out["felt"] = load_material(path).model_dump(
                mode="json", by_alias=True, exclude_none=True
            )
        return out

    out = dict(raw)
    for key in ("contacts", "values"):
        if isinstance(raw.get(key), Mapping):
            out[key] = whole(raw[key])
    return out
