"""Members of a sweep: one simulation each, in parallel, stored in a folder when they are finished.

They run on threads of the core or on an executor.
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.errors import IntegrationError
from feltmb.mechanism import Action
from feltmb.run.batch import simulate_many
from feltmb.run.stroke import Stroke
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import Store, digest_of, make_folder, package_digest

if TYPE_CHECKING:
    from feltmb.run.results import Run


@checked
@dataclass(frozen=True)
class Member:
    """One simulation: mechanism, values by dotted path, stroke, options of ``simulate``."""

    action: Action
    stroke: Stroke
    values: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    save_run: str = ""  #: NetCDF file to be written; "" for none

    def changed_action(self) -> Action:
        """The mechanism with the values of this member."""
        return self.action.with_values(self.values) if self.values else self.action

    def simulate_options(self) -> dict[str, Any]:
        """Options of ``simulate``."""
        return {"ledger": False, "summary_only": not self.save_run, **self.options}

    @cached_property
    def key(self) -> str:
        """SHA-256 of parameters, stroke, options, and code."""
        return digest_of(
            package_digest("feltmb"),
            self.action.hash,
            self.values,
            self.stroke.as_dict(),
            self.options,
            bool(self.save_run),
        )


@dataclass(frozen=True)
class Outcome:
    """Outcome of a member.

    Attributes
    ----------
    status
        ``done``; ``failed``: the solver stopped early (the outcome has what was reached), or the
        values are impossible; ``error``: another fault (a worker process died, the wall time limit
        was reached). A member with ``error`` is repeated when the sweep continues.
    error
        Message in one line; empty if done.
    numbers
        Summary of the run, SI units; ``steps`` and ``rhs``: work counts.
    wall
        Wall time of the simulation [s].
    warnings
        Warnings of the run (:attr:`Run.warnings`).
    resumed
        Whether it was read from the folder instead of computed.
    """

    status: str
    error: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    reached: float = 0.0
    wall: float = 0.0
    warnings: tuple[str, ...] = ()
    resumed: bool = False


def one_line(error: BaseException) -> str:
    """Message of an error, with its type if it is not an error of feltmb."""
    text = " ".join(str(error).split())
    return text if isinstance(error, Error) else f"{type(error).__name__}: {text}".rstrip(": ")


def failure_outcome(error: Exception) -> Outcome:
    """Outcome of a member without a run."""
    return Outcome("failed" if isinstance(error, Error) else "error", one_line(error))


def to_outcome(member: Member, result: Run | Error) -> Outcome:
    """Outcome of a member, from its run or from an error."""
    status, error = "done", ""
    if isinstance(result, IntegrationError):
        run, error = result.partial, one_line(result)
        if run.status != "failed":  # the state at a wall time limit is random
            return Outcome("error", error, reached=run.reached, wall=float(run.stats["wall"]))
        status = "failed"
    elif isinstance(result, Error):
        return failure_outcome(result)
    else:
        run = result
    try:
        numbers = {k: float(v) for k, v in run.summary.items()}
        if member.save_run:
            try:
                run.save(member.save_run, force=True)
            except Error as failure:  # a fault of the disk, not of the member: it is repeated
                return Outcome("error", one_line(failure))
    except Exception as failure:  # a member must not stop the others
        return failure_outcome(failure)
    numbers.update(steps=float(run.stats["steps"]), rhs=float(run.stats["rhs"]))
    wall = float(run.stats["wall"])
    return Outcome(status, error, numbers, run.reached, wall, run.warnings)


@checked
def run_member(member: Member) -> Outcome:
    """Simulate one member, in any process; every fault becomes its outcome."""
    from feltmb.run.simulate import simulate

    try:
        action = member.changed_action()
        result: Run | Error
        try:
            result = simulate(action, member.stroke, **member.simulate_options())
        except IntegrationError as failure:
            result = failure
    except Exception as failure:  # a member must not stop the others
        return failure_outcome(failure)
    return to_outcome(member, result)


# --- in a folder ---------------------------------------------------------------------------------


def _files(member: Member, status: str) -> dict[str, Path]:
    """File of the saved run of a member."""
    return {"run": Path(member.save_run)} if member.save_run and status == "done" else {}


def store(folder: Path, member: Member, outcome: Outcome) -> None:
    """Write the outcome of a member; it counts as finished when its file exists."""
    found = {
        "feltmb": "member",
        "name": member.name,
        "action": member.action.name,
        "values": dict(member.values),
        "stroke": member.stroke.name,
        "status": outcome.status,
        "error": outcome.error,
        "numbers": outcome.numbers,
        "reached": outcome.reached,
        "wall": outcome.wall,
        "warnings": list(outcome.warnings),
    }
    Store(folder).put(member.key, found, files=_files(member, outcome.status))


def recall(folder: Path, member: Member) -> Outcome | None:
    """Outcome of a member from the folder; None if it is absent or was changed."""
    found = Store(folder).get(member.key, {"run": Path(member.save_run)})
    if found is None:
        return None
    numbers = {str(name): float(value) for name, value in found["numbers"].items()}
    return Outcome(
        str(found["status"]), str(found["error"]), numbers, float(found["reached"]),
        float(found["wall"]), tuple(map(str, found["warnings"])), resumed=True,
    )  # fmt: skip


# --- in parallel ---------------------------------------------------------------------------------


def default_jobs() -> int:
    """Number of cores that this process may use."""
    try:
        return max(1, len(os.sched_getaffinity(0)))
    except AttributeError:
        return max(1, os.cpu_count() or 1)


@checked
def run_members(
    members: Iterable[Member],
    *,
    executor: Executor | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
) -> Generator[tuple[int, Outcome], None, None]:
    """Run members and yield their outcomes with their indices, as they are finished.

    Only as many members as needed for the workers are in memory. A finished member is stored in the
    folder before it is yielded. The order of the yielded outcomes depends on the workers, but the
    outcomes do not.

    Parameters
    ----------
    members
        Members; may be a generator.
    executor
        Executor; default: one batch of the core (:mod:`feltmb.run.batch`) on threads of this
        process. A given executor is not shut down.
    jobs
        Number of threads without an executor, at most four per core; default: the number of cores
        of this process.
    folder
        Folder of finished members, which are not computed again.
    """
    where = make_folder(folder) if folder is not None else None
    if executor is not None:
        return _on_executor(members, executor, where)
    count = default_jobs() if jobs is None else int(jobs)
    if count < 1:
        raise InvalidParameter(f"jobs = {count}, must be >= 1")
    return _Batch(members, count, where).outcomes()


# --- threads of the core -------------------------------------------------------------------------


class _Batch:
    """One batch of the core in a thread of its own; its workers store finished members.

    A worker takes a member, makes its mechanism, simulates without the global interpreter lock,
    extracts the values from the run and stores them. It puts the outcome into a queue of limited
    size, so that a slow consumer slows the workers down.
    """

    def __init__(self, members: Iterable[Member], jobs: int, folder: Path | None):
        self._members = members
        self._jobs = jobs
        self._folder = folder
        self._guard = threading.Lock()
        self._positions: dict[str, list[int]] = {}  # of running members; equal members run once
        self._under_way: dict[int, Member] = {}
        self._ready: queue.Queue[tuple[int, Outcome] | None] = queue.Queue(2 * jobs + 2)
        self._stop = _core.StopFlag()
        self._fault: BaseException | None = None

    def outcomes(self) -> Generator[tuple[int, Outcome], None, None]:
        """Indices and outcomes, as they are finished."""
        thread = threading.Thread(target=self._run, name="feltmb batch")
        try:
            thread.start()
        except RuntimeError as refused:  # by the system
            raise Error(f"sweep: its thread could not be started: {refused}") from None
        try:
            while (found := self._ready.get()) is not None:
                yield found
            if self._fault is not None:
                raise self._fault
        finally:
            self._stop.set()
            thread.join()

    def _run(self) -> None:
        try:
            simulate_many(
                self._strokes(), self._take, jobs=self._jobs, ordered=False, stop=self._stop
            )
        except BaseException as fault:
            self._fault = fault
        self._put(None)

    def _put(self, item: tuple[int, Outcome] | None) -> bool:
        # No thread waits for the outcomes after the main thread has ended.
        while not self._stop.is_set() and threading.main_thread().is_alive():
            try:
                self._ready.put(item, timeout=0.1)
            except queue.Full:
                continue
            return True
        return False

    def _strokes(self) -> Iterator[tuple[Any, ...]]:
        """Members to be simulated; called by one worker at a time."""
        begun = 0
        for index, member in enumerate(self._members):
            with self._guard:
                if member.key in self._positions:
                    self._positions[member.key].append(index)
                    continue
            known = recall(self._folder, member) if self._folder is not None else None
            if known is not None:
                self._put((index, known))
                continue
            with self._guard:
                self._positions[member.key] = [index]
            try:
                action = member.changed_action()
            except Exception as failure:  # a member must not stop the others
                self._finish(member, failure_outcome(failure))
                continue
            self._under_way[begun] = member
            begun += 1
            yield action, member.stroke, member.simulate_options()

    def _take(self, index: int, result: Run | Error) -> bool:
        member = self._under_way.pop(index)
        return self._finish(member, to_outcome(member, result))

    def _finish(self, member: Member, outcome: Outcome) -> bool:
        if self._folder is not None and outcome.status in ("done", "failed"):
            store(self._folder, member, outcome)
        with self._guard:
            positions = self._positions.pop(member.key)
        return all(self._put((position, outcome)) for position in positions)


# --- an executor ---------------------------------------------------------------------------------


def _on_executor(
    members: Iterable[Member], executor: Executor, folder: Path | None
) -> Generator[tuple[int, Outcome], None, None]:
    workers = getattr(executor, "_max_workers", None) or 16
    limit = 2 * int(workers) + 2
    waiting: dict[Future[Outcome], Member] = {}
    positions: dict[str, list[int]] = {}  # of running members; equal members run once
    try:
        for index, member in enumerate(members):
            if member.key in positions:
                positions[member.key].append(index)
                continue
            known = recall(folder, member) if folder is not None else None
            if known is not None:
                yield index, known
                continue
            while len(waiting) >= limit:
                yield from _collect(waiting, positions, folder)
            positions[member.key] = [index]
            try:
                waiting[executor.submit(run_member, member)] = member
            except RuntimeError as failure:  # the executor failed or was shut down
                for position in positions.pop(member.key):
                    yield position, Outcome("error", one_line(failure))
        while waiting:
            yield from _collect(waiting, positions, folder)
    finally:
        for future in waiting:
            future.cancel()


def _collect(
    waiting: dict[Future[Outcome], Member], positions: dict[str, list[int]], folder: Path | None
) -> Iterator[tuple[int, Outcome]]:
    """Wait for at least one member, store the finished ones, and yield them."""
    done, _ = wait(waiting, return_when=FIRST_COMPLETED)
    for future in done:
        member = waiting.pop(future)
        failure = future.exception()
        if failure is None:
            outcome = future.result()
        elif isinstance(failure, Exception):
            outcome = Outcome("error", one_line(failure))
        else:
            raise failure
        if folder is not None and outcome.status in ("done", "failed"):
            store(folder, member, outcome)
        for position in positions.pop(member.key):
            yield position, outcome
