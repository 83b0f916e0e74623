"""Records of a diagnosis, with the noise with which they are judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feltmb.data import Array, Record
from feltmb.data.smoothing import noise_in_difference, noise_of_record
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit.model import Model
from feltmb.fit.segmented_records import SegmentedRecord, segment_record
from feltmb.fit.solve import Fit, finish
from feltmb.gap.checks import (
    DataChecks,
    check_against,
    check_records,
    not_compared,
    with_sigma,
    without_constant,
    without_copies,
)
from feltmb.gap.criteria import GIVEN_SIGMA
from feltmb.gap.discrepancy import Discrepancy, with_color, with_factor, with_noise
from feltmb.gap.missing_rows import divided, with_parts
from feltmb.gap.overlay import wrong_clock
from feltmb.gap.split import split_records

__all__ = ["JudgedData", "judged_data", "prepare", "ready", "with_other_noise"]

#: Scatter of the samples of an input that may be noise of its sensor, as shares of its spread:
#: less is rounding, and more is an excitation that is random itself.
SCATTER = 2e-4, 0.1


@dataclass(frozen=True, eq=False)
class JudgedData:
    """Segmented records, and the data checks that gave their noise."""

    checks: DataChecks
    fitted: tuple[SegmentedRecord, ...]
    """Records to fit."""
    held: tuple[SegmentedRecord, ...]
    """Held-out records, which are used for the proof only."""

    def each(self, change: Callable[[SegmentedRecord], SegmentedRecord]) -> JudgedData:
        """The data with a change of every record."""
        return replace(
            self,
            fitted=tuple(change(s) for s in self.fitted),
            held=tuple(change(s) for s in self.held),
        )

    def colored(self, model: Model, color: Mapping[str, float]) -> JudgedData:
        """The data with noise that is correlated over these times [s], by output."""
        new = self.each(lambda s: with_color(model, s, dict(color)))
        return replace(new, checks=_with_color(self.checks, color))

    def noisier(self, model: Model, factor: Mapping[str, float]) -> JudgedData:
        """The data with these factors of the noise, by output."""
        new = self.each(lambda s: with_factor(model, s, dict(factor)))
        return replace(new, checks=_with_factor(self.checks, factor))

    def with_residual(self, model: Model, residual: Mapping[str, Discrepancy]) -> JudgedData:
        """The data with a residual that no effect explains as a part of the noise, by output."""
        return self.each(lambda s: with_noise(model, s, dict(residual)))

    def warned(self, warnings: Sequence[str]) -> JudgedData:
        """The data with further warnings, before those of its checks."""
        checks = replace(self.checks, warnings=(*warnings, *self.checks.warnings))
        return replace(self, checks=checks)


def judged_data(
    model: Model,
    records: Sequence[Record],
    hold_out: Sequence[str] | str | None,
    *,
    good_enough: Mapping[str, float],
    segment: float | None,
) -> tuple[Model, JudgedData, tuple[Record, ...]]:
    """Prepare the model, and check, split and segment its records.

    Parameters
    ----------
    model
        Model that is diagnosed.
    records
        Measured runs.
    hold_out
        Names of the held-out records; None: see :func:`~feltmb.gap.split.split_records`.
    good_enough
        Practical accuracy by output or unit [its unit], which is added to the noise.
    segment
        Length of a segment [s]; None: chosen from the records.

    Returns
    -------
    tuple
        The prepared model, the data, and the prepared records.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    named = [hold_out] if isinstance(hold_out, str) else hold_out
    model, records, whole, copies = ready(model, records, named or ())
    if named is not None:
        hold_out = with_parts(named, records)
    fitted, held = split_records(records, hold_out, masked=model.from_rest, left_out=copies)
    blocks = (*fitted, *held)
    checks = check_records(blocks, model.outputs)
    if checks.problems:
        raise DataError("records: " + "; ".join(checks.problems))
    checks = _inherit(checks, whole, blocks)
    checks = _floored(checks, good_enough, model)
    data = JudgedData(
        checks, prepare(model, fitted, checks, segment), prepare(model, held, checks, segment)
    )
    return model, data, tuple(records)


