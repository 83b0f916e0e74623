"""Strokes: what the finger or the motor does, as force or as motion, against time.

``load_stroke`` reads a packaged stroke, a TOML file or a CSV table; ``ramp_stroke``,
``pulse_stroke``, ``table_stroke``, ``motion_stroke``, ``torque_stroke`` and ``sequence`` make them
in Python.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, ValidationError

from feltmb import _core, params
from feltmb.errors import DataError, InvalidParameter
from feltmb.files import is_file, read_toml
from feltmb.quantity import SI, Schema, fault_lines, fault_text, shortened
from feltmb.smoothing import noise_of_record, smooth_record
from feltmb.units import conversion_factor

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

__all__ = [
    "Stroke",
    "load_stroke",
    "motion_stroke",
    "packaged_strokes",
    "pulse_stroke",
    "ramp_stroke",
    "read_stroke_csv",
    "sequence",
    "table_stroke",
    "torque_stroke",
]

Kind = Literal["force", "motion", "key_motion", "torque", "motor_motion"]
Interpolation = Literal["linear", "monotone", "spline"]
UNITS = {"force": "N", "motion": "m", "key_motion": "m", "torque": "N m", "motor_motion": "rad"}

#: Kinds whose motion a point or a coordinate keeps to exactly; the reaction is an output.
PRESCRIBED = ("key_motion", "motor_motion")

#: Kinds that act on the mechanism's motor instead of the finger.
MOTORS = ("torque", "motor_motion")


@dataclass(frozen=True)
class Stroke:
    """What drives a mechanism, through knots, positive pressing.

    Constant before the first and after the last knot. ``linear`` is straight between knots;
    ``monotone`` is a cubic without overshoot (PCHIP), continuous in slope; ``spline`` is a cubic
    spline, continuous in curvature, at rest at both ends.

    Kinds: ``force`` [N] of the finger on the key; ``motion`` [m] of a finger that meets the key
    through its pad; ``key_motion`` [m] of the point under the finger itself, counted from where it
    starts; ``torque`` [N m] of the mechanism's motor; ``motor_motion`` [rad] of its hub. With the
    two motions that are prescribed exactly, the force that they take is an output
    (``finger.force``, ``motor.torque``).
    """

    name: str
    kind: Kind
    time: tuple[float, ...]
    value: tuple[float, ...]
    interpolation: Interpolation = "linear"
    oscillation_amplitude: float = 0.0
    oscillation_frequency: float = 0.0
    duration: float = 0.4
    source: str = ""
    profile: _core.Profile = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in UNITS:
            raise InvalidParameter(
                f"stroke {self.name!r}: kind {self.kind!r} is none of {', '.join(UNITS)}"
            )
        if self.interpolation not in ("linear", "monotone", "spline"):
            raise InvalidParameter(
                f"stroke {self.name!r}: interpolation {self.interpolation!r} is none of linear, "
                "monotone, spline"
            )
        if not (math.isfinite(self.duration) and self.duration > 0):
            raise InvalidParameter(
                f"stroke {self.name!r}: duration = {self.duration:g} s, must be > 0"
            )
        if not _finite(self.oscillation_amplitude, self.oscillation_frequency):
            raise InvalidParameter(
                f"stroke {self.name!r}: oscillation {self.oscillation_amplitude!r} at "
                f"{self.oscillation_frequency!r} Hz, must be finite numbers"
            )
        try:
            profile = _core.Profile(
                list(self.time),
                list(self.value),
                getattr(_core.Interpolation, self.interpolation),
                self.oscillation_amplitude,
                self.oscillation_frequency,
            )
        except InvalidParameter as error:
            raise InvalidParameter(f"stroke {self.name!r}: {error}") from None
        if self.kind in PRESCRIBED and not profile.smooth:
            raise InvalidParameter(
                f"stroke {self.name!r}: {self.kind} with linear interpolation would need infinite "
                "forces at its knots; use spline or monotone"
            )
        object.__setattr__(self, "profile", profile)

    def __reduce__(self) -> tuple[Any, ...]:
        return (
            Stroke,
            (
                self.name,
                self.kind,
                self.time,
                self.value,
                self.interpolation,
                self.oscillation_amplitude,
                self.oscillation_frequency,
                self.duration,
                self.source,
            ),
        )

    @property
    def unit(self) -> str:
        """Unit of the values: N, m, N m or rad."""
        return UNITS[self.kind]

    def at(self, time: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Values at times [s], in :attr:`unit`."""
        import numpy as np

        return np.asarray(self.profile.value(np.asarray(time, dtype=float)))

    def shifted(self, delay: float) -> Stroke:
        """The same stroke, later by ``delay`` [s]; the duration grows with it.

        Raises
        ------
        InvalidParameter
            The stroke oscillates: its phase counts from time zero.
        """
        if self.oscillation_amplitude and delay:
            raise InvalidParameter(f"stroke {self.name!r} oscillates and cannot be shifted")
        return replace(
            self,
            time=tuple(t + delay for t in self.time),
            duration=self.duration + max(0.0, delay),
        )

    def scaled(self, factor: float) -> Stroke:
        """The same stroke with its values times ``factor``."""
        return replace(self, value=tuple(v * factor for v in self.value))

    @property
    def noise(self) -> float:
        """Estimated standard deviation of the noise of a sampled record, in :attr:`unit`."""
        return noise_of_record(self.value)

    def smoothed(self, noise: float | None = None) -> Stroke:
        """The same record within its noise, as a spline; see :func:`smooth_record`.

        Parameters
        ----------
        noise
            Standard deviation of the noise, in :attr:`unit`; default: :attr:`noise`.
        """
        value = smooth_record(self.time, self.value, self.noise if noise is None else noise)
        return replace(self, value=tuple(value.tolist()), interpolation="spline")

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for files."""
        return {
            "name": self.name,
            "kind": self.kind,
            "time": list(self.time),
            "value": list(self.value),
            "interpolation": self.interpolation,
            "oscillation_amplitude": self.oscillation_amplitude,
            "oscillation_frequency": self.oscillation_frequency,
            "duration": self.duration,
            "source": self.source,
        }


def _need(ok: bool, what: str, got: object, expected: str) -> None:
    if not ok:
        raise InvalidParameter(f"stroke: {what} = {got!r}, must be {expected}")


def _finite(*values: float) -> bool:
    return all(isinstance(v, (int, float)) and math.isfinite(v) for v in values)


def ramp_stroke(
    force: float,
    start: float = 0.05,
    ramp: float = 0.1,
    *,
    duration: float | None = None,
    oscillation: tuple[float, float] | None = None,
    name: str = "ramp",
) -> Stroke:
    """Force that rises linearly from 0 at ``start`` to ``force`` within ``ramp``, then held.

    Parameters
    ----------
    force
        [N]; negative would pull the key up.
    start, ramp
        [s], ``start`` >= 0, ``ramp`` > 0.
    duration
        Length of a run with this stroke [s]; default 0.22 s beyond the end of the ramp.
    oscillation
        Relative amplitude and frequency [Hz] of a factor 1 + a sin(2 pi f t).
    """
    _need(_finite(force), "force", force, "a finite number [N]")
    _need(_finite(start) and start >= 0, "start", start, ">= 0 s")
    _need(_finite(ramp) and ramp > 0, "ramp", ramp, "> 0 s")
    amplitude, frequency = oscillation or (0.0, 0.0)
    _need(_finite(amplitude, frequency), "oscillation", oscillation, "amplitude and Hz")
    return Stroke(
        name,
        "force",
        (start, start + ramp),
        (0.0, force),
        "linear",
        amplitude,
        frequency,
        duration if duration is not None else start + ramp + 0.22,
    )


def pulse_stroke(
    force: float,
    start: float = 0.02,
    rise: float = 0.0125,
    fall: float = 0.0125,
    *,
    hold: float = 0.0,
    duration: float | None = None,
    name: str = "pulse",
) -> Stroke:
    """Force that rises to ``force`` [N] in ``rise`` [s], holds for ``hold``, falls in ``fall``."""
    _need(_finite(force), "force", force, "a finite number [N]")
    _need(_finite(start) and start >= 0, "start", start, ">= 0 s")
    _need(_finite(rise) and rise > 0, "rise", rise, "> 0 s")
    _need(_finite(fall) and fall > 0, "fall", fall, "> 0 s")
    _need(_finite(hold) and hold >= 0, "hold", hold, ">= 0 s")
    time = [start, start + rise]
    value = [0.0, force]
    if hold > 0:
        time.append(time[-1] + hold)
        value.append(force)
    time.append(time[-1] + fall)
    value.append(0.0)
    end = duration if duration is not None else time[-1] + 0.35
    return Stroke(name, "force", tuple(time), tuple(value), duration=end)


def table_stroke(
    time: Sequence[float],
    force: Sequence[float],
    *,
    interpolation: Interpolation = "monotone",
    duration: float | None = None,
    name: str = "table",
) -> Stroke:
    """Force [N] through a table of times [s]."""
    return _table("force", time, force, interpolation, duration, name)


def motion_stroke(
    time: Sequence[float],
    displacement: Sequence[float],
    *,
    of: Literal["finger", "key", "motor"] = "finger",
    interpolation: Interpolation | None = None,
    duration: float | None = None,
    name: str = "motion",
) -> Stroke:
    """Prescribed motion, positive down; the force that it takes is an output.

    Parameters
    ----------
    time
        [s], growing.
    displacement
        [m], of a motor [rad].
    of
        ``finger``: a finger that acts through the one-sided pad of the mechanism's ``[finger]``,
        zero where the pad just touches the key. ``key``: the point under the finger itself, counted
        from where it starts; the key keeps to it exactly and is free to lift or turn about that
        point. ``motor``: the angle of the motor's hub.
    interpolation
        Default: ``monotone`` for the finger, ``spline`` otherwise.
    """
    kinds: dict[str, Kind] = {"finger": "motion", "key": "key_motion", "motor": "motor_motion"}
    if of not in kinds:
        raise InvalidParameter(f"motion_stroke: of = {of!r} is none of {', '.join(kinds)}")
    kind = kinds[of]
    return _table(kind, time, displacement, interpolation or _usual(kind), duration, name)


def torque_stroke(
    time: Sequence[float],
    torque: Sequence[float],
    *,
    interpolation: Interpolation = "linear",
    duration: float | None = None,
    name: str = "torque",
) -> Stroke:
    """Torque [N m] of the mechanism's motor through a table of times [s], positive pressing."""
    return _table("torque", time, torque, interpolation, duration, name)


