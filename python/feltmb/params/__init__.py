"""Packaged data sets: mechanisms in this folder; strokes, targets, felts in subfolders."""

import tomllib
from importlib import resources
from pathlib import Path

__all__ = ["folder", "names", "texts"]


def folder(kind: str = "") -> Path:
    """Folder of the packaged data of a type, such as ``"strokes"``; empty for mechanisms."""
    return Path(str(resources.files("feltmb") / "params")) / kind


def names(kind: str = "") -> list[str]:
    """Names of the packaged TOML files of a type, sorted."""
    return sorted(p.stem for p in folder(kind).glob("*.toml"))


def texts(key: str, kind: str = "") -> dict[str, str]:
    """A text at the top of each packaged file of a type, such as ``"about"``, by name."""
    files = {name: folder(kind) / f"{name}.toml" for name in names(kind)}
    return {name: tomllib.loads(p.read_text("utf-8"))[key] for name, p in files.items()}
