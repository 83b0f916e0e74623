"""Findings of the thesis: variants of the action, their numbers, and what is claimed about them.

Usage: python bench/thesis_studies/findings.py [NAME ...] [--out FOLDER] [--jobs N]

The TOML files of this folder state the variants, numbers, findings and figures; their formulas are
Python expressions of names of a run. Without names, all are run. ``--out`` writes the numbers as
CSV and the figures as PNG.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

import feltmb
from feltmb.run.arrays import summary_unit
from feltmb.run.batch import simulate_many
from unmodeled.errors import Error
from unmodeled.units import to_si

FOLDER = Path(__file__).parent
#: In the order of the figures of the thesis.
NAMES = ("wire", "wire_vibration", "shank", "string", "hysteresis", "staccato", "shapes", "axial",
         "letoff", "input", "contact-law")  # fmt: skip
FUNCTIONS = {"abs": abs, "max": max, "min": min, "sqrt": math.sqrt}
COUNTS = ("steps", "rhs", "reversals", "wall")


class Absent(Exception):
    """A number that a run does not have."""


# ------------------------------------------------------------------------------ numbers of a run


class Names(dict[str, Any]):
    """Names of a formula over time: ``hammer_tip.x`` is an output of a run."""

    def __init__(self, run: Any, scalars: dict[str, float], still: set[str]):
        super().__init__(scalars | FUNCTIONS)
        self.run, self.still = run, still

    def __missing__(self, part: str) -> Any:
        names = self

        class Part:
            def __getattr__(self, output: str) -> Any:
                name = f"{part}.{output}"
                if name in names.still:
                    return np.zeros_like(names.run.time)
                if name not in names.run:
                    raise Absent(name)
                return names.run[name]

        return Part()


def evaluate(text: str, names: dict[str, Any]) -> Any:
    """Value of a formula of a file of this folder."""
    try:
        # As numbers: a name that a run does not have is a part without an output.
        return np.asarray(eval(text, {"__builtins__": {}}, names), dtype=float)
    except (TypeError, ValueError, ZeroDivisionError) as error:
        raise Absent(f"{text}: {error}") from None


def statistic(stat: str, time: Any, y: Any, level: float = 0.0) -> float:
    """A statistic of samples at even times; NaN if it does not exist.

    ``settles``: time from which it stays within ``level`` of its last value; ``returns``: of its
    first value; ``pulses``: times above ``level``, where gaps shorter than 1 % of the series do not
    count; ``swing_back``: maximum minus the smallest later value; ``frequency``: that of the
    largest spectral line with at least three periods [Hz].
    """
    length = time[-1] - time[0]
    above = y > level
    if stat == "frequency":
        if np.ptp(y) < 1e-9:  # rounding
            return math.nan
        power = np.abs(np.fft.rfft((y - np.mean(y)) * np.hanning(y.size), 8 * y.size))
        lines = np.fft.rfftfreq(8 * y.size, length / (time.size - 1))
        power[lines < 3.0 / length] = 0.0
        return float(lines[int(np.argmax(power))])
    if stat in ("settles", "returns"):
        away = np.nonzero(np.abs(y - y[-1 if stat == "settles" else 0]) > level)[0]
        after = 0 if away.size == 0 else away[-1] + 1
        return float(time[after]) if after < time.size else math.nan
    if stat == "pulses":
        return float(np.count_nonzero(np.diff(time[above]) > 0.01 * length) + int(above.any()))
    simple = {
        "last": lambda: y[-1],
        "min": lambda: np.min(y),
        "max": lambda: np.max(y),
        "span": lambda: np.ptp(y),
        "rms": lambda: np.std(y),
        "variation": lambda: np.sum(np.abs(np.diff(y))),
        "time_above": lambda: np.count_nonzero(above) * length / (time.size - 1),
        "swing_back": lambda: np.max(y) - np.min(y[np.argmax(y) :]),
    }
    return float(simple[stat]())


def series_key(panel: dict[str, Any]) -> str:
    """Key of the samples of a panel."""
    return json.dumps([panel["output"], panel.get("from"), panel.get("to"), panel.get("from_rest")])


def extract(
    run: Any, action: Any, wanted: dict[str, Any], panels: list[dict[str, Any]]
) -> tuple[dict[str, float], dict[str, Any]]:
    """Numbers and series of a run; those that it does not have are absent."""
    scalars = dict(run.summary) | {k: float(run.stats[k]) for k in COUNTS if k in run.stats}
    config = action.config
    # A part that is switched off has no output.
    still = {f"{name}.force" for name, strap in config.straps.items() if not strap.enabled}
    if config.string is not None and config.string.kind == "rigid_stop":
        still |= {"string.strike", "string.bridge_force"}
    numbers: dict[str, float] = {}

    def part(entry: dict[str, Any]) -> tuple[Any, Any]:
        names = Names(run, scalars | numbers, still)
        ends = [evaluate(str(entry.get(k, d)), names) for k, d in (("from", -1.0), ("to", 1e9))]
        chosen = (run.time >= float(ends[0])) & (run.time <= float(ends[1]))
        y = np.broadcast_to(evaluate(entry["output"], names), run.time.shape)
        return run.time[chosen], (y - y[0] if entry.get("from_rest") else y)[chosen]

    for _ in wanted:  # a number may use a later one
        for name, entry in wanted.items():
            try:
                if "output" in entry:
                    time, y = part(entry)
                    value = statistic(entry["stat"], time, y, entry.get("level", 0.0))
                else:
                    text = entry.get("value", name)
                    value = float(evaluate(text, Names(run, scalars | numbers, still)))
            except Absent:
                continue
            if math.isfinite(value):
                numbers[name] = value
    series = {}
    for panel in panels:
        try:
            series[series_key(panel)] = np.stack(part(panel))
        except Absent:
            continue
    return scalars | numbers, series


# ------------------------------------------------------------------------------ a study


@dataclasses.dataclass(frozen=True)
class Case:
    """A variant with a stroke at a point of the axis; ``value`` is None without an axis."""

    variant: str
    stroke: str
    value: Any = None


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Numbers (SI) and series of a run, or why there are none."""

    numbers: dict[str, float]
    series: dict[str, Any]
    error: str = ""


