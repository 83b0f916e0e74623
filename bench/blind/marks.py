"""Marks of the yardstick: what an answer to a case of known truth is worth; imports no feltmb.

Marks of a case with an effect:

- *right*: each true effect, or an accepted equivalent, is named, and nothing false is;
- *part*: some of several true effects are named, the rest is not told, and nothing false is named;
- *class*: the true effect is in a told class, or a look-alike is named alone;
- *silent*: nothing is named or told (UNKNOWN among these is also counted apart);
- *wrong*: something is named, or a class is told, that holds nothing accepted.

Of a control: *quiet*, *unknown*, *false alarm*. Of a cause that no candidate has: *right* is
UNKNOWN without a name, *silent*, *wrong*; *class*: a candidate that imitates it within the noise.
Of any case: *none* is no answer within the limit, or an error.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from statistics import median
from typing import Any, Literal

__all__ = [
    "Answer", "Cause", "Marked", "Truth", "case_numbers", "compare", "mark", "mcnemar", "read",
    "table", "without_nan",
]  # fmt: skip

Kind = Literal["control", "effect", "outside", "one of", "numbers"]
#: Marks, best first.
MARKS = (
    "right", "quiet", "part", "class", "silent", "unknown", "none", "wrong", "false alarm",
)  # fmt: skip


@dataclass(frozen=True)
class Cause:
    """One true effect: patterns of names (``fnmatch``) that are accepted.

    ``parameter:NAME`` accepts that the fit is told to have moved this parameter, and nothing named.
    """

    right: tuple[str, ...]
    near: tuple[str, ...] = ()


@dataclass(frozen=True)
class Truth:
    """What is right in a case."""

    kind: Kind
    causes: tuple[Cause, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    """True values of parameters, for the coverage of intervals."""
    sizes: Mapping[str, float] = field(default_factory=dict)
    """True magnitudes of effects whose law is that of the candidate."""
    free: tuple[str, ...] = ()
    """Patterns of names that are neither right nor false."""
    accuracy: float = 0.05
    """Relative accuracy that ``numbers`` need in a case of this kind."""
    engineer: float = math.nan
    """Rms of the held-out records by least squares with the right set [unit of the output]."""
    about: str = ""

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Truth:
        """Truth from a stored one."""
        causes = tuple(Cause(tuple(c["right"]), tuple(c["near"])) for c in plain["causes"])
        best = plain.get("engineer")
        own = {"causes": causes, "free": tuple(plain["free"])}
        return cls(**{**plain, **own, "engineer": math.nan if best is None else best})


Interval = tuple[float, float, float]
"""Value, lower and upper end (95 %)."""


@dataclass(frozen=True)
class Told:
    """A member of the set of an answer."""

    causes: tuple[str, ...]
    """It, and what is told to be equivalent."""
    mark: str
    probability: float
    """Probability of the sets with any of these [1]."""
    excludes_zero: bool


@dataclass(frozen=True)
class Answer:
    """What an engine said of a case."""

    verdict: str
    """NO GAP, CALIBRATED, NAMED, ONE OF, UNKNOWN, DATA PROBLEM; "none": no answer."""
    named: tuple[str, ...] = ()
    classes: tuple[tuple[str, ...], ...] = ()
    """Each: one of these acts."""
    moved: tuple[str, ...] = ()
    """Parameters that are told to differ from the tabulated values."""
    parameters: Mapping[str, Interval] = field(default_factory=dict)
    magnitudes: Mapping[str, Interval] = field(default_factory=dict)
    seconds: float = math.nan
    """Processor time [s]."""
    held_out: tuple[float, float] | None = None
    """Size of the residual of held-out records, with the fitted parameters alone and with what is
    named, in one unit."""
    said: str = ""
    """Reasons of the verdict, or the error."""
    supported: tuple[str, ...] = ()
    """Causes that improve the prediction of held-out records for sure, without a name."""
    first: str = ""
    """First sentence that a user reads."""
    predicted: float = math.nan
    """Rms of the held-out records with what is told [unit of the output], worst channel."""
    members: tuple[Told, ...] = ()
    """Members of the set of the answer, each with its mark."""

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> Answer:
        """Answer from a stored one."""
        return cls(
            **{
                **plain,
                "named": tuple(plain["named"]),
                "parameters": _numbers(plain["parameters"]),
                "magnitudes": _numbers(plain["magnitudes"]),
                "seconds": math.nan if plain["seconds"] is None else plain["seconds"],
                "classes": tuple(tuple(c) for c in plain["classes"]),
                "moved": tuple(plain["moved"]),
                "supported": tuple(plain.get("supported", ())),
                "members": tuple(
                    Told(**{**t, "causes": tuple(t["causes"])}) for t in plain.get("members", ())
                ),
                "predicted": math.nan if plain.get("predicted") is None else plain["predicted"],
                "held_out": None if plain["held_out"] is None else tuple(plain["held_out"]),
            }
        )


def case_numbers(text: str, count: int) -> list[int]:
    """Case numbers of "0,3,5-9", as far as there are so many cases."""
    out: list[int] = []
    for part in text.split(","):
        low, _, high = part.partition("-")
        out += range(int(low), int(high or low) + 1)
    return [n for n in out if n < count]


def without_nan(value: Any) -> Any:
    """Plain data in which a number that is not known is null."""
    if isinstance(value, Mapping):
        return {k: without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _numbers(told: Mapping[str, Sequence[float | None]]) -> dict[str, Interval]:
    """Intervals from stored ones."""
    nan = math.nan
    return {
        n: (nan if v is None else v, nan if a is None else a, nan if b is None else b)
        for n, (v, a, b) in told.items()
    }


def _matches(names: Iterable[str], patterns: Iterable[str]) -> bool:
    patterns = tuple(patterns)
    return any(fnmatchcase(n, p) for n in names for p in patterns)


def mark(truth: Truth, answer: Answer) -> str:
    """One of :data:`MARKS`; see the text of the module."""
    if answer.verdict == "none":
        return "none"
    named = [n for n in answer.named if not _matches([n], truth.free)]
    classes = [c for c in answer.classes if not _matches(c, truth.free)]
    blames = answer.verdict == "DATA PROBLEM" and not answer.named
    said = bool(named or classes or blames)
    unknown = answer.verdict == "UNKNOWN"
    if truth.kind == "control":
        return "false alarm" if said else "unknown" if unknown else "quiet"
    if truth.kind == "numbers":
        if said:
            return "wrong"
        fitted = answer.parameters
        known = all(
            n in fitted and abs(fitted[n][0] - v) <= truth.accuracy * abs(v)
            for n, v in truth.numbers.items()
        )
        return "right" if known and not unknown else "silent"
    if truth.kind == "one of":  # the records cannot tell these apart
        wanted = set(truth.causes[0].right)
        if not said:
            return "silent"
        if not named and any(wanted <= set(c) for c in classes):
            return "right"
        return "class" if not named and all(wanted & set(c) for c in classes) else "wrong"
    accepted = [p for c in truth.causes for p in (*c.right, *c.near)]
    if any(not _matches([n], accepted) for n in named) or blames:
        return "wrong"
    if any(not _matches(c, accepted) for c in classes):
        return "wrong"
    if truth.kind == "outside":
        return "class" if said else "right" if unknown else "silent"
    found = [_matches(named, c.right) for c in truth.causes]
    if not said:
        moved = [f"parameter:{n}" for n in answer.moved]
        found = [_matches(moved, [p for p in c.right if p.startswith("parameter:")])
                 for c in truth.causes]  # fmt: skip
        # A moved parameter is an answer only if it is the whole one.
        return "right" if truth.causes and all(found) and not unknown else "silent"
    if all(found):
        return "right"
    if any(found):
        return "part"
    return "class"


@dataclass(frozen=True)
class Marked:
    """A case, its answer and its mark."""

    set: str
    case: int
    commit: str
    truth: Truth
    answer: Answer

    @property
    def mark(self) -> str:
        """Mark of the answer."""
        return mark(self.truth, self.answer)

    @property
    def over_engineer(self) -> float:
        """Held-out residual over that of least squares with the right set [1]; NaN: not known."""
        return self.answer.predicted / self.truth.engineer

    @property
    def falsely_supported(self) -> list[str]:
        """Supported causes that are not in the machine."""
        accepted = [p for c in self.truth.causes for p in (*c.right, *c.near)]
        accepted += self.truth.free
        return [n for n in self.answer.supported if not _matches([n], accepted)]

    @property
    def line(self) -> str:
        """As one line of a file of results."""
        plain = {
            "set": self.set,
            "case": self.case,
            "commit": self.commit,
            "mark": self.mark,
            "truth": asdict(self.truth),
            "answer": asdict(self.answer),
        }
        return json.dumps(without_nan(plain))


def read(path: Path) -> dict[tuple[str, int], Marked]:
    """Answers of a file by set and case; the last one of a case counts."""
    found = {}
    for line in path.read_text("utf-8").splitlines():
        if line.strip():
            row = json.loads(line)
            found[row["set"], row["case"]] = Marked(
                row["set"], row["case"], row["commit"], Truth.of(row["truth"]),
                Answer.of(row["answer"]),
            )  # fmt: skip
    return found


def mcnemar(first: int, second: int) -> float:
    """Exact two-sided p of McNemar's test, from the cases in which only one of two succeeds."""
    n, k = first + second, min(first, second)
    if n == 0:
        return 1.0
    return min(1.0, 2.0 * sum(math.comb(n, i) for i in range(k + 1)) / 2.0**n)


