"""The interactive blind bench of the whole action in the linear model: every effect, all policies.

The interactive bench (experiments.py) needs a minute for each diagnosis of the whole action, so
that it can run a few cases only. Here the machine and the diagnosis are linear: the data of an
experiment with the information matrix I over tolerances and effects are

    b = I x + L z,    L L' = I,    z ~ N(0, 1),

x the deviations of the tolerances, drawn from their priors, and the magnitude of the true effect.
The diagnosis is one linear step (Knowledge.linear_belief). A plan takes the experiment that
promises most of a pool of strokes and of the tests of parts, as gap.design does, and is made anew
after every experiment. What this leaves out: fits that do not find their minimum, nonlinear
effects, other forms of effects, and strokes that are optimized beyond the pool.

    PYTHONPATH=bench python -m blind.linear_experiments -o FOLDER [--pool 60] [--nulls 60]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from feltmb.gap.designs import LEAST_PLAN_GAIN
from feltmb.gap.information import Information, Knowledge, information, planned

from blind.action_requests import ActionRequests
from blind.action_truth import NOISE_CAMERA
from blind.interactive import drawn_size
from blind.score import wilson
from feltmb import gap
from feltmb.adapters import MechanismModel, planned_strokes
from feltmb.data import Array
from feltmb.files import Store, make_folder, write_text
from feltmb.gap.score import all_candidates

__all__ = ["Bench", "Truth", "outcome"]

ROUNDS = (0, 1, 2, 4, 6)
POLICIES = ("designed", "random", "repeats")
#: Output of a load cell, which keeps its noise.
FORCE = "finger.force"
#: Probability that a name requires.
NAME = 0.9


@dataclass(frozen=True)
class Truth:
    """A case: deviations of the tolerances, and at most one effect."""

    number: int
    effect: str
    x: Array
    """Deviations of the parameters [their units], then magnitudes of the candidates [scales]."""


def outcome(truth: Truth, belief: gap.Belief) -> str:
    """right, class, wrong or silent; quiet or alarm without an effect."""
    order = sorted(belief.weights, key=lambda n: -belief.weights[n])
    best = belief.weights[order[0]]
    two = sum(belief.weights[n] for n in order[:2])
    said = order[:1] if best >= NAME else order[:2] if two >= NAME else []
    if not truth.effect:
        return "alarm" if said else "quiet"
    if not said:
        return "silent"
    if truth.effect not in said:
        return "wrong"
    return "right" if len(said) == 1 else "class"


class Bench:
    """A pool of experiments of the whole action, and cases that are played in the linear model."""

    def __init__(self, pool: int, *, seed: int, store: Store | None = None, sigma: float) -> None:
        machine = ActionRequests()
        model = machine.model
        assert isinstance(model, MechanismModel)
        self.model, self.effects = model, machine.effects
        self.every = all_candidates(machine.effects)
        strokes = planned_strokes(model)
        sensors = {
            n: s if n == FORCE else replace(s, sigma=sigma) for n, s in strokes[0].sensors.items()
        }
        found = [information(model, planned(model, r, sensors), self.every, store=store)
                 for r in strokes]  # fmt: skip
        self.known = [f for f in found if f is not None]
        self.strokes: list[Information] = []
        for k in range(pool):
            record = gap.draw_experiment(
                model, machine.limits, sensors=sensors, seed=10_000 * seed + k
            )[2]
            made = information(model, record, self.every, store=store)
            if made is not None:
                self.strokes.append(made)
            print(f"stroke {k + 1} of {pool}", flush=True)
        self.even = gap.Belief.even(self.every)
        start = Knowledge.start(model, self.every, self.even)
        self.tests = {t.parameter: start.part(t.parameter, t.sd) for t in machine.limits.parts}
        self.roots: dict[int, Array] = {}

    def truths(self, nulls: int, seed: int) -> list[Truth]:
        """One case for each effect of the library, then ``nulls`` cases without an effect."""
        names = list(dict.fromkeys(t.name for t in self.every))
        out = []
        for number, name in enumerate([*names, *[""] * nulls]):
            rng = np.random.default_rng([seed, number])
            sd = np.array([p.sd for p in self.model.parameters])
            x = np.concatenate([sd * rng.standard_normal(sd.size), np.zeros(len(self.every))])
            if name:
                own = [i for i, t in enumerate(self.every) if t.name == name]
                at = own[int(rng.integers(len(own)))]
                low, high = self.every[at].effect.bounds
                size = drawn_size(1.0, rng)
                if (low < 0.0 and rng.random() < 0.5) or high <= 0.0:
                    size = -size
                x[sd.size + at] = np.clip(size, *(np.array([low, high]) /
                                                  self.every[at].effect.scale))  # fmt: skip
            out.append(Truth(number, name, x))
        return out

    def measured(self, made: Information, x: Array, rng: np.random.Generator) -> Information:
        """Data of an experiment."""
        key = id(made)
        if key not in self.roots:
            value, vector = np.linalg.eigh(made.matrix)
            self.roots[key] = vector * np.sqrt(np.maximum(value, 0.0))
        noise = self.roots[key] @ rng.standard_normal(x.size)
        return Information(made.matrix, made.matrix @ x + noise)

    def play(self, truth: Truth, policy: str, seed: int) -> list[dict[str, Any]]:
        """Results after 0 to 6 experiments."""
        rng = np.random.default_rng([seed, truth.number, POLICIES.index(policy)])
        first = np.random.default_rng([seed, truth.number, 9])  # the same for all policies
        data = [self.measured(k, truth.x, first) for k in self.known]
        tested: list[str] = []
        rows: list[dict[str, Any]] = []
        promised, ended = float("nan"), False
        for count in range(ROUNDS[-1] + 1):
            belief = Knowledge.start(self.model, self.every, self.even, data).linear_belief()
            if count in ROUNDS:
                true = belief.weights[truth.effect] if truth.effect else belief.none
                rows.append({"experiments": count, "outcome": outcome(truth, belief),
                             "true": true, "promised": promised, "tests": len(tested)})  # fmt: skip
            if count == ROUNDS[-1] or ended:
                continue
            now = Knowledge.start(self.model, self.every, belief, data)
            if policy == "repeats":
                data.append(self.measured(self.known[count % len(self.known)], truth.x, rng))
                continue
            if policy == "random":
                k = int(rng.integers(len(self.strokes)))
                data.append(self.measured(self.strokes[k], truth.x, rng))
                continue
            left = [n for n in self.tests if n not in tested]
            options = [*self.strokes, *(self.tests[n] for n in left)]
            worth = np.array([now.plus(o).names() for o in options])
            best = int(np.argmax(worth))
            if worth[best] - now.names() < LEAST_PLAN_GAIN:
                ended = True
                continue
            promised = float(worth[best])
            if best >= len(self.strokes):
                tested.append(left[best - len(self.strokes)])
            data.append(self.measured(options[best], truth.x, rng))
        return rows


def table(results: dict[str, list[tuple[Truth, list[dict[str, Any]]]]]) -> str:
    """Scores by policy and number of experiments, as Markdown."""
    lines = [
        "| policy | experiments | right | class of two | right or class (95 %) | wrong | silent | "
        "false alarms | probability of the truth: promised, found |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for policy, cases in results.items():
        for k, count in enumerate(ROUNDS):
            rows = [(t, r[k]) for t, r in cases if len(r) > k]
            told = [r["outcome"] for t, r in rows if t.effect]
            nulls = [r["outcome"] for t, r in rows if not t.effect]
            if not told:
                continue
            share, low, high = wilson(sum(o in ("right", "class") for o in told), len(told))
            of = {o: sum(x == o for x in told) / len(told) for o in
                  ("right", "class", "wrong", "silent")}  # fmt: skip
            both = [(r["promised"], r["true"]) for t, r in rows
                    if t.effect and r["promised"] == r["promised"]]  # fmt: skip
            promise = "-"
            if both:
                promise = ", ".join(f"{v:.0%}" for v in np.mean(both, axis=0))
            alarms = f"{sum(o == 'alarm' for o in nulls)} of {len(nulls)}"
            lines.append(
                f"| {policy} | {count} | {of['right']:.0%} | {of['class']:.0%} | {share:.0f} % "
                f"({low:.0f} to {high:.0f}) | {of['wrong']:.1%} | {of['silent']:.0%} | {alarms} | "
                f"{promise} |"
            )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Play all cases with all policies, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--pool", type=int, default=60)
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sigma", type=float, default=NOISE_CAMERA, help="of the cameras [m]")
    parser.add_argument("--cases", type=int, help="only so many cases, evenly chosen")
    given = parser.parse_args(arguments)
    folder = make_folder(given.out)
    store = Store(folder / "store")
    bench = Bench(given.pool, seed=given.seed, store=store, sigma=given.sigma)
    truths = bench.truths(given.nulls, given.seed)
    if given.cases:
        chosen = np.linspace(0, len(truths) - 1, min(given.cases, len(truths))).round()
        truths = [truths[int(k)] for k in chosen]
    results: dict[str, list[tuple[Truth, list[dict[str, Any]]]]] = {}
    for policy in ("repeats", "random", "designed"):
        results[policy] = []
        for truth in truths:
            rows = bench.play(truth, policy, given.seed)
            results[policy].append((truth, rows))
            print(policy, truth.number, truth.effect or "-", [r["outcome"] for r in rows],
                  flush=True)  # fmt: skip
        plain = {p: [{"effect": t.effect, "rounds": r} for t, r in own]
                 for p, own in results.items()}  # fmt: skip
        write_text(folder / "cases.json", json.dumps(plain, indent=1) + "\n", force=True)
        write_text(folder / "table.md", table(results), force=True)
    print(f"\n{len(bench.effects)} effects, {len(bench.strokes)} strokes, "
          f"{len(bench.tests)} tests of parts\n\n{table(results)}")  # fmt: skip


if __name__ == "__main__":
    main()
