"""Models whose runs are computed in other processes, and kept in a folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from typing import Any

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.models.model import Model


@dataclass(frozen=True)
class Means:
    """Where runs are computed and kept; see :func:`running`."""

    workers: int | None = None
    executor: Any = None
    cache: Path | None = None


@checked
def running(
    model: Model,
    *,
    executor: Any = None,
    cache: str | Path | None = None,
    workers: int | None = None,
) -> Model:
    """The same model, whose runs are computed and kept elsewhere.

    Only for models that are functions of a whole record: :class:`~unmodeled.Simulator`,
    :func:`~unmodeled.fmu`, :func:`~unmodeled.mujoco`.

    Parameters
    ----------
    executor
        Executor of ``concurrent.futures``, or a Dask client: anything with ``submit``, which
        returns a future. Batches of runs are submitted to it; single runs are made in this
        process. The function is pickled, unless the executor is one of threads. It is not shut
        down.
    cache
        Folder of finished runs, which are not computed again. They belong to the file that
        defines the function (or to the attribute ``version`` of the function), to the names of
        inputs, outputs and parameters, and to the bytes of times, inputs and parameters. A
        change of another module, library or program is not seen: delete the folder, or change
        ``version``. A run that raises an exception is not kept.
    workers
        Number of processes of this machine, for MuJoCo of threads.

    Raises
    ------
    InvalidParameter
        The model is of another kind, the function cannot be pickled, or nothing identifies it.
    """
    if executor is None and cache is None and workers is None:
        return model
    if workers is not None and (workers < 1 or executor is not None):
        beside = " and an executor" * (executor is not None)
        raise InvalidParameter(
            f"model {model.name}: workers = {workers}{beside}, expected a whole number >= 1, or "
            "an executor alone"
        )
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InvalidParameter(
            f"model {model.name}: executor is {type(executor).__name__}, expected one of "
            "concurrent.futures or a Dask client: an object with submit"
        )
    folder = None if cache is None else Path(cache).expanduser()
    return by_means(model, Means(workers, executor, folder))


@singledispatch
def by_means(model: Model, means: Means) -> Model:
    """The same model with other means; only of a function of a whole record."""
    del means
    raise InvalidParameter(
        f"model {model.name}: executor, workers and cache are for a Simulator, an FMU or a "
        f"MuJoCo model, got {type(model).__name__}, whose runs are computed together in this "
        "process"
    )


@singledispatch
def cached(model: Model) -> str:
    """How many runs so far were taken from the folder of :func:`running`; empty: none."""
    del model
    return ""


@singledispatch
def resumed(model: Model) -> str:
    """What is kept of a diagnosis that ends before its answer, and how to go on."""
    del model
    return (
        "nothing is kept, and the same command begins anew; an interruption after the first "
        "fit gives an answer, as a limit of time does (--seconds, in Python Options(seconds=))"
    )
