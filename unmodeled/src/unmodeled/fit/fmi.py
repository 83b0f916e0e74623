"""An FMU as a simulator, run by FMPy."""

from __future__ import annotations

import copy
import hashlib
import shutil
import tempfile
import threading
import weakref
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, evenly_spaced
from unmodeled.errors import InvalidParameter, message, near_names
from unmodeled.files import LARGEST_FILE, NPZ_FAULTS, open_input
from unmodeled.fit.priors import Bounds, Priors, Unknowns
from unmodeled.fit.simulator import Simulator
from unmodeled.models.model import Origin
from unmodeled.units import spelled_unit

#: Relative tolerance of model exchange: derivatives are differences of runs, and the integrator
#: starts anew at each sample with inputs (errors of 1e-5 at 200 samples).
RTOL = 1e-8
#: Largest number of files in an FMU, and size of its description [bytes], some 200 000 variables.
MOST_ENTRIES, LARGEST_TEXT = 10_000, 30_000_000
#: Held by the only thread that unpacks an FMU, or runs one that is instantiated once in a process.
_ALONE = threading.Lock()


def _fmpy() -> Any:
    try:
        import fmpy
    except ImportError:
        raise InvalidParameter("fmu: the package fmpy is not installed; pip install fmpy") from None
    return fmpy


