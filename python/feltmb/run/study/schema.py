"""Schema of a study file."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field

from feltmb.units.quantity import Schema

#: Values that any run may have: name -> (text, unit for people).
KNOWN: dict[str, tuple[str, str]] = {
    "impact_speed": ("impact speed (of the contact)", "m/s"),
    "rebound_speed": ("rebound speed (of the contact)", "m/s"),
    "max_impact_force": ("largest force of the impact", "N"),
    "impact_duration": ("contact of the impact lasts", "ms"),
    "let_off_gap": ("distance at let-off", "mm"),
    "check_gap": ("distance in check", "mm"),
    "check_gap_swing": ("swing in check, last 10 ms", "mm"),
    "key_travel": ("key travel", "mm"),
    "steps": ("integration steps", "1"),
    "rhs": ("right-hand sides", "1"),
}

WORD = re.compile(r"^[A-Za-z_][A-Za-z0-9_]*$")

Stat = Literal[
    "first",
    "last",
    "min",
    "max",
    "mean",
    "span",
    "rms",
    "variation",
    "time_of_max",
    "time_of_min",
    "rises_above",
    "falls_below",
    "time_above",
    "pulses",
    "settles",
    "returns",
    "swing_back",
    "frequency",
]
#: Statistics that need ``level``.
NEED_LEVEL = ("rises_above", "falls_below", "time_above", "pulses", "settles", "returns")

When = float | str


class ThesisSpec(Schema):
    """Source of a study and its result, in one sentence."""

    cite: str = "thesis"
    figure: str = ""
    found: str = ""


class MadeStroke(Schema):
    """A stroke made from another one: scaled, delayed, or recorded at the key."""

    base: str
    record: Literal["force", "key_motion"] | None = None
    scale: float = 1.0
    delay: float = 0.0
    duration: Annotated[float, Field(gt=0)] | None = None


class BaseSpec(Schema):
    """Common base of all variants."""

    action: str = "steinway45"
    strokes: list[str] = Field(min_length=1)
    values: dict[str, Any] = Field(default_factory=dict)
    options: dict[str, Any] = Field(default_factory=dict)


class VariantSpec(Schema):
    """Table ``[variants.NAME]``."""

    label: str = ""
    note: str = ""
    action: str | None = None
    values: dict[str, Any] = Field(default_factory=dict)
    strokes: list[str] | None = None
    options: dict[str, Any] = Field(default_factory=dict)
    only: dict[str, list[Any]] = Field(default_factory=dict)


class AxisSpec(Schema):
    """Table ``[[sweep.axis]]``."""

    name: str
    label: str = ""
    unit: str = "1"
    path: str | list[str]
    inverse: list[str] = Field(default_factory=list)
    how: Literal["set", "scale", "offset"] = "set"
    values: Any
    log: bool = False


class SweepSpec(Schema):
    """Table ``[sweep]``."""

    mode: Literal["grid", "list"] = "grid"
    axis: list[AxisSpec] = Field(min_length=1)


class NumberSpec(Schema):
    """Table ``[numbers.NAME]``: a formula, or a statistic of an output in a time window."""

    label: str = ""
    unit: str = ""
    value: str | None = None
    output: str | None = None
    stat: Stat | None = None
    start: Annotated[When | None, Field(alias="from")] = None
    end: Annotated[When | None, Field(alias="to")] = None
    level: float | None = None
    thesis: dict[str, float] = Field(default_factory=dict)
    digits: Annotated[int, Field(ge=1, le=15)] = 4
    strokes: list[str] | None = None


class MarkSpec(Schema):
    """A line across a panel."""

    value: float
    label: str = ""


class PanelSpec(Schema):
    """One set of axes of a figure."""

    output: str | None = None
    number: str | None = None
    stroke: str | None = None
    strokes: list[str] | None = None
    variants: list[str] | None = None
    unit: str = ""
    label: str = ""
    title: str = ""
    start: Annotated[When | None, Field(alias="from")] = None
    end: Annotated[When | None, Field(alias="to")] = None
    from_rest: bool = False
    log: bool = False
    marks: list[MarkSpec] = Field(default_factory=list)
    only: dict[str, list[Any]] = Field(default_factory=dict)


class FigureSpec(Schema):
    """Table ``[figures.NAME]``."""

    title: str
    kind: Literal["time", "sweep", "bars"] = "time"
    figure: str = ""
    caption: str = ""
    columns: Annotated[int, Field(ge=1, le=4)] = 1
    x: str | None = None
    panels: list[PanelSpec] = Field(min_length=1)


class FindingSpec(Schema):
    """Table ``[[findings]]``: a statement, and the value that decides it.

    ``claim`` states the origin: the source that ``[thesis]`` cites, or the study itself. ``over``
    names an axis of the sweep: the finding is evaluated at each of its values, which replace the
    name of the axis in ``check`` and ``size``.
    """

    says: str
    source: str = ""
    claim: Literal["thesis", "own"] = "own"
    over: str | None = None
    check: str | None = None
    size: str | None = None
    unit: str = "1"
    thesis: float | None = None
    within: Annotated[float, Field(gt=0)] | None = None
    note: str = ""


class StudyFile(Schema):
    """A study file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    title: str
    about: str = ""
    thesis: ThesisSpec = ThesisSpec()
    base: BaseSpec
    strokes: dict[str, MadeStroke] = Field(default_factory=dict)
    variants: dict[str, VariantSpec] = Field(default_factory=dict)
    sweep: SweepSpec | None = None
    numbers: dict[str, NumberSpec] = Field(default_factory=dict)
    figures: dict[str, FigureSpec] = Field(default_factory=dict)
    findings: list[FindingSpec] = Field(default_factory=list)
