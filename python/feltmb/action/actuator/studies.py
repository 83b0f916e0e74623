"""Figures 5.6 to 5.11 of the thesis, and a comparison of its findings with simulated values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.action.actuator.model import ActuatorRun, load_actuator, simulate_actuator
from feltmb.arguments import checked
from feltmb.files import check_writable, make_folder, write_file, write_text

__all__ = ["ActuatorStudy", "StudyFinding", "study_actuator"]

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
class StudyFinding:
    """One finding of the thesis.

    ``agrees`` is None if it depends on assumed data.
    """

    says: str
    source: str
    here: str
    agrees: bool | None
    note: str = ""


@dataclass(frozen=True)
class ActuatorStudy:
    """Runs of the study by name, with findings and figures."""

    runs: Mapping[str, ActuatorRun]
    findings: tuple[StudyFinding, ...]

    @cached_property
    def figures(self) -> dict[str, Any]:
        """Figures by their number in the thesis."""
        from feltmb.action.actuator.plot import compare_runs

        return {
            number: compare_runs(
                {name: self.runs[name] for name in names}, panels, f"Fig. {number}: {title}"
            )
            for number, (title, names, panels) in FIGURES.items()
        }

    @checked
    def save(self, folder: str | Path, *, force: bool = False) -> list[Path]:
        """Write ``figure_5_6.png`` and so on, ``findings.csv`` and ``runs.csv``."""
        import csv
        import io

        folder = make_folder(folder)
        targets = [folder / f"figure_{n.replace('.', '_')}.png" for n in FIGURES]
        tables = [folder / "findings.csv", folder / "runs.csv"]
        for path in targets + tables:
            check_writable(path, force=force)
        for path, figure in zip(targets, self.figures.values(), strict=True):
            write_file(path, partial(figure.savefig, format="png", dpi=150), force=force)
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["finding", "source", "here", "agrees", "note"])
        for f in self.findings:
            verdict = "not tested" if f.agrees is None else "yes" if f.agrees else "no"
            table.writerow([f.says, f.source, f.here, verdict, f.note])
        write_text(tables[0], text.getvalue(), force=force)
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        keys = sorted({k for run in self.runs.values() for k in run.summary})
        table.writerow(["run", *keys])
        for name, run in self.runs.items():
            table.writerow([name, *(f"{run.summary.get(k, np.nan):.6g}" for k in keys)])
        write_text(tables[1], text.getvalue(), force=force)
        return [*targets, *tables]


@checked
def study_actuator(duration: float = 0.2) -> ActuatorStudy:
    """Simulate Figures 5.6 to 5.11 and compare them with sections 5.2.1 to 5.2.4."""
    wood, aluminum = load_actuator("wood"), load_actuator("aluminum")
    made = {
        "wood": wood,
        "aluminum": aluminum,
        "wood dashpot": wood.with_damper("dashpot"),
        "wood one-sided": wood.with_damper("one-sided"),
        "wood one-sided, same c": wood.with_damper("one-sided", 0.0075),
    }
    runs = {name: simulate_actuator(a, duration=duration) for name, a in made.items()}
    return ActuatorStudy(runs, tuple(_findings(runs)))


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


def _findings(runs: Mapping[str, ActuatorRun]) -> list[StudyFinding]:
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
        StudyFinding(
            "the stop is first met at 0.032 s",
            "5.2.4",
            f"{1e3 * first['aluminum']:.2f} ms aluminum, {1e3 * first['wood']:.2f} ms wood",
            None,
            "the equivalent mass was chosen for it; the coupled action gives it without",
        ),
        StudyFinding(
            "the wooden arm's vibrations are larger",
            "5.2.1",
            f"deflection, rms: {1e3 * bend['wood']:.3f} mm wood, "
            f"{1e3 * bend['aluminum']:.4f} mm aluminum",
            bend["wood"] > bend["aluminum"],
        ),
        StudyFinding(
            "and last longer",
            "5.2.1",
            f"to a tenth: {1e3 * lasts['wood']:.0f} ms wood, "
            f"{1e3 * lasts['aluminum']:.0f} ms aluminum",
            lasts["wood"] > lasts["aluminum"],
        ),
        StudyFinding(
            "a stiffer arm gives short-lasting oscillations with greater peaks of the force",
            "5.2.4",
            f"peak {peak['aluminum']:.1f} N aluminum, {peak['wood']:.1f} N wood",
            peak["aluminum"] > peak["wood"] and lasts["aluminum"] < lasts["wood"],
        ),
        StudyFinding(
            "compliance alone does not suppress the oscillation of the force",
            "5.2.1",
            f"rms over 30 ms after contact: {force['wood']:.2f} N wood, "
            f"{force['aluminum']:.2f} N aluminum",
            force["wood"] > 0.25 * force["aluminum"],
        ),
        StudyFinding(
            "the simple dashpot reduces the oscillations of the wooden arm considerably",
            "5.2.2",
            f"held force rings by {ring['wood dashpot']:.3f} N rms, undamped {ring['wood']:.3f} N",
            ring["wood dashpot"] < 0.5 * ring["wood"],
        ),
        StudyFinding(
            "it delays the first contact",
            "5.2.3",
            f"by {delay:.2f} ms",
            delay > 0.02,
        ),
        StudyFinding(
            "the one-sided dashpot leaves the force before contact and its time as they are",
            "5.2.3",
            f"time shifts by {shift:.4f} ms, force before contact by {gap:.3f} N at most",
            shift < 0.02 and gap < 0.02 * peak["wood"],
        ),
        StudyFinding(
            "at the same level of damping the one-sided dashpot leaves more oscillation",
            "5.2.4, Fig. 5.11",
            f"after contact {force['wood one-sided, same c']:.2f} N rms, "
            f"dashpot {force['wood dashpot']:.2f} N",
            _swing(same, "finger.force", *after["wood one-sided, same c"])
            > _swing(runs["wood dashpot"], "finger.force", *after["wood dashpot"]),
        ),
        StudyFinding(
            "one-sided damping of 0.05 suppresses the oscillations after contact",
            "5.2.3, Fig. 5.10",
            f"held force rings by {ring['wood one-sided']:.3f} N rms, undamped {ring['wood']:.3f}",
            ring["wood one-sided"] < 0.5 * ring["wood"],
        ),
    ]
