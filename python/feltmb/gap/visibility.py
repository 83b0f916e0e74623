"""Effects that experiments show and separate, and the tests of parts that would help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from feltmb.fit.limits import no_test_of
from feltmb.gap.confusion import confused_groups, confusion_if_detected
from feltmb.gap.criteria import BEST_PART, CONFUSED, WORTH_TELLING
from feltmb.gap.information import Knowledge
from feltmb.units import readable_unit, unit_suffix

__all__ = [
    "DecisiveTest",
    "HelpfulPart",
    "Visible",
    "decisive_tests",
    "helpful_parts",
    "inseparable",
    "reasons",
    "visible",
]

#: Largest numbers of reasons for an experiment, and of helpful parts of a plan.
REASONS, HELPFUL_PARTS = 3, 8


@dataclass(frozen=True, kw_only=True)
class Visible:
    """One effect, before and after the whole plan."""

    effect: str
    unit: str
    belief: float
    """Present probability of the effect [1]."""
    smallest_before: float
    """Smallest detectable magnitude now [unit]; inf: not detectable."""
    smallest: float
    """Smallest detectable magnitude after the plan [unit]; inf: not detectable."""
    right: float
    """Expected probability of the effect after the plan, if it were the cause [1]."""
    pair: float
    """Expected probability of the effect and the most similar candidate together, after the plan
    [1]."""
    rival: str
    """Effect that it would most often be confused with after the plan; "": none."""
    confusion: float
    """Probability of this confusion, at the larger of its expected and its smallest detectable
    magnitude [1]."""
    surviving: float
    """Share of its signature (amplitude) that parameters cannot imitate, after the plan [1]."""
    hidden: str = ""
    """Why the plan shows it at no magnitude, as text; "": it does."""


@dataclass(frozen=True, kw_only=True)
class HelpfulPart:
    """A parameter whose separate measurement would make an effect detectable."""

    effect: str
    parameter: str
    known_to: float
    """Standard deviation that the measurement must have [``unit``]."""
    unit: str
    tolerance: float
    """Its present standard deviation [``unit``]."""
    smallest_before: float
    """Smallest detectable magnitude of the effect before the measurement [``effect_unit``]."""
    smallest: float
    effect_unit: str

    @property
    def text(self) -> str:
        """Description in a sentence."""
        now = _amount(self.smallest_before, self.effect_unit)
        if math.isinf(self.smallest_before):
            now = "at no magnitude"
        return (
            f"{self.parameter} known to {_accuracy(self.known_to, self.unit)}: {self.effect} is "
            f"detectable from {_amount(self.smallest, self.effect_unit)} (now {now})"
        )


@dataclass(frozen=True, kw_only=True)
class DecisiveTest:
    """A test of one part that separates its effect from all others of its group."""

    effect: str
    measured: str
    """What the test measures: the effect, or the parameter with the same number."""
    known_to: float
    """Standard deviation that the test must have, so that the probability of confusion is at most
    one in ten with all tested experiments, whichever effect is the cause [``unit``]."""
    unit: str

    @property
    def text(self) -> str:
        """The effect and the standard deviation."""
        return f"{self.measured} to {_accuracy(self.known_to, self.unit)}"


def _accuracy(sd: float, unit: str) -> str:
    """A standard deviation; a share in percent."""
    return f"{sd:.1%}" if unit == "1" else _amount(sd, unit)


def _amount(value: float, unit: str) -> str:
    """A value in the unit in which people read it."""
    factor, shown = readable_unit(value, unit)
    return f"{factor * value:.3g}{unit_suffix(shown)}"


def reasons(before: Knowledge, after: Knowledge) -> tuple[str, ...]:
    """Reasons: number of detectable effects, and separated pairs weighted by probability."""
    weights = before.belief.over(before.candidates)
    names = np.array([t.name for t in before.candidates])
    was, then = before.confusion(), after.confusion()
    out = []
    shown = [set(names[k.detected()]) for k in (before, after)]
    if shown[1] - shown[0]:
        count = len(set(names))
        out.append(
            f"detects {len(shown[1])} of {count} effects at their expected magnitude "
            f"({len(shown[0])} before)"
        )
    fall = np.where(names[:, None] == names, 0.0, was - then)
    worth = fall * np.minimum(weights[:, None], weights[None, :])
    reported: set[str] = set()
    for flat in np.argsort(-worth, axis=None, kind="stable"):
        a, b = (int(i) for i in np.unravel_index(int(flat), worth.shape))
        if worth[a, b] <= 0.0 or len(out) >= REASONS:
            break
        if fall[a, b] < WORTH_TELLING or names[a] in reported:
            continue
        reported |= {names[a], names[b]}
        out.append(
            f"separates {names[a]} from {names[b]}: probability of confusion {was[a, b]:.0%} "
            f"-> {then[a, b]:.0%}"
        )
    return tuple(out)


def _hidden(all_: Knowledge, at: int) -> str:
    """Why no experiment of a plan shows a candidate; all tested experiments are in ``all_``."""
    smallest = float(all_.smallest()[at])
    candidate = all_.candidates[at]
    if math.isfinite(smallest):
        unit = unit_suffix(candidate.effect.unit)
        return (
            "no experiment of the plan shows it; all tested experiments together show it from "
            f"{smallest:.2g}{unit}"
        )
    alike = all_.imitators(at)
    if not alike:
        return "no measured output changes with it in any tested experiment"
    return (
        f"a change of {' and '.join(alike)} looks the same in all tested experiments; measure "
        f"{'this parameter' if len(alike) == 1 else 'these parameters'} separately"
    )


def visible(before: Knowledge, after: Knowledge, everything: Knowledge) -> tuple[Visible, ...]:
    """Each effect before and after a plan, the most probable first.

    Parameters
    ----------
    before, after
        Knowledge without and with the experiments of the plan.
    everything
        Knowledge with all experiments that were evaluated.
    """
    weights = before.belief.over(before.candidates)
    first, last = before.smallest(), after.smallest()
    right, pair = after.beliefs(), after.beliefs(2)
    confusion = confusion_if_detected(after.gram, after.expected())
    surviving = after.surviving()
    names = [t.name for t in before.candidates]
    rows: dict[str, Visible] = {}
    for i, t in enumerate(before.candidates):
        row = confusion[i].copy()
        row[[n == t.name for n in names]] = 0.0
        rival = int(np.argmax(row))
        known = rows.get(t.name)
        if known is not None and known.smallest <= last[i]:
            continue
        rows[t.name] = Visible(
            effect=t.name,
            unit=t.effect.unit,
            belief=float(sum(w for w, n in zip(weights, names, strict=True) if n == t.name)),
            smallest_before=float(first[i]),
            smallest=float(last[i]),
            right=float(right[i]),
            pair=float(pair[i]),
            rival=names[rival] if row[rival] > 0.0 else "",
            confusion=float(row[rival]),
            surviving=float(surviving[i]),
            hidden="" if math.isfinite(last[i]) else _hidden(everything, i),
        )
    return tuple(sorted(rows.values(), key=lambda r: (-r.belief, -r.right, r.effect)))


def helpful_parts(knowledge: Knowledge) -> tuple[HelpfulPart, ...]:
    """Parameters whose tolerances limit the detection of effects, the most useful ones first.

    A test of a part is assumed to halve the standard deviation of its parameter, because that gives
    four fifths of the improvement by exact knowledge. It reaches at least a tenth of the tolerance.
    """
    weights = knowledge.belief.over(knowledge.candidates)
    right, smallest = knowledge.beliefs(), knowledge.smallest()
    found: dict[str, tuple[float, HelpfulPart]] = {}
    for p, spread in zip(knowledge.model.parameters, knowledge.spread(), strict=True):
        known_to = max(0.5 * spread, BEST_PART * p.sd if math.isfinite(p.sd) else 0.0)
        if not 0.0 < known_to < p.sd or not p.of_the_machine:
            continue
        then = knowledge.plus(knowledge.part(p.name, known_to)).smallest()
        for i in np.flatnonzero(then < 0.9 * smallest):
            t = knowledge.candidates[i]
            gain = float(weights[i] * (1.0 - right[i]) * math.log(smallest[i] / then[i]))
            if not math.isfinite(gain):
                gain = float(weights[i])
            known = found.get(t.name)
            if known is not None and (known[0], -known[1].smallest) >= (gain, -then[i]):
                continue
            found[t.name] = (
                gain,
                HelpfulPart(
                    effect=t.name,
                    parameter=p.name,
                    known_to=known_to,
                    unit=p.unit,
                    tolerance=p.sd,
                    smallest_before=float(smallest[i]),
                    smallest=float(then[i]),
                    effect_unit=t.effect.unit,
                ),
            )
    order = sorted(found.values(), key=lambda x: (-x[0], x[1].effect))
    return tuple(h for _, h in order[:HELPFUL_PARTS])


def inseparable(knowledge: Knowledge) -> tuple[tuple[str, ...], ...]:
    """Groups of effects, detectable at their expected magnitude, that no experiment separates."""
    shown = knowledge.detected()
    chance = np.where(np.outer(shown, shown), knowledge.confusion(), 0.0)
    return confused_groups([t.name for t in knowledge.candidates], chance)


def decisive_tests(
    knowledge: Knowledge, groups: Sequence[Sequence[str]]
) -> tuple[DecisiveTest, ...]:
    """Tests of parts that separate an effect from the others of its group, beside ``knowledge``.

    If two effects of a group change the same number, a test of this number does not separate them.
    """
    found = (_decisive(knowledge, n, group) for group in groups for n in group)
    return tuple(test for test in found if test is not None)


def _decisive(knowledge: Knowledge, name: str, group: Sequence[str]) -> DecisiveTest | None:
    """The test of the part of an effect; None: no test can decide."""
    effects = {t.name: t.effect for t in knowledge.candidates}
    parameters = {p.name: p for p in knowledge.model.parameters}
    effect = effects[name]
    same = parameters.get(effect.tolerance_parameter)
    measured, unit = (name, effect.unit) if same is None else (same.name, same.unit)
    if no_test_of(measured, knowledge.model, list(effects.values())):
        return None
    alone = knowledge.among(group)
    own = np.array([t.name == name for t in alone.candidates])

    def excess(log_sd: float) -> float:
        chance = alone.plus(alone.part(measured, math.exp(log_sd))).confusion()
        return float(max(np.max(chance[own][:, ~own]), np.max(chance[~own][:, own]))) - CONFUSED

    size = effect.scale if same is None else effect.scale * abs(effect.tolerance_ratio)
    low, high = math.log(1e-3 * size), math.log(1e3 * size)
    if excess(low) > 0.0 or excess(high) < 0.0:
        return None
    return DecisiveTest(
        effect=name,
        measured=measured,
        known_to=math.exp(brentq(excess, low, high, xtol=1e-5)),
        unit=unit,
    )
