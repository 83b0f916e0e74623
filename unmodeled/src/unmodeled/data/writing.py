"""Writes records as CSV files, each with a small TOML file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data.records import Record, Sensor, StartPrior
from unmodeled.files import write_text

if TYPE_CHECKING:
    from unmodeled.data.sheet import OutputSpec


def _kept(unit: str) -> str:
    """A unit that a reader would convert without being told to keep it; else ""."""
    from unmodeled.data.files import conversion

    return "" if conversion(unit, "", "") in ((0.0, 1.0, unit), (0.0, 1.0, "1")) else unit


def _spec(sensor: Sensor) -> OutputSpec:
    """Description of an output and its sensor."""
    from unmodeled.data.sheet import OutputSpec

    fields = {k: v for k, v in vars(sensor).items() if k not in ("name", "unit", "bandwidth")}
    bandwidth = sensor.bandwidth if math.isfinite(sensor.bandwidth) else None
    return OutputSpec(si=_kept(sensor.unit), bandwidth=bandwidth, **fields)


@checked
def write_record(record: Record, path: str | Path, *, force: bool = False) -> Path:
    """Write a record as a CSV file and a TOML file, which :func:`read_record` can read.

    The samples before the record (:attr:`Record.before`) are not written.

    Parameters
    ----------
    record
        Record to be written.
    path
        CSV file; the TOML file gets the same name.
    force
        False: an existing file is not overwritten.

    Examples
    --------
    A record and its TOML file, which are read again:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from unmodeled import Record
    >>> from unmodeled.data import write_record
    >>> time = np.array([0.0, 0.1, 0.2])
    >>> record = Record(name="r", time=time, inputs={}, outputs={"x": 2.0 * time})
    >>> write_record(record, Path(tempfile.mkdtemp()) / "r.csv").name
    'r.csv'
    """
    import tomlkit

    from unmodeled.data.sheet import InputSpec, Sheet

    path = Path(path)
    units = {n: record.input_units.get(n, "") for n in record.inputs}
    units |= {n: sensor.unit for n, sensor in record.sensors.items()}
    head = ["time [s]", *(f"{n} [{units[n]}]" for n in record.inputs)]
    head += [n if units[n] == "1" else f"{n} [{units[n]}]" for n in record.outputs]
    table = np.column_stack([record.time, *record.inputs.values(), *record.outputs.values()])
    lines = [",".join(head)]
    lines += [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in table]
    start = record.start or StartPrior()
    sheet = Sheet(
        name=record.name,
        role=record.role,
        input_mode=record.input_mode,
        repeats=record.repeats,
        source=record.source,
        inputs={
            n: InputSpec(
                si=_kept(units[n]),
                sigma=record.input_sigma.get(n, 0.0),
                correlation_time=record.input_correlation_time.get(n, 0.0),
            )
            for n in record.inputs
        },
        outputs={n: _spec(s) for n, s in record.sensors.items()},
        start={
            k: (start.mean.get(k, 0.0), start.sd.get(k, 1e300)) for k in {**start.mean, **start.sd}
        },
        start_known=start.known,
        conditions=dict(record.conditions),
    )
    write_text(path, "\n".join(lines) + "\n", force=force)
    write_text(
        path.with_suffix(".toml"),
        tomlkit.dumps(sheet.model_dump(mode="json", exclude_defaults=True)),
        force=force,
    )
    return path
