"""Goldens: which strokes, which signals, how they are stored and compared."""

import json
from pathlib import Path

import numpy as np

import feltmb

FOLDER = Path(__file__).parent / "goldens"
RTOL = 1e-10
OUTPUT_RATE = 10_000.0
DURATION = {"piano": 0.25, "forte": 0.11, "staccato": 0.06}  # s, to the check
SIGNALS = (
    "key.angle",
    "whippen.angle",
    "jack.angle",
    "hammer.angle",
    "damper.angle",
    "hammer_tip.vx",
    "contact03.force",
    "contact04.force",
    "contact06.force",
    "string.strike",
    "string.bridge_force",
)
#: Relative tolerance of the numbers of the summary; the others have 1e-6.
LOOSER = {"rebound_speed": 1e-5, "max_impact_force_time": 1e-5}


def simulate(name):
    """Run of one golden."""
    return feltmb.simulate(
        "steinway45", name, duration=DURATION[name], rtol=RTOL, output_rate=OUTPUT_RATE
    )


def load(name):
    """Signals by name, with ``time``, and the record of how they were made."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        signals = {key: stored[key] for key in stored.files}
    return signals, json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def series_errors(time, got, want, *, absolute=1e-6, relative=1e-6, shift=1e-6):
    """Indices at which ``got`` is neither close in value nor in time to ``want``.

    Parameters
    ----------
    time : ndarray (n,)
        [s], increasing.
    got, want : ndarray (n,)
        Two records of one signal.
    absolute
        Of the range of ``want``.
    relative
        Of the sample.
    shift
        [s]: a sample passes if ``want``, moved by at most this in time, meets it. The steepest of
        the neighboring slopes stands for the curve between the samples.
    """
    error = np.abs(got - want)
    slope = np.abs(np.diff(want) / np.diff(time))
    steepest = np.maximum(np.append(slope, 0.0), np.insert(slope, 0, 0.0))
    room = np.maximum(absolute * np.ptp(want), relative * np.abs(want))
    return np.nonzero(~(error <= np.maximum(room, shift * steepest)))[0]
