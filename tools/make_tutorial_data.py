"""Writes examples/tutorial: the compression test and the measured strokes of the tutorial.

Both are synthetic, and the files say so. The test is that of the packaged felt a12_06 with
scatter. The strokes are those of the action that the tutorial regulates, with its capstan felt
0.4 mm thinner and three tolerances off (truth.json, which the tutorial does not read); give it:

    python tools/make_tutorial_data.py mine.toml
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

import feltmb
from blind.synthetic import Sensors, make_case
from feltmb import felt
from feltmb.adapters.library import load_library
from unmodeled.data import write_record

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples" / "tutorial"

THICKNESS = 6.0e-3
"""Thickness of the specimen without load [m]."""
AREA = 4.0e-4
"""Area of the specimen [m^2]."""
SCATTER = 0.004
"""Standard deviation of a force, relative to the largest force."""

STROKES = (("staccato", "fit"), ("slow", "fit"), ("fast", "held_out"))
TOLERANCES = ["felt.03", "joint_friction.butt", "mass.head"]


def write_test() -> None:
    """Force over thickness of a specimen in loading and unloading."""
    truth = felt.load_material("a12_06")
    rng = np.random.default_rng(1)
    v = np.linspace(truth.v_f0, truth.end, 61)[1:]
    rows = ["# synthetic: felt a12_06, 6 mm thick, 4 cm^2, scatter of 0.4 % of the largest force"]
    rows.append("thickness [mm],force [N],branch")
    top = AREA * float(truth.pressure("loading", [truth.end])[0])
    for branch, order in (("loading", v), ("unloading", v[::-1])):
        force = AREA * truth.pressure(branch, order) + SCATTER * top * rng.standard_normal(v.size)
        for x, f in zip(order, force, strict=True):
            rows.append(f"{1e3 * THICKNESS * truth.v_f0 / x:.4f},{max(f, 0.0):.2f},{branch}")
    (FOLDER / "hammer_felt_test.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_strokes(action: feltmb.Action) -> None:
    """Strokes of the regulated action up to 6 ms after the impact."""
    case = make_case(
        action,
        {"felt_thickness.03": 4.0},
        seed=3,
        name="tutorial",
        library=load_library(action, "steinway45"),
        channels=["key", "whippen", "hammer"],
        strokes=STROKES,
        sensors=Sensors(force_noise=0.002, force_step=0.0),
        tolerances=TOLERANCES,
        other_forms=False,
        refined=False,
        after_impact=0.006,
    )
    for record in case.records:
        write_record(record, FOLDER / "strokes" / f"{record.name}.csv")
    truth = asdict(case.truth)
    (FOLDER / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    (FOLDER / "strokes").mkdir(parents=True, exist_ok=True)
    write_test()
    if len(sys.argv) > 1:
        write_strokes(feltmb.load_action(sys.argv[1]))


if __name__ == "__main__":
    main()