class _Fmu:
    """Function that runs an FMU; every process that was not forked unpacks the FMU once.

    An input is linear between samples, or constant (``hold``), and outputs are those of the inputs
    at the same sample.
    """

    def __init__(
        self,
        path: Path,
        outputs: tuple[str, ...],
        kind: str,
        hold: str,
        at_end: frozenset[str],
        notices: tuple[str, ...],
    ):
        self.path, self.outputs, self.kind, self.hold = path, outputs, kind, hold
        self.at_end = at_end
        """Inputs that the FMU itself moves to the given value, which it reaches after the step."""
        self.notices = notices
        self.units: dict[str, str] = {}
        self.values: dict[str, float | None] = {}
        self.limits: dict[str, tuple[float, float]] = {}
        self.whole: Any = None
        """Description with all variables, whose reading takes seconds; None: not read yet."""
        self._folder = ""
        self._description: Any = None
        self._loaded: Any = None

    @property
    def version(self) -> str:
        """What identifies its results: the file, the way it is run, and FMPy."""
        sha256 = hashlib.sha256(self.path.read_bytes()).hexdigest()
        own = self.kind, self.hold, sorted(self.at_end), _fmpy().__version__
        return f"{self.path.name} sha256 {sha256} {own}"

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_folder": "", "whole": None, "_description": None, "_loaded": None}

    def __call__(
        self, time: Array, inputs: Mapping[str, Array], parameters: Mapping[str, float]
    ) -> dict[str, Array]:
        fmpy = _fmpy()
        with _ALONE:
            if not self._folder:
                self._folder = _unpacked(self.path)
                weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
                whole = self.whole or fmpy.read_model_description(self._folder, validate=False)
                used = {*inputs, *parameters, *self.outputs}
                own = [v for v in whole.modelVariables if v.name in used]
                self._description = copy.copy(whole)
                self._description.modelVariables = own
        if evenly_spaced(time):  # equal steps, whatever the rounding of the clock
            time = np.linspace(time[0], time[-1], time.size)
        table = np.zeros(time.size, dtype=[(n, np.float64) for n in ("time", *inputs)])
        table["time"] = time
        for name, values in inputs.items():
            table[name] = values
        run = self._exchanged if self.kind == "ModelExchange" else self._stepped
        once = self._interface.canBeInstantiatedOnlyOncePerProcess
        with _ALONE if once else nullcontext():
            fmu = self._instance(fmpy)
            try:
                seen = run(fmu, table, dict(parameters))
            finally:
                fmu.freeInstance()
        return {n: seen[n] for n in self.outputs}

    @property
    def _interface(self) -> Any:
        """What the FMU states about this kind of simulation."""
        return getattr(self._description, self.kind[0].lower() + self.kind[1:])

    def _instance(self, fmpy: Any) -> Any:
        """A new instance of the FMU, whose library is loaded once: that takes FMPy 30 ms."""
        if self._loaded is not None:
            fmu = copy.copy(self._loaded)
            fmu.instantiate()
            return fmu
        fmu = fmpy.simulation.instantiate_fmu(
            self._folder, self._description, self.kind, require_functions=False
        )
        if not self._interface.canBeInstantiatedOnlyOncePerProcess:
            self._loaded = copy.copy(fmu)
            fmu.freeLibrary = self._loaded.freeLibrary = _kept
        return fmu

    def _simulate(self, fmu: Any, table: Any, parameters: dict[str, float], **options: Any) -> Any:
        return _fmpy().simulate_fmu(
            self._folder,
            validate=False,
            model_description=self._description,
            fmu_instance=fmu,
            fmi_type=self.kind,
            start_time=float(table["time"][0]),
            start_values=parameters,
            input=table,
            output=list(self.outputs),
            **options,
        )

    def _exchanged(self, fmu: Any, table: Any, parameters: dict[str, float]) -> Any:
        """Outputs by model exchange."""
        time = table["time"]
        step = np.min(np.diff(time))
        if 1e-9 * np.max(np.abs(time)) > 1e-3 * step:
            raise InvalidParameter(
                f"{self.path.name}: FMPy cannot tell the times of the record apart, "
                f"{time[0]:.9g} s, {time[1]:.9g} s, ...; let its clock start near zero"
            )
        # Two rows at a sample are an event, also in a table without inputs, where FMPy's integrator
        # starts anew: else it would step across several samples, with the inputs of the first one.
        twice = np.repeat(table, 2)
        interval = float(time[-1] - time[0])
        if len(table.dtype) == 1 and evenly_spaced(time):  # FMPy stops at these samples by itself
            twice, interval = table, interval / (time.size - 1)
        if self.hold == "zero":
            for name in table.dtype.names[1:]:
                twice[name][2::2] = table[name][:-1]
        else:
            # FMPy sets the inputs between the steps of its integrator only.
            values = _fmpy().simulation.Input(fmu, self._description, table)
            set_time = fmu.setTime

            def at(moment: float) -> None:
                set_time(moment)
                values.apply(moment, discrete=False)

            fmu.setTime = at
        seen = self._simulate(
            fmu,
            twice,
            parameters,
            stop_time=float(time[-1]),
            output_interval=interval,
            relative_tolerance=RTOL,
        )
        return seen[np.searchsorted(seen["time"], time + 1e-3 * step, "right") - 1]

    def _stepped(self, fmu: Any, table: Any, parameters: dict[str, float]) -> Any:
        """Outputs by co-simulation, with the inputs at the end of each step."""
        simulation, does = _fmpy().simulation, self._description.coSimulation
        time = table["time"]
        steps = np.diff(time)
        if evenly_spaced(time):
            steps[:] = (time[-1] - time[0]) / steps.size
        elif not does.canHandleVariableCommunicationStepSize:
            raise InvalidParameter(
                f"{self.path.name}: takes steps of one duration only, and the times of the record "
                "are not even; interpolate the record to even times"
            )
        # Two constant values have the mean and the first moment of a line: with them, states are
        # those of the line up to the third order of the step. One value has the mean.
        linear = self.hold == "linear" and not self.at_end
        free = does.canHandleVariableCommunicationStepSize and not does.fixedInternalStepSize
        parts = 2 if linear and free else 1
        steps = np.repeat(steps / parts, parts)
        held = np.repeat(table, parts)[: steps.size]
        held["time"] = time[0] + np.append(0.0, np.cumsum(steps[:-1]))
        held["time"][::parts] = time[:-1]
        kept = {v.name for v in self._description.modelVariables if not _continuous(v)}
        for name in table.dtype.names[1:]:
            if name in self.at_end:
                held[name] = table[name][1:]
            elif linear and name not in kept:
                first, rise = table[name][:-1], np.diff(table[name])
                for part, share in enumerate((1 / 6, 5 / 6) if parts == 2 else (1 / 2,)):
                    held[name][part::parts] = first + share * rise
        options = {"stop_time": float(time[0]), "output_interval": steps[0]}
        self._simulate(fmu, table[:1], parameters, terminate=False, set_stop_time=False, **options)
        before = simulation.Input(fmu, self._description, held)
        after = simulation.Input(fmu, self._description, table)
        row = 0
        # The rows are at these times: FMPy would look for them and interpolate, at each step.
        before.interpolate = after.interpolate = lambda table, **_: (table[:, row], None)
        seen = simulation.Recorder(fmu, self._description, list(self.outputs))
        seen.sample(time[0])
        for k, (now, step) in enumerate(zip(held["time"], steps, strict=True), 1):
            row = k - 1
            before.apply(now, after_event=True)
            done = fmu.doStep(currentCommunicationPoint=now, communicationStepSize=step)
            if done is not None and done[1]:  # FMI 3.0
                raise RuntimeError(f"the FMU ends the simulation at t = {now + step:g} s")
            if k % parts == 0:
                row = k // parts
                after.apply(time[row], after_event=True)
                seen.sample(time[row])
        fmu.terminate()
        return seen.result()


