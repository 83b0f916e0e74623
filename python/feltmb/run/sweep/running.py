"""Runs many members in parallel, on threads of the core or on an executor."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.arguments import checked
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.files import make_folder
from feltmb.run.batch import simulate_many
from feltmb.run.sweep.folder import recall, store
from feltmb.run.sweep.member import (
    Member,
    Outcome,
    failure_outcome,
    one_line,
    run_member,
    to_outcome,
)

if TYPE_CHECKING:
    from feltmb.mechanism import Action
    from feltmb.run.results import Run


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
        self._under_way: dict[int, tuple[Member, Action]] = {}
        self._ready: queue.Queue[tuple[int, Outcome] | None] = queue.Queue(2 * jobs + 2)
        self._stop = _core.StopFlag()
        self._fault: BaseException | None = None

    def outcomes(self) -> Generator[tuple[int, Outcome], None, None]:
        """Indices and outcomes, as they are finished."""
        thread = threading.Thread(target=self._run, name="feltmb batch")
        try:
            thread.start()
        except RuntimeError as refused:  # by the system
            raise FeltmbError(f"sweep: its thread could not be started: {refused}") from None
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
            self._under_way[begun] = (member, action)
            begun += 1
            yield action, member.stroke, member.simulate_options()

    def _take(self, index: int, result: Run | FeltmbError) -> bool:
        member, action = self._under_way.pop(index)
        return self._finish(member, to_outcome(member, action, result))

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