@dataclasses.dataclass(frozen=True)
class Finding:
    """A claim and its outcome: ``agrees``, ``depends``, ``disagrees`` or ``not tested``."""

    says: str
    claim: str
    outcome: str
    sizes: tuple[float, ...] = ()  #: in ``unit``, one for each value of the axis
    unit: str = ""
    held: int = 0
    of: int = 0


class Study:
    """A file of this folder: its simulations, numbers and findings.

    Attributes
    ----------
    spec
        Tables of the file.
    outcomes
        Outcome of each :class:`Case`, after :meth:`run`.
    """

    def __init__(self, name: str):
        self.name = name
        self.spec = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
        self.base = self.spec["base"]
        self.variants: dict[str, dict[str, Any]] = self.spec["variants"]
        self.numbers: dict[str, dict[str, Any]] = self.spec.get("numbers", {})
        self.axis: dict[str, Any] | None = (
            self.spec["sweep"]["axis"][0] if "sweep" in self.spec else None
        )
        self.outcomes: dict[Case, Outcome] = {}

    def cases(self) -> list[Case]:
        """All simulations."""
        return [
            Case(name, stroke, value)
            for name, variant in self.variants.items()
            for value in (self.axis["values"] if self.axis else (None,))
            if self._among(variant, value)
            for stroke in variant.get("strokes", self.base["strokes"])
        ]

    def _among(self, table: dict[str, Any], value: Any) -> bool:
        only = table.get("only", {}).get(self.axis["name"]) if self.axis else None
        return only is None or value in only

    def shows(self, panel: dict[str, Any], case: Case) -> bool:
        """Whether a panel of a figure shows a case."""
        strokes = [panel["stroke"]] if "stroke" in panel else panel.get("strokes", [case.stroke])
        return (
            case.variant in panel.get("variants", self.variants)
            and case.stroke in strokes
            and self._among(panel, case.value)
        )

    def _stroke(self, name: str) -> Any:
        made = self.spec.get("strokes", {}).get(name)
        if made is None:
            return feltmb.load_stroke(name)
        stroke = feltmb.load_stroke(made["base"])
        if "duration" in made:
            stroke = dataclasses.replace(stroke, duration=made["duration"])
        if "record" not in made:
            return dataclasses.replace(stroke, name=name)
        # What a sensor at the key records when the base mechanism performs the stroke.
        run = feltmb.simulate(self.base["action"], stroke, rtol=1e-7, ledger=False, events=False)
        if made["record"] == "force":
            record = feltmb.table_stroke(run.time, run["finger.force"], name=name)
        else:
            travel = run["finger.displacement"]
            record = feltmb.motion_stroke(run.time, travel - travel[0], of="key", name=name)
        return dataclasses.replace(record, duration=stroke.duration)

    def _set(self, action: Any, stroke: Any, value: Any) -> tuple[Any, Any]:
        """Mechanism and stroke at a value of the axis."""
        if self.axis is None:
            return action, stroke
        if self.axis["path"] == "stroke.scale":
            return action, stroke.scaled(value)
        paths = self.axis["path"]
        paths = [paths] if isinstance(paths, str) else paths
        sign = {"set": "", "scale": " *=", "offset": " +="}[self.axis.get("how", "set")]
        given = f"{value} {self.axis['unit']}" if "unit" in self.axis else value
        values = {path + sign: given for path in paths}
        values |= {f"{path} *=": 1.0 / value for path in self.axis.get("inverse", ())}
        return action.with_values(values), stroke

    def run(self, jobs: int | None = None) -> Study:
        """Simulate all cases in parallel."""
        cases, actions = self.cases(), {}
        for name, variant in self.variants.items():
            action = feltmb.load_action(variant.get("action", self.base["action"]))
            actions[name] = action.with_values(
                self.base.get("values", {}) | variant.get("values", {})
            )
        strokes = {name: self._stroke(name) for name in {c.stroke for c in cases}}
        made = []
        for c in cases:
            options = self.base.get("options", {}) | self.variants[c.variant].get("options", {})
            made.append((*self._set(actions[c.variant], strokes[c.stroke], c.value), options))
        panels = [
            panel
            for figure in self.spec.get("figures", {}).values()
            for panel in figure["panels"]
            if "output" in panel
        ]
        found: dict[Case, Outcome] = {}

        def take(index: int, run: Any) -> None:
            case = cases[index]
            if isinstance(run, Error):
                found[case] = Outcome({}, {}, " ".join(str(run).split()))
                return
            wanted = {
                name: number
                for name, number in self.numbers.items()
                if case.stroke in number.get("strokes", [case.stroke])
            }
            shown = [p for p in panels if self.shows(p, case)]
            found[case] = Outcome(*extract(run, made[index][0], wanted, shown))

        simulate_many(made, take, jobs=jobs, ledger=False)
        self.outcomes = {case: found[case] for case in cases}
        return self

    def number(self, name: str, *words: Any) -> float:
        """A number of a run, SI; the words are a variant, a stroke and a value of the axis.

        Words may be omitted where there is only one.
        """
        chosen = {
            "variant": next((w for w in words if w in self.variants), next(iter(self.variants))),
            "stroke": "", "value": None,
        }  # fmt: skip
        strokes = self.variants[chosen["variant"]].get("strokes", self.base["strokes"])
        chosen["stroke"] = next((w for w in words if w in strokes), strokes[0])
        rest = [w for w in words if w not in self.variants and w not in strokes]
        if len(rest) != (self.axis is not None):
            raise ValueError(f"{self.name}: {name}{words}: expected one value of the axis")
        for case, outcome in self.outcomes.items():
            same = not rest or case.value == rest[0]
            if (case.variant, case.stroke) == (chosen["variant"], chosen["stroke"]) and same:
                if name not in outcome.numbers:
                    raise Absent(f"{name}{words}: {outcome.error or 'the run does not have it'}")
                return outcome.numbers[name]
        raise Absent(f"{name}{words}: was not run")

    def findings(self) -> list[Finding]:
        """The findings of the file with their outcomes."""
        return [self._judged(given) for given in self.spec.get("findings", [])]

    def _judged(self, given: dict[str, Any]) -> Finding:
        values = self.axis["values"] if self.axis and "over" in given else (None,)
        unit = given.get("unit", "1")
        holds, sizes = [], []
        for value in values:
            names = _Words(self, {given["over"]: value} if "over" in given else {})
            try:
                if "size" in given:
                    sizes.append(float(evaluate(given["size"], names)) / to_si(unit)[0])
                tests = [bool(evaluate(given["check"], names))] if "check" in given else []
                if "thesis" in given:
                    error = abs(sizes[-1] - given["thesis"])
                    tests.append(error <= given["within"] * abs(given["thesis"]))
            except Absent:
                continue
            if tests:
                holds.append(all(tests))
        outcome = "depends"
        if not holds:
            outcome = "not tested"
        elif len(set(holds)) == 1:
            outcome = "agrees" if holds[0] else "disagrees"
        claim = given.get("claim", "own")
        return Finding(given["says"], claim, outcome, tuple(sizes), unit, sum(holds), len(holds))

    def table(self) -> Any:
        """Numbers of all runs, SI: a pandas table with one row for each run."""
        import pandas as pd

        rows = []
        for case, outcome in self.outcomes.items():
            row: dict[str, Any] = {"variant": case.variant, "stroke": case.stroke}
            if self.axis:
                row[self.axis["name"]] = case.value
            row |= {name: outcome.numbers.get(name, math.nan) for name in self.numbers}
            rows.append(row | {"error": outcome.error})
        return pd.DataFrame(rows)

    def shown(self, name: str) -> tuple[str, str, float]:
        """Label, unit and factor from SI of a number."""
        number = self.numbers.get(name, {})
        si = summary_unit(name)
        unit = number.get("unit") or {"m": "mm", "s": "ms"}.get(si, si)
        return number.get("label", name.replace("_", " ")), unit, 1.0 / to_si(unit)[0]

    def figure(self, name: str) -> Any:
        """A figure of the file (matplotlib)."""
        from matplotlib.figure import Figure

        from unmodeled.style import CYCLE

        given = self.spec["figures"][name]
        columns = min(given.get("columns", 1), len(given["panels"]))
        rows = math.ceil(len(given["panels"]) / columns)
        figure = Figure(figsize=(7.4 if columns == 1 else 9.6, 2.8 * rows + 0.7),
                        layout="constrained")  # fmt: skip
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        draw = {"time": self._time, "sweep": self._over_axis, "bars": self._bars}
        for ax, panel in zip(axes, given["panels"], strict=False):
            ax.set_prop_cycle(color=CYCLE)
            draw[given.get("kind", "time")](ax, panel)
            ax.set_title(panel.get("title", panel.get("stroke", "")), loc="left", fontsize=9)
            ax.spines[["top", "right"]].set_visible(False)
            ax.set_yscale("log" if panel.get("log") else "linear")
        for ax in axes[len(given["panels"]) :]:
            ax.set_visible(False)
        lines = {}
        for ax in axes:
            lines |= {text: line for line, text in zip(*ax.get_legend_handles_labels(),
                                                       strict=True)}  # fmt: skip
        figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=3,
                      frameon=False, fontsize=8)  # fmt: skip
        figure.suptitle(given["title"], x=0.01, ha="left", fontsize=10)
        return figure

    def _label(self, case: Case, *, point: bool) -> str:
        parts = [self.variants[case.variant].get("label", case.variant)]
        parts += [f"{self.axis['name']} {case.value:g}"] if point and self.axis else []
        return ", ".join(parts)

    def _time(self, ax: Any, panel: dict[str, Any]) -> None:
        factor = 1.0 / to_si(panel.get("unit", "1"))[0]
        cases = [c for c in self.outcomes if self.shows(panel, c)]
        for case in cases:
            pair = self.outcomes[case].series.get(series_key(panel))
            if pair is not None:
                several = len({c.value for c in cases}) > 1
                ax.plot(1e3 * pair[0], factor * pair[1], label=self._label(case, point=several))
        ax.set_xlabel("time [ms]")
        ax.set_ylabel(f"{panel.get('label', panel['output'])} [{panel.get('unit', '1')}]")

    def _over_axis(self, ax: Any, panel: dict[str, Any]) -> None:
        assert self.axis is not None
        text, unit, factor = self.shown(panel["number"])
        lines: dict[tuple[str, str], list[tuple[float, float]]] = {}
        for case, outcome in self.outcomes.items():
            if self.shows(panel, case) and panel["number"] in outcome.numbers:
                point = (case.value, factor * outcome.numbers[panel["number"]])
                lines.setdefault((case.variant, case.stroke), []).append(point)
        several = len({stroke for _, stroke in lines}) > 1
        for (variant, stroke), points in lines.items():
            label = self.variants[variant].get("label", variant)
            ax.plot(*zip(*points, strict=True), "o-", markersize=4,
                    label=f"{label}, {stroke}" if several else label)  # fmt: skip
        ax.set_xlabel(f"{self.axis['label']} [{self.axis.get('unit', '1')}]")
        ax.set_xscale("log" if self.axis.get("log") else "linear")
        ax.set_ylabel(f"{text} [{unit}]")

    def _bars(self, ax: Any, panel: dict[str, Any]) -> None:
        text, unit, factor = self.shown(panel["number"])
        thesis = self.numbers[panel["number"]].get("thesis", {})
        cases = [c for c in self.outcomes if self.shows(panel, c)]
        names = [f"{c.variant}\n{c.stroke}" for c in cases]
        values = [factor * self.outcomes[c].numbers.get(panel["number"], math.nan) for c in cases]
        ax.bar(range(len(cases)), values, label=self.name)
        for x, case in enumerate(cases):
            printed = thesis.get(f"{case.variant}.{case.stroke}")
            if printed is not None:
                ax.hlines(printed, x - 0.4, x + 0.4, color="black",
                          label="thesis")  # fmt: skip
        ax.set_xticks(range(len(cases)), names, fontsize=6)
        ax.set_ylabel(f"{text} [{unit}]")


