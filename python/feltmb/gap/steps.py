"""Recommended next steps of a report, apart from experiments that separate rivals."""

from __future__ import annotations

from collections.abc import Sequence

from feltmb.fit.model import OF_RECORDS, Effect, Model
from feltmb.fit.solve import Interval
from feltmb.gap.criteria import MOVED
from feltmb.gap.findings import (
    EXPLAINED,
    Advice,
    AsItIs,
    Calibrated,
    Closest,
    ComponentRow,
    Ranked,
    Verdict,
)

__all__ = ["next_steps"]


def next_steps(
    verdict: Verdict,
    as_it_is: Sequence[AsItIs],
    calibrated: Sequence[Calibrated],
    named: Sequence[Ranked],
    one_of: Sequence[Ranked],
    closest: Closest | None,
    components: Sequence[ComponentRow],
    intervals: Sequence[Interval],
    model: Model,
    tested: Sequence[Effect],
) -> tuple[Advice, ...]:
    """Steps in the order of their expected benefit."""
    texts = [
        f"Check unit, sign and column of {row.channel}: a constant fits its records better "
        "than the model."
        for row in as_it_is
        if row.worse_than_constant and verdict not in EXPLAINED
    ]
    far = [row.part for row in calibrated if row.beyond]
    if len(far) > 1:
        texts.append(
            "Make sure that the model is of the machine that was measured, with its parts and its "
            f"regulation of that day; look at {', '.join(f[0].lower() + f[1:] for f in far[:4])} "
            "first."
        )
    texts += [
        f"{i.name} is at its limit {i.value:.4g}: widen the limit, or find the reason."
        for i in intervals
        if i.at_limit and i.value != i.prior  # a part without friction was measured as such
    ]
    texts += [
        f"Measure it separately: {row.text[0].lower()}{row.text[1:]}."
        for row in calibrated
        if row.sure and row.prior_deviations is not None and abs(row.prior_deviations) > MOVED
    ][:3]
    texts += [f"{r.effect}: {r.remedy or _remedy(r)}" for r in named]
    # A direct test decides between effects that no record can separate.
    texts += [f"If it is {r.effect}: {r.remedy}" for r in one_of if r.remedy]
    if verdict in (Verdict.UNKNOWN, Verdict.NAMED_RESIDUAL):
        strong = [c for c in components if c.significant]
        places = {r.component for r in (*named, *one_of)}
        if strong and strong[0].component not in places:
            texts.append(
                f"Look at {strong[0].component}, or add an effect that acts there. "
                f"{strong[0].text}."
            )
        if closest is not None:
            texts.append(
                f"Give more held-out records that excite {' and '.join(closest.effects)}: it is "
                "closest."
            )
        if not any(e.kind in OF_RECORDS for e in tested):
            texts.append(
                "No error of a sensor or an input was tested: add for_sensor and for_input of "
                "feltmb.gap.library."
            )
        fixed = [p.name for p in model.parameters if p.sd == 0.0]
        if fixed:
            texts.append(
                f"{', '.join(fixed[:6])}{' and others' if len(fixed) > 6 else ''}: fixed (sd = 0), "
                "so a wrong value cannot be found. Give a standard deviation."
            )
        texts.append(
            "If the residual is small enough for you, set good_enough (--good-enough), which "
            "is added to the noise."
        )
    return tuple(Advice(text=t) for t in texts)


def _remedy(effect: Ranked) -> str:
    """What to do about a named effect that states no remedy."""
    if effect.kind in OF_RECORDS:
        return "correct the records, or add it to the model"
    return "add it to the model, or remove its cause from the machine"
