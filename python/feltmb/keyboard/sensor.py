"""A sensor at the hammer, the key or both: curve, place, noise, converter, sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from feltmb import params
from feltmb.action.touch.static import roles_of
from feltmb.keyboard.gestures import Press, gesture, run_all, truth_of
from feltmb.mechanism import Action
from feltmb.quantities import SI
from feltmb.run.simulate import simulate
from feltmb.run.stroke import ramp_stroke
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import read_toml
from unmodeled.units.quantity import Schema, validated

if TYPE_CHECKING:
    import numpy.typing as npt
    import pandas as pd

    from feltmb.run.results import Run

    Array = npt.NDArray[np.float64]

#: Strokes from which the distances of an action are taken: power, finger speed [m/s].
PROBES = ((2.0, 0.14), (2.0, 0.2), (2.0, 0.25), (2.0, 0.35), (2.0, 0.45), (1.0, 0.5), (1.0, 0.9),
          (1.0, 1.4))  # fmt: skip

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Sensor(Schema):
    """Description of a sensor; the file of ``feltmb keyboard sensor`` has these keys.

    A curve that rises and falls has branches: one reading belongs to several travels.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    name: str
    about: str = ""
    at: Literal["hammer", "key", "both"] = "hammer"
    travel: Annotated[tuple[float, ...], Field(min_length=2, max_length=1000)] = (0.0, 1.0)
    """Travels of the curve [1]: 0 at rest, 1 where hammer and string, or key and punching, meet."""
    reading: Annotated[tuple[Share, ...], Field(min_length=2, max_length=1000)] = (0.0, 1.0)
    """Readings at these travels, share of the full scale [1]; they may rise and fall."""
    place: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    """Where the hammer is seen: share of the way from its center to the strike point."""
    bits: Annotated[int, Field(ge=4, le=24)] = 12
    low: float = 0.0
    """Reading at the lowest count of the converter."""
    high: float = 1.05
    """Reading at the highest count of the converter."""
    noise: Annotated[float, Field(ge=0.0, le=0.1)] = 3e-4
    """Standard deviation of the reading."""
    rate: Annotated[float, SI("Hz"), Field(ge=100.0, le=1e6)] = 5000.0
    """Samples per second [Hz]."""
    shift: Annotated[float, SI("1"), Field(ge=0.0, le=0.2)] = 0.0
    """Tolerance of its place: standard deviation of the travel of each unit [1]."""
    gain: Annotated[float, SI("1"), Field(ge=0.0, le=0.3)] = 0.0
    """Tolerance of its gain: relative standard deviation of the reading of each unit [1]."""

    @model_validator(mode="after")
    def _table(self) -> Sensor:
        if len(self.travel) != len(self.reading):
            raise ValueError(
                f"got {len(self.travel)} travels and {len(self.reading)} readings, expected as many"
            )
        if any(b <= a for a, b in pairwise(self.travel)):
            raise ValueError("travel: expected increasing numbers")
        if self.travel[0] > 0.0 or self.travel[-1] < 0.95:
            raise ValueError(
                f"travel: got {self.travel[0]:g} to {self.travel[-1]:g}, expected from 0 to at "
                "least 0.95"
            )
        if self.high <= self.low:
            raise ValueError(f"high: got {self.high:g}, expected above low, {self.low:g}")
        if min(map(abs, np.diff(self.reading))) == 0.0 and len(set(self.reading)) == 1:
            raise ValueError("reading: got one value, expected a curve")
        return self

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the columns of its samples."""
        return ("hammer", "key") if self.at == "both" else (self.at,)

    @cached_property
    def branches(self) -> tuple[slice, ...]:
        """Parts of the table in which the reading rises or falls all the way."""
        sign = np.sign(np.diff(self.reading))
        ends = [0, *(np.flatnonzero(sign[1:] != sign[:-1]) + 1).tolist(), len(self.travel) - 1]
        return tuple(slice(a, b + 1) for a, b in pairwise(ends))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the curve."""
        found = []
        if len(self.branches) > 1:
            parts = " and ".join(
                f"{self.travel[b][0]:g} to {self.travel[b][-1]:g}" for b in self.branches
            )
            found.append(
                f"the curve is not monotonic: a reading belongs to {len(self.branches)} branches "
                f"of the travel, {parts}; the travel is followed from rest"
            )
        if max(self.reading) > self.high or min(self.reading) < self.low:
            found.append(f"the converter clips readings outside {self.low:g} to {self.high:g}")
        return tuple(found)

    def sample(
        self, time: Array, travel: dict[str, Array], rng: np.random.Generator
    ) -> pd.DataFrame:
        """Counts of the converter for travels [1] over time [s], by channel; one unit each.

        Parameters
        ----------
        time
            Times [s].
        travel
            Travels by channel.
        rng
            Random numbers of the noise and of the tolerances.
        """
        import pandas as pd

        ticks = np.arange(time[0], time[-1], 1.0 / self.rate)
        most = 2**self.bits - 1
        columns = {}
        for name in self.channels:
            seen = np.interp(ticks, time, travel[name]) + rng.normal(0.0, self.shift)
            reading = np.interp(seen, self.travel, self.reading)
            reading = reading * (1.0 + rng.normal(0.0, self.gain))
            reading = reading + rng.normal(0.0, self.noise, ticks.size)
            counts = np.rint((reading - self.low) / (self.high - self.low) * most)
            columns[name] = np.clip(counts, 0, most).astype(np.int32)
        return pd.DataFrame(columns, index=pd.Index(ticks, name="time"))

    def travel_of(self, counts: npt.ArrayLike) -> list[Array]:
        """Travels [1] to which counts may belong, by branch; NaN: none of this branch."""
        reading = self.low + np.asarray(counts) / (2**self.bits - 1) * (self.high - self.low)
        found = []
        for part in self.branches:
            y, x = np.array(self.reading[part]), np.array(self.travel[part])
            y, x = (y, x) if y[-1] > y[0] else (y[::-1], x[::-1])
            inside = np.interp(reading, y, x)
            if len(self.branches) == 1:  # beyond the table as at its end: the gain may be off
                for end, inner in ((0, 1), (-1, -2)):
                    slope = (x[inner] - x[end]) / (y[inner] - y[end])
                    past = reading < y[0] if end == 0 else reading > y[-1]
                    inside = np.where(past, x[end] + slope * (reading - y[end]), inside)
            else:
                off = (reading < y[0] - 4 * self.noise) | (reading > y[-1] + 4 * self.noise)
                inside = np.where(off, np.nan, inside)
            found.append(inside)
        return found

    def followed(self, counts: npt.ArrayLike) -> Array:
        """Travel [1] of counts that begin at rest; from branch to branch without a jump."""
        found = self.travel_of(counts)
        if len(found) == 1:
            return found[0]
        table = np.stack(found)
        out = np.zeros(table.shape[1])
        last = step = 0.0
        for i, column in enumerate(table.T):
            distance = np.abs(column - (last + step))
            if np.isfinite(distance).any():
                now = float(column[np.nanargmin(distance)])
                step, last = 0.5 * step + 0.5 * (now - last), now
            out[i] = last
        return out


