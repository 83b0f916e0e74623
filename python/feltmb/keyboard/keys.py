"""The weights of a keyboard, key by key, and their files: Piano Touch Lab (JSON) and CSV.

Weights are in grams, as technicians keep them: a weight of 1 g on a key is a force of 1 gf.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unmodeled.arguments import checked
from unmodeled.data.tables import read_number, read_table, text_lines
from unmodeled.errors import DataError, near_names
from unmodeled.files import LARGEST_TABLE, check_suffix, read_input, read_json, write_text
from unmodeled.units import split_column
from unmodeled.units.quantity import fault_text

if TYPE_CHECKING:
    import pandas as pd

#: MIDI number of key 1, the A0.
FIRST_MIDI = 21
NAMES = ("C", "C#", "D", "D#", "E", "F", "F#", "G", "G#", "A", "A#", "B")
FEWEST, MOST = 20, 108
#: Unit of a column of weights -> grams.
GRAMS = {"": 1.0, "g": 1.0, "gf": 1.0, "oz": 28.349523, "ozf": 28.349523, "kg": 1e3, "kgf": 1e3,
         "N": 101.97162, "cN": 1.0197162, "mN": 0.10197162, "lb": 453.59237}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One measured number of a key."""

    text: str
    unit: str
    low: float
    high: float
    json: str


COLUMNS = {
    "down_weight": Column("down weight", "g", 15.0, 200.0, "downWeightWithoutSpringSupport"),
    "down_weight_with_spring": Column(
        "down weight with support spring", "g", 15.0, 200.0, "downWeightWithSpringSupport"
    ),
    "up_weight": Column("up weight", "g", 0.0, 150.0, "upWeight"),
    "front_weight": Column("front weight", "g", -60.0, 80.0, "frontWeight"),
    "strike_weight": Column("strike weight", "g", 2.0, 20.0, "strikeWeight"),
    "key_ratio": Column("key weight ratio", "1", 0.3, 0.8, "keyWeightRatio"),
    "strike_weight_ratio": Column(
        "measured strike weight ratio", "1", 3.0, 10.0, "measuredStrikeWeightRatio"
    ),
    "whippen_weight": Column("whippen radius weight", "g", 5.0, 40.0, "wippenRadiusWeight"),
}


def note_name(key: int) -> str:
    """Name of a key, such as ``A4`` for key 49; key 1 is A0.

    Examples
    --------
    >>> from feltmb import keyboard
    >>> keyboard.note_name(1), keyboard.note_name(49)
    ('A0', 'A4')
    """
    octave, step = divmod(key + FIRST_MIDI - 1, 12)
    return f"{NAMES[step]}{octave - 1}"


def is_sharp(key: int) -> bool:
    """Whether the key is a short one."""
    return "#" in note_name(key)


