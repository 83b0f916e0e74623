"""Model and effects from a name on the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from feltmb.adapters.drives import FORCE
from feltmb.adapters.library import load_library
from feltmb.adapters.mechanism import mechanism_model
from feltmb.adapters.model import MechanismModel
from feltmb.adapters.signals import partners
from feltmb.data import Record
from feltmb.errors import InvalidParameter
from feltmb.fit import Effect
from feltmb.mechanism import Action, load_action, packaged_actions
from feltmb.mechanism.parameters import with_values_told

__all__ = ["SETTINGS", "model_of", "resolve"]

#: Settings of a command: name -> meaning.
SETTINGS = {
    "channels": "channels or outputs, with commas: key,hammer_tip (default: those of the library)",
    "effects": "names or patterns, with commas: felt_*,let_off_button (default: all)",
    "tolerances": "parameters to estimate, names or patterns (default: all of the library)",
    "library": "packaged library of effects or TOML file (default: that of the mechanism)",
    "rtol": "relative tolerance of the integrator (default 1e-6)",
    "until": "time after the impact up to which samples are used in s, or end: all "
    "samples (default: that of the library, 0.01)",
    "variation": "relative change of felt and friction from stroke to stroke "
    "(default 0.01), none: no variation",
}


def _mechanism(name: str) -> Action | None:
    if name in packaged_actions():
        return load_action(name)
    if not name.endswith(".toml"):
        return None
    return load_action(name)


def model_of(action: Action, records: Sequence[Record] | Record) -> MechanismModel:
    """A mechanism as a model, with the default channels and the outputs that records show.

    Parameters
    ----------
    action
        The mechanism.
    records
        Measured runs.
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    library = load_library(action)
    known = {f"{point}.{axis}" for point in action.config.points for axis in "xy"}
    known |= {FORCE} if action.config.finger is not None else set()
    shown = list(dict.fromkeys(n for r in records for n in r.outputs if n in known))
    channels = ",".join(shown or library.default_channels)
    found = resolve(action, {"channels": channels} if channels else {})
    assert found is not None
    return found[0]


def resolve(
    name: str | Action,
    settings: Mapping[str, str],
    also: Sequence[str] = (),
    *,
    tell: Callable[[str], None] | None = None,
) -> tuple[MechanismModel, tuple[Effect, ...]] | None:
    """Model and effects of a packaged mechanism or a mechanism file; None for other names.

    Parameters
    ----------
    name
        Name, path of a file, or a mechanism.
    settings
        Settings of :data:`SETTINGS`; a name with a dot is a path of the mechanism,
        ``string.modes``.
    also
        Channels in addition to those of the settings.
    tell
        Function that receives sentences about assumptions.

    Raises
    ------
    InvalidParameter
        A setting, channel or effect is unknown; the message has the known ones.
    """
    action = _mechanism(name) if isinstance(name, str) else name
    if action is None:
        return None
    paths = {k: v for k, v in settings.items() if "." in k}
    unknown = sorted(set(settings) - set(SETTINGS) - set(paths))
    if unknown:
        raise InvalidParameter(
            f"--set {', '.join(unknown)}: expected {', '.join(SETTINGS)}, or a path of the "
            "mechanism such as string.modes"
        )
    action = with_values_told(action, [f"{k}={v}" for k, v in paths.items()], tell)
    options: dict[str, Any] = {}
    if "rtol" in settings:
        try:
            options["rtol"] = float(settings["rtol"])
        except ValueError:
            raise InvalidParameter(f"rtol: got {settings['rtol']!r}, expected a number") from None
    if "until" in settings:
        options["until"] = _until(settings)
    if "variation" in settings:
        options["variation"] = _variation(settings)
    library = load_library(action, settings.get("library"))
    if "tolerances" in settings:
        options["tolerances"] = _list(settings["tolerances"])
    channels = _list(settings.get("channels", "")) or list(library.default_channels)
    effects = _list(settings.get("effects", ""))
    outputs = library.outputs([*channels, *also])
    turned = [e.sensor for e in library.select(effects) if e.sensor and e.sensor.kind == "tilt"]
    beside = partners(turned, outputs, library.channels)
    model, made = mechanism_model(
        action, channels=[*outputs, *beside], effects=effects, library=library, **options
    )
    model.beside = frozenset(beside)
    return model, made


def _until(settings: Mapping[str, str]) -> float:
    """Time after the impact that is used [s]; infinite: to the end."""
    text = settings["until"]
    if text == "end":
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise InvalidParameter(f"until: got {text!r}, expected seconds >= 0, or end")
    return value


def _variation(settings: Mapping[str, str]) -> float | None:
    """Run-to-run variation [1]; None: none."""
    text = settings["variation"]
    if text == "none":
        return None
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 0.5:
        raise InvalidParameter(f"variation: got {text!r}, expected a share from 0 to 0.5, or none")
    return value


def _list(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]
