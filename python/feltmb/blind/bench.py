"""The blind bench: seal truths, make records, diagnose them, keep every result in its own file.

Folder of a bench::

    seal.json       seed, number of cases, SHA-256 of truths.json and of the kinds from outside
    truths.json     what was withheld, written and hashed before anything is diagnosed
    records/N.npz   what the engine is shown
    answers/N.json  what only the scorer reads
    results/N.json  what the engine said

All files are written whole or not at all, so that a bench that was cut off goes on where it was.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, Literal

import numpy as np

from feltmb.blind import truth, truth_machine, truth_sensors
from feltmb.errors import DataError, FileExists, InvalidParameter
from feltmb.files import (
    LARGEST_JSON,
    NPZ_FAULTS,
    make_folder,
    read_input,
    read_json,
    read_npz,
    write_file,
    write_text,
)

__all__ = ["Bench", "Half", "read_records"]

Half = Literal["development", "test", "both"]
Model = Literal["key_hammer", "steinway45"]
CHUNK = 20
MOST_CASES = 100_000
LARGEST_OUTSIDE = 30.0  # times the size that a kind says is worth trying first
Progress = Callable[[str, int, int], None]


def _json(value: Any) -> str:
    return json.dumps(value, indent=1, sort_keys=True, allow_nan=True) + "\n"


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def load_kinds(outside: Path | None) -> dict[str, Any]:
    """Kinds from outside the library: the packaged ones and those of a Python file.

    Raises
    ------
    InvalidParameter
        The file cannot be loaded, or a kind in it lacks what it needs; all faults at once.
    """
    from feltmb.blind import truth_outside

    kinds = truth.load_outside(truth_outside)
    if outside is None:
        return kinds
    if not outside.is_file():
        raise InvalidParameter(
            f"{outside}: there is no such file; expected Python that defines KINDS"
        )
    spec = importlib.util.spec_from_file_location("feltmb_outside", outside)
    if spec is None or spec.loader is None:
        raise InvalidParameter(f"{outside}: is no Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InvalidParameter(f"{outside}: {type(error).__name__}: {error}") from None
    faults = []
    found = getattr(module, "KINDS", None)
    if not isinstance(found, (tuple, list)) or not found:
        raise InvalidParameter(f"{outside}: expected KINDS, a tuple of kinds, see `--help`")
    onsets = ("start", "key", "bed", "string", "letoff", "check")
    for i, kind in enumerate(found):
        name = getattr(kind, "name", None)
        where = f"KINDS[{i}] ({name})"
        for attribute in ("name", "component", "onset"):
            if not isinstance(getattr(kind, attribute, None), str):
                faults.append(f"{where}: {attribute} is missing, expected a text")
        if getattr(kind, "onset", None) not in onsets:
            faults.append(f"{where}: onset, expected one of {', '.join(onsets)}")
        size = getattr(kind, "size", None)
        if not (isinstance(size, (int, float)) and math.isfinite(size) and size > 0.0):
            faults.append(f"{where}: size = {size!r}, expected a number > 0")
        if not (hasattr(kind, "force") or hasattr(kind, "observe")):
            faults.append(f"{where}: has neither force nor observe")
        if name in kinds or name in truth.EFFECTS:
            faults.append(f"{where}: the name is taken")
    if faults:
        raise InvalidParameter("\n".join(f"{outside}: {f}" for f in faults))
    return {**kinds, **{kind.name: kind for kind in found}}


@dataclass(frozen=True)
class Bench:
    """A bench in a folder.

    Parameters
    ----------
    folder
        Where it is kept.
    outside
        Python file with further kinds from outside the library.
    model
        The small model ``key_hammer`` or the full action ``steinway45``. A bench that is sealed
        already keeps its own.
    """

    folder: Path
    outside: Path | None = None
    model: Model = "key_hammer"

    # ------------------------------------------------------------ sealing

    def seal(self, cases: int, seed: int, *, resume: bool = False) -> dict[str, Any]:
        """Draw the truths and write their hash, before anything is diagnosed."""
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
            wanted["model"] = self.model
            other = [f"{k} = {seal[k]}, got {v}" for k, v in wanted.items() if seal[k] != v]
            if other:
                raise InvalidParameter(f"{path}: the bench was sealed with {'; '.join(other)}")
            return seal
        from feltmb import __version__

        drawn, sources = self._draw(cases, seed)
        text = _json(drawn)
        make_folder(self.folder)
        write_text(self.folder / "truths.json", text, force=True)
        seal = {
            "version": __version__,
            "model": self.model,
            "cases": cases,
            "seed": seed,
            "sealed": datetime.now(UTC).isoformat(timespec="seconds"),
            "truths_sha256": _sha256(text.encode()),
            "generator_sha256": _sources(*sources),
            "outside": self._outside_hash(),
        }
        write_text(path, _json(seal))
        return seal

    def _draw(self, cases: int, seed: int) -> tuple[list[Any], tuple[str, ...]]:
        """Truths as plain data, and the files that they and their records come from."""
        if self.model != "key_hammer":
            from feltmb.blind import action_bench

            if self.outside is not None:
                raise InvalidParameter(
                    f"{self.outside}: kinds of one's own are for the model key_hammer; those of "
                    f"{self.model} are in blind/action_truth.py"
                )
            return action_bench.draw_all(seed, cases), action_bench.GENERATOR
        from feltmb.blind.calibration import calibrate, packaged_scales

        kinds = load_kinds(self.outside)
        scales = packaged_scales()
        new = {k: v for k, v in kinds.items() if f"{k}:outside" not in scales["force"]}
        if new:
            for mode, found in calibrate(new, only_outside=True).items():
                scales[mode] |= found
        largest = {name: LARGEST_OUTSIDE * kind.size for name, kind in kinds.items()}
        drawn = [asdict(truth.draw(seed, n, scales, largest)) for n in range(cases)]
        names = ("truth", "truth_machine", "truth_sensors", "truth_outside")
        return drawn, tuple(f"blind/{name}.py" for name in names)

    def sealed(self) -> dict[str, Any]:
        """Return the seal, after a check that the truths are those that were sealed."""
        path = self.folder / "seal.json"
        try:
            seal: dict[str, Any] = read_json(path)
            truths = read_input(self.folder / "truths.json", most=LARGEST_JSON)
        except DataError as error:
            raise InvalidParameter(f"{self.folder}: is no bench: {error}") from None
        kinds = {"cases": int, "seed": int, "truths_sha256": str, "outside": str, "version": str,
                 "sealed": str, "model": str}  # fmt: skip
        wrong = [
            k for k, t in kinds.items() if not isinstance(seal, dict) or type(seal.get(k)) is not t
        ]
        if wrong or not 1 <= seal["cases"] <= MOST_CASES:
            raise InvalidParameter(f"{path}: is damaged: {', '.join(wrong) or 'cases'}")
        if _sha256(truths) != seal["truths_sha256"]:
            raise InvalidParameter(f"{self.folder}: truths.json is not what was sealed")
        return seal

    def _outside_hash(self) -> str:
        return "" if self.outside is None else _sha256(self.outside.read_bytes())

    def numbers(self, half: Half) -> list[int]:
        """Numbers of the cases of a half: even ones for development, odd ones for the test."""
        every = range(int(self.sealed()["cases"]))
        return [n for n in every if half == "both" or (n % 2 == 0) == (half == "development")]

    # ------------------------------------------------------------ work

    def make_records(
        self, half: Half = "both", *, workers: int = 2, progress: Progress | None = None
    ) -> None:
        """Simulate the records of all cases that have none yet."""
        todo = [n for n in self.numbers(half) if not self._made(n)]
        size = CHUNK if self.model == "key_hammer" else 1
        chunks = [todo[i : i + size] for i in range(0, len(todo), size)]
        jobs: list[Any] = [(_make_records, (self.folder, self.outside, chunk)) for chunk in chunks]
        if self.model != "key_hammer":
            jobs = [(_make_action_records, (self.folder, chunk)) for chunk in chunks]
        done = 0
        for made in _run(jobs, workers):
            done += len(made)
            if progress is not None:
                progress("records", done, len(todo))

    def _made(self, number: int) -> bool:
        return (self.folder / "records" / f"{number}.npz").exists() and (
            self.folder / "answers" / f"{number}.json"
        ).exists()

    def diagnose(
        self,
        half: Half = "both",
        *,
        workers: int = 2,
        oracle: bool = True,
        progress: Progress | None = None,
    ) -> None:
        """Diagnose all cases that have no result of this engine yet."""
        engine = engine_hash(self.model)
        todo = []
        for n in self.numbers(half):
            if _engine_of(self.folder / "results" / f"{n}.json") != engine:
                todo.append(n)
        work = _diagnose if self.model == "key_hammer" else _diagnose_action
        jobs = [(work, (self.folder, n, oracle)) for n in todo]
        for done, _ in enumerate(_run(jobs, workers), start=1):
            if progress is not None:
                progress("diagnoses", done, len(todo))


def _engine_of(path: Path) -> str:
    """Hash of the engine that made a result; empty if there is none that can be read."""
    try:
        return str(read_json(path)["engine"])
    except (ValueError, LookupError, TypeError):
        return ""


def _sources(*names: str) -> str:
    """Hash of source files of the package."""
    root = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for name in names:
        path = root / name
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


@functools.cache
def engine_hash(model: Model = "key_hammer") -> str:
    """Hash of what a result depends on: the engine, the nominal, its library."""
    if model != "key_hammer":
        from feltmb.blind.action_bench import SOURCES

        return _sources("fit", "gap", "data", *SOURCES)
    return _sources("fit", "gap", "data", "lumped.py", "blind/nominal.py")


def _end_with_parent() -> None:
    """Let a worker end when the process that asked for its work was killed."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _run(jobs: Sequence[tuple[Callable[..., Any], tuple[Any, ...]]], workers: int) -> Iterator[Any]:
    """Results of jobs as they come, by worker processes with one thread each."""
    if workers <= 1 or len(jobs) <= 1:
        for function, arguments in jobs:
            yield function(*arguments)
        return
    limits = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before = {k: os.environ.get(k) for k in limits}
    os.environ.update(dict.fromkeys(limits, "1"))
    try:
        with ProcessPoolExecutor(
            workers, mp_context=get_context("spawn"), initializer=_end_with_parent
        ) as pool:
            pending = [pool.submit(function, *arguments) for function, arguments in jobs]
            try:
                for future in as_completed(pending):
                    yield future.result()
            finally:
                for future in pending:
                    future.cancel()
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value


