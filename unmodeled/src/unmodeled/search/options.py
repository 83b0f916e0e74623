"""Options of a diagnosis: what the user decides, and a few numbers of the search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

#: Share of the motion that does not matter, unless the user states it.
GOOD_ENOUGH = 0.01

Tolerances = Literal["auto", "drawn", "kept"]


@checked
@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a diagnosis. The defaults are suitable for most cases.

    Examples
    --------
    Ten seconds, and what leaves less than 0.1 mm of x does not matter:

    >>> from unmodeled import Options
    >>> options = Options(seconds=10.0, good_enough={"x": 1e-4})
    >>> options.credibility
    0.9
    """

    credibility: float = 0.9
    """Posterior probability that a named effect, or a class of effects, needs, compared with the
    other causes of the library [1]."""
    good_enough: Mapping[str, float] = field(default_factory=dict)
    """Residual that does not matter, by output or by unit (``{"m": 2e-4}``) [SI]; for others, 1 %
    of the motion, or of input minus output where a servo leads the output to an input."""
    prior: float = 0.5
    """Prior probability that the model lacks an effect of the list [1]."""
    seconds: float = 120.0
    """Limit of time [s]; the best sets of effects until then are the answer."""
    rounds: int | None = None
    """Limit of the rounds of simulations [1]: all fits that proceed together simulate the records
    once in each. A search that it ends has the same answer on a slow and on a fast machine; None:
    ``seconds`` alone is a limit."""
    max_effects: int = 4
    """Largest number of effects in a set [1]."""
    then: Sequence[str] = ()
    """Names of the records after a change of the machine: what acts in some records acts in these;
    (): in one record, the first or the last ones."""
    tries: int = 9
    """Number of effects that are fitted together with a set in each round, and of pairs [1]."""

    tolerances: Tolerances = "auto"
    """What the standard deviation of a parameter says: ``"drawn"``: all parameters deviate by
    about theirs, as those of a new machine; ``"kept"``: few do, as after a repair; ``"auto"``: the
    records decide."""

    def matters(self, name: str, unit: str, compared: float) -> float:
        """Residual of an output from which on it matters [unit of the output].

        Parameters
        ----------
        name, unit
            The output and its unit; ``good_enough`` may state either.
        compared
            Size of the motion whose share decides otherwise [unit of the output].
        """
        return self.good_enough.get(name, self.good_enough.get(unit, GOOD_ENOUGH * compared))

    def __post_init__(self) -> None:
        faults = []
        if not 0.5 <= self.credibility < 1.0:
            faults.append(f"credibility = {self.credibility!r}, expected in [0.5, 1)")
        if not 0.0 < self.prior < 1.0:
            faults.append(f"prior = {self.prior!r}, expected in (0, 1)")
        if not self.seconds > 0.0:
            faults.append(f"seconds = {self.seconds!r}, expected > 0")
        if self.rounds is not None and self.rounds < 1:
            faults.append(f"rounds = {self.rounds!r}, expected from 1 on")
        if not 1 <= self.max_effects <= 12:
            faults.append(f"max_effects = {self.max_effects!r}, expected from 1 to 12")
        if not 1 <= self.tries <= 20:
            faults.append(f"tries = {self.tries!r}, expected from 1 to 20")
        for name, value in self.good_enough.items():
            if not 0.0 < value < math.inf:
                faults.append(f"good_enough of {name} = {value!r}, expected > 0")
        if faults:
            raise InvalidParameter("options: " + "; ".join(faults))
