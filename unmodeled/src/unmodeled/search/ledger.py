"""The ledger: one finding for each candidate, and the rules that mark it.

Rules mark the members of the answer. They never remove one: what is in the set that the answer
shows (:mod:`unmodeled.search.choice`) is told with its mark, and what is not has the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from enum import Enum
from typing import Any

from unmodeled.errors import InvalidParameter


class Mark(Enum):
    """How sure a member of the answer is."""

    NAMED = "named"
    """The records tell it from all listed causes."""
    ONE_OF = "one of"
    """It, or one of its equivalents, which the records do not tell apart from it."""
    SUPPORTED = "supported"
    """Records that were not fitted surely need it, or another law that does the same."""
    SMALL = "small"
    """It takes away less than what matters, is probable, and its interval excludes zero."""
    UNSURE = "unsure"
    """It is a part of the fit, and none of these."""


@dataclass(frozen=True)
class Finding:
    """What is known of one candidate."""

    cause: str
    member: bool = False
    """Whether it is in the set of the answer."""
    left: bool = False
    """Whether it was a member of a probable set, and left it."""
    fitted: bool = False
    """Whether a fitted set contains it."""
    gain: float = math.nan
    """Gain of log evidence to first order, at the fit of the model alone; NaN: not computed."""
    probability: float = 0.0
    """Probability of the sets that contain it [1]."""
    least_probability: float = 0.0
    """The lower one if a discrepancy of the model counts half or twice as many samples [1]."""
    evidence: float = math.nan
    """Log odds of the set of the answer and the set without it."""
    held_out: tuple[float, float, float] | None = None
    """Held-out residual without it over that with it, and its interval [1]; None: not known."""
    better: int = 0
    """Number of held-out records that are predicted better with it."""
    of: int = 0
    """Number of held-out records."""
    predicts: bool = False
    """Whether the held-out records surely need it."""
    refused: bool = False
    """Whether they are surely predicted worse with it."""
    same: float = 1.0
    """Probability that its size is the same in all records, as far as differences matter [1]."""
    at_limit: bool = False
    """Whether its size is at a limit that is none of its law."""
    takes: float = math.nan
    """What it takes away, over what matters [1]."""
    excludes_zero: bool = True
    """Whether its interval excludes zero."""
    together: float = 0.0
    """Probability of the sets that contain it or one of its equivalents [1]."""
    equivalents: tuple[str, ...] = ()
    """Causes that the records do not tell apart from it."""
    stands_for: tuple[str, ...] = ()
    """Members of the answer from which the records do not tell it."""
    complete: bool = True
    """Whether the search tried all that it would add to the best set."""
    credibility: float = 0.9
    """Probability that a name needs [1]."""
    mark: Mark | None = None
    """None: it is not in the answer."""
    codes: tuple[str, ...] = ()
    """Codes of the rules that hold, the one that gave the mark first."""


def from_plain(report: Mapping[str, Any]) -> tuple[Finding, ...]:
    """The findings of a stored report.

    Raises
    ------
    KeyError, TypeError, ValueError
        It holds none, or none of this form.
    """
    out = []
    for row in report["findings"]:
        own = {f.name: row[f.name] for f in fields(Finding)}
        numbers = {f.name: float("nan" if row[f.name] is None else row[f.name])
                   for f in fields(Finding) if f.type == "float"}  # fmt: skip
        own |= numbers
        own |= {k: tuple(row[k]) for k in ("equivalents", "stands_for", "codes")}
        own["held_out"] = None if (g := row["held_out"]) is None else tuple(map(float, g))
        own["mark"] = None if row["mark"] is None else Mark[row["mark"]]
        out.append(Finding(**own))
    return tuple(out)


def listed(findings: Sequence[Finding], name: str) -> Finding:
    """The finding of a candidate.

    Raises
    ------
    InvalidParameter
        There is no candidate of this name.
    """
    names = [f.cause for f in findings]
    if name in names:
        return findings[names.index(name)]
    near = ", ".join(get_close_matches(name, names, 3, 0.3)) or "none"
    raise InvalidParameter(
        f"no candidate {name!r} among {len(names)}; expected the name of one, nearest: {near}"
    )


@dataclass(frozen=True)
class Rule:
    """A rule of the judgement."""

    code: str
    mark: Mark | None
    """Mark that it gives; None: the candidate is not in the answer."""
    holds: Callable[[Finding], bool]
    threshold: str = ""
    """Number that decides, as it is stated in the documentation."""


def _probable(f: Finding) -> bool:
    return f.probability >= f.credibility


#: Probability of the differences of a magnitude between records below which they are real.
SAME = 0.01
#: The first rule that holds gives the mark; the codes of all that hold are told.
RULES: tuple[Rule, ...] = (
    # What is not in the answer.
    Rule("stands for", None, lambda f: not f.member and bool(f.stands_for),
         "log evidence within 1 of a member of the answer"),
    Rule("not fitted", None, lambda f: not f.member and not f.fitted,
         "its first-order gain is among the smallest"),
    Rule("differs", None, lambda f: f.left and f.same < SAME,
         "probability of equal sizes in all records below 1 %, by more than what matters"),
    Rule("refused", None, lambda f: f.left and f.refused,
         "held-out residual surely larger with it (95 %)"),
    Rule("not needed", None, lambda f: f.left,
         "log odds below those of the credibility, and no sure gain of 5 % in held-out records"),
    Rule("less probable", None, lambda f: not f.member, "another set is more probable"),
    # Marks of what is in the answer.
    Rule("cut", Mark.UNSURE, lambda f: not f.complete or math.isnan(f.evidence),
         "the search did not reach its end, or the set without it was not fitted"),
    Rule("at limit", Mark.UNSURE, lambda f: f.at_limit and not _probable(f),
         "size at a limit that is none of its law"),
    Rule("zero", Mark.UNSURE, lambda f: not f.excludes_zero and not f.equivalents
         and not f.predicts, "interval of 95 % that contains zero"),
    Rule("small", Mark.SMALL, lambda f: f.takes < 1.0 and f.together >= f.credibility
         and f.excludes_zero and not f.refused,
         "takes away less than what matters, at the probability of the credibility or more"),
    Rule("does not matter", Mark.UNSURE, lambda f: f.takes < 1.0 and not f.predicts,
         "takes away less than what matters"),
    Rule("one of", Mark.ONE_OF, lambda f: bool(f.equivalents), "log evidence within 1"),
    Rule("named", Mark.NAMED, _probable, "probability of the credibility or more"),
    Rule("supported", Mark.SUPPORTED, lambda f: f.predicts,
         "held-out residual surely 5 % smaller with it (95 %)"),
    Rule("unsure", Mark.UNSURE, lambda _: True),
    # Beside a mark.
    Rule("trust", Mark.NAMED, lambda f: _probable(f) and f.least_probability < f.credibility,
         "a discrepancy counted as 10 or 40 samples instead of 20"),
    Rule("chosen by", Mark.SUPPORTED, lambda f: f.predicts, "the held-out records also chose it"),
)  # fmt: skip
#: Number of rules that give a mark; the others are told beside it.
MARKING = 15


def marked(finding: Finding) -> Finding:
    """The finding with its mark and the codes of the rules that hold."""
    first = next(r for r in RULES[:MARKING] if r.holds(finding))
    more = [r.code for r in RULES[MARKING:] if finding.member and r.holds(finding)]
    return replace(finding, mark=first.mark, codes=(first.code, *more))
