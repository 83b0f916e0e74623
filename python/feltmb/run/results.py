"""Runs: named time series with units, events, summary, energy ledger, statistics, provenance.

A :class:`Run` only contains data and has no knowledge of pianos. xarray and pandas are imported
when they are needed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from feltmb.display import html_table, picture
from feltmb.run.arrays import Numbers, renamed, summary_unit
from unmodeled.arguments import checked
from unmodeled.errors import DataError, InvalidParameter, no_such, shortened
from unmodeled.files import check_suffix, plain_text, write_file
from unmodeled.files.hdf5 import HDF5_FAULTS, open_hdf5
from unmodeled.units.quantity import fault_lines

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    Array = npt.NDArray[np.float64]

__all__ = ["FILE_FORMAT", "Provenance", "Run", "let_off_words", "load_run"]

FILE_FORMAT = 1
MOST_NUMBERS = 100_000_000  # limit of a file: 800 MB in memory


def let_off_words(summary: Mapping[str, float]) -> str:
    """Text: the hammer met the string while still on the jack; "" if it did not."""
    if "let_off_time" in summary or "impact_time" not in summary:
        return ""
    if "free_flight_time" in summary:
        return "no let-off: thrown off"
    return "no let-off before hammer strikes" if "jack_toe_time" in summary else ""


class Provenance(dict[str, Any]):
    """Provenance whose expensive entries are computed at their first access.

    Writing all parameters as TOML takes as long as several strokes, and most runs of a sweep do not
    need it.
    """

    def __init__(self, entries: Mapping[str, Any], late: Mapping[str, Callable[[], Any]]):
        super().__init__(entries)
        self._late = dict(late)

    def __missing__(self, key: str) -> Any:
        self[key] = self._late[key]()
        return self[key]

    def __contains__(self, key: object) -> bool:
        return key in self._late or super().__contains__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Value of an entry, or ``default``."""
        return self[key] if key in self else default  # noqa: SIM401

    def whole(self) -> dict[str, Any]:
        """All entries as a plain dictionary."""
        return {**self, **{key: self[key] for key in self._late}}

    def __reduce__(self) -> tuple[Any, ...]:
        return (dict, (self.whole(),))


