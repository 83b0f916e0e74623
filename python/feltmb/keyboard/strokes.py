"""Labeled records of a sensor: simulated strokes, what the sensor reads, and the truth."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.keyboard.gestures import Gesture, Inversion, random_gestures, run_all, truth_of
from feltmb.keyboard.sensor import Sensor, Setup, load_sensor, setup_of, travels
from feltmb.keyboard.velocity import VelocityCurve
from feltmb.mechanism import Action, load_action
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import check_writable, is_file, why_missing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from feltmb.run.results import Run
    from feltmb.run.stroke import Stroke

#: Records that are made, or are in memory, at a time.
BLOCK = 200
#: Ending of a set as lines of JSON, which needs no other package.
LINES = ".jsonl"


@dataclass(frozen=True, eq=False)
class Labeled:
    """What a sensor read in one gesture, and the truth.

    Attributes
    ----------
    kind : str
        struck, pressed, staccato, repeated, half return, aftertouch.
    samples : DataFrame
        Counts of the converter over the time [s], a column a channel.
    truth : tuple
        Time [s] and speed at the string [m/s] of each strike.
    """

    kind: str
    samples: pd.DataFrame
    truth: tuple[tuple[float, float], ...]

    def plot(self, setup: Setup) -> Figure:
        """The counts over time with the true strikes, and the curve of the sensor.

        Parameters
        ----------
        setup
            Sensor and action.
        """
        from unmodeled.style import BLUE, GRAY, RED, head_line, new_figure, side_legend, style_axes

        sensor = setup.sensor
        figure = new_figure(9.0, 6.0)
        head_line(figure, f"{sensor.name} in {setup.action}: {self.kind}")
        upper, lower = figure.subplots(2, 1, height_ratios=(3, 2))
        for name, color in zip(sensor.channels, (BLUE, GRAY), strict=False):
            upper.plot(1e3 * self.samples.index, self.samples[name], color=color, label=name)
        for i, (time, speed) in enumerate(self.truth):
            label = "strike, m/s" if i == 0 else None
            upper.axvline(1e3 * time, color=RED, lw=1, label=label)
            upper.annotate(f"{speed:.2f}", (1e3 * time, 1.0), xycoords=("data", "axes fraction"),
                           ha="center", va="bottom", fontsize=8, color=RED)  # fmt: skip
        lower.plot(sensor.travel, sensor.reading, "o-", color=BLUE, ms=3, label="curve")
        for level, label in ((sensor.low, "range of the converter"), (sensor.high, None)):
            lower.axhline(level, color=GRAY, lw=0.8, ls="--", label=label)
        style_axes(upper, "time [ms]", f"counts, {sensor.bits} bits")
        style_axes(lower, "travel [1]: 0 rest, 1 string or key punching", "reading [1]")
        side_legend(upper)
        side_legend(lower)
        return figure


@checked
def labeled_strokes(
    action: Action | str = "grand_action",
    sensor: Sensor | str = "reflective",
    count: int = 1000,
    *,
    kinds: Sequence[str] = (),
    seed: int = 0,
    jobs: int | None = None,
) -> tuple[Setup, Iterator[Labeled]]:
    """Simulate random gestures from ppp to fff with a sensor; the same ones for the same seed.

    Parameters
    ----------
    action
        Action that is played, or its name.
    sensor
        Sensor, or its name. Each record is of another unit: its tolerances are drawn anew.
    count
        Number of records; one has one to five presses.
    kinds
        Kinds of strokes, with equal shares; none: struck, pressed, staccato, repeated and half
        return in usual shares. ``aftertouch`` presses again from within the aftertouch.
    seed
        Seed of the random numbers.
    jobs
        Threads; default: one a core. The records do not depend on it.

    Returns
    -------
    Setup
        What an algorithm may know.
    iterator of Labeled
        The records; they are simulated as they are asked for.
    """
    if count < 1 or seed < 0:
        what, got = ("count", count) if count < 1 else ("seed", seed)
        raise InvalidParameter(f"labeled_strokes: {what} = {got}, must be positive")
    mechanism = load_action(action) if isinstance(action, str) else action
    described = load_sensor(sensor) if isinstance(sensor, str) else sensor
    setup = setup_of(mechanism, described)
    gestures = list(random_gestures(Inversion(mechanism), count, seed, kinds))
    return setup, _records(mechanism, setup, gestures, seed, jobs)


@checked
def sensed(
    action: Action, stroke: Stroke, sensor: Sensor, *, seed: int = 0
) -> tuple[Setup, Labeled]:
    """What a sensor reads in one stroke, and the truth.

    Parameters
    ----------
    action
        Action that is played.
    stroke
        Stroke.
    sensor
        Sensor; its tolerances are drawn for one unit.
    seed
        Seed of the random numbers.
    """
    setup, made = setup_of(action, sensor), []

    def take(_: int, run: Run) -> None:
        samples = sensor.sample(run.time, travels(action, run, setup), np.random.default_rng(seed))
        made.append(Labeled(stroke.name, samples, tuple(truth_of(run))))

    run_all(action, [stroke], take)
    return setup, made[0]


def _records(
    action: Action, setup: Setup, gestures: Sequence[Gesture], seed: int, jobs: int | None
) -> Iterator[Labeled]:
    count = len(gestures)
    units = [np.random.default_rng(s) for s in np.random.SeedSequence([seed, 1]).spawn(count)]
    for first in range(0, count, BLOCK):
        block = gestures[first : first + BLOCK]
        made: list[Labeled] = []

        def take(index: int, run: Run, first: int = first, made: list[Labeled] = made) -> None:
            at = first + index
            samples = setup.sensor.sample(run.time, travels(action, run, setup), units[at])
            made.append(Labeled(gestures[at].kind, samples, tuple(truth_of(run))))

        run_all(action, (g.stroke for g in block), take, jobs)
        yield from made


# --- files -------------------------------------------------------------------------------------


def _arrow() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InvalidParameter(
            "a set of strokes as Parquet needs the extra feltmb[parquet]; a file .jsonl needs none"
        ) from None
    return pyarrow


@checked
def write_set(
    path: str | Path,
    setup: Any,
    records: Any,
    *,
    curve: Any = None,
    force: bool = False,
) -> int:
    """Write labeled records as Parquet, or as lines of JSON (.jsonl); return their number.

    One row or line a record, with the columns ``kind``, ``start`` [s], ``rate`` [Hz], a list of
    counts a channel, and the lists ``strike_time`` [s], ``strike_speed`` [m/s] and ``velocity``
    (MIDI). The setup is in the metadata of the file, or in its first line.

    Parameters
    ----------
    path
        File to be written.
    setup, records
        Those of :func:`labeled_strokes`.
    curve
        Velocity curve; default: the packaged one.
    force
        False: an existing file is not overwritten.
    """
    path = Path(path)
    write = _write_lines if path.suffix == LINES else _write_parquet
    if write is _write_parquet:
        _arrow()  # before anything is simulated
    check_writable(path, force=force)
    curve = curve or VelocityCurve()
    rows = (
        {
            "kind": record.kind,
            "start": float(record.samples.index[0]),
            "rate": setup.sensor.rate,
            **{c: record.samples[c].to_numpy() for c in setup.sensor.channels},
            "strike_time": [t for t, _ in record.truth],
            "strike_speed": [v for _, v in record.truth],
            "velocity": [curve.velocity(v) for _, v in record.truth],
        }
        for record in records
    )
    partial = path.with_name(path.name + ".part")
    try:
        count = write(partial, setup, rows)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    return count


def _write_parquet(path: Path, setup: Any, rows: Iterator[dict[str, Any]]) -> int:
    arrow = _arrow()
    schema = arrow.schema(
        {
            "kind": arrow.string(),
            "start": arrow.float64(),
            "rate": arrow.float64(),
            **{c: arrow.list_(arrow.int32()) for c in setup.sensor.channels},
            "strike_time": arrow.list_(arrow.float64()),
            "strike_speed": arrow.list_(arrow.float64()),
            "velocity": arrow.list_(arrow.int32()),
        },
        metadata={"setup": json.dumps(setup.as_dict())},
    )
    count = 0
    with arrow.parquet.ParquetWriter(path, schema) as writer:
        while block := list(itertools.islice(rows, BLOCK)):
            writer.write_table(arrow.Table.from_pylist(block, schema))
            count += len(block)
    return count


def _write_lines(path: Path, setup: Any, rows: Iterator[dict[str, Any]]) -> int:
    count = 0
    with path.open("w", encoding="utf-8") as file:
        file.write(json.dumps({"setup": setup.as_dict()}) + "\n")
        for row in rows:
            plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in row.items()}
            file.write(json.dumps(plain) + "\n")
            count += 1
    return count


def _read_parquet(path: Path) -> tuple[dict[str, Any], Iterator[dict[str, Any]]]:
    arrow = _arrow()
    try:
        file = arrow.parquet.ParquetFile(path)
    except arrow.ArrowException as fault:
        raise ValueError(str(fault)) from None
    rows = (row for batch in file.iter_batches(BLOCK) for row in batch.to_pylist())
    return json.loads(file.schema_arrow.metadata[b"setup"]), rows


def _read_lines(path: Path) -> tuple[dict[str, Any], Iterator[dict[str, Any]]]:
    def rows() -> Iterator[dict[str, Any]]:
        with path.open(encoding="utf-8") as file:
            next(file)
            yield from map(json.loads, file)

    with path.open(encoding="utf-8") as file:
        return json.loads(file.readline())["setup"], rows()


@checked
def read_set(path: str | Path) -> tuple[Setup, Iterator[Labeled]]:
    """The setup and the records of a file of :func:`write_set`.

    Raises
    ------
    InvalidParameter
        The file is no such set.
    """
    import pandas as pd

    path = Path(path)
    if not is_file(path):
        raise InvalidParameter(f"{path}: {why_missing(path)}")
    read = _read_lines if path.suffix == LINES else _read_parquet
    if read is _read_parquet:
        _arrow()
    try:
        known, rows = read(path)
        sensor = Sensor.model_validate(known.pop("sensor"))
        pairs: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in known.items()
        }
        setup = Setup(sensor, **pairs)
    except (KeyError, TypeError, ValueError) as fault:
        raise InvalidParameter(
            f"{path}: is no set of labeled strokes ({type(fault).__name__}); expected a file of "
            "feltmb keyboard strokes"
        ) from None

    def records() -> Iterator[Labeled]:
        for row in rows:
            counts = {c: np.array(row[c], dtype=np.int32) for c in sensor.channels}
            ticks = row["start"] + np.arange(len(counts[sensor.channels[0]])) / row["rate"]
            yield Labeled(
                row["kind"],
                pd.DataFrame(counts, index=pd.Index(ticks, name="time")),
                tuple(zip(row["strike_time"], row["strike_speed"], strict=True)),
            )

    return setup, records()
