"""Published values of a mechanism, for comparison with the summary of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from feltmb import params
from unmodeled.arguments import checked
from unmodeled.files import read_toml

if TYPE_CHECKING:
    from feltmb.run.results import Run


@dataclass(frozen=True)
class Comparison:
    """A value of a run and the published value."""

    stroke: str
    key: str  #: key in ``run.summary``
    simulated: float | None  #: value of the run, SI; None if the run does not have it
    published: float  #: published value, SI
    unit: str
    source: str

    @property
    def difference(self) -> float | None:
        """(simulated - published) / published."""
        return None if self.simulated is None else self.simulated / self.published - 1.0


@checked
def compare_with_published(run: Run) -> list[Comparison]:
    """Published values for the mechanism and stroke of a run; empty if there are none."""
    action = run.provenance.get("action")
    if action not in params.names("published"):  # the name in a saved run may be any text
        return []
    path = params.folder("published") / f"{action}.toml"
    name = run.provenance["stroke"]["name"]
    return [
        Comparison(
            name, row["key"], run.summary.get(row["key"]), row["value"], row["unit"], row["source"]
        )
        for row in read_toml(path)["values"]
        if row["stroke"] == name
    ]
