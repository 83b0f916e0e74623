"""C++: the public declarations of the headers, each with its signature, description and members."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

#: In the order of the layers.
FOLDERS = (
    "core", "numeric", "fiber", "contact", "beam", "modal", "ode", "planar", "model",
    "sensitivity", "batch",
)  # fmt: skip

KEEPS = re.compile(r"\b(class|struct|union|enum|namespace)\b")


HEAD = """\
# C++ headers

These pages list the public declarations of each header: signatures, descriptions, and the fields
of structures with type, default, unit and meaning. To use the library, call
`find_package(feltmb)` and link the target `feltmb::feltmb`, as in
[tests/cmake_consumer](../../../tests/cmake_consumer).

```{toctree}
:maxdepth: 2

"""


def pages(include: Path) -> dict[str, str]:
    """Path and text of each page: an index, and one page for each folder of headers."""
    root = include / "feltmb"
    found = {p.parent.relative_to(root).as_posix() for p in root.rglob("*.hpp")}
    folders = [f for f in (*FOLDERS, *sorted(found - set(FOLDERS))) if f in found]
    names = {folder: f"cpp/{folder.replace('/', '_')}" for folder in folders}
    index = HEAD + "".join(f"{name}\n" for name in names.values()) + "```\n"
    texts = {f"{names[f]}.md": folder_page(root, f) for f in folders}
    return {"cpp.md": index, **texts}


def folder_page(root: Path, folder: str) -> str:
    """The headers of one folder."""
    lines = [f"# {folder}", ""]
    for file in sorted((root / folder).glob("*.hpp")):
        about, code = declarations(file.read_text(encoding="utf-8"))
        lines += [f"## feltmb/{folder}/{file.name}", ""]
        lines += [plain(about), ""] if about else []
        for item in items(code):
            lines += rendered(item)
    return "\n".join(lines).rstrip() + "\n"


@dataclass
class Item:
    """One declaration: the comment before it, its text, and the comment after it."""

    text: str
    before: list[str] = field(default_factory=list)
    behind: list[str] = field(default_factory=list)

    @property
    def about(self) -> list[str]:
        """Lines of both comments."""
        return [*self.before, *self.behind]


def items(code: str) -> Iterator[Item]:
    """Declarations of a header, or of the body of a class."""
    item = None
    comment: list[str] = []
    i = 0
    while i < len(code):
        if code[i].isspace():
            i += 1
            continue
        end = code.find("\n", i)
        end = len(code) if end < 0 else end
        access = re.match(r"(public|protected|private):", code[i:])
        if access:
            i += access.end()
        elif code.startswith("///<", i):
            if item is not None:
                item.behind.append(code[i + 4 : end].strip())
            i = end
        elif code.startswith("//", i):
            if code.startswith("///", i):
                comment.append(code[i + 3 : end].removeprefix(" ").rstrip())
            i = end
        else:
            if item is not None:
                yield item
            stop = statement_end(code, i)
            text = code[i:stop].strip()
            item = Item(text, comment) if text.strip(";") else None
            comment = []
            i = stop
    if item is not None:
        yield item


def statement_end(code: str, start: int) -> int:
    """Index after the semicolon of the statement that begins at ``start``."""
    depth = 0
    for found in re.compile(r'//[^\n]*|"(?:\\.|[^"\\])*"|[{}();]').finditer(code, start):
        c = found.group()
        depth += (c in "{(") - (c in "})") if len(c) == 1 else 0
        if c == ";" and depth <= 0:
            return found.end()
    return len(code)


def rendered(item: Item) -> list[str]:
    """One declaration as Markdown."""
    made = re.match(
        r"(?P<head>(?:template\s*<.*?>\s*)?(?:struct|class)\s+(?P<name>\w+)[^;{]*)\{(?P<body>.*)\}\s*;$",
        item.text,
        re.DOTALL,
    )
    if made is None:
        if re.fullmatch(r"(struct|class|enum)\s[^{(]*;", item.text):
            return []  # a forward declaration
        return [*fenced(item.text), *described(item.about)]
    lines = [f"### {made['name']}", "", *fenced(f"{made['head'].strip()};"), *described(item.about)]
    members = list(items(made["body"].replace("\n  ", "\n")))
    fields = [(parts, m) for m in members if (parts := field_parts(m.text))]
    if fields:
        lines += ["| field | type | default | meaning |", "|---|---|---|---|"]
        for (kind, name, default), m in fields:
            cells = (f"`{name}`", code_cell(kind), code_cell(default), plain(" ".join(m.about)))
            lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
        lines.append("")
    bare: list[str] = []
    for m in members:
        if field_parts(m.text):
            continue
        if not m.about and not m.text.startswith(("struct", "class", "enum")):
            bare.append(m.text)
            continue
        lines += [*fenced("\n".join(bare)), *fenced(m.text), *described(m.about)]
        bare = []
    return [*lines, *fenced("\n".join(bare))]


