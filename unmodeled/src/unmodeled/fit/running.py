"""Runs of a function of a whole record: in this process or others, each computed once."""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time as clock
import warnings
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Generic, TypeVar

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.fit.runs import StoredRuns
from unmodeled.models.elsewhere import Means
from unmodeled.ode.calling import explained

# --------------------------------------------------------------------------------- the last values


K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Latest(Generic[K, V]):
    """A cache of recently used values that several threads may use.

    Unlike ``functools.lru_cache``, it can limit the sum of the sizes of the values, and a value
    need not be computed from its key alone.

    Parameters
    ----------
    most
        Largest sum of the sizes of all values; the last value is kept in any case.
    size
        Function that gives the size of a value; default: 1.
    """

    def __init__(self, most: int, size: Callable[[V], int] = lambda _: 1):
        self._most = most
        self._size = size
        self._total = 0
        self._made: OrderedDict[K, V] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """Number of stored values."""
        return len(self._made)

    def find(self, key: K) -> V | None:
        """Value of a key; None if it is not stored."""
        with self._lock:
            if key not in self._made:
                return None
            self._made.move_to_end(key)
            return self._made[key]

    def keep(self, key: K, value: V) -> None:
        """Store a value, replacing an older value of the key; remove the oldest values."""
        with self._lock:
            if key in self._made:
                self._total -= self._size(self._made.pop(key))
            self._made[key] = value
            self._total += self._size(value)
            while self._total > self._most and len(self._made) > 1:
                self._total -= self._size(self._made.popitem(last=False)[1])

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Value of a key; it is computed if it is not stored.

        Two threads that request the same value at the same time may both compute it.
        """
        with self._lock:
            if key in self._made:
                self._made.move_to_end(key)
                return self._made[key]
        made = make()
        self.keep(key, made)
        return made


# -------------------------------------------------------------------------------------------- runs


#: Largest number of cached values (two hundred megabytes).
KEPT = 25_000_000

Function = Callable[..., Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class Run:
    """A requested run."""

    record: str
    time: Array
    inputs: dict[str, Array]
    parameters: dict[str, float]
    repeated: bool = False
    """Whether it repeats a run, to see whether the function returns the same again."""

    @classmethod
    def of(cls, record: Record, inputs: Sequence[str], parameters: dict[str, float]) -> Run:
        """Run of a whole record with given parameters."""
        return cls(record.name, record.time, {n: record.inputs[n] for n in inputs}, parameters)

    @property
    def key(self) -> bytes:
        """Hash of all arguments of the function."""
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.time, *self.inputs.values()):
            digest.update(np.ascontiguousarray(array).tobytes())
        digest.update(np.array(list(self.parameters.values())).tobytes())
        digest.update(b"again" * self.repeated)
        return digest.digest()

    def __str__(self) -> str:
        values = ", ".join(f"{k} = {v:.6g}" for k, v in self.parameters.items())
        return (
            f"record {self.record}, {len(self.time)} samples from {self.time[0]:g} to "
            f"{self.time[-1]:g} s; parameters {values or 'none'}"
        )


#: The function, in a worker process.
_function: Function | None = None


def _begin(function: Function | bytes) -> None:
    """Start of a process: the function is inherited or unpickled; the parent handles Ctrl-C."""
    global _function
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _function = pickle.loads(function) if isinstance(function, bytes) else function


def _work(run: Run, outputs: tuple[str, ...]) -> Array | str:
    assert _function is not None
    return call(_function, run, outputs)


@lru_cache(maxsize=4)
def _unpickled(function: bytes) -> Function:
    """The function in a process of an executor, which keeps what it has read or compiled."""
    made: Function = pickle.loads(function)
    return made


def _sent(function: bytes, run: Run, outputs: tuple[str, ...]) -> Array | str:
    return call(_unpickled(function), run, outputs)


class Unusable(InvalidParameter):
    """The function returned a value of the wrong form."""


def call(function: Function, run: Run, outputs: tuple[str, ...]) -> Array | str:
    """Outputs of one run, (n, ny), or the exception of the function.

    Raises
    ------
    Unusable
        An output is missing or has another length.
    """
    inputs = {k: v.copy() for k, v in run.inputs.items()}  # the function may modify them
    try:
        with np.errstate(all="ignore"):
            given = function(run.time.copy(), inputs, dict(run.parameters))
    except Error as error:
        return str(error)
    except Exception as error:
        return explained(error)
    if not isinstance(given, Mapping):
        raise Unusable(
            f"returned {type(given).__name__}, expected a dictionary of arrays by output: "
            f"{', '.join(outputs)}"
        )
    missing = [n for n in outputs if n not in given]
    if missing:
        there = ", ".join(map(str, given)) or "none"
        raise Unusable(f"returned no output {', '.join(missing)}; there is {there}")
    found = np.empty((len(run.time), len(outputs)))
    for i, name in enumerate(outputs):
        try:
            values = np.asarray(given[name], dtype=np.float64)
        except (TypeError, ValueError):
            raise Unusable(f"output {name} holds no numbers: {given[name]!r:.80}") from None
        if values.shape != run.time.shape:
            raise Unusable(
                f"output {name} has shape {values.shape}, expected one value for each time, "
                f"{run.time.shape}"
            )
        found[:, i] = values
    return found


def cores() -> int:
    """Number of cores that this process may use."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return there or 1