def _usual(kind: Kind) -> Interpolation:
    """Interpolation of a record that does not say how."""
    return "spline" if kind in PRESCRIBED else "linear" if kind == "torque" else "monotone"


def _table(
    kind: Kind,
    time: Sequence[float],
    value: Sequence[float],
    interpolation: Interpolation,
    duration: float | None,
    name: str,
) -> Stroke:
    times = tuple(float(t) for t in time)
    end = duration if duration is not None else (times[-1] if times and times[-1] > 0 else 0.4)
    return Stroke(name, kind, times, tuple(float(v) for v in value), interpolation, duration=end)


#: A held value goes over to the first value of the next stroke within this time [s].
_SEAM = 1e-4


def sequence(*strokes: Stroke, period: float | None = None, name: str = "sequence") -> Stroke:
    """Strokes one after the other: repeated blows, press and release.

    Parameters
    ----------
    strokes
        All of force or all of motion, without oscillation, same interpolation.
    period
        Each begins this long after the one before [s]; default: when the one before ends
        (its ``duration``). Knots of one stroke must end before the next begins. What a stroke
        holds at its end it holds until then, and lets go within 0.1 ms.
    """
    _need(len(strokes) > 0, "sequence", strokes, "at least one stroke")
    first = strokes[0]
    time: list[float] = []
    value: list[float] = []
    start = 0.0
    for i, stroke in enumerate(strokes):
        if stroke.kind != first.kind or stroke.interpolation != first.interpolation:
            raise InvalidParameter(
                f"sequence: stroke {i} ({stroke.name}) is a {stroke.interpolation} {stroke.kind}, "
                f"the first a {first.interpolation} {first.kind}; they must agree"
            )
        if stroke.oscillation_amplitude:
            raise InvalidParameter(f"sequence: stroke {i} ({stroke.name}) oscillates; give a table")
        if time and value[-1] != stroke.value[0] and start - _SEAM > time[-1]:
            # What the last stroke holds, it holds until the next begins.
            time += [start - _SEAM, start]
            value += [value[-1], stroke.value[0]]
        for t, v in zip(stroke.time, stroke.value, strict=True):
            if time and start + t <= time[-1]:
                if start + t == time[-1] and v == value[-1]:
                    continue
                raise InvalidParameter(
                    f"sequence: stroke {i} ({stroke.name}) begins at {start + t:g} s before the "
                    f"one before it ends at {time[-1]:g} s"
                )
            time.append(start + t)
            value.append(v)
        end = start + stroke.duration
        start = end if period is None else start + period
    return Stroke(name, first.kind, tuple(time), tuple(value), first.interpolation, duration=end)


