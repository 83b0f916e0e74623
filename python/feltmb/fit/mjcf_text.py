"""Changes of numbers in the text of an MJCF file; the rest of the text stays as it is."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from xml.parsers import expat

import numpy as np

__all__ = ["changed_text"]

#: Attribute that is the gain, by the element of an actuator.
_GAIN = {"position": "kp", "velocity": "kv", "general": "gainprm"}
_TAG = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""")


@dataclass(frozen=True)
class _Tag:
    """A start tag, from its ``<`` to behind its ``>``."""

    element: str
    first: int
    last: int


def _tags(text: bytes) -> dict[tuple[str, str], _Tag]:
    """Start tags of bodies, their inertials, joints and actuators, by kind and name."""
    found: dict[tuple[str, str], _Tag] = {}
    path: list[tuple[str, str]] = []
    parser = expat.ParserCreate()

    def start(element: str, attributes: dict[str, str]) -> None:
        name = attributes.get("name", "")
        part = path[1][0] if len(path) > 1 else ""
        kind = element if part == "worldbody" else "actuator" if part == "actuator" else ""
        if kind == "inertial":
            name = path[-1][1]
        path.append((element, name))
        if kind in ("body", "joint", "inertial", "actuator") and name:
            end = _TAG.match(text, parser.CurrentByteIndex)
            assert end is not None
            found[kind, name] = _Tag(element, parser.CurrentByteIndex, end.end())

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _element: path.pop()
    parser.Parse(text, True)
    return found


def changed_text(text: bytes, patched: Any, values: Mapping[str, float]) -> bytes:
    """Text of an MJCF file with the values of properties.

    Parameters
    ----------
    text
        Text of the file.
    patched
        Specification (``MjSpec``) with these values.
    values
        Values by property, such as ``elbow.damping``.

    Raises
    ------
    KeyError
        An element is not in the text, or has no attribute for a property.
    """
    tags = _tags(text)
    attributes: dict[_Tag, dict[str, str]] = {}
    splices: list[tuple[int, int, bytes]] = []
    for name, value in values.items():
        owner, _, what = name.rpartition(".")
        if what == "mass":
            body, tag = patched.body(owner), tags["body", owner]
            numbers = {"pos": body.ipos, "quat": body.iquat, "mass": value,
                       "diaginertia": body.inertia}  # fmt: skip
            own = tags.get(("inertial", owner))
            place = (own.first, own.last) if own else (tag.last, tag.last)
            before = b"" if own else _indent(text, tag) + b"  "
            splices.append((*place, before + _element("inertial", numbers)))
        elif what == "backlash":
            if value > 0.0:
                tag = tags["joint", owner]
                end = tag.last
                if not text[:end].endswith(b"/>"):
                    end = text.index(b">", text.index(b"</joint", end)) + 1
                line = _indent(text, tag) + _element("joint", _free(patched, owner))
                splices.append((end, end, line))
        elif what == "gain":
            tag = tags["actuator", owner]
            key = _GAIN[tag.element]
            new = {key: _shown(value)}
            if key == "gainprm":
                new["biasprm"] = _shown(patched.actuator(owner).biasprm[:3])
            attributes.setdefault(tag, {}).update(new)
        elif what == "delay":
            actuator = patched.actuator(owner)
            new = {"delay": _shown(value), "nsample": str(actuator.nsample)}
            attributes.setdefault(tags["actuator", owner], {}).update(new)
        elif what == "gear":
            gear = {"gear": _shown(patched.actuator(owner).gear)}
            attributes.setdefault(tags["actuator", owner], {}).update(gear)
        else:
            attributes.setdefault(tags["joint", owner], {}).update({what: _shown(value)})
    for tag, new in attributes.items():
        splices.append((tag.first, tag.last, _with(text[tag.first : tag.last], new)))
    for first, last, replacement in sorted(splices, reverse=True):
        text = text[:first] + replacement + text[last:]
    return text


def _free(patched: Any, owner: str) -> dict[str, Any]:
    """Attributes of the joint of a backlash, all that a default could change included."""
    joint = patched.joint(f"{owner}_backlash")
    return {
        "name": joint.name,
        "type": joint.type.name.removeprefix("mjJNT_").lower(),
        "axis": joint.axis,
        "pos": joint.pos,
        "limited": "true",
        "range": joint.range,
        "solreflimit": joint.solref_limit,
        "armature": joint.armature,
        "damping": 0,
        "frictionloss": 0,
        "stiffness": 0,
    }


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else " ".join(f"{v:.8g}" for v in np.ravel(value))


def _element(name: str, attributes: Mapping[str, Any]) -> bytes:
    return f"<{name}{_listed(attributes)}/>".encode()


def _listed(attributes: Mapping[str, Any]) -> str:
    return "".join(f' {key}="{_shown(value)}"' for key, value in attributes.items())


def _indent(text: bytes, tag: _Tag) -> bytes:
    """Start of a new line with the indentation of a tag."""
    line = text[text.rfind(b"\n", 0, tag.first) + 1 : tag.first]
    return b"\n" + line if not line.strip() else b"\n"


def _with(tag: bytes, attributes: Mapping[str, str]) -> bytes:
    """A start tag with new values of attributes."""
    text = tag.decode()
    for key, value in attributes.items():
        found = re.search(rf"""(?<=\s){key}\s*=\s*("[^"]*"|'[^']*')""", text)
        close = re.search(r"\s*/?>$", text)
        assert close is not None
        if found is None:
            text = f'{text[: close.start()]} {key}="{value}"{text[close.start() :]}'
        else:
            text = f'{text[: found.start()]}{key}="{value}"{text[found.end() :]}'
    return text.encode()
