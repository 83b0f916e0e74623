"""Scorer of the blind bench: reads answers and results, nothing else; imports nothing of feltmb.

Words used here. *Claim*: a verdict other than NO GAP and TOO WEAK. *Wrong*: a claim that names an
effect that is not there, offers a class without a true member, or blames the data where the
machine is to blame. Intervals are 95 %: Wilson's for shares, bootstrap for the rest.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["BINS", "Figure", "markdown", "read", "read_truth", "score"]

#: Bins of noncentrality.
BINS = ((0.5, 1.5), (1.5, 3.0), (3.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, 50.1))
#: Noncentrality from which a cause is expected to be found.
SEEN = 5.0
DATA = ("input", "hammer camera", "key camera")
UNKNOWN = ("UNKNOWN", "NAMED + RESIDUAL REMAINS")
SILENT = ("NO GAP", "NO STRUCTURAL GAP, CALIBRATED", "TOO WEAK", "NOT COMPLETE")


@dataclass(frozen=True)
class Figure:
    """One statistic with its 95 % interval and the number of its cases."""

    name: str
    value: float
    low: float
    high: float
    n: int
    unit: str = "%"
    target: str = ""
    aim: str = ""
    met: bool | None = None


def wilson(hits: int, n: int) -> tuple[float, float, float]:
    """Share with Wilson's 95 % interval, in percent."""
    if n == 0:
        return math.nan, math.nan, math.nan
    z, p = 1.959964, hits / n
    center = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return 100.0 * p, 100.0 * max(center - half, 0.0), 100.0 * min(center + half, 1.0)


def bootstrap(
    values: Sequence[Any], statistic: Callable[[Any], float], rounds: int = 1000
) -> tuple[float, float, float]:
    """Statistic with the 95 % interval of a bootstrap over the cases (fixed seed)."""
    data = np.asarray(values, dtype=float)
    if data.shape[0] == 0:
        return math.nan, math.nan, math.nan
    rng = np.random.default_rng(12345)
    drawn = [
        statistic(data[rng.integers(data.shape[0], size=data.shape[0])]) for _ in range(rounds)
    ]
    return statistic(data), float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975))


def _strength(part: Mapping[str, Any]) -> float:
    """Noncentrality of a part: computed for its own case if available, else as drawn."""
    return float(part.get("nc", part["target"]))


@dataclass(frozen=True)
class Scored:
    """A case with its answer and its result."""

    number: int
    parts: tuple[Mapping[str, Any], ...]
    result: Mapping[str, Any]

    @property
    def outside(self) -> bool:
        return any(p["form"] == "outside" for p in self.parts)

    @property
    def truth(self) -> set[str]:
        return {str(p["name"]) for p in self.parts}

    @property
    def present(self) -> set[str]:
        """True effects, and those that the other form of one of them is mixed with."""
        return self.truth | {str(p["second"]) for p in self.parts if "second" in p}

    @property
    def alike(self) -> dict[str, float]:
        """Noncentrality that an effect of the library leaves of an outside cause, by name.

        Of the most similar effects only, where the bench has computed them.
        """
        return {str(a["effect"]): float(a["left"]) for p in self.parts for a in p.get("alike", ())}

    @property
    def distinct(self) -> float:
        """Strength of an outside cause beside the most similar effect of the library."""
        return min([self.strength, *self.alike.values()])

    @property
    def substitutes(self) -> set[str]:
        """Effects that leave less of an outside cause than can be told apart."""
        return {name for name, left in self.alike.items() if left < SEEN}

    @property
    def kind(self) -> int:
        """0 none, 1 to 3 effects of the library, 4 outside."""
        return 4 if self.outside else len(self.parts)

    @property
    def strength(self) -> float:
        return max((_strength(p) for p in self.parts), default=0.0)

    @property
    def failed(self) -> bool:
        return "error" in self.result

    @property
    def verdict(self) -> str:
        return "ERROR" if self.failed else str(self.result["verdict"])

    @property
    def claims(self) -> bool:
        return self.verdict not in SILENT

    @property
    def named(self) -> set[str]:
        return set() if self.failed else set(self.result["named"])

    @property
    def ranking(self) -> list[Mapping[str, Any]]:
        return [] if self.failed else list(self.result["effects"])

    def top(self, k: int) -> bool:
        """Whether a true effect is among the first k of the ranking."""
        return any(r["effect"] in self.truth for r in self.ranking[:k])

    def in_class(self) -> bool:
        """Whether names, class, or else the first and its confusable ones include it."""
        offered = self.offered()
        if not offered and self.ranking:
            offered = {self.ranking[0]["effect"], *self.ranking[0]["confusable"]}
        return bool(offered & self.truth)

    def offered(self) -> set[str]:
        """Effects that are named, and those of the class."""
        return set() if self.failed else set(self.result["named"]) | set(self.result["one_of"])

    def wrong(self, substitutes: bool = False) -> bool:
        """Whether the diagnosis makes a wrong claim.

        With ``substitutes`` an effect is right in the place of an outside cause that it reproduces.
        """
        if self.failed or not self.claims:
            return False
        present = self.present | (self.substitutes if substitutes else set())
        if self.named - present:
            return True
        if self.result["one_of"]:
            return not set(self.result["one_of"]) & present
        if self.verdict == "DATA PROBLEM":
            data = any(p.get("data", p["component"] in DATA) for p in self.parts)
            return not data and not (substitutes and self.named & self.substitutes)
        return False

    def commits(self) -> bool:
        """Whether the diagnosis names an effect, offers a class, or blames the data."""
        return not self.failed and bool(
            self.named or self.result["one_of"] or self.verdict == "DATA PROBLEM"
        )

    def flagged(self) -> bool:
        return self.verdict in UNKNOWN


