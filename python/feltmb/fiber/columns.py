"""Columns of compression tests: files of testing machines, with units in the header."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unmodeled.data.columns import read_columns
from unmodeled.data.files import read_sheet
from unmodeled.data.mapping import unit_of_column, values_in
from unmodeled.data.series import Columns
from unmodeled.data.sheet import ColumnSpec, ReadOptions, Sheet
from unmodeled.data.tables import plain_name
from unmodeled.errors import DataError, InvalidParameter, shortened
from unmodeled.units import conversion_factor, spelled_unit, weight_hint
from unmodeled.units.quantity import fault_text, parse_scalar

Array = NDArray[np.float64]

#: Quantity -> SI unit, in the order in which they are preferred.
COMPRESSIONS = {"v_f": "1", "strain": "1", "thickness": "m", "displacement": "m"}
LOADS = {"pressure": "Pa", "force": "N"}
_UNITS = COMPRESSIONS | LOADS
#: Names of a displacement that is counted from the first contact.
_FROM_CONTACT = "compression, Stauchung, Stauchweg, Eindrückung, écrasement, enfoncement, 圧縮量"
#: Usual names of testing machines. A name of two quantities is one of them by its unit.
NAMES = {
    "v_f": "v_f, volume fraction, Volumenanteil, fraction volumique",
    "strain": "strain, Dehnung, Stauchung, Verformung, compression, déformation, 应变, ひずみ, 歪",
    "thickness": "thickness, gap, height, Dicke, Höhe, Probendicke, épaisseur, hauteur, 厚度, 厚さ",
    "displacement": "displacement, disp, extension, travel, stroke, position, distance, crosshead, "
    f"crosshead displacement, deflection, deformation, indentation, {_FROM_CONTACT}, Weg, "
    "Standardweg, Traverse, Traversenweg, Verformung, Verschiebung, Kolbenweg, déplacement, "
    "déplacement traverse, course, déformation, flèche, 位移, 变形, "
    "変位, ストローク",
    "pressure": "pressure, stress, Druck, Spannung, Druckspannung, contrainte, pression, 压力, "
    "应力, 応力, 圧力",
    "force": "force, load, load cell, Kraft, Standardkraft, Prüfkraft, Druckkraft, Last, F, "
    "charge, effort, force standard, 力, 载荷, 试验力, 压力, "
    "試験力, 荷重",
}
#: Words beside a name, as in Compressive extension and Charge en compression.
_BESIDE = "compressive, axial, machine, en compression, de compression"
#: Usual names of a column that tells specimens apart.
SPECIMENS = (
    "specimen, specimen no, specimen number, sample, run, test, trial, Probe, Probe Nr, "
    "Probennummer, Proben, Prüfkörper, Muster, Versuch, material, éprouvette, échantillon, essai, "
    "试样"
)
#: Keys of the description of a column that are used.
_KEYS = {"column", "unit", "scale", "origin", "factor", "shift", "si"}
#: Options of reading that are used.
_OPTIONS = {"columns", "units", "scales", "origins"}
#: Keys of a description of a file that would change the samples, and are not used.
_OF_RECORDS = {"interval", "frame_rate", "missing", "first", "last", "every"}
#: Words beside the name of a specimen.
_NUMBERED = ("id", "no", "nr", "number", "nummer", "name", "label", "numéro")
#: Columns of texts that divide the test of one specimen.
_PARTS_OF_A_TEST = ("branch", "phase", "step", "segment", "cycle", "direction", "stage", "state")
#: Texts of parts of the test of one specimen.
_PARTS = {"loading", "unloading", "up", "down", "forward", "back", "hold", "preload"}
#: Least samples of a specimen.
_LEAST = 8
#: Largest value of a sample in SI units: no test has it, and products of such values are numbers.
_LARGEST = 1e20
#: Quantities that decrease under load.
_DECREASING = ("thickness",)
#: Columns of one quantity that differ by less than this share of their range, and a constant, are
#: one reading: no result of a test tells them apart.
_ONE_READING = 1e-3


@dataclass(frozen=True)
class CompressionColumns:
    """Compression and load of a test, in the order of the file."""

    compression: str
    """v_f, strain, thickness or displacement."""
    load: str
    """pressure or force."""
    x: Array
    """Values of the compression [1 or m]."""
    loads: Array
    """Values of the load [Pa or N], compression positive."""
    branches: list[str]
    """Words loading and unloading; empty if the file has no column for them."""
    notes: tuple[str, ...]
    """Columns of the same kind that are not used."""
    from_contact: bool
    """Whether the compression is called so and starts at zero."""
    time: Array | None = None
    """Time of each sample [s]; None if the file has no clock that runs on."""


def read_test(
    path: Path,
    compressions: Sequence[str] = (*COMPRESSIONS,),
    loads: Sequence[str] = (*LOADS,),
    *,
    options: ReadOptions | None = None,
    specimen: str = "",
) -> CompressionColumns:
    """Read compression and load of a test.

    Parameters
    ----------
    path
        File in any format of measured records; a TOML file beside it may describe the columns of
        the quantities.
    compressions, loads
        Quantities that may be used; of several in the file, the first one here.
    options
        Columns of the quantities, of ``time`` and of ``specimen``; units; for raw readings
        ``scales``, the size of one unit of the file, and ``origins``, its zero.
    specimen
        Which one of several specimens.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message.
    """
    options = options or ReadOptions()
    sheet = read_sheet(path) or Sheet()
    specs: dict[str, ColumnSpec] = {**sheet.inputs, **sheet.outputs}
    faults = _unused(path, options, specs)
    faults += [
        f"{path.with_suffix('.toml')}: {key} is not used in a compression test"
        for key in sorted(sheet.model_fields_set & _OF_RECORDS)
    ]
    columns = read_columns(path, strict=False, numbered=bool(options.columns or specs))
    stated = _stated(columns, options, specs, faults)
    notes: list[str] = []
    chosen = []
    for units, wanted in ((COMPRESSIONS, compressions), (LOADS, loads)):
        quantity, column = _choose(columns, units, wanted, stated, faults, notes)
        spec = _spec(quantity, specs, options)
        chosen.append((quantity, column, _values(columns, column, quantity, spec, faults)))
    (quantity, column, x), (load, load_column, p) = chosen
    faults += columns.faults([column, load_column], complete=True)
    branches = _branches(columns, faults)
    time = _time(columns, options, sheet, faults)
    if not faults:
        rows = _specimen(columns, options.columns.get("specimen") or sheet.run, specimen, faults)
        x, p = x[rows], p[rows]
        time = None if time is None else time[rows]
        branches = [branches[i] for i in rows] if branches else []
    if not faults and x.size < 3:
        faults = [f"{x.size} samples, expected at least 3"]
    if not faults:
        x, p = _positive(quantity, x, load, p, faults, notes)
    if faults:
        raise DataError(fault_text(str(path), faults, most=20))
    named = _called(column, _FROM_CONTACT) and quantity == "displacement"
    from_contact = named and abs(float(x[0])) <= 5e-3 * float(np.ptp(x))
    if time is not None and not (np.all(np.diff(time) >= 0.0) and np.ptp(time) > 0.0):
        time = None
    return CompressionColumns(quantity, load, x, p, branches, tuple(notes), from_contact, time)


def _unused(path: Path, options: ReadOptions, specs: Mapping[str, ColumnSpec]) -> list[str]:
    """Faults of names and keys that a compression test does not have."""
    named = {**options.columns, **options.units, **options.scales, **options.origins, **specs}
    sized = {*options.scales, *options.origins, *specs}
    faults = [
        f"{name}: is no quantity of a compression test, expected one of {', '.join(_UNITS)}, time, "
        "specimen (--column QUANTITY=COLUMN, --unit QUANTITY=UNIT)"
        for name in named
        if name not in _UNITS
        and (name not in ("time", "specimen") or name in sized)
        and (name != "specimen" or name in options.units)
    ]
    faults += [
        f"{key}: is not used in a compression test, expected {', '.join(sorted(_OPTIONS))}"
        for key, value in vars(options).items()
        if key not in _OPTIONS and value != getattr(ReadOptions(), key)
    ]
    return faults + [
        f"{path.with_suffix('.toml')}: {key} of {name} is not used in a compression test, expected "
        f"{', '.join(sorted(_KEYS))}"
        for name, spec in specs.items()
        for key in sorted(spec.model_fields_set & ({*ColumnSpec.model_fields, "gain"} - _KEYS))
    ]


def _stated(
    columns: Columns,
    options: ReadOptions,
    specs: Mapping[str, ColumnSpec],
    faults: list[str],
) -> dict[str, str]:
    """Columns by quantity as the user states them; stated units go into ``columns``."""
    stated: dict[str, str] = {}
    for name in _UNITS.keys() & {*options.columns, *options.units, *specs}:
        spec = specs.get(name, ColumnSpec())
        column = options.columns.get(name) or spec.column
        found = columns.find(column or name)
        unit = options.units.get(name) or spec.unit
        if not found and (column or not unit):
            faults.append(
                f"no column {shortened(column or name)!r} for {name}; there are {columns}"
            )
        elif found:
            stated[name] = found
        if unit:
            places = [found] if found else _named(columns, name)
            columns.units |= dict.fromkeys(places, unit)
    return stated


def _spec(quantity: str, specs: Mapping[str, ColumnSpec], options: ReadOptions) -> ColumnSpec:
    """Description of a column, in which the options replace the scale and the origin."""
    given = {"scale": options.scales.get(quantity), "origin": options.origins.get(quantity)}
    return specs.get(quantity, ColumnSpec()).model_copy(
        update={k: v for k, v in given.items() if v is not None}
    )


def _values(
    columns: Columns, column: str, quantity: str, spec: ColumnSpec, faults: list[str]
) -> Array:
    """Values of a column in the SI unit of its quantity; none without a column."""
    if not column:
        return np.zeros(0)
    si = _UNITS[quantity]

    def number(key: str, text: float | str, unit: str) -> float:
        try:
            return parse_scalar(text, unit)
        except ValueError as error:
            faults.append(f"column {shortened(column)}: {key} of {quantity}: {error}")
            return math.nan

    origin = number("origin", spec.origin, "1")
    size = 1.0 if spec.scale == "" else number("scale", spec.scale, si)
    if size == 0.0:
        faults.append(f"column {shortened(column)}: scale of {quantity} = 0, expected another one")
    if spec.scale != "":
        columns.units[column] = si
    unit = unit_of_column(columns, column) or si
    wrong: list[str] = []
    values = values_in(columns, column, si, wrong)
    if wrong and not unit_of_column(columns, column):
        wrong[-1] += (
            f" (or --unit {quantity}={si}; raw readings: --scale {quantity}=SIZE, what one is)"
        )
    faults += wrong
    if origin != 0.0 and not wrong:
        values = values - origin * conversion_factor(unit, si)
    with np.errstate(over="ignore"):
        values = values * size * spec.factor + spec.shift
    faults += [
        f"{columns.place(int(i))}: {shortened(column)} = {values[i]:.4g} {_UNITS[quantity]}, "
        f"expected at most {_LARGEST:g}"
        for i in np.flatnonzero(np.abs(values) > _LARGEST)
    ]
    return values


def _time(columns: Columns, options: ReadOptions, sheet: Sheet, faults: list[str]) -> Array | None:
    """Time of all rows [s]; None without a column of it that has a unit."""
    stated = options.columns.get("time") or sheet.time
    unit = options.units.get("time") or sheet.time_unit
    column = columns.find(stated) if stated else next(iter(columns.called("time")), "")
    if not column:
        if stated or unit:
            faults.append(
                f"no column {shortened(stated or 'time')!r} for time; there are {columns}"
            )
        return None
    if unit:
        columns.units[column] = unit
    wrong: list[str] = []
    values = values_in(columns, column, "s", wrong)
    if stated or unit:
        faults += wrong
    return None if wrong or not np.all(np.isfinite(values)) else values


def _branches(columns: Columns, faults: list[str]) -> list[str]:
    """Words of the column ``branch``; empty if there is none."""
    words = next((c for c in (*columns.texts, *columns.values) if plain_name(c) == "branch"), "")
    branches = [w.strip().lower() for w in columns.texts.get(words, [])]
    if words and not branches:
        faults.append("column branch has numbers, expected the words loading and unloading")
    faults += [
        f'{columns.place(i)}: branch = "{shortened(word)}", expected loading or unloading'
        for i, word in enumerate(branches)
        if word not in ("loading", "unloading")
    ]
    return branches


def _plain(names: str) -> list[str]:
    return [plain_name(name) for name in names.split(",")]


def _called(column: str, names: str) -> bool:
    """Whether a column has one of the names, alone or with the words beside a name."""
    beside = "|".join(_plain(_BESIDE))
    stem = re.fullmatch(f"(?:{beside})*(.*?)(?:{beside})*", plain_name(column))
    return bool({plain_name(column), stem[1] if stem else ""} & {*_plain(names)})


def _specimen(columns: Columns, stated: str, wanted: str, faults: list[str]) -> NDArray[np.intp]:
    """Rows of one specimen; a fault if the file has several and none of them is chosen."""
    size = max((v.size for v in columns.values.values()), default=0)
    named: dict[str, Sequence[float | str]] = {c: v.tolist() for c, v in columns.values.items()}
    named |= columns.texts
    column = next((c for c in named if stated and plain_name(c) == plain_name(stated)), "")
    if stated and not column:
        faults.append(f"no column {shortened(stated)!r} for specimen; there are {columns}")
        return np.arange(size)
    labels, where = _labels(columns, named, column, size)
    found = list(dict.fromkeys(labels))
    if len(found) > 1 and not wanted:
        faults.append(
            f"{len(found)} specimens ({where}): {shortened(', '.join(found), 300)}; expected one: "
            "choose it (--specimen NAME, in Python specimen)"
        )
    elif wanted and wanted not in found:
        faults.append(f"no specimen {shortened(wanted)!r} ({where}); there are {', '.join(found)}")
    return np.flatnonzero(np.array(labels) == (wanted or found[0]))


def _labels(
    columns: Columns, named: Mapping[str, Sequence[float | str]], column: str, size: int
) -> tuple[list[str], str]:
    """Name of the specimen of each row, and what tells it."""
    if not column:
        several = (n for n in named if len(set(named[n])) * _LEAST <= size)
        column = next((n for n in several if _tells_specimens(n, named[n])), "")
    if column:
        cells = named[column]
        labels = [c.strip() if isinstance(c, str) else f"{c:.10g}" for c in cells]
        return labels, f"column {shortened(column)}"
    clock = columns.called("time")
    if clock and np.any(np.diff(columns.values[clock[0]]) < 0.0):
        restarts = np.cumsum(np.diff(columns.values[clock[0]], prepend=-np.inf) < 0.0)
        return [str(k + 1) for k in restarts], f"column {clock[0]} starts again"
    return ["1"] * size, "one specimen"


def _tells_specimens(name: str, cells: Sequence[float | str]) -> bool:
    """Whether a column tells specimens apart.

    It is called so (``Sample ID``, ``Test No.``), or it has texts, each in one block of rows.
    """
    words = re.findall(r"[^\W\d_]+", name)
    stem = plain_name("".join(w for w in words if w.lower() not in _NUMBERED))
    parts = {str(c).strip().lower() for c in cells} & _PARTS
    if parts or not words:
        return False
    if stem in ("", *_plain(SPECIMENS)):
        return True
    blocks = 1 + sum(a != b for a, b in pairwise(cells))
    texts = all(isinstance(c, str) for c in cells)
    return texts and plain_name(name) not in _PARTS_OF_A_TEST and blocks == len(set(cells)) > 1


def _named(columns: Columns, quantity: str) -> list[str]:
    """Columns with a usual name of a quantity, whose unit measures it, or is unknown."""
    known = NAMES[quantity]
    return [c for c in columns.values if _called(c, known) and _fits(columns, c, quantity)]


def _wrong_units(columns: Columns, wanted: Sequence[str]) -> Iterator[str]:
    """Faults of columns with the name of a quantity in a unit that does not measure it."""
    for quantity in wanted:
        si = _UNITS[quantity]
        for column in (c for c in columns.values if _called(c, NAMES[quantity])):
            unit = unit_of_column(columns, column)
            other = f"{unit}f" if weight_hint(unit, si) and unit in ("g", "kg", "lb") else si
            yield (
                f"column {shortened(columns.headings.get(column, column))}: unit {unit} does not "
                f"measure a {quantity}, expected a unit of {si}{weight_hint(unit, si)} "
                f"(--column {quantity}={shlex.quote(column)} --unit {quantity}={other}, in Python "
                "options)"
            )


def _fits(columns: Columns, column: str, quantity: str) -> bool:
    unit = unit_of_column(columns, column)
    if not unit or spelled_unit(unit) is None:
        return True
    try:
        conversion_factor(unit, _UNITS[quantity])
    except InvalidParameter:
        return False
    return True


def _no_column(columns: Columns, wanted: Sequence[str]) -> str:
    known = "; ".join(f"{q}: {NAMES[q]}" for q in wanted)
    return (
        f"expected a column {' or '.join(wanted)}; there are {columns}. Names: {known}; also with "
        f"{_BESIDE} (another one: --column {wanted[0]}=COLUMN --unit {wanted[0]}=UNIT, in Python "
        "options)"
    )


def _choose(
    columns: Columns,
    units: dict[str, str],
    wanted: Sequence[str],
    stated: dict[str, str],
    faults: list[str],
    notes: list[str],
) -> tuple[str, str]:
    """Quantity and its column; empty with a fault if there is none."""
    named = {q: [stated[q]] if q in stated else _named(columns, q) for q in units}
    quantity = next((q for q in wanted if q in stated), "") or next(
        (q for q in wanted if named[q]), ""
    )
    if not quantity:
        faults += [*_wrong_units(columns, wanted)] or [_no_column(columns, wanted)]
        return "", ""
    headings = [columns.headings.get(c, c) for c in named[quantity]]
    alike = len(headings) > 1 and _one_reading(columns, named[quantity], units[quantity])
    if alike:
        notes.append(
            f"{headings[0]} is used, not {shortened(', '.join(headings[1:]), 300)}, which differs "
            "from it by no more than a constant"
        )
    elif len(headings) > 1:
        faults.append(
            f"columns {shortened(', '.join(headings), 300)} are each a {quantity}, expected one: "
            f"--column {quantity}=COLUMN chooses it (in Python options)"
        )
    beside = dict.fromkeys(c for q in units for c in named[q] if c not in named[quantity])
    others = [columns.headings.get(c, c) for c in beside]
    if others:
        notes.append(
            f"{headings[0]} is used, not {shortened(', '.join(dict.fromkeys(others)), 300)}"
        )
    return quantity, named[quantity][0]


def _one_reading(columns: Columns, names: Sequence[str], unit: str) -> bool:
    """Whether columns differ by no more than a constant."""
    first, *others = (values_in(columns, name, unit, []) for name in names)
    room = _ONE_READING * float(np.ptp(first))
    return all(float(np.ptp(other - first)) <= room for other in others)


def _positive(
    quantity: str, x: Array, load: str, p: Array, faults: list[str], notes: list[str]
) -> tuple[Array, Array]:
    """Compression and load with positive signs; machines for tension have both negative."""
    turned = []
    if not np.max(p) > -np.min(p):
        turned, p = [load], -p
    along = float(np.sum((x - np.mean(x)) * p))
    decreasing = quantity in _DECREASING
    if along < 0.0 and turned and not decreasing:
        turned, x = [quantity, *turned], -x
    elif (along > 0.0) == decreasing and along:
        does, sign = ("increases", "decrease") if decreasing else ("decreases", "increase")
        faults.append(f"{quantity} {does} with the load, expected it to {sign} in compression")
    if not np.max(p) > 0.0:
        faults.append(f"{load} is 0, expected a load")
    if turned:
        notes.append(
            f"{' and '.join(turned)} decrease{'s' if len(turned) == 1 else ''} in compression: the "
            "sign is reversed"
        )
    return x, p
