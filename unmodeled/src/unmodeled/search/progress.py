"""Progress of a diagnosis: the stage, the share that is done, and the time that is left.

How many sets a search will fit is not known before. Each stage ends at a typical share of the whole
time, whatever the model: the longer a diagnosis took so far, the longer it will take.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

#: Typical share of the time of a diagnosis at the end of each stage [1].
ENDS = {
    "prepare": 0.2,
    "fit": 0.3,
    "search": 0.6,
    "exchange": 0.65,
    "held_out": 0.95,
    "judge": 0.98,
    "locate": 1.0,
}


class Stop(Exception):
    """Ends a search: its answer is that of the fits so far.

    The function that is told the progress may raise it, from any thread.

    Parameters
    ----------
    fits
        The fits as far as they are, one for each set; None: there is none.
    """

    def __init__(self, fits: Sequence[Any] = ()) -> None:
        super().__init__()
        self.fits = fits


def interrupted(reason: BaseException | None) -> bool:
    """Whether Ctrl-C ended the search, also if fits that proceed together passed it on."""
    while isinstance(reason, Stop):
        reason = reason.__cause__
    return isinstance(reason, KeyboardInterrupt)


class Limit:
    """A time after which no step begins, and before which none begins that would end after it.

    ``end`` is a time of ``clock`` [s]; ``step`` is called before each step; ``most`` is a number of
    steps, None: any. A number ends a search at the same fit on a slow and on a fast machine.
    """

    def __init__(
        self,
        end: float,
        step: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
        most: int | None = None,
    ) -> None:
        self._end, self._step, self._clock = end, step, clock
        self._most, self.steps = math.inf if most is None else most, 0
        self._last, self._longest = clock(), 0.0

    def __call__(self) -> None:
        """The next step begins; it may take as long as the longest one before.

        Raises
        ------
        Stop
            It would end after the limit.
        """
        self._step()
        if self.steps >= self._most:
            raise Stop
        self.steps += 1
        now = self._clock()
        self._longest, self._last = max(self._longest, now - self._last), now
        if now + self._longest > self._end:
            raise Stop


@dataclass(frozen=True)
class Progress:
    """State of a diagnosis."""

    stage: str
    """"prepare", "fit", "search", "exchange", "held_out", "judge", "locate" or "done"."""
    share: float
    """Share of the work that is done [1]; it never decreases."""
    left: float
    """Estimated time that is left [s]; NaN: not known yet."""
    elapsed: float
    """[s]"""
    needed: float = math.nan
    """Estimated time of the whole diagnosis if there were no limit [s]; NaN: not known yet."""


class Meter:
    """Turns stages and steps into progress.

    Parameters
    ----------
    tell
        Is called with the progress at each stage and step; None: nothing is called. If it raises
        :class:`Stop`, the next step raises it.
    seconds
        Limit of time of all fits [s].
    clock
        Time [s].
    """

    def __init__(
        self,
        tell: Callable[[Progress], None] | None,
        seconds: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tell, self._seconds, self._clock = tell, seconds, clock
        self._began = self._stage_began = clock()
        self._stage = "prepare"
        self._share = self._since = 0.0
        self._stopped = False

    def stage(self, name: str) -> None:
        """A stage begins, or another round of it."""
        now = self._clock()
        if name != self._stage:
            self._share = max(self._state(now).share, ENDS[self._stage])
        self._since = self._share
        self._stage_began, self._stage = now, name
        self._report(now)

    def step(self) -> None:
        """The fits that proceed together begin their next step.

        Raises
        ------
        Stop
            The function that is told the progress has raised it.
        """
        self._report(self._clock())
        if self._stopped:
            raise Stop

    def _report(self, now: float) -> None:
        if self._tell is None or self._stopped:
            return
        try:
            self._tell(self._state(now))
        except Stop:  # there may be no fit yet, or the results are being computed
            self._stopped = True

    def _state(self, now: float) -> Progress:
        elapsed = now - self._began
        if self._stage == "done":
            return Progress("done", 1.0, 0.0, elapsed)
        if self._stage == "prepare":
            return Progress("prepare", 0.0, math.nan, elapsed)
        # A stage comes nearer to its end as long as it takes: to half of it in its usual time.
        since, spent = self._since, now - self._stage_began
        usual = (self._stage_began - self._began) * (ENDS[self._stage] / since - 1.0)
        part = spent / (spent + usual) if usual > 0.0 else 0.0
        self._share = max(self._share, since + (ENDS[self._stage] - since) * part)
        needed = elapsed / self._share
        left = min(needed - elapsed, self._limit(now))
        return Progress(self._stage, self._share, left, elapsed, needed)

    @property
    def needed(self) -> float:
        """Estimated time of the whole diagnosis if there were no limit [s]; NaN: not known yet."""
        return self._state(self._clock()).needed

    def _limit(self, now: float) -> float:
        """Time until the limit, and typical time after it [s]."""
        after = self._seconds * (1.0 / ENDS["held_out"] - 1.0)
        return max(self._began + self._seconds - now, 0.0) + after
