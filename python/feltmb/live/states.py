"""Requests of a page: the checked state of its controls, as a mechanism and a stroke."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator

from feltmb.live.knobs import Bench
from feltmb.mechanism import Action
from feltmb.params import names
from feltmb.run.stroke import (
    Stroke,
    load_stroke,
    motion_stroke,
    pulse_stroke,
    ramp_stroke,
    sequence,
    table_stroke,
)
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.page import guard

#: Largest numbers of knots of a drawn stroke, of changed controls, and of shown outputs.
MOST_KNOTS, MOST_TURNED, MOST_SHOWN = 400, 500, 24
#: Longest stroke [s]; the page would wait too long for a longer one.
LONGEST = 3.0
#: Start of the strokes of the page [s].
START = 0.02

Finite = Annotated[float, Field(allow_inf_nan=False)]


@cache
def _packaged(name: str) -> Stroke:
    """Read once: a page that turns asks for the same stroke many times a second."""
    return load_stroke(name)


def fault_of(error: Exception) -> str:
    """Message of an error for the page; internal errors are written to the log."""
    return guard.fault_of(error, "feltmb live")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Turned(_Table):
    """Changes: magnitudes of knobs [SI], and numbers by path in the units of the file."""

    knobs: Annotated[dict[str, Finite], Field(max_length=MOST_TURNED)] = {}
    numbers: Annotated[dict[str, Finite], Field(max_length=MOST_TURNED)] = {}

    def values(self, bench: Bench) -> dict[str, float | str]:
        """The changed numbers by path, as for ``--set``.

        Raises
        ------
        InvalidParameter
            This mechanism does not have a changed value.
        """
        return bench.values(self.knobs, self.numbers)

    def action(self, bench: Bench) -> Action:
        """The mechanism with all changes.

        Raises
        ------
        InvalidParameter
            This mechanism does not have a changed value, or the value is out of range.
        """
        return bench.changed(self.values(bench))


class Playing(_Table):
    """The stroke that is simulated."""

    kind: Literal["packaged", "press", "strike", "drawn", "slow", "repeat", "free"] = "packaged"
    name: Annotated[str, Field(max_length=200)] = "forte"
    force: Annotated[float, Field(gt=0, le=200, allow_inf_nan=False)] = 5.0
    """Force of ``press`` and ``repeat`` [N]."""
    speed: Annotated[float, Field(ge=0.005, le=5, allow_inf_nan=False)] = 0.2
    """Speed of the finger in ``strike`` and ``slow`` [m/s]."""
    travel: Annotated[float, Field(gt=0, le=0.05, allow_inf_nan=False)] = 0.012
    """Travel of the finger in ``strike`` and ``slow`` [m]."""
    rate: Annotated[float, Field(ge=1, le=20, allow_inf_nan=False)] = 6.0
    """Number of strikes per second of ``repeat`` [1/s]."""
    count: Annotated[int, Field(ge=1, le=12)] = 3
    duration: Annotated[float, Field(ge=0.01, le=LONGEST)] = 0.5
    """Duration of ``free``, without a finger [s]."""
    drawn: Literal["force", "motion"] = "force"
    time: Annotated[list[Finite], Field(max_length=MOST_KNOTS)] = []
    value: Annotated[list[Finite], Field(max_length=MOST_KNOTS)] = []

    @model_validator(mode="after")
    def _known(self) -> Playing:
        if self.kind == "packaged" and self.name not in names("strokes"):
            known = ", ".join(names("strokes"))
            raise ValueError(f"stroke {shortened(repr(self.name))} is unknown; known are {known}")
        if self.kind == "drawn" and not 2 <= len(self.time) == len(self.value):
            raise ValueError("a drawn stroke needs 2 or more knots, a value for each time")
        return self

    def stroke(self) -> Stroke:
        """The stroke.

        Raises
        ------
        InvalidParameter
            It is too long, or the times of its knots do not increase.
        """
        stroke = self._made()
        if stroke.duration > LONGEST:
            raise InvalidParameter(
                f"stroke {stroke.name!r} lasts {stroke.duration:.3g} s, expected {LONGEST:g} s at "
                "most in a live page; use feltmb stroke"
            )
        return stroke

    def _made(self) -> Stroke:
        if self.kind == "packaged":
            return _packaged(self.name)
        if self.kind == "free":
            return table_stroke(
                [0.0, self.duration], [0.0, 0.0], interpolation="linear", name="free"
            )
        if self.kind == "press":
            return ramp_stroke(self.force, START, 0.02, duration=0.3, name=f"{self.force:g} N")
        if self.kind == "drawn":
            end = max(self.time) + 0.15
            if self.drawn == "force":
                return table_stroke(
                    self.time, self.value, interpolation="linear", duration=end, name="drawn force"
                )
            return motion_stroke(self.time, self.value, duration=end, name="drawn motion")
        if self.kind == "repeat":
            period = 1.0 / self.rate
            pulse = pulse_stroke(
                self.force, 0.01, 0.25 * period, 0.25 * period, duration=period, name="strike"
            )
            return sequence(*[pulse] * self.count, name=f"{self.count} at {self.rate:g} Hz")
        end = START + self.travel / self.speed
        time, value = [START, end], [0.0, self.travel]
        if self.kind == "slow":
            time += [end + 0.05, 2.0 * end + 0.05 - START]
            value += [self.travel, 0.0]
        return motion_stroke(
            time,
            value,
            interpolation="linear",
            duration=time[-1] + 0.1,
            name=f"{self.kind} {self.speed:g} m/s",
        )


class Asked(_Table):
    """One request of a page."""

    _came: float = PrivateAttr(default_factory=time.perf_counter)
    id: Annotated[int, Field(ge=0, le=2**53)]
    turned: Turned = Turned()
    minus: Turned | None = None
    """Mechanism whose sound is subtracted from the sound of ``turned``."""
    playing: Playing = Playing()
    until: Annotated[float, Field(ge=1e-3, allow_inf_nan=False)] = LONGEST
    """End of the pictures during changes [s]; the complete run follows."""
    shown: Annotated[list[str], Field(max_length=MOST_SHOWN)] = []
    """Outputs whose curves are shown."""
    extras: Annotated[list[Literal["targets", "touch", "speeds"]], Field(max_length=3)] = []
    """Additional results, computed when nothing else is to be done."""

    @property
    def came(self) -> float:
        """When the request came, on the clock of ``time.perf_counter`` [s]."""
        return self._came

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> Asked:
        """Request from a message of the page.

        Raises
        ------
        InvalidParameter
            The message is not a valid request.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            lines = [
                f"{'.'.join(map(str, e['loc']))[:80]}: {e['msg'][:200]}" for e in error.errors()[:8]
            ]
            raise InvalidParameter("\n".join(lines)) from None
