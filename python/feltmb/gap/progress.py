"""Progress of a diagnosis: the stage, the share that is done, and the time that is left.

How many sets a search will fit is not known before. The meter counts the joint steps of the fits,
measures what a step costs, and assumes typical numbers for the rest: steps in a round, rounds that
follow, and the comparison with held-out records.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Meter", "Progress", "Stop"]

#: Typical number of joint steps of the fits of a round, and of the comparison with held-out
#: records.
STEPS, STEPS_AFTER = 9.0, 24.0
#: Cost of such a step after the search, in steps of the fit of the model alone [1].
COST_AFTER = 2.5
#: Expected further work in durations of a round: after the first round, after later ones, and of
#: the exchange; and of the comparison with held-out records [1].
FIRST, LATER, EXCHANGE, AFTER = 0.35, 0.9, 0.5, 0.45
#: Expected growth of the duration from one round to the next, because sets become larger [1].
GROWTH = 1.25
#: Share of the expected duration of a stage that is left when it takes longer than expected [1].
LEAST = 0.2


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


class Meter:
    """Turns stages and steps into progress.

    Parameters
    ----------
    tell
        Is called with the progress at each stage and step; None: nothing is called. If it raises
        :class:`Stop`, the next step raises it.
    seconds
        Limit of time of the search [s].
    tries
        Number of sets that are fitted together.
    clock
        Time [s].
    """

    def __init__(
        self,
        tell: Callable[[Progress], None] | None,
        seconds: float,
        tries: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tell, self._seconds, self._tries, self._clock = tell, seconds, tries, clock
        self._began = self._stage_began = clock()
        self._search_began = math.nan
        self._stage, self._times = "prepare", [self._began]
        self._rounds = 0
        self._round = math.nan  # expected duration of a round
        self._step = math.nan  # duration of a step of the fit of the model alone
        self._share = 0.0
        self._stopped = False

    def stage(self, name: str, share: float = 0.0) -> None:
        """A stage begins, or another round of it.

        Parameters
        ----------
        name
            Name of the stage.
        share
            Share of the stage that is done [1]; it is not used.
        """
        del share
        now = self._clock()
        spent, steps = now - self._stage_began, len(self._times) - 1
        if self._stage == "fit":
            self._step = spent / max(steps, 1)
        if self._stage == "search":
            self._round = GROWTH * spent if name == "search" else self._length_of_round(now)
        if name == "search":
            self._rounds += 1
            if self._rounds == 1:
                self._search_began = now
        self._stage, self._stage_began, self._times = name, now, [now]
        self._report(now)

    def step(self) -> None:
        """The fits that proceed together begin their next step.

        Raises
        ------
        Stop
            The function that is told the progress has raised it.
        """
        now = self._clock()
        self._times.append(now)
        self._report(now)
        if self._stopped:
            raise Stop

    @property
    def progress(self) -> Progress:
        """The present state."""
        return self._state(self._clock())

    def _report(self, now: float) -> None:
        if self._tell is None or self._stopped:
            return
        try:
            self._tell(self._state(now))
        except Stop:  # there may be no fit yet, or the results are being computed
            self._stopped = True

    def _state(self, now: float) -> Progress:
        left = 0.0 if self._stage == "done" else self._left(now)
        elapsed = now - self._began
        if math.isfinite(left) and elapsed + left > 0.0:
            self._share = max(self._share, elapsed / (elapsed + left))
        return Progress(self._stage, self._share, left, elapsed)

    def _length_of_round(self, now: float) -> float:
        """Expected duration of the present round: its scores, and typical number of steps."""
        if math.isfinite(self._round):
            return max(self._round, now - self._stage_began)
        steps = len(self._times) - 1
        if steps < 2:  # only the fit of the model alone is known
            return max(STEPS * self._tries * self._step, now - self._stage_began)
        scores = self._times[1] - self._times[0]
        each = (now - self._times[1]) / (steps - 1)
        return scores + max(STEPS, steps - 1.0) * each

    def _after(self, length: float) -> float:
        """Expected duration of what follows the search [s]: the mean of two estimates."""
        return math.sqrt(STEPS_AFTER * COST_AFTER * self._step * AFTER * length)

    def _left(self, now: float) -> float:
        """Expected time that is left [s]."""
        spent, steps = now - self._stage_began, len(self._times) - 1
        if self._stage == "search":
            length = self._length_of_round(now)
            further = (FIRST if self._rounds == 1 else LATER) * length
            left = max(length - spent, LEAST * length) + further
            limit = max(self._search_began + self._seconds - now, 0.0)
            return min(left, limit) + self._after(length)
        if self._stage == "exchange":
            return max(EXCHANGE * self._round - spent, LEAST * self._round) + self._after(
                self._round
            )
        if self._stage == "held_out":
            each = spent / steps if steps > 2 else self._after(self._round) / STEPS_AFTER
            return max(STEPS_AFTER - steps, LEAST * STEPS_AFTER) * each
        return 0.1 * self._after(self._round) if self._stage in ("judge", "locate") else math.nan
