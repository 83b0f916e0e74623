"""Mechanisms as models of unmodeled: the entry point ``unmodeled.models``.

`unmodeled diagnose steinway45 strokes/*.csv` and `feltmb gap diagnose` load mechanisms here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from unmodeled.loading import LoadedModel


def load(
    name: str,
    settings: Mapping[str, str],
    channels: Sequence[str],
    notify: Callable[[str], None] | None,
) -> LoadedModel | None:
    """Packaged mechanism or mechanism file, see :func:`feltmb.adapters.model.resolve`."""
    from feltmb.adapters import planned_strokes
    from feltmb.adapters.model import resolve
    from unmodeled.loading import LoadedModel

    found = resolve(name, settings, channels, notify=notify)
    if found is None:
        return None
    model, effects = found
    return LoadedModel(model, effects, planned_strokes(model), model.library.outputs)


def names() -> Iterable[str]:
    """Packaged mechanisms."""
    from feltmb.mechanism import packaged_actions

    return packaged_actions()


def settings(words: Sequence[str], incomplete: str) -> Iterator[str]:
    """Settings of the adapter, and dotted paths of the mechanism on the command line."""
    from feltmb.adapters.model import SETTINGS
    from feltmb.cli.completing import setting_words

    del words
    yield from setting_words(incomplete, SETTINGS)
