"""Mechanisms as data: TOML file, validated description, immutable model.

Only this package knows the file format of mechanisms. ``load_action`` reads a packaged data set or
a file, :class:`Action` contains it, and ``Action.with_values`` changes numbers by their dotted
path. ``schema`` defines the content of a file, ``reading`` finds and extends files, ``values``
changes them, ``checking`` finds all faults, and ``to_core`` describes the mechanism to the core.
"""

from feltmb.contact.tables import LAWS, Curve
from feltmb.mechanism.action import Action, load_action
from feltmb.mechanism.checking import missing_law_faults, spread_laws
from feltmb.mechanism.reading import files_of, load_raw, packaged_actions, without_paths
from feltmb.mechanism.schema import (
    Body,
    Contact,
    FrictionParameters,
    LawChoice,
    MechanismFile,
    NamedEvent,
    Reading,
    Source,
    Spring,
    Surface,
    View,
)
from feltmb.mechanism.to_core import core_law, describe
from feltmb.mechanism.values import (
    apply_values,
    expand_path,
    parse_setting,
    plain_data,
)

__all__ = [
    "LAWS",
    "Action",
    "Body",
    "Contact",
    "Curve",
    "FrictionParameters",
    "LawChoice",
    "MechanismFile",
    "NamedEvent",
    "Reading",
    "Source",
    "Spring",
    "Surface",
    "View",
    "apply_values",
    "core_law",
    "describe",
    "expand_path",
    "files_of",
    "load_action",
    "load_raw",
    "missing_law_faults",
    "packaged_actions",
    "parse_setting",
    "plain_data",
    "spread_laws",
    "without_paths",
]
