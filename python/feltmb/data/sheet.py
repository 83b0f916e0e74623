"""The TOML beside a measured file: which column is what, in which unit, how noisy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import Field

from feltmb.arguments import checked
from feltmb.data.records import Reference
from feltmb.units.quantity import Schema

__all__ = ["ColumnSpec", "InputSpec", "OutputSpec", "ReadOptions", "Sheet"]


class ColumnSpec(Schema):
    """A column of the file: where it is and in what unit."""

    column: str = ""
    """Name in the file, or its whole heading; default: that of the signal."""
    unit: str = ""
    """Unit in the file, also px; default: that of the header, else SI."""
    scale: float | str = ""
    """What one unit of the file is, such as "0.21 mm" for a pixel; instead of the unit."""
    origin: float | Literal["start"] = 0.0
    """Zero of the channel [unit of the file]; "start": where it stands still at the beginning."""
    down: bool | None = None
    """Whether it counts downwards; default: pixels of a channel whose name ends in .y do."""
    factor: float = 1.0
    """Multiplies the values after the unit."""
    shift: float = 0.0
    """Added after the factor [unit of the model]."""
    si: str = ""
    """Unit of the model; default: the SI unit of the same quantity, or the unit itself."""


class InputSpec(ColumnSpec):
    """An input."""

    sigma: Annotated[float, Field(ge=0.0)] = 0.0
    correlation_time: Annotated[float, Field(ge=0.0)] = 0.0
    delay: float = 0.0
    """Of its sensor [s]; positive: the reading lags."""
    bandwidth: Annotated[float, Field(gt=0.0)] | None = None
    """Corner of the low-pass of its sensor [Hz]."""
    gain: float = 1.0
    offset: float = 0.0


class OutputSpec(ColumnSpec):
    """An output and its sensor."""

    sigma: float | None = None
    quantum: float = 0.0
    delay: float = 0.0
    bandwidth: float | None = None
    gain: float = 1.0
    offset: float = 0.0
    correlation_time: float = 0.0
    colored_sigma: float = 0.0
    gain_sd: float = 0.0
    offset_sd: float = 0.0
    delay_sd: float = 0.0
    reference: Reference = ""
    """Zero of a coordinate: "absolute" (frame of the model), "rest" (its rest pose); default: told
    by where the channel starts."""
    point: str = ""
    axis: str = ""


class Sheet(Schema):
    """The TOML beside a measured file."""

    name: str = ""
    role: Literal["fit", "held_out"] = "fit"
    input_mode: Literal["force", "motion"] = "force"
    repeats: str = ""
    source: str = ""
    time: str = ""
    """Column of the clock; default: time or t, else the first."""
    time_unit: str = ""
    """Unit of the clock; default: that of the header, else s."""
    interval: float | None = None
    """Step of the clock [s] if the file has none."""
    frame_rate: Annotated[float, Field(gt=0.0)] | None = None
    """True frames a second of a camera [Hz], whatever rate the video plays at."""
    run: str = ""
    """Column that numbers the runs of the file; default: a run begins where the clock does."""
    likelihood: Annotated[float, Field(ge=0.0, le=1.0)] = 0.6
    """Points of a tracker that are less likely are missing [1]."""
    first: int = 0
    """First sample that is used."""
    last: int | None = None
    """Sample before which to stop; negative counts from the end."""
    every: Annotated[int, Field(ge=1)] = 1
    """Use every so-manyth sample."""
    inputs: dict[str, InputSpec] = Field(default_factory=dict)
    outputs: dict[str, OutputSpec] = Field(default_factory=dict)
    start: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """State -> (mean, standard deviation) at the first sample [SI]."""
    conditions: dict[str, float | str] = Field(default_factory=dict)


@checked
@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """How to read measured files, instead of what their TOML or header says.

    The mappings go from a channel (or ``time``) to a value; the key ``""`` stands for all outputs:
    those whose unit is not known (``units``), those in pixels (``scales``, ``origins``).
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    """Column of the file."""
    units: Mapping[str, str] = field(default_factory=dict)
    scales: Mapping[str, str] = field(default_factory=dict)
    """What one unit of the file is, such as "0.21 mm"."""
    origins: Mapping[str, str] = field(default_factory=dict)
    """Zero in the unit of the file, or "start"; of all outputs "X,Y" as well."""
    delays: Mapping[str, float] = field(default_factory=dict)
    """By how much a channel is late [s]."""
    references: Mapping[str, str] = field(default_factory=dict)
    """"absolute" or "rest"."""
    frame_rate: float | None = None
    """[Hz]"""
    run: str = ""
    """Column that numbers the runs."""
    likelihood: float | None = None
    """[1]"""
    down: bool | None = None
    """Whether pixels count downwards in y; default: they do."""

    def top(self) -> dict[str, Any]:
        """Keys of the sheet that are replaced."""
        found: dict[str, Any] = {}
        if self.frame_rate is not None:
            found["frame_rate"] = self.frame_rate
        if self.likelihood is not None:
            found["likelihood"] = self.likelihood
        if self.run:
            found["run"] = self.run
        if "time" in self.columns:
            found["time"] = self.columns["time"]
        if "time" in self.units:
            found["time_unit"] = self.units["time"]
        return found
