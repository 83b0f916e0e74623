"""C++: the public part of the headers, bodies left out."""

from __future__ import annotations

import re
from pathlib import Path

#: In the order of the layers.
FOLDERS = (
    "core", "numeric", "fiber", "contact", "beam", "modal", "ode", "planar", "model",
    "sensitivity", "batch",
)  # fmt: skip

KEEPS = re.compile(r"\b(class|struct|union|enum|namespace)\b")


HEAD = """\
# C++ headers

What each header declares, with its comments. Bodies and private parts are left out. To use the
library: `find_package(feltmb)`, target `feltmb::feltmb`, as in
[tests/cmake_consumer](../../../tests/cmake_consumer).

```{toctree}
:maxdepth: 2

"""


def pages(include: Path) -> dict[str, str]:
    """Path and text of each page: an index, and one page a folder of headers."""
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
        lines += [about, ""] if about else []
        lines += ["```cpp", code, "```", ""] if code else []
    return "\n".join(lines).rstrip() + "\n"


def declarations(text: str) -> tuple[str, str]:
    """What a header is about, and its declarations."""
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
    """Bodies of functions become a semicolon; classes, enums and initializers stay."""
    out: list[str] = []
    statement = ""  # since the last ; { }, comments left out
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
    """Whether a brace after this opens the body of a function."""
    plain = re.sub(r"template\s*<[^{]*?>\s*(?=\w)", "", statement)
    return (
        ")" in plain
        and not re.search(r"^\s*(class|struct|union|enum|namespace)\b", plain)
        and (not re.search(r"=\s*$", plain))
    )


def cut_initializers(out: list[str], statement: str) -> None:
    """Take the initializers of a constructor off what was written."""
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
    """End of the braces that open at ``start``; strings and comments count as text."""
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
    """Leave out the private part of each class, which is its last."""
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
