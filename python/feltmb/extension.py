"""Mechanisms as models of unmodeled: the entry point ``unmodeled.models``.

`unmodeled diagnose steinway45 strokes/*.csv` and `feltmb gap diagnose` load mechanisms here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from unmodeled.experiment.designs import DesignedExperiment
    from unmodeled.loading import LoadedModel

__all__ = ["load", "names", "settings", "write_stroke"]


def load(
    name: str,
    settings: Mapping[str, str],
    channels: Sequence[str],
    notify: Callable[[str], None] | None,
) -> LoadedModel | None:
    """Packaged mechanism or mechanism file, see :func:`feltmb.adapters.model.resolve`."""
    from feltmb.adapters import finger_limits, planned_strokes
    from feltmb.adapters.model import resolve
    from unmodeled.loading import LoadedModel

    found = resolve(name, settings, channels, tell=notify)
    if found is None:
        return None
    model, effects = found
    return LoadedModel(
        model,
        effects,
        planned_strokes(model),
        model.library.outputs,
        finger_limits(model),
        write_input=write_stroke,
    )


def write_stroke(
    experiment: DesignedExperiment, stem: Path, units: Mapping[str, str], *, force: bool
) -> list[Path]:
    """Write a planned input as the file of a stroke."""
    from feltmb.adapters import STROKE_KINDS, write_planned_stroke

    if experiment.input not in STROKE_KINDS or experiment.profile is None:
        return []
    path, (time, value) = stem.with_name(f"{stem.name}.toml"), experiment.profile.knots()
    write_planned_stroke(
        path,
        STROKE_KINDS[experiment.input],
        time,
        value,
        unit=units.get(experiment.input, "1"),
        about=experiment.name,
        force=force,
    )
    return [path]


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
