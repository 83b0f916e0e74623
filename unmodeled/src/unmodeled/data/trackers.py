"""Exports of trackers: Kinovea, Tracker, DeepLabCut, OptiTrack Motive, Vicon Nexus, Qualisys.

The header identifies the program. A point P becomes the columns ``P.x`` and ``P.y``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from unmodeled.data.records import Array
from unmodeled.data.series import MOST_NUMBERS, Columns, columns_of, limit_text
from unmodeled.data.tables import Lines, read_number, read_table
from unmodeled.errors import DataError
from unmodeled.units import PIXEL, split_column

_KINOVEA_TEXT = "#kinovea trajectory data export"
_SEPARATORS = ("\t", ",", ";")


def read_tracked(path: Path, lines: Lines) -> Columns | None:
    """Series of an export with a known header; None for any other text."""
    capture = (_optitrack, _vicon, _qualisys)
    for reader in (_kinovea_text, _deeplabcut, _tracker, *capture, _kinovea_table):
        columns = reader(path, lines)
        if columns is not None:
            return columns
    return None


def _cells(line: str) -> list[str]:
    separator = max(_SEPARATORS, key=line.count)
    return [c.strip().strip('"') for c in line.split(separator)]


# ---------------------------------------------------------------- Kinovea


def _kinovea_table(path: Path, lines: Lines) -> Columns | None:
    """Columns: time, then NAME/KEY/X and NAME/KEY/Y of every point."""
    head = _cells(lines.texts[0]) if len(lines) else []
    points = [c.rsplit("/", 2) for c in head[1:]]
    named = all(len(p) == 3 and all(p) and p[2] in "XY" for p in points)
    if len(head) < 3 or not named or not head[0].lower().startswith("time"):
        return None
    several: dict[str, set[str]] = {}
    for point, key, _ in points:
        several.setdefault(point, set()).add(key)
    names = [split_column(head[0])]
    for point, key, axis in points:
        name = point if len(several[point]) == 1 else f"{point}.{key}"
        names.append((f"{name}.{axis.lower()}", ""))
    columns = columns_of(path, read_table(lines), names)
    columns.source = "Kinovea"
    if names[0][0] not in columns.units:
        columns.notes.append("Kinovea says no unit of time: seconds, its default")
    return columns


def _kinovea_text(path: Path, lines: Lines) -> Columns | None:
    """Blocks of T X Y, one per trajectory; a block starts at its name or when the time restarts."""
    if not (len(lines) and lines.texts[0].strip().lower().startswith(_KINOVEA_TEXT)):
        return None
    blocks, code = _kinovea_blocks(path, lines)
    columns = Columns(source="Kinovea")
    clock = np.unique(np.concatenate([rows[:, 0] for _, rows in blocks] or [np.zeros(0)]))
    # Points that are seen at different times need the square of their number.
    if clock.size * (1 + 2 * len(blocks)) > MOST_NUMBERS:
        raise DataError(f"{path}: {len(blocks)} points at {clock.size} times; {limit_text()}")
    columns.values["time"] = clock
    columns.units["time"] = "s"
    columns.notes.append(
        "times of Kinovea are read as h:mm:ss:hundredths"
        if code
        else "Kinovea says no unit of time: seconds, its default"
    )
    for name, rows in blocks:
        for k, axis in ((1, "x"), (2, "y")):
            values = np.full(clock.size, np.nan)
            values[np.searchsorted(clock, rows[:, 0])] = rows[:, k]
            columns.values[f"{name}.{axis}"] = values
    return columns


def _kinovea_blocks(path: Path, lines: Lines) -> tuple[list[tuple[str, Array]], bool]:
    """Name and rows T X Y of each trajectory, and whether a time is a time code."""
    blocks: list[tuple[str, list[list[float]]]] = []
    faults = []
    code = False
    for number, line in zip(lines.numbers[1:], lines.texts[1:], strict=True):
        text = line.strip()
        if text.startswith("#"):
            if text.replace(" ", "").upper() != "#TXY":
                blocks.append((text[1:].strip(), []))
            continue
        cells = text.split()
        read = [_kinovea_time(cells[0]), *(read_number(c.replace(",", ".")) for c in cells[1:3])]
        row = [n for n in read if n is not None]
        if len(row) != 3:
            faults.append(f"line {number}: got {text[:60]!r}, expected T X Y")
            continue
        code = code or ":" in cells[0]
        if not blocks or (blocks[-1][1] and row[0] < blocks[-1][1][-1][0]):
            blocks.append((f"point{len(blocks) + 1}", []))
        blocks[-1][1].append(row)
    if faults:
        raise DataError(f"{path}: " + "; ".join(faults[:5]))
    return [(name, np.array(rows).reshape(-1, 3)) for name, rows in blocks], code


def _kinovea_time(text: str) -> float | None:
    """Time [s] from a number or a time code h:mm:ss:hundredths."""
    parts = text.split(":")
    if len(parts) == 1:
        return read_number(text.replace(",", "."))
    numbers = [read_number(p) for p in parts]
    if None in numbers or len(parts) > 4:
        return None
    weights = (3600.0, 60.0, 1.0, 0.01)[-len(parts) :] if len(parts) == 4 else (60.0, 1.0, 0.01)
    return sum(w * n for w, n in zip(weights[-len(parts) :], numbers, strict=True) if n is not None)


# ---------------------------------------------------------------- Tracker


def _tracker(path: Path, lines: Lines) -> Columns | None:
    """A line with the names of the tracks, then t and the columns of each track: x, y and more."""
    body = lines.where(lambda line: line.strip().lower() != "#multi:")
    if len(body) < 4:
        return None
    head = [split_column(c) for c in _cells(body.texts[1].lstrip("#"))]
    while head and head[-1] == ("", ""):
        head.pop()
    plain = [n.lower() for n, _ in head]
    if not plain or plain[0] != "t" or not {"x", "y"} <= set(plain):
        return None
    tracks = _cells(body.texts[0].lstrip("#"))
    named = [t for t in tracks if t]
    if not named or any(read_number(t) is not None for t in named):
        return None
    spread = tracks + [""] * (len(head) - len(tracks))
    several = plain.count("x") > 1
    name, names = named[0], [("time", head[0][1])]
    for j, (column, unit) in enumerate(head[1:], 1):
        if several and j < len(spread) and spread[j]:
            name = spread[j]
        names.append((f"{name}.{column.lower()}", unit))
    rows = Lines([body.texts[1].lstrip("#"), *body.texts[2:]], body.numbers[1:])
    columns = columns_of(path, read_table(rows), names)
    columns.source = "Tracker"
    if "time" not in columns.units:
        columns.units["time"] = "s"
    return columns


# ---------------------------------------------------------------- DeepLabCut


def _deeplabcut(path: Path, lines: Lines) -> Columns | None:
    """Lines scorer, (individuals,) bodyparts, coords; then frames with x, y, likelihood."""
    heads = [_cells(line) for line in lines.texts[:4]]
    kinds = [h[0].lower() for h in heads]
    if not kinds or kinds[0] != "scorer" or "bodyparts" not in kinds or "coords" not in kinds:
        return None
    parts, coords = heads[kinds.index("bodyparts")], heads[kinds.index("coords")]
    owners = heads[kinds.index("individuals")] if "individuals" in kinds else None
    widths = {len(h) for h in (parts, coords, owners) if h is not None}
    if len(widths) > 1:
        raise DataError(
            f"{path}: the header lines of DeepLabCut have {', '.join(map(str, sorted(widths)))} "
            "cells, expected as many in each"
        )
    names = [("frame", "")]
    for j in range(1, len(coords)):
        part = parts[j] if owners is None else f"{owners[j]}.{parts[j]}"
        names.append((f"{part}.{coords[j]}", PIXEL if coords[j] in ("x", "y") else ""))
    columns = columns_of(path, read_table(lines[kinds.index("coords") :]), names)
    columns.source, columns.frames = "DeepLabCut", "frame"
    return columns


# ---------------------------------------------------------------- motion capture


def _optitrack(path: Path, lines: Lines) -> Columns | None:
    """Pairs of settings, lines Type, Name, ID, ..., the quantities, then Frame, Time and axes."""
    heads = [_cells(line) for line in lines.texts[:12]]
    at = next((i for i, h in enumerate(heads) if h[0] == "Frame" and i > 3), 0)
    if not heads or heads[0][0] != "Format Version" or not at:
        return None
    labels = {h[1]: h for h in heads[1:at] if len(h) > 2}
    width = len(heads[at])
    points, kinds = labels.get("Name", []), heads[at - 1]
    if min(len(points), len(kinds)) != width:
        raise DataError(f"{path}: header of OptiTrack without the lines Name and Position")
    settings = dict(zip(heads[0][::2], heads[0][1::2], strict=False))
    unit = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}.get(
        settings.get("Length Units", "").lower(), ""
    )
    names = [("frame", ""), ("time", "s")]
    for point, kind, axis in list(zip(points, kinds, heads[at], strict=True))[2:]:
        place = kind == "Position"
        name = f"{point}.{axis.lower()}" if place else f"{point}.{kind.lower()}.{axis.lower()}"
        names.append((name, unit if place else ""))
    columns = columns_of(path, read_table(lines[at:]), names)
    columns.source = "OptiTrack"
    return columns


def _vicon(path: Path, lines: Lines) -> Columns | None:
    """Section Trajectories: its rate, the points, Frame, Sub Frame and axes, units, rows."""
    titles = [i for i, t in enumerate(lines.texts) if t.strip(' ,;\t"') in _VICON]
    heads = [_cells(t) for t in lines.texts[:5]]
    if not titles or titles[0] != 0 or len(heads) < 5 or heads[3][:2] != ["Frame", "Sub Frame"]:
        return None
    sections = [lines.texts[i].strip(' ,;\t"') for i in titles]
    if "Trajectories" not in sections:
        raise DataError(
            f"{path}: Vicon export without trajectories, expected the section Trajectories: choose "
            "it in the ASCII export, or save the columns of one device with one header"
        )
    first = sections.index("Trajectories")
    part = lines[titles[first] : [*titles, len(lines)][first + 1]]
    if len(part) < 6:
        raise DataError(
            f"{path}: line {part.numbers[-1]}: the section Trajectories ends here, expected its "
            "frame rate, points, axes, units and frames"
        )
    rate, points, axes, units = (_cells(t) for t in part.texts[1:5])
    frequency = read_number(rate[0])
    if not (frequency and frequency > 0.0) or len(units) != len(axes):
        raise DataError(f"{path}: line {part.numbers[1]}: {rate[0]!r}, expected a frame rate [Hz]")
    names, point = [("frame", ""), ("", "")], ""
    points += [""] * (len(axes) - len(points))  # a point is named above its first axis
    for j in range(2, len(axes)):
        point = points[j] or point
        names.append((f"{point.rpartition(':')[2]}.{axes[j].lower()}", units[j]))
    rows = Lines([part.texts[3], *part.texts[5:]], np.delete(part.numbers[3:], 1))
    columns = columns_of(path, read_table(rows), names)
    columns.source = "Vicon"
    frames = columns.values["frame"]
    columns.values["time"] = (frames - frames[0]) / frequency
    columns.units["time"] = "s"
    columns.notes.append(f"time is counted from frame {frames[0]:g}, at {frequency:g} Hz")
    del sections[first]
    if sections:
        columns.notes.append(f"sections {', '.join(sections)} of the Vicon export are left out")
    return columns


_VICON = ("Trajectories", "Devices", "Model Outputs", "Joints", "Segments", "Events")


def _qualisys(path: Path, lines: Lines) -> Columns | None:
    """Settings, FREQUENCY and MARKER_NAMES among them, perhaps a header, and rows x y z."""
    heads = {h[0]: (i, h[1:]) for i, h in enumerate(map(_cells, lines.texts[:40]))}
    if not {"NO_OF_MARKERS", "FREQUENCY", "MARKER_NAMES"} <= heads.keys():
        return None
    at, points = heads["MARKER_NAMES"]
    rate = read_number(heads["FREQUENCY"][1][0]) if heads["FREQUENCY"][1] else None
    if not (rate and rate > 0.0):
        number = lines.numbers[heads["FREQUENCY"][0]]
        raise DataError(f"{path}: line {number}: FREQUENCY, expected a frame rate [Hz]")
    names = [(f"{p}.{axis}", "mm") for p in points if p for axis in "xyz"]
    below = lines[at + 1 :]
    title = _cells(below.texts[0]) if len(below) else []
    clocked = title[:2] == ["Frame", "Time"]
    names = [("frame", ""), ("time", "s")][: 2 * clocked] + names
    if not title or any(read_number(c) is not None for c in title):
        head = "\t".join(name for name, _ in names)
        below = Lines([head, *below.texts], lines.numbers[at:])
    columns = columns_of(path, read_table(below), names)
    columns.source = "Qualisys"
    columns.notes.append("Qualisys states no unit: millimeters, its default")
    if not clocked:
        size = columns.lines.size if columns.lines is not None else 0
        columns.values["time"] = np.arange(size) / rate
        columns.units["time"] = "s"
        columns.notes.append(f"time is counted at {rate:g} Hz, which the file states")
    return columns
