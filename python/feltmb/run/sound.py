"""The sound of the string: signals of a run, and WAV files."""

from __future__ import annotations

import io
import wave

import numpy as np
import numpy.typing as npt

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = npt.NDArray[np.float64]

#: Default sample rate [Hz].
RATE = 44100
#: Largest sample in a file; full scale is 32767.
FULL_SCALE = 32000


@checked
def sampled(time: Array, signal: Array, rate: int = RATE, slowness: float = 1.0) -> Array:
    """Signal over times [s], interpolated linearly at ``rate`` [Hz].

    Raises
    ------
    InvalidParameter
        ``rate`` or ``slowness`` is out of range.
    """
    if not (0 < rate < 2**31 and 0 < slowness < float("inf")):
        raise InvalidParameter(
            f"wav: slowness {slowness:g} and rate {rate} must be finite numbers > 0"
        )
    length = float(time[-1] - time[0]) * slowness * rate
    if length > 1e9:
        raise InvalidParameter(
            f"wav: slowness {slowness:g} at rate {rate} gives {length:.3g} samples, "
            "must be at most 1e9"
        )
    # The spacing follows from the rate alone, so that samples of two runs have equal times.
    grid = time[0] + np.arange(max(2, int(length))) / (rate * slowness)
    return np.asarray(np.interp(grid, time, signal))


@checked
def difference(first: Array, second: Array) -> Array:
    """First minus second signal; the shorter one is extended by zeros."""
    out = np.zeros(max(len(first), len(second)))
    out[: len(first)] += first
    out[: len(second)] -= second
    return out


@checked
def wav(sound: Array, rate: int = RATE) -> bytes:
    """16 bit mono WAV file, scaled to the largest value."""
    top = float(np.max(np.abs(sound)))
    scaled = np.round(sound / top * FULL_SCALE) if top > 0 else np.zeros(len(sound))
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setnchannels(1)
        out.setsampwidth(2)
        out.setframerate(rate)
        out.writeframes(scaled.astype("<i2").tobytes())
    return file.getvalue()