def _read_truths(folder: Path) -> list[truth.Case]:
    cases = []
    for entry in read_json(folder / "truths.json"):
        parts = [truth.Part(**p) for p in entry.pop("parts")]
        cases.append(truth.Case(parts=parts, **entry))
    return cases


def _make_records(folder: Path, outside: Path | None, numbers: Sequence[int]) -> Sequence[int]:
    kinds = load_kinds(outside)
    truths = _read_truths(folder)
    cases = [truths[n] for n in numbers]
    # Every case without each of its effects, for the moment from which they show.
    lacking = [
        replace(case, parts=[q for q in case.parts if q is not part])
        for case in cases
        for part in case.parts
    ]
    both = [*cases, *lacking]
    result = truth_machine.integrate(both, [truth.STROKES] * len(both), kinds)
    ideal = [
        truth_sensors.record(c, truth.STROKES, result, i * len(truth.STROKES), kinds, ideal=True)
        for i, c in enumerate(both)
    ]
    without = iter(ideal[len(cases) :])
    for i, case in enumerate(cases):
        first = i * len(truth.STROKES)
        views = truth_sensors.record(case, truth.STROKES, result, first, kinds)
        arrays = {f"{s}.{channel}": v for s, view in views.items() for channel, v in view.items()}

        def save(path: Path, arrays: dict[str, Any] = arrays, mode: str = case.mode) -> None:
            with path.open("wb") as file:
                np.savez_compressed(file, mode=np.array(mode), **arrays)

        answer = _answer(case, result, first, kinds)
        for told in answer["parts"]:
            view = next(without)
            if told["component"] != "input":  # what is recorded of the input moves no camera
                moments = {k: truth_sensors.shows(ideal[i][k], view[k]) for k in truth.STROKES}
                told["shows"] = {k: t for k, t in moments.items() if math.isfinite(t)}
        write_text(
            make_folder(folder / "answers") / f"{case.number}.json", _json(answer), force=True
        )
        write_file(make_folder(folder / "records") / f"{case.number}.npz", save, force=True)
    return numbers


