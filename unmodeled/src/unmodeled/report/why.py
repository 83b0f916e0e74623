"""Why a candidate is in the answer, or not: the line of the ledger as sentences."""

from __future__ import annotations

import math

from unmodeled.report.words import joined, percent
from unmodeled.search.ledger import RULES, Finding

#: What each code says of a candidate.
SENTENCES = {
    "not fitted": "It was not fitted: its gain to first order, {gain}, is among the smallest.",
    "differs": "It left the answer: its size differs between the records by more than what "
    "matters (probability of equal sizes {same}), as that of an imitation does.",
    "refused": "It left the answer: the held-out records are surely predicted worse with it.",
    "not needed": "It left the answer: neither the evidence nor the held-out records need it.",
    "stands for": "The answer tells it beside {stands_for}: the records do not tell them apart.",
    "less probable": "It was fitted, and another set of causes is more probable.",
    "cut": "The search did not reach its end, or the set without it was not fitted: it is the best "
    "so far, and has no name.",
    "at limit": "Its size is at a limit that is none of its law, so that it may imitate another "
    "cause.",
    "zero": "Its 95 % interval contains zero.",
    "small": "It takes away {takes} of what matters.",
    "does not matter": "It takes away {takes} of what matters, and its odds are not sure.",
    "one of": "The records do not tell it from {equivalents}.",
    "named": "The records tell it from all other candidates.",
    "supported": "The held-out records surely need it, or another law that does the same.",
    "unsure": "Its probability is below {credibility}, and the held-out records do not surely "
    "need it.",
    "trust": "If a discrepancy of the model counted as 10 or 40 samples instead of 20, its "
    "probability would be {least}, and it would have no name.",
    "chosen by": "These held-out records also chose the answer.",
}
assert set(SENTENCES) == {r.code for r in RULES}


def why(f: Finding) -> str:
    """Why a candidate is in the answer, or not.

    Parameters
    ----------
    f
        Its line of the ledger.
    """
    inside = "" if f.member or f.codes[:1] == ("stands for",) else "not "
    head = f"{f.cause[:1].upper()}{f.cause[1:]} is {inside}in the answer"
    mark = f.mark.value if f.mark else ""
    return f"{head}{f', marked *{mark}*' if mark else ''}. {reasons(f)}".rstrip()


def reasons(f: Finding) -> str:
    """The rules that hold for a candidate, and its numbers, as sentences.

    Parameters
    ----------
    f
        Its line of the ledger.
    """
    words = {
        "gain": f"{f.gain:.2g} of log evidence" if math.isfinite(f.gain) else "not computed",
        "same": percent(f.same),
        "takes": percent(f.takes),
        "equivalents": joined(f.equivalents, "or"),
        "stands_for": joined(f.stands_for, "or"),
        "credibility": percent(f.credibility),
        "least": percent(f.least_probability),
    }
    return " ".join([*(SENTENCES[code].format(**words) for code in f.codes), *_numbers(f)])


def _numbers(f: Finding) -> list[str]:
    """The numbers of the line that the sentences do not tell."""
    out = []
    if f.of:
        out.append(f"{f.better} of {f.of} held-out records are better with it.")
    if f.held_out is not None:
        value, low, high = f.held_out
        out.append(
            f"Without it, their residual is {value:.3g} times as large (95 %: {low:.3g} to "
            f"{high:.3g})."
        )
    if math.isfinite(f.evidence):
        odds = math.exp(min(abs(f.evidence), 50.0))
        sides = "for it" if f.evidence >= 0.0 else "against it"
        out.append(f"At 20 samples for the discrepancy, the odds are {odds:.2g} to 1 {sides}.")
    if f.fitted:
        out.append(f"The sets that contain it have the probability {percent(f.probability)}.")
    return out
