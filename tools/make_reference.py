"""Writes docs/reference from the source: command line, TOML files, Python, C++ headers.

    python tools/make_reference.py           writes the pages
    python tools/make_reference.py --check   says which pages are out of date; exit code 1 if any

tests/python/unit/test_reference.py does the same check.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from reference import command_line, cpp, python_api, toml_files

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "reference"

INDEX = """\
# Reference

Written from the source by `python tools/make_reference.py`; a test says when a page is out of date.

- [Command line](command_line.md): every command with its options.
- [TOML files](toml_files.md): every key with its unit, limits and default.
- [Python](python.md): what the modules offer.
- [C++ headers](cpp.md): the core library.
"""


def pages() -> dict[str, str]:
    """Name of each page and its text."""
    return {
        "README.md": INDEX,
        "command_line.md": command_line.page(),
        "toml_files.md": toml_files.page(),
        "python.md": python_api.page(),
        "cpp.md": cpp.page(ROOT / "cpp" / "include"),
    }


def out_of_date() -> list[str]:
    """Pages that differ from the source."""
    found = []
    for name, text in pages().items():
        file = FOLDER / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            found.append(name)
    return found


def main() -> int:
    if "--check" in sys.argv[1:]:
        old = out_of_date()
        for name in old:
            print(f"docs/reference/{name} is out of date; run python tools/make_reference.py")
        return 1 if old else 0
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"docs/reference/{name}: {len(text.splitlines())} lines")
    return 0


if __name__ == "__main__":
    sys.exit(main())
