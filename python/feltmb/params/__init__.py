"""Packaged data sets: mechanisms in this folder; strokes, targets, felts in subfolders."""

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from unmodeled.errors import InvalidParameter, near_names, shown
from unmodeled.files import is_file, why_missing

__all__ = ["find", "folder", "names", "sources", "texts"]


def folder(kind: str = "") -> Path:
    """Folder of the packaged data of a type, such as ``"strokes"``; empty for mechanisms."""
    return Path(str(resources.files("feltmb") / "params")) / kind


def names(kind: str = "") -> list[str]:
    """Names of the packaged TOML files of a type, sorted."""
    return sorted(p.stem for p in folder(kind).glob("*.toml"))


def find(
    name_or_path: str | Path, kind: str, what: str, *, beside: Path = Path(), forms: str = "TOML"
) -> Path:
    """File of packaged data by its name, or any other file by its path.

    Parameters
    ----------
    name_or_path
        Name of packaged data, or path of a file.
    kind
        Folder of the packaged data, see :func:`folder`.
    what
        What it is, for the message, such as ``"stroke"``.
    beside
        Folder of a relative path.
    forms
        Kinds of files, for the message.

    Raises
    ------
    InvalidParameter
        There is neither.
    """
    text, known = str(name_or_path), names(kind)
    if text in known:
        return folder(kind) / f"{text}.toml"
    path = beside / text
    if is_file(path):
        return path
    hint = f"or give the path of a {forms} file{near_names(text, known)}"
    if path.suffix or len(path.parts) > 1:
        hint = why_missing(path)
    raise InvalidParameter(
        f"{what} {shown(text)} is unknown; packaged are {', '.join(known)}; {hint}"
    )


def texts(key: str, kind: str = "") -> dict[str, str]:
    """A text at the top of each packaged file of a type, such as ``"about"``, by name."""
    return {name: table[key] for name, table in _tables(kind).items()}


def sources() -> dict[str, str]:
    """Where the numbers of each packaged mechanism come from, by name."""
    found = _tables("")
    return {n: t["source"]["cite"] if "source" in t else t["extends"] for n, t in found.items()}


def _tables(kind: str) -> dict[str, dict[str, Any]]:
    files = {name: folder(kind) / f"{name}.toml" for name in names(kind)}
    return {name: tomllib.loads(path.read_text("utf-8")) for name, path in files.items()}
