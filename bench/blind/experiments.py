"""The interactive blind bench: a machine with a sealed truth answers requests.

The diagnosing side gets default records, may ask for further experiments within limits, and is
scored after 0, 1, 2, 4 and 6 of them (--rounds): designed ones (planned anew after each score),
ones that are drawn at random from the same limits, and repeats of the default strokes (after the
last round only). The machine is the small one (key_hammer) or the whole action (steinway45).

Scored is the screen of the diagnosis: a fit of the model alone to all records, the scores of all
effects there, and the log evidence of each alone. A name needs a belief of 90 % and a score that
nothing reaches by chance in 99 of 100; a class of two 90 % together. With --diagnose the whole
diagnosis is scored, every second experiment held out: that takes ten times as long.

    python bench/blind/experiments.py --cases 20 --seed 26 -o out/experiments
    python bench/blind/experiments.py --machine steinway45 --cases 20 --seed 26 -o out/action

Folder: seal.json (hash of the truths), truths.json, cases/N.json (what was asked, measured and
said), score.md, calibration.json, calibration.png. A bench that was cut off goes on where it was.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


from feltmb.fit.solve import FitSettings
from feltmb.gap.information import Knowledge, information
from feltmb.gap.spread import spread
from feltmb.gap.tabulated import given_values

from blind.action_requests import ActionRequests
from blind.interactive import Asked, Interactive
from blind.machine import as_json, sha256
from blind.small_requests import SmallRequests
from feltmb import gap
from feltmb.cli import main
from feltmb.data import Record
from feltmb.errors import InvalidParameter
from feltmb.files import make_folder, read_json, write_file, write_text
from feltmb.gap.measured import known_by_test
from feltmb.gap.report import report_json
from feltmb.gap.score import all_candidates, family_threshold, score_fit, screen_sets

__all__ = ["MACHINES", "ROUNDS", "command", "outcome_of"]

#: Numbers of experiments after which a diagnosis is scored.
ROUNDS = (0, 1, 2, 4, 6)
#: Largest of these numbers.
MOST_EXPERIMENTS = 1000
POLICIES = ("designed", "random", "repeats")
#: Machines by name.
MACHINES: dict[str, Callable[[], Interactive]] = {
    "key_hammer": SmallRequests,
    "steinway45": ActionRequests,
}
#: Probability that a name requires.
NAME = 0.9


def outcome_of(case: Any, report: Mapping[str, Any], same_number: str = "") -> str:
    """right, class (of two), more, wrong, silent or unknown; without an effect quiet or alarm.

    ``same_number``: parameter of the model that the true effect changes too. A test of its part
    that differs from the table is the right answer.
    """
    named, one_of = list(report["named"]), list(report["one_of"])
    verdict = report["verdict"]
    quiet = verdict in {
        str(v)
        for v in gap.Verdict
        if v.name in ("NO_GAP", "CALIBRATED", "TOO_WEAK", "NOT_COMPLETE")
    }
    if quiet:  # the test of a part may have found the cause
        named = list(report.get("given", ()))
    if not case.parts:
        return "quiet" if quiet and not named else "alarm"
    true = {case.parts[0].name, same_number or case.parts[0].name}
    if named:
        if set(named) <= true:
            return "right"
        return "more" if true & set(named) else "wrong"
    if one_of:
        if true & set(one_of):
            return "class" if len(one_of) <= 2 else "large class"
        return "wrong"
    return "silent" if quiet else "unknown"


def evidence_of(case: Any, sets: Mapping[tuple[str, ...], float]) -> float:
    """Log evidence of the best set with the true effect relative to the best one without it."""
    true = case.parts[0].name
    own = max((v for names, v in sets.items() if true in names), default=math.nan)
    return own - max([0.0, *(v for names, v in sets.items() if true not in names)])


@dataclass
class Seen:
    """Result of one scoring."""

    row: dict[str, Any]
    belief: gap.Belief
    sets: Mapping[tuple[str, ...], float]
    """Log evidence of each set of effects relative to the model, prior included."""


class Player:
    """The diagnosing side, which gets records and tests of parts, but no truth."""

    def __init__(self, machine: Interactive, *, whole: bool):
        self.model, self.library = machine.model, machine.effects
        self.allowed, self.families = machine.limits, machine.families
        self.whole = whole
        self.every = all_candidates(self.library)

    def see(self, records: Sequence[Record], parts: Sequence[gap.Measured]) -> Seen:
        """Compare the model, with tests of parts, with all records."""
        model = gap.with_measured(self.model, parts, self.library)
        return self._diagnosed(model, records) if self.whole else self._screened(model, records)

    def _diagnosed(self, model: gap.Model, records: Sequence[Record]) -> Seen:
        options = gap.Options(bootstrap=0, width=2, max_effects=2, advice=False)
        report = gap.diagnose(model, self.library, records, options=options)
        sets = {s.effects: s.evidence for s in report.which.sets if s.refitted}
        row = {
            "verdict": str(report.verdict),
            "named": list(report.named),
            "one_of": list(report.one_of),
            "given": [g.name for g in report.given if g.differs],
        }
        return Seen(row, gap.Belief.of_report(report_json(report)), sets)

    def _screened(self, model: gap.Model, records: Sequence[Record]) -> Seen:
        fit = gap.fit_model(model, records, settings=FitSettings(restarts=0))
        every = self._left(model)
        scores = score_fit(fit, every)
        found = {every[x.index[0]].name: x for x in screen_sets(scores, largest=1)[::-1]}
        sets = {n: x.evidence for n, x in found.items()}
        top = max([0.0, *sets.values()])
        weights = {n: math.exp(v - top) for n, v in sets.items()}
        total = sum(weights.values()) + math.exp(-top)
        weights = {n: w / total for n, w in weights.items()}
        order = sorted(weights, key=lambda n: -weights[n])
        level = family_threshold(scores, 0.01, draws=4000)[0]
        given = [g.name for g in given_values(fit, spread(fit), model, 0.01) if g.differs]
        row: dict[str, Any] = {"verdict": "NO GAP", "named": [], "one_of": [], "given": given}
        if order and found[order[0]].statistic / scores.inflation > level:
            row["verdict"] = "UNKNOWN"
            if weights[order[0]] > NAME:
                row |= {"verdict": "NAMED", "named": order[:1]}
            elif sum(weights[n] for n in order[:2]) > NAME:
                row |= {"verdict": "ONE OF", "one_of": order[:2]}
        scale = {t.name: t.effect.scale for t in every}
        sizes = {n: abs(found[n].magnitudes[0]) * scale[n] for n in order if weights[n] > 0.01}
        belief = gap.Belief(weights=weights, none=math.exp(-top) / total, magnitudes=sizes)
        row["misfit"] = fit.chi2 / fit.dof
        return Seen(row, belief, {(n,): v for n, v in sets.items()})

    def plan(
        self, records: Sequence[Record], parts: Sequence[gap.Measured], belief: gap.Belief,
        budget: float, seed: int,
    ) -> gap.Design:  # fmt: skip
        return gap.design(
            gap.with_measured(self.model, parts, self.library), self.library, records,
            limits=self.allowed.without_tests(m.parameter for m in parts), budget=budget,
            belief=belief, families=self.families, candidates=16, refinements=6, seed=seed,
        )  # fmt: skip

    def _left(self, model: gap.Model) -> tuple[gap.Candidate, ...]:
        """Candidates that no test of a part has measured."""
        own = {t.name for t in model.own_effects}
        return tuple(
            t for t in self.every if t.name not in own and not known_by_test(t.effect, model)
        )

    def same(self, case: Any) -> str:
        """Parameter of the model that changes the same number as the true effect; "": none."""
        own = {e.name: e.tolerance_parameter for e in self.library}
        return own.get(case.parts[0].name, "") if case.parts else ""

    def expected(
        self, case: Any, records: Sequence[Record], parts: Sequence[gap.Measured]
    ) -> float:
        """Log evidence of the true effect relative to its best rival, as expected by the plan.

        The bench uses it for the calibration; the planning side does not know it.
        """
        true = case.parts[0]
        model = gap.with_measured(self.model, parts, self.library)
        every = self._left(model)
        known = [information(model, r, every) for r in records]
        knowledge = Knowledge.start(
            model, every, gap.Belief.even(every), [k for k in known if k is not None]
        )
        at = [t.name for t in every].index(true.name)
        row = knowledge.evidence()[at]
        rest = np.delete(row, [i for i, t in enumerate(every) if t.name == true.name])
        return float((true.size / every[at].effect.scale) ** 2 * np.min(rest))


@dataclass
class Case:
    """One running case with one policy."""

    truth: Any
    records: list[Record]
    parts: list[gap.Measured]
    belief: gap.Belief
    asked: list[str]
    rows: list[dict[str, Any]]
    spent: float = 0.0
    number: int = 0
    """Number of requested records; tests of parts do not count."""


def run_cases(
    player: Player, machine: Interactive, cases: Sequence[Any], folder: Path,
    policies: Sequence[str], left: Callable[[], bool], rounds: Sequence[int] = ROUNDS,
) -> None:  # fmt: skip
    """Run cases with all policies; the requests of all cases are integrated together."""

    def path(case: Any) -> Path:
        return make_folder(folder / "cases") / f"{case.number}.json"

    def keep(case: Any, **more: Any) -> None:
        found = read_json(path(case)) if path(case).exists() else {"number": case.number}
        text = json.loads(json.dumps({**found, **more}), parse_constant=lambda _: None)
        write_text(path(case), as_json(text), force=True)

    default: dict[int, tuple[dict[str, Any], gap.Belief]] = {}

    def score(own: Case) -> dict[str, Any]:
        if own.asked:
            return scored_anew(own)
        # Without experiments all policies have the same records.
        if own.truth.number not in default:
            default[own.truth.number] = (scored_anew(own), own.belief)
        row, own.belief = default[own.truth.number]
        return dict(row)

    def scored_anew(own: Case) -> dict[str, Any]:
        clock = time.process_time()
        try:
            seen = player.see(own.records, own.parts)
        except Exception as error:  # a crash counts as a bad result
            return {"outcome": "failed", "error": f"{type(error).__name__}: {error}"}
        own.belief = seen.belief
        row = {**seen.row, "outcome": outcome_of(own.truth, seen.row, player.same(own.truth))}
        row["cpu_seconds"] = time.process_time() - clock
        made = {m.parameter for m in own.parts}
        if own.truth.parts and not made & {own.truth.parts[0].name, player.same(own.truth)}:
            row["evidence"] = evidence_of(own.truth, seen.sets)
            row["expected"] = player.expected(own.truth, own.records, own.parts)
        return row

    def scored(policy: str) -> list[int]:
        """Numbers of experiments after which a policy is scored."""
        return [n for n in rounds if policy != "repeats" or n in (0, rounds[-1])]

    def done(case: Any, policy: str) -> bool:
        found = read_json(path(case)) if path(case).exists() else {}
        counts = [r["experiments"] for r in found.get(policy, {}).get("rounds", [])]
        # Plans are made anew after each score: results of other rounds are of other experiments.
        if counts != scored(policy)[: len(counts)]:
            raise InvalidParameter(
                f"{path(case)}: {policy} was scored after {', '.join(map(str, counts))} "
                f"experiments, got --rounds {','.join(map(str, rounds))}; give these rounds or "
                "another folder"
            )
        return len(counts) == len(scored(policy))

    left_out = {(c.number, p) for p in policies for c in cases if done(c, p)}
    first = machine.defaults(cases)
    for policy in policies:
        todo = [
            Case(c, list(r), [], gap.Belief(weights={}), [], [])
            for c, r in zip(cases, first, strict=True)
            if (c.number, policy) not in left_out
        ]
        for until in rounds:
            owners: list[Case] = []
            batch: list[Asked] = []
            for own in todo if left() else []:
                for asked in ask(player, machine, policy, own, until):
                    owners.append(own)
                    batch.append(asked)
            for own, record in zip(owners, machine.records(batch), strict=True):
                own.records.append(record)
            if until not in scored(policy):
                continue
            for own in todo:
                if left():
                    own.rows.append({"experiments": until, **score(own)})
                    keep(own.truth, **{policy: {"rounds": own.rows, "asked": own.asked}})


def ask(player: Player, machine: Interactive, policy: str, own: Case, until: float) -> list[Asked]:
    """Requests of the next round; tests of parts are performed here."""
    out: list[Asked] = []
    chosen: list[Any] = []
    if policy == "designed" and own.spent < until - 1e-9:
        left = until - own.spent
        plan = player.plan(own.records, own.parts, own.belief, left, own.truth.number)
        chosen = list(plan.experiments)
    while own.spent < until - 1e-9:
        if policy == "designed":
            if not chosen:
                break
            e = chosen.pop(0)
            name = e.name
            own.spent += e.cost
            if e.part is not None:
                own.parts.append(machine.part(own.truth, e.part, len(own.parts) + 1))
                own.asked.append(name)
                continue
            values = machine.input_of(e.record)
        elif policy == "random":
            seed = 1000 * own.truth.number + own.number + 1
            sensors = own.records[0].sensors
            _, profile, r = gap.draw_experiment(
                player.model, player.allowed, sensors=sensors, families=player.families, seed=seed
            )
            values, name = machine.input_of(r), profile.family
            own.spent += 1.0
        else:
            name, values = machine.default(own.number)
            own.spent += 1.0
        own.number += 1
        own.asked.append(name)
        out.append(Asked(own.truth, f"experiment_{own.number}", np.asarray(values), own.number))
    return out


def _seal(
    machine: Interactive,
    folder: Path,
    truths: Sequence[Any],
    seed: int,
    *,
    whole: bool | None = None,
    new: bool = True,
) -> None:
    """Write the truths and their hash before any diagnosis.

    ``whole``: whether the whole diagnosis is scored; None: as it was sealed. ``new``: whether a
    folder without a seal becomes a bench.
    """
    text = as_json([asdict(t) for t in truths])
    path = folder / "seal.json"
    if path.exists():
        seal = read_json(path)
        if seal["truths_sha256"] != sha256(text.encode()):
            of = seal.get("machine", SmallRequests.name)  # once the only one
            raise InvalidParameter(
                f"{folder}: was sealed with {seal['cases']} cases of seed {seal['seed']} of "
                f"{of}, got {len(truths)} of seed {seed} of {machine.name} or another "
                "generator; give these or another folder"
            )
        kept = seal.get("diagnose")  # missing: sealed by an older version, or without a call
        if whole is not None and kept is None:
            write_text(path, as_json({**seal, "diagnose": whole}), force=True)
        elif whole is not None and kept != whole:
            was, now = ("--diagnose" if w else "no --diagnose" for w in (kept, whole))
            raise InvalidParameter(
                f"{folder}: its results are with {was}, got {now}; one table cannot hold both. "
                f"Give {was}, or another folder"
            )
        return
    if not new:
        raise InvalidParameter(
            f"{folder}: is no bench: seal.json is missing; omit --score-only to make one"
        )
    make_folder(folder)
    write_text(folder / "truths.json", text, force=True)
    seal = {
        "machine": machine.name,
        "cases": len(truths),
        "seed": seed,
        "sealed": datetime.now(UTC).isoformat(timespec="seconds"),
        "truths_sha256": sha256(text.encode()),
    }
    if whole is not None:
        seal["diagnose"] = whole
    write_text(path, as_json(seal))


def table(folder: Path, truths: Sequence[Any]) -> str:
    """Outcomes by policy and round, and the calibration, as Markdown."""
    done = [read_json(p) for p in sorted((folder / "cases").glob("*.json"))]
    case = {c.number: c for c in truths}
    words = ("right", "class", "more", "large class", "unknown", "silent", "wrong", "failed")
    lines = [
        "| policy | experiments | n | "
        + " | ".join(words)
        + " | right or class | nulls | alarms |",
        "|---|---|---|" + "---|" * (len(words) + 3),
    ]
    for policy in POLICIES:
        counts = sorted(
            {r["experiments"] for d in done for r in d.get(policy, {}).get("rounds", ())}
        )
        for count in counts:
            rows = [
                (case[d["number"]], r)
                for d in done
                for r in d.get(policy, {}).get("rounds", ())
                if r["experiments"] == count
            ]
            single = [r["outcome"] for c, r in rows if c.parts]
            null = [r["outcome"] for c, r in rows if not c.parts]
            good = sum(o in ("right", "class") for o in single)
            share = f"{good / len(single):.0%}" if single else "-"
            cells = " | ".join(str(single.count(w)) for w in words)
            alarms = sum(o != "quiet" for o in null)
            lines.append(
                f"| {policy} | {count} | {len(single)} | {cells} | {share} | {len(null)} | "
                f"{alarms} |"
            )
    return "\n".join(lines) + "\n"


def calibration(folder: Path, truths: Sequence[Any]) -> list[tuple[str, float, float]]:
    """(policy, expected gain, realized gain) of log evidence from the start to each round."""
    case = {c.number: c for c in truths}
    out = []
    for path in sorted((folder / "cases").glob("*.json")):
        d = read_json(path)
        if not case[d["number"]].parts:
            continue
        for policy in POLICIES:
            rows = d.get(policy, {}).get("rounds", ())
            good = [r for r in rows if None not in (r.get("evidence"), r.get("expected"))]
            if not good or good[0]["experiments"] != 0:
                continue
            for row in good[1:]:
                gains = [row[k] - good[0][k] for k in ("expected", "evidence")]
                out.append((policy, *gains))
    return out


def _plot(points: Sequence[tuple[str, float, float]], path: Path) -> None:
    from feltmb.style import new_figure, style_axes

    figure = new_figure(5.0, 4.5)
    ax = figure.subplots()
    for policy, color in zip(POLICIES, ("#0072B2", "#D55E00", "#999999"), strict=True):
        own = [(e, r) for p, e, r in points if p == policy]
        if own:
            ax.plot(*np.array(own).T, "o", color=color, markersize=4, label=policy, alpha=0.7)
    ends = [0.1, max([10.0, *(e for _, e, _ in points)])]
    ax.plot(ends, ends, color="k", linewidth=0.8)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.set_yscale("symlog", linthresh=1.0)
    style_axes(ax, "expected gain of log evidence", "realized gain", "true effect, best rival")
    ax.legend(frameon=False)
    write_file(path, lambda p: figure.savefig(p, format="png", dpi=110), force=True)


def _rounds(_: click.Context, __: click.Parameter, value: str) -> tuple[int, ...]:
    """Numbers of experiments; they start at 0 and increase."""
    try:
        found = tuple(int(word) for word in value.split(","))
    except ValueError:
        found = ()
    rising = all(a < b for a, b in pairwise(found))
    if not found or found[0] != 0 or found[-1] > MOST_EXPERIMENTS or not rising:
        raise click.BadParameter(
            f"got {value!r}, expected increasing integers from 0 to {MOST_EXPERIMENTS}, as 0,2,4"
        )
    return found


@click.command()
@click.option(
    "--machine", "of", default="key_hammer", show_default=True, type=click.Choice([*MACHINES])
)
@click.option("--cases", type=click.IntRange(1, 10_000), default=20, show_default=True)
@click.option("--seed", type=click.IntRange(0), default=26, show_default=True)
@click.option("--out", "-o", "output", type=click.Path(path_type=Path), required=True)
@click.option("--until", type=float, default=math.inf, help="Stop after so many seconds [s].")
@click.option("--policy", "policies", multiple=True, type=click.Choice(POLICIES))
@click.option(
    "--rounds",
    default=",".join(map(str, ROUNDS)),
    show_default=True,
    metavar="N,N,...",
    callback=_rounds,
    help="Numbers of experiments after which the diagnosis is scored, in increasing order.",
)
@click.option("--diagnose", "whole", is_flag=True, help="Score the whole diagnosis.")
@click.option("--score-only", is_flag=True)
def command(
    of: str, cases: int, seed: int, output: Path, until: float, policies: tuple[str, ...],
    rounds: Sequence[int], whole: bool, score_only: bool,
) -> None:  # fmt: skip
    """Sealed cases of a machine; experiments that are designed, random, or repeats."""
    machine = MACHINES[of]()
    truths = [machine.draw(seed, n) for n in range(cases)]
    # --score-only alone takes the results that are there, whatever they are.
    told = None if score_only and not whole else whole
    _seal(machine, output, truths, seed, whole=told, new=not score_only)
    began = time.monotonic()
    if not score_only:
        player = Player(machine, whole=whole)
        for n in range(0, cases, machine.together):
            run_cases(
                player, machine, truths[n : n + machine.together], output, policies or POLICIES,
                lambda: time.monotonic() - began < until, rounds,
            )  # fmt: skip
            click.echo(
                f"{min(cases, n + machine.together)} cases: {time.monotonic() - began:.0f} s",
                err=True,
            )
            if time.monotonic() - began > until:
                break
    text = table(output, truths)
    points = calibration(output, truths)
    if points:
        _plot(points, output / "calibration.png")
    write_text(output / "score.md", text, force=True)
    write_text(output / "calibration.json", as_json(points), force=True)
    click.echo(text)


if __name__ == "__main__":
    main(command=command, name="experiments.py")
