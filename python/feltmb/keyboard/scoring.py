"""The score of an algorithm: its strikes against the true ones, by level from ppp to fff."""

from __future__ import annotations

import csv
import io
import json
import math
import runpy
import shlex
import shutil
import subprocess
import tempfile
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.keyboard import algorithms
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter, no_such, shown
from unmodeled.files import is_file

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from feltmb.keyboard.sensor import Setup
    from feltmb.keyboard.strokes import Labeled

Algorithm = Callable[["pd.DataFrame", "Setup"], Any]

#: Level -> its lowest speed of the hammer at the string [m/s].
LEVELS = {"ppp": 0.2, "pp": 0.5, "p": 0.8, "mp": 1.25, "mf": 1.8, "f": 2.5, "ff": 3.5, "fff": 4.5}
#: A strike below this speed is neither missed nor, if it is found, false [m/s].
FAINTEST = LEVELS["ppp"]
#: A found strike belongs to the true one that is at most this far away [s].
TOGETHER = 0.02
PACKAGED = ("largest_derivative", "model_based")
#: An algorithm that fails in the first records is not called again.
GIVE_UP = 10
PROGRAM_TIME = 60.0  # s, limit of a program for one record


def level_of(speed: float) -> str:
    """Level of a strike with this speed [m/s]."""
    return [name for name, low in LEVELS.items() if low <= max(speed, FAINTEST)][-1]


