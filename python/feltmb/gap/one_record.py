"""A sensor that differs in one record: a hint of where an unknown cause is.

Held-out records cannot confirm an error of a single record. It is therefore never named, but told
if it explains most of what the model does not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from feltmb.data import Array, Record
from feltmb.fit.model import Candidate, Effect, Model
from feltmb.fit.segmented_records import SegmentedRecord
from feltmb.fit.solve import FitSettings
from feltmb.gap.criteria import EXPLAINS_MOST, squares_of_noise
from feltmb.gap.findings import RecordError
from feltmb.gap.score import score_fit
from feltmb.gap.tabulated import outcome_at

__all__ = ["error_of_one_record"]


def error_of_one_record(
    model: Model,
    records: Sequence[SegmentedRecord],
    theta: Array,
    settings: FitSettings,
    alpha: float,
) -> RecordError | None:
    """The gain or offset of one sensor in one record that explains most of a misfit.

    It is a score test with parameters, start states and all other unknowns projected out. The
    result is None if nothing explains half of the excess of the sum of squares over noise, or if
    there are fewer than three records: of two records, either may be the wrong one.

    Parameters
    ----------
    model
        Model without effects.
    records
        All records, also the held-out ones.
    theta
        Fitted parameters, the point of the linear model.
    settings
        Settings of fits.
    alpha
        Rate of false alarms (``Options.alpha``).
    """
    names = dict.fromkeys(s.record.whole for s in records)
    if len(names) < 3:
        return None
    at = outcome_at(model, records, theta, settings).fit
    if not np.isfinite(at.cost):
        return None
    free = replace(at.problem, frozen=False)
    fit = replace(at, problem=free, point=replace(at.point, memo={}))
    seen = [
        (name, channel)
        for name in names
        for channel in model.outputs
        if any(s.record.whole == name and channel in s.record.outputs for s in records)
    ]
    outputs = list(model.outputs)
    rows = [(name, channel, kind) for name, channel in seen for kind in ("gain", "offset")]
    candidates = tuple(
        Candidate(
            Effect(
                name=f"{kind} of {channel} in {name}",
                component=f"sensor {channel}",
                kind="sensor",
                observe=_of_record(name, outputs.index(channel), kind),
                scale=1.0,
            )
        )
        for name, channel, kind in rows
    )
    scores = score_fit(fit, candidates)
    gains = scores.singles()
    best = int(np.argmax(gains))
    squares = scores.inflation * fit.dof
    if squares < squares_of_noise(alpha, fit.dof):
        return None
    if not gains[best] > EXPLAINS_MOST * (squares - fit.dof):
        return None
    record, channel, kind = rows[best]
    return RecordError(
        record=record,
        channel=channel,
        kind=kind,
        size=float(scores.one_step()[best]),
        unit=model.units.get(channel, "1") if kind == "offset" else "1",
        gain=0.5 * float(gains[best]),
    )


def _of_record(name: str, channel: int, kind: str) -> Callable[..., Array]:
    """Change of one channel in one record by a magnitude."""

    def observe(
        record: Record, values: Array, segments: Array, magnitudes: Array, shape: object
    ) -> Array:
        del segments, shape
        out = values.copy()
        if record.whole == name:
            size = magnitudes[:, None]
            y = values[:, :, channel]
            out[:, :, channel] = y * (1.0 + size) if kind == "gain" else y + size
        return out

    return observe
