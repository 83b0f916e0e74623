"""Storage of finished members in a folder."""

from __future__ import annotations

from pathlib import Path

from feltmb.files import Store
from feltmb.run.sweep.member import Member, Outcome


def _files(member: Member, status: str) -> dict[str, Path]:
    """File of the saved run of a member."""
    return {"run": Path(member.save_run)} if member.save_run and status == "done" else {}


def store(folder: Path, member: Member, outcome: Outcome) -> None:
    """Write the outcome of a member; it counts as finished when its file exists."""
    found = {
        "feltmb": "member",
        "name": member.name,
        "action": member.action.name,
        "values": dict(member.values),
        "stroke": member.stroke.name,
        "status": outcome.status,
        "error": outcome.error,
        "numbers": outcome.numbers,
        "reached": outcome.reached,
        "wall": outcome.wall,
        "warnings": list(outcome.warnings),
    }
    Store(folder).put(member.key, found, outcome.series, _files(member, outcome.status))


def recall(folder: Path, member: Member) -> Outcome | None:
    """Outcome of a member from the folder; None if it is absent or was changed."""
    kept = Store(folder).get(member.key, {"run": Path(member.save_run)})
    if kept is None:
        return None
    found = kept.data
    numbers = {str(name): float(value) for name, value in found["numbers"].items()}
    return Outcome(
        str(found["status"]), str(found["error"]), numbers, kept.arrays, float(found["reached"]),
        float(found["wall"]), tuple(map(str, found["warnings"])), resumed=True,
    )  # fmt: skip
