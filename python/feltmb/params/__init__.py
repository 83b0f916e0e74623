"""Packaged data sets: mechanisms in this folder; strokes, studies, targets, felts in subfolders."""

from importlib import resources
from pathlib import Path

__all__ = ["folder", "names"]


def folder(kind: str = "") -> Path:
    """Folder of the packaged data of a type, such as ``"strokes"``; empty for mechanisms."""
    return Path(str(resources.files("feltmb") / "params")) / kind


def names(kind: str = "") -> list[str]:
    """Names of the packaged TOML files of a type, sorted."""
    return sorted(p.stem for p in folder(kind).glob("*.toml"))
