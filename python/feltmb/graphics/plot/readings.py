"""Data of a run for the figures: contacts, events, time windows, its mechanism."""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from feltmb.run.reading import striker_speed
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.style import plain_text

if TYPE_CHECKING:
    from feltmb.mechanism import Action
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]


def need_samples(run: Run) -> None:
    """Raise an error for a run with fewer than two samples."""
    if len(run.time) < 2:
        raise InvalidParameter(f"plot: the run has {len(run.time)} samples, expected at least 2")


def need_output(run: Run, name: str, picture: str) -> None:
    """Raise an error for a run without a required output."""
    if name not in run:
        raise InvalidParameter(f"plot {picture}: the run has no output {name!r}")


@checked
def run_action(run: Run) -> Action:
    """Mechanism of a run, made from the text of its parameters.

    Raises
    ------
    InvalidParameter
        The run does not contain its parameters, or those of another mechanism.
    """
    from feltmb.mechanism import Action, without_paths
    from unmodeled.files import parse_toml

    text = run.provenance.get("toml")
    if not text:
        raise InvalidParameter("plot: the run does not hold the parameters of its mechanism")
    origin = str(run.provenance.get("action", "run"))
    raw = parse_toml(str(text), f"{origin}: the mechanism of the run")
    action = Action(without_paths(raw, origin), origin=origin)
    other = {*contact_numbers(run)} - {*action.mechanism.contact_numbers}
    if action.coordinates != run.coordinates or other:
        raise InvalidParameter(
            f"{origin}: the run holds the parameters of another mechanism: coordinates "
            f"{', '.join(action.coordinates)}, expected {', '.join(run.coordinates)}"
            + (f"; contacts {sorted(other)} are missing" if other else "")
        )
    return action


def run_name(run: Run) -> str:
    """Mechanism and stroke of a run, as text for matplotlib."""
    stroke = run.provenance.get("stroke", {}).get("name", "")
    action = str(run.provenance.get("action", ""))
    return plain_text(
        " · ".join(part for part in (action, f"stroke {stroke}" if stroke else "") if part)
    )


def contact_label(run: Run, number: int) -> str:
    """Number and name of a contact, as text for matplotlib in short lines."""
    name = f"contact{number:02d}.force"
    text = run.long_names[run.names.index(name)]
    label = text.partition(": ")[2]
    label = shortened(f"{number} {label}" if label else f"contact {number}", MOST_LETTERS)
    return plain_text(textwrap.fill(label, LINE))


def contact_numbers(run: Run) -> list[int]:
    """Numbers of the contacts in the run, sorted."""
    found = (re.fullmatch(r"contact(\d+)\.force", name) for name in run.names)
    return sorted(int(match.group(1)) for match in found if match)


def loaded_contacts(run: Run, least: float = 1e-6) -> list[int]:
    """Numbers of the contacts with a force above ``least`` [N] in any sample."""
    return [n for n in contact_numbers(run) if float(np.max(run[f"contact{n:02d}.force"])) > least]


#: Longest name of a contact in a figure, and its longest line, in letters.
MOST_LETTERS, LINE = 60, 32
_AUTOMATIC = re.compile(r"(contact\d+|finger)_(on|off)")
#: Share of the largest travel of the key that it travels in a note.
NOTE = 0.3


def named_events(run: Run) -> list[tuple[float, str]]:
    """Times [s] and names of the events that the mechanism file names, in time, each once.

    A point may reach its travel several times; a rule names only the first event.
    """
    table = run.event_table
    first: dict[str, float] = {}
    for name, time in zip(table.get("event", []), table.get("time", []), strict=True):
        if not _AUTOMATIC.fullmatch(str(name)):
            first.setdefault(str(name), float(time))
    return sorted((time, name) for name, time in first.items())


def repeated_strikes(run: Run) -> list[dict[str, float]]:
    """All strikes of a run with several notes, as in ``run.strikes``; empty for one note.

    In a note, the key goes down by a part of its largest travel. A hammer that bounces strikes
    again, and is no other note.
    """
    travels = [s.get("key_travel", 0.0) for s in run.strike_list]
    notes = sum(travel > NOTE * max(travels) for travel in travels)
    return list(run.strike_list) if notes > 1 else []


def marked_events(run: Run) -> list[tuple[float, str]]:
    """Times [s] and names of the marks: the strikes of several notes, or the named events."""
    strikes = repeated_strikes(run)
    if not strikes:
        return named_events(run)
    return [(s["impact_time"], f"strike {i}") for i, s in enumerate(strikes, start=1)]


def action_window(run: Run) -> tuple[float, float]:
    """Times [s] around the named events; the whole run if there are none or they fill it.

    Of several notes: the time in which the mechanism moves.
    """
    if repeated_strikes(run):
        return busy_window(run)
    times = [t for t, _ in named_events(run)]
    start, end = float(run.time[0]), float(run.time[-1])
    if len(times) < 2:
        return start, end
    first = min((t for t, name in named_events(run) if name != "key_start"), default=times[0])
    span = max(times[-1] - first, 1e-3)
    return max(start, first - 0.6 * span), min(end, times[-1] + 1.2 * span)


def busy_window(run: Run) -> tuple[float, float]:
    """Interval [s] in which forces and motions change, with a margin."""
    start, end = float(run.time[0]), float(run.time[-1])
    columns = [
        i
        for i, name in enumerate(run.names)
        if re.fullmatch(r"contact\d+\.force|finger\.force|.+\.[xy]", name)
    ]
    if not columns:
        return start, end
    values = run.values[:, columns]
    size = np.ptp(values, axis=0)
    values = values[:, size > 1e-6 * max(float(size.max()), 1e-30)]
    size = np.ptp(values, axis=0)
    if size.size == 0:
        return start, end
    leaves = np.any(np.abs(values - values[0]) > 0.02 * size, axis=1)
    settles = np.any(np.abs(values - values[-1]) > 0.02 * size, axis=1)
    first = float(run.time[int(np.argmax(leaves))])
    last = float(run.time[len(run.time) - 1 - int(np.argmax(settles[::-1]))])
    span = max(last - first, 1e-3)
    return max(start, first - 0.06 * span), min(end, last + 0.06 * span)


def string_window(run: Run) -> tuple[float, float]:
    """Interval [s] in which the string moves at the strike point, with a margin."""
    start, end = float(run.time[0]), float(run.time[-1])
    strike = np.abs(run["string.strike"]) if "string.strike" in run else np.zeros(1)
    top = float(strike.max())
    if top <= 0:
        return start, end
    moving = np.flatnonzero(strike > 0.02 * top)
    first, last = float(run.time[moving[0]]), float(run.time[moving[-1]])
    span = max(last - first, 2e-3)
    return max(start, first - 0.08 * span), min(end, last + 0.08 * span)


def need_striker(run: Run) -> Array:
    """Speed of the striking point in its direction [m/s]."""
    speed = striker_speed(run)
    if speed is None:
        raise InvalidParameter(
            "plot striker_speed: the mechanism of the run names no point that strikes; give it "
            "reading.striker, such as { point = 'hammer_tip', direction = [-1.0, 0.0] }"
        )
    return speed


def finger_work(run: Run) -> Array | None:
    """Work [J] of the finger since the start, from force and travel; None without these."""
    if "finger.force" not in run or "finger.displacement" not in run:
        return None
    force, travel = run["finger.force"], run["finger.displacement"]
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(travel)
    return np.concatenate([[0.0], np.cumsum(steps)])
