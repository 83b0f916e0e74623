"""Values and series from a run."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import numpy.typing as npt

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.run.study.expression import Formula, NotThere
from feltmb.run.study.schema import NEED_LEVEL, Stat, When

if TYPE_CHECKING:
    from feltmb.mechanism import Action
    from feltmb.run.results import Run

Array = npt.NDArray[np.float64]

MOST_SAMPLES = 6000  # samples of a series for a figure


@checked
def extract_run(
    run: Run, action: Action, spec: Mapping[str, Any]
) -> tuple[dict[str, float], dict[str, Array]]:
    """Values and series of a run; those that the run does not have are absent.

    Parameters
    ----------
    spec
        ``numbers``: name -> entry of ``[numbers]``; ``series``: key -> output and window.
    """
    missing = [key for key in ("numbers", "series") if not isinstance(spec.get(key), Mapping)]
    if missing:
        raise InvalidParameter(f"extract_run: spec has no table {' and no '.join(missing)}")
    scalars: dict[str, float] = {k: float(v) for k, v in run.summary.items()}
    counts = ("steps", "rhs", "jacobians", "reversals", "wall")
    scalars.update({k: float(run.stats[k]) for k in counts if k in run.stats})
    if run.energy:
        scalars.update({k: float(v) for k, v in run.energy.items() if isinstance(v, float)})

    # Parts that are switched off have no output: a missing strap does not pull, a missing stop does
    # not move.
    still = {f"{name}.force" for name, strap in action.config.straps.items() if not strap.enabled}
    if action.config.string is not None and action.config.string.kind == "rigid_stop":
        still |= {"string.strike", "string.bridge_force"}

    def output(name: str, arguments: tuple[Any, ...] | None) -> Array | float:
        if arguments is not None:
            raise NotThere(name)
        if name == "time":
            return run.time
        if name in run:
            return run[name]
        if name in scalars:
            return scalars[name]
        if name in still:
            return np.zeros_like(run.time)
        raise NotThere(name)

    def scalar(name: str, arguments: tuple[Any, ...] | None) -> float:
        if arguments is None and name in scalars:
            return scalars[name]
        raise NotThere(name)

    def window(start: When | None, end: When | None) -> tuple[float, float]:
        low = run.time[0] if start is None else float(_when(start, scalar))
        high = run.time[-1] if end is None else float(_when(end, scalar))
        return float(low), float(high)

    def samples_of(text: str) -> Array:
        made = np.asarray(Formula(text)(output), dtype=float)
        return np.broadcast_to(made, run.time.shape)

    def number(entry: Mapping[str, Any]) -> float:
        if entry.get("value") is not None:
            return float(Formula(entry["value"])(scalar))
        low, high = window(entry.get("from"), entry.get("to"))
        chosen = (run.time >= low) & (run.time <= high)
        if np.count_nonzero(chosen) < 2:
            raise NotThere(entry["output"])
        samples = samples_of(entry["output"])[chosen]
        return statistic(entry["stat"], run.time[chosen], samples, entry.get("level"))

    # Values may depend on later ones in the file: repeat until no value is added.
    numbers: dict[str, float] = {}
    left = dict(spec["numbers"])
    for _ in spec["numbers"]:
        before = len(left)
        for name, entry in list(left.items()):
            try:
                value = number(entry)
            except NotThere:
                continue
            del left[name]
            if math.isfinite(value):
                numbers[name] = scalars[name] = value
        if len(left) == before:
            break
    series: dict[str, Array] = {}
    for key, entry in spec["series"].items():
        try:
            samples = samples_of(entry["output"])
            low, high = window(entry.get("from"), entry.get("to"))
        except NotThere:
            continue
        if entry.get("from_rest"):
            samples = samples - samples[0]
        chosen = (run.time >= low) & (run.time <= high)
        series[key] = _thin(np.stack([run.time[chosen], samples[chosen]]))
    return numbers, series


def _when(when: When, scalar: Any) -> float:
    return float(Formula(when)(scalar)) if isinstance(when, str) else float(when)


def _thin(pair: Array) -> Array:
    """At most MOST_SAMPLES samples; the minimum and maximum of each interval are kept."""
    count = pair.shape[1]
    if count <= MOST_SAMPLES:
        return np.ascontiguousarray(pair)
    edges = np.linspace(0, count, MOST_SAMPLES // 2 + 1).astype(int)
    keep: list[int] = []
    for a, b in itertools.pairwise(edges):
        low, high = a + int(np.argmin(pair[1, a:b])), a + int(np.argmax(pair[1, a:b]))
        keep += sorted({low, high})
    return np.ascontiguousarray(pair[:, keep])


@checked
def statistic(stat: str, time: Array, samples: Array, level: float | None = None) -> float:
    """One statistic of a series of samples.

    Parameters
    ----------
    stat
        ``first last min max mean span rms`` (span: maximum minus minimum; rms: about the mean);
        ``variation``: sum of all absolute changes; ``time_of_max time_of_min``;
        ``rises_above falls_below``: first time of crossing ``level``; ``time_above``: total time
        above ``level``; ``pulses``: number of intervals above ``level``, where gaps shorter than a
        hundredth of the series are ignored; ``settles``: time from which it stays within ``level``
        of its last value; ``returns``: time from which it stays within ``level`` of its first
        value; NaN if it does not at the end; ``swing_back``: maximum minus the smallest later
        value; ``frequency``: frequency of the largest spectral line with at least three periods
        [Hz].
    time, samples
        Times [s] and samples in any unit, shape (n,), n >= 2, evenly spaced.

    Returns
    -------
    float
        Value of the statistic; NaN if it does not exist.
    """
    if time.ndim != 1 or time.shape != samples.shape or time.size < 2:
        raise InvalidParameter(
            f"statistic: time of shape {time.shape} and samples of {samples.shape}, expected one "
            "shape (n,), n >= 2"
        )
    if stat not in get_args(Stat):
        raise InvalidParameter(f"statistic: {stat!r} is none of {', '.join(get_args(Stat))}")
    if stat in NEED_LEVEL and level is None:
        raise InvalidParameter(f"statistic: {stat} needs a level")
    simple: dict[str, Callable[[], Any]] = {
        "first": lambda: samples[0],
        "last": lambda: samples[-1],
        "min": lambda: np.min(samples),
        "max": lambda: np.max(samples),
        "mean": lambda: np.mean(samples),
        "span": lambda: np.ptp(samples),
        "rms": lambda: np.std(samples),
        "variation": lambda: np.sum(np.abs(np.diff(samples))),
        "time_of_max": lambda: time[np.argmax(samples)],
        "time_of_min": lambda: time[np.argmin(samples)],
        "swing_back": lambda: np.max(samples) - np.min(samples[np.argmax(samples) :]),
    }
    if stat in simple:
        return float(simple[stat]())
    if stat == "frequency":
        if np.ptp(samples) < 1e-9:  # rounding
            return math.nan
        swing = (samples - np.mean(samples)) * np.hanning(samples.size)
        count = 8 * samples.size
        power = np.abs(np.fft.rfft(swing, count))
        step = (time[-1] - time[0]) / (time.size - 1)
        lines = np.fft.rfftfreq(count, step)
        power[lines < 3.0 / (time[-1] - time[0])] = 0.0
        return float(lines[int(np.argmax(power))])
    assert level is not None
    if stat == "settles":
        outside = np.nonzero(np.abs(samples - samples[-1]) > level)[0]
        return float(time[0] if outside.size == 0 else time[min(outside[-1] + 1, time.size - 1)])
    if stat == "returns":
        away = np.nonzero(np.abs(samples - samples[0]) > level)[0]
        if away.size == 0:
            return float(time[0])
        return float(time[away[-1] + 1]) if away[-1] + 1 < time.size else math.nan
    above = samples > level
    if stat == "time_above":
        return float(np.count_nonzero(above) * (time[-1] - time[0]) / (time.size - 1))
    if stat == "pulses":
        times = time[np.nonzero(above)[0]]
        pause = 0.01 * (time[-1] - time[0])
        return float(np.count_nonzero(np.diff(times) > pause) + int(times.size > 0))
    wanted = above if stat == "rises_above" else samples < level
    found = np.nonzero(wanted)[0]
    return float(time[found[0]]) if found.size else math.nan