def _kept() -> None:
    """Nothing: the library of an FMU stays loaded until the process ends."""


def _continuous(variable: Any) -> bool:
    """Whether an input changes between samples."""
    real = variable.type in ("Real", "Float64", "Float32")
    return real and variable.variability != "discrete"


def _channels(description: Any, causality: str) -> dict[str, str]:
    """Continuous inputs or outputs of an FMU, with their units as in :mod:`unmodeled.units`."""
    found = {}
    for v in description.modelVariables:
        if v.causality == causality and v.type in ("Real", "Float64", "Float32"):
            found[v.name] = _unit(v)
    return found


def _unit(variable: Any) -> str:
    """Unit of a variable in the form of :mod:`unmodeled.units`; empty: not stated, or not known."""
    declared = variable.declaredType
    unit = variable.unit or (declared.unit if declared is not None else None) or ""
    return spelled_unit(unit.replace(".", " ")) or "" if unit else ""


def _start(variable: Any) -> float | None:
    """Start value of a variable; None: it has none, or one that is no number."""
    try:
        return float(variable.start)
    except (TypeError, ValueError):
        return None


def _kind(path: Path, description: Any, kind: str | None) -> str:
    """Kind of the simulation: the stated one, else model exchange if the FMU has it."""
    kinds = [
        name
        for name, there in (
            ("ModelExchange", description.modelExchange),
            ("CoSimulation", description.coSimulation),
        )
        if there is not None
    ]
    if not kinds or (kind is not None and kind not in kinds):
        raise InvalidParameter(
            f"{path}: is an FMU for {' and '.join(kinds) or 'scheduled execution'}, expected "
            f"{kind or 'model exchange or co-simulation'}"
        )
    return kind or kinds[0]


