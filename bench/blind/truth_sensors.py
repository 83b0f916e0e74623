"""What the sensors of the blind bench show of the machine, by the generator's own code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from blind.truth import FRAME, KEEP, LENGTH, RATIO, STEP, STROKES, Array, Case, played
from blind.truth_machine import Strokes

NOISE_CAMERA = 5e-5  # [m]
PIXEL = 2e-5  # [m]
NOISE_INPUT = {"force": 0.02, "motion": 1e-5}  # [N], [m], before the filter
RANGE_INPUT = {"force": 25.0, "motion": 12e-3}  # of 12 bits [N], [m]


def _coarse(values: Array, quantum: float) -> Array:
    return np.asarray(np.round(values / quantum) * quantum)


class _Sizes:
    """Magnitudes of the withheld effects of a case, 0 for those that are not there."""

    def __init__(self, case: Case):
        self.total = {(q.name, q.form): q.size for q in case.parts}

    def __call__(self, name: str, form: str) -> float:
        return float(self.total.get((name, form), 0.0))


def _expose(frames: Array, fine: Array, y: Array, late: float) -> Array:
    """Mean while the shutter is open: half a frame around the time stamp."""
    moments = frames[:, None] - late + np.linspace(-0.5, 0.5, 11)[None, :] * 0.5 * FRAME
    return np.asarray(np.interp(moments, fine, y).mean(axis=1))


def _grain(count: int, rng: np.random.Generator) -> Array:
    """Mean of three frames' white noise: correlated over three frames, of unit variance."""
    white = rng.standard_normal(count + 2)
    return np.asarray((white[:-2] + white[1:-1] + white[2:]) / np.sqrt(3.0))


def _cameras(
    case: Case,
    result: Strokes,
    job: int,
    fine: Array,
    outside: Mapping[str, Any],
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Key and hammer as the optics sees them, not yet sampled."""
    size = _Sizes(case)
    key = result.key[:, job]
    hammer = result.hammer[:, job] - result.bend[:, job]
    finger = result.finger[:, job]
    key = key + finger * size("key_flexibility", "A")
    key = key + size("key_flexibility", "B") * finger * (1.1 - 0.1 * np.tanh(finger / 5.0))
    hammer = hammer * (1.0 + size("hammer_scale", "A"))
    hammer = hammer + size("hammer_scale", "B") * hammer * (0.8 + 0.4 * hammer / 45e-3)
    hammer = hammer + size("hammer_offset", "A")
    hammer = hammer + size("hammer_offset", "B") * (0.8 + 0.4 * fine / LENGTH)
    for q in case.parts:
        if q.form == "outside" and hasattr(outside[q.name], "observe"):
            key, hammer = outside[q.name].observe(fine, key, hammer, q.size, rng)
    return key, hammer


def recorded_input(case: Case, stroke: str, fine: Array, frames: Array) -> Array:
    """Recorded input, before noise. Magnitudes are errors of the reading, as of the cameras."""
    size = _Sizes(case)
    u = played(fine, case.mode, stroke, case.strokes[STROKES.index(stroke)])
    unit = 1e-3 if case.mode == "motion" else 1.0
    top = 10e-3 if case.mode == "motion" else 6.0
    gain = 1.0 + size("input_gain", "A")
    shown = u * (gain + size("input_gain", "B") * (0.8 + 0.2 * u / top))
    shown = shown + unit * size("input_offset", "A")
    shown = shown + unit * size("input_offset", "B") * (0.7 + 0.6 * fine / LENGTH)
    seen = np.interp(frames - size("input_delay", "A"), fine, shown)
    blur = size("input_delay", "B")
    if blur != 0.0:
        # A smear over twice the delay instead of a shift.
        moments = frames[:, None] - blur * np.linspace(0.0, 2.0, 21)[None, :]
        seen = seen + np.interp(moments, fine, shown).mean(axis=1) - np.interp(frames, fine, shown)
    return np.asarray(seen)


def record(
    case: Case,
    names: Sequence[str],
    result: Strokes,
    first: int,
    outside: Mapping[str, Any],
    *,
    ideal: bool = False,
) -> dict[str, dict[str, Array]]:
    """Sensors' view of the strokes of one case: {stroke: {finger, key, hammer}}.

    `first`: job of its first stroke. `ideal`: no noise and no steps of the digitizers.
    """
    fine = np.arange(result.key.shape[0], dtype=np.float64) * np.float64(KEEP * STEP)
    frames = np.arange(round(LENGTH / FRAME), dtype=np.float64) * np.float64(FRAME)
    views = {}
    for k, name in enumerate(names):
        rng = np.random.default_rng([*(case.seed or [0, 0]), 2, STROKES.index(name)])
        key, hammer = _cameras(case, result, first + k, fine, outside, rng)
        view = {
            "key": _expose(frames, fine, key, 0.0),
            "hammer": _expose(frames, fine, hammer, case.skew),
            "finger": recorded_input(case, name, fine, frames),
        }
        if not ideal:
            raw = view["finger"] + NOISE_INPUT[case.mode] * rng.standard_normal(frames.size)
            padded = np.pad(raw, 1, mode="edge")
            filtered = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
            view["finger"] = _coarse(filtered, RANGE_INPUT[case.mode] / 4096.0)
            for channel in ("key", "hammer"):
                noise = NOISE_CAMERA * _grain(frames.size, rng)
                view[channel] = _coarse(view[channel] + noise, PIXEL)
        views[name] = view
    return views


def shows(with_it: Mapping[str, Array], without: Mapping[str, Array]) -> float:
    """Time [s] from which ideal records of a stroke differ by an effect; NaN: never.

    By a tenth of the camera's noise and of their largest difference, in either camera.
    """
    apart = np.max([np.abs(with_it[c] - without[c]) for c in ("key", "hammer")], axis=0)
    there = np.flatnonzero(apart > 0.1 * max(NOISE_CAMERA, float(np.max(apart))))
    return float(there[0] * FRAME) if there.size else float("nan")


def onset(case: Case, result: Strokes, job: int, what: str) -> float:
    """Time [s] at which an effect first can act in a stroke; NaN: never."""
    key, hammer = result.key[:, job], result.hammer[:, job]
    k = STROKES.index(STROKES[job % len(STROKES)])
    conditions = {
        "start": np.ones(key.size, dtype=bool),
        "key": key > 3e-4,
        "bed": key > case.parameters["bed_position"][k],
        "string": hammer > 45e-3,
        "letoff": hammer > RATIO * key + 1e-3,
        "check": (key > 8.6e-3)
        & (hammer < case.parameters["check_position"][k])
        & (np.arange(key.size) > int(np.argmax(hammer))),
    }
    happened = np.flatnonzero(conditions[what])
    return float(happened[0] * KEEP * STEP) if happened.size else float("nan")
