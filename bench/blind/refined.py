"""The same mechanism with refined numerical models, to estimate the discretization error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feltmb.mechanism import Action

__all__ = ["KINDS", "refined"]

#: More modes of the string, more shape functions of beams, friction with a lower threshold speed.
KINDS = ("modes", "shapes", "friction")
MOST_MODES = 200


def refined(action: Action, kinds: Sequence[str] = KINDS) -> Action:
    """Twice the string modes (up to 200), one more beam shape, a third of the friction's speed.

    If it has none of these, the action itself is returned.
    """
    values: dict[str, Any] = {}
    config = action.config
    if "modes" in kinds and config.string is not None and config.string.kind == "modal":
        values["string.modes"] = max(config.string.modes, min(2 * config.string.modes, MOST_MODES))
    if "shapes" in kinds:
        for name, body in config.bodies.items():
            if body.kind == "beam" and not body.rigid:
                values[f"bodies.{name}.lateral_shapes"] = body.lateral_shapes + 1
    if "friction" in kinds:
        for name, contact in config.contacts.items():
            if contact.friction.core.turns_over:
                speed = contact.friction.threshold_speed / 3.0
                values[f"contacts.{name}.friction.threshold_speed"] = speed
    return action.with_values(values) if values else action
