"""Sixteen changes of a workshop on an upright and on a grand: what is told, beside the truth.

    python bench/stories/workshop.py --seed 20291201 -o FOLDER [NUMBER ...]

The size of each change and the noise are drawn from the seed; the SHA-256 of all of them is printed
before the first diagnosis. Three strokes a change, a load cell of 15 mN and a camera of 0.03 mm at
2 kHz. *Right*: the change is told alone or as a member of a class (and nothing else beside it);
*held*: the interval of what is told holds the true size. A control is right if nothing is told.
Rows are appended to ``FOLDER/answers.jsonl``; ``--table`` prints them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import feltmb
import unmodeled
from feltmb.adapters.model import resolve
from unmodeled.data import read_records

UPRIGHT, GRAND = "steinway45_leaded", "grand_action"
STROKES = (("soft", 3.6, 0.16), ("middle", 8.5, 0.09), ("loud", 19.0, 0.05))


@dataclass(frozen=True)
class Fault:
    """A change of an action; ``{}`` in a setting is its size."""

    action: str
    what: str
    settings: Mapping[str, str]
    sizes: tuple[float, float]
    """Smallest and largest size, in the unit of the setting."""
    right: Mapping[str, float]
    """Names of causes and parameters that are the change: told size [SI] by size of the setting."""
    base: float = 0.0
    """Size of the setting that is no change."""


def _friction(action: str, what: str, body: str, amplitude: float) -> Fault:
    right = {f"joint_friction.{body}": 1.0, f"coulomb_friction.{body}": amplitude}
    path = f"bodies.{body}.friction.amplitude *="
    return Fault(action, what, {path: "{}"}, (1.4, 2.2), right, 1.0)


def _mass(action: str, sizes: tuple[float, float]) -> Fault:
    both = {f"bodies.head.{n} *=": "{}" for n in ("mass", "inertia")}
    return Fault(action, "mass of the hammer head", both, sizes, {"mass.head": 1.0}, 1.0)


def _moved(action: str, what: str, path: str, low: float, high: float, *names: str) -> Fault:
    return Fault(action, what, {path: "{} mm"}, (low, high), dict.fromkeys(names, 1e-3))


FAULTS = (
    _mass(UPRIGHT, (0.9, 0.95)),
    _moved(UPRIGHT, "capstan", "surfaces.Kp2.point.y +=", -0.6, -0.3, "capstan_height"),
    _friction(UPRIGHT, "friction of the hammer butt", "butt", 1.75e-3),
    Fault(
        UPRIGHT, "butt spring", {"springs.butt_spring.stiffness *=": "{}"}, (0.75, 0.88),
        {"spring.butt_spring": 1.0, "spring_rate.butt_spring": 1.0}, 1.0,
    ),
    _moved(UPRIGHT, "let-off button", "surfaces.Gp10.point.y +=", 0.3, 0.8, "let_off_button"),
    Fault(UPRIGHT, "lead in the key", {"lead": "{} g at 120 mm"}, (6.0, 14.0),
          {"key_lead": 1e-3 * 120.0 / 140.0}),
    _moved(UPRIGHT, "rest rail along x", "surfaces.Gp8.point.x +=", 1.0, 2.0, "rest_rail"),
    Fault(UPRIGHT, "nothing", {}, (0.0, 0.0), {}),
    _friction(GRAND, "friction of the hammer center", "hammer", 6.8e-4),
    _friction(GRAND, "friction of the whippen center", "whippen", 5.6e-4),
    _mass(GRAND, (1.05, 1.12)),
    _moved(GRAND, "capstan", "surfaces.capstan.point.y +=", 0.3, 0.6, "capstan_height"),
    _moved(GRAND, "let-off button", "surfaces.let_off_button.point.y +=", -0.6, -0.3,
           "let_off_button"),
    _moved(GRAND, "worn knuckle", "surfaces.knuckle.radius +=", -0.6, -0.3, "worn_knuckle"),
    Fault(GRAND, "lead in the key", {"lead": "{} g at 120 mm"}, (6.0, 14.0),
          {"key_lead": 1e-3 * 120.0 / 140.0}),
    Fault(GRAND, "nothing", {}, (0.0, 0.0), {}),
)  # fmt: skip


def draw(seed: int) -> list[float]:
    """Sizes of all changes, in the units of their settings."""
    rng = np.random.default_rng(seed)
    return [round(float(rng.uniform(*f.sizes)), 3) for f in FAULTS]


def make(fault: Fault, size: float, seed: Sequence[int], folder: Path) -> list[Path]:
    """Write the strokes of a changed action."""
    settings = {path: text.format(size) for path, text in fault.settings.items()}
    action, rng = (
        feltmb.load_action(fault.action).with_values(settings),
        np.random.default_rng(seed),
    )
    axis = "x" if fault.action == UPRIGHT else "y"
    names, out = ["key_front.y", "whippen.y", f"hammer_tip.{axis}"], []
    folder.mkdir(parents=True, exist_ok=True)
    for name, force, ramp in STROKES:
        stroke = feltmb.ramp_stroke(force=force, start=0.05, ramp=ramp)
        run = feltmb.simulate(action, stroke, duration=0.35, output_rate=20e3)
        i = np.arange(0, run.time.size, 10)
        columns = [run.time[i], run["finger.force"][i] + rng.normal(0.0, 0.015, i.size)]
        columns += [1e3 * (run[n][i] - run[n][0]) + rng.normal(0.0, 0.03, i.size) for n in names]
        head = "time [s],force [N]," + ",".join(f"{n} [mm]" for n in names)
        out.append(folder / f"{name}.csv")
        np.savetxt(out[-1], np.column_stack(columns), "%.4f", ",", header=head, comments="")
    return out


def judged(fault: Fault, size: float, changes: Sequence[Mapping[str, Any]]) -> tuple[str, bool]:
    """Mark of a list of changes, and whether the interval of the true one holds its size."""
    told = [c for c in changes if c["tier"] not in ("small", "unsure")]
    groups = [(c, *c.get("equivalents", ())) for c in told]
    if not fault.right:
        return ("right" if not told else "false alarm"), True
    for group in groups:
        for c in group:
            if c["name"] in fault.right:
                true = fault.right[c["name"]] * (size - fault.base)
                held = c["low"] <= true <= c["high"]
                mark = "right" if len(group) == 1 else f"class of {len(group)}"
                return mark + f", {len(groups) - 1} more" * (len(groups) > 1), held
    return ("wrong" if groups else "silent"), False


def run(number: int, seed: int, size: float, folder: Path) -> dict[str, Any]:
    """Diagnose a change."""
    fault = FAULTS[number]
    paths = make(fault, size, [seed, number], folder / str(number))
    found = resolve(fault.action, {}, (), notify=lambda _: None)
    assert found is not None
    model, effects = found
    records = read_records(
        paths, inputs=model.inputs, outputs=model.outputs, modes=model.input_modes,
        units=model.units, names=model.input_names,
    )  # fmt: skip
    begin = time.process_time()
    report = unmodeled.diagnose(model, effects, records, options=unmodeled.Options(seconds=900.0))
    data = json.loads(report.to_json())
    mark, held = judged(fault, size, data["changes"])
    return {
        "number": number, "seed": seed, "action": fault.action, "what": fault.what, "size": size,
        "mark": mark, "held": held, "seconds": round(time.process_time() - begin, 1),
        "first": report.summary(),
        "changes": [
            [[c["name"], c["tier"], c["size"], c["low"], c["high"]]
             for c in (first, *first.get("equivalents", ()))]
            for first in data["changes"]
        ],
    }  # fmt: skip


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Answers as a table in Markdown."""
    lines = ["| action | change | size | told | holds the truth | first sentence |"]
    lines.append("|---|---|---|---|---|---|")
    for r in rows:
        unit = next(iter(FAULTS[r["number"]].settings.values()), "").format(r["size"])
        held = "yes" if r["held"] else "no"
        told = " ".join(r["first"].split())
        lines.append(f"| {r['action']} | {r['what']} | {unit} | {r['mark']} | {held} | {told} |")
    return "\n".join(lines)


def main() -> None:
    """Diagnose drawn changes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("numbers", nargs="*", type=int, metavar="NUMBER")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--table", action="store_true", help="print the stored answers only")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path, sizes = given.out / "answers.jsonl", draw(given.seed)
    print(
        "SHA-256 of seed and sizes:", hashlib.sha256(repr((given.seed, sizes)).encode()).hexdigest()
    )
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    rows = {r["number"]: r for r in map(json.loads, lines)}
    for n in [] if given.table else given.numbers or range(len(FAULTS)):
        if n in rows:
            continue
        rows[n] = run(n, given.seed, sizes[n], given.out)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[n]) + "\n")
        print({k: v for k, v in rows[n].items() if k != "changes"}, flush=True)
    print(table([rows[n] for n in sorted(rows)]))


if __name__ == "__main__":
    main()