def _limits(variables: Mapping[str, Any], names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Limits that an FMU states."""
    return {
        n: (
            -np.inf if v.min is None else float(v.min),
            np.inf if v.max is None else float(v.max),
        )
        for n, v in variables.items()
        if n in names and (v.min is not None or v.max is not None)
    }


#: Types of FMI 2 and 3 of real numbers.
FLOATS = ("Real", "Float64")


def _notices(
    kind: str, variables: Mapping[str, Any], inputs: Iterable[str], listed: Sequence[str]
) -> tuple[str, ...]:
    """Notes about how an FMU gets its inputs, and which of its parameters could be fitted.

    ``listed``: parameters that are fitted or are possible causes.
    """
    notices = []
    if kind == "CoSimulation" and inputs:
        notices.append(
            "co-simulation: outputs are read with the inputs of their sample; an FMU that "
            "computes them only in a step shows a direct influence late, by up to half a sample"
        )
    left = [n for n, v in variables.items() if v.causality == "input" and n not in inputs]
    if left:
        notices.append(f"its inputs {', '.join(left)} keep their start values")
    names = [n for n, v in variables.items() if v.causality == "parameter" and v.type in FLOATS]
    if names and not listed:
        text = (
            f"none of its parameters {', '.join(names)} is fitted: --parameter NAME=±SD states one "
            "that is uncertain, --unknown NAME=UNIT one that is a possible cause, such as a "
            "friction that is zero in the FMU"
        )
        notices.append(message(text))
    return tuple(notices)


def _unpacked(path: Path) -> str:
    """New folder with the content of an FMU; none is left behind if it cannot be unpacked."""
    folder = tempfile.mkdtemp()
    try:
        _check_size(path)
        return str(_fmpy().extract(str(path), folder))
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if not isinstance(error, Exception) or isinstance(error, InvalidParameter):
            raise
        raise InvalidParameter(f"{path}: cannot be unpacked as an FMU: {error}") from error


def _check_size(path: Path) -> None:
    """Raise an error if a file is no archive, or one whose content is too large to be unpacked."""
    with open_input(path, most=LARGEST_FILE, error=InvalidParameter) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
        except NPZ_FAULTS as error:
            raise InvalidParameter(f"{path}: cannot be read as an FMU: {error}") from None
    if len(entries) > MOST_ENTRIES:
        told = f"has {len(entries)} files; the limit is {MOST_ENTRIES} files"
        raise InvalidParameter(f"{path}: {told}")
    sizes = {e.filename: e.file_size for e in entries}
    text = "modelDescription.xml"
    for what, size, most in (
        ("unpacked it", sum(e.file_size for e in entries), LARGEST_FILE),
        (f"its {text}", sizes.get(text, 0), LARGEST_TEXT),
    ):
        if size > most:
            raise InvalidParameter(f"{path}: {what} has {size} bytes; the limit is {most} bytes")


def _described(path: Path) -> Any:
    """Description of the model in an FMU."""
    fmpy = _fmpy()
    _check_size(path)
    try:
        return fmpy.read_model_description(str(path))
    except Exception as error:
        raise InvalidParameter(f"{path}: cannot be read as an FMU: {error}") from error


@checked
def fmu(
    path: str | Path,
    *,
    parameters: Priors = (),
    unknown: Unknowns = None,
    inputs: Sequence[str] | Mapping[str, str] | None = None,
    outputs: Sequence[str] | Mapping[str, str] | None = None,
    bounds: Bounds = None,
    kind: Literal["ModelExchange", "CoSimulation"] | None = None,
    hold: Literal["linear", "zero"] = "linear",
    workers: int | None = None,
    name: str = "",
) -> Simulator:
    """An FMU as a model; requires the package ``fmpy``.

    Parameters
    ----------
    path
        File of the FMU.
    parameters, unknown, inputs, outputs, bounds
        As in :class:`Simulator`; the names are variables of the FMU. Default of the inputs and
        outputs: those of the FMU, with their units. The value of a parameter may be None: its start
        value in the FMU. An unknown effect with a unit has this value without the effect.
    kind
        Default: model exchange if the FMU has it. In co-simulation an FMU does not get inputs
        within a step; outputs are read after the inputs have got their values at its end.
    hold
        Input between samples: ``"linear"``, in co-simulation by two constant values with its mean
        and first moment; ``"zero"`` (constant at the value of the last sample, as for a
        digital-to-analog converter).
    workers, name
        As in :class:`Simulator`; the default name is the name of the FMU.

    Raises
    ------
    InvalidParameter
        FMPy is not installed, the file is not an FMU, or the FMU does not have these variables.
    """
    path = Path(path).absolute()
    again = {"unknown": unknown, "inputs": inputs, "outputs": outputs, "bounds": bounds}
    description = _described(path)
    variables = {v.name: v for v in description.modelVariables}
    if inputs is None:
        inputs = _channels(description, "input")
    every = outputs is None
    outputs = _channels(description, "output") if outputs is None else outputs
    listed = [*(p if isinstance(p, str) else p.name for p in parameters), *(unknown or {})]
    wanted = [*listed, *inputs, *outputs]
    missing = [n for n in wanted if n not in variables]
    if missing:
        raise InvalidParameter(
            f"{path}: has no variable {', '.join(missing)}{near_names(missing[0], variables)}; "
            f"there are {', '.join(sorted(variables))}"
        )
    run_as = _kind(path, description, kind)
    at_end = frozenset(
        n
        for n in inputs
        if (variables[n].description or "").endswith(("at the end of the step", "hold: linear"))
    )
    notices = _notices(run_as, variables, inputs, listed)
    function = _Fmu(path, tuple(outputs), run_as, hold, at_end, notices)
    function.whole = description
    function.units = {n: _unit(v) for n, v in variables.items()}
    function.values = {n: _start(v) for n, v in variables.items()}
    function.limits = _limits(variables, listed)
    out = Simulator(
        function,
        parameters=parameters,
        inputs=inputs,
        outputs=outputs,
        unknown=unknown,
        bounds=bounds,
        workers=workers,
        name=name or description.modelName,
    )
    out.origin = Origin("fmu", str(path), {**again, "kind": kind, "hold": hold, "name": name})
    out.open = False, every  # the records show which outputs are compared
    return out