def ready(
    model: Model, records: Sequence[Record], hold_out: Sequence[str] = ()
) -> tuple[Model, tuple[Record, ...], DataChecks, tuple[str, ...]]:
    """Prepare the model and the records; also return the data checks and notes about copies.

    Records are divided at missing rows (:mod:`feltmb.gap.missing_rows`). ``hold_out``: names of
    records that are kept if they have a copy.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    records, copies = without_copies(records, hold_out)
    records, inputs = model.driven(divided(model, records))
    absent = not_compared(model, records)
    records, constant = without_constant(records, model.outputs)
    checks = check_against(model, records)
    # A simulation of a record with a wrong clock may not end.
    if wrong := wrong_clock(model, records):
        raise DataError(
            f"DATA PROBLEM: the unit of {wrong}. Specify the true unit: --unit time=UNIT, unit of "
            "the time in the TOML file; rates of a model are per second"
        )
    prepared = model.ready([with_sigma(r, checks.noise(r.name)) for r in records])
    # A model may increase the noise of a sensor to the error of its own outputs.
    sensors = {r.name: r.sensors for r in prepared.records}
    channels = [
        replace(c, sigma=max(c.sigma, sensors[c.record][c.channel].sigma or 0.0))
        for c in checks.channels
    ]
    noisy = _taken_as_exact(prepared.records) if prepared.model.states() else []
    warnings = (*copies, *inputs, *noisy, *absent, *constant, *checks.warnings, *prepared.notes)
    checks = replace(checks, channels=tuple(channels), warnings=warnings)
    return prepared.model, prepared.records, checks, copies


def _taken_as_exact(records: Sequence[Record]) -> list[str]:
    """Warnings about inputs whose noise is not given although their samples scatter."""
    found: dict[str, float] = {}
    for r in records:
        for name, value in r.inputs.items():
            noise = _scatter(value) if r.even else 0.0
            if noise > 0.0 and not r.input_sigma.get(name, 0.0) > 0.0:
                found[name] = max(found.get(name, 0.0), noise)
    return [
        f"{name} is taken as exact, but its samples scatter by {noise:.2g} (SI): if this is noise "
        f"of its sensor, specify it (sigma in [inputs.{name}], in Python input_sigma)"
        for name, noise in found.items()
    ]


def _scatter(value: Array) -> float:
    """Standard deviation of white noise in an input; 0 if it looks smooth, rounded, or random.

    White noise is the same in the fourth and in the sixth difference, a fast signal is not.
    """
    noise, spread = noise_of_record(value), float(np.std(value))
    steps = np.diff(np.unique(value))
    if not SCATTER[0] * spread < noise < SCATTER[1] * spread or noise < 0.5 * np.min(steps):
        return 0.0
    return noise if 0.8 < noise_in_difference(value, 6) / noise < 1.25 else 0.0


def prepare(
    model: Model, records: Sequence[Record], checks: DataChecks, segment: float | None
) -> tuple[SegmentedRecord, ...]:
    """Cut records into segments, with the noise of the data checks."""
    return tuple(segment_record(model, r, checks.noise(r.name), segment) for r in records)


def _inherit(checks: DataChecks, whole: DataChecks, blocks: Sequence[Record]) -> DataChecks:
    """Blocks of a record inherit the noise that was found for the whole record."""
    by_name = {(c.record, c.channel): c for c in whole.channels}
    # A record may have the name of a part of another one.
    base = {
        block.name: max((n for n in whole.records if block.part_of(n)), key=len) for block in blocks
    }
    channels = []
    for c in checks.channels:
        parent = by_name[base[c.record], c.channel]
        channels.append(
            replace(
                c,
                sigma=parent.sigma,
                method=parent.method,
                correlation_time=parent.correlation_time,
                averaged=parent.averaged,
                quantum=parent.quantum,
                white=parent.white,
                relative=parent.relative,
            )
        )
    return replace(whole, channels=tuple(channels))


def _floored(checks: DataChecks, floors: Mapping[str, float], model: Model) -> DataChecks:
    """The data checks with the practical accuracy added to the noise of some channels."""
    if not floors:
        return checks
    units = {c.unit for c in checks.channels}
    unknown = [n for n in floors if n not in model.outputs and n not in units]
    if unknown:
        raise InvalidParameter(
            f"good_enough: got {', '.join(unknown)}, expected an output "
            f"({', '.join(model.outputs)}) or a unit of one ({', '.join(sorted(units))})"
        )
    channels = []
    for c in checks.channels:
        floor = floors.get(c.channel, floors.get(c.unit, 0.0))
        channels.append(replace(c, sigma=math.hypot(c.sigma, floor)))
    return replace(checks, channels=tuple(channels))


def _with_factor(checks: DataChecks, factor: Mapping[str, float]) -> DataChecks:
    """The data checks with larger noise of some channels, and warnings about it."""
    channels = tuple(
        c.with_noise_times(factor[c.channel]) if c.channel in factor else c for c in checks.channels
    )
    given = {c.channel for c in checks.channels if c.method == "sensor"}
    known = f"given noise (assumed accurate to {GIVEN_SIGMA:.0%})"
    warnings = tuple(
        f"{name}: neighboring samples differ by {f:.3g} times the "
        f"{known if name in given else 'estimated noise'}; the larger noise is used"
        for name, f in factor.items()
    )
    return replace(checks, channels=channels, warnings=(*checks.warnings, *warnings))


def _with_color(checks: DataChecks, color: Mapping[str, float]) -> DataChecks:
    """The data checks with correlated noise of some channels, and warnings about it."""
    channels = tuple(
        replace(c, correlation_time=color[c.channel]) if c.channel in color else c
        for c in checks.channels
    )
    warnings = tuple(
        f"{name}: the residual of the model is no larger than the noise of its sensor, but it is "
        f"correlated over {time:.3g} s, and no force or effect explains this as well. "
        "It is treated as noise; if this is correct, specify its correlation_time"
        for name, time in color.items()
    )
    return replace(checks, channels=channels, warnings=(*checks.warnings, *warnings))


def with_other_noise(fit: Fit, sensed: tuple[SegmentedRecord, ...]) -> Fit:
    """Evaluate a fit, unchanged, with another noise."""
    if fit.problem.segmented_records is sensed:
        return fit
    problem = replace(fit.problem, segmented_records=sensed)
    return finish(problem, replace(fit.point, memo={}), fit.level, fit.defect_sd)
