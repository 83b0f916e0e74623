"""The page of the leaderboard: tables and a picture from stored results."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from blind.marks import Answer

__all__ = ["of_tier", "rate", "read", "write_page"]

#: Sets in the order of the page.
ORDER = "interventions", "measured", "machines", "questions", "robots"
#: Sets whose single cases are in `bench/causes/results` only.
UNLISTED = ("machines",)
#: What an engine sees, and how it is set.
SEEN = {
    "unmodeled": "model, priors, candidates with their scales and shapes, noise; defaults",
    "bic": "the same through simulations of `unmodeled`, without the priors of the magnitudes; "
    "`lmfit`, `least_squares`, its BIC, a fall of more than 10, at most five",
    "petab_select": "as `bic`; FAMoS by AICc, all candidates may be swapped; the best set until "
    "the limit",
    "sindy": "residual and columns of the candidates at the fit of the model alone; "
    "`pysindy.STLSQ`, ridge 0.05, the threshold of the lowest BIC of 25",
    "lasso": "the same columns; `LassoCV`, five folds",
    "gp": "residual, inputs and outputs, 300 samples; Gaussian process of `scikit-learn`; no names",
    "parameter_list": "robots only: file and records; all numbers of joints and servos, a payload, "
    "one delay, by least squares within bounds, as `mujoco.sysid`; told is what differs "
    "by three standard deviations",
    "cma": "the same list by CMA-ES until 70 % of the limit, within which it did not converge",
}
Row = Mapping[str, Any]


def of_tier(answer: Answer, tier: str) -> Answer:
    """An answer as one tier has it: what is named, or what is named or supported."""
    if tier == "named" or not answer.supported:
        return answer
    verdict = answer.verdict if answer.verdict in ("NAMED", "ONE OF") else "NAMED"
    named = tuple(dict.fromkeys([*answer.named, *answer.supported]))
    return replace(answer, named=named, verdict=verdict)


def rate(hits: int, count: int) -> tuple[float, float, float]:
    """Share with its 95 % interval of Clopper and Pearson."""
    if count == 0:
        return math.nan, 0.0, 1.0
    from scipy.stats import binomtest  # slow to import, and every engine imports this file

    interval = binomtest(hits, count).proportion_ci(method="exact")
    return hits / count, float(interval.low), float(interval.high)


def _told(hits: int, count: int) -> str:
    share, low, high = rate(hits, count)
    return "-" if count == 0 else f"{hits} of {count} ({share:.0%}, {low:.0%} to {high:.0%})"


def read(folder: Path) -> dict[str, list[Row]]:
    """Rows of all files of results, by engine."""
    found: dict[str, list[Row]] = {}
    for path in sorted(folder.glob("*.json")):
        plain = json.loads(path.read_text("utf-8"))
        if "rows" in plain:
            found[plain["engine"]] = plain["rows"]
    return dict(sorted(found.items(), key=lambda one: ([*SEEN, one[0]].index(one[0]), one[0])))


def counts(rows: Sequence[Row], key: str = "mark") -> dict[str, tuple[int, int]]:
    """Right names among cases with a cause, quiet controls, and false names among all cases.

    A case without an answer counts as one, so that an engine gains nothing by a crash.
    """
    caused = [r[key] for r in rows if r["truth"]["kind"] in ("effect", "one of", "numbers")]
    empty = [r[key] for r in rows if r["truth"]["kind"] == "control"]
    whole = [r[key] for r in rows]
    return {
        "right": (caused.count("right"), len(caused)),
        "part": (caused.count("part") + caused.count("class"), len(caused)),
        "quiet": (sum(m in ("quiet", "unknown") for m in empty), len(empty)),
        "wrong": (sum(m in ("wrong", "false alarm") for m in whole), len(whole)),
        "none": (whole.count("none"), len(whole)),
    }


def _table(found: Mapping[str, list[Row]], name: str) -> list[str]:
    """A set as a table of engines."""
    head = ["engine", "right", "part or class", "nothing named in controls", "wrong names",
            "no answer", "CPU s, median", "run of the set"]  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for engine, every in found.items():
        rows = [r for r in every if r["set"] == name]
        if not rows:
            lines.append(f"| {engine} |" + " not run |" + " |" * (len(head) - 2))
            continue
        tiers = [("", "mark")]
        if any(r["mark"] != r["mark_with_supported"] for r in rows):
            tiers.append((", named or supported", "mark_with_supported"))
        spent = [r["answer"]["seconds"] for r in rows if r["answer"]["seconds"] is not None]
        for more, key in tiers:
            c = counts(rows, key)
            cells = [engine + more, *(_told(*c[k]) for k in ("right", "part", "quiet", "wrong")),
                     str(c["none"][0]), f"{median(spent):.1f}" if spent else "-",
                     f"{len(rows)} (limit {max(r['limit'] for r in rows):g} s)"]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def _cases(found: Mapping[str, list[Row]], name: str) -> list[str]:
    """The marks of each case of a set; of the first engine, also what it told."""
    marks = {(e, r["case"]): r for e, rows in found.items() for r in rows if r["set"] == name}
    cases: dict[str, tuple[int, str]] = {}
    for (_, case), r in marks.items():
        cases[case] = r["number"], r["truth"]["about"]
    engines = [e for e in found if any(k[0] == e for k in marks)]
    lines = [
        f"| case | what is true | {' | '.join(engines)} |",
        "|---|---|" + "---|" * len(engines),
    ]
    for case, (_, about) in sorted(cases.items(), key=lambda one: one[1]):
        cells = [_cell(marks.get((e, case)), whole=e == engines[0]) for e in engines]
        lines.append(f"| {case} | {about} | {' | '.join(cells)} |")
    return lines


def _cell(row: Row | None, *, whole: bool) -> str:
    if row is None or not whole:
        return "" if row is None else row["mark"]
    answer = row["answer"]
    told = [*answer["named"], *(" or ".join(c) for c in answer["classes"])]
    more = [f"supported: {', '.join(answer['supported'])}"] if answer["supported"] else []
    text = "; ".join([", ".join(told), *more] if told else more)
    said = f" ({answer['said']})" if row["mark"] == "none" else ""
    return f"**{row['mark']}**{said}{': ' * bool(text)}{text}".replace("|", "/")


def _first(found: Mapping[str, list[Row]]) -> list[str]:
    """Right and wrong names of all sets together, on the cases that an engine and the first ran."""
    (own, rows), *others = found.items()
    lines = ["| engine | cases of both | right, of cases with a cause | wrong names | "
             f"right by {own} | wrong by {own} |", "|---|---|---|---|---|---|"]  # fmt: skip
    for engine, theirs in others:
        both = {r["case"] for r in rows} & {r["case"] for r in theirs}
        c, o = (counts([r for r in some if r["case"] in both]) for some in (theirs, rows))
        cells = [f"{x[k][0]} of {x[k][1]}" for x in (c, o) for k in ("right", "wrong")]
        lines.append(f"| {engine} | {len(both)} | {' | '.join(cells)} |")
    return [f"All sets together, paired with {own}:", "", *lines, ""] if others else []


def held_out(found: Mapping[str, list[Row]]) -> list[str]:
    """Held-out residuals over those of least squares with the right set."""
    lines = []
    for engine, rows in found.items():
        for r in rows:
            best, own = r["truth"].get("engineer"), r["answer"].get("predicted")
            if r["set"] == "measured" and best and own:
                lines.append(
                    f"| {r['case']} | {engine} | {own:.3g} | {best:.3g} | {own / best:.2f} |"
                )
    head = ["| case | engine | rms held out | engineer | ratio |", "|---|---|---|---|---|"]
    return [*head, *sorted(lines)] if lines else []


def picture(found: Mapping[str, list[Row]]) -> str:
    """Right names and wrong names of each engine, with intervals, as SVG."""
    bars = []
    for engine, rows in found.items():
        c = counts(rows)
        bars.append((engine, rate(*c["right"]), rate(*c["wrong"]), len(rows)))
    left, wide, step = 150, 250, 34
    high = 46 + step * len(bars)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left + 2 * wide + 60} {high}" '
           'font-family="sans-serif" font-size="12">',
           f'<rect width="{left + 2 * wide + 60}" height="{high}" fill="white"/>']  # fmt: skip
    for k, title in enumerate(("right, of cases with a cause", "wrong names, of all cases")):
        x = left + k * (wide + 30)
        out.append(f'<text x="{x}" y="16">{title}</text>')
        for tick in (0.0, 0.5, 1.0):
            at = x + tick * wide
            out.append(f'<line x1="{at}" y1="24" x2="{at}" y2="{high - 20}" stroke="#ccc"/>')
            out.append(f'<text x="{at}" y="{high - 6}" text-anchor="middle">{tick:.0%}</text>')
    for j, (engine, *rates, count) in enumerate(bars):
        y = 28 + step * j
        out.append(f'<text x="4" y="{y + 15}">{engine} ({count})</text>')
        for k, ((share, low, top), color) in enumerate(zip(rates, ("#2b6cb0", "#c05621"),
                                                           strict=True)):  # fmt: skip
            x = left + k * (wide + 30)
            share = 0.0 if math.isnan(share) else share
            out.append(f'<rect x="{x}" y="{y}" width="{share * wide:.1f}" height="20" '
                       f'fill="{color}" fill-opacity="0.7"/>')  # fmt: skip
            out.append(f'<line x1="{x + low * wide:.1f}" y1="{y + 10}" x2="{x + top * wide:.1f}" '
                       f'y2="{y + 10}" stroke="black"/>')  # fmt: skip
    return "\n".join([*out, "</svg>", ""])


#: Published figures of measured machines: case, what, figure, source.
PUBLISHED = (
    ("tanks", "rms of the validation record, V", "0.343 to 0.757", "benchmark of 2016"),
    ("bouc_wen", "rms of the test record, mm (here a part of it)", "0.012", "benchmark of 2016"),
)
#: Published parameters of EMPS, of the benchmark of 2019.
EMPS = {"mass": (95.1, "kg"), "viscous": (203.5, "N s/m"), "dry friction": (20.4, "N")}
#: Rms of published models of the Silverbox [mV]: multisine, arrow, arrow without extrapolation.
SILVERBOX = {"FROLS, published": "8.5 | 16.2 | 7.5", "black boxes, published": "0.26 to 4 | | "}


def _official(found: Mapping[str, list[Row]], path: Path) -> list[str]:
    """Numbers of benchmarks beside published ones."""
    lines = ["## Official numbers", ""]
    if path.exists():
        lines += [
            "Silverbox (Wigren and Schoukens 2013), rms of the simulated output on the official "
            "test records. Only multisines were fitted; 50 samples fit the start of a record. "
            "`python bench/causes/official.py silverbox.npz`:", "",
            "| model | multisine, mV | arrow, mV | arrow without extrapolation, mV |",
            "|---|---|---|---|",
        ]  # fmt: skip
        for name, row in json.loads(path.read_text("utf-8"))["silverbox"].items():
            more = "with quadratic stiffness" if name.startswith("6") else "cubic oscillator"
            cells = " | ".join(f"{v:.3f}" for v in row["rms_mV"].values())
            lines.append(f"| least squares, {name} ({more}) | {cells} |")
        lines += [f"| {name} | {cells} |" for name, cells in SILVERBOX.items()]
        lines.append("")
    rows = {(e, r["case"]): r["answer"] for e, some in found.items() for r in some}
    own = []
    for (case, what, figure, source), e in itertools.product(PUBLISHED, found):
        v = rows.get((e, case), {}).get("predicted")
        if v:
            v *= 1e3 if ", mm" in what else 1.0
            own.append(f"| {case}: {what} | {e} | {v:.3g} | {figure} ({source}) |")
    for e in found:
        answer = rows.get((e, "emps"))
        told = {**answer["parameters"], **answer["magnitudes"]} if answer else {}
        own += [f"| EMPS: {n}, {unit} | {e} | {told[n][0]:.4g} | {v:g} (benchmark of 2019) |"
                for n, (v, unit) in EMPS.items() if n in told]  # fmt: skip
    if own:
        lines += ["| what | engine | here | published |", "|---|---|---|---|", *own]
    return lines if len(lines) > 2 else []


def _not_run(found: Mapping[str, list[Row]], sizes: Mapping[str, int]) -> list[str]:
    """What the page does not know."""
    lines = []
    for engine in [*SEEN, *(e for e in found if e not in SEEN)]:
        own = [r["set"] for r in found.get(engine, ())]
        missing = [f"{n} ({size - own.count(n)} of {size} cases)"
                   for n, size in sizes.items() if own.count(n) < size]  # fmt: skip
        if missing:
            lines.append(f"- {engine}: {', '.join(missing)}")
    return ["## Not run", "", *lines] if lines else []


def write_page(results: Path, docs: Path, sizes: Mapping[str, int]) -> None:
    """Write docs/validation/leaderboard.md and its picture; ``sizes``: cases of each set."""
    found = read(results)
    lines = [
        "# Leaderboard of causes", "",
        "How often does a method name the right cause? Each case is a folder of records, a model "
        "that lacks something (or nothing), and candidates. The truth is sealed by its SHA-256 "
        "before an engine sees the folder. All engines have the same limit of processor time and "
        "the same simulations. Losses are printed as wins are. The rows are those of "
        "`bench/causes/results`; `python bench/causes/run.py --page` writes this page from them.",
        "", *_first(found), "![rates of right and wrong names](../img/leaderboard.svg)", "",
        "Shares have 95 % intervals of Clopper and Pearson. The number beside a name is the number "
        "of its cases; engines that ran other cases cannot be compared by the picture alone. "
        "Marks: *right*, each true cause (or an accepted equivalent) is named and nothing false; "
        "*part*, some of several; *class*, it is in a told class, or a look-alike is named alone; "
        "*silent*; *wrong*, a false name; *none*, no answer. A control is *quiet*, *unknown* or a "
        "*false alarm*. If no candidate is the cause, *right* is to say that something unknown "
        "acts.",
        "", "## What each engine sees", "", "| engine | sees, and is set so | version |",
        "|---|---|---|",
    ]  # fmt: skip
    for engine, rows in found.items():
        versions = sorted({r["version"] for r in rows if r["version"]})
        lines.append(
            f"| {engine} | {SEEN.get(engine, 'the case folder')} | {', '.join(versions)} |"
        )
    for name in ORDER:
        if any(r["set"] == name for rows in found.values() for r in rows):
            lines += ["", f"## {name.capitalize()}", "", *_table(found, name)]
            lines += ["", *_cases(found, name)] if name not in UNLISTED else []
        if name == "measured" and (ratios := held_out(found)):
            lines += ["", "Held-out residual beside least squares with the right set:", "", *ratios]
    lines += ["", *_official(found, results / "official.json")]
    lines += ["", *_not_run(found, sizes)]
    text = "\n".join(lines).rstrip() + "\n"
    (docs / "validation" / "leaderboard.md").write_text(text, encoding="utf-8")
    (docs / "img").mkdir(exist_ok=True)
    (docs / "img" / "leaderboard.svg").write_text(picture(found), encoding="utf-8")
