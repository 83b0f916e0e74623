"""First-time stories: data as somebody would bring it, diagnosed by the command line.

Each story changes one thing of steinway45, or of how it was measured. Strokes are runs of
``feltmb stroke``; a few columns of their CSV get the noise of a camera and of a load cell and a
header of the user's own. ``feltmb gap diagnose steinway45 FILE...`` reads them with nothing
prepared; ``python bench/blind/yardstick.py stories`` diagnoses and marks all.

    python bench/stories/stories.py -o FOLDER              all
    python bench/stories/stories.py -o FOLDER head felt    some
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Table = dict[str, Array]

__all__ = ["STORIES", "Story", "make"]

RATE = 2000.0
"""Sample rate [Hz]."""
CAMERA, CELL = 2e-5, 5e-3
"""Noise of a tracked point [m] and of the load cell [N]."""
STROKES = {"piano": 0.30, "forte": 0.16, "staccato": 0.25}
"""Strokes and their recorded durations [s]."""
CHANNELS = ("key_front.y", "whippen.y", "hammer_tip.x", "hammer_tip.y", "backcheck.x")


def _same(table: Table) -> Table:
    return table


def _tilted(angle: float) -> Callable[[Table], Table]:
    """A camera rotated about its axis by an angle [rad]; it measures displacements."""

    def seen(table: Table) -> Table:
        out = dict(table)
        c, s = np.cos(angle), np.sin(angle)
        for point in {n.rpartition(".")[0] for n in table if n[-2:] in (".x", ".y")}:
            x, y = (table.get(f"{point}.{a}", table[f"{point}.raw_{a}"]) for a in "xy")
            x, y = x - x[0], y - y[0]
            if f"{point}.x" in table:
                out[f"{point}.x"] = c * x - s * y
            if f"{point}.y" in table:
                out[f"{point}.y"] = s * x + c * y
        return out

    return seen


def _scaled(factor: float) -> Callable[[Table], Table]:
    def seen(table: Table) -> Table:
        return {n: factor * v if n.endswith((".x", ".y")) else v for n, v in table.items()}

    return seen


def _late(delay: float) -> Callable[[Table], Table]:
    """A load cell whose reading is late by this time [s]."""

    def seen(table: Table) -> Table:
        t = table["time"]
        return {**table, "force": np.interp(t - delay, t, table["force"])}

    return seen


@dataclass(frozen=True, kw_only=True)
class Story:
    """A change of the machine, or of its measurement."""

    settings: Mapping[str, str] = field(default_factory=dict)
    """Settings of ``feltmb stroke`` for the machine, which the model does not have."""
    machine: str = "steinway45"
    seen: Callable[[Table], Table] = _same
    """Function that converts the run to the readings of the sensors."""
    absolute: bool = False
    """Whether channels are absolute coordinates instead of displacements from rest."""
    channels: tuple[str, ...] = CHANNELS
    """Recorded outputs."""
    camera: float = CAMERA
    """Noise of a tracked point [m]."""
    frames: int = 1
    """Number of frames over which the tracking of a point averages."""
    unit: str = "mm"
    """Unit in the header; the numbers are in mm."""
    size: tuple[str, float] | None = None
    """Effect or parameter that differs, and its true magnitude [its unit]; None: nothing."""


STORIES: dict[str, Story] = {
    "head": Story(
        settings={"bodies.head.mass": "7.02 g", "bodies.head.inertia": "2.79 kg mm^2"},
        size=("mass.head", -0.1),
    ),
    # Only the mass is larger, as a user would set it; mass.head also scales the inertia.
    "heavy": Story(
        settings={"bodies.head.mass": "9 g"},
        size=("mass.head", 0.154),
    ),
    "felt": Story(
        settings={
            "contacts.03.loading.a": "21600 N/m",
            "contacts.03.loading.c": "-17920 N/m",
            "contacts.03.unloading.a": "336 N/m",
            "contacts.03.unloading.c": "2192 N/m",
        },
        size=("felt.03", -0.2),
    ),
    "let_off": Story(
        # The hammer is 1 mm farther from the string at let-off.
        settings={"surfaces.Gp10.point.y": "76.88 mm"},
        size=("let_off_button", -0.12e-3),
    ),
    "string": Story(
        settings={"string.count": "2"},
        size=("string_impedance", -1.0 / 3.0),
    ),
    "friction": Story(
        settings={"bodies.whippen.friction.amplitude": "2.4e-3 N m"},
        size=("joint_friction.whippen", 2.4e-3 / 7.94e-4 - 1.0),
    ),
    "tilt": Story(
        seen=_tilted(0.035),
        size=("camera_tilt", -0.035),
    ),
    "scale": Story(
        seen=_scaled(1.06),
        size=("camera_scale", 0.06),
    ),
    "unit": Story(unit="cm"),
    "absolute": Story(absolute=True),
    "late": Story(
        seen=_late(2e-3),
        size=("input_delay", 2e-3),
    ),
    # A phone beside the hammer, and a tracking program; its noise is not known.
    "one_camera": Story(
        settings={"surfaces.Gp10.point.y": "77.5 mm"},
        channels=("hammer_tip.x", "hammer_tip.y"),
        camera=5e-5,
        frames=3,
        size=("let_off_button", 0.5e-3),
    ),
    "nothing": Story(),
    # Not regulated, and with one string: key dip differs by 1.3 mm and let-off by 0.4 mm.
    "other": Story(
        machine="steinway45_printed",
        size=("key_dip", -1.306e-3),
    ),
}


def _command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "feltmb", *arguments]


def _run_of(story: Story, stroke: str, folder: Path) -> Table:
    """Columns of a run [SI]."""
    out = folder / "runs" / f"{stroke}.csv"
    out.parent.mkdir(parents=True, exist_ok=True)
    options = ["--duration", str(STROKES[stroke]), "--output-rate", str(RATE), "-o", str(out)]
    for path, value in story.settings.items():
        options += ["--set", f"{path}={value}"]
    subprocess.run(
        _command("stroke", story.machine, stroke, *options, "--force"),
        check=True,
        stdout=subprocess.DEVNULL,
    )
    with out.open(newline="", encoding="utf-8") as file:
        rows = csv.reader(file)
        names = [n.partition(" [")[0] for n in next(rows)]
        data = np.array([[float(v) for v in row] for row in rows])
    columns = dict(zip(names, data.T, strict=True))
    table = {"time": columns["time"], "force": columns["finger.force"]}
    table |= {c: columns[c] for c in CHANNELS}
    points = {c.rpartition(".")[0] for c in CHANNELS}
    return table | {f"{p}.raw_{a}": columns[f"{p}.{a}"] for p in points for a in "xy"}


def _averaged(frames: int, samples: int, random: np.random.Generator) -> Array:
    """Noise of variance 1 that is the mean over some frames."""
    white = random.standard_normal(samples + frames - 1)
    return np.convolve(white, np.full(frames, frames**-0.5), "valid")


def make(story: Story, folder: Path, strokes: tuple[str, ...] = tuple(STROKES)) -> list[Path]:
    """Measured files of a story."""
    paths = []
    for k, stroke in enumerate(strokes):
        random = np.random.default_rng(100 + k)
        table = _run_of(story, stroke, folder)
        if not story.absolute:
            table = {n: v - v[0] if n.endswith((".x", ".y")) else v for n, v in table.items()}
            table |= {n: table[n] - table[n][0] for n in table if ".raw_" in n}
        table = story.seen(table)
        table["force"] = table["force"] + CELL * random.standard_normal(table["time"].size)
        header = ["Time [ms]", "Force [N]", *(f"{c} [{story.unit}]" for c in story.channels)]
        columns = [1e3 * table["time"], table["force"]]
        for name in story.channels:
            noise = story.camera * _averaged(story.frames, table["time"].size, random)
            columns.append(1e3 * (table[name] + noise))
        path = folder / f"{stroke}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, delimiter=";")
            rows.writerow(header)
            rows.writerows([f"{v:.4f}" for v in row] for row in zip(*columns, strict=True))
        paths.append(path)
    return paths


def main() -> None:
    """Make the files of stories."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="STORY", help=", ".join(STORIES))
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    for name in arguments.names or STORIES:
        for path in make(STORIES[name], arguments.out / name):
            print(path)


if __name__ == "__main__":
    main()
