"""Draws docs/img/architecture.svg and writes the tables of the page on the architecture.

    python tools/make_architecture.py           writes
    python tools/make_architecture.py --check   says what is out of date; exit code 1 if anything

What may use what is the table MAY_USE of tests/python/test_layers.py, which a test holds against
the includes and imports; what a part is for is the first line of its text.
"""

from __future__ import annotations

import ast
import html
import importlib.util
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
PICTURE = ROOT / "docs" / "img" / "architecture.svg"

#: Purpose of the folders of the C++ core; the modules of the package state their own.
FOLDERS = {
    "core": "exceptions, plane vectors, sums that do not depend on the machine",
    "numeric": "roots, quadrature, interpolation, eigenproblems, random numbers, threads",
    "fiber": "micromechanics of fiber networks, box of single fibers",
    "contact": "contact laws with their memory, envelopes of felt, friction",
    "beam": "shapes of flexible beams, hub with a flexible arm",
    "modal": "the string in its modes, exact stepping between contacts",
    "ode": "integration in time behind one interface; the only part that sees SUNDIALS",
    "planar": "multibody mechanism: description, assembly, dynamics",
    "model": "a mechanism in time: equilibrium, simulation, events, energy ledger, actuator",
    "sensitivity": "derivatives of a stroke",
    "batch": "many strokes and segments in threads",
    "bindings": "feltmb._core: the only part that sees Python",
    "fmu": "the C functions of co-simulation units (FMI), a binary of its own",
    "c": "the C interface of a felt",
    "wasm": "the C functions of the web page, compiled to WebAssembly",
    "bench": "speed, apart from the tests",
}

WIDTH, ROW, BOX = 1000, 46, 26
LETTER = 7.1  # width of a letter


def may_use() -> dict[str, dict[str, set[str]]]:
    """Language -> part -> parts that it may use."""
    path = ROOT / "tests" / "python" / "test_layers.py"
    spec = importlib.util.spec_from_file_location("test_layers", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return {
        language: {part: set(used.split()) - {part} for part, used in table.items()}
        for language, table in module.MAY_USE.items()
    }


def levels(table: dict[str, set[str]]) -> list[list[str]]:
    """Parts sorted by the longest chain below them; a part only uses parts in lower rows."""
    depth: dict[str, int] = {}

    def of(part: str) -> int:
        if part not in depth:
            depth[part] = 1 + max((of(p) for p in table[part]), default=-1)
        return depth[part]

    rows: list[list[str]] = []
    for part in table:
        while len(rows) <= of(part):
            rows.append([])
        rows[depth[part]].append(part)
    return rows


def reduced(table: dict[str, set[str]]) -> dict[str, list[str]]:
    """Used parts, without those that another used part already uses."""
    below = {p: set(used) for p, used in table.items()}
    for _ in table:
        below = {p: used.union(*(below[q] for q in used)) for p, used in below.items()}
    return {
        part: sorted(q for q in used if not any(q in below[r] for r in used if r != q))
        for part, used in table.items()
    }


def used_by_name(part: str) -> str:
    """Name for people."""
    return "(package)" if part == "__init__" else part


#: Folders of the Python packages.
PACKAGES = {"feltmb": ROOT / "python" / "feltmb", "unmodeled": ROOT / "unmodeled/src/unmodeled"}


def summary_line(language: str, part: str) -> str:
    """What a part is: the first line of the text of a Python part."""
    if language == "C++":
        return FOLDERS[part]
    package = PACKAGES[language]
    file = package / f"{part}.py"
    if not file.is_file():
        file = package / part / "__init__.py"
    if part == "_core":
        return "The C++ core, as Python sees it."
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def draw(tables: dict[str, dict[str, set[str]]]) -> str:
    """The figure as SVG."""
    shapes: list[str] = []
    y = 30.0
    title = {
        "feltmb": "Python: python/feltmb, which uses unmodeled",
        "unmodeled": "Python: unmodeled/src/unmodeled",
        "C++": "C++: cpp/, bench/",
    }
    for language, fill in (("feltmb", "#CFE6F5"), ("unmodeled", "#D5EFD0"), ("C++", "#F9D9B8")):
        table = tables[language]
        rows = levels(table)[::-1]
        wrapped = [line for row in rows for line in lines_of(row)]
        shapes.append(
            f'<rect x="10" y="{y - 20:.0f}" width="{WIDTH - 20}" '
            f'height="{len(wrapped) * ROW + 30:.0f}" fill="none" stroke="#999"/>'
        )
        shapes.append(f'<text x="22" y="{y:.0f}" class="title">{title[language]}</text>')
        y += 16
        place: dict[str, tuple[float, float]] = {}
        boxes: list[str] = []
        for line in wrapped:
            gap = 110 if language == "C++" else 12
            width = sum(box_width(p) + gap for p in line) - gap
            x = (WIDTH - width) / 2
            for part in line:
                w = box_width(part)
                place[part] = (x + w / 2, y)
                boxes.append(
                    f'<rect x="{x:.1f}" y="{y:.0f}" width="{w:.1f}" height="{BOX}" rx="4" '
                    f'fill="{fill}" stroke="#555"/>'
                    f'<text x="{x + w / 2:.1f}" y="{y + 17:.0f}" text-anchor="middle">'
                    f"{html.escape(used_by_name(part))}</text>"
                )
                x += w + gap
            y += ROW
        if language == "C++":  # among fifty modules, arrows would hide the boxes
            for part, used in reduced(table).items():
                for other in used:
                    (x0, y0), (x1, y1) = place[part], place[other]
                    shapes.append(
                        f'<line x1="{x0:.1f}" y1="{y0 + BOX:.0f}" x2="{x1:.1f}" y2="{y1:.0f}" '
                        'stroke="#888" marker-end="url(#arrow)"/>'
                    )
        shapes += boxes
        y += 40
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y - 30:.0f}" '
        f'width="{WIDTH}" height="{y - 30:.0f}">'
        "<style>text{font:13px sans-serif;fill:#222}.title{font-weight:bold}</style>"
        '<defs><marker id="arrow" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" fill="#888"/></marker></defs>'
        '<rect width="100%" height="100%" fill="white"/>'
    )
    return "\n".join([head, *shapes, "</svg>", ""])


