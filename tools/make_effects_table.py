"""Updates the tables of docs/reference/gap-effects.md from the library of effects."""

import re
from pathlib import Path

import feltmb
from feltmb.adapters import Entry, Library, load_library
from unmodeled.units import unit_suffix

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "reference" / "gap-effects.md"


def sizes_of(entries: list[Entry]) -> str:
    """Magnitudes of a family: one, or the smallest and the largest of each unit."""
    by_unit: dict[str, list[float]] = {}
    for e in entries:
        by_unit.setdefault(e.unit, []).append(e.magnitude)
    texts = []
    for unit, sizes in by_unit.items():
        ends = dict.fromkeys(f"{v:.3g}" for v in (min(sizes), max(sizes)))
        texts.append(" to ".join(ends) + unit_suffix(unit))
    return {1: "+", -1: "-", 0: "±"}[entries[0].sign] + ", ".join(texts)


def shapes_of(entry: Entry) -> str:
    if entry.shape is None:
        return ""
    values = ", ".join(f"{v:g}" for v in entry.shape.values)
    return f"{entry.shape.path.rpartition('.')[2]} {values} {entry.shape.unit}".strip()


def shared(rows: list[list[str]]) -> list[str]:
    """Words with which all rows begin."""
    same = [len(set(column)) == 1 for column in zip(*rows, strict=False)]
    return rows[0][: [*same, False].index(False)]


def common(texts: list[str]) -> str:
    """What sentences have in common, with ... for the part that is named."""
    words = [text.split() for text in texts]
    begin = shared(words)
    end = shared([w[len(begin) :][::-1] for w in words])[::-1]
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
        more = ", ".join(filter(None, (entries[0].kind, shapes_of(entries[0]))))
        text = common([e.mechanism for e in entries])
        rows.append(f"| `{name}` | {parts} | {text} | {sizes_of(entries)} | {more} |")
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


def tables() -> dict[str, str]:
    """Generated parts of the document, by their marks."""
    library = load_library(feltmb.load_action("steinway45"))
    return {
        "effects": effects_markdown(library),
        "tolerances": tolerances_markdown(library),
    }


def renewed(text: str) -> str:
    """The document with up-to-date tables."""
    for mark, table in tables().items():
        pattern = re.compile(rf"(<!-- {mark} -->\n).*?(<!-- end of {mark} -->)", re.DOTALL)
        if not pattern.search(text):
            raise SystemExit(f"{DOCUMENT}: the mark <!-- {mark} --> is missing")
        text = pattern.sub(lambda m, t=table: m.group(1) + t + m.group(2), text)
    return text


if __name__ == "__main__":
    DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
