"""Notes that say the same of several records, as one note."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

__all__ = ["grouped"]

#: Number of records from which only the first ones are named.
MOST_NAMED = 8
#: A part of a record: run[1/2].
_PART = re.compile(r"\[[^\]]*\]$")
_NUMBER = re.compile(r"(?<![\w.\[/])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w/]|\.\d)")


def grouped(notes: Iterable[str], records: Iterable[str]) -> list[str]:
    """Notes in their order; those of several records that differ in numbers only become one.

    A note of one record begins with its name: ``run: text`` or ``run.channel: text``. Of several
    ones, a number is a range: ``in all 3 records: channel: 27 .. 40% of the values are missing``.

    Parameters
    ----------
    notes
        Notes about records and about all of them.
    records
        Names of the records.
    """
    parts = {*records}
    wholes = {_PART.sub("", name) for name in parts}
    names = sorted(parts | wholes, key=lambda n: (-len(n), n))
    found: dict[tuple[bool, str], list[tuple[str, str, str]]] = {}
    for note in dict.fromkeys(notes):
        name, text = _split(note, names)
        # Without a record, equal numbers are part of what is said.
        kind = _NUMBER.sub("#", text) if name else note
        found.setdefault((bool(name), kind), []).append((name, text, note))
    out = []
    for (of_record, _), same in found.items():
        told = list(dict.fromkeys(name for name, *_ in same))
        if not of_record or len(told) < 2 or len(told) < len(same):
            out += [note for *_, note in same]
        else:
            where = f"all {len(told)} records" if {*told} in (parts, wholes) else _listed(told)
            out.append(f"in {where}: {_ranges([text for _, text, _ in same]).removeprefix('.')}")
    return out


def _split(note: str, names: Sequence[str]) -> tuple[str, str]:
    """Name of the record of a note and the text with its channel; no name: of all records."""
    for name in names:
        for start in (name, f"record {name}"):
            if note.startswith(f"{start}: "):
                return name, note[len(start) + 2 :]
            if note.startswith(f"{start}.") and ": " in note:
                return name, note[len(start) :]
    return "", note


def _listed(told: Sequence[str]) -> str:
    more = len(told) - MOST_NAMED
    names = ", ".join(told[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"{len(told)} records ({names})"


def _ranges(texts: Sequence[str]) -> str:
    """The text of all, which differ in numbers only; such a number is its range."""
    numbers = iter(zip(*(_NUMBER.findall(text) for text in texts), strict=True))

    def range_of(_: re.Match[str]) -> str:
        values = next(numbers)
        low, high = min(values, key=float), max(values, key=float)
        return low if low == high else f"{low} .. {high}"

    return _NUMBER.sub(range_of, texts[0])
