"""An FMU as a simulator, run by FMPy."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array
from feltmb.errors import InvalidParameter
from feltmb.files import is_file
from feltmb.fit.model import Effect, Parameter
from feltmb.fit.simulator import Exposed, SimulatorModel

__all__ = ["fmu_model"]


def _fmpy() -> Any:
    try:
        import fmpy
    except ImportError:
        raise InvalidParameter(
            "fmu_model: the package fmpy is not installed; pip install fmpy"
        ) from None
    return fmpy


class _Fmu:
    """Function that runs an FMU; every process that was not forked unpacks the FMU once."""

    def __init__(self, path: Path, outputs: tuple[str, ...], kind: str | None):
        self.path, self.outputs, self.kind = path, outputs, kind
        self._folder = ""

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_folder": ""}

    def __call__(
        self, time: Array, inputs: Mapping[str, Array], parameters: Mapping[str, float]
    ) -> dict[str, Array]:
        fmpy = _fmpy()
        if not self._folder:
            self._folder = fmpy.extract(str(self.path), tempfile.mkdtemp())
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        table = np.zeros(time.size, dtype=[(n, np.float64) for n in ("time", *inputs)])
        table["time"] = time
        for name, values in inputs.items():
            table[name] = values
        seen = fmpy.simulate_fmu(
            self._folder,
            validate=False,
            fmi_type=self.kind,
            start_time=float(time[0]),
            stop_time=float(time[-1]),
            output_interval=float(np.min(np.diff(time))),
            start_values=dict(parameters),
            input=table if inputs else None,
            output=list(self.outputs),
        )
        return {n: np.interp(time, seen["time"], seen[n]) for n in self.outputs}


@checked
def fmu_model(
    path: str | Path,
    *,
    parameters: Sequence[Parameter],
    inputs: Sequence[str] | Mapping[str, str],
    outputs: Sequence[str] | Mapping[str, str],
    exposed: Mapping[str, Exposed | Effect] | None = None,
    kind: str | None = None,
    workers: int | None = None,
    name: str = "",
) -> SimulatorModel:
    """An FMU as a model; requires the package ``fmpy``.

    Parameters
    ----------
    path
        File of the FMU.
    parameters, inputs, outputs, exposed
        As in :class:`SimulatorModel`; the names are variables of the FMU.
    kind
        "CoSimulation" or "ModelExchange"; default: the first one in the FMU.
    workers, name
        As in :class:`SimulatorModel`; the default name is the name of the FMU.

    Raises
    ------
    InvalidParameter
        FMPy is not installed, the file is not an FMU, or the FMU does not have these variables.
    """
    fmpy = _fmpy()
    path = Path(path).absolute()
    if not is_file(path):
        raise InvalidParameter(f"{path}: there is no such file")
    try:
        description = fmpy.read_model_description(str(path))
    except Exception as error:
        raise InvalidParameter(f"{path}: cannot be read as an FMU: {error}") from error
    known = {v.name for v in description.modelVariables}
    wanted = [*(p.name for p in parameters), *(exposed or {}), *inputs, *outputs]
    missing = [n for n in wanted if n not in known]
    if missing:
        raise InvalidParameter(
            f"{path}: has no variable {', '.join(missing)}; there are {', '.join(sorted(known))}"
        )
    return SimulatorModel(
        _Fmu(path, tuple(outputs), kind),
        parameters=parameters,
        inputs=inputs,
        outputs=outputs,
        exposed=exposed,
        workers=workers,
        name=name or description.modelName,
    )
