"""Processes several records at once and combines their simulations.

The time of a model in Python is the overhead of array operations, hardly their length: a batch of
the segments of all records takes little longer than one record. The work for each record therefore
has a thread of its own. Every call of ``simulate`` waits until all threads have called it or have
ended. One call of ``simulate_all`` then answers all of them. The calls do not depend on the timing
of the threads, so that results are reproducible.
"""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from feltmb.fit.model import Batch, Model, Simulated

__all__ = ["each"]

T = TypeVar("T")
R = TypeVar("R")


def each(model: Model, work: Callable[[Model, T], R], items: Sequence[T]) -> list[R]:
    """Results of ``work(model, item)`` for all items, in their order.

    Raises
    ------
    Exception
        Exception of the first item, in their order, whose work failed.
    """
    if not model.together or len(items) < 2:
        return [work(model, item) for item in items]
    meeting = _Meeting(model.core, len(items))
    results: list[R | None] = [None] * len(items)
    faults: list[BaseException | None] = [None] * len(items)

    def one(i: int) -> None:
        try:
            results[i] = work(model.asking(partial(meeting.ask, i)), items[i])
        except BaseException as fault:
            faults[i] = fault
        finally:
            meeting.leave()

    threads = [
        threading.Thread(target=contextvars.copy_context().run, args=(one, i), daemon=True)
        for i in range(len(items))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for fault in faults:
        if fault is not None:
            raise fault
    return results  # type: ignore[return-value]


class _Meeting:
    """Synchronizes threads so that their simulations are done in one call."""

    def __init__(self, model: Model, count: int) -> None:
        self._model = model
        self._present = count
        self._asked: dict[int, Sequence[Batch]] = {}
        self._answers: dict[int, list[Simulated] | BaseException] = {}
        self._round = threading.Condition()

    def ask(self, i: int, batches: Sequence[Batch]) -> list[Simulated]:
        """Simulate, together with the requests of the other threads."""
        with self._round:
            self._asked[i] = batches
            self._answer_all()
            while i not in self._answers:
                self._round.wait()
            answer = self._answers.pop(i)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def leave(self) -> None:
        """End the participation of a thread."""
        with self._round:
            self._present -= 1
            self._answer_all()

    def _answer_all(self) -> None:
        """Run the simulations if all threads wait."""
        if not self._asked or len(self._asked) < self._present:
            return
        who = sorted(self._asked)
        try:
            runs = iter(self._model.simulate_all([batch for i in who for batch in self._asked[i]]))
            for i in who:
                self._answers[i] = [next(runs) for _ in self._asked[i]]
        except BaseException as fault:  # SystemExit as well: the waiting threads must get it
            self._answers.update((i, fault) for i in who)
        self._asked.clear()
        self._round.notify_all()
