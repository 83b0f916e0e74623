"""Results of a stopped diagnosis: what was not tried, and which statements remain valid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from feltmb.fit.model import Effect
from feltmb.fit.watch import FIT, REPORT, SEARCH, Watch
from feltmb.gap.acceptance import Accepted
from feltmb.gap.decide import Decision, first_scored
from feltmb.gap.findings import EXPLAINED, Advice, NotTested, Verdict, listed
from feltmb.gap.search import Search
from feltmb.gap.sizes import Sizes

__all__ = ["completion", "cut_short", "left_out"]


def left_out(found: Search, effects: Sequence[Effect]) -> tuple[NotTested, ...]:
    """Effects that are in no fitted set."""
    fitted = {name for c in found.sets for name in c.names} | {name for name, _ in found.failed}
    scored = {t.effect.name for t in found.scores.candidates}

    def why(name: str) -> str:
        done = "was scored to first order, but not refitted: " if name in scored else ""
        return f"{done}the search was stopped before"

    return tuple(NotTested(name=e.name, why=why(e.name)) for e in effects if e.name not in fitted)


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

    An unfinished fit of the model proves nothing, nor does an unfinished proof. If no effect is
    proven, an unfinished search may have missed it. A named effect is kept only if no untested
    effect could replace it.
    """
    begin = f"Stopped in the {watch.stopped_in} ({watch.why})"
    untested = f"{len(skipped)} of {effects} effects were not refitted"
    searching = watch.stopped_in in (FIT, SEARCH)
    left, seen = "", ""
    if watch.stopped_in == FIT and not found.model_fit.converged and not found.sets:
        left, seen = "whether there is a gap cannot be told yet", _so_far(found, sizes)
    elif not accepted.complete:
        left = "the proof on held-out records is not complete, so nothing is named"
        seen = _so_far(found, sizes)
    elif searching and not decision.named and decision.verdict not in EXPLAINED:
        left, seen = "the search for a cause is not complete", decision.statement
    if left:
        step = f" The present step was: {watch.stopped_at}." if watch.stopped_at else ""
        untested = f" {untested}." if skipped else ""
        return replace(
            decision,
            verdict=Verdict.NOT_COMPLETE,
            statement=f"{begin}: {left}.{step}{untested} {seen}",
            named=(),
            one_of=(),
            confidence=math.nan,
        )
    if skipped:
        begin += f"; {untested}"
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


def completion(watch: Watch, *, kept: bool) -> tuple[Advice, ...]:
    """How to complete a stopped diagnosis; ``kept``: its finished fits are in a folder."""
    if watch.stopped_in in ("", REPORT):
        return ()
    folder = "output folder (-o FOLDER --force, in Python Options(resume=FOLDER))"
    text = f"Start the diagnosis again with the same {folder}: it continues from its finished fits."
    if not kept:
        text = f"Start the diagnosis again. With an {folder} finished fits are kept."
    return (Advice(text=text),)


def _so_far(found: Search, sizes: Sizes) -> str:
    """What the fitted records suggest before the proof."""
    fit = found.model_fit
    but = "" if fit.converged else ", which has not converged,"
    ratio = f"{fit.chi2 / fit.dof:.3g} times the sum of squares of noise"
    text = f"The fit of the model{but} leaves {ratio}."
    if found.best is not None:
        nearest = listed(map(sizes.text, found.best.names))
        return f"{text} {nearest} would explain the fitted records best so far."
    return text + first_scored(found.scores)