#: Words in the name of an effect that is an error of a sensor or of a recorded input.
OF_RECORDS = (" of sensor ", " of input ", "clock")


def _covered(cases: Sequence[Marked]) -> dict[str, tuple[int, int]]:
    """Intervals that contain the truth, and all intervals of known truth, by kind."""
    found = dict.fromkeys(("all", "parameters", "effects", "errors of the records"), (0, 0))
    for c in cases:
        pairs = [(c.answer.parameters, c.truth.numbers), (c.answer.magnitudes, c.truth.sizes)]
        for (told, true), kind in zip(pairs, ("parameters", "effects"), strict=True):
            for name, (_, low, high) in told.items():
                if name in true and math.isfinite(low) and math.isfinite(high):
                    error = kind == "effects" and any(w in name for w in OF_RECORDS)
                    for k in ("all", "errors of the records" if error else kind):
                        hits, total = found[k]
                        found[k] = hits + (low <= true[name] <= high), total + 1
    return found


def calibration(cases: Sequence[Marked]) -> dict[str, tuple[int, int, float]]:
    """Members in the machine, all members and their mean probability, by mark and probability."""
    found: dict[str, list[tuple[bool, float]]] = {}
    for c in cases:
        if c.truth.kind not in ("effect", "control"):
            continue
        real = [p for t in c.truth.causes for p in (*t.right, *t.near)]
        for t in c.answer.members:
            if _matches(t.causes, c.truth.free):
                continue
            true, p = _matches(t.causes, real), t.probability
            between = next(b for b in (0.99, 0.9, 0.5, 0.0) if p >= b)
            zero = "" if t.excludes_zero else ", interval with zero"
            for row in ("all", f"all, {between:g} and more", t.mark + zero):
                found.setdefault(row, []).append((true, p))
    return {
        row: (sum(t for t, _ in own), len(own), sum(p for _, p in own) / len(own))
        for row, own in sorted(found.items())
    }


