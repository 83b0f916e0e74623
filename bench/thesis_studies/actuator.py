"""Figures 5.6 to 5.11 of the thesis, and a comparison of its findings with simulated values.

Usage: python bench/thesis_studies/actuator.py [--out FOLDER]

``--out`` writes the figures as PNG.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.action.actuator import ActuatorRun, load_actuator, simulate_actuator
from feltmb.action.actuator.plot import compare_runs

#: figure -> (title, runs, panels)
FIGURES: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "5.6": ("Wooden arm, no damper", ("wood",), ("angle", "deflection")),
    "5.7": ("Aluminum arm, no damper", ("aluminum",), ("angle", "deflection")),
    "5.8": ("Finger force, no damper", ("wood", "aluminum"), ("finger",)),
    "5.9": (
        "Wooden arm, simple dashpot 0.0075 N m s/rad",
        ("wood dashpot",),
        ("deflection", "angle", "finger"),
    ),
    "5.10": (
        "Wooden arm, one-sided dashpot 0.05 N m s/rad",
        ("wood one-sided",),
        ("deflection", "angle", "finger"),
    ),
    "5.11": (
        "Finger force, wooden arm: no damper and both dashpots at 0.0075 N m s/rad",
        ("wood", "wood dashpot", "wood one-sided, same c"),
        ("finger",),
    ),
}


@dataclass(frozen=True)
class Finding:
    """One finding of the thesis.

    ``agrees`` is None if it depends on assumed data.
    """

    says: str
    source: str
    here: str
    agrees: bool | None
    note: str = ""


def simulate(duration: float = 0.2) -> dict[str, ActuatorRun]:
    """Runs of the figures, by name."""
    wood, aluminum = load_actuator("wood"), load_actuator("aluminum")
    made = {
        "wood": wood,
        "aluminum": aluminum,
        "wood dashpot": wood.with_damper("dashpot"),
        "wood one-sided": wood.with_damper("one-sided"),
        "wood one-sided, same c": wood.with_damper("one-sided", 0.0075),
    }
    return {name: simulate_actuator(a, duration=duration) for name, a in made.items()}


def figure(runs: Mapping[str, ActuatorRun], number: str) -> Any:
    """Figure by its number in the thesis."""
    title, names, panels = FIGURES[number]
    return compare_runs({name: runs[name] for name in names}, panels, f"Fig. {number}: {title}")


def _swing(run: ActuatorRun, output: str, begin: float, end: float) -> float:
    """Root mean square of an output about its mean over 5 ms: only the vibration."""
    per = max(1, round(5e-3 / (run.time[1] - run.time[0])))
    values = run[output]
    smooth = np.convolve(values, np.ones(per) / per, mode="same")
    span = (run.time >= begin) & (run.time <= end)
    return float(np.sqrt(np.mean((values - smooth)[span] ** 2)))


def _lasts(run: ActuatorRun, output: str, share: float = 0.1) -> float:
    """Time after the first contact until the vibration stays below a share of its maximum [s]."""
    first = run.summary["first_contact_time"]
    times = np.arange(first, run.time[-1] - 0.01, 1e-3)  # too short for a mean after this
    swing = np.array([_swing(run, output, t, t + 0.005) for t in times])
    above = np.nonzero(swing > share * swing.max())[0]
    return float(times[above[-1]] + 0.005 - first)


def findings(runs: Mapping[str, ActuatorRun]) -> list[Finding]:
    """What the thesis found, held against the runs."""
    wood = runs["wood"]
    first = {name: run.summary["first_contact_time"] for name, run in runs.items()}
    after = {name: (t, t + 0.03) for name, t in first.items()}
    bend = {n: _swing(runs[n], "tip.deflection", *after[n]) for n in ("wood", "aluminum")}
    # Force of the first vibrations, after the impact itself.
    force = {n: _swing(runs[n], "finger.force", after[n][0] + 0.005, after[n][1]) for n in runs}
    lasts = {n: _lasts(runs[n], "tip.deflection") for n in ("wood", "aluminum")}
    same = runs["wood one-sided, same c"]
    before = wood.time < first["wood"]
    gap = float(
        np.max(np.abs(runs["wood one-sided"]["finger.force"] - wood["finger.force"])[before])
    )
    delay = 1e3 * (first["wood dashpot"] - first["wood"])
    shift = 1e3 * abs(first["wood one-sided"] - first["wood"])
    ring = {n: r.summary["ringing"] for n, r in runs.items()}
    peak = {n: r.summary["peak_finger_force"] for n, r in runs.items()}
    return [
        Finding(
            "the stop is first met at 0.032 s",
            "5.2.4",
            f"{1e3 * first['aluminum']:.2f} ms aluminum, {1e3 * first['wood']:.2f} ms wood",
            None,
            "the equivalent mass was chosen for it; the coupled action gives it without",
        ),
        Finding(
            "the wooden arm's vibrations are larger",
            "5.2.1",
            f"deflection, rms: {1e3 * bend['wood']:.3f} mm wood, "
            f"{1e3 * bend['aluminum']:.4f} mm aluminum",
            bend["wood"] > bend["aluminum"],
        ),
        Finding(
            "and last longer",
            "5.2.1",
            f"to a tenth: {1e3 * lasts['wood']:.0f} ms wood, "
            f"{1e3 * lasts['aluminum']:.0f} ms aluminum",
            lasts["wood"] > lasts["aluminum"],
        ),
        Finding(
            "a stiffer arm gives short-lasting oscillations with greater peaks of the force",
            "5.2.4",
            f"peak {peak['aluminum']:.1f} N aluminum, {peak['wood']:.1f} N wood",
            peak["aluminum"] > peak["wood"] and lasts["aluminum"] < lasts["wood"],
        ),
        Finding(
            "compliance alone does not suppress the oscillation of the force",
            "5.2.1",
            f"rms over 30 ms after contact: {force['wood']:.2f} N wood, "
            f"{force['aluminum']:.2f} N aluminum",
            force["wood"] > 0.25 * force["aluminum"],
        ),
        Finding(
            "the simple dashpot reduces the oscillations of the wooden arm considerably",
            "5.2.2",
            f"held force rings by {ring['wood dashpot']:.3f} N rms, undamped {ring['wood']:.3f} N",
            ring["wood dashpot"] < 0.5 * ring["wood"],
        ),
        Finding(
            "it delays the first contact",
            "5.2.3",
            f"by {delay:.2f} ms",
            delay > 0.02,
        ),
        Finding(
            "the one-sided dashpot leaves the force before contact and its time as they are",
            "5.2.3",
            f"time shifts by {shift:.4f} ms, force before contact by {gap:.3f} N at most",
            shift < 0.02 and gap < 0.02 * peak["wood"],
        ),
        Finding(
            "at the same level of damping the one-sided dashpot leaves more oscillation",
            "5.2.4, Fig. 5.11",
            f"after contact {force['wood one-sided, same c']:.2f} N rms, "
            f"dashpot {force['wood dashpot']:.2f} N",
            _swing(same, "finger.force", *after["wood one-sided, same c"])
            > _swing(runs["wood dashpot"], "finger.force", *after["wood dashpot"]),
        ),
        Finding(
            "one-sided damping of 0.05 suppresses the oscillations after contact",
            "5.2.3, Fig. 5.10",
            f"held force rings by {ring['wood one-sided']:.3f} N rms, undamped {ring['wood']:.3f}",
            ring["wood one-sided"] < 0.5 * ring["wood"],
        ),
    ]


def main() -> None:
    """Print the findings, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder of the figures")
    asked = parser.parse_args()
    runs = simulate()
    for f in findings(runs):
        verdict = {None: "not tested", True: "yes", False: "NO"}[f.agrees]
        print(f"{f.says} ({f.source}): {f.here}: {verdict}" + (f" ({f.note})" if f.note else ""))
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        for number in FIGURES:
            path = asked.out / f"figure_{number.replace('.', '_')}.png"
            figure(runs, number).savefig(path, dpi=150)
            print(f"wrote {path}")


if __name__ == "__main__":
    main()
