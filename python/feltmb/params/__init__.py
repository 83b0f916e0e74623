"""Packaged data sets: mechanisms here, strokes, studies, targets, felts in folders beside them."""

from importlib import resources
from pathlib import Path

__all__ = ["folder", "names"]


def folder(kind: str = "") -> Path:
    """Folder of the packaged data of a kind, such as ``"strokes"``; empty for mechanisms."""
    return Path(str(resources.files("feltmb") / "params")) / kind


def names(kind: str = "") -> list[str]:
    """Names of the packaged TOML files of a kind, sorted."""
    return sorted(p.stem for p in folder(kind).glob("*.toml"))