@checked
def load_sensor(name_or_path: str | Path) -> Sensor:
    """A packaged sensor by its name, or one from a TOML file.

    Raises
    ------
    InvalidParameter
        The file does not exist, or its content is invalid; all faults are told.
    """
    path = params.find(name_or_path, "sensors", "sensor")
    return validated(Sensor, read_toml(path), str(path))


@dataclass(frozen=True, eq=False)
class Setup:
    """A sensor in an action: what an algorithm may know beside the samples.

    Attributes
    ----------
    sensor : Sensor
        Description without the errors of the unit at hand.
    action : str
    reach : float
        Travel of the strike point to the string [m]; travel 1 of the hammer.
    dip : float
        Travel of the key to its punching [m]; travel 1 of the key.
    flight : float
        Mean deceleration of the strike point just before the string [m/s^2].
    speeds, peaks : tuple of float
        Speeds at the string [m/s], and the largest travel of the hammer in such a strike [1]: felt
        and string yield.
    """

    sensor: Sensor
    action: str
    reach: float
    dip: float
    flight: float
    speeds: tuple[float, ...]
    peaks: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for programs."""
        return {**vars(self), "sensor": self.sensor.model_dump(by_alias=True)}

    def stream(self, samples: pd.DataFrame) -> str:
        """Text of a record for firmware: the setup, then one line of counts a sample.

        The first three lines are comments: numbers as ``name=value``, and the curve of the sensor.

        Parameters
        ----------
        samples
            Counts over the time [s].
        """
        sensor = self.sensor
        known = {
            "rate": sensor.rate, "start": float(samples.index[0]), "bits": sensor.bits,
            "low": sensor.low, "high": sensor.high, "reach": self.reach, "dip": self.dip,
            "flight": self.flight,
        }  # fmt: skip
        curve = {"travel": sensor.travel, "reading": sensor.reading}
        return "".join(
            (
                f"# {' '.join(f'{k}={v:.9g}' for k, v in known.items())}\n",
                *(f"# {k}={','.join(f'{v:.9g}' for v in row)}\n" for k, row in curve.items()),
                samples.to_csv(index=False),
            )
        )


def setup_of(action: Action, sensor: Sensor) -> Setup:
    """What an algorithm may know of an action with a sensor, from a few simulated strokes."""
    strokes = [gesture([Press(s, p)]) for p, s in PROBES]
    flights: list[float] = []
    peaks: list[tuple[float, float]] = []

    def take(_: int, run: Run) -> None:
        if not (strikes := truth_of(run)):
            return
        time, speed = strikes[0]
        tip = _motions(action, run, 1.0)[0]
        rows = (run.time > time - 3e-3) & (run.time < time)
        flights.append(float(-2.0 * np.polyfit(run.time[rows] - time, tip[rows], 2)[0]))
        peaks.append((speed, float(_motions(action, run, sensor.place)[0].max())))

    run_all(action, strokes, take)
    if not peaks:
        raise InvalidParameter(f"action {action.name!r}: its hammer does not reach the string")
    still = simulate(action, ramp_stroke(0.0, duration=1e-4), ledger=False)
    roles = roles_of(action)
    reach, dip = (
        float(-still[f"contact{roles[name]:02d}.compression"][0]) for name in ("strike", "bottom")
    )
    peaks = sorted([(0.0, reach), *peaks])
    return Setup(
        sensor,
        action.name,
        reach,
        dip,
        float(np.median(flights)),
        tuple(v for v, _ in peaks),
        tuple(x / reach for _, x in peaks),
    )


def travels(action: Action, run: Run, setup: Setup) -> dict[str, Array]:
    """Travel of hammer and key in a run [1]: 0 at rest, 1 at string and punching.

    Parameters
    ----------
    action
        Mechanism of the run.
    run
        Run.
    setup
        Distances of the action, and where the sensor sees the hammer.
    """
    hammer, key = _motions(action, run, setup.sensor.place)
    return {"hammer": hammer / setup.reach, "key": key / setup.dip}


def _motions(action: Action, run: Run, place: float) -> tuple[Array, Array]:
    """Motion of the hammer, scaled to its strike point, and of the key front from rest [m].

    The hammer is seen at ``place`` on the way from its center to the strike point. A flexible
    shank counts with the shape that a weight at its end gives it.
    """
    config = action.config
    striker, weights = config.reading.striker, config.reading.weights
    point, strike = config.reading.key_point, config.reading.strike_contact
    if striker is None or weights is None or point is None or strike is None:
        raise InvalidParameter(
            f"action {action.name!r}: its file does not say what is hammer, string and key front; "
            "expected reading.striker, weights, strike_contact and key_point"
        )
    # Toward the string at rest, as its contact has it.
    gap = -run[f"contact{strike:02d}.compression"]
    gap = gap - run["string.strike"] if "string.strike" in run.names else gap
    tip = np.stack([run[f"{striker.point}.{axis}"] for axis in "xy"])
    direction = np.array(striker.direction) / math.hypot(*striker.direction)
    # Less the bending between the place and the tip; the hub alone would turn a rigid shank.
    hub = config.bodies[weights.hammer]
    turned = run[str(hub.coordinate)]
    turned = turned - turned[0]
    arm = tip[:, 0] - np.array(hub.position)
    across = direction @ np.array([-arm[1], arm[0]])
    rigid = (np.cos(turned) - 1.0) * (direction @ arm) + np.sin(turned) * across
    bent = direction @ (tip - tip[:, :1]) - rigid
    key = run[f"{point}.y"]
    return gap[0] - gap - (1.0 - 0.5 * place * (3.0 - place)) * bent, key[0] - key
