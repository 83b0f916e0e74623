"""Effects that experiments show and separate, and the tests of parts that would help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from feltmb.fit.model import VARIABILITY
from feltmb.gap.advise import linked_groups
from feltmb.gap.criteria import CONFUSED, WORTH_TELLING
from feltmb.gap.information import Knowledge
from feltmb.gap.measured import no_test_of
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
    """Probability of this confusion at its scale [1]."""
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
    """A test of one part that separates its effect from all others.

    With a magnitude m and a standard deviation s of the test, the expected log evidence for the
    effect is at least (m/s)^2 / 2, whatever the records show. The probability of confusion is then
    at most Phi(-m / (2 s)). If the effect changes the same number as a parameter, the square of its
    tolerance is added to s^2.
    """

    effect: str
    measured: str
    """What the test measures: the effect, or the parameter with the same number."""
    known_to: float
    """Standard deviation that the test must have, so that this probability is at most one in ten
    [``unit``]."""
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
    names = [t.name for t in before.candidates]
    was, then = before.confusion(), after.confusion()
    out = []
    shown = [{n for n, c in zip(names, x[:, -1], strict=True) if c < CONFUSED} for x in (was, then)]
    if shown[1] - shown[0]:
        count = len(set(names))
        out.append(
            f"detects {len(shown[1])} of {count} effects at their expected magnitude "
            f"({len(shown[0])} before)"
        )
    # Only a detectable effect can be confused with another one.
    fall = np.where(_same(names), 0.0, was[:, :-1] - then[:, :-1])
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
    confusion = after.confusion()
    names = [t.name for t in before.candidates]
    rows: dict[str, Visible] = {}
    for i, t in enumerate(before.candidates):
        row = confusion[i, :-1].copy()
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
            hidden="" if math.isfinite(last[i]) else _hidden(everything, i),
        )
    return tuple(sorted(rows.values(), key=lambda r: (-r.belief, -r.right, r.effect)))


def helpful_parts(knowledge: Knowledge) -> tuple[HelpfulPart, ...]:
    """Parameters whose tolerances limit the detection of effects, the most useful ones first."""
    weights = knowledge.belief.over(knowledge.candidates)
    right, smallest = knowledge.beliefs(), knowledge.smallest()
    found: dict[str, tuple[float, HelpfulPart]] = {}
    for i, t in enumerate(knowledge.candidates):
        helpful = knowledge.helpful_part(i)
        if helpful is None or not helpful[2] < 0.9 * smallest[i]:
            continue
        p = knowledge.model.parameters[helpful[0]]
        if p.component == VARIABILITY:
            continue
        gain = float(weights[i] * (1.0 - right[i]) * math.log(smallest[i] / helpful[2]))
        if not math.isfinite(gain):
            gain = float(weights[i])
        if t.name in found and found[t.name][0] >= gain:
            continue
        found[t.name] = (
            gain,
            HelpfulPart(
                effect=t.name,
                parameter=p.name,
                known_to=helpful[1],
                unit=p.unit,
                tolerance=p.sd,
                smallest_before=float(smallest[i]),
                smallest=helpful[2],
                effect_unit=t.effect.unit,
            ),
        )
    order = sorted(found.values(), key=lambda x: (-x[0], x[1].effect))
    return tuple(h for _, h in order[:HELPFUL_PARTS])


def inseparable(knowledge: Knowledge) -> tuple[tuple[str, ...], ...]:
    """Groups of detectable effects that no allowed experiment separates."""
    names = [t.name for t in knowledge.candidates]
    chance = knowledge.confusion()
    shown = chance[:, -1] < CONFUSED
    linked = _same(names) | ((chance[:, :-1] > CONFUSED) & np.outer(shown, shown))
    return tuple(sorted(linked_groups(names, linked)))


def _same(names: Sequence[str]) -> NDArray[np.bool_]:
    """Whether two candidates are shapes of one effect, (k, k)."""
    return np.array([[a == b for b in names] for a in names], dtype=bool)


def decisive_tests(
    knowledge: Knowledge, groups: Sequence[Sequence[str]]
) -> tuple[DecisiveTest, ...]:
    """Tests of parts that separate an effect from the others of its group.

    If two effects of a group change the same number, a test of this number does not separate them.
    """
    same = {t.name: t.effect.tolerance_parameter or t.name for t in knowledge.candidates}
    out = []
    for group in groups:
        numbers = [same[n] for n in group]
        alone = [n for n in group if numbers.count(same[n]) == 1]
        out += [_decisive(knowledge, n) for n in alone]
    return tuple(test for test in out if test is not None)


def _decisive(knowledge: Knowledge, name: str) -> DecisiveTest | None:
    """The test of the part of an effect; None: no test can decide."""
    effects = {t.name: t.effect for t in knowledge.candidates}
    parameters = {p.name: p for p in knowledge.model.parameters}
    effect = effects[name]
    size = knowledge.belief.magnitudes.get(name, effect.scale)
    known_to = size / (2.0 * float(norm.isf(CONFUSED)))
    same = parameters.get(effect.tolerance_parameter)
    measured, unit = name, effect.unit
    if same is not None:
        known_to *= abs(effect.tolerance_ratio)
        known_to = math.sqrt(max(known_to**2 - same.sd**2, 0.0))
        measured, unit = same.name, same.unit
    if not known_to > 0.0 or no_test_of(measured, knowledge.model, list(effects.values())):
        return None
    return DecisiveTest(effect=name, measured=measured, known_to=known_to, unit=unit)