def _gains(cases: Sequence[Marked]) -> list[float]:
    """Held-out residual with the named effects, as a share of that without them."""
    return [
        c.answer.held_out[1] / c.answer.held_out[0]
        for c in cases
        if c.answer.held_out is not None and c.answer.named and c.answer.held_out[0] > 0.0
    ]


def table(cases: Sequence[Marked]) -> dict[str, str]:
    """Counts and numbers of some cases of one file, by the name of the row."""
    marks = [c.mark for c in cases]
    effects = [c for c in cases if c.truth.kind in ("effect", "one of", "numbers")]
    controls = [c for c in cases if c.truth.kind == "control"]
    outside = [c for c in cases if c.truth.kind == "outside"]
    rows = {"cases": f"{len(cases)}"}
    for title, some, shown in (
        ("effects", effects, ("right", "part", "class", "silent", "wrong", "none")),
        ("controls", controls, ("quiet", "unknown", "false alarm", "none")),
        ("outside", outside, ("right", "class", "silent", "wrong", "none")),
    ):
        if some:
            own = [c.mark for c in some]
            rows |= {f"{title}: {m}": f"{own.count(m)} of {len(some)}" for m in shown}
    unknown = sum(c.answer.verdict == "UNKNOWN" for c in effects)
    if effects:
        rows["effects: silent with UNKNOWN"] = f"{unknown} of {len(effects)}"
    for kind, (hits, total) in _covered(cases).items():
        if total or kind == "all":
            of = "" if kind == "all" else f": {kind}"
            share = f" ({hits / total:.0%})" if total else ""
            rows[f"intervals that cover{of}"] = f"{hits} of {total}{share}"
    spent = [c.answer.seconds for c in cases if math.isfinite(c.answer.seconds)]
    if spent:
        rows["CPU s, median / most"] = f"{median(spent):.1f} / {max(spent):.0f}"
    left = [c.over_engineer for c in cases if math.isfinite(c.over_engineer)]
    if left:
        rows["held out within 1.1 of an engineer"] = f"{sum(v <= 1.1 for v in left)} of {len(left)}"
    told = [n for c in cases for n in c.answer.supported]
    if told:
        false = [n for c in cases for n in c.falsely_supported]
        rows["supported members that are not in the machine"] = f"{len(false)} of {len(told)}"
    for row, (true, total, p) in calibration(cases).items():
        rows[f"members in the machine: {row}"] = f"{true} of {total} (told {p:.0%})"
    gains = _gains(cases)
    if gains:
        rows["held-out residual after / before, median"] = f"{median(gains):.2f} ({len(gains)})"
    assert set(marks) <= set(MARKS)
    return rows


