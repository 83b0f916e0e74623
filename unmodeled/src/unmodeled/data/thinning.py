"""Records of many samples are thinned as far as their inputs and outputs permit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from unmodeled.data.records import Array, Record
from unmodeled.data.smoothing import noise_of_record

#: Number of samples of all records above which they are thinned: 0.4 GB in a diagnosis.
MOST_SAMPLES = 30_000
#: Largest rms of what a thinned output and input lose, as a share of their spread, if they have no
#: more noise. An input keeps its integral: a step of it moves by nothing, but becomes a ramp.
LOST, LOST_OF_INPUT = 0.01, 0.05
#: Variance of a sample less the line through two others with the same noise, over that of the
#: noise, as a mean over the places between these.
OF_LINE = 5.0 / 3.0


def thinned(
    records: Sequence[Record], outputs: Sequence[str]
) -> tuple[tuple[Record, ...], list[str]]:
    """Every n-th sample of long records, with inputs that keep their integral; notes about them.

    n is the smallest one for which all records have :data:`MOST_SAMPLES` together, or a smaller one
    if a line between the samples that stay would miss what moves in between by more than the noise
    and 1 % of the motion of an output, or 5 % of that of an input.

    Parameters
    ----------
    records
        Records.
    outputs
        Outputs that are compared.
    """
    total = sum(r.samples for r in records)
    wanted = math.ceil(total / MOST_SAMPLES)
    if wanted < 2:
        return tuple(records), []
    found, notes = [], []
    for record in records:
        step = wanted
        while step > 1 and not _follows(record, outputs, step):
            step //= 2
        found.append(_every(record, step) if step > 1 else record)
        if step > 1:
            notes.append(
                f"record {record.name}: every {step}th of {record.samples} samples is used, "
                "because a line between them shows all that moves; inputs are averaged"
            )
        if step < wanted and found[-1].samples > MOST_SAMPLES:
            notes.append(
                f"record {record.name}: {found[-1].samples} samples, which move too fast to be "
                "thinned further: memory and time grow with them; cut the record (first and last "
                "in the TOML)"
            )
    return tuple(found), notes


def _follows(record: Record, outputs: Sequence[str], step: int) -> bool:
    """Whether lines between every n-th sample show what moves."""
    at = np.arange(0, record.samples, step)
    signals = [(x, x[at], record.sensors[n].sigma, LOST) for n, x in record.outputs.items()
               if n in outputs]  # fmt: skip
    signals += [(u, _averaged(u, step)[at], None, LOST_OF_INPUT) for u in record.inputs.values()]
    for whole, kept, sigma, share in signals:
        lost = whole - np.interp(record.time, record.time[at], kept)
        lost = lost[: at[-1] + 1]
        lost = lost[np.isfinite(lost)]
        finite = whole[np.isfinite(whole)]
        noise = max(sigma or 0.0, noise_of_record(finite))
        bias = np.mean(lost**2) - OF_LINE * noise**2 if lost.size else 0.0
        if bias > max(noise, share * float(np.std(finite))) ** 2:
            return False
    return True


def _averaged(values: Array, step: int) -> Array:
    """Means with triangular weights: lines between every n-th have the integral of the signal."""
    weights = np.convolve(np.ones(step), np.ones(step)) / step**2
    out = np.convolve(values, weights, "same")
    out[:step], out[-step:] = values[:step], values[-step:]
    return out


def _every(record: Record, step: int) -> Record:
    at = slice(None, None, step)
    # The variance of the mean of independent samples with these weights.
    share = math.sqrt((2 * step**2 + 1) / (3 * step**3))
    colored = record.input_correlation_time
    return replace(
        record,
        time=record.time[at],
        inputs={n: _averaged(u, step)[at] for n, u in record.inputs.items()},
        outputs={n: x[at] for n, x in record.outputs.items()},
        input_sigma={n: s if colored.get(n) else s * share for n, s in record.input_sigma.items()},
    )