# --- files ---------------------------------------------------------------------------------------


class _Ramp(Schema):
    force: Annotated[float, SI("N")]
    start: Annotated[float, SI("s"), Field(ge=0)]
    ramp: Annotated[float, SI("s"), Field(gt=0)]


class _Pulse(Schema):
    force: Annotated[float, SI("N")]
    start: Annotated[float, SI("s"), Field(ge=0)]
    rise: Annotated[float, SI("s"), Field(gt=0)]
    hold: Annotated[float, SI("s"), Field(ge=0)] = 0.0
    fall: Annotated[float, SI("s"), Field(gt=0)]


class _Knots(Schema):
    unit: Annotated[list[str], Field(min_length=2, max_length=2)] | None = None
    time: list[float]
    value: list[float]
    interpolation: Interpolation | None = None


class _Oscillation(Schema):
    amplitude: Annotated[float, SI("1")]
    frequency: Annotated[float, SI("Hz"), Field(gt=0)]


class _StrokeFile(Schema):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    about: str = ""
    source: str = ""
    kind: Kind = "force"
    duration: Annotated[float, SI("s"), Field(gt=0)] | None = None
    ramp: _Ramp | None = None
    pulse: _Pulse | None = None
    knots: _Knots | None = None
    oscillation: _Oscillation | None = None
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    period: Annotated[float, SI("s"), Field(gt=0)] | None = None