def field_parts(text: str) -> tuple[str, str, str] | None:
    """Type, name and default of a field; None for anything else."""
    bare = re.sub(r"\s+", " ", text).rstrip("; ")
    if bare.startswith(("using ", "friend ", "struct ", "class ", "enum ", "template")):
        return None
    flat = bare
    while (shorter := re.sub(r"<[^<>]*>", "", flat)) != flat:
        flat = shorter
    if "(" in flat.split("=")[0].split("{")[0] or "operator" in flat:
        return None
    found = re.fullmatch(
        r"(?P<type>.+?[\s&*>])(?P<name>\w+(?:\[[^\]]*\])?)\s*(?:=\s*(?P<set>.*)|\{(?P<init>.*)\})?",
        bare,
    )
    if found is None:
        return None
    return found["type"].strip(), found["name"], (found["set"] or found["init"] or "").strip()


def code_cell(text: str) -> str:
    """Code in a cell of a table."""
    return f"`{text}`" if text else ""


def fenced(code: str) -> list[str]:
    """A block of code; empty for empty text."""
    return ["```cpp", code.strip(), "```", ""] if code.strip() else []


def described(comment: list[str]) -> list[str]:
    """A comment as paragraphs; indented lines are formulas and remain unchanged."""
    lines: list[str] = []
    formula: list[str] = []
    for line in [*comment, ""]:
        if line.startswith("  "):
            formula.append(line)
            continue
        if formula:
            lines += ["", "```text", *formula, "```", ""]
            formula = []
        lines.append(plain(line))
    return [*lines, ""] if any(lines) else []


def plain(text: str) -> str:
    """Text of a comment for Markdown: markup is escaped, except for code in backticks."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        p if p.startswith("`") else re.sub(r"([\\*_<>\[\]$#{}~^|])", r"\\\1", p) for p in parts
    )


def declarations(text: str) -> tuple[str, str]:
    """Description of a header, and its declarations."""
    head = re.match(r"((?:///?.*\n)+)", text)
    about = ""
    if head:
        about = " ".join(re.sub(r"^///? ?", "", line) for line in head.group(1).splitlines())
        text = text[head.end() :]
    text = re.sub(r"^\s*#(.*\\\n)*.*\n", "", text, flags=re.MULTILINE)
    text = without_bodies(text)
    text = re.sub(
        r"^(inline )?namespace .*\{\n|^\}\s*// namespace.*\n", "", text, flags=re.MULTILINE
    )
    text = re.sub(r"^namespace \{[^}]*\}\n", "", text, flags=re.MULTILINE)
    text = without_private(text)
    return about.strip(), re.sub(r"\n{3,}", "\n\n", text).strip()


def without_bodies(text: str) -> str:
    """Replace function bodies by a semicolon; keep classes, enums and initializers."""
    out: list[str] = []
    statement = ""  # since the last ; { }, without comments
    i = 0
    while i < len(text):
        if text.startswith("//", i):
            end = text.find("\n", i)
            end = len(text) if end < 0 else end
            out.append(text[i:end])
            i = end
            continue
        c = text[i]
        if c == "{" and is_body(statement):
            cut_initializers(out, statement)
            i = skip_group(text, i)
            rest = text[i:].lstrip()
            while rest.startswith((",", "{")):  # the braces were those of an initializer
                i = skip_group(text, text.index("{", i))
                rest = text[i:].lstrip()
            out.append(";")
            statement = ""
            continue
        if c == "{" and not KEEPS.search(statement):
            end = skip_group(text, i)
            out.append(text[i:end])
            statement += "{}"
            i = end
            continue
        out.append(c)
        statement = "" if c in ";{}" else statement + c
        i += 1
    return "".join(out)


def is_body(statement: str) -> bool:
    """Whether a brace after this text opens a function body."""
    plain = re.sub(r"template\s*<[^{]*?>\s*(?=\w)", "", statement)
    return (
        ")" in plain
        and not re.search(r"^\s*(class|struct|union|enum|namespace)\b", plain)
        and (not re.search(r"=\s*$", plain))
    )


def cut_initializers(out: list[str], statement: str) -> None:
    """Remove the initializers of a constructor."""
    found = re.search(r"\)\s*(noexcept\s*)?(:\s*[A-Za-z_].*)$", statement, re.DOTALL)
    if found and "::" not in found.group(2)[:2]:
        text = "".join(out)
        at = text.rfind(found.group(2).split("{")[0])
        if at > 0:
            out[:] = [text[:at].rstrip()]
            return
    text = "".join(out)
    out[:] = [text.rstrip()]


def skip_group(text: str, start: int) -> int:
    """Index after the brace group that opens at ``start``, without braces in strings."""
    depth = 0
    for found in re.compile(r'//[^\n]*|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])\'|[{}]').finditer(
        text, start
    ):
        if found.group() == "{":
            depth += 1
        elif found.group() == "}":
            depth -= 1
            if depth == 0:
                return found.end()
    return len(text)


def without_private(text: str) -> str:
    """Remove the private part of each class, which is its last part."""
    lines = []
    skipping = False
    for line in text.splitlines():
        if re.match(r"^ private:", line):
            skipping = True
        elif skipping and line.startswith("}"):
            skipping = False
        if not skipping:
            lines.append(line)
    return "\n".join(lines)
