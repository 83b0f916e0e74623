"""A mechanism with its tolerances and effects as a model of a fit or a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feltmb.adapters.effects import effect_of
from feltmb.adapters.library import Entry, Library, load_library
from feltmb.adapters.model import MechanismModel
from feltmb.adapters.signals import columns_of
from feltmb.arguments import checked
from feltmb.fit import Effect
from feltmb.mechanism import Action

__all__ = ["mechanism_model"]


@checked
def mechanism_model(
    action: Action,
    *,
    channels: Sequence[str] = (),
    library: Library | str | None = None,
    effects: Sequence[str] = (),
    tolerances: Sequence[str | Entry] | None = None,
    **options: Any,
) -> tuple[MechanismModel, tuple[Effect, ...]]:
    """A mechanism with its tolerances and effects as a model of a fit or a diagnosis.

    Parameters
    ----------
    channels
        Channel names of the library (``key``, ``hammer_tip``) or outputs (``hammer_tip.x``);
        default: the default channels of the library.
    library
        A library, its name or path; default: the library of the mechanism.
    effects
        Names or patterns (``felt_*``); default: all effects of the library.
    tolerances
        Parameters that a fit estimates: names, patterns or entries of the library; default: all of
        the library. An empty list: none.
    options
        Options of :class:`MechanismModel`.

    Raises
    ------
    InvalidParameter
        A name is unknown; the message has the nearest known ones. A text is given instead of a list
        of names.
    """
    if not isinstance(library, Library):
        library = load_library(action, library)
    estimated = _chosen(library, tolerances)
    model = MechanismModel(
        action, library, library.outputs(channels), tolerances=estimated, **options
    )
    chosen = [e for e in library.select(effects) if _can_show(model, e)]
    ready = []
    for e in chosen:
        alias = model.simulator.alias(e)
        ready.append(
            effect_of(
                e,
                model.outputs,
                library.channels,
                tolerance_parameter="" if alias is None else alias.tolerance.name,
                tolerance_ratio=1.0 if alias is None else alias.ratio(0.0, 0.0),
            )
        )
    model.effects, model.offers_all = tuple(ready), True
    return model, model.effects


def _chosen(library: Library, tolerances: Sequence[str | Entry] | None) -> tuple[Entry, ...]:
    """Tolerances by name, pattern or entry; None: all of the library."""
    if tolerances is None:
        return library.tolerances
    out: list[Entry] = []
    for t in tolerances:
        out += [t] if isinstance(t, Entry) else library.choose_tolerances([t])
    return tuple({t.name: t for t in out}.values())


def _can_show(model: MechanismModel, entry: Entry) -> bool:
    """Whether the channel of a sensor effect exists."""
    if entry.sensor is None:
        moved = {c.path.split(".")[1] for c in entry.changes if c.path.startswith("points.")}
        return not moved or any(o.rpartition(".")[0] in moved for o in model.outputs)
    return bool(columns_of(entry.sensor, model.outputs, model.library.channels))
