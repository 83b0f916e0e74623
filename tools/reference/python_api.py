"""Python: what the modules offer, with signatures and texts."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from typing import Any

from reference.attributes import field_texts

#: In the order of the page; each offers its ``__all__``.
MODULES = (
    "feltmb",
    "feltmb.contact",
    "feltmb.felt",
    "feltmb.fiber",
    "feltmb.data",
    "feltmb.fit",
    "feltmb.gap",
    "feltmb.gap.library",
    "feltmb.adapters",
    "feltmb.action.actuator",
    "feltmb.run.quasistatic",
    "feltmb.mechanism.parameters",
    "feltmb.run.batch",
    "feltmb.graphics.viewer",
    "feltmb.graphics.plot",
    "feltmb.errors",
    "feltmb.units",
)


def page() -> str:
    """The whole page."""
    lines = ["# Python", "", "What each module offers, once: a name stands where it is first.", ""]
    lines += [f"- [{name}](#{name.replace('.', '')})" for name in MODULES]
    lines.append("")
    seen: set[int] = set()
    for name in MODULES:
        module = importlib.import_module(name)
        lines += [f"## {name}", "", *text_block(inspect.getdoc(module))]
        for item in getattr(module, "__all__", ()):
            value = getattr(module, item)
            if item.startswith("__") or inspect.ismodule(value) or id(value) in seen:
                continue
            if inspect.isclass(value) or callable(value):
                seen.add(id(value))
            lines += entry(item, value)
    return "\n".join(lines).rstrip() + "\n"


def entry(name: str, value: Any) -> list[str]:
    """One name of a module."""
    if inspect.isclass(value):
        return class_entry(name, value)
    if callable(value):
        return [f"### {name}{signature(value)}", "", *text_block(inspect.getdoc(value))]
    shown = repr(value)
    plain = isinstance(value, (int, float, str)) or (
        isinstance(value, tuple) and len(shown) < 200 and " at 0x" not in shown
    )
    return [f"### {name}", "", *([f"`{shown}`", ""] if plain else [])]


def class_entry(name: str, cls: type) -> list[str]:
    """A class with its fields and methods."""
    lines = [f"### class {name}", "", *text_block(inspect.getdoc(cls))]
    texts = field_texts(cls)
    fields = [f.name for f in dataclasses.fields(cls)] if dataclasses.is_dataclass(cls) else []
    fields = [f for f in fields if not f.startswith("_")]
    if fields:
        lines += [f"- `{f}`" + (f": {texts[f]}" if f in texts else "") for f in fields] + [""]
    for member, value in vars(cls).items():
        if member.startswith("_") or member in fields:
            continue
        inner = value.__func__ if isinstance(value, (classmethod, staticmethod)) else value
        if isinstance(inner, property):
            text = inspect.getdoc(inner) or ""
            lines += [f"- `{member}`: {' '.join(text.split())}" if text else f"- `{member}`", ""]
        elif inspect.isfunction(inner) and inspect.getdoc(inner):
            lines += [f"#### {name}.{member}{signature(inner, bound=True)}", ""]
            lines += text_block(inspect.getdoc(inner))
    return lines


def signature(value: Any, *, bound: bool = False) -> str:
    """Parameters, without annotations: the text tells units and meaning."""
    try:
        found = inspect.signature(value)
    except (TypeError, ValueError):
        return "(...)"
    parameters = [p.replace(annotation=p.empty) for p in found.parameters.values()]
    if bound and parameters and parameters[0].name in ("self", "cls"):
        parameters = parameters[1:]
    text = str(found.replace(parameters=parameters, return_annotation=found.empty))
    return re.sub(r"<([\w.]+)[^>]*>", r"\1", text).replace("*", r"\*")


def text_block(text: str | None) -> list[str]:
    """First paragraph as it is, the rest as it stands in the source."""
    if not text:
        return []
    first, _, rest = text.partition("\n\n")
    lines = [" ".join(first.split()), ""]
    return lines + (["```text", *rest.rstrip().splitlines(), "```", ""] if rest.strip() else [])
