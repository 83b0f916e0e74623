"""Python: one page for each module, which Sphinx fills from signatures and docstrings."""

from __future__ import annotations

import importlib
import inspect
from types import GenericAlias, ModuleType
from typing import Any

#: Modules in the order of the index; each describes its ``__all__``.
MODULES = (
    "feltmb",
    "feltmb.contact",
    "feltmb.felt",
    "feltmb.fiber",
    "unmodeled.data",
    "unmodeled.fit",
    "unmodeled.models",
    "unmodeled.ode",
    "unmodeled",
    "unmodeled.search.result",
    "unmodeled.library",
    "unmodeled.experiment",
    "feltmb.adapters",
    "feltmb.action.actuator",
    "feltmb.keyboard",
    "feltmb.run.quasistatic",
    "feltmb.mechanism.parameters",
    "feltmb.run.batch",
    "feltmb.graphics.viewer",
    "feltmb.graphics.plot",
    "unmodeled.errors",
    "unmodeled.units",
)

INDEX = """\
Python
======

The public names of each module. A name that several modules offer is described once, in the first
of them.

.. toctree::
   :maxdepth: 1

"""


def offered() -> dict[str, dict[str, Any]]:
    """Module -> its public names that no earlier module has."""
    found: dict[str, dict[str, Any]] = {}
    seen: set[int] = set()
    for name in MODULES:
        module = importlib.import_module(name)
        found[name] = {}
        for item in getattr(module, "__all__", ()):
            value = getattr(module, item)
            if item.startswith("__") or isinstance(value, ModuleType):
                continue
            if callable(value):
                if id(value) in seen:
                    continue
                seen.add(id(value))
            found[name][item] = value
    return found


def public_names() -> dict[str, str]:
    """Place of definition of a class or function -> name under which it is described."""
    return {
        f"{value.__module__}.{value.__qualname__}": f"{module}.{item}"
        for module, items in offered().items()
        for item, value in items.items()
        if hasattr(value, "__qualname__")
    }


def pages() -> dict[str, str]:
    """Path and text of each page."""
    found = {
        f"python/{module}.rst": module_page(module, items) for module, items in offered().items()
    }
    listed = "".join(f"   python/{module}\n" for module in MODULES)
    return {"python.rst": INDEX + listed, **found}


def module_page(module: str, items: dict[str, Any]) -> str:
    """One module: description, table of its names, and each of them."""
    lines = [module, "=" * len(module), "", f".. automodule:: {module}", "   :no-members:", ""]
    lines += [f".. currentmodule:: {module}", ""]
    described = [item for item, value in items.items() if is_described(value)]
    if described:
        lines += [".. autosummary::", "   :nosignatures:", ""]
        lines += [f"   {item}" for item in described] + [""]
    for item, value in items.items():
        if not is_described(value):
            lines += [f".. py:data:: {item}", *constant(value), ""]
        elif inspect.isclass(value):
            lines += [f".. autoclass:: {item}", "   :members:", ""]
        else:
            lines += [f".. autofunction:: {item}", ""]
    return "\n".join(lines).rstrip() + "\n"


def is_described(value: Any) -> bool:
    """Whether an object is a class or function, as opposed to a constant or a type alias."""
    if isinstance(value, GenericAlias):
        return False
    return callable(value) and hasattr(value, "__qualname__")


def constant(value: Any) -> list[str]:
    """Value of a constant, if it is short."""
    shown = repr(value)
    plain = isinstance(value, (int, float, str)) or (
        isinstance(value, tuple) and len(shown) < 200 and " at 0x" not in shown
    )
    return [f"   :value: {shown}"] if plain else []