def packaged_strokes() -> list[str]:
    """Names of the strokes that come with the package."""
    return params.names("strokes")


def load_stroke(name_or_path: str | Path) -> Stroke:
    """Read a stroke: a packaged name, a TOML file, or a CSV of time and force or displacement.

    Raises
    ------
    InvalidParameter
        The name is unknown, or a TOML file has faults (all are listed).
    DataError
        A CSV has faults (all are listed with their lines).
    """
    text = str(name_or_path)
    if text in packaged_strokes():
        return _from_toml(params.folder("strokes") / f"{text}.toml")
    path = Path(text)
    if not is_file(path):
        hint = "there is no such file" if path.suffix else "or give the path of a TOML or CSV file"
        raise InvalidParameter(
            f"stroke {shortened(repr(text))} is unknown; "
            f"packaged are {', '.join(packaged_strokes())}; {hint}"
        )
    return _from_toml(path) if path.suffix == ".toml" else read_stroke_csv(path)


def _from_toml(path: Path) -> Stroke:
    raw = read_toml(path)
    faults: list[str] = []
    if raw.get("kind") in UNITS and raw["kind"] != "force" and "knots" not in raw:
        faults.append(f"kind {raw['kind']!r} needs knots; ramp and pulse are forces")
    given = [key for key in ("ramp", "pulse", "knots") if key in raw]
    if len(given) != 1:
        faults.append(
            f"give one of ramp, pulse, knots; got {', '.join(given) if given else 'none'}"
        )
    try:
        parsed = _StrokeFile.model_validate(raw)
    except ValidationError as error:
        faults += fault_lines(error, _StrokeFile)
    if faults:
        raise InvalidParameter(fault_text(path.name, faults))
    stroke = _one_stroke(parsed, path)
    if parsed.oscillation is not None:
        stroke = replace(
            stroke,
            oscillation_amplitude=parsed.oscillation.amplitude,
            oscillation_frequency=parsed.oscillation.frequency,
        )
    if parsed.duration is not None:
        stroke = replace(stroke, duration=parsed.duration)
    stroke = replace(stroke, name=parsed.name, source=parsed.source)
    if parsed.repeat > 1:
        stroke = sequence(*[stroke] * parsed.repeat, period=parsed.period, name=parsed.name)
        stroke = replace(stroke, source=parsed.source)
    return stroke


def _one_stroke(parsed: _StrokeFile, path: Path) -> Stroke:
    if parsed.ramp is not None:
        r = parsed.ramp
        return ramp_stroke(r.force, r.start, r.ramp)
    if parsed.pulse is not None:
        p = parsed.pulse
        return pulse_stroke(p.force, p.start, p.rise, p.fall, hold=p.hold)
    knots = parsed.knots
    assert knots is not None
    try:
        unit = knots.unit or ["s", UNITS[parsed.kind]]
        time_factor = conversion_factor(unit[0], "s")
        value_factor = conversion_factor(unit[-1], UNITS[parsed.kind])
    except InvalidParameter as error:
        raise InvalidParameter(f"{path.name}: knots.unit: {error}") from None
    return _table(
        parsed.kind,
        [t * time_factor for t in knots.time],
        [v * value_factor for v in knots.value],
        knots.interpolation or (_usual(parsed.kind) if parsed.kind in PRESCRIBED else "linear"),
        None,
        parsed.name,
    )


_HEADER = re.compile(r"^\s*([A-Za-z_ .]+?)\s*(?:\[([^\]]*)\])?\s*$")
_COLUMNS: dict[str, Kind] = {
    "force": "force",
    "displacement": "motion",
    "motion": "motion",
    "key displacement": "key_motion",
    "torque": "torque",
    "motor angle": "motor_motion",
}


