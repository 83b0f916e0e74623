"""The report of a diagnosis as text: what the model misses, what explains it, what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence

from feltmb.diagnosis.result import Channel, Named, Reason, Result, Verdict

__all__ = ["statement", "text"]

#: Words of reasons that a user must know beside the verdict.
TOLD = {
    Reason.NOISE_NOT_STATED: "no noise of a sensor is stated, so that only the share of the motion "
    "counts",
    Reason.DIFFERS_BETWEEN_RECORDS: "a probable cause has another magnitude in each record, as an "
    "imitation of something that is not in the list has; it is not named",
    Reason.NO_HELD_OUT_GAIN: "the held-out records are not predicted better",
    Reason.NOT_COMPLETE: "the search ended at its limit of time",
    Reason.CALIBRATION_PREDICTS_WORSE: "the calibrated model predicts the held-out records worse "
    "than the tabulated one",
}


def digits(value: float, uncertainty: float) -> str:
    """A number with the digits that its uncertainty supports, two of the uncertainty."""
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return f"{value:.4g}"
    places = 1 - math.floor(math.log10(uncertainty))
    return f"{value:.{places}f}" if 0 <= places <= 12 else f"{round(value, places):.6g}"


def magnitude(n: Named) -> str:
    """Magnitude with its interval, in its unit."""
    half = 0.5 * (n.high - n.low)
    unit = "" if n.unit == "1" else f" {n.unit}"
    value, low, high = (digits(v, half) for v in (n.magnitude, n.low, n.high))
    return f"{value}{unit} ({low} to {high})"


def name(n: Named) -> str:
    """Name of a cause as the subject of a sentence."""
    return f"{n.cause} outside its tolerance" if n.parameter else n.cause


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %"


def _worst(channels: Sequence[Channel]) -> Channel:
    return max(channels, key=lambda c: c.calibrated / c.motion if c.motion > 0.0 else 0.0)


def statement(result: Result) -> str:
    """What the model misses, what explains it, and what remains, in one or two sentences."""
    c = _worst(result.channels)
    share = [v / c.motion if c.motion > 0.0 else math.nan for v in (c.calibrated, c.explained)]
    left = "" if math.isnan(c.noise) else f", {c.explained / c.noise:.2g} times the noise"
    misses = f"The model misses {_percent(share[0])} of the motion of {c.name}"
    if result.verdict is Verdict.NO_GAP:
        return f"{misses}{left}: there is no gap."
    if result.verdict is Verdict.CALIBRATED:
        return f"{misses} with fitted parameters{left}: no cause is missing."
    if result.verdict is Verdict.UNKNOWN:
        return f"{misses} with fitted parameters{left}. No cause of the list explains it."
    told = [f"{name(n)} of {magnitude(n)}" for n in result.named]
    told += [" or ".join(name(n) for n in group) for group in result.classes]
    return (
        f"{misses}. {' and '.join(told)} take{'s' if len(told) == 1 else ''} it to "
        f"{_percent(share[1])}{left}."
    )


def text(result: Result) -> str:
    """The report as plain text: statement, residuals, causes, parameters, sets."""
    lines = [statement(result), ""]
    lines += [f"Note: {TOLD[r]}." for r in result.reasons if r in TOLD]
    if result.held_out_gain is not None:
        value, low, high = (f"{100.0 * (1.0 - g):.0f}" for g in result.held_out_gain)
        lines.append(f"Held-out records: the residual shrinks by {value} % ({high} to {low} %).")
    for n in result.named:
        lines += ["", f"{name(n)} [{n.component}]: {magnitude(n)}, probability {n.probability:.2f}"]
        lines += [f"  {s}" for s in (n.mechanism, n.remedy) if s]
        if len(n.by_record) > 1:
            each = ", ".join(digits(v, 0.5 * (n.high - n.low)) for v in n.by_record)
            lines.append(f"  in each record: {each}")
    for group in result.classes:
        lines += ["", "One of these, which the records do not tell apart:"]
        lines += [f"  {name(n)}: {magnitude(n)}, probability {n.probability:.2f}" for n in group]
    lines += ["", "Residual (rms)        noise      tabulated  calibrated explained  of the motion"]
    lines += [
        f"  {f'{c.name} [{c.unit}]':20s}"
        + "".join(f"{v:<11.3g}" for v in (c.noise, c.tabulated, c.calibrated, c.explained))
        + (_percent(c.explained / c.motion) if c.motion > 0.0 else "")
        for c in result.channels
    ]
    moved = [p for p in result.parameters if p.sd > 0.0]
    if moved:
        lines += ["", "Parameters            tabulated  fitted     95 % interval"]
        for p in moved:
            half = 0.5 * (p.high - p.low)
            value, low, high = (digits(v, half) for v in (p.value, p.low, p.high))
            unit = "" if p.unit == "1" else f" [{p.unit}]"
            lines.append(f"  {p.name + unit:20s}{p.tabulated:<11.4g}{value:11s}{low} to {high}")
    return "\n".join(lines)
