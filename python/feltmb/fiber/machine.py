"""What a testing machine adds to a test: its frame yields, its load cell drifts and has a limit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.fiber.approach import LEAST, OFFSET, SURE, free_approach, scatter_of
from feltmb.fiber.columns import CompressionColumns, read_test
from unmodeled.data import ReadOptions
from unmodeled.errors import DataError, InvalidParameter

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

#: Range that counts as the largest force: multiples of the scatter, and share of the range.
LIMIT = 3.0, 1e-3
#: Displacement within it that is no peak, in those of a felt as stiff as below it.
FLAT = 4.0
#: Share of the force at whose lower half of samples the rounds of the drift begin.
EARLY = 0.1
#: Largest drift of a load cell, as a share of the range of the force.
MOST = 0.1
#: Rounds of the drift and the first contact, which depend on each other.
ROUNDS = 5
#: Standard error of a median over that of a mean.
MEDIAN = 1.25


def saturation(x: Array, force: Array, loading: NDArray[np.bool_]) -> str:
    """Fault of a force that stays at its largest value; empty if it does not.

    At a peak of a felt, the force falls with the displacement. At the limit of a load cell, it is
    the same on both sides of the peak, or up to the end of a test of loading only.

    Parameters
    ----------
    x, force
        Displacement [any unit] and force [its unit] of one cycle.
    loading
        Whether each sample is on its loading.
    """
    size, top = float(np.ptp(force)), float(np.max(force))
    levels = np.unique(np.round(force / max(1e-6 * size, 1e-300)))
    step = 1e-6 * size * float(np.min(np.diff(levels), initial=np.inf))  # that of a converter
    near = max(LIMIT[0] * scatter_of(force[loading]), LIMIT[1] * size, min(step, size))
    below = loading & (force < top - near) & (force > top - 0.2 * size - near)
    if below.sum() < 2 or size <= 0.0:
        return ""
    per_force = float(np.ptp(x[below])) / max(float(np.ptp(force[below])), near)
    at_top = force >= top - near
    sides = [x[at_top & side] for side in (loading, ~loading) if side.any()]
    if min(side.size for side in sides) < 2:
        return ""
    widths = [float(np.ptp(side)) for side in sides]
    if min(widths) <= FLAT * near * per_force:
        return ""
    return (
        f"the force stays at {top:.4g} while the displacement goes on by {max(widths):.3g}: the "
        "load cell is at its limit, and a law would end there; expected a force that grows up to "
        "the turn (less compression, or a larger load cell)"
    )


@dataclass(frozen=True)
class Drift:
    """Force of the free load cell along a test, beside that of its beginning."""

    force: Array
    """At each sample; 0 if the drift is within its error [that of the force]."""
    error: float
    """Standard error of the force of unloading relative to that of loading."""
    total: float
    """From the first to the last free part of the test; of loading only, to its end."""
    last: str = "the last one"
    """Where ``total`` ends."""

    @property
    def text(self) -> str:
        """What is subtracted."""
        return (
            f"the load cell drifts by {self.total:.3g} N from the first free part of the test to "
            f"{self.last}: this is subtracted, in proportion to the time between them"
        )


def drift_of(x: Array, force: Array, clock: Array, zero: float) -> Drift | None:
    """Drift of the load cell from the parts of a test that are free; None if there are not two.

    Parameters
    ----------
    x, force, clock
        Displacement, force and time of each sample, in the order of the test.
    zero
        Displacement at the first contact. Samples in the lower half of the way to it are free.
    """
    free = np.flatnonzero(x < 0.5 * (float(np.min(x)) + zero))
    parts = [p for p in np.split(free, np.flatnonzero(np.diff(free) > 1) + 1) if p.size >= LEAST]
    if len(parts) < 2:
        return None
    levels = np.array([float(np.median(force[p])) for p in parts])
    noise = max(scatter_of(force[p]) for p in parts)
    error = MEDIAN * noise * float(np.sqrt(1.0 / parts[0].size + 1.0 / parts[1].size))
    change = float(np.max(np.abs(levels - levels[0])))
    # About half of the time between two free parts is between loading and unloading.
    if change <= max(SURE * error, OFFSET * float(np.ptp(force))):
        return Drift(np.zeros_like(force), 0.5 * float(np.hypot(error, change)), 0.0)
    along = np.interp(clock, [float(np.mean(clock[p])) for p in parts], levels) - levels[0]
    return Drift(np.asarray(along), 0.5 * error, float(levels[-1] - levels[0]))


def drift_of_approach(x: Array, force: Array, clock: Array, zero: float | None) -> Drift | None:
    """Drift of the load cell from the slope of the free approach of a loading; None: it shows none.

    A curved approach is no drift, but the beginning of a soft contact.

    Parameters
    ----------
    x, force, clock
        Displacement, in ascending order, force and time of each sample.
    zero
        Displacement at the first contact; None: estimated.
    """
    early = np.flatnonzero(force < np.min(force) + EARLY * np.ptp(force))
    early = early[: max(LEAST, early.size // 2)]
    drift = np.polyfit(clock[early], force[early], 1)[0] * (clock - clock[0])
    for _ in range(ROUNDS):
        free = x < free_approach(x, force - drift, zero).zero
        count, t = int(np.sum(free)), clock[free]
        if count < 2 * LEAST or not np.ptp(t) > 0.0:
            return None
        t = (t - np.mean(t)) / np.std(t)
        terms = np.column_stack([np.ones(count), t, t**2 - 1.0])
        weights, *_ = np.linalg.lstsq(terms, force[free], rcond=None)
        per_time = 1.0 / float(np.std(clock[free]))
        drift = float(weights[1]) * per_time * (clock - clock[0])
    noise = max(float(np.std(force[free] - terms @ weights)), scatter_of(force))
    # A scatter of zero tells no error of the rounding.
    noise = max(noise, OFFSET * float(np.ptp(force)) / SURE)
    sd = noise * np.sqrt(np.diag(np.linalg.inv(terms.T @ terms)))
    if abs(weights[1]) <= SURE * sd[1] or abs(weights[2]) > SURE * sd[2]:
        return None
    if abs(drift[-1]) > MOST * float(np.ptp(force)):  # rather a soft contact
        return None
    error = float(sd[1]) * per_time * float(np.ptp(clock))
    return Drift(drift, error, float(drift[-1]), "its end, as in its approach")


def without_frame(
    table: CompressionColumns,
    frame: float | str | Path | None,
    *,
    thickness0: float | None,
    area: float | None,
    options: ReadOptions | None = None,
) -> CompressionColumns:
    """The test without the deflection of the frame of its machine.

    Parameters
    ----------
    table
        Columns of the test.
    frame
        Compliance [m/N], or the file of a blank record: displacement and force without a specimen.
    thickness0, area
        Thickness [m] and area [m^2] of the specimen, for strain and pressure.
    options
        Those of the test; the blank record has the same columns of displacement and force.

    Raises
    ------
    DataError
        The blank record does not reach the force of the test, or a number is missing.
    """
    if frame is None:
        return table
    faults = []
    if isinstance(frame, int | float) and not (np.isfinite(frame) and frame >= 0.0):
        faults.append(f"frame = {frame:g} m/N, expected a compliance >= 0, such as 0.1um/N")
    if table.compression == "v_f":
        faults.append("frame: the file has volume fractions, expected a displacement or thickness")
    if table.compression == "strain" and thickness0 is None:
        faults.append("frame: a strain needs the thickness of the felt (--thickness)")
    if table.load == "pressure" and area is None:
        faults.append("frame: a pressure needs the area of the sample (--area)")
    if faults:
        raise DataError("; ".join(faults))
    force = table.loads * (area if table.load == "pressure" and area else 1.0)
    if isinstance(frame, str | Path):
        moved = _by_blank(Path(frame), force, options or ReadOptions())
    else:
        moved = frame * force
    unit = {"strain": thickness0 or 1.0, "thickness": -1.0}.get(table.compression, 1.0)
    note = (
        f"the deflection of the frame, {1e3 * float(np.max(moved)):.3g} mm at the largest force, "
        "is subtracted"
    )
    return replace(table, x=table.x - moved / unit, notes=(*table.notes, note))


def _by_blank(path: Path, force: Array, options: ReadOptions) -> Array:
    """Deflection [m] of a frame at forces [N], from a record without a specimen."""
    from scipy.optimize import isotonic_regression

    quantities = ("displacement", "thickness"), ("force",)

    def own(given: Mapping[str, str]) -> dict[str, str]:
        return {q: text for q, text in given.items() if q in sum(quantities, ())}

    of_blank = ReadOptions(
        columns=own(options.columns),
        units=own(options.units),
        scales=own(options.scales),
        origins=own(options.origins),
    )
    try:
        blank = read_test(path, *quantities, options=of_blank)
    except DataError as error:
        raise InvalidParameter(f"frame: {error}") from None
    x = -blank.x if blank.compression == "thickness" else blank.x
    order = np.argsort(blank.loads, kind="stable")
    loads, x = blank.loads[order], np.asarray(isotonic_regression(x[order]).x)
    if float(loads[-1]) < 0.98 * float(np.max(force)):
        raise DataError(
            f"frame: {path}: the blank record goes to {loads[-1]:.4g} N, and the test to "
            f"{np.max(force):.4g} N; expected the same force at least"
        )
    return np.asarray(np.interp(force, loads, x) - np.interp(0.0, loads, x))
