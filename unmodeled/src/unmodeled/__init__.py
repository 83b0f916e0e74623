"""Find what a simulation lacks when it does not match a measurement.

For example::

    import unmodeled

    prior = {"k": (9.0, 1.0, "N/m")}
    model = unmodeled.Equations(rates, states={"x": "m", "v": "m/s"}, parameters=prior)
    report = model.diagnose(unmodeled.read("runs/*.csv"))
    print(report)                           # which effect, how large, what it removes

Models
    Equations, Simulator (a function of yours), fmu, mujoco, FunctionModel, LinearModel; load_model:
    by the name of a file. Each has fit(records) and diagnose(records); servo_laws: what a remedy of
    a MuJoCo model holds beside MJCF
Records
    read (CSV, MAT, HDF5, NetCDF, Parquet, Feather, MCAP), records_from_frame, Record, Sensor
Diagnosis
    diagnose, fit_model, check (before any fit), candidates, Options, Report, Verdict; verify: it
    repeats the diagnosis of a folder that report.write wrote; withhold: a test of the diagnosis on
    simulated machines; read_measured, with_measured: tests of single parts
Packages
    data: records and files; fit: models and priors; library: effects; search: the engine; report;
    experiment: which record next
Errors
    Error, below it InvalidParameter, DataError, ModelError, FileExists

Inside, all numbers are in SI units. ``unmodeled --help`` shows the command line. Everything is
imported at its first use, so that ``import unmodeled`` is fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from unmodeled.blind import Withheld, withhold
    from unmodeled.data import Record, Sensor, StartPrior, read, records_from_frame
    from unmodeled.diagnosis import diagnose, fit_model
    from unmodeled.errors import DataError, Error, FileExists, InvalidParameter, ModelError
    from unmodeled.fit import (
        Coordinate,
        Coupling,
        Effect,
        Equations,
        Exposed,
        FunctionModel,
        LinearModel,
        Model,
        Parameter,
        Rate,
        Simulator,
        State,
        fmu,
        including,
        mujoco,
    )
    from unmodeled.fit.measured import Measured, read_measured, with_measured
    from unmodeled.fit.mjcf_laws import servo_laws
    from unmodeled.library.defaults import candidates
    from unmodeled.loading import load_model
    from unmodeled.report import Explained, Report, explained_model
    from unmodeled.search.compare import Comparison, check
    from unmodeled.search.options import Options
    from unmodeled.search.progress import Progress, Stop
    from unmodeled.search.result import Verdict
    from unmodeled.verification import Verification, verify

    __version__: str

__all__ = [
    "Comparison",
    "Coordinate",
    "Coupling",
    "DataError",
    "Effect",
    "Equations",
    "Error",
    "Explained",
    "Exposed",
    "FileExists",
    "FunctionModel",
    "InvalidParameter",
    "LinearModel",
    "Measured",
    "Model",
    "ModelError",
    "Options",
    "Parameter",
    "Progress",
    "Rate",
    "Record",
    "Report",
    "Sensor",
    "Simulator",
    "StartPrior",
    "State",
    "Stop",
    "Verdict",
    "Verification",
    "Withheld",
    "__version__",
    "candidates",
    "check",
    "diagnose",
    "explained_model",
    "fit_model",
    "fmu",
    "including",
    "load_model",
    "mujoco",
    "read",
    "read_measured",
    "records_from_frame",
    "servo_laws",
    "verify",
    "with_measured",
    "withhold",
]

#: module -> names that are imported at their first use
_LAZY = {
    "unmodeled.blind": "Withheld withhold",
    "unmodeled.data": "Record Sensor StartPrior read records_from_frame",
    "unmodeled.diagnosis": "diagnose fit_model",
    "unmodeled.errors": "DataError Error FileExists InvalidParameter ModelError",
    "unmodeled.fit": "Coordinate Coupling Effect Equations Exposed FunctionModel LinearModel Model "
    "Parameter Rate Simulator State fmu including mujoco",
    "unmodeled.fit.measured": "Measured read_measured with_measured",
    "unmodeled.fit.mjcf_laws": "servo_laws",
    "unmodeled.library.defaults": "candidates",
    "unmodeled.loading": "load_model",
    "unmodeled.report": "Explained Report explained_model",
    "unmodeled.search.compare": "Comparison check",
    "unmodeled.search.options": "Options",
    "unmodeled.search.progress": "Progress Stop",
    "unmodeled.search.result": "Verdict",
    "unmodeled.verification": "Verification verify",
}
_HOME = {name: module for module, names in _LAZY.items() for name in names.split()}
_PACKAGES = ("data", "experiment", "fit", "library", "report", "search", "units")


def __getattr__(name: str) -> object:
    """Import a name at its first use, for example ``unmodeled.diagnose``."""
    import importlib

    if name == "__version__":
        from importlib.metadata import version

        return version("unmodeled")
    if name in _HOME:
        value = getattr(importlib.import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    if name in _PACKAGES:
        return importlib.import_module(f"unmodeled.{name}")
    raise AttributeError(f"module 'unmodeled' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, *_PACKAGES})