#: What is compared pairwise: title -> whether a case succeeds.
PAIRED: Mapping[str, Callable[[Marked], bool]] = {
    "right or quiet": lambda c: c.mark in ("right", "quiet"),
    "right, part, class or quiet": lambda c: c.mark in ("right", "part", "class", "quiet"),
    "neither wrong nor false alarm": lambda c: c.mark not in ("wrong", "false alarm"),
    "an answer": lambda c: c.mark != "none",
}


def compare(
    first: Mapping[tuple[str, int], Marked], second: Mapping[tuple[str, int], Marked]
) -> str:
    """Paired table of the cases that both files have, for each set, as Markdown."""
    common = sorted(first.keys() & second.keys())
    lines = []
    for name in dict.fromkeys(s for s, _ in common):
        keys = [k for k in common if k[0] == name]
        one, two = [first[k] for k in keys], [second[k] for k in keys]
        left, right = table(one), table(two)
        lines += [f"### {name}, {len(keys)} cases", "", "| | A | B |", "|---|---|---|"]
        rows = dict.fromkeys([*left, *right])
        lines += [f"| {r} | {left.get(r, '-')} | {right.get(r, '-')} |" for r in rows]
        lines += ["", "| paired | only A | only B | p |", "|---|---|---|---|"]
        for title, good in PAIRED.items():
            a = sum(good(x) and not good(y) for x, y in zip(one, two, strict=True))
            b = sum(good(y) and not good(x) for x, y in zip(one, two, strict=True))
            lines.append(f"| {title} | {a} | {b} | {mcnemar(a, b):.2g} |")
        changed = [
            f"{k[1]}: {x.mark} -> {y.mark} ({y.truth.about})"
            for k, x, y in zip(keys, one, two, strict=True)
            if x.mark != y.mark
        ]
        lines += ["", *(f"- {c}" for c in changed), ""]
    return "\n".join(lines)