def _make_action_records(folder: Path, numbers: Sequence[int]) -> Sequence[int]:
    from feltmb.blind import action_bench

    truths = read_json(folder / "truths.json")
    for n in numbers:
        told = action_bench.make_records(truths[n], make_folder(folder / "records") / f"{n}.npz")
        write_text(make_folder(folder / "answers") / f"{n}.json", _json(told), force=True)
    return numbers


def _diagnose_action(folder: Path, number: int, oracle: bool) -> int:
    from feltmb.blind import action_bench

    found = action_bench.result(folder, number, with_oracle=oracle)
    found["engine"] = engine_hash("steinway45")
    write_text(make_folder(folder / "results") / f"{number}.json", _json(found), force=True)
    return number


def _answer(
    case: truth.Case, result: truth_machine.Strokes, first: int, kinds: Mapping[str, Any]
) -> dict[str, Any]:
    """What the scorer needs to know of a case."""
    parts = []
    for part in case.parts:
        if part.form == "outside":
            component, what = kinds[part.name].component, kinds[part.name].onset
        else:
            component, what = truth.EFFECTS[part.name]
        onsets = {
            stroke: truth_sensors.onset(case, result, first + k, what)
            for k, stroke in enumerate(truth.STROKES)
        }
        parts.append({**asdict(part), "component": component, "onset": onsets})
    return {"number": case.number, "mode": case.mode, "parts": parts}