@dataclass(frozen=True, eq=False)
class Keyboard:
    """Weights of the keys of one instrument.

    Attributes
    ----------
    name : str
        Instrument.
    frame : DataFrame
        One row a key, key 1 first; columns as in ``COLUMNS``, weights in g; NaN: not measured.
    notes : tuple of str
        What was assumed or left out when the file was read.
    """

    name: str
    frame: pd.DataFrame
    notes: tuple[str, ...] = ()

    @checked
    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the weights as ``.csv`` or as ``.json`` of Piano Touch Lab.

        Parameters
        ----------
        path
            File to be written.
        force
            False: an existing file is not overwritten.
        """
        path = Path(path)
        check_suffix(path, ".csv", ".json")
        text = self._csv() if path.suffix.lower() == ".csv" else self._json()
        return write_text(path, text, force=force)

    def _csv(self) -> str:
        given = self.frame.dropna(axis="columns", how="all")
        heads = [f"{COLUMNS[c].text} [{COLUMNS[c].unit}]" for c in given]
        return str(given.to_csv(header=heads, index_label="key", lineterminator="\n"))

    def _json(self) -> str:
        keys = [
            {
                c.json: None if math.isnan(v) else v
                for c, v in zip(COLUMNS.values(), row, strict=True)
            }
            for row in self.frame[list(COLUMNS)].to_numpy(float).tolist()
        ]
        brand, _, model = self.name.partition(" ")
        piano = {"brand": brand, "model": model, "keyCount": len(keys), "startNote": "A0"}
        measures = {"keys": keys, "keyWeightRatio": None, "wippenRadiusWeight": None}
        return json.dumps({"measures": measures, "piano": piano}, indent=1) + "\n"


@checked
def read_keyboard(path: str | Path) -> Keyboard:
    """Read the weights of a keyboard from a CSV file or from JSON of Piano Touch Lab.

    A CSV file has one row a key; the columns are found by their names, such as ``down weight [g]``,
    and their units (g, gf, oz, N). ``down weight`` is that without the support spring of the
    whippen; the up weight is measured without it, too.

    Raises
    ------
    DataError
        The file cannot be read, or holds weights that no keyboard has; all faults are told.
    """
    path = Path(path)
    reader = _from_json if path.suffix.lower() == ".json" else _from_csv
    return reader(path)


def _checked(path: Path, name: str, rows: Mapping[int, Mapping[str, float]], last: int,
             notes: list[str], faults: list[str]) -> Keyboard:  # fmt: skip
    """The keyboard of rows by key, if they have no fault."""
    import numpy as np
    import pandas as pd

    frame = pd.DataFrame.from_dict({k: dict(rows[k]) for k in sorted(rows)}, orient="index")
    frame = frame.reindex(columns=list(COLUMNS)).astype(float)
    for needed in ("down_weight", "up_weight"):
        if frame[needed].notna().sum() < FEWEST and not faults:
            faults.append(
                f"{COLUMNS[needed].text}: got {frame[needed].notna().sum()} numbers, expected one "
                f"a key, at least {FEWEST}"
            )
    faults += _strange(frame)
    if not FEWEST <= last <= MOST:
        faults.append(f"keys: got {last}, expected {FEWEST} to {MOST}, and 88 on most pianos")
    if faults:
        raise DataError(fault_text(str(path), faults))
    if last != 88:
        notes.append(f"the keyboard has {last} keys, not 88; key 1 is taken as A0")
    missing = np.setdiff1d(np.arange(1, last + 1), frame.index)
    if missing.size:
        listed = ", ".join(map(str, missing[:12])) + (", ..." if missing.size > 12 else "")
        notes.append(f"{missing.size} keys are missing ({listed}); their curves are interpolated")
    frame = frame.reindex(pd.RangeIndex(1, last + 1, name="key"))
    return Keyboard(name, frame, tuple(notes))


def _strange(frame: pd.DataFrame) -> Iterator[str]:
    """Weights that no keyboard has; most of a column: one fault of the column."""
    for name, column in COLUMNS.items():
        values = frame[name].dropna()
        wrong = values[(values < column.low) | (values > column.high)]
        expected = f"expected {column.low:g} to {column.high:g} {column.unit}"
        if len(wrong) <= 3:
            yield from (f"key {k}: {column.text}: got {v:g}, {expected}" for k, v in wrong.items())
            continue
        hint = "are the columns in this order?"
        if column.unit == "g" and column.low <= abs(GRAMS["oz"] * wrong.median()) <= column.high:
            hint = "if these are ounces, write the unit into the head of the column, [oz]"
        yield (
            f"{column.text}: {len(wrong)} of {len(values)} numbers, {wrong.min():g} to "
            f"{wrong.max():g}, are no {column.text}; {expected}; {hint}"
        )
    pairs = (("up_weight", "down_weight"), ("down_weight_with_spring", "down_weight"))
    for less, more in pairs:
        turned = frame.index[frame[less] >= frame[more]]
        texts = COLUMNS[less].text, COLUMNS[more].text
        if 2 * len(turned) > (frame[less].notna() & frame[more].notna()).sum():
            yield (
                f"{texts[0]}: not below the {texts[1]} on {len(turned)} keys; expected less; the "
                "two columns seem to be swapped"
            )
        else:
            for k in turned:
                got = f"{frame.at[k, less]:g} g", f"{frame.at[k, more]:g} g"
                yield f"key {k}: {texts[0]}: got {got[0]}, expected below the {texts[1]}, {got[1]}"


# --- CSV -----------------------------------------------------------------------------------------


def _meaning(head: str) -> str | None:
    """Column of a head, ``key`` for the number of the key; None: unknown."""
    words = set(re.findall(r"[a-z#]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", head).lower()))
    spring = "spring" in words and "without" not in words
    rules: tuple[tuple[str, Callable[[], bool]], ...] = (
        ("down_weight_with_spring", lambda: bool({"down", "dw"} & words) and spring),
        ("down_weight", lambda: bool({"down", "dw"} & words)),
        ("up_weight", lambda: bool({"up", "uw"} & words)),
        ("front_weight", lambda: bool({"front", "fw"} & words)),
        ("strike_weight_ratio", lambda: "strike" in words and "ratio" in words),
        ("strike_weight", lambda: bool({"strike", "sw", "hammer"} & words)),
        ("key_ratio", lambda: "ratio" in words),
        ("whippen_weight", lambda: any(re.match("wh?ipp?en", w) for w in words)),
        ("key", lambda: bool({"key", "note", "nr", "no", "number", "#"} & words)),
    )
    return next((name for name, holds in rules if holds()), None)


def _from_csv(path: Path) -> Keyboard:
    lines = text_lines(read_input(path, most=LARGEST_TABLE), path)
    lines = lines.where(lambda line: not line.lstrip().startswith("#"))
    if len(lines) < 2:
        raise DataError(f"{path}: got no rows, expected a head and one row a key")
    table = read_table(lines)
    faults: list[str] = []
    notes: list[str] = []
    found: dict[str, tuple[int, float]] = {}
    for place, head in enumerate(table.header):
        name, unit = split_column(head)
        bracket = re.search(r"[\[(]\s*(ozf?)\s*[\])]", head)
        unit = bracket[1] if bracket else unit
        meaning = _meaning(name)
        if meaning is None:
            notes.append(f"column {head.strip()!r} is not used{near_names(name, COLUMNS)}")
            continue
        plain = meaning in ("key", "key_ratio", "strike_weight_ratio")
        if meaning in found:
            faults.append(f"column {head.strip()!r}: a second column of this kind, expected one")
        elif not plain and unit not in GRAMS:
            faults.append(f"column {head.strip()!r}: got [{unit}], expected one of "
                          f"{', '.join(filter(None, GRAMS))}")  # fmt: skip
        else:
            found[meaning] = (place, 1.0 if plain else GRAMS[unit])
    if "key" not in found:
        faults.append(
            f"got the columns {', '.join(table.header) or 'none'}; expected a column 'key' with "
            "the numbers from 1, and such as 'down weight [g]', 'up weight [g]', 'front weight "
            "[g]', 'strike weight [g]', 'key ratio'"
        )
        raise DataError(fault_text(str(path), faults))
    rows: dict[int, dict[str, float]] = {}
    for line, cells in table.rows:
        given = {}
        for meaning, (place, factor) in found.items():
            cell = cells[place] if place < len(cells) else ""
            number = read_number(cell, table.decimal)
            if number is None:
                faults.append(f"line {line}: {meaning}: got {cell!r}, expected a number")
            else:
                given[meaning] = factor * number
        key = given.pop("key", math.nan)
        if not (key >= 1 and key == int(key)) or key > MOST:
            faults.append(
                f"line {line}: key: got {key:g}, expected a whole number from 1 to {MOST}"
            )
        elif int(key) in rows:
            faults.append(f"line {line}: key {key:g}: given twice")
        else:
            rows[int(key)] = given
    return _checked(path, path.stem, rows, _size(rows), notes, faults)


def _size(rows: Mapping[int, object]) -> int:
    """Number of keys; a file of most keys of 88 lacks some of them."""
    last = max(rows, default=0)
    return 88 if 80 < last < 88 and len(rows) < last else last


# --- JSON ----------------------------------------------------------------------------------------


def _numbers_of(
    entry: Mapping[str, Any], measures: Mapping[str, Any], where: str, faults: list[str]
) -> dict[str, float]:
    """Numbers of a key; what its entry lacks stands above all keys."""
    older = {"downWeightWithoutSpringSupport": entry.get("downWeight")}
    found = {}
    for name, column in COLUMNS.items():
        value = entry.get(column.json, older.get(column.json))
        value = measures.get(column.json) if value is None else value
        if isinstance(value, bool) or not isinstance(value, (int, float, type(None))):
            faults.append(f"{where}.{column.json}: got {value!r}, expected a number or null")
        elif value is not None:
            found[name] = float(value)
    return found


def _from_json(path: Path) -> Keyboard:
    data = read_json(path)
    top: Any = data if isinstance(data, dict) else {}
    places = [top.get("measures"), top.get("data"), top]
    measures = next((p for p in places if isinstance(p, dict) and "keys" in p), None)
    if measures is None or not isinstance(measures["keys"], list):
        raise DataError(
            f"{path}: got no list measures.keys, expected an export of Piano Touch Lab with one "
            "entry a key"
        )
    piano = top.get("piano") if isinstance(top.get("piano"), dict) else {}
    faults: list[str] = []
    notes: list[str] = []
    start, keys = piano.get("startNote"), measures["keys"]
    if start not in (None, "A0"):
        notes.append(f"the first key is {start}; the colors of the keys are those from A0")
    count = piano.get("keyCount")
    if isinstance(count, int) and count != len(keys):
        faults.append(f"measures.keys: got {len(keys)} keys, expected {count}, piano.keyCount")
    rows: dict[int, dict[str, float]] = {}
    for key, entry in enumerate(keys, start=1):
        if isinstance(entry, dict):
            rows[key] = _numbers_of(entry, measures, f"measures.keys[{key - 1}]", faults)
        else:
            faults.append(f"measures.keys[{key - 1}]: got {type(entry).__name__}, expected a table")
    told = (str(piano.get(k) or "").strip() for k in ("brand", "model"))
    return _checked(path, " ".join(filter(None, told)) or path.stem, rows, len(keys), notes, faults)
