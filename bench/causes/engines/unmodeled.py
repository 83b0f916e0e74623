"""``unmodeled`` at its defaults; at the limit it answers by its fits so far."""

from __future__ import annotations

import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import unmodeled
from causes.cases import opened

__all__ = ["run"]


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """What a diagnosis tells of a case."""
    model, effects, records = opened(folder)
    end = time.process_time() + 0.85 * seconds

    def watch(_: unmodeled.Progress) -> None:
        if time.process_time() > end:
            raise unmodeled.Stop

    # Its own limit is one of wall time, which a busy machine would reach early.
    options = unmodeled.Options(seconds=30.0 * seconds)
    result = unmodeled.diagnose(model, effects, records, options=options, progress=watch)

    def name(cause: Any) -> str:
        return f"parameter:{cause.cause}" if cause.parameter else str(cause.cause)

    told = [*result.named, *(c for group in result.classes for c in group)]
    return {
        "version": version("unmodeled"),
        "verdict": str(result.verdict.value).upper(),
        "named": [name(c) for c in result.named],
        "classes": [[name(c) for c in group] for group in result.classes],
        "supported": [name(c) for c in result.supported],
        "moved": [p.name for p in result.parameters if not p.low <= p.tabulated <= p.high],
        "parameters": {p.name: (p.value, p.low, p.high) for p in result.parameters},
        "magnitudes": {c.cause: (c.magnitude, c.low, c.high) for c in told if not c.parameter},
        "said": ", ".join(r.value for r in result.reasons),
        "predicted": result.worst.held_out_explained,
    }
