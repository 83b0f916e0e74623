"""Files of a plan: inputs for a controller, figures, all numbers.

For experiment 1: ``1.csv`` (time and inputs) and ``1.png``. ``plan.json`` holds all numbers, those
of tests of parts too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array
from unmodeled.experiment.designs import Design, DesignedExperiment
from unmodeled.files import make_folder, write_file, write_text
from unmodeled.search.result import plain
from unmodeled.style import new_figure, reader_unit, side_legend, style_axes

__all__ = ["design_json", "reasons", "write_columns", "write_design"]


@checked
def reasons(experiment: DesignedExperiment, causes: int) -> list[str]:
    """Why an experiment is proposed, in sentences.

    Parameters
    ----------
    experiment
        The experiment.
    causes
        Number of all causes.
    """
    before, after = experiment.detected
    out = []
    if after > before:
        out.append(
            f"detects {after} of {causes} causes at their expected magnitude ({before} before)"
        )
    if experiment.separated is not None:
        cause, rival, was, then = experiment.separated
        out.append(
            f"separates {cause} from {rival}: probability of confusion {was:.0%} -> {then:.0%}"
        )
    return out


@checked
def design_json(design: Design) -> dict[str, Any]:
    """Plan as one JSON object; an infinite number is a text.

    Parameters
    ----------
    design
        The plan.
    """
    bare = [replace(e, record=None) for e in design.experiments]
    plan: dict[str, Any] = plain(replace(design, experiments=tuple(bare)))
    for row, e in zip(plan["experiments"], design.experiments, strict=True):
        del row["record"]
        if e.profile is not None:
            row["profile"] = {"family": e.profile.family, **e.profile.numbers}
    return plan


@checked
def write_design(
    design: Design,
    folder: str | Path,
    *,
    units: Mapping[str, str] | None = None,
    force: bool = False,
) -> list[Path]:
    """Write the files of a plan into a folder.

    Parameters
    ----------
    design
        The plan.
    folder
        Folder of the files.
    units
        SI units by input and output.
    force
        Whether existing files are overwritten.

    Returns
    -------
    list of pathlib.Path
        The files.
    """
    folder = make_folder(folder)
    known = dict(units or {})
    text = json.dumps(design_json(design), indent=1, ensure_ascii=False) + "\n"
    out = [write_text(folder / "plan.json", text, force=force)]
    for i, e in enumerate(design.experiments, 1):
        if e.record is None:
            continue
        columns = {n: (v, known.get(n, "1")) for n, v in e.record.inputs.items()}
        out.append(write_columns(folder / f"{i}.csv", e.record.time, columns, force=force))
        out.append(_picture(e, folder / f"{i}.png", known, force=force))
    return out


def write_columns(
    path: Path, time: Array, columns: Mapping[str, tuple[Array, str]], *, force: bool = False
) -> Path:
    """CSV of inputs over time [s], for a controller; ``columns``: values and unit by name."""
    head = ["time [s]", *(n if u == "1" else f"{n} [{u}]" for n, (_, u) in columns.items())]
    table = np.column_stack([time, *(values for values, _ in columns.values())])
    lines = [",".join(head), *(",".join(f"{v:.9g}" for v in row) for row in table)]
    return write_text(path, "\n".join(lines) + "\n", force=force)


def _picture(e: DesignedExperiment, path: Path, units: Mapping[str, str], *, force: bool) -> Path:
    """Figure of the input and, below it, the expected outputs."""
    assert e.record is not None
    figure = new_figure(7.4, 4.5)
    above, below = figure.subplots(2, 1, sharex=True)
    factor, unit = reader_unit(units.get(e.input, "1"))
    above.plot(1e3 * e.record.time, factor * e.record.inputs[e.input], color="#0072B2")
    style_axes(above, "", f"{e.input} [{unit}]", e.name)
    for name, values in e.record.outputs.items():
        own, shown = reader_unit(units.get(name, "1"))
        below.plot(1e3 * e.record.time, own * values, label=f"{name} [{shown}]", linewidth=1.0)
    style_axes(below, "time [ms]", "expected")
    side_legend(below)
    return write_file(path, lambda p: figure.savefig(p, format="png", dpi=150), force=force)