_NUMBER = (int, float)
_PART = {"name": str, "form": str, "component": str, "size": _NUMBER, "target": _NUMBER,
         "onset": {...: _NUMBER}}  # fmt: skip
_EFFECT = {"effect": str, "component": str, "low": _NUMBER, "high": _NUMBER, "posterior": _NUMBER,
           "confusable": [str]}  # fmt: skip
_RESULT = {"verdict": str, "named": [str], "one_of": [str], "closed": _NUMBER, "effects": [_EFFECT],
           "sets": [{"effects": [str]}], "onset": {...: _NUMBER}}  # fmt: skip


def _check(value: Any, shape: Any, where: str) -> None:
    """Raise ValueError if a file has another structure than required."""
    if isinstance(shape, list):
        _check(value, list, where)
        for i, item in enumerate(value):
            _check(item, shape[0], f"{where}[{i}]")
    elif isinstance(shape, dict):
        _check(value, dict, where)
        keys = value if ... in shape else shape
        for key in keys:
            if key not in value:
                raise ValueError(f"{where}.{key} is missing")
            _check(value[key], shape.get(key, shape.get(...)), f"{where}.{key}")
    elif not isinstance(value, shape) or isinstance(value, bool):
        raise ValueError(f"{where} is of the wrong kind ({type(value).__name__})")
    elif shape is _NUMBER and 1e100 < abs(value) < math.inf:
        raise ValueError(f"{where} is beyond 1e100")


def _read(path: Path, shape: Any) -> Any:
    try:
        found = json.loads(path.read_text("utf-8"))
        _check(found, shape(found) if callable(shape) else shape, "file")
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: is damaged: {str(error)[:300]}") from None
    return found


def _result_shape(found: Any) -> Any:
    """Required structure of a result; the result of a failed diagnosis only has its error."""
    if isinstance(found, dict) and "error" in found:
        return {"cpu_seconds": _NUMBER}
    oracle = found.get("oracle") if isinstance(found, dict) else None
    more = {} if oracle is None else {"oracle": {"closed": _NUMBER}}
    return {**_RESULT, "cpu_seconds": _NUMBER, **more}