@dataclass(frozen=True, eq=False)
class Score:
    """How well an algorithm finds the strikes.

    Attributes
    ----------
    name : str
        Algorithm.
    strikes : DataFrame
        One row a true strike of at least 0.2 m/s: ``record``, ``kind``, ``level``, ``speed`` [m/s],
        ``time`` [s], ``speed_error`` (relative [1]) and ``time_error`` [s]; NaN: missed.
    false : DataFrame
        Found strikes that are none: ``record``, ``kind``, ``time`` [s], ``speed`` [m/s].
    records : int
        Number of records.
    failures : tuple of str
        Records in which the algorithm failed, and why.
    """

    name: str
    strikes: pd.DataFrame
    false: pd.DataFrame
    records: int
    failures: tuple[str, ...]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a level, and one for all: counts, errors of speed [%] and time [ms]."""
        import pandas as pd

        rows = {}
        for level in (*LEVELS, "all"):
            part = self.strikes if level == "all" else self.strikes[self.strikes["level"] == level]
            error, late = 100.0 * part["speed_error"].dropna(), 1e3 * part["time_error"].dropna()
            false = self.false["speed"]
            some = len(error) > 0
            rows[level] = {
                "strikes": len(part),
                "missed": int(part["speed_error"].isna().sum()),
                "false": int(sum(level in ("all", level_of(v)) for v in false)),
                "speed_rms": float(np.sqrt(np.mean(error**2))) if some else math.nan,
                "speed_mean": float(error.mean()) if some else math.nan,
                "speed_low": float(error.min()) if some else math.nan,
                "speed_high": float(error.max()) if some else math.nan,
                "time_rms": float(np.sqrt(np.mean(late**2))) if some else math.nan,
            }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("level")

    def plot(self) -> Figure:
        """Errors of speed and time over the true speed, and missed and false strikes."""
        from unmodeled.style import (
            BLUE,
            CYCLE,
            GRAY,
            PALE,
            RED,
            head_line,
            new_figure,
            side_legend,
            style_axes,
        )

        figure = new_figure(8.5, 8.0)
        head_line(figure, f"{self.name}: {len(self.strikes)} strikes in {self.records} records")
        upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
        for color, (kind, part) in zip(CYCLE, self.strikes.groupby("kind"), strict=False):
            dots: dict[str, Any] = {"ms": 3.0, "color": color, "label": str(kind)}
            upper.plot(part["speed"], 100.0 * part["speed_error"], ".", **dots)
            middle.plot(part["speed"], 1e3 * part["time_error"], ".", **dots)
        upper.axhline(0.0, color=GRAY, lw=0.8)
        middle.axhline(0.0, color=GRAY, lw=0.8)
        lows = [*LEVELS.values(), max(7.0, 1.02 * float(self.strikes["speed"].max()))]
        missed = self.strikes.loc[self.strikes["speed_error"].isna(), "speed"]
        bars = ((self.strikes["speed"], PALE, "true"), (missed, RED, "missed"),
                (self.false["speed"], BLUE, "false"))  # fmt: skip
        for k, (values, color, label) in enumerate(bars):
            counts, _ = np.histogram(values, lows)
            left = np.array(lows[:-1]) * (np.array(lows[1:]) / lows[:-1]) ** (0.25 * (k + 1))
            lower.bar(left, counts, width=0.1 * left, color=color, label=label)
        lower.set_xscale("log")
        lower.set_xlim(lows[0] * 0.95, lows[-1])
        middles = [math.sqrt(a * b) for a, b in pairwise(lows)]
        for ax, text in ((upper, "error of the speed [%]"), (middle, "error of the time [ms]"),
                         (lower, "strikes")):  # fmt: skip
            style_axes(ax, "", text)
            side_legend(ax)
            for low in lows:
                ax.axvline(low, color=GRAY, lw=0.4, zorder=0)
        for x, name in zip(middles, LEVELS, strict=True):
            upper.text(
                x, 1.01, name, transform=upper.get_xaxis_transform(), ha="center", fontsize=8
            )
        ticks = [0.2, 0.5, 1.0, 2.0, 5.0]
        lower.set_xticks(ticks, [f"{t:g}" for t in ticks])
        lower.minorticks_off()
        lower.set_xlabel("true speed of the hammer at the string [m/s]", fontsize=8.5)
        return figure


def load_algorithm(text: str) -> tuple[str, Algorithm]:
    """An algorithm by its name on the command line.

    ``largest_derivative`` and ``model_based`` are packaged. ``FILE.py:FUNCTION`` is a function of
    the samples (a DataFrame over the time [s]) and the setup. Any other text is a program, which is
    called with the names of a CSV file (``time,hammer,key``) and of a JSON file (the setup), and
    prints CSV with the head ``time,speed``. ``stream:COMMAND`` is a program that reads the counts
    from its input, a line a sample (:meth:`Setup.stream`), and prints the same.
    """
    if text in PACKAGED:
        return text, getattr(algorithms, text)
    file, mark, name = text.rpartition(":")
    if mark and file.endswith(".py"):
        if not is_file(Path(file)):
            raise InvalidParameter(f"algorithm {file}: there is no such file")
        try:
            found = runpy.run_path(file)
        except Exception as error:
            raise InvalidParameter(f"algorithm {file}: cannot be loaded: {_told(error)}") from None
        if not callable(found.get(name)):
            raise no_such(f"function in {file}", name, [n for n in found if callable(found[n])])
        return name, found[name]
    streamed = text.startswith("stream:")
    words = shlex.split(text.removeprefix("stream:"))
    if not words:
        raise no_such("algorithm", text, PACKAGED)
    if len(words) == 1 and not streamed and "/" not in text and "." not in text:
        raise InvalidParameter(
            f"algorithm {text!r}: expected {' or '.join(PACKAGED)}, FILE.py:FUNCTION, or the "
            "command of a program, such as './find' or 'python find.py'"
        )
    if shutil.which(words[0]) is None:
        raise InvalidParameter(f"algorithm {text!r}: there is no program {words[0]}")
    return words[-1], _program(words, streamed=streamed)


def _program(words: Sequence[str], *, streamed: bool) -> Algorithm:
    """The function that calls a program."""

    def run(*more: str, given: str | None = None) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*words, *more], input=given, capture_output=True, text=True,
                              check=False, timeout=PROGRAM_TIME)  # fmt: skip

    def with_files(samples: pd.DataFrame, setup: Setup) -> subprocess.CompletedProcess[str]:
        with tempfile.TemporaryDirectory() as folder:
            table, known = Path(folder) / "samples.csv", Path(folder) / "setup.json"
            samples.to_csv(table)
            known.write_text(json.dumps(setup.as_dict()))
            return run(str(table), str(known))

    def call(samples: pd.DataFrame, setup: Setup) -> Any:
        done = run(given=setup.stream(samples)) if streamed else with_files(samples, setup)
        if done.returncode:
            raise Error(f"exit code {done.returncode}: {done.stderr.strip()[-300:]}")
        head, *rows = list(csv.reader(io.StringIO(done.stdout))) or [[]]
        if [cell.strip() for cell in head] != ["time", "speed"]:
            raise Error(f"printed {shown(done.stdout)}, expected CSV with the head time,speed")
        return rows

    return call


def _told(error: BaseException) -> str:
    """Kind and place of an error of a function of the user; the text of one of feltmb."""
    if isinstance(error, Error):
        return str(error)
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename[0] != "<"]
    where = f", {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def _found(algorithm: Algorithm, record: Labeled, setup: Setup) -> list[tuple[float, float]]:
    """What an algorithm finds in a record, as sorted pairs.

    Raises
    ------
    Error
        It returns something else.
    """
    given = algorithm(record.samples, setup)
    try:
        pairs = sorted((float(time), float(speed)) for time, speed in given)
    except (TypeError, ValueError):
        raise Error(
            f"returned {shown(given)}, expected a list of (time in s, speed in m/s)"
        ) from None
    if not all(math.isfinite(x) for pair in pairs for x in pair):
        raise Error(f"returned {shown(pairs)}, expected finite numbers")
    return pairs


@checked
def score(algorithm: Algorithm, records: Iterable[Any], setup: Any, *, name: str = "") -> Score:
    """Compare what an algorithm finds with the true strikes.

    A found strike belongs to the nearest true one within 20 ms, each to one. Strikes below 0.2 m/s
    are neither missed nor false.

    Parameters
    ----------
    algorithm
        Function of the samples and the setup; it returns times [s] and speeds [m/s].
    records
        Labeled records.
    setup
        Sensor and action of the records.
    name
        Name of the algorithm.

    Raises
    ------
    Error
        The algorithm fails in every record.
    """
    import pandas as pd

    rows: list[tuple[Any, ...]] = []
    false: list[tuple[Any, ...]] = []
    failures: list[str] = []
    count = 0
    for count, record in enumerate(records, start=1):
        try:
            found = _found(algorithm, record, setup)
        except Exception as error:
            failures.append(f"record {count}: {_told(error)}")
            found = []
            if len(failures) == count == GIVE_UP:
                break
        truth = record.truth
        near = sorted(
            (abs(at - time), i, k)
            for i, (time, _) in enumerate(truth)
            for k, (at, _) in enumerate(found)
            if abs(at - time) <= TOGETHER
        )
        of: dict[int, int] = {}
        for _, i, k in near:
            if i not in of and k not in of.values():
                of[i] = k
        for i, (time, speed) in enumerate(truth):
            if speed < FAINTEST:
                continue
            at, told = found[of[i]] if i in of else (math.nan, math.nan)
            rows.append(
                (count, record.kind, level_of(speed), speed, time, told / speed - 1.0, at - time)
            )
        false += [
            (count, record.kind, *pair)
            for k, pair in enumerate(found)
            if k not in of.values() and pair[1] >= FAINTEST
        ]
    if not count:
        raise InvalidParameter("score: got no record, expected at least one")
    if len(failures) == count:
        raise Error(f"the algorithm failed in the first {count} records; {failures[0]}")
    heads = ["record", "kind", "level", "speed", "time", "speed_error", "time_error"]
    return Score(
        name or getattr(algorithm, "__name__", "algorithm"),
        pd.DataFrame(rows, columns=heads),
        pd.DataFrame(false, columns=["record", "kind", "time", "speed"]),
        count,
        tuple(failures),
    )
