"""The library as a table for people."""

from __future__ import annotations

from feltmb.adapters.library import Entry, Library
from feltmb.units import unit_suffix

__all__ = ["effects_markdown", "tolerances_markdown"]


def _size(entry: Entry) -> str:
    sign = {1: "+", -1: "-", 0: "±"}[entry.sign]
    unit = entry.unit.replace("{input_unit}", "N")
    return f"{sign}{entry.magnitude:.3g}" + unit_suffix(unit)


def _shapes(entry: Entry) -> str:
    if not entry.shape_path:
        return ""
    values = ", ".join(f"{v:g}" for v in entry.shapes if v is not None)
    return f"{entry.shape_path.rpartition('.')[2]} {values} {entry.shape_unit}".strip()


def effects_markdown(library: Library) -> str:
    """Table of effects: name, mechanism, magnitude, kind, shapes."""
    rows = ["| effect | description | magnitude | kind | shapes |", "|---|---|---|---|---|"]
    for e in library.effects:
        rows.append(f"| `{e.name}` | {e.mechanism} | {_size(e)} | {e.kind} | {_shapes(e)} |")
    return "\n".join(rows) + "\n"


def tolerances_markdown(library: Library) -> str:
    """Table of tolerances: name, standard deviation, source."""
    rows = ["| parameter | standard deviation | source |", "|---|---|---|"]
    for e in library.tolerances:
        magnitude = f"{100 * e.magnitude:g} %" if e.unit == "1" else f"{e.magnitude:.3g} {e.unit}"
        rows.append(f"| `{e.name}` ({e.mechanism}) | {magnitude} | {e.source} |")
    return "\n".join(rows) + "\n"