class _Words(dict[str, Any]):
    """Names of a finding: variants, strokes and values are words; any other name is a number."""

    def __init__(self, study: Study, place: dict[str, Any]):
        strokes = {case.stroke for case in study.outcomes}
        super().__init__({w: w for w in [*study.variants, *strokes]} | FUNCTIONS | place)
        self.study = study

    def __missing__(self, name: str) -> Any:
        return lambda *words: self.study.number(name, *words)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=NAMES)
    parser.add_argument("--out", type=Path, help="folder of tables (CSV) and figures (PNG)")
    parser.add_argument("--jobs", type=int)
    given = parser.parse_args()
    for name in given.names:
        study = Study(name).run(given.jobs)
        print(f"\n{study.spec['title']}\n{study.table().to_string(index=False)}")
        for f in study.findings():
            sizes = f"  [{min(f.sizes):.4g} to {max(f.sizes):.4g} {f.unit}]" if f.sizes else ""
            print(f"{f.outcome:>10} {f.held}/{f.of} ({f.claim}) {f.says}{sizes}")
        if given.out:
            given.out.mkdir(parents=True, exist_ok=True)
            study.table().to_csv(given.out / f"{name}.csv", index=False)
            for key in study.spec.get("figures", {}):
                study.figure(key).savefig(given.out / f"{name}_{key}.png", dpi=150)


if __name__ == "__main__":
    try:
        main()
    except Error as error:
        sys.exit(str(error))