def read_truth(path: Path) -> tuple[Mapping[str, Any], ...]:
    """Withheld effects of a case, from its answer.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    return tuple(_read(path, {"parts": [_PART]})["parts"])


def read(folder: Path, numbers: Sequence[int]) -> list[Scored]:
    """Cases of a bench folder that have an answer and a result.

    Raises
    ------
    ValueError
        A file of the bench is damaged.
    """
    cases = []
    for n in numbers:
        answer, result = folder / "answers" / f"{n}.json", folder / "results" / f"{n}.json"
        if answer.exists() and result.exists():
            cases.append(Scored(n, read_truth(answer), _read(result, _result_shape)))
    return cases


def _ece(pairs: Any) -> float:
    """Expected calibration error of (posterior, hit) in ten bins of equal width."""
    p, hit = pairs[:, 0], pairs[:, 1]
    bins = np.minimum((p * 10).astype(int), 9)
    total = 0.0
    for b in range(10):
        inside = bins == b
        if np.any(inside):
            total += np.mean(inside) * abs(np.mean(p[inside]) - np.mean(hit[inside]))
    return float(total)


def score(cases: Sequence[Scored]) -> list[Figure]:
    """All statistics of the table, in its order."""
    figures: list[Figure] = []

    def share(
        name: str, chosen: Sequence[Scored], hit: Callable[[Scored], bool],
        target: float = math.nan, aim: float = math.nan, above: bool = True,
    ) -> None:  # fmt: skip
        hits = sum(map(hit, chosen))
        value, low, high = wilson(hits, len(chosen))
        sign = ">=" if above else "<="
        met = None
        if not math.isnan(target) and chosen:
            met = value >= target if above else value <= target
        figures.append(
            Figure(
                name, value, low, high, len(chosen), "%",
                "" if math.isnan(target) else f"{sign} {target:g}",
                "" if math.isnan(aim) else f"{sign} {aim:g}", met,
            )
        )  # fmt: skip

    def number(
        name: str, values: Sequence[Any], statistic: Callable[[Any], float], unit: str,
        target: float = math.nan, aim: float = math.nan,
    ) -> None:  # fmt: skip
        value, low, high = bootstrap(values, statistic)
        met = None if math.isnan(target) or not values else value <= target
        figures.append(
            Figure(
                name, value, low, high, len(values), unit,
                "" if math.isnan(target) else f"<= {target:g}",
                "" if math.isnan(aim) else f"<= {aim:g}", met,
            )
        )  # fmt: skip

    null = [c for c in cases if c.kind == 0]
    single = [c for c in cases if c.kind == 1]
    strong = [c for c in single if c.strength >= SEEN]
    pairs = [c for c in cases if c.kind == 2]
    many = [c for c in cases if c.kind in (2, 3)]
    outside = [c for c in cases if c.kind == 4]
    committed = [c for c in cases if c.commits()]

    share("false alarm, no effect", null, lambda c: c.claims, 5.0, 1.0, above=False)
    share("top-1, one effect, nc >= 5", strong, lambda c: c.top(1), 80.0, 95.0)
    seen = [c for c in outside if c.strength >= SEEN]
    share("unknown flagged, outside, nc >= 5", seen, Scored.flagged, 80.0, 95.0)
    share(
        "unknown flagged, outside, nc >= 5 beside every effect of the library",
        [c for c in seen if c.alike and c.distinct >= SEEN], Scored.flagged, 80.0, 95.0,
    )  # fmt: skip
    share(
        "outside, an effect leaves nc < 5: it is named or in the class",
        [c for c in seen if c.substitutes], lambda c: bool(c.offered() & c.substitutes),
    )  # fmt: skip
    share("confident and wrong, of all cases", cases, Scored.wrong, 5.0, 1.0, above=False)
    share(
        "confident and wrong, effects that leave nc < 5 of an outside cause are right", cases,
        lambda c: c.wrong(substitutes=True), 5.0, 1.0, above=False,
    )  # fmt: skip
    share("selective risk: wrong, of those that commit", committed, Scored.wrong)
    share("diagnosis failed with an error", cases, lambda c: c.failed)
    for low, high in BINS:
        chosen = [c for c in single if low <= c.strength < high]
        share(f"top-1, one effect, nc {low:g}-{high:.2g}", chosen, lambda c: c.top(1))
        share(f"top-2, one effect, nc {low:g}-{high:.2g}", chosen, lambda c: c.top(2))
        share(f"in its class, nc {low:g}-{high:.2g}", chosen, Scored.in_class)
        share(f"NO GAP or TOO WEAK, nc {low:g}-{high:.2g}", chosen, lambda c: c.verdict in SILENT)
    share("top-2, one effect, nc >= 5", strong, lambda c: c.top(2))
    share("in its class, one effect, nc >= 5", strong, Scored.in_class)
    share("top-1, form A (the library's), nc >= 5",
          [c for c in strong if c.parts[0]["form"] == "A"], lambda c: c.top(1))  # fmt: skip
    share("top-1, form B (another), nc >= 5",
          [c for c in strong if c.parts[0]["form"] == "B"], lambda c: c.top(1))  # fmt: skip
    number("magnitude of the class, one effect, nc >= 5",
           [max(1, len(c.result["one_of"])) for c in strong if not c.failed and c.claims],
           lambda v: float(np.mean(v)), "effects")  # fmt: skip
    share("two effects, both named", pairs, lambda c: c.truth <= c.named)
    both = [c for c in pairs if min(_strength(p) for p in c.parts) >= 5.0]
    share("two effects, both named, both nc >= 5", both, lambda c: c.truth <= c.named)
    share(
        "two effects, both in the best set, both nc >= 5", both,
        lambda c: not c.failed and bool(c.result["sets"])
        and c.truth <= set(c.result["sets"][0]["effects"]),
    )  # fmt: skip
    share("two effects, one of them first", pairs, lambda c: c.top(1))
    number("F1 of the named set, two or three effects",
           [2.0 * len(c.truth & c.named) / (len(c.truth) + len(c.named)) for c in many],
           lambda v: float(np.mean(v)), "1")  # fmt: skip
    share("outside: names an effect or blames wrongly", outside, Scored.wrong)
    share("outside: silent (NO GAP, TOO WEAK)", outside, lambda c: c.verdict in SILENT)
    share("outside: component of the first is right", outside, _component_hit)

    said = [c for c in cases if not c.failed and c.ranking and c.kind != 0]
    first = [(float(c.ranking[0]["posterior"]), float(c.top(1))) for c in said]
    number("ECE, posterior of the first", first, _ece, "1", 0.08, 0.03)
    # A posterior also stands for the cases in which there was nothing to find.
    every = [
        (float(c.ranking[0]["posterior"]), float(c.top(1)))
        for c in cases
        if not c.failed and c.ranking
    ]
    number("ECE, posterior of the first, nulls included", every, _ece, "1")
    number(
        "Brier, posteriors of all effects",
        [
            (float(r["posterior"]), float(r["effect"] in c.truth))
            for c in cases if not c.failed for r in c.ranking
        ],
        lambda v: float(np.mean((v[:, 0] - v[:, 1]) ** 2)), "1",
    )  # fmt: skip
    order = sorted(
        (c for c in single if not c.failed and c.ranking),
        key=lambda c: -float(c.ranking[0]["posterior"]),
    )
    kept = order[: max(1, round(0.8 * len(order)))] if order else []
    share("first wrong, at 80 % coverage, one effect", kept, lambda c: not c.top(1))

    for name, key in (("onset", "onset"), ("moment from which it shows", "shows")):
        number(f"{name}, median error, nc >= 5",
               [d for c in strong for d in _onset_errors(c, key)], lambda v: float(np.median(v)),
               "ms", 5.0, 1.0)  # fmt: skip
    share("moment from which it shows within 5 ms (of records)",
          [x for c in strong for x in _each_onset(c)],
          lambda c: min(_onset_errors(c, "shows")) <= 5.0)  # fmt: skip
    share("component of the first, nc >= 5", strong, _component_hit, 80.0, 95.0)
    right = [c for c in strong if c.top(1) and c.parts[0]["form"] == "A"]
    share("95 % interval covers, first right, form A", right, _covered)
    number("held-out gap closed, named right, nc >= 5",
           [c.result["closed"] for c in strong
            if c.named == c.truth and math.isfinite(c.result["closed"])],
           lambda v: float(np.median(v)), "1")  # fmt: skip
    ratios = [r for c in strong if (r := _to_oracle(c)) is not None]
    number("closed / closed by the oracle, nc >= 5", ratios, lambda v: float(np.median(v)), "1")
    cpu = [float(c.result["cpu_seconds"]) for c in cases]
    number("CPU time a case, median", cpu, lambda v: float(np.median(v)), "s", 5.0)
    number("CPU time a case, mean", cpu, lambda v: float(np.mean(v)), "s")
    number("CPU time a case, 95th percentile", cpu, lambda v: float(np.quantile(v, 0.95)), "s")
    return figures


def _component_hit(c: Scored) -> bool:
    return bool(c.ranking) and c.ranking[0]["component"] in {p["component"] for p in c.parts}


def _covered(c: Scored) -> bool:
    row = c.ranking[0]
    return bool(row["low"] <= float(c.parts[0]["size"]) <= row["high"])


def _onset_errors(c: Scored, key: str = "onset") -> list[float]:
    """Errors of the onset in the records that show one [ms].

    Against when the effect first can act, or, with the key "shows", when it first shows.
    """
    if c.failed:
        return []
    true = c.parts[0].get(key, {})
    return [
        1e3 * abs(t - true[k])
        for k, t in c.result["onset"].items()
        if k in true and math.isfinite(true[k]) and math.isfinite(t)
    ]


def _each_onset(c: Scored) -> list[Scored]:
    """One copy of the case for every record with an onset, with only this onset."""
    if c.failed:
        return []
    return [
        Scored(c.number, c.parts, {**c.result, "onset": {k: t}})
        for k, t in c.result["onset"].items()
        if _onset_errors(Scored(c.number, c.parts, {**c.result, "onset": {k: t}}), "shows")
    ]


def _to_oracle(c: Scored) -> float | None:
    oracle = c.result.get("oracle")
    if not oracle or c.failed:
        return None
    best, own = float(oracle["closed"]), float(c.result["closed"])
    if not (math.isfinite(best) and math.isfinite(own)) or best < 0.2:
        return None
    return own / best


def markdown(figures: Sequence[Figure]) -> str:
    """Table of the statistics."""
    lines = [
        "| figure | value | 95 % interval | n | target | aim | met |",
        "|---|---|---|---|---|---|---|",
    ]
    for f in figures:
        met = "" if f.met is None else "yes" if f.met else "**no**"
        if f.n == 0:
            value, interval = "-", "-"
        else:
            unit = "" if f.unit in ("%", "1") else f" {f.unit}"
            percent = " %" if f.unit == "%" else ""
            value = f"{f.value:.3g}{percent}{unit}"
            interval = f"{f.low:.3g} to {f.high:.3g}"
        lines.append(f"| {f.name} | {value} | {interval} | {f.n} | {f.target} | {f.aim} | {met} |")
    return "\n".join(lines) + "\n"
