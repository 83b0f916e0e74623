"""Many simulations at once: over parameters, strokes and options, resumable, in a fixed order.

:func:`sweep` is for users; :func:`run_members` is what it and the studies stand on. A member is one
simulation. Members run on any ``concurrent.futures.Executor``: what is sent there is a module-level
function and plain data, so that threads, processes and clusters do alike.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from feltmb import _core
from feltmb.config import Action, load_action
from feltmb.errors import FeltmbError, IntegrationError, InvalidParameter
from feltmb.files import check_writable, write_file, write_text
from feltmb.stroke import Stroke, load_stroke

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd

    from feltmb.results import Run

    Array = npt.NDArray[np.float64]

__all__ = [
    "Axis",
    "Extract",
    "Member",
    "Outcome",
    "SweepResult",
    "run_member",
    "run_members",
    "sweep",
    "value_at",
]

MEMBER_FORMAT = 1
OPTIONS = (
    "duration",
    "rtol",
    "output_rate",
    "ledger",
    "events",
    "max_wall",
    "max_step",
    "max_order",
)
Progress = Callable[[int, int, str], object]


@dataclass(frozen=True)
class Extract:
    """Numbers and series to take from a run.

    Attributes
    ----------
    function
        Module-level function ``function(run, action, spec) -> (numbers, series)``.
    spec
        Plain data that it reads; part of the key of a member.
    """

    function: Callable[[Run, Action, Any], tuple[dict[str, float], dict[str, Array]]]
    spec: Any


@dataclass(frozen=True)
class Member:
    """One simulation: a mechanism, values by dotted path, a stroke, options of ``simulate``."""

    action: Action
    stroke: Stroke
    values: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    extract: Extract | None = None
    save_run: str = ""  #: NetCDF file to write, "" for none

    @cached_property
    def key(self) -> str:
        """SHA-256 of parameters, stroke, options, what is extracted, and code."""
        text = json.dumps(
            {
                "format": MEMBER_FORMAT,
                "code": code_fingerprint(),
                "action": self.action.hash,
                "values": self.values,
                "stroke": self.stroke.as_dict(),
                "options": dict(self.options),
                "extract": None if self.extract is None else self.extract.spec,
                "run": bool(self.save_run),
            },
            sort_keys=True,
            default=str,
        )
        return hashlib.sha256(text.encode()).hexdigest()


#: Modules on which the outcome of a member depends.
_CODE = ("config", "events", "results", "simulate", "stroke", "study", "study_expression", "sweep")


@lru_cache(maxsize=1)
def code_fingerprint() -> str:
    """Version and digest of the code: results of other code must not be taken for the same."""
    digest = hashlib.sha256()
    files = [Path(__file__).with_name(f"{name}.py") for name in _CODE]
    for file in [*files, Path(getattr(_core, "__file__", None) or "")]:
        digest.update(file.read_bytes() if file.is_file() else b"")
    return f"{_core.__version__} {digest.hexdigest()[:16]}"


@dataclass(frozen=True)
class Outcome:
    """What became of a member.

    Attributes
    ----------
    status
        ``done``; ``failed``: the solver stopped early or the values are impossible, with what was
        reached; ``error``: something else went wrong (a worker died, the wall time was used up),
        which is tried again when the sweep is resumed.
    error
        One line, empty if done.
    numbers
        Summary of the run and extracted numbers, SI units; ``steps`` and ``rhs``: work counts.
    series
        Extracted arrays.
    wall
        Wall time of the simulation [s].
    resumed
        Taken from the folder, not computed now.
    """

    status: str
    error: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    series: dict[str, Array] = field(default_factory=dict)
    reached: float = 0.0
    wall: float = 0.0
    resumed: bool = False


# --- one member ----------------------------------------------------------------------------------


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return (
        text if isinstance(error, FeltmbError) else f"{type(error).__name__}: {text}".rstrip(": ")
    )


def run_member(member: Member, stop: threading.Event | None = None) -> Outcome:
    """Simulate one member; whatever goes wrong comes back as its outcome.

    Parameters
    ----------
    stop
        Interrupts the simulation when it is set; only within one process.
    """
    from feltmb.simulate import simulate

    try:
        action = member.action.with_values(member.values) if member.values else member.action
        progress = None if stop is None else lambda _time: not stop.is_set()
        options = {"ledger": False, **member.options}
        try:
            run, status, error = (
                simulate(action, member.stroke, progress=progress, **options),
                "done",
                "",
            )
        except IntegrationError as failure:
            run, error = failure.partial, _one_line(failure)
            if run.status != "failed":  # where the wall time stops a run is chance
                return Outcome("error", error, reached=run.reached, wall=float(run.stats["wall"]))
            status = "failed"
        numbers = {k: float(v) for k, v in run.summary.items()}
        series: dict[str, Array] = {}
        if member.extract is not None and run.time.size > 1:
            more, series = member.extract.function(run, action, member.extract.spec)
            numbers.update(more)
        if member.save_run:
            try:
                run.save(member.save_run, force=True)
            except FeltmbError as failure:  # of the disk, not of the member: to be tried again
                return Outcome("error", _one_line(failure))
    except FeltmbError as failure:
        return Outcome("failed", _one_line(failure))
    except Exception as failure:  # a member must never take the others with it
        return Outcome("error", _one_line(failure))
    numbers.update(steps=float(run.stats["steps"]), rhs=float(run.stats["rhs"]))
    return Outcome(status, error, numbers, series, run.reached, float(run.stats["wall"]))


# --- the folder of finished members --------------------------------------------------------------


def _file(folder: Path, key: str) -> Path:
    return folder / f"{key[:40]}.json"


def _store(folder: Path, member: Member, outcome: Outcome) -> None:
    import numpy as np

    path = _file(folder, member.key)
    if outcome.series:
        series = outcome.series

        def write(target: Path) -> None:
            with target.open("wb") as out:
                np.savez_compressed(out, **series)  # type: ignore[arg-type]

        write_file(path.with_suffix(".npz"), write, force=True)
    write_text(
        path,
        json.dumps(
            {
                "feltmb": "member",
                "key": member.key,
                "name": member.name,
                "action": member.action.name,
                "values": dict(member.values),
                "stroke": member.stroke.name,
                "status": outcome.status,
                "error": outcome.error,
                "numbers": outcome.numbers,
                "series": sorted(outcome.series),
                "reached": outcome.reached,
                "wall": outcome.wall,
            },
            indent=1,
            default=str,
        )
        + "\n",
        force=True,
    )


def _recall(folder: Path, member: Member) -> Outcome | None:
    """Outcome in the folder; None if it is absent or damaged."""
    import zipfile

    import numpy as np

    path = _file(folder, member.key)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["key"] != member.key:
            return None
        if member.save_run and found["status"] == "done" and not Path(member.save_run).is_file():
            return None
        series: dict[str, Array] = {}
        if found["series"]:
            with np.load(path.with_suffix(".npz"), allow_pickle=False) as data:
                series = {name: data[name] for name in found["series"]}
        return Outcome(
            str(found["status"]),
            str(found["error"]),
            {str(k): float(v) for k, v in found["numbers"].items()},
            series,
            float(found["reached"]),
            float(found["wall"]),
            resumed=True,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile):
        return None


# --- many members --------------------------------------------------------------------------------


def default_jobs() -> int:
    """Cores that this process may use."""
    try:
        return max(1, len(os.sched_getaffinity(0)))
    except AttributeError:
        return max(1, os.cpu_count() or 1)


def run_members(
    members: Iterable[Member],
    *,
    executor: Executor | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
) -> Iterator[tuple[int, Outcome]]:
    """Run members and yield their outcomes with their positions, as they are finished.

    Only as many members as keep the workers busy are in memory; the order of what is yielded
    depends on them, the outcomes do not.

    Parameters
    ----------
    members
        May be a generator.
    executor
        Where to run; default: threads of this process. A given executor is not shut down.
    jobs
        Number of threads without an executor; default: the cores of this process.
    folder
        Folder of finished members: what lies there is not computed again.
    """
    where = Path(folder) if folder is not None else None
    own: ThreadPoolExecutor | None = None
    stop: threading.Event | None = None
    if executor is None:
        count = default_jobs() if jobs is None else int(jobs)
        if count < 1:
            raise InvalidParameter(f"jobs = {count}, must be >= 1")
        executor = own = ThreadPoolExecutor(count, thread_name_prefix="feltmb")
        stop = threading.Event()
    workers = getattr(executor, "_max_workers", None) or 16
    limit = 2 * int(workers) + 2

    waiting: dict[Future[Outcome], Member] = {}
    positions: dict[str, list[int]] = {}  # of members under way; twins run once
    arguments = () if stop is None else (stop,)
    try:
        for index, member in enumerate(members):
            if member.key in positions:
                positions[member.key].append(index)
                continue
            known = _recall(where, member) if where is not None else None
            if known is not None:
                yield index, known
                continue
            while len(waiting) >= limit:
                yield from _collect(waiting, positions, where)
            positions[member.key] = [index]
            try:
                waiting[executor.submit(run_member, member, *arguments)] = member
            except RuntimeError as failure:  # the executor is broken or was shut down
                for position in positions.pop(member.key):
                    yield position, Outcome("error", _one_line(failure))
        while waiting:
            yield from _collect(waiting, positions, where)
    finally:
        if stop is not None:
            stop.set()
        for future in waiting:
            future.cancel()
        if own is not None:
            own.shutdown(wait=True, cancel_futures=True)


def _collect(
    waiting: dict[Future[Outcome], Member], positions: dict[str, list[int]], folder: Path | None
) -> Iterator[tuple[int, Outcome]]:
    """Wait for at least one member, store what is finished, yield it."""
    done, _ = wait(waiting, return_when=FIRST_COMPLETED)
    for future in done:
        member = waiting.pop(future)
        failure = future.exception()
        if failure is None:
            outcome = future.result()
        elif isinstance(failure, Exception):
            outcome = Outcome("error", _one_line(failure))
        else:
            raise failure
        if folder is not None and outcome.status in ("done", "failed"):
            _store(folder, member, outcome)
        for position in positions.pop(member.key):
            yield position, outcome


class ProgressBar:
    """Progress of members: a callable of the user's, a bar on a terminal, or nothing.

    Parameters
    ----------
    progress
        ``progress(done, total, name)``; None: a bar if standard error is a terminal; False: none.
    total
        Number of members.
    """

    def __init__(self, progress: Progress | bool | None, total: int, title: str = ""):
        import sys

        self._call = progress if callable(progress) else None
        self._total = total
        self._done = 0
        self._bar: Any = None
        wanted = progress is True or (progress is None and sys.stderr.isatty())
        if self._call is None and wanted:
            from rich.console import Console
            from rich.progress import (
                BarColumn,
                MofNCompleteColumn,
                Progress,
                TextColumn,
                TimeRemainingColumn,
            )

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._task = self._bar.add_task(title or "simulating", total=total)

    def __enter__(self) -> ProgressBar:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self, name: str) -> None:
        """One member more."""
        self._done += 1
        if self._call is not None:
            self._call(self._done, self._total, name)
        elif self._bar is not None:
            self._bar.update(self._task, completed=self._done, description=name[:32])


# --- values over which a sweep goes --------------------------------------------------------------


def value_at(action: Action, path: str) -> Any:
    """Number or text at a dotted path of a mechanism, in the unit that its file gives.

    Raises
    ------
    InvalidParameter
        There is no such path, or it names several values.
    """
    from feltmb.config import _expand
    from feltmb.quantity import is_quantity

    raw = action.raw
    found = _expand(raw, path)
    if len(found) != 1:
        raise InvalidParameter(f"path {path!r} names {len(found)} values, expected one")
    node: Any = raw
    for part in found[0]:
        if is_quantity(node):
            node = node["value"]
        if isinstance(node, Mapping) and part in node:
            node = node[part]
        elif isinstance(node, (list, tuple)) and part in ("x", "y", "0", "1"):
            node = node[{"x": 0, "y": 1, "0": 0, "1": 1}[part]]
        else:
            raise InvalidParameter(f"path {path!r}: {part!r} does not exist")
    return node["value"] if is_quantity(node) else node


How = Literal["set", "scale", "offset"]


@dataclass(frozen=True)
class Axis:
    """One direction of a sweep.

    Attributes
    ----------
    name
        Column of the table.
    values
        What to go through.
    paths
        Dotted paths that take the value: of the mechanism, ``stroke.scale``, ``stroke.delay`` or
        ``options.NAME``.
    how
        ``set`` the value, ``scale`` the mechanism's own by it, or ``offset`` it, both in the unit
        that the file of the mechanism gives.
    inverse
        Paths that are divided by the value; with ``scale`` only.
    """

    name: str
    values: tuple[Any, ...]
    paths: tuple[str, ...]
    how: How = "set"
    inverse: tuple[str, ...] = ()

    def at(self, action: Action, value: Any) -> dict[str, Any]:
        """Values by path for one value of the axis."""
        if self.how == "set":
            return dict.fromkeys(self.paths, value)
        out: dict[str, Any] = {}
        for path in (*self.paths, *self.inverse):
            base = value_at(action, path)
            if isinstance(base, bool) or not isinstance(base, (int, float)):
                raise InvalidParameter(f"path {path!r}: {base!r} is no number to {self.how}")
            if self.how == "offset":
                out[path] = base + value
            else:
                out[path] = base / value if path in self.inverse else base * value
        return out


def axis_values(given: Any, where: str) -> tuple[tuple[Any, ...], How]:
    """Values of an axis from a sequence or a table; see :func:`sweep`."""
    how: How = "set"
    if isinstance(given, Mapping):
        for word in ("scale", "offset"):
            if word in given:
                if len(given) > 1:
                    raise InvalidParameter(f"{where}: {word} stands alone")
                values, inner = axis_values(given[word], where)
                if inner != "set":
                    raise InvalidParameter(f"{where}: scale and offset do not nest")
                return values, word
        unknown = set(given) - {"from", "to", "count", "spacing"}
        if unknown or not {"from", "to", "count"} <= set(given):
            raise InvalidParameter(
                f"{where}: got keys {', '.join(map(str, given))}; a range has from, to, count "
                "and spacing = 'linear' or 'log'"
            )
        return _range(given, where), how
    if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
        raise InvalidParameter(f"{where}: got {given!r}, expected a list of values or a range")
    values = tuple(v.item() if hasattr(v, "item") else v for v in given)
    if not values:
        raise InvalidParameter(f"{where}: has no values")
    return values, how


MOST_POINTS = 1_000_000  # of a sweep, and of one of its axes


def _range(given: Mapping[str, Any], where: str) -> tuple[float, ...]:
    import numpy as np

    start, end, count = given["from"], given["to"], given["count"]
    spacing = given.get("spacing", "linear")
    numeric = all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v)
        for v in (start, end)
    )
    if not numeric or not isinstance(count, int) or not 1 <= count <= MOST_POINTS:
        raise InvalidParameter(
            f"{where}: from = {start!r}, to = {end!r}, count = {count!r}; expected two numbers and "
            f"a count of 1 to {MOST_POINTS}"
        )
    if spacing == "linear":
        return tuple(float(v) for v in np.linspace(start, end, count))
    if spacing == "log" and start > 0 and end > 0:
        return tuple(float(v) for v in np.geomspace(start, end, count))
    raise InvalidParameter(
        f"{where}: spacing = {spacing!r}, expected linear, or log between positive numbers"
    )


def grid_points(axes: Sequence[Axis], mode: Literal["grid", "list"]) -> Iterator[tuple[Any, ...]]:
    """Combinations of the values of the axes, the last varying fastest; ``list``: side by side."""
    if mode == "grid":
        size = math.prod(len(axis.values) for axis in axes)
        if size > MOST_POINTS:
            raise InvalidParameter(f"sweep: a grid of {size} points; the limit is {MOST_POINTS}")
        return itertools.product(*(axis.values for axis in axes))
    if len({len(axis.values) for axis in axes}) > 1:
        lengths = ", ".join(f"{axis.name}: {len(axis.values)}" for axis in axes)
        raise InvalidParameter(f"sweep: a list needs axes of the same length, got {lengths}")
    return zip(*(axis.values for axis in axes), strict=True) if axes else iter([()])


def apply_point(
    action: Action, stroke: Stroke, options: Mapping[str, Any], values: Mapping[str, Any]
) -> tuple[dict[str, Any], Stroke, dict[str, Any]]:
    """Split values by path into those of the mechanism, of the stroke and of the options."""
    del action
    mechanism: dict[str, Any] = {}
    chosen = dict(options)
    for path, value in values.items():
        head, _, rest = path.partition(".")
        if head == "options":
            check_options([rest])
            chosen[rest] = value
        elif head == "stroke":
            if rest == "scale":
                stroke = stroke.scaled(float(value))
            elif rest == "delay":
                stroke = stroke.shifted(float(value))
            elif rest == "duration":
                stroke = replace(stroke, duration=float(value))
            else:
                raise InvalidParameter(
                    f"path {path!r}: of a stroke there are stroke.scale, .delay, .duration"
                )
        else:
            mechanism[path] = value
    return mechanism, stroke, chosen


def check_options(names: Iterable[str]) -> None:
    """Refuse options that ``simulate`` does not have."""
    for name in names:
        if name not in OPTIONS:
            raise InvalidParameter(f"option {name!r} is unknown; there are {', '.join(OPTIONS)}")


# --- the sweep -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SweepResult:
    """What a sweep gave.

    Attributes
    ----------
    table : DataFrame
        One row a member in the order of the values, the last path varying fastest: a column for
        each path, ``stroke``, ``status``, ``error``, and the summary of the run in SI units with
        ``steps`` and ``rhs``. A number that a run does not have is NaN.
    """

    table: pd.DataFrame
    _runs: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"SweepResult({len(self.table)} members, {len(self.failed)} failed)"

    def __len__(self) -> int:
        return len(self.table)

    @property
    def failed(self) -> pd.DataFrame:
        """Rows that are not done."""
        return self.table[self.table["status"] != "done"]

    def run(self, index: int) -> Run:
        """Read the run of a member; the sweep must have had ``summary_only=False``."""
        from feltmb.results import load_run

        if not self._runs:
            raise InvalidParameter("the sweep kept no runs; call it with summary_only=False")
        return load_run(self._runs[index])

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the table as CSV, SI units."""
        return write_text(Path(path), self.table.to_csv(index=False), force=force)