def box_width(part: str) -> float:
    return max(50.0, LETTER * len(used_by_name(part)) + 18)


def lines_of(row: list[str]) -> list[list[str]]:
    """A row of parts, wrapped to the width of the figure."""
    lines: list[list[str]] = [[]]
    for part in row:
        if sum(box_width(p) + 12 for p in [*lines[-1], part]) > WIDTH - 60:
            lines.append([])
        lines[-1].append(part)
    return lines


def tables_text(tables: dict[str, dict[str, set[str]]]) -> str:
    """Tables of the page."""
    lines = []
    for language in ("C++", "feltmb", "unmodeled"):
        lines += [f"### {language}", "", "| part | what it is | builds on |", "|---|---|---|"]
        direct = reduced(tables[language])
        for row in levels(tables[language]):
            for part in row:
                used = ", ".join(used_by_name(p) for p in direct[part])
                lines.append(
                    f"| `{used_by_name(part)}` | {summary_line(language, part)} | {used} |"
                )
        lines.append("")
    return "\n".join(lines)


def pages() -> dict[Path, str]:
    """Expected content of the files."""
    tables = may_use()
    text = PAGE.read_text(encoding="utf-8")
    marks = re.compile(r"(<!-- parts -->\n).*?(<!-- end of parts -->)", re.DOTALL)
    new = marks.sub(lambda m: m.group(1) + "\n" + tables_text(tables) + "\n" + m.group(2), text)
    return {PICTURE: draw(tables), PAGE: new}


def main() -> int:
    old = [f for f, text in pages().items() if not f.is_file() or f.read_text("utf-8") != text]
    if "--check" in sys.argv[1:]:
        for file in old:
            print(f"{file.relative_to(ROOT)} is out of date; run python tools/make_architecture.py")
        return 1 if old else 0
    for file, text in pages().items():
        file.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
