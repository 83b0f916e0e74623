"""Writes docs/reference/generated from the source: command line, TOML files, Python, C++ headers.

    python tools/make_reference.py

The build of the site (`bash tools/docs.sh`) writes them. Only the page of the TOML files is in git,
so that a clone has the keys of every table; run this after a change of a schema.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from reference import command_line, cpp, python_api, toml_files

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "reference" / "generated"

#: Pages that other pages may link to.
LINKED = ("command_line.md", "toml_files.md", "python.rst", "cpp.md")


def pages() -> dict[str, str]:
    """Path of each page below the folder, and its text."""
    return {
        "command_line.md": command_line.page(),
        "toml_files.md": toml_files.page(),
        **python_api.pages(),
        **cpp.pages(ROOT / "cpp" / "include"),
    }


def write(folder: Path = FOLDER) -> list[Path]:
    """Write the pages that differ from what is there, delete others; returns those written."""
    wanted = {folder / name: text for name, text in pages().items()}
    for old in set(folder.rglob("*.*")) - set(wanted):
        old.unlink()
    written = []
    for file, text in wanted.items():
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
            written.append(file)
    return written


def main() -> int:
    for file in write():
        lines = len(file.read_text(encoding="utf-8").splitlines())
        print(f"{file.relative_to(ROOT)}: {lines} lines")
    return 0


if __name__ == "__main__":
    sys.exit(main())
