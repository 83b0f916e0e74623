"""The folder of finished members: one small file each, whole or not there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from feltmb.files import write_file, write_text
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
    write_text(
        path,
        json.dumps(
            {
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
            },
            indent=1,
            default=str,
        )
        + "\n",
        force=True,
    )


def recall(folder: Path, member: Member) -> Outcome | None:
    """Outcome in the folder; None if it is absent or damaged."""
    import zipfile

    import numpy as np

    path = _file(folder, member.key)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["key"] != member.key:
            return None
        if member.save_run and found["status"] == "done" and not Path(member.save_run).is_file():
            return None
        series: dict[str, Array] = {}
        if found["series"]:
            with np.load(path.with_suffix(".npz"), allow_pickle=False) as data:
                series = {name: data[name] for name in found["series"]}
        return Outcome(
            str(found["status"]),
            str(found["error"]),
            {str(k): float(v) for k, v in found["numbers"].items()},
            series,
            float(found["reached"]),
            float(found["wall"]),
            resumed=True,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile):
        return None