def sweep(
    action: Action | str,
    stroke: Stroke | str | Sequence[Stroke | str],
    values: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    *,
    mode: Literal["grid", "list"] = "grid",
    options: Mapping[str, Any] | None = None,
    executor: Executor | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
    summary_only: bool = True,
    progress: Progress | bool | None = None,
) -> SweepResult:
    """Simulate over values of parameters.

    Parameters
    ----------
    action, stroke
        Objects or names; several strokes are simulated at each point.
    values
        ``{path: values}``: all combinations (or ``mode="list"``: side by side). Paths are those of
        :meth:`Action.with_values`, ``stroke.scale``, ``stroke.delay`` [s], ``stroke.duration`` [s],
        ``options.rtol`` and so on. Values are a list; ``{"from": 1, "to": 4, "count": 7,
        "spacing": "log"}``; ``{"scale": values}``: multiples of the value that the mechanism has;
        ``{"offset": values}``: added to it, in the unit of its file. Or a list of
        ``{path: value}``, one for each point.
    options
        Options of ``simulate``; the ledger is off unless asked for.
    executor
        Any ``concurrent.futures.Executor``: a process pool, ``client.get_executor()`` of Dask. It
        is not shut down. Default: threads.
    jobs
        Threads without an executor; default: one a core.
    folder
        Folder for one small file a finished member. A sweep that was cut off goes on from there;
        nothing is computed twice. A member is known by its parameters, stroke, options and code.
    summary_only
        False: also write each run as NetCDF into ``folder`` (which every worker must see).
    progress
        ``progress(done, total, name)``; default: a bar on a terminal; False: none.

    Returns
    -------
    SweepResult
        A member that fails has its error in the table; the others are not affected. The table
        does not depend on the executor or the number of workers.

    Raises
    ------
    InvalidParameter
        Arguments are wrong. Values out of range are the fault of their member only.
    """
    import pandas as pd

    base = load_action(action) if isinstance(action, str) else action
    strokes = [stroke] if isinstance(stroke, (Stroke, str)) else list(stroke)
    loaded = [load_stroke(s) if isinstance(s, str) else s for s in strokes]
    if not loaded:
        raise InvalidParameter("sweep: no stroke")
    given = dict(options or {})
    check_options(given)
    where = Path(folder) if folder is not None else None
    if where is not None and where.exists() and not where.is_dir():
        raise InvalidParameter(f"folder {where}: is a file")
    if not summary_only and where is None:
        raise InvalidParameter("sweep: runs are kept in a folder; give folder=")

    names, points = _points(base, values, mode)
    rows: list[dict[str, Any]] = []
    members: list[Member] = []
    faults: dict[int, Outcome] = {}
    for shown, changes in points:
        for s in loaded:
            rows.append({**dict(zip(names, shown, strict=True)), "stroke": s.name})
            try:
                mechanism, changed, chosen = apply_point(base, s, given, changes)
            except (InvalidParameter, TypeError, ValueError) as failure:
                faults[len(rows) - 1] = Outcome("failed", _one_line(failure))
                mechanism, changed, chosen = {}, s, given
            label = " ".join(
                f"{n.rsplit('.', 1)[-1]}={v}" for n, v in zip(names, shown, strict=True)
            )
            member = Member(base, changed, mechanism, chosen, f"{s.name} {label}".strip())
            if not summary_only:
                assert where is not None
                marked = replace(member, save_run="yes")
                member = replace(member, save_run=str(where / f"{marked.key[:40]}.nc"))
            members.append(member)
    outcomes: list[Outcome | None] = [faults.get(i) for i in range(len(members))]
    numbered = [(i, m) for i, m in enumerate(members) if i not in faults]
    with ProgressBar(progress, len(numbered), "sweep") as bar:
        for k, outcome in run_members(
            (m for _, m in numbered), executor=executor, jobs=jobs, folder=where
        ):
            index, member = numbered[k]
            outcomes[index] = outcome
            bar.step(member.name)
    return SweepResult(
        _table(rows, outcomes, pd), tuple(m.save_run for m in members) if not summary_only else ()
    )


