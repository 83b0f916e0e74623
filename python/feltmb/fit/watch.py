"""Progress of a long fit or diagnosis, and its early end.

After a stop, the running optimization ends at its present point, no other one is started, and the
results so far are reported. The proof on held-out records still has its part of the time limit, or
``GRACE`` after an interruption. What it has not completed then is discarded (:class:`Ended`).
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from threading import Lock

from feltmb.arguments import checked
from feltmb.blas import one_thread

__all__ = [
    "CHECKS",
    "FIT",
    "PROOF",
    "REPORT",
    "SEARCH",
    "Ended",
    "Progress",
    "Say",
    "Tell",
    "Watch",
    "current",
    "simulated",
    "watching",
]

CHECKS, FIT = "checks of the data", "fit of the model"
SEARCH, PROOF, REPORT = "search", "proof on held-out records", "report"
STAGES = (CHECKS, FIT, SEARCH, PROOF, REPORT)
#: Smallest and usual largest number of steps (linearizations and trial points) of the fit of the
#: model, of items of the other stages (refits, evaluations on held-out records), and of steps of an
#: item, until they are known.
STEPS_OF_FIT, STEPS_OF_ITEM = (20, 120), (5, 12)
ITEMS = {SEARCH: (3, 40), PROOF: (2, 16)}
#: Share of the time limit after which no fit is started; the rest is for the proof.
FOR_FITS = 0.6
#: Share of this time after which the fit of the model alone ends, so that effects are fitted, too.
FOR_MODEL = 0.5
#: Time after an interruption that the proof and the report still have [s].
GRACE = 5.0
#: Shortest time between two calls of the callback within a stage [s].
PAUSE = 0.1


@checked
@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress that a callback receives."""

    stage: str
    """Stage in plain words: checks of the data, fit of the model, search, proof, report."""
    detail: str
    """Present step: the effects that are fitted, the level of a fit."""
    simulations: int
    """Number of simulated records so far; a part of a record counts as its share."""
    about: int
    """Least expected total number of simulated records; 0: unknown."""
    misfit: float | None
    """Smallest sum of squares so far, relative to its expectation under noise [1]; None: none
    yet."""
    elapsed: float
    """Elapsed time [s]."""
    left: float | None
    """Least remaining time [s]: known refits and evaluations, with the mean time of those that are
    finished. None: unknown."""
    notice: str = ""
    """Message for the user, which is told once."""
    left_most: float | None = None
    """Remaining time [s] if every stage takes its usual largest number of them, or until the time
    limit. None: unknown, because there were more."""


class Ended(BaseException):
    """The time of a computation is over: what it has not completed is discarded.

    It is no error of the model that is simulated, so that ``except Exception`` does not handle it.
    """


Tell = Callable[[Progress], None]
#: Function that is told a step of a stage: its name, the number of finished steps, and of all.
Say = Callable[[str, int, int], None]

_seen = 0.0
_counting = Lock()


def simulated(runs: float) -> None:
    """Count simulated records; models call it, in any thread.

    Raises
    ------
    Ended
        The time is over, and the result of the running block is discarded.
    """
    global _seen
    with _counting:
        _seen += runs
    current().beat()


