"""TOML file that describes a measured file: signals of the columns, units, and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import Field

from unmodeled.arguments import checked
from unmodeled.data.records import Reference
from unmodeled.units.quantity import Schema


class ColumnSpec(Schema):
    """A column of the file and its unit."""

    column: str = ""
    """Name in the file, or its complete heading; default: the name of the signal."""
    unit: str = ""
    """Unit in the file, also px; default: the unit of the header, else that of the model."""
    scale: float | str = ""
    """Size of one unit of the file, such as "0.21 mm" for a pixel, or the distance of two points of
    the picture, such as "210 mm from 120 340 to 412 338"; replaces the unit."""
    origin: float | Literal["start"] = 0.0
    """Zero of the channel [unit of the file]; "start": the position at rest at the beginning."""
    down: bool | None = None
    """Whether the values increase downwards; default: true for channels in pixels whose name ends
    in .y."""
    period: float | str = ""
    """Period of a counter or an angle that wraps, such as 65536 [unit of the file] or "360 deg": a
    jump by more than a half of it is one."""
    factor: float = 1.0
    """Factor of the values after the conversion of the unit."""
    shift: float = 0.0
    """Value that is added after the factor [unit of the model]."""
    si: str = ""
    """Unit of the record, in which sigma and offset are stated; default: the unit that the model
    states, else the SI unit of the same quantity, or the unit itself."""


class InputSpec(ColumnSpec):
    """An input."""

    sigma: Annotated[float, Field(ge=0.0)] = 0.0
    correlation_time: Annotated[float, Field(ge=0.0)] = 0.0
    delay: float = 0.0
    """Delay of the sensor of the input [s]; positive: the reading is late."""
    bandwidth: Annotated[float, Field(gt=0.0)] | None = None
    """Corner frequency of the low-pass of the sensor of the input [Hz]."""
    gain: float = 1.0
    offset: float = 0.0
    faults: dict[str, float] = Field(default_factory=dict)
    """Errors of further kinds by the name of the fault, such as {clock = 0.01}."""


class OutputSpec(ColumnSpec):
    """An output and its sensor."""

    sigma: float | None = None
    relative_sigma: float = 0.0
    """Noise that is proportional to the value [1], in addition to sigma; 0.04 is 4 % of it."""
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
    faults: dict[str, float] = Field(default_factory=dict)
    """Known errors of further kinds by the name of the fault, such as {clock = 0.01}."""
    faults_sd: dict[str, float] = Field(default_factory=dict)
    """Standard deviations of unknown errors of further kinds."""
    reference: Reference = ""
    """Zero of a coordinate: "absolute" (frame of the model), "rest" (its rest pose); default:
    determined from the start of the channel."""
    point: str = ""
    axis: str = ""


class Sheet(Schema):
    """TOML file that describes a measured file."""

    name: str = ""
    role: Literal["fit", "held_out"] = "fit"
    input_mode: Literal["force", "motion"] = "force"
    repeats: str = ""
    source: str = ""
    time: str = ""
    """Column of the clock; default: time or t, else the first column."""
    time_unit: str = ""
    """Unit of the clock; default: the unit of the header, else s."""
    interval: float | None = None
    """Time step [s], if the file has no clock."""
    frame_rate: Annotated[float, Field(gt=0.0)] | None = None
    """True frame rate of a camera [Hz]; the frame rate of the video may differ."""
    run: str = ""
    """Column that numbers the runs of the file; default: a run starts when the clock starts
    again."""
    likelihood: Annotated[float, Field(ge=0.0, le=1.0)] = 0.6
    """Samples of a tracker with a smaller likelihood are missing [1]."""
    missing: tuple[float, ...] = ()
    """Numbers that stand for a missing value in all columns [unit of the file], such as [-9999]."""
    first: int = 0
    """First sample that is used."""
    last: int | None = None
    """Index after the last sample that is used; a negative value counts from the end."""
    every: Annotated[int, Field(ge=1)] = 1
    """Use every n-th sample."""
    inputs: dict[str, InputSpec] = Field(default_factory=dict)
    outputs: dict[str, OutputSpec] = Field(default_factory=dict)
    start: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """State -> (mean, standard deviation) at the first sample [SI]."""
    start_known: bool = True
    """false: the record starts during a motion; the start of the model does not apply."""
    conditions: dict[str, float | str] = Field(default_factory=dict)


@checked
@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Options of reading measured files, which replace the TOML file or the header.

    The mappings go from a channel (or ``time``) to a value. The key ``""`` means all outputs with
    an unknown unit (``units``), or for all outputs in pixels (``scales``, ``origins``).

    Examples
    --------
    The channel ``angle`` is the column ``enc1`` of the file, in degrees:

    >>> from unmodeled.data import ReadOptions
    >>> options = ReadOptions(columns={"angle": "enc1"}, units={"angle": "deg"})
    >>> options.units
    {'angle': 'deg'}
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    """Column of the file for this channel (or for time)."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Unit of a channel (or of time), also px; without CHANNEL: unit of all outputs without a unit
    in the header."""
    scales: Mapping[str, str] = field(default_factory=dict)
    """Length of a pixel, or of another unit of the file, such as 0.21mm; or the distance of two
    points in pixels: '210mm from 120 340 to 412 338'."""
    origins: Mapping[str, str] = field(default_factory=dict)
    """Zero of a channel in the unit of the file; X,Y: zero of all channels in pixels; start: first
    value of the channel."""
    y_up: bool = False
    """The y pixels count upward; default: downward."""
    periods: Mapping[str, str] = field(default_factory=dict)
    """Period of a channel that wraps, such as 65536 in the unit of the file, or 360deg: a jump by
    more than a half of it is one."""
    references: Mapping[str, str] = field(default_factory=dict)
    """absolute (coordinates of the mechanism) or rest (displacement from rest); default: determined
    from the first value of the channel."""
    frame_rate: float | None = None
    """Frames per second of the camera [Hz]."""
    delays: Mapping[str, float] = field(default_factory=dict)
    """Delay of a channel, or of all outputs, relative to the input, such as 12ms. Its unit is s."""
    run: str = ""
    """Column with the number of the run; default: a new run begins where the time restarts."""
    missing: Sequence[float] = ()
    """Number of the file that stands for a missing value, such as -9999."""
    likelihood: float | None = None
    """Points of a tracker below this likelihood [1] are missing values; default: 0.6; the file
    needs a column such as tip_likelihood beside tip_x."""

    def top(self) -> dict[str, Any]:
        """Keys of the TOML file that are replaced."""
        known = {"frame_rate": self.frame_rate, "likelihood": self.likelihood}
        given = {k: v for k, v in known.items() if v is not None}
        texts = {"run": self.run, "time": self.columns.get("time"),
                 "time_unit": self.units.get("time"), "missing": tuple(self.missing)}  # fmt: skip
        return given | {k: v for k, v in texts.items() if v}
