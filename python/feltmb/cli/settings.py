"""Mechanisms on the command line with changed values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

from feltmb.cli import completing
from unmodeled.cli.options import option
from unmodeled.cli.screen import complain

if TYPE_CHECKING:
    from feltmb.action.actuator import Actuator
    from feltmb.mechanism import Action

M = TypeVar("M", "Action", "Actuator")

SET = option(
    "Change a value of the mechanism by its dotted path, such as string.modes=80 or "
    "contacts.*.law=printed; a bare number is in SI units. PATH+=AMOUNT, PATH-=AMOUNT and "
    "PATH*=FACTOR change a number: surfaces.Gp10.point.y+=0.5mm.",
    words="--set",
    metavar="PATH=VALUE",
    complete=completing.settings,
)


def load_with_settings(name: str, settings: Sequence[str] = ()) -> Action:
    """Mechanism by name or path, with the values of ``--set``."""
    from feltmb.mechanism import load_action

    return with_settings(load_action(name), settings)


def with_settings(model: M, settings: Sequence[str]) -> M:
    """Model of a file with the values of ``--set``; tells what changed numbers became."""
    from feltmb.mechanism.parameters import with_noted_values

    return with_noted_values(model, settings, complain)
