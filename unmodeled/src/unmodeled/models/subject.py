"""What a cause is about, stated where the cause is made: nothing reads the text of a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

SubjectKind = Literal[
    "own", "coordinate", "between", "state", "input", "sensor", "clock", "parameter"
]


@dataclass(frozen=True)
class Scope:
    """Where a law acts; by default in all records with one size."""

    each: bool = False
    """Whether every record has a size of its own."""
    channels: tuple[str, ...] = ()
    """Names of the inputs or sensors that have it together; (): one."""
    records: tuple[str, ...] = ()
    """Names of the records in which it acts, in their order; (): all."""
    shares: tuple[float, ...] = ()
    """Share of its size in each of them, which grows from the first to the last; (): all of it."""

    @property
    def where(self) -> str:
        """The records as the end of a name, with a space before it; "": all."""
        if self.shares:
            return " over the records"
        if not self.records:
            return ""
        between = " and " if len(self.records) == 2 else " to "
        return f" in {between.join(dict.fromkeys((self.records[0], self.records[-1])))}"

    def repeat(self, names: Sequence[str]) -> str:
        """Record that tells whether it is of its records or of their inputs; "": there is none.

        ``names``: those of all records.
        """
        others = [n for n in names if n not in self.records]
        if not self.records or not others:
            return ""
        return (
            f"repeat {self.records[-1]} with the input of {others[0]}: what is still there is of "
            "the machine at that time, what is not comes from the input"
        )


#: All records, one size.
EVERYWHERE = Scope()


@dataclass(frozen=True)
class Subject:
    """What a cause is about. The report makes its sentences from it."""

    kind: SubjectKind = "own"
    """What it acts on; "between": two bodies; "own": an effect of the user, told by its label."""
    fault: str = ""
    """Law of :mod:`unmodeled.library`, or fault of :mod:`unmodeled.chain`."""
    channel: str = ""
    """Name of the input, the output or the state."""
    component: str = ""
    """Part of the machine."""
    label: str = ""
    """What is added, or with "the" what changes; "": only the name tells it."""
    scope: Scope = EVERYWHERE

    @property
    def of_signal(self) -> bool:
        """Whether it is a fault of an input or a sensor."""
        return self.kind in ("input", "sensor")


#: Subject of what states none.
NOTHING = Subject()


def subject_of(name: str, component: str, label: str) -> Subject:
    """Subject of an effect of the user: what is added is its label, or its name before the part.

    Parameters
    ----------
    name, component, label
        Fields of the effect.
    """
    before, last = name[: -len(component) - 1], name[-len(component) - 1 :]
    if not label and component and last == f" {component}" and before[:4].lower() != "the ":
        label = before.removesuffix(" of")
    return Subject(component=component, label=label)
