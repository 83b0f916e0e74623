"""Mechanism with the effects of a diagnosis, for simulation and saving."""

from __future__ import annotations

from collections.abc import Sequence

from feltmb.adapters.library import Entry
from feltmb.adapters.variants import changed_config
from feltmb.arguments import checked
from feltmb.mechanism import Action

__all__ = ["action_with_effects"]


@checked
def action_with_effects(
    action: Action, entries: Sequence[tuple[Entry, float, float | None]]
) -> Action:
    """Mechanism with tolerances and effects of given magnitudes.

    Parameters
    ----------
    entries
        (entry, magnitude [its unit], shape or None); sensor and input effects do not change a
        mechanism.

    Returns
    -------
    Action
        The mechanism in SI units. Notes and sources of the file are removed, because they describe
        the old values. If nothing changed, the original object is returned.
    """
    config = changed_config(action.config, entries, {})
    if config is action.config:
        return action
    raw = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    return Action(raw, action.origin)