#: Longest wait for the end of processes, which those that have nothing to do need not [s].
IDLE = 1.0


def _end(pool: Any) -> None:
    """End the processes of a pool, without a long wait for a run of the user's function.

    At the end of Python a pool whose thread is just closing its pipe raised an exception.
    """
    given = {"wait": True, "cancel_futures": True}
    ending = threading.Thread(target=pool.shutdown, kwargs=given, daemon=True)
    with suppress(RuntimeError):  # Python ends, and ends the pool
        ending.start()
        ending.join(IDLE)


class Runner:
    """Computes runs and caches the results.

    A function with a method ``run_all(runs, workers)`` computes several runs at once, unless there
    is an executor.
    """

    def __init__(
        self, function: Function, outputs: tuple[str, ...], name: str, means: Means, words: object
    ):
        self._function = function
        self._outputs = outputs
        self._name = name
        self._kept: Latest[bytes, Array] = Latest(KEPT, lambda values: values.size)
        self._workers = means.workers
        self._pool: Any = means.executor
        self._task: Callable[..., Array | str] = _work
        if self._pool is not None:
            self._task = self._portable()
        self._stored = None
        if means.cache is not None:
            self._stored = StoredRuns(means.cache, function, words, name)
        self._failed = False
        self.made = 0
        """Number of runs so far."""
        self.found = 0
        """Number of runs that were taken from the folder so far."""
        self.notices: list[str] = list(getattr(function, "notices", ()))
        """Notes for the user about processes, and those of the function."""

    def _portable(self) -> Callable[..., Array | str]:
        """What an executor is given: threads get the function itself, others get it pickled."""
        if isinstance(self._pool, ThreadPoolExecutor):
            return partial(call, self._function)
        try:  # Dask has it; it also pickles closures, and functions of scripts and notebooks
            import cloudpickle as pickler
        except ImportError:
            pickler = pickle
        try:
            return partial(_sent, pickler.dumps(self._function))
        except Exception as error:
            raise InvalidParameter(
                f"model {self._name}: its function cannot be sent to the executor: "
                f"{type(error).__name__}: {error}; expected a function at the top level of a "
                "module that uses nothing open (file, lock, connection): let it open that itself"
            ) from None

    def start(self) -> None:
        """Start processes, before there are threads."""
        if self._pool is not None or hasattr(self._function, "run_all"):
            return
        count = self._workers or cores()
        if count == 1:
            return
        given: Function | bytes = self._function
        if sys.platform == "linux":
            # With fork, closures, notebooks and scripts without a guard of __main__ work as well.
            # The processes only call the function, so that they do not wait for a lock of this
            # process.
            context = multiprocessing.get_context("fork")
        else:
            context = multiprocessing.get_context("spawn")
            try:
                given = pickle.dumps(self._function)
            except Exception as error:
                self.notices.append(
                    f"its function cannot be pickled ({error}): runs are sequential. Define it "
                    "at the top level of a module to use parallel processes"
                )
                return
        pool = None
        try:
            from concurrent.futures import ProcessPoolExecutor  # not in a browser

            pool = ProcessPoolExecutor(count, context, _begin, (given,))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # of a fork
                pool.submit(os.getpid).result()
        except (ImportError, OSError, RuntimeError) as error:
            if pool is not None:
                pool.shutdown(wait=False)
            self.notices.append(f"no process could be started ({error}): runs are made in this one")
            return
        weakref.finalize(self, _end, pool)
        self._pool = pool

    def first(self, run: Run) -> tuple[float, Array]:
        """Duration of a second run [s], and its values, which should equal those of the first.

        Raises
        ------
        InvalidParameter
            The function fails.
        """
        self.values([run], must=True)  # the first call includes imports and tables of the function
        repeated = replace(run, repeated=True)
        known = self._recalled([repeated])
        if known[0] is not None:  # whoever keeps runs has long ones
            return math.inf, known[0]
        tick = clock.perf_counter()
        again = self._one(repeated)
        self.made += 1
        if isinstance(again, str):
            raise InvalidParameter(f"model {self._name}: its function raises {again} ({run})")
        return clock.perf_counter() - tick, again

    @contextmanager
    def trying(self) -> Iterator[None]:
        """A block in which a failed run is no news."""
        before, self._failed = self._failed, True
        try:
            yield
        finally:
            self._failed = before

    def values(self, runs: Sequence[Run], must: bool = False) -> list[Array]:
        """Outputs of runs, (n, ny) each; NaN if the function fails.

        Raises
        ------
        InvalidParameter
            A run that ``must`` succeed failed; the message names the first such run and its fault.
        """
        keys = [run.key for run in runs]
        known = {k: self._kept.find(k) for k in keys}
        found = {k: values for k, values in known.items() if values is not None}
        new = {k: run for k, run in zip(keys, runs, strict=True) if k not in found}
        for (key, run), got in zip(new.items(), self._make(list(new.values())), strict=True):
            fault = f"raises {got}" if isinstance(got, str) else self._undefined(run, got)
            if fault and (must or not self._failed):
                text = f"model {self._name}: its function {fault} ({run})"
                if must:
                    raise InvalidParameter(text)
                self._failed = True
                text += "; this trial, and others like it, count as failed"
                warnings.warn(text, RuntimeWarning, stacklevel=2)
            if isinstance(got, str):
                got = np.full((len(run.time), len(self._outputs)), np.nan)
            found[key] = got
            self._kept.keep(key, got)
        return [found[k] for k in keys]

    def _undefined(self, run: Run, found: Array) -> str:
        """The first value that is not finite, as text; empty: all are."""
        bad = np.argwhere(~np.isfinite(found))
        if not bad.size:
            return ""
        j, i = bad[0]
        return f"returns {found[j, i]} for {self._outputs[i]} at t = {run.time[j]:g} s, sample {j}"

    def took(self, run: Run, given: Any) -> None:
        """Keep what the function returned for a run already, if it is of use."""
        found = self._one(run, lambda *_: given)
        if not isinstance(found, str) and not self._undefined(run, found):
            self._kept.keep(run.key, found)

    def _one(self, run: Run, function: Function | None = None) -> Array | str:
        try:
            found = call(function or self._function, run, self._outputs)
        except Unusable as error:
            raise self._invalid(run, error) from None
        return self._keeping(run, found)

    def _keeping(self, run: Run, found: Array | str) -> Array | str:
        """Store what a run returned; what it raised may have another cause than its arguments."""
        if self._stored is not None and not isinstance(found, str):
            self._stored.put(run.key, found)
        return found

    def _recalled(self, runs: Sequence[Run]) -> list[Array | None]:
        """Stored outputs of runs; None: there are none."""
        if self._stored is None:
            return [None] * len(runs)
        shapes = [(len(run.time), len(self._outputs)) for run in runs]
        got = [self._stored.get(r.key, s) for r, s in zip(runs, shapes, strict=True)]
        self.found += sum(values is not None for values in got)
        return got

    def _invalid(self, run: Run, error: Unusable) -> InvalidParameter:
        return InvalidParameter(f"model {self._name}: its function {error} ({run})")

    def _make(self, runs: Sequence[Run]) -> list[Array | str]:
        known = self._recalled(runs)
        new = iter(self._computed([r for r, y in zip(runs, known, strict=True) if y is None]))
        return [next(new) if values is None else values for values in known]

    def _computed(self, runs: Sequence[Run]) -> list[Array | str]:
        out: list[Array | str] = []
        # Own processes also make a single run: one that ends its process does not end this one.
        if self._pool is None or len(runs) < (1 if self._task is _work else 2):
            together = getattr(self._function, "run_all", None)  # it has threads of its own
            given = iter(together(runs, self._workers) if together and runs else ())
            for run in runs:
                out.append(self._one(run, (lambda *_: next(given)) if together else None))
                self.made += 1
            return out
        futures: list[Any] = []
        try:
            futures += (self._pool.submit(self._task, run, self._outputs) for run in runs)
            for run, future in zip(runs, futures, strict=True):
                out.append(self._keeping(run, future.result()))
                self.made += 1
        except Unusable as error:
            raise self._invalid(runs[len(out)], error) from None
        except Error:
            raise
        except Exception as error:
            raise InvalidParameter(self._lost(runs[len(out)], error)) from error
        finally:
            for future in futures[len(out) :]:
                future.cancel()
        return out

    def _lost(self, run: Run, error: Exception) -> str:
        """Message about a run that ended outside of the function."""
        if isinstance(error, BrokenExecutor):
            return (
                f"model {self._name}: a process of its function ended without an answer, as after "
                f"a fault of memory, with this or another run of the batch ({run}); workers=1 runs "
                "it in this process"
            )
        return (
            f"model {self._name}: the executor raises {type(error).__name__}: {error} ({run}); its "
            "workers need unmodeled, and the modules and files of the function"
        )