class Watch:
    """Progress of one diagnosis or fit, with its time limit [s] and stop function."""

    def __init__(
        self,
        tell: Tell | None = None,
        budget: float | None = None,
        stop: Callable[[], bool] | None = None,
        stages: Sequence[str] = STAGES,
    ):
        self._tell = tell
        self._budget = budget
        self._stop = stop
        self._stages = stages
        self._begin = clock.perf_counter()
        self._entered = 0.0
        self._asked: float | None = None  # time of the interruption [s]
        self._discarding, self._patient = 0, 0
        self._ended = math.inf  # time of the stop [s]
        self._first = _seen
        self._last = -PAUSE
        self._calls = dict.fromkeys(STAGES, 0)
        self._items = {stage: least for stage, (least, _) in ITEMS.items()}  # known ones left
        self._took: dict[str, list[float]] = {SEARCH: [], PROOF: []}  # of finished items [s]
        self._notice = ""
        self._item = 0.0  # start of the present item
        self.stage, self.detail = CHECKS, ""
        self.misfit: float | None = None
        self.why = ""
        """Reason for the stop; empty: not stopped."""
        self.stopped_in = ""
        """Stage in which it was stopped."""
        self.stopped_at = ""
        """Step of this stage."""
        self.model_cut = 0.0
        """Time after which the fit of the model alone was ended [s]; 0: it was not."""

    @property
    def elapsed(self) -> float:
        """Time since the start [s]."""
        return clock.perf_counter() - self._begin

    def over(self) -> bool:
        """Whether the run must end."""
        if not self.why:
            if self._interrupted():
                self._end("interrupted")
            elif self._before_proof() and self._budget is not None:
                if self.elapsed > FOR_FITS * self._budget:
                    self._end(f"fits may take {FOR_FITS:.0%} of the budget of {self._budget:g} s")
            elif self._budget is not None and self.elapsed > self._budget:
                self._end(f"the budget of {self._budget:g} s was spent")
        return bool(self.why)

    def _interrupted(self) -> bool:
        """Whether the stop function asked for the end, now or before."""
        if self._asked is None and self._stop is not None and self._stop():
            self._asked = self.elapsed
        return self._asked is not None

    def _before_proof(self) -> bool:
        """Whether a proof follows, which has its own part of the time limit."""
        return PROOF in self._stages and self.stage in (CHECKS, FIT, SEARCH)

    def _end(self, why: str) -> None:
        """Keep the first reason for the stop, and its stage."""
        if not self.why:
            self.why, self.stopped_in, self.stopped_at = why, self.stage, self.detail
            self._ended = self.elapsed

    def stopping(self) -> bool:
        """Whether fits and searches must end; a proof still has its part of the time limit."""
        return self.stage in (FIT, SEARCH) and (self.over() or self._model_late())

    def _model_late(self) -> bool:
        """Whether the fit of the model alone must leave the rest of the time to the search."""
        if self.stage != FIT or SEARCH not in self._stages or self._budget is None:
            return False
        taken = self.elapsed - self._entered
        if taken <= FOR_MODEL * FOR_FITS * self._budget:
            return False
        self.model_cut = self.model_cut or taken
        return True

    def must_end(self) -> bool:
        """Whether a loop of the present stage must end."""
        return self.stopping() or self.proof_over()

    def proof_over(self) -> bool:
        """Whether the proof or the report must end: their part of the time is over.

        They continue for ``GRACE`` after an interruption, and judge what was found.
        """
        if self.stage not in (PROOF, REPORT):
            return False
        if self._interrupted():
            self._end("interrupted")
            assert self._asked is not None
            return self.elapsed - self._asked > GRACE
        if self._budget is None:
            return False
        late = (
            self.elapsed > self._budget + GRACE
            if self.stage == REPORT
            else self.elapsed - self._entered > (1.0 - FOR_FITS) * self._budget
        )
        if late:
            self._end(f"the budget of {self._budget:g} s was spent")
        return late

    @contextmanager
    def discarding(self) -> Iterator[None]:
        """Block whose result is discarded, with :class:`Ended`, when its time is over."""
        self._discarding += 1
        try:
            yield
        finally:
            self._discarding -= 1

    @contextmanager
    def keeping(self) -> Iterator[None]:
        """Block that is left when its time is over; what it has found so far is used.

        Within a block that is discarded, :class:`Ended` goes on to that block.
        """
        try:
            with self.discarding():
                yield
        except Ended:
            if self._discarding:
                raise

    @contextmanager
    def finishing(self) -> Iterator[None]:
        """As :meth:`keeping`, but the block has ``GRACE`` after the stop."""
        self._patient += 1
        try:
            with self.keeping():
                yield
        finally:
            self._patient -= 1

    def enter(self, stage: str) -> None:
        """Start a stage."""
        self._finish_item()
        self._items[stage] = ITEMS.get(stage, (0, 0))[0]
        self.stage, self.detail = stage, ""
        self._entered = self.elapsed
        self._show(now=True)

    def say(self, detail: str, done: int = 0, total: int = 0) -> None:
        """Report the present step of the stage."""
        self.detail = f"{detail} {done + 1}/{total}" if total else detail
        self._show(now=True)

    def expect(self, count: int) -> None:
        """The present item of the stage is finished; at least ``count`` more are known.

        An item is a refit in the search, or an evaluation in the proof. The next one begins now.
        """
        took = self._took.get(self.stage)
        if took is None:
            return
        self._finish_item()
        took.append(math.inf)
        self._item, self._items[self.stage] = self.elapsed, max(count, 1)

    def _finish_item(self) -> None:
        """Keep the time of the present item, unless it was ended early."""
        took = self._took.get(self.stage)
        if took and not self.must_end():
            took[-1] = self.elapsed - self._item

    def note(self, notice: str) -> None:
        """Tell the user something, once."""
        self._notice = notice
        self._show(now=True)
        self._notice = ""

    def fitted(self, misfit: float) -> None:
        """Report the sum of squares of a finished fit, relative to its expectation."""
        if misfit < (math.inf if self.misfit is None else self.misfit):
            self.misfit = misfit

    def step(self) -> None:
        """Count one more linearization or trial point.

        Raises
        ------
        Ended
            The time is over, and the result of the running block is discarded.
        """
        self._calls[self.stage] = self._calls.get(self.stage, 0) + 1
        self.beat()

    def beat(self) -> None:
        """Report activity within a step; see :meth:`step`."""
        self._show(now=False)
        if self._discarding and self.must_end():
            if self._patient and self.elapsed - self._ended <= GRACE:
                return
            raise Ended

    def _show(self, *, now: bool) -> None:
        elapsed = self.elapsed
        if self._tell is None or not (now or elapsed - self._last >= PAUSE):
            return
        self._last = elapsed
        made = round(_seen - self._first)
        about = 0
        left = most = None
        if sum(self._calls.values()) >= 4 and made and self.stage != REPORT:
            left, most = self._left()
            if self._budget is not None:
                limit = max(self._budget - elapsed, 0.0)
                left, most = min(left, limit), limit if most is None else min(most, limit)
            about = round(made * (1.0 + left / elapsed))
        self._tell(
            Progress(
                stage=self.stage,
                detail=self.detail,
                simulations=made,
                about=about,
                misfit=self.misfit,
                elapsed=elapsed,
                left=left,
                left_most=most,
                notice=self._notice,
            )
        )

    def _left(self) -> tuple[float, float | None]:
        """Least and usual largest remaining time [s]; the latter is None if it is exceeded."""
        step = self.elapsed / sum(self._calls.values())
        finished = [t for took in self._took.values() for t in took if t < math.inf]
        least, most = 0.0, 0.0
        known = True
        if self.stage in (CHECKS, FIT) and not self.over():
            least, most = (step * max(0, n - self._calls[FIT]) for n in STEPS_OF_FIT)
            known = self._calls[FIT] <= STEPS_OF_FIT[1]
        for stage in self._stages[self._stages.index(self.stage) :]:
            if stage not in ITEMS or (stage == SEARCH and self.over()):
                continue
            items, usual = self._items[stage], ITEMS[stage][1]
            own = [t for t in self._took[stage] if t < math.inf] or finished
            short, long = (step * n for n in STEPS_OF_ITEM)
            if own:
                short = long = sum(own) / len(own)
            more = max(items, usual - len(self._took[stage]))
            spent = self.elapsed - self._item if stage == self.stage and self._took[stage] else 0.0
            least += max(items * short - spent, (items - 1) * short)
            most += max(more * long - spent, (more - 1) * long)
            known = known and len(self._took[stage]) <= usual
        return least, most if known else None


#: Watch of this thread and of the threads that it starts; otherwise an unused watch.
_current: ContextVar[Watch | None] = ContextVar("watch", default=None)
_idle = Watch()


def current() -> Watch:
    """The watch of the running computation."""
    return _current.get() or _idle


@contextmanager
def watching(watch: Watch) -> Iterator[Watch]:
    """Use a watch in a block, with one thread for linear algebra."""
    token = _current.set(watch)
    try:
        with one_thread():
            yield watch
    finally:
        _current.reset(token)
