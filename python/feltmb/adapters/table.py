"""The library as a table for people."""

from __future__ import annotations

import os

from feltmb.adapters.library import Entry, Library
from feltmb.units import unit_suffix

__all__ = ["effects_markdown", "tolerances_markdown"]


def _sizes(entries: list[Entry]) -> str:
    """Magnitudes of a family: one, or the smallest and the largest of each unit."""
    by_unit: dict[str, list[float]] = {}
    for e in entries:
        by_unit.setdefault(e.unit.replace("{input_unit}", "N"), []).append(e.magnitude)
    texts = []
    for unit, sizes in by_unit.items():
        ends = dict.fromkeys(f"{v:.3g}" for v in (min(sizes), max(sizes)))
        texts.append(" to ".join(ends) + unit_suffix(unit))
    return {1: "+", -1: "-", 0: "±"}[entries[0].sign] + ", ".join(texts)


def _shapes(entry: Entry) -> str:
    if not entry.shape_path:
        return ""
    values = ", ".join(f"{v:g}" for v in entry.shapes if v is not None)
    return f"{entry.shape_path.rpartition('.')[2]} {values} {entry.shape_unit}".strip()


def _common(texts: list[str]) -> str:
    """What sentences have in common, with ... for the part that is named."""
    words = [text.split() for text in texts]
    begin = os.path.commonprefix(words)
    end = os.path.commonprefix([w[len(begin) :][::-1] for w in words])[::-1]
    middle = [] if all(len(w) == len(begin) + len(end) for w in words) else ["..."]
    return " ".join([*begin, *middle, *end])


def effects_markdown(library: Library) -> str:
    """Table of effects by family: name, parts, what they have in common, magnitudes, kind."""
    families: dict[str, list[Entry]] = {}
    for e in library.effects:
        families.setdefault(e.name.partition(".")[0], []).append(e)
    rows = ["| effect | of | description | magnitude | kind, shapes |", "|---|---|---|---|---|"]
    for name, entries in families.items():
        parts = ", ".join(e.name.partition(".")[2] for e in entries)
        more = ", ".join(filter(None, (entries[0].kind, _shapes(entries[0]))))
        text = _common([e.mechanism for e in entries])
        rows.append(f"| `{name}` | {parts} | {text} | {_sizes(entries)} | {more} |")
    return "\n".join(rows) + "\n"


def tolerances_markdown(library: Library) -> str:
    """Table of tolerances by size and source: names, standard deviation, source."""
    groups: dict[tuple[str, str], list[str]] = {}
    for e in library.tolerances:
        size = f"{100 * e.magnitude:g} %" if e.unit == "1" else f"{e.magnitude:.3g} {e.unit}"
        groups.setdefault((size, e.source), []).append(f"`{e.name}`")
    rows = ["| parameters | standard deviation | source |", "|---|---|---|"]
    for (size, source), names in groups.items():
        rows.append(f"| {', '.join(names)} | {size} | {source} |")
    return "\n".join(rows) + "\n"
