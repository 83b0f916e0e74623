"""What a long fit or diagnosis tells while it runs, and when it is to end early.

A stop is soft: an optimization that is under way ends at the point that it has reached, no other
is begun, and what is known by then is reported. The proof on held-out records is still made.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from threading import Lock

from feltmb.arguments import checked

__all__ = [
    "CHECKS",
    "FIT",
    "PROOF",
    "REPORT",
    "SEARCH",
    "Progress",
    "Tell",
    "Watch",
    "current",
    "simulated",
    "watching",
]

CHECKS, FIT = "checks of the data", "fit of the model"
SEARCH, PROOF, REPORT = "search", "proof on held-out records", "report"
STAGES = (CHECKS, FIT, SEARCH, PROOF, REPORT)
#: Linearizations and trial points that stages mostly take: what is left is estimated from them.
USUAL = {FIT: 20, SEARCH: 120, PROOF: 20}
#: Share of a budget after which nothing new is fitted: the rest is for the proof.
FOR_FITS = 0.8
#: Seconds between two calls of the callback within a stage.
PAUSE = 0.1


@checked
@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress that a callback receives."""

    stage: str
    """In plain words: checks of the data, fit of the model, search, proof, report."""
    detail: str
    """What is under way: the effects that are fitted, the level of a descent."""
    simulations: int
    """Runs of records so far; parts of a record count as their share."""
    about: int
    """Runs that it will be about; 0: not known yet."""
    misfit: float | None
    """Least sum of squares so far, of its expectation under noise [1]; None: none yet."""
    elapsed: float
    """[s]"""
    left: float | None
    """About [s]; None: not known yet."""


Tell = Callable[[Progress], None]

_seen = 0.0
_counting = Lock()


def simulated(runs: float) -> None:
    """Note that records were simulated; called by models, in any thread."""
    global _seen
    with _counting:
        _seen += runs


class Watch:
    """Progress of one diagnosis or fit, its budget [s] and its stop."""

    def __init__(
        self,
        tell: Tell | None = None,
        budget: float | None = None,
        stop: Callable[[], bool] | None = None,
    ):
        self._tell = tell
        self._budget = budget
        self._stop = stop
        self._begin = clock.perf_counter()
        self._first = _seen
        self._last = -PAUSE
        self._calls = dict.fromkeys(STAGES, 0)
        self.stage, self.detail = CHECKS, ""
        self.misfit: float | None = None
        self.why = ""
        """Why it was stopped, in words; empty: it was not."""
        self.stopped_in = ""
        """Stage in which it was."""

    @property
    def elapsed(self) -> float:
        """Since the begin [s]."""
        return clock.perf_counter() - self._begin

    def over(self) -> bool:
        """Whether it is to end."""
        if not self.why:
            if self._stop is not None and self._stop():
                self.why = "interrupted"
            elif self._budget is not None and self.elapsed > FOR_FITS * self._budget:
                self.why = f"the budget of {self._budget:g} s was spent"
            if self.why:
                self.stopped_in = self.stage
        return bool(self.why)

    def stopping(self) -> bool:
        """Whether what fits and searches is to end; a proof is still made."""
        return self.stage in (FIT, SEARCH) and self.over()

    def enter(self, stage: str, detail: str = "") -> None:
        """A stage begins."""
        self.stage, self.detail = stage, detail
        self._show(now=True)

    def say(self, detail: str, done: int = 0, total: int = 0) -> None:
        """What is under way within the stage."""
        self.detail = f"{detail} {done + 1}/{total}" if total else detail
        self._show(now=True)

    def fitted(self, misfit: float) -> None:
        """A fit ended with this sum of squares, of its expectation."""
        if self.misfit is None or misfit < self.misfit:
            self.misfit = misfit

    def step(self) -> None:
        """One more linearization or trial point is simulated."""
        self._calls[self.stage] = self._calls.get(self.stage, 0) + 1
        self._show(now=False)

    def beat(self) -> None:
        """Something goes on within a step."""
        self._show(now=False)

    def _show(self, *, now: bool) -> None:
        elapsed = self.elapsed
        if self._tell is None or not (now or elapsed - self._last >= PAUSE):
            return
        self._last = elapsed
        made = round(_seen - self._first)
        calls = sum(self._calls.values())
        about, left = 0, None
        if calls >= 4 and made:
            about = max(round(made * (calls + self._calls_left()) / calls), made)
            left = elapsed * (about - made) / made
            if self._budget is not None:
                left = min(left, max(self._budget - elapsed, 0.0))
        self._tell(
            Progress(
                stage=self.stage,
                detail=self.detail,
                simulations=made,
                about=about,
                misfit=self.misfit,
                elapsed=elapsed,
                left=left,
            )
        )

    def _calls_left(self) -> float:
        """Steps that are still to be expected: a stage beyond its usual number is half through."""
        at = STAGES.index(self.stage)
        here = self._calls[self.stage]
        usual = USUAL.get(self.stage, 0)
        left = max(usual - here, 0.3 * here) if usual and not self.over() else 0.0
        return left + sum(USUAL.get(s, 0) for s in STAGES[at + 1 :])


#: That of this thread and of those that work for it; a watch that nobody looks at elsewhere.
_current: ContextVar[Watch | None] = ContextVar("watch", default=None)
_idle = Watch()


def current() -> Watch:
    """The watch of what runs."""
    return _current.get() or _idle


@contextmanager
def watching(watch: Watch) -> Iterator[Watch]:
    """Make a watch that of what runs within."""
    token = _current.set(watch)
    try:
        yield watch
    finally:
        _current.reset(token)
