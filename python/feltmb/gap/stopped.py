"""Results of a stopped diagnosis: what was not tried, and which statements remain valid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from feltmb.fit.model import Effect
from feltmb.fit.watch import FIT, Watch
from feltmb.gap.acceptance import Accepted
from feltmb.gap.decide import Decision
from feltmb.gap.findings import NotTested, Verdict
from feltmb.gap.search import Search
from feltmb.gap.sizes import Sizes

__all__ = ["cut_short", "left_out"]


def left_out(found: Search, effects: Sequence[Effect]) -> tuple[NotTested, ...]:
    """Effects that have a score but are in no fitted set."""
    fitted = {name for c in found.sets for name in c.names} | {name for name, _ in found.failed}
    why = "was scored to first order, but not refitted: the search was stopped before"
    return tuple(NotTested(name=e.name, why=why) for e in effects if e.name not in fitted)


def cut_short(
    decision: Decision,
    watch: Watch,
    accepted: Accepted,
    found: Search,
    skipped: Sequence[NotTested],
    effects: int,
    sizes: Sizes,
) -> Decision:
    """The decision, limited to what holds after the stop.

    An unfinished fit of the model proves nothing, nor does an unfinished proof. A named effect is
    kept only if no untested effect could replace it.
    """
    begin = f"Stopped in the {watch.stopped_in} ({watch.why})"
    if watch.stopped_in == FIT and not found.model_fit.converged:
        ratio = found.model_fit.chi2 / found.model_fit.dof
        text = (
            f"{begin}: the fit of the model is not finished, so a gap cannot be assessed. The best "
            f"sum of squares so far is {ratio:.3g} of its expectation."
        )
        return replace(
            decision, verdict=Verdict.TOO_WEAK, statement=text, named=(), one_of=(), confidence=0.0
        )
    if not accepted.complete:
        text = f"{begin}: the proof on held-out records is not complete, so nothing is named."
        if found.best is not None:
            nearest = " and ".join(map(sizes.text, found.best.names))
            text += f" {nearest} would explain the fitted records best so far."
        return replace(
            decision, verdict=Verdict.TOO_WEAK, statement=text, named=(), one_of=(), confidence=0.0
        )
    if skipped:
        begin += f"; {len(skipped)} of {effects} effects were not refitted"
    rivals = [n for n in found.skipped if n not in decision.named]
    if decision.named and rivals:
        every = (*decision.named, *(n for n in decision.one_of if n not in rivals), *rivals)
        named = ", ".join(map(sizes.text, decision.named))
        text = (
            f"{begin}. Best so far: {named}, which held-out records do not refuse; "
            f"{', '.join(rivals)} were not yet tested as alternatives."
        )
        return replace(
            decision, verdict=Verdict.ONE_OF, statement=text, named=(), one_of=tuple(every)
        )
    return replace(decision, statement=f"{begin}. {decision.statement}")
