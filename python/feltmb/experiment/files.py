"""Files of a plan: inputs for a controller, figures, all numbers.

For experiment 1: ``1.csv`` (time and inputs) and ``1.png``; a test of a part is ``1.toml`` with
``[part]``, a further sensor with ``[sensor]``. ``plan.json`` holds all numbers. The caller may add
files of inputs in other formats.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feltmb._core import __version__
from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.experiment.design import Design, DesignedExperiment
from feltmb.files import make_folder, write_file, write_text
from feltmb.gap.report import plain
from feltmb.style import new_figure, reader_unit, side_legend, style_axes

__all__ = ["InputFiles", "design_json", "read_request", "request_file", "write_design"]

#: Writes the input of an experiment in other formats, at a path without an ending, and returns what
#: was written.
InputFiles = Callable[[DesignedExperiment, Path], Sequence[Path]]


def design_json(design: Design) -> dict[str, Any]:
    """Plan as one JSON object."""
    experiments = []
    for i, e in enumerate(design.experiments, 1):
        row: dict[str, Any] = {
            "number": i,
            "name": e.name,
            "kind": e.kind,
            "cost": e.cost,
            "before": e.before,
            "after": e.after,
            "reasons": list(e.reasons),
        }
        if e.profile is not None:
            row |= {"input": e.input, "family": e.profile.family, "numbers": e.profile.numbers}
        if e.part is not None:
            row["part"] = e.part
        if e.sensor is not None:
            row["sensor"] = e.sensor
        experiments.append(row)
    return {
        "feltmb": __version__,
        "aim": design.aim,
        "before": plain(design.before),
        "after": plain(design.after),
        "reachable": plain(design.reachable),
        "experiments": plain(experiments),
        "effects": plain(design.effects),
        "parts": [{**plain(p), "text": p.text} for p in design.parts],
        "sensors": [
            {**plain(s), "gain": plain(s.gain), "gain_per_cost": plain(s.gain_per_cost)}
            for s in design.sensors
        ],
        "inseparable": plain(design.inseparable),
        "decisive": [{**plain(t), "text": t.text} for t in design.decisive],
        "belief": plain(design.belief),
    }


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
    units
        SI units by input and output.
    input_files
        Function that writes inputs in further formats.
    force
        Whether existing files are overwritten.
    """
    folder = make_folder(folder)
    known = dict(units or {})
    out = [
        write_text(
            folder / "plan.json",
            json.dumps(design_json(design), indent=1, ensure_ascii=False) + "\n",
            force=force,
        )
    ]
    for i, e in enumerate(design.experiments, 1):
        out.append(request_file(e, folder / str(i), units=known, force=force))
        if e.profile is None or e.record is None:
            continue
        if input_files is not None:
            out += input_files(e, folder / str(i))
        out.append(_picture(e, folder / f"{i}.png", known, force=force))
    return out


def request_file(
    experiment: DesignedExperiment, stem: Path, *, units: Mapping[str, str], force: bool = False
) -> Path:
    """What whoever measures is given.

    A CSV of the inputs over time, or a TOML with ``[part]`` or ``[sensor]``.
    """
    import tomlkit

    asked: dict[str, Any] = {}
    if experiment.part is not None:
        part = experiment.part
        asked = {"part": {"parameter": part.parameter, "sd": part.sd, "how": part.how}}
    elif experiment.sensor is not None:
        own = experiment.sensor
        asked = {"sensor": {"output": own.output, "sigma": own.sigma, "how": own.how}}
    if asked:
        return write_text(stem.with_name(stem.name + ".toml"), tomlkit.dumps(asked), force=force)
    record = experiment.record
    assert record is not None
    names = list(record.inputs)
    head = ["time [s]"]
    head += [n if units.get(n, "1") == "1" else f"{n} [{units[n]}]" for n in names]
    table = np.column_stack([record.time, *(record.inputs[n] for n in names)])
    lines = [",".join(head)]
    lines += [",".join(f"{v:.9g}" for v in row) for row in table]
    return write_text(stem.with_name(stem.name + ".csv"), "\n".join(lines) + "\n", force=force)


def read_request(path: Path) -> tuple[Array, dict[str, Array]]:
    """Times [s] and inputs by name [their units] of a request that :func:`request_file` wrote."""
    with path.open(encoding="utf-8") as file:
        _, *names = (column.split(" [")[0] for column in file.readline().strip().split(","))
        time, *values = np.loadtxt(file, delimiter=",", ndmin=2).T
    return time, dict(zip(names, values, strict=True))


def _picture(e: DesignedExperiment, path: Path, units: Mapping[str, str], *, force: bool) -> Path:
    """Figure of the input and, below it, the expected outputs."""
    record = e.record
    assert isinstance(record, Record)
    figure = new_figure(7.4, 4.5)
    above, below = figure.subplots(2, 1, sharex=True)
    factor, unit = reader_unit(units.get(e.input, "1"))
    above.plot(1e3 * record.time, factor * record.inputs[e.input], color="#0072B2")
    style_axes(above, "", f"{e.input} [{unit}]", e.name)
    for name, values in record.outputs.items():
        own, shown = reader_unit(units.get(name, "1"))
        below.plot(1e3 * record.time, own * values, label=f"{name} [{shown}]", linewidth=1.0)
    style_axes(below, "time [ms]", "expected")
    side_legend(below)
    return write_file(path, lambda p: figure.savefig(p, format="png", dpi=150), force=force)
