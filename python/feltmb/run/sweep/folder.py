"""The folder of finished members: one small file each, whole or not there."""

from __future__ import annotations

import hashlib
import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.errors import printable
from feltmb.files import is_file, open_input, read_json, read_npz, write_file, write_text
from feltmb.files.hdf5 import LARGEST_FILE
from feltmb.run.sweep.member import Member, Outcome

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]


def _file(folder: Path, key: str) -> Path:
    return folder / f"{key[:40]}.json"


def store(folder: Path, member: Member, outcome: Outcome) -> None:
    """Write what became of a member; it is finished once its file is there."""
    import numpy as np

    path = _file(folder, member.key)
    if outcome.series:
        series = outcome.series

        def write(target: Path) -> None:
            with target.open("wb") as out:
                np.savez_compressed(out, **series)  # type: ignore[arg-type]

        write_file(path.with_suffix(".npz"), write, force=True)
    found = {
        "feltmb": "member",
        "key": member.key,
        "name": member.name,
        "action": member.action.name,
        "values": dict(member.values),
        "stroke": member.stroke.name,
        "status": outcome.status,
        "error": outcome.error,
        "numbers": outcome.numbers,
        "series": sorted(outcome.series),
        "reached": outcome.reached,
        "wall": outcome.wall,
        "files": _digests(path, member, bool(outcome.series), outcome.status),
    }
    found = json.loads(json.dumps(found, default=str))  # as it will be read
    found["sha256"] = _digest(found)
    write_text(path, json.dumps(found, indent=1) + "\n", force=True)


def _digest(found: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _digests(path: Path, member: Member, series: bool, status: str) -> dict[str, str]:
    """Checksums of the files beside that of a member, by what they hold."""
    files = {"series": path.with_suffix(".npz")} if series else {}
    if member.save_run and status == "done":
        files["run"] = Path(member.save_run)
    found = {}
    for what, file in files.items():
        with open_input(file, most=LARGEST_FILE) as stream:
            found[what] = hashlib.file_digest(stream, "sha256").hexdigest()
    return found


def recall(folder: Path, member: Member) -> Outcome | None:
    """Outcome in the folder; None if it is absent, or not as it was written: it is computed anew.

    The checksums find what was damaged or edited by chance or by hand. They are no seal: who wants
    to forge a result can write new ones.
    """
    path = _file(folder, member.key)
    if not is_file(path):
        return None
    try:
        found = read_json(path)
        checksum = found.pop("sha256")
        if found["key"] != member.key or checksum != _digest(found):
            raise ValueError("its checksum differs")
        if member.save_run and found["status"] == "done" and not is_file(Path(member.save_run)):
            return None
        if found["files"] != _digests(path, member, bool(found["series"]), found["status"]):
            raise ValueError("the checksum of its series or its run differs")
        series: dict[str, Array] = {}
        if found["series"]:
            arrays = read_npz(path.with_suffix(".npz"))
            series = {name: arrays[name] for name in found["series"]}
        return Outcome(
            str(found["status"]),
            str(found["error"]),
            {str(k): float(v) for k, v in found["numbers"].items()},
            series,
            float(found["reached"]),
            float(found["wall"]),
            resumed=True,
        )
    except (ValueError, KeyError, TypeError, AttributeError) as fault:
        warnings.warn(
            f"{path.name}: {member.name or 'a member'} is computed anew: the file is damaged or "
            f"was edited ({printable(str(fault))[:200]})",
            RuntimeWarning,
            stacklevel=2,
        )
        return None
