"""A mechanism with the effects that a diagnosis found, ready to simulate and to save."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from feltmb.adapters.library import Entry
from feltmb.adapters.variants import changed_config
from feltmb.mechanism import Action

__all__ = ["action_with_effects"]


def action_with_effects(
    action: Action,
    entries: Sequence[tuple[Entry, float, float | None]],
    conditions: Mapping[str, float | str] | None = None,
) -> Action:
    """Mechanism with tolerances and effects of given magnitudes.

    Parameters
    ----------
    entries
        (entry, magnitude [its unit], shape or None); sensor and input effects change no mechanism.
    conditions
        Of the record for which drifting effects are wanted.

    Returns
    -------
    Action
        In SI units; notes and sources of the file are left behind, because they speak of the old
        numbers. The old action itself if nothing changed.
    """
    config = changed_config(action.config, entries, conditions or {})
    if config is action.config:
        return action
    raw = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    return Action(raw, action.origin)
