"""Updates the tables of docs/reference/gap-effects.md from the library of effects."""

import re
from pathlib import Path

import feltmb
from feltmb.adapters import load_library
from feltmb.adapters.table import effects_markdown, tolerances_markdown

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "reference" / "gap-effects.md"


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
