"""Interpretation of a run according to ``[reading]`` of its mechanism file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from feltmb.errors import InvalidParameter
from feltmb.files import parse_toml
from feltmb.mechanism import Reading

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.run.results import Run

__all__ = ["reading_of", "row_unit", "strike_words", "striker_speed"]


def reading_of(run: Run) -> Reading:
    """``[reading]`` of the mechanism of a run; empty if the run does not contain it."""
    try:
        return Reading.model_validate(_tables(run).get("reading", {}))
    except ValidationError:
        return Reading()


def _tables(run: Run) -> dict[str, Any]:
    """Tables of the mechanism of a run; none if the run does not hold it."""
    try:
        return parse_toml(str(run.provenance.get("toml", "")), "run")
    except InvalidParameter:
        return {}


def strike_words(run: Run) -> dict[str, str]:
    """Texts of the numbers of a strike, by their name in ``run.summary``.

    They name what the label of the strike contact names ("hammer - string"), else its surfaces.
    """
    number = reading_of(run).strike_contact
    contact: Any = _tables(run).get("contacts", {})
    contact = contact.get(f"{number or 0:02d}", {}) if isinstance(contact, dict) else {}
    contact = contact if isinstance(contact, dict) else {}
    one, mark, other = str(contact.get("label", "")).partition(" - ")
    surfaces = contact.get("surfaces")
    if not mark and isinstance(surfaces, list) and len(surfaces) == 2:
        one, other = (str(s) for s in surfaces)
    if not (one and other):
        return {
            "impact_time": "impact",
            "max_string_force": "largest force of the impact",
            "string_contact_duration": "contact of the impact lasts",
            "let_off_gap": "distance at let-off",
        }
    return {
        "impact_time": f"{one} meets the {other}" if mark else f"{one} meets {other}",
        "max_string_force": f"largest {other} force",
        "string_contact_duration": f"{other} contact lasts",
        "let_off_gap": f"{one} - {other} distance at let-off",
    }


def row_unit(run: Run, name: str) -> str:
    """SI unit of a row of ``[reading.rows]``."""
    output = reading_of(run).rows[name].output
    return "s" if output is None else run.unit(output)


def striker_speed(run: Run) -> npt.NDArray[np.float64] | None:
    """Speed of the striking point along its direction [m/s]; None if there is none."""
    striker = reading_of(run).striker
    if striker is None or f"{striker.point}.vx" not in run:
        return None
    length = (striker.direction[0] ** 2 + striker.direction[1] ** 2) ** 0.5
    x, y = (part / length for part in striker.direction)
    speed: npt.NDArray[np.float64] = x * run[f"{striker.point}.vx"] + y * run[f"{striker.point}.vy"]
    return speed
