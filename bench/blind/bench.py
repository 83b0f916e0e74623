"""The blind bench: seals truths, makes records, diagnoses them, stores every result in a file.

Folder of a bench::

    seal.json       seed, number of cases, SHA-256 of truths.json and of the kinds from outside
    truths.json     what was withheld, written and hashed before anything is diagnosed
    records/N.npz   what the engine is shown
    results/N.json  what the engine said
    answers/N.json  what only the scorer reads, made from the sealed truths once there is a result

All files are written completely or not at all, so that an interrupted bench can continue.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, Literal

from blind.action_machine import ActionMachine
from blind.machine import Machine, as_json, digest_of, sha256
from blind.small_machine import KeyHammerMachine
from feltmb.errors import DataError, FileExists, InvalidParameter
from feltmb.files import LARGEST_JSON, make_folder, read_input, read_json, write_text

__all__ = ["MACHINES", "Bench", "Half"]

Half = Literal["development", "test", "both"]
MOST_CASES = 100_000
#: Machines by name.
MACHINES: dict[str, Machine] = {m.name: m for m in (KeyHammerMachine(), ActionMachine())}
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Bench:
    """A bench in a folder.

    Parameters
    ----------
    folder
        Folder of the bench.
    outside
        Python file with further kinds from outside the library.
    machine
        Name of the machine, see :data:`MACHINES`.
    """

    folder: Path
    outside: Path | None = None
    machine: Machine = MACHINES["key_hammer"]

    # ------------------------------------------------------------ sealing

    def seal(self, cases: int, seed: int, *, resume: bool = False) -> dict[str, Any]:
        """Draw the truths and write their hash, before any diagnosis."""
        if not 1 <= cases <= MOST_CASES or seed < 0:
            raise InvalidParameter(
                f"cases = {cases}, seed = {seed}: expected 1 to {MOST_CASES} and >= 0"
            )
        path = self.folder / "seal.json"
        if path.exists():
            seal = self.sealed()
            if not resume:
                raise FileExists(f"{self.folder}: holds a bench already; go on with --resume")
            wanted = {"cases": cases, "seed": seed, "outside": self._outside_hash()}
            wanted["machine"] = self.machine.name
            other = [f"{k} = {seal[k]}, got {v}" for k, v in wanted.items() if seal[k] != v]
            if other:
                raise InvalidParameter(f"{path}: the bench was sealed with {'; '.join(other)}")
            return seal
        from feltmb import __version__

        text = as_json(self.machine.draw(seed, cases, self.outside))
        make_folder(self.folder)
        write_text(self.folder / "truths.json", text, force=True)
        seal = {
            "version": __version__,
            "machine": self.machine.name,
            "cases": cases,
            "seed": seed,
            "sealed": datetime.now(UTC).isoformat(timespec="seconds"),
            "truths_sha256": sha256(text.encode()),
            "generator_sha256": digest_of(*self.machine.generator),
            "outside": self._outside_hash(),
        }
        write_text(path, as_json(seal))
        return seal

    def sealed(self) -> dict[str, Any]:
        """Return the seal, after a check that the truths are the sealed ones."""
        path = self.folder / "seal.json"
        try:
            seal: dict[str, Any] = read_json(path)
            truths = read_input(self.folder / "truths.json", most=LARGEST_JSON)
        except DataError as error:
            raise InvalidParameter(f"{self.folder}: is no bench: {error}") from None
        kinds = {"cases": int, "seed": int, "truths_sha256": str, "outside": str, "version": str,
                 "sealed": str, "machine": str}  # fmt: skip
        wrong = [
            k for k, t in kinds.items() if not isinstance(seal, dict) or type(seal.get(k)) is not t
        ]
        if not wrong and not isinstance(seal.get("generator_sha256", ""), str):
            wrong = ["generator_sha256"]
        if wrong or not 1 <= seal["cases"] <= MOST_CASES:
            raise InvalidParameter(f"{path}: is damaged: {', '.join(wrong) or 'cases'}")
        if sha256(truths) != seal["truths_sha256"]:
            raise InvalidParameter(f"{self.folder}: truths.json is not what was sealed")
        return seal

    def _outside_hash(self) -> str:
        return "" if self.outside is None else sha256(self.outside.read_bytes())

    def numbers(self, half: Half) -> list[int]:
        """Numbers of the cases of a half: even ones for development, odd ones for the test."""
        every = range(int(self.sealed()["cases"]))
        return [n for n in every if half == "both" or (n % 2 == 0) == (half == "development")]

    # ------------------------------------------------------------ work

    def make_records(
        self,
        half: Half = "both",
        *,
        workers: int = 2,
        executor: Executor | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Simulate the records of all cases that have none.

        ``executor``: any ``concurrent.futures.Executor``, for example ``client.get_executor()`` of
        Dask, in place of ``workers`` processes. Its workers must see the folder of the bench under
        the same path and import this package; the executor is not shut down.
        """
        todo = [n for n in self.numbers(half) if not self._has("records", n)]
        self._generate("records", self.machine.make_records, todo, workers, executor, progress)

    def make_answers(
        self,
        half: Half = "both",
        *,
        workers: int = 2,
        executor: Executor | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Write the answers of all cases that have a result and no answer.

        ``executor``: see :meth:`make_records`.
        """
        known = [n for n in self.numbers(half) if self._has("results", n)]
        todo = [n for n in known if not self.answered(n)]
        self._generate("answers", self.machine.make_answers, todo, workers, executor, progress)

    def _generate(
        self,
        what: str,
        make: Callable[[Path, Path | None, Sequence[int]], None],
        todo: Sequence[int],
        workers: int,
        executor: Executor | None,
        progress: Progress | None,
    ) -> None:
        """Make files of cases with the generator of the seal."""
        seal = self.sealed()
        if todo and seal.get("outside", "") != self._outside_hash():
            raise InvalidParameter(
                f"{self.folder}: {len(todo)} cases have no {what}, and the bench was sealed with "
                "another file of kinds from outside (--outside)"
            )
        # Seals of older versions have no hash of the generator.
        sealed, today = seal.get("generator_sha256"), digest_of(*self.machine.generator)
        if todo and sealed is not None and sealed != today:
            raise InvalidParameter(
                f"{self.folder}: {len(todo)} cases have no {what}, and the files of the generator "
                f"changed since the seal (SHA-256 {sealed[:12]}, now {today[:12]}): all cases of a "
                "bench must come from the same generator. Make a new bench, or go on with the "
                "version that sealed this one"
            )
        size = self.machine.chunk
        chunks = [todo[i : i + size] for i in range(0, len(todo), size)]
        batches = [(_make, (make, self.folder, self.outside, chunk)) for chunk in chunks]
        done = 0
        for made in _run(batches, workers, executor):
            done += len(made)
            if progress is not None:
                progress(what, done, len(todo))

    def answered(self, number: int) -> bool:
        """Whether the scorer can read what was withheld of a case."""
        return self._has("answers", number)

    def _has(self, what: Literal["records", "results", "answers"], number: int) -> bool:
        """Whether a file of a case exists."""
        ending = "npz" if what == "records" else "json"
        return (self.folder / what / f"{number}.{ending}").exists()

    def diagnose(
        self,
        half: Half = "both",
        *,
        workers: int = 2,
        executor: Executor | None = None,
        oracle: bool = True,
        progress: Progress | None = None,
    ) -> None:
        """Diagnose all cases without a result of this engine.

        ``executor``: see :meth:`make_records`.
        """
        results = self.folder / "results"
        engine = self.machine.engine_hash
        todo = [n for n in self.numbers(half) if _engine_of(results / f"{n}.json") != engine]
        batches = [(_diagnose, (self.machine, self.folder, n, oracle)) for n in todo]
        for done, _ in enumerate(_run(batches, workers, executor), start=1):
            if progress is not None:
                progress("diagnoses", done, len(todo))


def _engine_of(path: Path) -> str:
    """Hash of the engine of a result; empty if the result is missing or unreadable."""
    try:
        return str(read_json(path)["engine"])
    except (ValueError, LookupError, TypeError):
        return ""


def _end_with_parent() -> None:
    """End a worker when its parent process was killed."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _run(
    batches: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]],
    workers: int,
    executor: Executor | None = None,
) -> Iterator[Any]:
    """Yield results of batches as they are finished.

    They run on an executor of the caller, or in worker processes with one thread each.
    """
    if executor is not None:
        yield from _finished(batches, executor)
        return
    if workers <= 1 or len(batches) <= 1:
        for function, arguments in batches:
            yield function(*arguments)
        return
    limits = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before = {k: os.environ.get(k) for k in limits}
    os.environ.update(dict.fromkeys(limits, "1"))
    try:
        with ProcessPoolExecutor(
            workers, mp_context=get_context("spawn"), initializer=_end_with_parent
        ) as pool:
            yield from _finished(batches, pool)
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value


def _finished(
    batches: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]], executor: Executor
) -> Iterator[Any]:
    """Yield results from an executor as they are finished; the rest is canceled on an error."""
    pending = [executor.submit(function, *arguments) for function, arguments in batches]
    try:
        for future in as_completed(pending):
            yield future.result()
    finally:
        for future in pending:
            future.cancel()


def _make(
    make: Callable[[Path, Path | None, Sequence[int]], None],
    folder: Path,
    outside: Path | None,
    numbers: Sequence[int],
) -> Sequence[int]:
    make(folder, outside, numbers)
    return numbers


def _diagnose(machine: Machine, folder: Path, number: int, oracle: bool) -> int:
    found = machine.result(folder, number, oracle=oracle)
    write_text(make_folder(folder / "results") / f"{number}.json", as_json(found), force=True)
    return number
