"""Screws of an action: the values that a regulation can change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from feltmb.action.regulate.targets import Screw, Step
from feltmb.mechanism import Action
from feltmb.mechanism.values import tidy
from unmodeled.errors import InvalidParameter
from unmodeled.units import conversion_factor
from unmodeled.units.quantity import parse_scalar


@dataclass
class Screws:
    """The screws of an action and the turn of each [m, rad]."""

    base: Action
    steps: list[Step]
    turns: list[float] = field(init=False)

    def __post_init__(self) -> None:
        self.turns = [0.0] * len(self.steps)
        faults = []
        for step in self.steps:
            if step.screw is not None:
                try:
                    self._position(step.screw)
                except InvalidParameter as error:
                    faults.append(f"step {step.name!r}: {error}")
        if faults:
            raise InvalidParameter("\n".join(faults))

    def _position(self, screw: Screw) -> tuple[Any, str, tuple[float, float] | None]:
        """Raw entry, unit and direction of a screw."""
        node: Any = self.base.raw
        parts = screw.path.split(".")
        if parts[0] in node.get("bodies", {}):
            parts = ["bodies", *parts]
        for part in parts:
            if not isinstance(node, Mapping) or part not in node:
                raise InvalidParameter(
                    f"screw {screw.path!r} is no value of mechanism {self.base.name!r}"
                )
            node = node[part]
        direction = screw.direction
        if direction == "normal":
            surface = self.base.config.surfaces.get(parts[1]) if parts[0] == "surfaces" else None
            if surface is None or surface.normal is None:
                raise InvalidParameter(f"screw {screw.path!r}: has no normal to move along")
            direction = surface.normal
        default = "rad" if direction is None else "m"
        unit = str(node.get("unit", default)) if isinstance(node, Mapping) else default
        value = node.get("value") if isinstance(node, Mapping) else node
        if direction is None:
            value = parse_scalar(node, "rad")
        elif not (isinstance(value, list) and len(value) == 2):
            raise InvalidParameter(f"screw {screw.path!r}: a direction needs a point to move")
        if isinstance(node, str):
            unit = default
        return (dict(node) if isinstance(node, Mapping) else {"value": value}), unit, direction

    def value(self, screw: Screw, action: Action) -> str:
        """Value of a screw in the file of an action, with its unit."""
        entry, unit, direction = Screws(action, [])._position(screw)
        value = entry["value"]
        if direction is None:
            return f"{parse_scalar(entry, 'rad') / conversion_factor(unit, 'rad'):.6g} {unit}"
        return "(" + ", ".join(f"{float(v):.6g}" for v in value) + f") {unit}"

    def apply(self, turns: list[float], describe: Callable[[int], str] | None = None) -> Action:
        """The action with its screws turned; ``describe`` returns a note for a step."""
        values: dict[str, Any] = {}
        for i, (step, turn) in enumerate(zip(self.steps, turns, strict=True)):
            if step.screw is None or turn == 0.0:
                continue
            entry, unit, direction = self._position(step.screw)
            path = step.screw.path
            new = values.get(path, entry)
            factor = 1.0 / conversion_factor(unit, step.screw.unit)
            if direction is None:
                if path not in values:
                    new = {**entry, "value": parse_scalar(entry, "rad") * factor}
                new = {**new, "value": tidy(float(new["value"]) + turn * factor)}
            else:
                new = {
                    **new,
                    "value": [
                        tidy(float(v) + turn * d * factor)
                        for v, d in zip(new["value"], direction, strict=True)
                    ],
                }
            new["unit"] = unit
            new["status"] = "regulated"
            if describe is not None:
                old = str(new.get("note", ""))
                new["note"] = f"{old}; {describe(i)}" if old else describe(i)
            values[path] = new
        return self.base.with_values(values) if values else self.base
