"""Published values that are compared with a touch."""

from __future__ import annotations

from typing import Any

from feltmb import params
from unmodeled.files import read_toml


def published_numbers() -> dict[str, dict[str, Any]]:
    """Key of a row of the touch -> published range or value."""
    path = params.folder("touch") / "published.toml"
    return {row["key"]: row for row in read_toml(path)["values"]}
