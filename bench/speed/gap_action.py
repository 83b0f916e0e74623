"""Time of a diagnosis of the action, by stage: five strokes by forty effects and more.

python bench/speed/gap_action.py [--strokes N] [--rtol R]
    [--effects PATTERNS] [--whole] [--json FILE]

Derivatives are counted in strokes: processor time over that of one stroke, which does not depend on
what else the machine is doing. Wall times are those of this machine at this moment.
"""

import argparse
import json
import platform
import time
from pathlib import Path

import numpy as np
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, polish

import feltmb
from feltmb.adapters import mechanism_model
from feltmb.adapters.synthetic import Sensors, make_case
from feltmb.fit import Jobs
from feltmb.fit.observe import machine_candidates
from feltmb.gap.score import all_candidates, score_fit

STROKES = (
    ("piano", "fit"),
    ("mezzo", "fit"),
    ("staccato", "fit"),
    ("forte", "fit"),
    ("soft_staccato", "fit"),
)


def main() -> None:
    """Run and print one line for each stage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--strokes", type=int, default=5)
    parser.add_argument("--rtol", type=float, default=3e-6)
    parser.add_argument("--effects", default="", help="names or patterns; default: all")
    parser.add_argument("--after-impact", type=float, default=0.006)
    parser.add_argument(
        "--whole",
        action="store_true",
        help="a whole diagnosis, the last two strokes held-out, instead of its stages",
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    action = feltmb.load_action("steinway45")
    model, effects = mechanism_model(
        action,
        rtol=options.rtol,
        effects=[e for e in options.effects.split(",") if e],
    )
    strokes = STROKES[: options.strokes]
    if options.whole:
        strokes = (*strokes[:-2], *((name, "held_out") for name, _ in strokes[-2:]))
    case = make_case(
        action,
        {"shank_compliance": 2.0},
        seed=1,
        strokes=strokes,
        sensors=Sensors(force_noise=0.002, force_step=0.0),
        spread=0.3,
        after_impact=options.after_impact,
    )
    noise = {o: Noise(2e-5) for o in model.outputs}
    times: dict[str, tuple[float, float]] = {}

    def timed(name: str, work):  # type: ignore[no-untyped-def]
        wall, cpu = time.perf_counter(), time.process_time()
        out = work()
        times[name] = (time.perf_counter() - wall, time.process_time() - cpu)
        print(
            f"{name:34s} wall {times[name][0]:8.2f} s   processor {times[name][1]:8.2f} s",
            flush=True,
        )
        return out

    def all_strokes() -> None:
        for r in case.records:
            model.simulate(
                r,
                Jobs(
                    theta=np.full((1, len(model.parameters)), 1e-9),
                    segments=np.array([[0, r.samples - 1]]),
                    starts=np.zeros((1, 0)),
                ),
            )

    included = all_candidates(effects)
    print(
        f"{len(case.records)} strokes, {len(effects)} effects ({len(included)} with shapes, "
        f"{len(machine_candidates(included))} in the machine), {len(model.parameters)} tolerances"
    )
    timed("one run of every stroke", all_strokes)
    if options.whole:
        floored = (
            model.with_variability(case.records) if hasattr(model, "with_variability") else model
        )
        chosen = feltmb.gap.Options(bootstrap=0, restarts=0)
        report = timed(
            "whole diagnosis",
            lambda: feltmb.gap.diagnose(floored, effects, case.records, None, chosen),
        )
        print(report.verdict, ", ".join(report.named))
        return
    if hasattr(model, "with_variability"):
        model = timed("floor of five strokes", lambda: model.with_variability(case.records))
    segmented_records = tuple(segment_record(model, r, noise, 1.0) for r in case.records)
    problem = Problem(model, segmented_records)
    point = problem.start()
    timed("derivatives by all tolerances", lambda: problem.linear(point))
    settings = FitSettings(restarts=0, iterations=8)
    fit = timed("model fit", lambda: polish(problem, point, 1.0, settings))
    timed("derivatives by all effects", lambda: problem.linear(fit.point, included))
    timed("scores (derivatives at the same point kept)", lambda: score_fit(fit, included))
    total = sum(w for k, (w, _) in times.items())
    cpu = sum(c for k, (_, c) in times.items())
    print(f"{'all':34s} wall {total:8.2f} s   processor {cpu:8.2f} s")
    if options.json:
        options.json.write_text(
            json.dumps(
                {"times": times, "machine": platform.processor(), "version": feltmb.__version__}
            )
        )


if __name__ == "__main__":
    main()
