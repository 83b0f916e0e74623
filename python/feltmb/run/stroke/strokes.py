"""Strokes, and functions that make them: ramps, pulses, tables, motions, sequences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from feltmb import _core
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


Kind = Literal["force", "motion", "key_motion", "torque", "motor_motion"]
Interpolation = Literal["linear", "monotone", "spline"]
UNITS = {"force": "N", "motion": "m", "key_motion": "m", "torque": "N m", "motor_motion": "rad"}

#: Largest value by unit: neither a hand nor a motor reaches more, and such a run would not end.
LARGEST = {"N": 1e5, "m": 10.0, "N m": 1e5, "rad": 1e3}

#: Kinds whose motion a point or a coordinate follows exactly; the reaction is an output.
PRESCRIBED = ("key_motion", "motor_motion")

#: Kinds that act on the mechanism's motor instead of the finger.
MOTORS = ("torque", "motor_motion")


@checked
@dataclass(frozen=True)
class Stroke:
    """Input of a mechanism as a function through knots, positive in the direction of pressing.

    It is constant before the first and after the last knot. ``linear``: linear between knots;
    ``monotone``: a cubic without overshoot (PCHIP) with continuous slope; ``spline``: a cubic
    spline with continuous curvature, at rest at both ends.

    Kinds: ``force`` [N] of the finger on the key; ``motion`` [m] of a finger that presses the key
    through its pad; ``key_motion`` [m] of the point under the finger, relative to its start;
    ``torque`` [N m] of the mechanism's motor; ``motor_motion`` [rad] of its hub. For the two
    motions that are prescribed exactly, the required force or torque is an output
    (``finger.force``, ``motor.torque``).

    Examples
    --------
    A force of 10 N from 20 ms on:

    >>> import feltmb
    >>> press = feltmb.Stroke("press", "force", (0.0, 0.02, 0.021), (0.0, 0.0, 10.0))
    >>> press.duration, press.interpolation
    (0.4, 'linear')
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
        unit = UNITS[self.kind]
        largest = max((abs(v) for v in self.value), default=0.0)
        most = LARGEST[unit]
        if largest > most:
            raise InvalidParameter(
                f"stroke {self.name!r}: value {largest:.6g} {unit}, expected {most:g} at most"
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
    def input(self) -> _core.InputSignal:
        """The input for the core."""
        return _core.InputSignal(self.profile, self.kind)

    @property
    def unit(self) -> str:
        """Unit of the values: N, m, N m or rad."""
        return UNITS[self.kind]

    def at(self, time: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Values at times [s], in :attr:`unit`."""
        import numpy as np

        return np.asarray(self.profile.value(np.asarray(time, dtype=float)))

    def shifted(self, delay: float) -> Stroke:
        """Copy of the stroke, later by ``delay`` [s]; its duration increases accordingly.

        Raises
        ------
        InvalidParameter
            The stroke oscillates; the phase of an oscillation is relative to time zero.
        """
        if self.oscillation_amplitude and delay:
            raise InvalidParameter(f"stroke {self.name!r} oscillates and cannot be shifted")
        return replace(
            self,
            time=tuple(t + delay for t in self.time),
            duration=self.duration + max(0.0, delay),
        )

    def scaled(self, factor: float) -> Stroke:
        """Copy of the stroke with its values multiplied by ``factor``."""
        return replace(self, value=tuple(v * factor for v in self.value))

    @property
    def noise(self) -> float:
        """Estimated standard deviation of the noise of a sampled record, in :attr:`unit`."""
        from unmodeled.data.smoothing import noise_of_record

        return noise_of_record(self.value)

    def smoothed(self, noise: float | None = None) -> Stroke:
        """Copy of a record, smoothed within its noise, as a spline; see :func:`smooth_record`.

        Parameters
        ----------
        noise
            Standard deviation of the noise, in :attr:`unit`; default: :attr:`noise`.
        """
        from unmodeled.data.smoothing import smooth_record

        value = smooth_record(self.time, self.value, self.noise if noise is None else noise)
        return replace(self, value=tuple(value.tolist()), interpolation="spline")

    def as_dict(self) -> dict[str, Any]:
        """Plain data for files."""
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


@checked
def ramp_stroke(
    force: float,
    start: float = 0.05,
    ramp: float = 0.1,
    *,
    duration: float | None = None,
    oscillation: tuple[float, float] | None = None,
    name: str = "ramp",
) -> Stroke:
    """Force that rises linearly from 0 at ``start`` to ``force`` within ``ramp``, then constant.

    Parameters
    ----------
    force
        Final force [N]; a negative force would lift the key.
    start, ramp
        Start and duration of the rise [s], ``start`` >= 0, ``ramp`` > 0.
    duration
        Duration of a run with this stroke [s]; default: until 0.22 s after the ramp.
    oscillation
        Relative amplitude and frequency [Hz] of a factor 1 + a sin(2 pi f t).

    Examples
    --------
    20 N within 0.1 s, half of it at 0.1 s:

    >>> from feltmb import ramp_stroke
    >>> round(float(ramp_stroke(20.0, start=0.05, ramp=0.1).at(0.1)), 6)
    10.0
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


@checked
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
    """Pulse of force: it rises to ``force`` [N], is held, and falls.

    Parameters
    ----------
    force
        Largest force [N].
    start
        Time at which the force begins [s].
    rise
        Duration of the rise [s].
    fall
        Duration of the fall [s].
    hold
        Duration for which the force is held [s].
    duration
        Duration of a run with the stroke [s]; default: a while beyond its end.
    name
        Name of the stroke.

    Examples
    --------
    A pulse of 10 N that rises and falls within 5 ms:

    >>> import feltmb
    >>> pulse = feltmb.pulse_stroke(10.0, 0.01, 0.005, 0.005)
    >>> max(pulse.value), pulse.kind
    (10.0, 'force')
    """
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


@checked
def table_stroke(
    time: Sequence[float],
    force: Sequence[float],
    *,
    interpolation: Interpolation = "monotone",
    duration: float | None = None,
    name: str = "table",
) -> Stroke:
    """Force [N] through a table of times [s].

    Parameters
    ----------
    time
        Times of the knots [s].
    force
        Force at the knots [N].
    interpolation
        ``linear``, ``monotone`` or ``spline``.
    duration
        Duration of a run with the stroke [s]; default: a while beyond its end.
    name
        Name of the stroke.

    Examples
    --------
    Between 0 N at 0 s and 8 N at 0.2 s:

    >>> from feltmb import table_stroke
    >>> stroke = table_stroke([0.0, 0.2], [0.0, 8.0], interpolation="linear")
    >>> round(float(stroke.at(0.05)), 6)
    2.0
    """
    return table_of("force", time, force, interpolation, duration, name)


@checked
def motion_stroke(
    time: Sequence[float],
    displacement: Sequence[float],
    *,
    of: Literal["finger", "key", "motor"] = "finger",
    interpolation: Interpolation | None = None,
    duration: float | None = None,
    name: str = "motion",
) -> Stroke:
    """Prescribed motion, positive downward. The required force is an output.

    Parameters
    ----------
    time
        Increasing times [s].
    displacement
        Displacement [m], or angle of a motor [rad].
    of
        ``finger``: a finger that acts through the one-sided pad of the mechanism's ``[finger]``; at
        zero, the pad just touches the key. ``key``: the point under the finger, relative to its
        start; the key follows it exactly and can lift or turn about that point. ``motor``: the
        angle of the motor's hub.
    interpolation
        Interpolation; default: ``monotone`` for the finger, ``spline`` otherwise.

    Examples
    --------
    A finger that goes 10 mm down in 0.1 s, in m:

    >>> from feltmb import motion_stroke
    >>> stroke = motion_stroke([0.0, 0.1], [0.0, 0.01], interpolation="linear")
    >>> stroke.kind, stroke.unit, round(float(stroke.at(0.05)), 6)
    ('motion', 'm', 0.005)
    """
    kinds: dict[str, Kind] = {"finger": "motion", "key": "key_motion", "motor": "motor_motion"}
    if of not in kinds:
        raise InvalidParameter(f"motion_stroke: of = {of!r} is none of {', '.join(kinds)}")
    kind = kinds[of]
    return table_of(
        kind, time, displacement, interpolation or usual_interpolation(kind), duration, name
    )


@checked
def torque_stroke(
    time: Sequence[float],
    torque: Sequence[float],
    *,
    interpolation: Interpolation = "linear",
    duration: float | None = None,
    name: str = "torque",
) -> Stroke:
    """Torque [N m] of the mechanism's motor through a table of times [s], positive pressing.

    Parameters
    ----------
    time
        Times of the knots [s].
    torque
        Torque at the knots [N m].
    interpolation
        ``linear``, ``monotone`` or ``spline``.
    duration
        Duration of a run with the stroke [s]; default: a while beyond its end.
    name
        Name of the stroke.
    """
    return table_of("torque", time, torque, interpolation, duration, name)


def usual_interpolation(kind: Kind) -> Interpolation:
    """Default interpolation of a record."""
    return "spline" if kind in PRESCRIBED else "linear" if kind == "torque" else "monotone"


def table_of(
    kind: Kind,
    time: Sequence[float],
    value: Sequence[float],
    interpolation: Interpolation,
    duration: float | None,
    name: str,
) -> Stroke:
    """A stroke through knots; its default duration is the time of the last knot."""
    times = tuple(float(t) for t in time)
    end = duration if duration is not None else (times[-1] if times and times[-1] > 0 else 0.4)
    return Stroke(name, kind, times, tuple(float(v) for v in value), interpolation, duration=end)


#: A held value changes to the first value of the next stroke within this time [s].
_SEAM = 1e-4


@checked
def sequence(*strokes: Stroke, period: float | None = None, name: str = "sequence") -> Stroke:
    """Strokes one after the other: repeated strikes, press and release.

    Parameters
    ----------
    strokes
        All of force or all of motion, without oscillation, with equal interpolation.
    period
        Time between the starts of consecutive strokes [s]; default: the ``duration`` of the earlier
        one. Knots of one stroke must end before the next starts. The last value of a stroke is held
        until then and changes within 0.1 ms.

    Examples
    --------
    The same note twice, 0.5 s apart:

    >>> import feltmb
    >>> note = feltmb.pulse_stroke(10.0)
    >>> feltmb.sequence(note, note, period=0.5).duration
    0.895
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
            # The last value of a stroke is held until the next one starts.
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
