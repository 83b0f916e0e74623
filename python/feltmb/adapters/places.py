"""Places in a mechanism of what an effect names: its bodies, and the point where they meet."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from feltmb.mechanism import Action, MechanismFile

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["bodies_at", "points_at"]


def _contact(config: MechanismFile, component: str) -> str | None:
    number = re.match(r"contact (\d+)", component)
    return number.group(1) if number and number.group(1) in config.contacts else None


def bodies_at(config: MechanismFile, component: str, paths: Iterable[str] = ()) -> list[str]:
    """Bodies of a component of a report, or those of the changed entries.

    Parameters
    ----------
    component
        Text of an effect, such as ``contact 03, key capstan - whippen`` or ``hammer head``.
    paths
        Dotted paths of the entries that the effect changes.
    """
    number = _contact(config, component)
    if number is not None:
        return [config.surfaces[name].body for name in config.contacts[number].surfaces]
    found = list(_of_paths(config, paths))
    return found or [n for n, b in config.bodies.items() if component.startswith(b.label or n)]


def _of_paths(config: MechanismFile, paths: Iterable[str]) -> Iterator[str]:
    for path in paths:
        table, name, *_ = path.split(".")
        if table == "bodies":
            yield name
        elif table == "surfaces":
            yield config.surfaces[name].body
        elif table == "contacts":
            yield from (config.surfaces[s].body for s in config.contacts[name].surfaces)
        elif table == "springs":
            coordinate = config.springs[name].coordinate
            yield from (n for n, b in config.bodies.items() if b.coordinate == coordinate)
        elif table == "straps":
            yield from (config.straps[name].body_a, config.straps[name].body_b)


def points_at(action: Action, component: str) -> list[tuple[float, float]]:
    """Point where the surfaces of a contact meet at rest [m]; none for other components."""
    from feltmb.run.simulate import evaluate

    number = _contact(action.config, component)
    if number is None:
        return []
    pose = action.rest_pose
    row = evaluate(action, pose, 0.0 * pose).contacts.loc[int(number)]
    return [(float(row["x"]), float(row["y"]))]
