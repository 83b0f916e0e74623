"""Contact law from a measured loop: force against compression, without the fibers of the felt.

Both branches are fitted by curves that never fall. Together they are the envelope of the law with
memory. The law is then driven along the whole test, inner loops included. The length of its
transition from loading to unloading is that with the smallest difference from the test.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.contact import Law
from feltmb.felt.envelopes import FeltEnvelope, FeltLaw
from feltmb.felt.loop_uncertainty import (
    SAME_SPEED,
    CycleLoss,
    Cycles,
    LoopUncertainty,
    complete_cycles,
    envelope_errors,
    loop_uncertainty,
    offset_error,
)
from feltmb.felt.monotone import LOWEST, MonotoneCurve, monotone_curve
from feltmb.felt.transition import transition_uncertainty
from feltmb.fiber.approach import LEAST, TOUCH, free_approach, scatter_of, smooth_zero
from feltmb.fiber.columns import read_test
from feltmb.fiber.cycles import Branches, find_branches
from feltmb.fiber.machine import Drift, drift_of, drift_of_approach, saturation, without_frame
from unmodeled.arguments import checked
from unmodeled.data import ReadOptions
from unmodeled.errors import DataError, InvalidParameter

Array = NDArray[np.float64]

#: First force that counts as a preload: multiples of the scatter of the force.
PRELOAD = 5.0
#: The compression that a preloaded test lacks is estimated up to this multiple of its first force,
#: and at most this multiple of the compression there.
BEGINNING, FARTHEST = 3.0, 20.0
#: Range of the transition length of the law, and its wiping out of inner loops (docs: model.md).
KAPPA, WIPING_OUT = (0.002, 1.0), 0.2
#: Exponent of the share of the compression with which unloading is raised to meet loading.
MEETING = 8


@checked
@dataclass(frozen=True)
class MeasuredLoop:
    """A measured loop of a contact and its law."""

    compression: Array
    """Compression of each sample [m], in the order of the test; 0 at the first contact."""
    force: Array
    """Force of each sample [N], compression positive, without the force of the free approach."""
    zero: float
    """Displacement at the first contact [m], as in the test."""
    branches: Branches
    """Samples of loading, unloading and holds."""
    envelope: FeltEnvelope
    """Both branches as a table, for a mechanism file."""
    uncertainty: LoopUncertainty
    """Standard uncertainties of the envelope, the loss and the zero."""
    notes: tuple[str, ...]
    """Sentences about samples that are left out, and about the zero."""
    cycles: tuple[CycleLoss, ...] = ()
    """Loss of each cycle; the loop is the one with the number ``branches.chosen``."""
    zero_interval: tuple[float, float] | None = None
    """Interval of 95 % of the first contact, whatever the shape of the toe [m]; None: it is
    given."""
    by_thickness: bool = False
    """Whether the displacement is minus a thickness."""

    @property
    def memory(self) -> Mapping[str, float]:
        """Numbers of the memory that follow the test better than the defaults of the law.

        They are ``kappa`` and ``wiping_out``.
        """
        return self.envelope.memory

    @cached_property
    def by_law(self) -> Array:
        """Force of the law with memory over the compression of the test [N]."""
        return _by_law(self.envelope, self.compression)

    def law(self, **options: float) -> Law:
        """Law with memory whose envelope is this loop.

        Parameters
        ----------
        options
            ``kappa``, ``recovery_time`` and the other numbers of ``memory`` in a mechanism file, in
            place of those that follow the test best.
        """
        return Law(self.envelope.law(**options))

    @property
    def rms(self) -> float:
        """Root mean square of the difference of law and test, without holds [N]."""
        return _rms(self.envelope, self.compression, self.force, self.branches)

    @property
    def loss(self) -> float:
        """Share of the loading work that the samples lose where both branches have samples [-]."""
        return next((c.loss for c in self.cycles if c.number == self.branches.chosen), math.nan)

    @property
    def loss_factor(self) -> float:
        """Loss factor (tan delta) of a linear solid with the same loss in the same cycle [1].

        The cycle goes from zero to its largest compression and back, about half of it.
        """
        return 4.0 * self.loss / (math.pi * (2.0 - self.loss))

    def kawabata(self, area: float) -> dict[str, float]:
        """Values of the compression test of Kawabata's system (KES-FB3).

        Parameters
        ----------
        area
            Area of the sample [m^2].

        Returns
        -------
        dict
            ``WC``, work of compression [J/m^2]; ``LC``, its ratio to that of a linear law [1];
            ``RC``, share of the work that comes back [1]; ``pressure``, the largest one [Pa]: KES
            ends at 50 gf/cm^2, and its values are for tests that end there.

        Raises
        ------
        InvalidParameter
            The area is not a positive number.
        """
        if not (math.isfinite(area) and area > 0.0):
            raise InvalidParameter(f"kawabata: area = {area:g} m^2, must be finite and > 0")
        made = self.envelope
        work = float(np.trapezoid(made.loading, made.compression)) / area
        pressure = float(made.loading[-1]) / area
        linear = 0.5 * pressure * made.closing
        return {"WC": work, "LC": work / linear, "RC": 1.0 - self.loss, "pressure": pressure}


@checked
def read_measured_loop(
    path: str | Path,
    *,
    zero: float | None = None,
    cycle: int | None = None,
    points: int = 193,
    thickness0: float | None = None,
    area: float | None = None,
    specimen: str = "",
    frame: float | str | Path | None = None,
    loss: float | None = None,
    law: FeltLaw = "felt_memory",
    options: ReadOptions | None = None,
) -> MeasuredLoop:
    """Contact law from a file with compression and force of a pair.

    A column that is called compression and starts at zero is not shifted.

    Parameters
    ----------
    path
        CSV file with the columns ``displacement [mm]`` (or ``thickness [mm]``, or ``strain [%]``)
        and ``force [N]`` (or ``pressure [kPa]``), as for :func:`feltmb.fiber.read_compression`.
    zero, cycle, points
        As in :func:`measured_loop`; ``zero`` is a thickness in a test by thickness.
    thickness0, area
        Thickness without load [m] and area [m^2], for a column of strain or pressure.
    specimen
        Which one of several specimens.
    frame
        Compliance of the frame of the machine [m/N], or the file of a record without a specimen.
    loss, law
        As in :func:`measured_loop`.
    options
        Columns and units of the quantities.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message.
    """
    test = read_specimen(
        path,
        zero=zero,
        thickness0=thickness0,
        area=area,
        specimen=specimen,
        frame=frame,
        options=options,
    )
    try:
        found = _measured_loop(
            test.displacement,
            test.force,
            time=test.time,
            zero=test.zero,
            cycle=cycle,
            loss=loss,
            points=points,
            name=test.name,
            law=law,
            by_thickness=test.by_thickness,
        )
    except InvalidParameter as error:
        raise DataError(f"{path}: {error}") from None
    return replace(found, notes=(*test.notes, *found.notes))


@checked
@dataclass(frozen=True)
class Specimen:
    """A compression test of a pair in the order of its samples."""

    name: str
    displacement: Array
    """Displacement, compression positive [m]; minus the thickness in a test by thickness."""
    force: Array
    """Force, compression positive [N]."""
    time: Array | None = None
    """Time [s]; None if it is not known."""
    zero: float | None = None
    """Displacement at the first contact [m]; None: estimated."""
    by_thickness: bool = False
    notes: tuple[str, ...] = ()


@checked
def read_specimen(
    path: str | Path,
    *,
    zero: float | None = None,
    thickness0: float | None = None,
    area: float | None = None,
    specimen: str = "",
    frame: float | str | Path | None = None,
    options: ReadOptions | None = None,
) -> Specimen:
    """Read a test of a pair of any kind: loading only, cycles, holds.

    Parameters
    ----------
    path, zero, thickness0, area, specimen, frame, options
        As in :func:`read_measured_loop`.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message.
    """
    file = Path(path)
    table = read_test(
        file,
        ("displacement", "thickness", "strain"),
        ("force", "pressure"),
        options=options,
        specimen=specimen,
    )
    lacking = [
        f"{quantity} without {what}, expected {option}"
        for quantity, number, what, option in (
            ("strain", thickness0, "the thickness of the felt", "thickness0 (--thickness)"),
            ("pressure", area, "the area of the sample", "area (--area)"),
        )
        if quantity in (table.compression, table.load) and number is None
    ]
    if lacking:
        raise DataError(f"{file}: {'; '.join(lacking)}")
    try:
        table = without_frame(table, frame, thickness0=thickness0, area=area, options=options)
    except DataError as error:
        raise DataError(f"{file}: {error}") from None
    by_thickness = table.compression == "thickness"
    if by_thickness and table.x.min() <= 0.0:
        raise DataError(f"{file}: thickness down to {table.x.min():.4g} m, expected > 0")
    sign = -1.0 if by_thickness else 1.0
    if table.from_contact and zero is None:
        zero = 0.0
    order = _order(sign * table.x, table.branches)
    x, force = table.x[order], table.loads[order]
    in_order = bool(np.all(np.diff(order) > 0))
    return Specimen(
        file.stem,
        sign * (x * thickness0 if table.compression == "strain" and thickness0 else x),
        force * area if table.load == "pressure" and area else force,
        table.time if in_order else None,
        None if zero is None else sign * zero,
        by_thickness,
        table.notes,
    )


def _order(x: Array, branches: list[str]) -> NDArray[np.intp]:
    """Samples in the order of the test; a file may list unloading with rising compression."""
    rows = np.arange(x.size)
    back = np.array([word == "unloading" for word in branches], dtype=bool)
    if back.sum() < 2 or np.sum(np.diff(x[back])) <= 0.0:
        return rows
    sides = rows[~back], rows[back]
    return np.concatenate([sides[0][np.argsort(x[~back])], sides[1][np.argsort(-x[back])]])


@checked
def measured_loop(
    displacement: Array,
    force: Array,
    *,
    time: Array | None = None,
    zero: float | None = None,
    cycle: int | None = None,
    loss: float | None = None,
    points: int = 193,
    name: str = "loop",
    law: FeltLaw = "felt_memory",
) -> MeasuredLoop:
    """Contact law from a measured loop of displacement and force.

    Each branch gets the monotone curve with the least squares over at most 40 knots. Below its
    lowest sample it continues as a power of the compression, with a note. The force of a free
    approach is subtracted, with a note. Unloading is raised by its distance to loading at the end
    times (e / e_end)^8, so that the branches meet there, and its share of loading is the nearest
    one that never decreases, as the law with memory requires. The transition of the law (``kappa``,
    and ``wiping_out`` = 0 or 0.2) is fitted to the whole test.

    Of several cycles, the loop is one: its loading with the unloading after it. The law is compared
    with the whole test. The scatter of the complete cycles is the uncertainty of the forces.

    Parameters
    ----------
    displacement
        Displacement in the order of the test [m], compression positive, (n,).
    force
        Force [N], compression positive, (n,).
    time
        Time of each sample [s], (n,), for the speeds of the cycles and the drift of the load cell.
    zero
        Displacement at the first contact [m]; default: the beginning of a smooth toe of the first
        loading (of ``cycle``, if it is given).
    cycle
        Number of the cycle that is the loop, from 1; default: the first complete one.
    loss
        Share of the loading work that is lost [1], for a test of loading only. Its unloading is
        then loading times a power of the compression, an assumption.
    points
        Number of rows of the table, at least 5; the rows are denser at small compression.
    name
        Name of the envelope.
    law
        Law that gets the loop and whose transition is fitted.

    Raises
    ------
    InvalidParameter
        The arrays are no loop, or an argument is out of range; all faults are in the message.
    """
    return _measured_loop(
        displacement, force, time=time, zero=zero, cycle=cycle, loss=loss, points=points,
        name=name, law=law, by_thickness=False,
    )  # fmt: skip


def _first_loading(branches: Branches, loading: NDArray[np.intp]) -> NDArray[np.intp]:
    """Samples of the loading that touched the felt for the first time."""
    if 1 not in branches.loops:
        return loading
    start, top, _ = branches.loops[1]
    first = np.setdiff1d(np.arange(start, top + 1), branches.held)
    return first if first.size >= LEAST else loading


def _refuse(faults: Iterable[str]) -> None:
    if found := "; ".join(faults):
        raise InvalidParameter(f"measured_loop: {found}")


def _sample_faults(x: Array, f: Array) -> Iterator[str]:
    """Why displacements and forces are no loop."""
    if x.ndim != 1 or x.shape != f.shape or x.size < 2 * LEAST:
        yield (
            f"displacement {x.shape} and force {f.shape}, expected arrays of equal length, at "
            f"least {2 * LEAST} samples"
        )
    elif not (np.all(np.isfinite(x)) and np.all(np.isfinite(f)) and np.ptp(x) > 0.0):
        yield "displacement and force, expected finite numbers that change"
    elif not np.max(f) > max(0.0, -np.min(f)):
        ends = f"{np.min(f):.4g} to {np.max(f):.4g}"
        yield f"force from {ends} N, expected compression to be positive"


def _argument_faults(x: Array, clock: Array, points: int, loss: float | None) -> Iterator[str]:
    if points < 5:
        yield f"points = {points}, must be >= 5"
    if clock.shape != x.shape or not np.all(np.diff(clock) >= 0.0):
        yield f"time {clock.shape}, expected one that runs on, as long as displacement"
    if loss is not None and not 0.0 <= loss < 1.0:
        yield f"loss = {loss:g}, must be >= 0 and < 1"


def _side_faults(sides: Mapping[str, NDArray[np.intp]]) -> list[str]:
    faults = [
        f"{at.size} samples of {side}, expected at least {LEAST}"
        for side, at in sides.items()
        if at.size < LEAST
    ]
    if faults and sides["loading"].size >= LEAST:
        faults.append("of a test of loading only, give the loss (loss, --loss 30%; 0: elastic)")
    return faults


def _faults_beyond(e: Array, sides: Mapping[str, NDArray[np.intp]], zero: float) -> Iterator[str]:
    for side, at in sides.items():
        if (number := int(np.sum(e[at] > 0.0))) < LEAST:
            yield (
                f"zero = {zero:.6g} m: {number} samples of {side} beyond it, expected at least "
                f"{LEAST}"
            )


def _zero_faults(x: Array, zero: float | None) -> Iterator[str]:
    least, most = float(np.min(x)), float(np.max(x))
    if zero is not None and not 2.0 * least - most <= zero < most:
        yield (
            f"zero = {zero:.6g} m, expected less than the largest displacement, near those of the "
            f"test: {least:.6g} to {most:.6g} m"
        )


def _measured_loop(
    displacement: Array,
    force: Array,
    *,
    time: Array | None,
    zero: float | None,
    cycle: int | None,
    loss: float | None,
    points: int,
    name: str,
    law: FeltLaw,
    by_thickness: bool,
) -> MeasuredLoop:
    """As :func:`measured_loop`; by thickness, the displacement is minus the thickness."""
    x, f = np.asarray(displacement, dtype=float), np.asarray(force, dtype=float)
    clock = np.arange(x.size, dtype=float) if time is None else np.asarray(time, dtype=float)
    _refuse([*_sample_faults(x, f), *_argument_faults(x, clock, points, loss)])
    approach = None
    if loss is not None:
        x, f, clock, approach = _with_unloading(x, f, clock, loss, zero)
    try:
        branches = find_branches(x, cycle)
    except InvalidParameter as error:
        raise InvalidParameter(f"measured_loop: {error}") from None
    loading, unloading = (branches.kept[s] for s in (branches.loading, ~branches.loading))
    sides = {"loading": loading, "unloading": unloading}
    _refuse([*_side_faults(sides), *_zero_faults(x, zero)])
    limit = saturation(x[branches.kept], f[branches.kept], branches.loading)
    _refuse([limit] if limit else [])
    given = zero is not None
    first = loading if cycle is not None else _first_loading(branches, loading)
    contact = free_approach(x[first], f[first], zero)
    zero, offset = contact.zero, contact.level
    drift = drift_of(x, f, clock, zero)
    e, f = x - zero, f - offset - (0.0 if drift is None else drift.force)
    _refuse(_faults_beyond(e, sides, zero))
    end = float(np.max(e))
    grid = end * np.linspace(0.0, 1.0, points) ** 2
    back = unloading
    if not branches.held.size:  # the turn belongs to both branches
        back = np.union1d(unloading, np.max(loading[loading < np.min(unloading)], initial=0))
    curves = monotone_curve(e[loading], f[loading], end), monotone_curve(e[back], f[back], end)
    meeting = (grid / end) ** MEETING

    load = curves[0].at(grid)
    made = _envelope(grid, load, curves[1].at(grid), meeting, name)
    made = replace(made, law_name=law)
    made = replace(made, memory=_memory(made, e, f, branches))
    unsure = offset_error(curves[0]) if offset else 0.0, drift.error if drift else 0.0
    cycles = complete_cycles(
        e, f, branches, grid, load, time=None if time is None else clock, drift=unsure[1]
    )
    sure = loop_uncertainty(
        grid, made.loading, made.unloading, curves, meeting, cycles, zero=contact.sd, offset=unsure
    )
    if "kappa" in made.memory:
        errors = envelope_errors(grid, curves, meeting, unsure)
        sure = replace(
            sure, kappa=_unsure_kappa(made, meeting, e, f, branches, cycles, errors, curves)
        )
    found = MeasuredLoop(
        e, f, zero, branches, made, sure, (), cycles.losses, by_thickness=by_thickness
    )
    if not given:
        found = replace(found, zero_interval=(contact.low, contact.high))
    notes = [*_notes(found, given=given), *_assumptions(curves, offset, loss)]
    if loss is not None:
        sure = replace(found.uncertainty, loss=0.0, unloading=found.uncertainty.loading)
        found = replace(found, uncertainty=sure)
    notes += [part.text for part in (drift, approach) if part and part.total]
    return replace(found, notes=tuple(notes))


def _assumptions(
    curves: Sequence[MonotoneCurve], offset: float, loss: float | None
) -> Iterator[str]:
    """What a loop has that was not measured."""
    for side, curve in zip(("loading", "unloading"), curves, strict=True):
        if curve.low:
            yield (
                f"{side} has no samples below {1e3 * curve.low:.4g} mm of compression: it "
                "continues there as a power of the compression"
            )
    if offset:
        yield f"the force of the free approach, {offset:.4g} N, is subtracted"
    if loss is not None:
        yield (
            f"loading only: the loss of {100 * loss:.3g} % is an assumption, and so is unloading, "
            "loading times a power of the compression"
        )


def _with_unloading(
    x: Array, f: Array, clock: Array, loss: float, zero: float | None
) -> tuple[Array, Array, Array, Drift | None]:
    """Displacement, force and time of loading, and of an unloading with this loss; the drift."""
    from scipy.optimize import brentq

    branches = find_branches(x)
    at = branches.kept[branches.loading]
    if branches.kept.size - at.size >= LEAST:
        _refuse(["loss: the test has unloading, and with it a loss"])
    if at.size < LEAST:
        _refuse([f"{at.size} samples of loading, expected at least {LEAST}"])
    at = at[np.argsort(x[at], kind="stable")]
    x, f, clock = x[at], f[at], clock[np.sort(at)]
    limit = saturation(x, f, np.ones(x.size, dtype=bool))
    _refuse([limit] if limit else [])
    drift = drift_of_approach(x, f, clock, zero)
    f = f if drift is None else f - drift.force
    contact = free_approach(x, f, zero)
    share = np.maximum(x - contact.zero, 0.0) / (float(np.max(x)) - contact.zero)
    felt = f - contact.level
    work = float(np.trapezoid(np.where(share > 0.0, felt, 0.0), x))

    def lost(power: float) -> float:
        return 1.0 - float(np.trapezoid(felt * share**power * (share > 0.0), x)) / work

    power = brentq(lambda p: lost(p) - loss, 0.0, 200.0) if loss else 0.0
    back = (contact.level + np.where(share > 0.0, felt * share**power, felt))[-2::-1]
    later = clock[-1] + (clock[-1] - clock[-2::-1])
    return np.r_[x, x[-2::-1]], np.r_[f, back], np.r_[clock, later], drift


def _envelope(grid: Array, load: Array, back: Array, meeting: Array, name: str) -> FeltEnvelope:
    """Envelope of two branches: unloading meets loading, and its share of it never decreases."""
    from scipy.optimize import isotonic_regression

    back = np.minimum(back + (load[-1] - back[-1]) * meeting, load)
    share = np.divide(back, load, out=np.zeros_like(back), where=load > 0.0)
    back = isotonic_regression(share, weights=load**2 + 1e-12 * load[-1] ** 2).x * load
    made = FeltEnvelope(grid, load, back, name, f"measured loop {name}")
    try:
        _ = made.core
    except InvalidParameter as error:
        raise InvalidParameter(f"measured_loop: {error}") from None
    return made


def _by_law(made: FeltEnvelope, e: Array) -> Array:
    """Force of the law with memory along a test [N]."""
    time = 1e-3 * np.arange(e.size)  # the law does not depend on the rate
    return Law(made.law()).path(np.maximum(e, 0.0), time)


def _rms(made: FeltEnvelope, e: Array, force: Array, branches: Branches) -> float:
    """Root mean square of the difference of law and test, without holds [N]."""
    kept = np.ones(force.size, dtype=bool)
    kept[branches.held] = False
    return float(np.sqrt(np.mean((_by_law(made, e) - force)[kept] ** 2)))


def _memory(made: FeltEnvelope, e: Array, force: Array, branches: Branches) -> dict[str, float]:
    """Numbers of the memory with the least difference of law and test, if they are worth it.

    Each number must improve the fit by more than its cost in the Bayesian information criterion.
    Otherwise the law keeps its default.
    """
    from scipy.optimize import minimize_scalar

    samples = force.size - branches.held.size
    core = made.core  # the numbers of the memory leave the envelope as it is

    def criterion(numbers: Mapping[str, float]) -> float:
        squares = _rms(replace(made, memory=numbers, made=core), e, force, branches) ** 2
        return samples * math.log(max(squares, 1e-300)) + len(numbers) * math.log(samples)

    options: list[dict[str, float]] = [{}]
    own: list[dict[str, float]] = [{}]
    if made.law_name == "felt_memory":  # the other law wipes out whatever was passed
        own.append({"wiping_out": WIPING_OUT})
    for wiping in own:
        at = minimize_scalar(
            lambda x, wiping=wiping: criterion({"kappa": math.exp(x), **wiping}),
            bounds=np.log(KAPPA),
            method="bounded",
            options={"xatol": 0.002},
        )
        options.append({"kappa": float(f"{math.exp(at.x):.4g}"), **wiping})
    return min(options, key=criterion)


def _unsure_kappa(
    made: FeltEnvelope,
    meeting: Array,
    e: Array,
    force: Array,
    branches: Branches,
    cycles: Cycles,
    errors: tuple[Array, Array],
    curves: tuple[MonotoneCurve, MonotoneCurve],
) -> float:
    """Standard uncertainty of ``kappa`` [1]; NaN if the test does not determine it."""
    kappa = made.memory["kappa"]
    if _at_limit(kappa):
        return math.nan

    def by_law(value: float, up: Array, down: Array) -> Array:
        load = np.maximum.accumulate(np.maximum(made.loading + up, 0.0))
        other = _envelope(made.compression, load, made.unloading + down, meeting, made.name)
        own = {**made.memory, "kappa": value}
        return _by_law(replace(other, law_name=made.law_name, memory=own), e)

    rest = force - _by_law(made, e)
    moved = [
        branch - curve.at(made.compression)
        for branch, curve in zip((made.loading, made.unloading), curves, strict=True)
    ]
    up, down = (np.column_stack(pair) for pair in zip(errors, moved, strict=True))
    correlation = float(np.mean([curve.scatter[1] for curve in curves]))
    return kappa * transition_uncertainty(
        by_law,
        kappa,
        made.compression,
        (made.loading, made.unloading),
        rest,
        (up, down),
        cycles,
        branches,
        correlation,
    )


def _at_limit(kappa: float) -> bool:
    """Whether a transition length is at the limit of its range."""
    return kappa < 1.1 * KAPPA[0] or kappa > KAPPA[1] / 1.1


def _notes(found: MeasuredLoop, *, given: bool) -> list[str]:
    """Sentences about the samples. ``given``: whether the zero was."""
    e, force, branches = found.compression, found.force, found.branches
    notes = []
    preload = _preload(found, given=given)
    if preload is not None:
        notes.append(preload)
    if found.loss < 0.0:
        notes.append(
            f"unloading lies above loading (loss {100 * found.loss:.3g} %), and the law has no "
            "loss there: check the order of the samples and the clocks of both columns"
        )
    kappa = found.memory.get("kappa", math.nan)
    if _at_limit(kappa):
        notes.append(
            f"kappa = {kappa:.3g} is at the limit of its range, {KAPPA[0]} to {KAPPA[1]}: the "
            "samples do not show the transition from loading to unloading"
        )
    left_out = e.size - np.union1d(branches.kept, branches.held).size
    if left_out:
        notes.append(
            f"{branches.cycles} loadings: the loop is cycle {branches.chosen}, its loading with "
            f"the unloading after it (another one: cycle, --cycle); {left_out} samples of the "
            "other cycles are compared with the law"
            + (", and give the uncertainty" if found.uncertainty.cycles > 1 else " only")
        )
        before = e[branches.loops[branches.chosen][0]] if branches.chosen in branches.loops else 0.0
        earlier = max((c.top for c in found.cycles if c.number < branches.chosen), default=0.0)
        if earlier > max(before, 0.0):
            notes.append(
                f"earlier cycles went to {1e3 * earlier:.4g} mm: up to there, the loading of the "
                "loop is that of a felt which was compressed before"
            )
    speeds = {c.number: c.speed for c in found.cycles if c.speed > 0.0}
    if speeds and max(speeds.values()) > SAME_SPEED * min(speeds.values()):
        own = speeds.get(branches.chosen, math.nan)
        notes.append(
            f"the cycles have speeds of {1e3 * min(speeds.values()):.3g} to "
            f"{1e3 * max(speeds.values()):.3g} mm/s, and the law does not depend on the rate: it "
            f"is that of cycle {branches.chosen} at {1e3 * own:.3g} mm/s. Compare the losses of "
            "the cycles; only those of about the same speed count as repetitions"
        )
    if branches.holds:
        first, last = max(branches.holds, key=lambda hold: force[hold[0]])
        notes.append(
            f"{branches.held.size} samples of holds are left out; in the one under the largest "
            f"load, the force goes from {force[first]:.4g} to {force[last]:.4g} N, which the law "
            "does not describe"
        )
    return notes


def _preload(found: MeasuredLoop, *, given: bool) -> str | None:
    """Sentence about a force at the first sample of loading, if it exceeds the scatter."""
    at = found.branches.kept[found.branches.loading]
    at = at[np.argsort(found.compression[at], kind="stable")]
    e, force = found.compression[at], found.force[at]
    if given and e[0] > LOWEST * found.envelope.closing:
        return None  # the law continues to the given zero as a power
    begin = slice(0, LEAST)
    slope, first = np.polyfit(e[begin] - e[0], force[begin], 1)
    first = min(float(first), float(np.median(force[begin])))
    if first <= max(PRELOAD * scatter_of(force), TOUCH[1] * float(np.max(force))):
        return None
    note = (
        f"the first sample of loading is under {first:.4g} N already, and the law has 0 N there: "
        "it is too stiff at small compression"
    )
    if given:
        return note
    above = np.flatnonzero(force > BEGINNING * first)
    end = int(above[0]) if above.size else e.size
    span = float(e[end - 1] - e[0])
    missing = 0.0
    if end > LEAST and slope > 0.0 and span > 0.0:
        farthest = float(e[0]) - FARTHEST * span
        zero = smooth_zero(e[:end], force[:end], (farthest, float(e[0])), approach=False)
        missing = float(e[0]) - zero if zero > farthest + 0.01 * span else 0.0
    what = "thickness" if found.by_thickness else "displacement"
    if missing < 1e-3 * span:
        return f"{note}; give the {what} at the first contact (zero, --zero)"
    zero = (missing - e[0] - found.zero) * (1.0 if found.by_thickness else -1.0)
    return (
        f"{note}; by a smooth toe through the samples up to {BEGINNING * first:.3g} N, the test "
        f"lacks about {1e3 * missing:.2g} mm of compression: give the {what} at the first contact "
        f"(zero), about --zero={1e3 * zero:.3g}mm, if the force is no offset of the load cell"
    )
