"""The files of an MJCF or URDF model and its sizes, checked before MuJoCo reads it.

MuJoCo waits for a pipe, reads a device without end, and makes what a file of a few bytes states:
a height field of gigabytes, a million copies of a body. It also reads files from any folder.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from unmodeled.errors import InvalidParameter
from unmodeled.files import LARGEST_FILE, LARGEST_JSON, open_input, read_input

#: Largest number of numbers in a height field or texture; of copies of a part, and of files.
NUMBERS, COPIES = 100_000_000, 20_000
#: Elements whose sizes are numbers that MuJoCo allocates -> the attributes, and the limit.
SIZES = {
    "hfield": (("nrow", "ncol"), NUMBERS),
    "texture": (("width", "height"), NUMBERS),
    "replicate": (("count",), COPIES),
    "composite": (("count",), COPIES),
    "flexcomp": (("count",), COPIES),
}


def outside_parts(path: Path) -> tuple[Path, ...]:
    """Files of a model that are not in its folder or below it.

    Raises
    ------
    InvalidParameter
        The file or one that it names is a pipe, a device or too large, or an element is too large.
    """
    found: dict[Path, int] = {}
    _read(path, path.parent, found, 1)
    if sum(found.values()) > LARGEST_FILE:
        raise InvalidParameter(
            f"{path}: its files have {sum(found.values())} bytes; the limit is {LARGEST_FILE} bytes"
        )
    home = path.parent.resolve()
    return tuple(p for p in found if home not in p.resolve().parents)


def _read(path: Path, home: Path, found: dict[Path, int], copies: int) -> None:
    """Add a file of XML and the files that it names, with their sizes [bytes]."""
    text = read_input(path, most=LARGEST_JSON, error=InvalidParameter)
    found[path] = len(text)
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError, LookupError):
        return  # MuJoCo tells what is wrong
    folders = [home, path.parent]
    for c in root.iter("compiler"):
        named = (c.get(n) for n in ("meshdir", "texturedir", "assetdir"))
        folders += [home / n for n in named if n]
    _check(root, path, copies)
    for tag, name in _named(root):
        places = (f / n for f in folders for n in (name, Path(name).name))
        part = next((p for p in places if _there(p)), None)
        if part is None or part in found:
            continue
        if len(found) == COPIES:
            raise InvalidParameter(f"{path}: names more than {COPIES} files")
        if tag in ("include", "model") or part.suffix.lower() in (".xml", ".mjcf", ".urdf"):
            _read(part, home, found, copies)
            continue
        with open_input(part, most=LARGEST_FILE, error=InvalidParameter) as file:
            found[part] = os.fstat(file.fileno()).st_size
            head = file.read(24)
        if head[1:4] == b"PNG":
            _limit(part, "the picture", _bytes(head[16:20]) * _bytes(head[20:24]), NUMBERS)


def _there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that is impossible
        return False


def _named(root: ET.Element) -> Iterator[tuple[str, str]]:
    """Elements and the files that they name."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if key.startswith("file") and value and "\0" not in value:
                yield element.tag, value.partition("://")[2] or value


def _check(element: ET.Element, path: Path, copies: int) -> None:
    """Raise an error if an element, or all copies of it, are too large."""
    if element.tag in SIZES:
        names, most = SIZES[element.tag]
        size = math.prod(_whole(n) for a in names for n in element.get(a, "1").split())
        if most == COPIES:
            size = copies = copies * size
        _limit(path, f"<{element.tag} {element.get('name', '')}>", size, most)
    for child in element:
        _check(child, path, copies)


def _limit(path: Path, what: str, size: int, most: int) -> None:
    if size > most:
        raise InvalidParameter(f"{path}: {what} has {size} elements; the limit is {most}")


def _whole(text: str) -> int:
    """A whole number; 1 for anything else, which MuJoCo refuses."""
    return max(int(text), 1) if text.isdecimal() and len(text) < 20 else 1


def _bytes(text: bytes) -> int:
    return int.from_bytes(text, "big")
