"""Runs: named time series with units, events, summary, energy ledger, statistics, provenance.

A :class:`Run` is data only; it knows no pianos. xarray and pandas are imported when their objects
are asked for.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.errors import DataError, InvalidParameter
from feltmb.files import is_file, write_file

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd
    import xarray as xr

    Array = npt.NDArray[np.float64]

__all__ = ["FILE_FORMAT", "Run", "load_run"]

FILE_FORMAT = 1


@dataclass(frozen=True, eq=False)
class Run:
    """What a simulation gave.

    Attributes
    ----------
    time : ndarray (n_times,)
        Sample times [s].
    values : ndarray (n_times, n_outputs)
        Samples of the outputs ``names`` in ``units``.
    eta : ndarray (n_times, n_modes)
        Modal coordinates of the string [m kg^1/2]; see ``string_displacement``.
    summary : dict
        Numbers of the run by name, SI units; a number that the run does not have is absent.
    energy : dict
        Ledger [J]; see ``docs/model.md``.
    stats : dict
        Work counts, wall time, states and contacts that limited the step most often.
    provenance : dict
        Version, data set, hash and text of all parameters, stroke, options.
    status : str
        ``done``, ``failed``, ``wall_time`` or ``interrupted``; ``message`` says why.
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
    _index: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_index", {name: i for i, name in enumerate(self.names)})

    def __repr__(self) -> str:
        action = self.provenance.get("action", "?")
        stroke = self.provenance.get("stroke", {}).get("name", "?")
        return (
            f"Run({action!r}, {stroke!r}, {len(self.time)} samples to {self.reached:g} s, "
            f"{self.status})"
        )

    @property
    def reached(self) -> float:
        """Last simulated time [s]."""
        return float(self.stats["reached"])

    def __getitem__(self, name: str) -> Array:
        """Samples of one output by name, shape (n_times,)."""
        try:
            return self.values[:, self._index[name]]
        except KeyError:
            import difflib

            near = difflib.get_close_matches(name, self.names, n=3)
            hint = f"; near are {', '.join(near)}" if near else ""
            raise InvalidParameter(f"run has no output {name!r}{hint}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._index

    def unit(self, name: str) -> str:
        """Unit of an output."""
        self[name]
        return self.units[self._index[name]]

    @cached_property
    def data(self) -> xr.Dataset:
        """Outputs over ``time`` [s]; every variable has the attributes units and long_name."""
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

    @cached_property
    def events(self) -> pd.DataFrame:
        """One row an event, in time.

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

    def event_time(self, name: str) -> float | None:
        """Time [s] of a named event, None if it did not happen."""
        names = self.event_table.get("event", [])
        return float(self.event_table["time"][names.index(name)]) if name in names else None

    def string_displacement(self, position: npt.ArrayLike) -> Array:
        """Displacement of the string [m] at distances [m] from its end y = 0.

        Returns
        -------
        ndarray (n_times,) or (n_times, n_positions)
            w = sum phi_j(y) eta_j, positive away from the hammer, thesis eqs 4.12, 4.15.
        """
        import numpy as np

        out: Array = self.eta @ self.string_shapes(position).T
        return out[:, 0] if np.ndim(position) == 0 else out

    def string_shapes(self, position: npt.ArrayLike) -> Array:
        """Mode shapes of the string [kg^-1/2] at distances [m] from its end y = 0.

        Returns
        -------
        ndarray (n_positions, n_modes)
            phi_j(y) of thesis eq. 4.12; times ``eta`` they give the displacement [m].
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
        return np.array([string.shapes(float(v))[0] for v in y])

    def _string(self) -> Any:
        from feltmb import _core

        parameters = self.provenance.get("string")
        if not parameters or self.eta.shape[1] == 0:
            raise InvalidParameter("the run has no modal string (string.kind = 'rigid_stop'?)")
        return _core.ModalString(_core.StringParameters(**parameters))

    def write_wav(
        self,
        path: str | Path,
        *,
        position: float | None = None,
        rate: int = 44100,
        slowness: float = 1.0,
        force: bool = False,
    ) -> Path:
        """Write the string as sound: 16 bit mono WAV, full scale at the largest value.

        Parameters
        ----------
        position
            Listen to the displacement here [m]; default: the force at the bridge end.
        rate
            Samples a second of the file.
        slowness
            2 plays at half the speed.

        Notes
        -----
        The samples of the run are interpolated linearly: partials above half its output rate are
        lost; simulate with ``output_rate`` of at least ``rate`` for the full band.
        """
        import wave

        import numpy as np

        if position is None:
            signal = self._string().bridge_force(np.ascontiguousarray(self.eta))
        else:
            signal = self.string_displacement(float(position))
        if not (0 < rate < 2**31 and 0 < slowness < float("inf")):
            raise InvalidParameter(
                f"wav: slowness {slowness:g} and rate {rate} must be finite numbers > 0"
            )
        length = float(self.time[-1] - self.time[0]) * slowness * rate
        if length > 1e9:
            raise InvalidParameter(
                f"wav: slowness {slowness:g} at rate {rate} gives {length:.3g} samples, "
                "must be at most 1e9"
            )
        count = max(2, int(length))
        grid = np.linspace(self.time[0], self.time[-1], count)
        sound = np.interp(grid, self.time, signal)
        top = float(np.max(np.abs(sound)))
        scaled = np.round(sound / top * 32000).astype("<i2") if top > 0 else np.zeros(count, "<i2")

        def write(target: Path) -> None:
            with wave.open(str(target), "wb") as out:
                out.setnchannels(1)
                out.setsampwidth(2)
                out.setframerate(rate)
                out.writeframes(scaled.tobytes())

        return write_file(Path(path), write, force=force)

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write one NetCDF-4 file that ``load_run`` reads back."""
        import numpy as np
        import xarray as xr

        data = self.data.copy()
        data.attrs.update(
            feltmb_format=FILE_FORMAT,
            message=self.message,
            coordinate_names=json.dumps(self.coordinates),
            summary=json.dumps(self.summary),
            energy=json.dumps(self.energy),
            stats=json.dumps(self.stats),
            provenance=json.dumps(self.provenance),
            events=json.dumps(self.event_table),
        )
        data["string.eta"] = (
            ("time", "mode"),
            self.eta,
            {"units": "m kg^0.5", "long_name": "modal coordinates of the string"},
        )
        data["end_state"] = ("state", self.end_state, {"units": "SI", "long_name": "state at end"})
        text = "largest compression that each contact remembers at the end"
        data["end_memory"] = ("contact", self.end_memory, {"units": "m", "long_name": text})
        encoding = {
            str(name): {"zlib": True, "complevel": 1, "shuffle": True}
            for name in data.data_vars
            if np.size(data[name]) > 0
        }

        assert isinstance(data, xr.Dataset)
        # HDF5 does not survive a full disk: made in memory, written as bytes.
        content = data.to_netcdf(engine="h5netcdf", encoding=encoding)

        def write(target: Path) -> None:
            target.write_bytes(content)

        return write_file(Path(path), write, force=force)


#: What the libraries below raise for a damaged file.
_HDF5_FAULTS = (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError)


def load_run(path: str | Path) -> Run:
    """Read a run that ``Run.save`` wrote."""
    import numpy as np
    import xarray as xr

    path = Path(path)
    if not is_file(path):
        raise DataError(f"{path}: there is no such file")
    try:
        with xr.open_dataset(path, engine="h5netcdf", phony_dims="sort") as opened:
            data = opened.load()
    except _HDF5_FAULTS as error:
        raise DataError(f"{path}: is no NetCDF file of a run: {error}") from None
    if data.attrs.get("feltmb_format") != FILE_FORMAT:
        raise DataError(
            f"{path}: feltmb_format is {data.attrs.get('feltmb_format')!r}, "
            f"expected {FILE_FORMAT}; was it written by feltmb stroke?"
        )
    try:
        meta = {
            key: json.loads(data.attrs[key])
            for key in ("coordinate_names", "summary", "energy", "stats", "provenance", "events")
        }
        for key, value in meta.items():
            if key != "coordinate_names" and not isinstance(value, dict):
                raise ValueError(f"{key} is no table")
        float(meta["stats"]["reached"])
        if len({len(column) for column in meta["events"].values()}) > 1:
            raise ValueError("the columns of the events differ in length")
        special = {"string.eta", "end_state", "end_memory"}
        names = tuple(str(n) for n in data.data_vars if n not in special)
        return Run(
            time=data["time"].to_numpy(),
            names=names,
            units=tuple(data[n].attrs["units"] for n in names),
            long_names=tuple(data[n].attrs["long_name"] for n in names),
            values=np.stack([data[n].to_numpy() for n in names], axis=1),
            eta=data["string.eta"].to_numpy(),
            event_table=meta["events"],
            summary=meta["summary"],
            energy=meta["energy"],
            stats=meta["stats"],
            provenance=meta["provenance"],
            end_state=data["end_state"].to_numpy(),
            end_memory=data["end_memory"].to_numpy(),
            coordinates=tuple(meta["coordinate_names"]),
            status=str(data.attrs["status"]),
            message=str(data.attrs["message"]),
        )
    except _HDF5_FAULTS as error:
        raise DataError(f"{path}: is no complete run: {error}") from None