# ---------------------------------------------------------------- what the engine is shown


def read_records(path: Path) -> list[Any]:
    """Records of a case with what a data sheet says of their sensors."""
    try:
        arrays = read_npz(path)
        mode = str(arrays.pop("mode"))
        return _records(arrays, mode)
    except NPZ_FAULTS as error:
        raise InvalidParameter(f"{path}: is damaged: {error}") from None


def _records(arrays: Mapping[str, Any], mode: str) -> list[Any]:
    from feltmb.data import Record, Sensor

    records = []
    for stroke in truth.STROKES:
        channels = {c: arrays[f"{stroke}.{c}"] for c in ("key", "hammer")}
        sensors = {
            c: Sensor(
                name=c,
                unit="m",
                sigma=truth_sensors.NOISE_CAMERA,
                quantum=truth_sensors.PIXEL,
                # The mean of three frames is worth one independent look per three frames.
                correlation_time=1.5 * truth.FRAME,
            )
            for c in channels
        }
        records.append(
            Record(
                name=stroke,
                time=np.arange(channels["key"].size) * truth.FRAME,
                inputs={"finger": arrays[f"{stroke}.finger"]},
                outputs=channels,
                sensors=sensors,
                input_mode="force" if mode == "force" else "motion",
                input_sigma={"finger": truth_sensors.NOISE_INPUT[mode]},
                role="fit" if stroke in truth.FIT else "held_out",
            )
        )
    return records


def _diagnose(folder: Path, number: int, oracle: bool) -> int:
    from feltmb import gap
    from feltmb.blind.nominal import KeyHammer, effects

    records = read_records(folder / "records" / f"{number}.npz")
    library = effects()
    clock = time.process_time()
    result: dict[str, Any] = {"number": number, "engine": engine_hash()}
    try:
        report = gap.diagnose(KeyHammer(), library, records)
    except Exception as error:  # a crash is a result too, and a bad one
        result |= {"error": f"{type(error).__name__}: {error}"}
    else:
        result |= summarize(report)
    result["cpu_seconds"] = time.process_time() - clock
    if oracle and "error" not in result:
        result["oracle"] = _oracle(folder, number, records, library)
    write_text(make_folder(folder / "results") / f"{number}.json", _json(result), force=True)
    return number


def summarize(report: Any) -> dict[str, Any]:
    """What the scorer needs of a report, as plain data."""
    return {
        "verdict": str(report.verdict),
        "statement": report.statement,
        "named": list(report.named),
        "one_of": list(report.one_of),
        "confidence": float(report.confidence),
        "none": float(report.which.none),
        "other": float(report.which.other),
        "effects": [
            {
                "effect": r.effect,
                "component": r.component,
                "kind": r.kind,
                "size": float(r.size),
                "low": float(r.low),
                "high": float(r.high),
                "refitted": bool(r.refitted),
                "statistic": float(r.statistic),
                "posterior": float(r.posterior),
                "confusable": list(r.confusable),
            }
            for r in report.which.effects
        ],
        "sets": [
            {"effects": list(s.effects), "posterior": float(s.posterior)}
            for s in report.which.sets[:10]
        ],
        "components": [
            {"component": c.component, "p": float(c.p), "significant": bool(c.significant)}
            for c in report.where.components
        ],
        "onset": {k: float(v) for k, v in report.where.onset.items()},
        "closed": float(report.how_far.closed),
        "per_record": {k: [float(a) for a in v] for k, v in report.how_far.per_record.items()},
    }


def _oracle(folder: Path, number: int, records: Any, library: Any) -> dict[str, Any] | None:
    """Diagnosis with a library of nothing but the true effects: the structure is known.

    Reads the truth, so it runs when the blind result is complete. None where there is no effect or
    one from outside the library.
    """
    from feltmb import gap
    from feltmb.blind.nominal import KeyHammer

    answer = read_json(folder / "answers" / f"{number}.json")
    names = {p["name"] for p in answer["parts"]}
    if not names or any(p["form"] == "outside" for p in answer["parts"]):
        return None
    try:
        report = gap.diagnose(KeyHammer(), [e for e in library if e.name in names], records)
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}", "closed": math.nan, "named": []}
    return {"closed": float(report.how_far.closed), "named": list(report.named)}
