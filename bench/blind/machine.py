"""Interface and common parts of the machines of the bench."""

from __future__ import annotations

import functools
import hashlib
import json
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from feltmb.data import Record
from feltmb.files import make_folder, package_digest, read_input, read_json, write_text
from feltmb.gap import Options

__all__ = ["Machine", "as_json", "digest_of", "sha256", "summarize"]

HERE = Path(__file__).resolve().parent
LARGEST_SOURCE = 10_000_000  # bytes


class Machine(ABC):
    """A machine with a sealed truth.

    A subclass draws truths, makes their records and diagnoses one case. The data of a bench are in
    its folder.
    """

    name: str
    """Name for ``--machine`` and the seal."""
    chunk: int = 1
    """Number of cases that are simulated together."""
    generator: tuple[str, ...] = ()
    """Files of this package on which truths and records depend."""
    engine: tuple[str, ...] = ()
    """Files of this package on which a result depends; it depends on the whole of feltmb too."""
    options = Options()
    """Options of the diagnoses."""

    @abstractmethod
    def draw(self, seed: int, cases: int, outside: Path | None) -> list[Any]:
        """Draw truths, as plain data.

        Raises
        ------
        InvalidParameter
            ``outside`` cannot be loaded, or the machine takes no causes from outside.
        """

    @abstractmethod
    def make_records(self, folder: Path, outside: Path | None, numbers: Sequence[int], /) -> None:
        """Write records of some cases, which the engine is shown, into the folder of a bench."""

    @abstractmethod
    def make_answers(self, folder: Path, outside: Path | None, numbers: Sequence[int], /) -> None:
        """Write what only the scorer reads of some cases into the folder of a bench."""

    @abstractmethod
    def read_records(self, path: Path) -> list[Record]:
        """Records of a case with the properties of their sensors from a data sheet."""

    @abstractmethod
    def diagnose(
        self,
        records: Sequence[Record],
        names: Sequence[str] = (),
        options: Options | None = None,
    ) -> Any:
        """Report of one case.

        ``names``: effects of the library that are tested, default all. ``options``: default
        :attr:`options`.
        """

    @functools.cached_property
    def engine_hash(self) -> str:
        """Hash of everything that determines a result: the installed feltmb, and the machine."""
        return sha256(f"{package_digest()} {digest_of(*self.engine)}".encode())

    def result(self, folder: Path, number: int, *, oracle: bool) -> dict[str, Any]:
        """Result of the diagnosis of a case, as plain data.

        ``oracle`` adds a diagnosis whose library only has the true effects.
        """
        records = self.read_records(folder / "records" / f"{number}.npz")
        clock = time.process_time()
        found: dict[str, Any] = {"number": number, "engine": self.engine_hash}
        with tempfile.TemporaryDirectory() as store:  # the oracle reads the fits of the model
            options = replace(self.options, resume=Path(store) if oracle else None)
            try:
                report = self.diagnose(records, options=options)
            except Exception as error:  # a crash counts as a bad result
                found["error"] = f"{type(error).__name__}: {error}"
            else:
                found |= summarize(report)
            found["cpu_seconds"] = time.process_time() - clock
            if oracle and "error" not in found:
                found["oracle"] = self._oracle(folder, number, records, options)
        return found

    def _oracle(
        self, folder: Path, number: int, records: Sequence[Record], options: Options
    ) -> dict[str, Any] | None:
        """Diagnosis with the true structure; None without an effect or with one from outside.

        It reads the truth and therefore runs after the blind result is complete.
        """
        parts = read_json(folder / "truths.json")[number]["parts"]
        names = sorted({p["name"] for p in parts})
        if not names or any(p["form"] == "outside" for p in parts):
            return None
        try:
            report = self.diagnose(records, names, options)
        except Exception as error:
            return {"error": f"{type(error).__name__}: {error}", "closed": None, "named": []}
        return {"closed": float(report.how_far.closed), "named": list(report.named)}

    def write_answer(self, folder: Path, number: int, answer: Mapping[str, Any]) -> None:
        """Write the data that only the scorer reads."""
        path = make_folder(folder / "answers") / f"{number}.json"
        write_text(path, as_json(answer), force=True)


def as_json(value: Any) -> str:
    """Plain data as text; equal data give equal text."""
    return json.dumps(value, indent=1, sort_keys=True, allow_nan=True) + "\n"


def sha256(data: bytes) -> str:
    """Hash of bytes."""
    return hashlib.sha256(data).hexdigest()


def digest_of(*names: str) -> str:
    """Hash of files of this package.

    Raises
    ------
    DataError
        There is no such file.
    """
    digest = hashlib.sha256()
    for name in names:
        data = read_input(HERE / name, most=LARGEST_SOURCE)
        digest.update(f"{name} {len(data)} ".encode() + data)
    return digest.hexdigest()


def summarize(report: Any) -> dict[str, Any]:
    """Data of a report for the scorer, as plain data."""
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
                "size": float(r.magnitude),
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