@dataclass(frozen=True, eq=False)
class Run:
    """Result of a simulation.

    Attributes
    ----------
    time : ndarray (n_times,)
        Sample times [s].
    values : ndarray (n_times, n_outputs)
        Samples of the outputs ``names`` in ``units``.
    eta : ndarray (n_times, n_modes)
        Modal coordinates of the string [m kg^1/2]; see ``string_displacement``.
    summary : dict
        Values of the run by name, SI units; a value that the run does not have is absent.
    energy : dict
        Ledger [J]; see ``docs/explanation/model.md``.
    stats : dict
        Work counts, wall time, and the states and contacts that limited the step most often.
    provenance : dict
        Version, data set, hash and text of all parameters, stroke, options.
    status : str
        ``done``, ``failed``, ``wall_time`` or ``interrupted``; ``message`` states the reason.
    """

    time: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    long_names: tuple[str, ...]
    values: Array
    eta: Array
    event_table: dict[str, list[Any]]
    summary: dict[str, float]
    energy: dict[str, Any]
    stats: dict[str, Any]
    provenance: dict[str, Any]
    end_state: Array
    end_memory: Array
    coordinates: tuple[str, ...]
    status: str = "done"
    message: str = ""
    strike_list: list[dict[str, float]] = field(default_factory=list)
    _index: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_index", {name: i for i, name in enumerate(self.names)})
        object.__setattr__(self, "summary", Numbers(self.summary))

    def __repr__(self) -> str:
        action = self.provenance.get("action", "?")
        stroke = self.provenance.get("stroke", {}).get("name", "?")
        count = len(self.warnings)
        warned = f", {count} warning{'s' if count > 1 else ''}" if count else ""
        return (
            f"Run({action!r}, {stroke!r}, {len(self.time)} samples to {self.reached:g} s, "
            f"{self.status}{warned})"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Where the accuracy is poor, or where the equations are not valid.

        Examples: a felt beyond its measured range, a finger that pulls, a member that bends far.
        """
        return tuple(self.stats.get("warnings", ()))

    def _repr_html_(self) -> str:
        times = {name: value for name, value in self.summary.items() if name.endswith("_time")}
        # Times in chronological order, then the other values.
        names = [
            *sorted(times, key=times.__getitem__),
            *(n for n in self.summary if n not in times),
        ]
        rows = [(name, self.summary[name], summary_unit(name)) for name in names]
        return html_table(repr(self), ("summary", "value", "unit"), rows)

    @checked
    def plot(self, kind: str = "overview") -> Figure:
        """Plot the run.

        Parameters
        ----------
        kind
            A function of ``feltmb.graphics.plot`` that takes one run: ``overview``, ``motion``,
            ``striker_speed``, ``contact_forces``, ``finger_force``, ``string``, ``energy`` or
            ``loops``.

        Returns
        -------
        Figure
            Figure of matplotlib.
        """
        kinds = (
            "overview", "motion", "striker_speed", "contact_forces", "finger_force", "string",
            "energy", "loops",
        )  # fmt: skip
        if kind not in kinds:
            raise InvalidParameter(f"plot: kind = {kind!r}, expected one of {', '.join(kinds)}")
        return picture(kind, self)

    @property
    def reached(self) -> float:
        """Last simulated time [s]."""
        return float(self.stats["reached"])

    def __getitem__(self, name: str) -> Array:
        """Samples of one output by name, shape (n_times,)."""
        return self.values[:, self._place(name)]

    def __contains__(self, name: object) -> bool:
        return name in self._index

    @checked
    def unit(self, name: str) -> str:
        """Unit of an output, by name."""
        self[name]
        return self.units[self._place(name)]

    def _place(self, name: str) -> int:
        if not isinstance(name, str) or name not in self._index:
            raise no_such("output", name, self.names)
        return self._index[name]

    @cached_property
    def data(self) -> xr.Dataset:
        """Outputs over ``time`` [s]; variables have the attributes ``units`` and ``long_name``."""
        import xarray as xr

        variables = {
            name: ("time", self.values[:, i], {"units": unit, "long_name": text})
            for i, (name, unit, text) in enumerate(
                zip(self.names, self.units, self.long_names, strict=True)
            )
        }
        time = ("time", self.time, {"units": "s", "long_name": "time"})
        return xr.Dataset(
            variables,
            coords={"time": time},
            attrs={
                "action": self.provenance.get("action", ""),
                "hash": self.provenance.get("hash", ""),
                "feltmb_version": self.provenance.get("version", ""),
                "status": self.status,
            },
        )

    def to_dataframe(self) -> pd.DataFrame:
        """Outputs as a table: one row per sample, one column per output; the index is time [s].

        Returns
        -------
        DataFrame
            Table; ``attrs["units"]`` contains the unit of each column.
        """
        import pandas as pd

        frame = pd.DataFrame(
            self.values, columns=list(self.names), index=pd.Index(self.time, name="time")
        )
        frame.attrs["units"] = dict(zip(self.names, self.units, strict=True))
        return frame

    @cached_property
    def events(self) -> pd.DataFrame:
        """One row for each event, in chronological order.

        Columns: ``event`` (name), ``time`` [s], ``contact`` (number, <NA> for a point event),
        ``change`` (closes, opens, passes), ``NAME.rate`` (speeds of all coordinates [rad/s, m/s]),
        ``gapNN`` (distance of the surfaces of each contact, negative when compressed [m]),
        ``approachNN`` (speed of the two materials toward each other [m/s]).
        """
        import pandas as pd

        frame = pd.DataFrame(self.event_table)
        if "contact" in frame:
            frame["contact"] = frame["contact"].astype("Int64")
        return frame

    @cached_property
    def strikes(self) -> pd.DataFrame:
        """One row for each strike, in chronological order; the index is the number, from 1.

        Columns: the numbers of ``summary`` that belong to a strike, SI units, and
        ``check_end_time`` (the backcheck releases the hammer), ``key_return_time`` (the key is
        back). NaN: it did not happen in this strike. Empty if there are several strikes, and the
        samples that separate them were not stored (``summary_only``).
        """
        import pandas as pd

        return pd.DataFrame(
            self.strike_list, index=pd.RangeIndex(1, len(self.strike_list) + 1, name="strike")
        )

    @checked
    def event_time(self, name: str) -> float | None:
        """Time [s] of a named event; None if it did not happen."""
        names = self.event_table.get("event", [])
        return float(self.event_table["time"][names.index(name)]) if name in names else None

    @checked
    def string_displacement(self, position: npt.ArrayLike) -> Array:
        """Displacement of the string [m] at distances [m] from its end y = 0.

        Returns
        -------
        ndarray (n_times,) or (n_times, n_positions)
            Displacement w = sum phi_j(y) eta_j, positive away from the hammer, thesis eqs 4.12,
            4.15.
        """
        import numpy as np

        out: Array = self.eta @ self.string_shapes(position).T
        return out[:, 0] if np.ndim(position) == 0 else out

    def bridge_force(self) -> Array:
        """Force of the string on its bridge end [N], at the times of the run (n_times,)."""
        import numpy as np

        return np.asarray(self._string().bridge_force(np.ascontiguousarray(self.eta)))

    @checked
    def string_shapes(self, position: npt.ArrayLike) -> Array:
        """Mode shapes of the string [kg^-1/2] at distances [m] from its end y = 0.

        Returns
        -------
        ndarray (n_positions, n_modes)
            phi_j(y) of thesis eq. 4.12; their product with ``eta`` is the displacement [m].
        """
        import numpy as np

        string = self._string()
        y = np.atleast_1d(np.asarray(position, dtype=float))
        length = string.parameters.length
        if not np.all((y >= 0) & (y <= length)):
            bad = y[~((y >= 0) & (y <= length))][0]
            raise InvalidParameter(
                f"string_displacement: positions must lie in [0, {length:g}] m, got {bad:g}"
            )
        rows = [string.shapes(float(v))[0] for v in y.ravel()]
        return np.array(rows).reshape(-1, self.eta.shape[1])

    def _string(self) -> Any:
        from feltmb import _core

        parameters = self.provenance.get("string")
        if not parameters or self.eta.shape[1] == 0:
            raise InvalidParameter("the run has no modal string (string.kind = 'rigid_stop'?)")
        try:
            string = _core.ModalString(_core.StringParameters(**parameters))
        except TypeError:
            raise DataError("the run does not hold the parameters of its string") from None
        if string.parameters.modes != self.eta.shape[1]:
            raise DataError(
                f"the run holds {self.eta.shape[1]} modes of a string of {string.parameters.modes}"
            )
        return string

    @checked
    def write_wav(
        self,
        path: str | Path,
        *,
        position: float | None = None,
        rate: int = 44100,
        slowness: float = 1.0,
        force: bool = False,
    ) -> Path:
        """Write the vibration of the string as sound: 16 bit mono WAV, scaled to its largest value.

        Parameters
        ----------
        position
            Position of the displacement that is written [m]; default: the force at the bridge end.
        rate
            Sample rate of the file [Hz].
        slowness
            Factor of the duration; 2: half the speed.

        Notes
        -----
        The samples of the run are interpolated linearly, and partials above half of its output rate
        are lost. Simulate with ``output_rate`` of at least ``rate`` for the full bandwidth.
        """
        from feltmb.run.sound import sampled, wav

        check_suffix(Path(path), ".wav")
        if position is None:
            signal = self.bridge_force()
        else:
            signal = self.string_displacement(float(position))
        data = wav(sampled(self.time, signal, rate, slowness), rate)

        def write(target: Path) -> None:
            target.write_bytes(data)

        return write_file(Path(path), write, force=force)

    def _write_table(self, target: Path) -> None:
        import numpy as np

        titles = [f"{n} [{u}]" for n, u in zip(self.names, self.units, strict=True)]
        titles = [f'"{t}"' if "," in t else t for t in titles]
        np.savetxt(
            target,
            np.column_stack([self.time, self.values]),
            fmt="%.9g",
            delimiter=",",
            header=",".join(["time [s]", *titles]),
            comments="",
            encoding="utf-8",
        )

    @checked
    def save(self, path: str | Path, *, force: bool = False, compress: bool = True) -> Path:
        """Write one NetCDF-4 file that ``load_run`` can read, or a table of the outputs.

        Parameters
        ----------
        path
            File; ``.nc`` (or ``.h5``): everything; ``.csv``: the outputs over time, with names and
            units in the header.
        compress
            False: writing takes a quarter of the time, and the file is half as large again.
        """
        from unmodeled.files.netcdf import Variable, encode

        check_suffix(Path(path), ".nc", ".h5", ".csv")
        if Path(path).suffix.lower() == ".csv":
            return write_file(Path(path), self._write_table, force=force)
        size = self.values.size + self.eta.size + self.time.size
        if size > MOST_NUMBERS:
            raise InvalidParameter(
                f"{path}: the run holds {size} numbers, and a file at most {MOST_NUMBERS}; "
                "simulate with a lower output_rate"
            )
        provenance = self.provenance
        attributes: dict[str, str | int] = {
            "action": str(provenance.get("action", "")),
            "hash": str(provenance.get("hash", "")),
            "feltmb_version": str(provenance.get("version", "")),
            "status": self.status,
            "feltmb_format": FILE_FORMAT,
            "message": self.message,
            "coordinate_names": json.dumps(self.coordinates),
            "summary": json.dumps(self.summary),
            "energy": json.dumps(self.energy),
            "stats": json.dumps(self.stats),
            "provenance": json.dumps(
                provenance.whole() if isinstance(provenance, Provenance) else provenance
            ),
            "events": json.dumps(self.event_table),
            "strikes": json.dumps(self.strike_list),
        }
        over_time = ("time",)
        variables = [
            Variable("time", over_time, self.time, "s", "time"),
            *(
                Variable(name, over_time, self.values[:, i], unit, text)
                for i, (name, unit, text) in enumerate(
                    zip(self.names, self.units, self.long_names, strict=True)
                )
            ),
            Variable(
                "string.eta",
                ("time", "mode"),
                self.eta,
                "m kg^0.5",
                "modal coordinates of the string",
            ),
            Variable("end_state", ("state",), self.end_state, "SI", "state at end"),
            Variable(
                "end_memory",
                ("contact",),
                self.end_memory,
                "m",
                "largest compression that each contact remembers at the end",
            ),
        ]
        # HDF5 fails badly on a full disk: the file is made in memory and written as bytes.
        content = encode(variables, attributes, compress=compress)

        def write(target: Path) -> None:
            target.write_bytes(content)

        return write_file(Path(path), write, force=force)


class _Stats(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")
    reached: float


class _Provenance(BaseModel):
    model_config = ConfigDict(strict=True)
    stroke: dict[str, Any] | None = None
    options: dict[str, Any] | None = None
    string: dict[str, Any] | None = None
    toml: str | None = None


class _Events(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")
    __pydantic_extra__: dict[str, list[Any]]
    event: list[str] = Field(default_factory=list)
    time: list[float] = Field(default_factory=list)

    @model_validator(mode="after")
    def _even(self) -> _Events:
        columns = {name: getattr(self, name) for name in self.model_fields_set}
        if len({len(column) for column in columns.values()}) > 1:
            raise ValueError("the columns of the events differ in length")
        return self


class _Tables(BaseModel):
    """Tables of a saved run; its content is not trusted."""

    model_config = ConfigDict(strict=True)
    coordinate_names: list[Any]
    summary: dict[str, float]
    energy: dict[str, Any]
    stats: _Stats
    provenance: _Provenance
    events: _Events
    strikes: list[dict[str, float]]


def _array_faults(arrays: Mapping[str, Any]) -> list[str]:
    """Faults of the arrays of a file that make it unusable as a run."""
    import numpy as np

    faults = []
    time = arrays["time"]
    for name, array in arrays.items():
        dimensions = 2 if name in ("values", "string.eta") else 1
        if array.ndim != dimensions or not np.issubdtype(array.dtype, np.floating):
            faults.append(f"{name} is {array.dtype} of shape {array.shape}, expected numbers")
        elif dimensions == 2 and array.shape[0] != len(time):
            faults.append(f"{name} has {array.shape[0]} samples, time has {len(time)}")
    if not faults and not (np.all(np.isfinite(time)) and np.all(np.diff(time) > 0)):
        faults.append("time does not grow")
    return faults


#: Arrays of a saved run that are not outputs.
_SPECIAL = ("time", "string.eta", "end_state", "end_memory")


def _read_file(path: Path) -> tuple[dict[str, Any], dict[str, Any], dict[str, tuple[str, str]]]:
    """Attributes, arrays, and unit and description of each output, in the order of the file."""
    import numpy as np

    arrays: dict[str, Any] = {}
    texts: dict[str, tuple[str, str]] = {}
    with open_hdf5(path, most_bytes=8 * MOST_NUMBERS, track_order=True) as file:
        attributes = file.attributes()
        outputs = []
        faults = []
        for item in file.datasets():
            if "not a netCDF variable" in str(item.attribute("NAME")):
                continue
            if not item.is_numbers or item.dtype.kind != "f":
                faults.append(f"{shortened(item.name)} is {item.dtype}, expected numbers")
            elif item.name in _SPECIAL:
                arrays[item.name] = item.read()
            else:
                outputs.append(item)
        faults += [f"{shortened(n)} is {why}" for n, why in file.left_out.items()]
        length = arrays["time"].size if "time" in arrays else 0
        for item in outputs:
            if item.shape != (length,):
                faults.append(f"{shortened(item.name)} has shape {item.shape}, time has {length}")
        size = length + sum(math.prod(item.shape or ()) for item in outputs)
        if size > MOST_NUMBERS:
            raise ValueError(f"{size} numbers; the limit of a run is {MOST_NUMBERS}")
        if faults:
            raise DataError(f"{path}: is no complete run: " + "; ".join(faults[:20]))
        arrays["values"] = np.empty((length, len(outputs)))
        for i, item in enumerate(outputs):
            arrays["values"][:, i] = item.read()
            unit, text = (item.attribute(key) for key in ("units", "long_name"))
            texts[item.name] = (plain_text("" if unit is None else unit),
                                plain_text("" if text is None else text))  # fmt: skip
    return attributes, arrays, texts


def _plain(node: Any) -> Any:
    """Tables of a saved run, with texts that can be displayed and written."""
    if isinstance(node, str):
        return plain_text(node)
    if isinstance(node, dict):
        return {plain_text(key): _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(value) for value in node] if _holds_text(node) else node
    return node


def _holds_text(values: list[Any]) -> bool:
    return any(isinstance(value, (str, dict, list)) for value in values)


@checked
def load_run(path: str | Path) -> Run:
    """Read a run that ``Run.save`` has written.

    Raises
    ------
    DataError
        The file does not exist, is not a NetCDF file, or does not contain a complete run.
    """
    import numpy as np

    path = Path(path)
    try:
        attributes, arrays, texts = _read_file(path)
    except DataError:
        raise
    except HDF5_FAULTS as error:
        reason = shortened(str(error), 300)
        from unmodeled.data.columns import MEASURED_FILES

        hint = ""
        if path.suffix.lower() in MEASURED_FILES:
            hint = (
                "; to compare a measured file with a model: feltmb gap check MODEL FILE -o PICTURE"
            )
        raise DataError(f"{path}: is no NetCDF file of a run: {reason}{hint}") from None
    form = attributes.get("feltmb_format")
    if not isinstance(form, (int, float, np.number)) or form != FILE_FORMAT:
        raise DataError(
            f"{path}: feltmb_format is {shortened(repr(form))}, expected {FILE_FORMAT}; "
            "was it written by feltmb stroke?"
        )
    try:
        meta = {
            key: _plain(json.loads(attributes[key]))
            for key in ("coordinate_names", "summary", "energy", "stats", "provenance", "events")
        }
        meta["strikes"] = _plain(json.loads(attributes.get("strikes", "[]")))  # newer than files
        meta |= {key: renamed(meta[key]) for key in ("summary", "strikes")}
        special = {n: arrays[n] for n in (*_SPECIAL, "values")}
        names = tuple(texts)
        if faults := _array_faults(special):
            raise ValueError("; ".join(faults))
        _Tables.model_validate(meta)
        return Run(
            time=special["time"],
            names=names,
            units=tuple(unit for unit, _ in texts.values()),
            long_names=tuple(text for _, text in texts.values()),
            values=special["values"],
            eta=special["string.eta"],
            event_table=meta["events"],
            summary=meta["summary"],
            energy=meta["energy"],
            stats=meta["stats"],
            provenance=meta["provenance"],
            end_state=special["end_state"],
            end_memory=special["end_memory"],
            coordinates=tuple(map(str, meta["coordinate_names"])),
            status=plain_text(attributes["status"]),
            message=plain_text(attributes["message"]),
            strike_list=meta["strikes"],
        )
    except KeyError as error:
        raise DataError(f"{path}: is no complete run: {error} is missing") from None
    except ValidationError as error:
        faults = fault_lines(error, _Tables)
        raise DataError(f"{path}: is no complete run: {'; '.join(faults[:20])}") from None
    except (*HDF5_FAULTS, RecursionError) as error:
        reason = shortened(str(error), 300)
        raise DataError(f"{path}: is no complete run: {reason}") from None
