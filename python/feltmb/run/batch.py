"""Many strokes in one call, on threads of the core, in order and with limited memory.

For a sweep with a table, which can be interrupted and continued, use :func:`feltmb.sweep`. This
module is for programs of the user with thousands of strokes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.errors import IntegrationError
from feltmb.mechanism import Action
from feltmb.run.options import ALL_OPTIONS, RunOptions, check_options
from feltmb.run.simulate import prepare, to_run
from feltmb.run.stroke import Stroke
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter, ModelError

if TYPE_CHECKING:
    from feltmb.run.results import Run

__all__ = ["simulate_many"]


@checked
def simulate_many(
    strokes: Iterator[Any]  # asked for one by one
    | Iterable[tuple[Action, Stroke] | tuple[Action, Stroke, Mapping[str, Any]]],
    take: Callable[[int, Run | Error], object],
    *,
    jobs: int | None = None,
    ordered: bool = True,
    stop: _core.StopFlag | None = None,
    options: RunOptions | None = None,
    **given: Any,
) -> int:
    """Simulate many strokes on threads.

    Parameters
    ----------
    strokes
        Action and stroke, and optionally options of this stroke alone. May be a generator: the next
        stroke is requested when a thread is free. Actions that ``Action.with_values`` made from one
        another share the unchanged parts.
    take
        ``take(index, outcome)`` is called with each outcome: the run, or the error that
        :func:`feltmb.simulate` would raise. If it returns False, the batch stops; any other value
        continues it. Outcomes that it does not store are freed: at most four outcomes per thread
        are in memory.
    jobs
        Number of threads, at most four per core, or fewer if the system cannot start more; default:
        one per core. Outcomes are identical, bit for bit, for any number.
    ordered
        True: ``take`` is called in the order of the strokes, by one thread at a time. False: each
        thread calls it as soon as its stroke is finished, so that calls may overlap; a long stroke
        then delays nothing.
    stop
        ``feltmb._core.StopFlag``; when any thread sets it, the batch ends immediately.
    options, given
        Options of all strokes: :class:`feltmb.run.RunOptions`, and single fields that replace its
        values. The ledger is off by default. ``summary_only=True`` is fastest.

    Returns
    -------
    int
        Number of outcomes.

    Raises
    ------
    InvalidParameter
        An argument is invalid. A fault of one stroke is the outcome of that stroke.

    Examples
    --------
    Two strokes of 1 ms on threads:

    >>> import feltmb
    >>> action, runs = feltmb.load_action("steinway45"), {}
    >>> strokes = [(action, feltmb.pulse_stroke(force, 0.0)) for force in (5.0, 10.0)]
    >>> _ = feltmb.batch.simulate_many(strokes, runs.__setitem__, duration=1e-3)
    >>> sorted(runs)
    [0, 1]
    """
    count = 0 if jobs is None else int(jobs)
    if jobs is not None and count < 1:
        raise InvalidParameter(f"jobs = {jobs}, must be >= 1")
    _refuse(given)
    chosen = replace(options or RunOptions(ledger=False), **given)
    under_way: dict[int, tuple[Any, ...]] = {}
    faults: dict[int, Error] = {}  # errors of strokes that could not start, by index
    handed = 0
    going = True
    guard = threading.Lock()

    def prepared() -> Iterator[Any]:
        begun = 0
        for position, (action, stroke, *own) in enumerate(strokes):
            try:
                if own:
                    _refuse(own[0])
                each = replace(chosen, **own[0]) if own else chosen
                settings, arguments = prepare(action, stroke, each)
            except Error as fault:
                if ordered:
                    faults[position] = fault
                else:
                    give(position, fault)
                continue
            mechanism, drive, start, monitors, memory = arguments
            under_way[begun] = (position, action, stroke, settings, (start, memory))
            begun += 1
            yield _core.BatchStroke(mechanism, drive, settings, start, monitors, memory)

    def give(position: int, outcome: Run | Error) -> None:
        nonlocal handed, going
        if not going:
            return
        with guard:
            handed += 1
        if take(position, outcome) is False:
            going = False

    def hand_on(index: int, result: Any, failure: str) -> bool:
        position, action, stroke, settings, start = under_way.pop(index)
        if ordered:
            for earlier in sorted(p for p in faults if p < position):
                give(earlier, faults.pop(earlier))
        if failure:
            error = ModelError(failure)
            error.code = result.code
            give(position, error)
            return going
        run = to_run(action, stroke, settings, result, start)
        if run.status == "done":
            give(position, run)
        elif run.status != "interrupted":
            give(
                position,
                IntegrationError(
                    run.message,
                    code=result.code,
                    partial=run,
                    time=run.reached,
                    state=result.failed_state,
                    contact=result.failed_contact,
                ),
            )
        return going

    _core.simulate_many(prepared(), hand_on, count, ordered, stop)
    for position in sorted(faults):
        give(position, faults[position])
    return handed


def _refuse(options: Mapping[str, Any]) -> None:
    for name in ("start", "progress"):
        if name in options:
            raise InvalidParameter(f"simulate_many: {name} is not for a batch")
    check_options(options, known=ALL_OPTIONS)
