"""Files of a plan: inputs for a controller, figures, all numbers.

For experiment 1: ``1.csv`` (time and inputs) and ``1.png``. ``plan.json`` holds all numbers, those
of tests of parts too. The caller may add files of inputs in other formats.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.arguments import checked
from feltmb.experiment.designs import Design, DesignedExperiment
from feltmb.files import make_folder, write_file, write_text
from feltmb.gap.result import plain
from feltmb.style import new_figure, reader_unit, side_legend, style_axes

__all__ = ["InputFiles", "design_json", "reasons", "write_design"]

#: Writes the input of an experiment in other formats, at a path without an ending, and returns what
#: was written.
InputFiles = Callable[[DesignedExperiment, Path], Sequence[Path]]


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
    input_files: InputFiles | None = None,
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
    input_files
        Function that writes inputs in further formats.
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
        out.append(_inputs(e, folder / f"{i}.csv", known, force=force))
        if input_files is not None:
            out += input_files(e, folder / str(i))
        out.append(_picture(e, folder / f"{i}.png", known, force=force))
    return out


def _inputs(e: DesignedExperiment, path: Path, units: Mapping[str, str], *, force: bool) -> Path:
    """CSV of the inputs over time."""
    assert e.record is not None
    names = list(e.record.inputs)
    head = ["time [s]"]
    head += [n if units.get(n, "1") == "1" else f"{n} [{units[n]}]" for n in names]
    table = np.column_stack([e.record.time, *(e.record.inputs[n] for n in names)])
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
