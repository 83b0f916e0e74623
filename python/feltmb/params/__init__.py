"""Packaged data sets: mechanisms in this folder; strokes, targets, felts in subfolders."""

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

__all__ = ["folder", "names", "sources", "texts"]


def folder(kind: str = "") -> Path:
    """Folder of the packaged data of a type, such as ``"strokes"``; empty for mechanisms."""
    return Path(str(resources.files("feltmb") / "params")) / kind


def names(kind: str = "") -> list[str]:
    """Names of the packaged TOML files of a type, sorted."""
    return sorted(p.stem for p in folder(kind).glob("*.toml"))


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
