"""The files of an MJCF or URDF model and its sizes, checked before MuJoCo reads it.

MuJoCo waits for a pipe, reads a device without end, and makes what a file of a few bytes states:
a height field of gigabytes, a million copies of a body. It also reads files from any folder.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.errors import InvalidParameter
from unmodeled.files import LARGEST_FILE, LARGEST_JSON, open_input, read_input

#: Endings of files of MuJoCo models.
MJCF = (".xml", ".mjcf", ".urdf")
#: Largest number of numbers in a height field or texture; of copies of a part, and of files.
NUMBERS, COPIES = 100_000_000, 20_000
#: Largest number of elements inside one another, of joints or actuators, and of iterations of a
#: solver; shortest time step [s].
DEEPEST, MOST_PARTS, MOST_ITERATIONS, SHORTEST_STEP = 300, 500, 10_000, 1e-9
#: Largest position and speed of a start [SI].
LARGEST_START = 1e100
ITERATIONS = ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations",
              "sdf_iterations")  # fmt: skip
#: Elements whose sizes are numbers that MuJoCo allocates -> the attributes, and the limit.
SIZES = {
    "hfield": (("nrow", "ncol"), NUMBERS),
    "texture": (("width", "height"), NUMBERS),
    "replicate": (("count",), COPIES),
    "composite": (("count",), COPIES),
    "flexcomp": (("count",), COPIES),
}


@dataclass
class Parts:
    """The files of a model, the model first; a path is absolute and has no ``..``."""

    sizes: dict[Path, int] = field(default_factory=dict)
    """Size of each file [bytes]."""
    absolute: set[Path] = field(default_factory=set)
    """Files that are named by an absolute path, or by such a file: elsewhere, they are missing."""


def outside_parts(path: Path) -> tuple[Path, ...]:
    """Files of a model that are not in its folder or below it; see :func:`parts_of`."""
    home = path.parent.resolve()
    return tuple(p for p in parts_of(path).sizes if home not in p.resolve().parents)


def parts_of(path: Path) -> Parts:
    """All files that a model names, each found as MuJoCo finds it.

    Raises
    ------
    InvalidParameter
        The file or one that it names is a pipe, a device or too large, or an element is too large.
    """
    found = Parts()
    path = _located(path)
    _read(path, path.parent, found, 1)
    if sum(found.sizes.values()) > LARGEST_FILE:
        raise InvalidParameter(
            f"{path}: its files have {sum(found.sizes.values())} bytes; the limit is "
            f"{LARGEST_FILE} bytes"
        )
    return found


def check_compiled(path: Path, model: Any) -> None:
    """Check numbers of a compiled model that would make a run endless, or its results no numbers.

    Raises
    ------
    InvalidParameter
        One of them is such a number; all are told.
    """
    option = model.opt
    step = float(option.timestep)
    faults = []
    if not SHORTEST_STEP <= step < math.inf:
        faults.append(f"timestep = {step:g} s, expected at least {SHORTEST_STEP:g} s")
    for name in ITERATIONS:
        if (count := int(getattr(option, name, 0))) > MOST_ITERATIONS:
            faults.append(f"{name} = {count}; the limit is {MOST_ITERATIONS}")
    for what, count in (("joints", model.njnt), ("actuators", model.nu)):
        if count > MOST_PARTS:
            faults.append(f"{count} {what}; the limit is {MOST_PARTS}")
    names = [n for n in dir(model) if n.startswith(("body_", "jnt_", "dof_", "geom_", "actuator_"))]
    for name in ("gravity", *names):
        numbers = np.asarray(getattr(option if name == "gravity" else model, name))
        if numbers.dtype.kind == "f" and np.isnan(numbers).any():
            faults.append(f"{name} holds nan, expected numbers")
    for name in ("qpos0", "key_qpos", "key_qvel"):
        most = float(np.max(np.abs(getattr(model, name)), initial=0.0))
        if not most <= LARGEST_START:
            faults.append(f"{name} holds {most:g}, expected at most {LARGEST_START:g}")
    if faults:
        raise InvalidParameter(f"{path}: {'; '.join(faults)}")


def _located(path: Path) -> Path:
    """Absolute path without ``..``, which may lead elsewhere behind a link."""
    plain = Path(os.path.normpath(path.absolute()))
    return plain if _there(plain) and plain.resolve() == path.resolve() else path.resolve()


def _read(path: Path, home: Path, found: Parts, copies: int) -> None:
    """Add a file of XML and the files that it names, with their sizes [bytes]."""
    text = read_input(path, most=LARGEST_JSON, error=InvalidParameter)
    found.sizes[path] = len(text)
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError, LookupError):
        return  # MuJoCo tells what is wrong
    named = (c.get(n) for c in root.iter("compiler") for n in ("meshdir", "texturedir", "assetdir"))
    folders = [home, path.parent, *(home / n for n in named if n and "\0" not in n)]
    _check(root, path, copies)
    for tag, name in _named(root):
        places = ((f, n) for f in folders for n in (name, Path(name).name))
        folder, given = next(((f, n) for f, n in places if _there(f / n)), (home, ""))
        part = _located(folder / given)
        if not given or part in found.sizes:
            continue
        if len(found.sizes) == COPIES:
            raise InvalidParameter(f"{path}: names more than {COPIES} files")
        if Path(given).is_absolute() or path in found.absolute or _is_absolute(folder, root):
            found.absolute.add(part)
        if tag in ("include", "model") or part.suffix.lower() in MJCF:
            _read(part, home, found, copies)
            continue
        with open_input(part, most=LARGEST_FILE, error=InvalidParameter) as file:
            found.sizes[part] = os.fstat(file.fileno()).st_size
            head = file.read(24)
        if head[1:4] == b"PNG":
            _limit(part, "the picture", _bytes(head[16:20]) * _bytes(head[20:24]), NUMBERS)


def _is_absolute(folder: Path, root: ET.Element) -> bool:
    """Whether a folder is one that the model names by an absolute path."""
    values = [v for c in root.iter("compiler") for k, v in c.attrib.items() if k.endswith("dir")]
    return any(Path(v).is_absolute() and Path(v) == folder for v in values)


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


def _check(root: ET.Element, path: Path, copies: int) -> None:
    """Raise an error if an element, or all copies of it, are too large or nested too deeply."""
    todo = [(root, copies, 0)]
    while todo:
        element, copies, depth = todo.pop()
        if depth > DEEPEST:
            raise InvalidParameter(f"{path}: more than {DEEPEST} elements are inside one another")
        if element.tag in SIZES:
            names, most = SIZES[element.tag]
            size = math.prod(_whole(n) for a in names for n in element.get(a, "1").split())
            if most == COPIES:
                size = copies = copies * size
            _limit(path, f"<{element.tag} {element.get('name', '')}>", size, most)
        todo += [(child, copies, depth + 1) for child in element]


def _limit(path: Path, what: str, size: int, most: int) -> None:
    if size > most:
        raise InvalidParameter(f"{path}: {what} has {size} elements; the limit is {most}")


def _whole(text: str) -> int:
    """A whole number; 1 for anything else, which MuJoCo refuses."""
    return max(int(text), 1) if text.isdecimal() and len(text) < 20 else 1


def _bytes(text: bytes) -> int:
    return int.from_bytes(text, "big")