def read_stroke_csv(path: str | Path, *, interpolation: Interpolation | None = None) -> Stroke:
    """Read a stroke from CSV with the header ``time [s],force [N]``.

    The second column is ``force``, ``displacement`` (of the finger), ``key displacement``,
    ``torque`` or ``motor angle``. Between rows: a monotone cubic, a spline for the two that are
    prescribed exactly, a straight line for a torque. Units in the header are converted
    (``time [ms],displacement [mm]``). Faults are collected: missing or wrong header, cells that are
    no finite number, times that do not grow, gaps of more than five sample intervals.

    Raises
    ------
    DataError
        Listing all faults with their line numbers.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is no UTF-8 text (byte {error.start})") from None
    if len(text) > 200_000_000:
        raise DataError(f"{path}: {len(text)} bytes; the limit of a stroke is 200 MB")
    kind, factors, header_faults = _parse_header(text)
    time, value, faults = _parse_rows(text, factors)
    faults = header_faults + faults + _time_faults([row for row in time if math.isfinite(row[1])])
    if faults:
        raise DataError(fault_text(path.name, faults, most=20))
    usual = interpolation or _usual(kind)
    return _table(kind, [t for _, t in time], value, usual, None, path.stem)


def _parse_header(text: str) -> tuple[Kind, tuple[float, float], list[str]]:
    wanted = (
        "'time [s],force [N]', or instead of force: displacement [m], key displacement [m], "
        "torque [N m], motor angle [rad]"
    )
    line = next((x for x in text.splitlines() if x.strip() and not x.startswith("#")), "")
    cells = line.split(",")
    kind: Kind = "force"
    factors = [1.0, 1.0]
    if len(cells) != 2:
        return kind, (1.0, 1.0), [f"header: got {line[:80]!r}, expected {wanted}"]
    faults = []
    for i, cell in enumerate(cells):
        match = _HEADER.match(cell)
        name = match.group(1).strip().lower() if match else ""
        unit = match.group(2) if match else None
        if i == 0 and name == "time":
            si = "s"
        elif i == 1 and name in _COLUMNS:
            kind = _COLUMNS[name]
            si = UNITS[kind]
        else:
            faults.append(f"header: got column {cell.strip()[:80]!r}, expected {wanted}")
            continue
        if unit is None:
            faults.append(f"header: column {cell.strip()!r} states no unit; write '{name} [{si}]'")
            continue
        try:
            factors[i] = conversion_factor(unit, si)
        except InvalidParameter as error:
            faults.append(f"header: column {name!r}: {error}")
    return kind, (factors[0], factors[1]), faults


def _parse_rows(
    text: str, factors: tuple[float, float]
) -> tuple[list[tuple[int, float]], list[float], list[str]]:
    time: list[tuple[int, float]] = []
    value: list[float] = []
    faults: list[str] = []
    header_seen = False
    for number, line in enumerate(io.StringIO(text), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        if not header_seen:
            header_seen = True
            continue
        cells = line.rstrip("\r\n").split(",")
        if len(cells) != 2:
            faults.append(f"line {number}: got {len(cells)} cells, expected 2")
            continue
        row = []
        for cell, column in zip(cells, ("time", "value"), strict=True):
            try:
                parsed = float(cell)
            except ValueError:
                parsed = math.nan
            if not math.isfinite(parsed):
                faults.append(
                    f"line {number}: {column} is {cell.strip()!r}, expected a finite number"
                )
            row.append(parsed)
        time.append((number, row[0] * factors[0]))
        value.append(row[1] * factors[1])
    if len(time) < 2 and not faults:
        faults.append(f"got {len(time)} rows of data, expected at least 2")
    return time, value, faults


def _time_faults(time: list[tuple[int, float]]) -> list[str]:
    faults = []
    steps = [b[1] - a[1] for a, b in itertools.pairwise(time)]
    for (number, t), step in zip(time[1:], steps, strict=True):
        if step <= 0:
            faults.append(
                f"line {number}: time {t:.9g} s does not follow {t - step:.9g} s; it must grow"
            )
    if not faults and len(steps) > 20:
        usual = sorted(steps)[len(steps) // 2]
        for (number, t), step in zip(time[1:], steps, strict=True):
            if step > 5 * usual:
                faults.append(
                    f"line {number}: gap of {step:.6g} s before {t:.6g} s; the usual step is "
                    f"{usual:.6g} s; fill it or cut the record there"
                )
    return faults