def _points(
    action: Action, values: Mapping[str, Any] | Sequence[Mapping[str, Any]], mode: str
) -> tuple[list[str], Iterator[tuple[tuple[Any, ...], dict[str, Any]]]]:
    if mode not in ("grid", "list"):
        raise InvalidParameter(f"mode = {mode!r}, expected 'grid' or 'list'")
    if isinstance(values, Mapping):
        axes = []
        for path, given in values.items():
            found, how = axis_values(given, f"values[{path!r}]")
            axes.append(Axis(path, found, (path,), how))
        combined = grid_points(axes, mode)  # type: ignore[arg-type]

        def expand() -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
            for point in combined:
                changes: dict[str, Any] = {}
                for axis, value in zip(axes, point, strict=True):
                    changes.update(axis.at(action, value))
                yield point, changes

        return [axis.name for axis in axes], expand()
    listed = [dict(v) for v in values]
    paths = list(dict.fromkeys(path for point in listed for path in point))
    if not listed:
        raise InvalidParameter("values: has no points")
    return paths, iter([(tuple(p.get(path) for path in paths), p) for p in listed])


def _table(rows: list[dict[str, Any]], outcomes: Sequence[Outcome | None], pd: Any) -> Any:
    """Rows with their outcomes; number columns in the order in which they first appear."""
    numbers = list(dict.fromkeys(k for o in outcomes if o is not None for k in o.numbers))
    numbers = [n for n in numbers if n not in ("steps", "rhs")] + ["steps", "rhs"]
    full = []
    for row, outcome in zip(rows, outcomes, strict=True):
        found = outcome or Outcome("error", "was not run")
        full.append(
            {
                **row,
                "status": found.status,
                "error": found.error,
                **{n: found.numbers.get(n, math.nan) for n in numbers},
            }
        )
    return pd.DataFrame(full)


def check_folder(path: Path, *, force: bool) -> None:
    """Refuse a file where a folder of results is to be."""
    if path.exists() and not path.is_dir():
        check_writable(path, force=force)
        raise InvalidParameter(f"{path}: is a file, expected a folder")
