"""Measured compression curves: CSV files with units in the header."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from feltmb.fiber.approach import LEAST, free_approach
from feltmb.fiber.columns import LOADS, CompressionColumns, read_test
from feltmb.fiber.cycles import find_branches
from feltmb.fiber.machine import saturation, without_frame
from unmodeled.arguments import checked
from unmodeled.data import ReadOptions
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.units.quantity import fault_text

Array = NDArray[np.float64]

#: Share of the compression without load that is told.
FREE_SHARE = 0.05
_RESOLUTION = 1e-3  # resolution of a load cell relative to the largest load of a test [-]


@checked
@dataclass(frozen=True)
class CompressionData:
    """One compression test.

    If the thickness (or volume fraction) without load is not stated, ``reference_known`` is False.
    The thickest sample is then the reference, although it may already be under load.
    :func:`feltmb.fiber.fit` and :func:`feltmb.felt.identify` estimate the true reference.
    """

    v_f: Array
    """Volume fraction [-]."""
    pressure: Array
    """Pressure [Pa], compression positive."""
    loading: NDArray[np.bool_]
    """True on the loading branch, False while unloading."""
    v_f0: float
    """Volume fraction at zero pressure [-]."""
    name: str = "data"
    thickness: Array | None = None
    """Thickness of the sample [m]; None for a test by volume fraction or strain."""
    reference_known: bool = True
    """Whether the unloaded state is stated."""
    notes: tuple[str, ...] = ()
    """Sentences about samples and columns of the file that are left out."""

    @property
    def thickest_loaded(self) -> float:
        """Largest thickness of a sample under load [m]; nan without thicknesses."""
        if self.thickness is None:
            return math.nan
        return float(np.max(self.thickness[self.is_loaded]))

    @property
    def thickness0(self) -> float | None:
        """Stated thickness without load [m]; None for other tests."""
        if self.thickness is None or not self.reference_known:
            return None
        return float(self.thickness[0] * self.v_f[0] / self.v_f0)

    @property
    def loosest_loaded(self) -> float:
        """Smallest volume fraction of a sample under load [-]."""
        return float(np.min(self.v_f[self.is_loaded]))

    @property
    def is_loaded(self) -> NDArray[np.bool_]:
        """Whether the pressure exceeds its scatter and the resolution of a load cell."""
        top = float(np.max(self.pressure))
        return np.asarray(self.pressure > max(5.0 * _scatter(self), _RESOLUTION * top))

    def with_thickness(self, thickness0: float) -> CompressionData:
        """Copy of the test with this thickness [m] at ``v_f0``.

        Raises
        ------
        DataError
            The test has no thicknesses, is under load at a larger thickness, or was compressed to a
            thickness at which the fibers would fill more than the volume.
        """
        if self.thickness is None:
            raise DataError(f"{self.name}: has no thicknesses, expected a test with them")
        fault = thick_fault(self.thickness, self.v_f0, thickness0)
        if fault:
            raise DataError(f"{self.name}: {fault}")
        made = replace(self, v_f=self.v_f0 * thickness0 / self.thickness, reference_known=True)
        fault = slack_fault(made, thickness0)
        if fault:
            raise DataError(f"{self.name}: {fault}")
        return made

    def branch(self, which: str) -> CompressionData:
        """Samples of ``"loading"`` or ``"unloading"`` only (``"both"``: all samples)."""
        if which not in ("loading", "unloading", "both"):
            raise DataError(f'{self.name}: branch = "{which}", expected loading, unloading or both')
        if which == "both":
            return self
        keep = self.loading if which == "loading" else ~self.loading
        if not keep.any():
            raise DataError(f"{self.name}: no samples on the {which} branch, expected at least 1")
        return self._part(keep)

    def _part(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> CompressionData:
        """Some of the samples: by a mask or by their indices."""
        return replace(
            self,
            v_f=self.v_f[keep],
            pressure=self.pressure[keep],
            loading=self.loading[keep],
            thickness=None if self.thickness is None else self.thickness[keep],
        )


def _by_reversals(test: CompressionData, cycle: int | None) -> CompressionData:
    """One cycle of the test with its branches, which are found from the reversals."""
    found = find_branches(test.v_f, cycle)
    left_out = len(test.v_f) - np.union1d(found.kept, found.held).size
    all_used = "(a column branch with the words loading and unloading uses all samples)"
    notes = []
    if left_out:
        notes.append(
            f"{found.cycles} loadings: cycle {found.chosen} is used, its loading with the "
            f"unloading after it (another one: cycle, --cycle); {left_out} samples of the other "
            f"cycles are left out {all_used}"
        )
    if found.holds:
        # Of several holds, the one under the largest load: a felt at rest does not relax.
        first, last = max(found.holds, key=lambda hold: test.pressure[hold[0]])
        where = "is held" if len(found.holds) == 1 else f"is held {len(found.holds)} times"
        which = "while" if len(found.holds) == 1 else "in the one under the largest load,"
        notes.append(
            f"the compression {where}: {found.held.size} samples are left out; {which} the "
            f"pressure goes from {test.pressure[first]:.4g} to {test.pressure[last]:.4g} Pa at "
            f"v_f = {test.v_f[last]:.4g}; no law of a felt here describes relaxation {all_used}"
        )
    return replace(test._part(found.kept), loading=found.loading, notes=tuple(notes))


def _after_approach(test: CompressionData, thickness0: float | None) -> CompressionData:
    """The test without the load at volume fractions below the unloaded one.

    ``thickness0``: thickness at the zero of a displacement whose first contact is not stated.
    """
    loading = test.loading
    if np.sum(loading) < LEAST:
        return test
    branch = test.v_f[loading], test.pressure[loading]
    notes = []
    if test.reference_known:
        load = free_approach(*branch, test.v_f0).level
        if load:
            test = replace(test, pressure=test.pressure - load)
            notes.append(f"the pressure of the free approach, {load:.4g} Pa, is subtracted")
    if thickness0 is not None:
        contact = free_approach(*branch).zero
        if contact - test.v_f0 > FREE_SHARE * (float(np.max(test.v_f)) - test.v_f0):
            at = thickness0 * (1.0 - test.v_f0 / contact)
            notes.append(
                f"there is no load below a displacement of {1e3 * at:.4g} mm: if the felt is "
                "touched only there, give this as the zero (zero of read_compression, --zero)"
            )
    return replace(test, notes=(*test.notes, *notes))


def _scatter(data: CompressionData) -> float:
    """Standard deviation of the pressures about a smooth curve [Pa], by third differences.

    The median of the absolute values is used, so that a kink or an outlier has no influence.
    """
    found = []
    for branch in (data.loading, ~data.loading):
        p = data.pressure[branch]
        if len(p) >= 8:
            found.append(float(np.median(np.abs(np.diff(p[np.argsort(data.v_f[branch])], 3)))))
    # Third differences of white noise have the variance 1 + 9 + 9 + 1.
    return 1.4826 * min(found) / math.sqrt(20.0) if found else 0.0


def thick_fault(thickness: Array, v_f0: float, thickness0: float) -> str:
    """Fault of an unloaded thickness [m] that is too large, as text; empty if there is none."""
    least = float(np.min(thickness))
    if v_f0 * thickness0 <= least:
        return ""
    return (
        f"thickness {thickness0 * 1e3:.6g} mm without load, at v_f0 = {v_f0:.6g}, but the test "
        f"goes down to {least * 1e3:.6g} mm, where the fibers would fill "
        f"{100 * v_f0 * thickness0 / least:.4g} % of the volume; expected at most "
        f"{least / v_f0 * 1e3:.6g} mm, or a smaller v_f0"
    )


def slack_fault(data: CompressionData, thickness0: float | None) -> str:
    """Fault of an unloaded state at which the test is under load, as text; empty if none."""
    beyond = data.is_loaded & (data.v_f < data.v_f0 * (1.0 - 1e-9))
    if not beyond.any():
        return ""
    worst = int(np.argmax(np.where(beyond, data.pressure, -np.inf)))
    carried = f"carries {data.pressure[worst]:.4g} Pa"
    if data.thickness is not None and thickness0 is not None:
        return (
            f"thickness {thickness0 * 1e3:.6g} mm without load, but the test {carried} at "
            f"{data.thickness[worst] * 1e3:.6g} mm; expected more than "
            f"{data.thickest_loaded * 1e3:.6g} mm, the largest thickness under load in the file"
        )
    return (
        f"v_f0 = {data.v_f0:.6g} without load, but the test {carried} at v_f = "
        f"{data.v_f[worst]:.6g}; expected less than {data.loosest_loaded:.6g}"
    )


@checked
def read_compression(
    path: str | Path,
    *,
    v_f0: float | None = None,
    thickness0: float | None = None,
    area: float | None = None,
    zero: float | None = None,
    cycle: int | None = None,
    specimen: str = "",
    frame: float | str | Path | None = None,
    options: ReadOptions | None = None,
) -> CompressionData:
    """Read a compression test from a file.

    The header states quantity and unit. One column is ``v_f [-]``, ``strain [-]`` or ``[%]``
    (engineering, compression positive), ``thickness [mm]``, or ``displacement [mm]`` (compression
    positive, zero at ``thickness0``); of several, the first of them. Another one is
    ``pressure [kPa]`` (Pa, MPa, N/mm^2, bar) or ``force [N]``; of both, the force if ``area`` is
    given. An optional column ``branch`` contains the words loading and unloading. Without it, the
    branches are found from the reversals. Of a test with several cycles, one is used: its loading
    with the unloading after it; the samples of the others and of holds are left out. Lines that
    start with ``#`` and those above the header are comments. Units may be in a line below the
    header. Other columns are ignored. Common other names are known, also German ones
    (``Kraft in N``, ``Dicke [mm]``).

    Parameters
    ----------
    path
        CSV or text: comma, semicolon, tab or space separated, decimal point or comma; also MAT
        and NetCDF.
    v_f0
        Volume fraction at zero pressure [-]; required with strain or thickness. If it is missing
        with ``v_f`` data, the value of the loosest sample is used, and ``reference_known`` is
        False.
    thickness0
        Thickness at ``v_f0`` [m]. If it is missing, the largest thickness of the file is used, and
        ``reference_known`` is False, because the thickest sample may already be under load.
    area
        Sample area [m^2]; required with force.
    zero
        Displacement at the first contact [m], for a test by displacement; default: 0. The load
        before it, or at thicknesses above ``thickness0``, is subtracted, with a note.
    cycle
        Number of the cycle that is used, from 1; default: the first complete one.
    specimen
        Which one of several specimens.
    frame
        Compliance of the frame of the machine [m/N], or the file of a record without a specimen.
    options
        Columns and units of the quantities; those in a TOML file beside the file are read.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message, with line numbers.
    """
    file = Path(path)
    table = read_test(
        file,
        loads=(*LOADS,) if area is None else ("force", "pressure"),
        options=options,
        specimen=specimen,
    )
    stated = _Stated(v_f0, thickness0, area, zero)
    faults = stated.faults(table)
    if faults:
        raise DataError(fault_text(str(file), faults, most=20))
    try:
        table = without_frame(table, frame, thickness0=thickness0, area=area, options=options)
    except DataError as error:
        raise DataError(f"{file}: {error}") from None
    v, heights = stated.fractions(table, faults)
    if not faults and not np.all((v > 0) & (v <= 1)):
        faults.append(f"v_f from {np.min(v):.6g} to {np.max(v):.6g}, expected > 0 and <= 1")
    if faults:
        raise DataError(fault_text(str(file), faults, most=20))
    known = v_f0 is not None and (heights is None or thickness0 is not None)
    reference = float(np.min(v)) if v_f0 is None else v_f0
    loads = table.loads if table.load == "pressure" else table.loads / stated.given_area
    if table.branches:
        loading = np.array([word == "loading" for word in table.branches])
        made = CompressionData(v, loads, loading, reference, file.stem, heights, known)
    else:
        whole = np.ones(len(v), dtype=np.bool_)
        test = CompressionData(v, loads, whole, reference, file.stem, heights, known)
        try:
            made = _by_reversals(test, cycle)
        except InvalidParameter as error:
            raise DataError(f"{file}: {error}") from None
    limit = saturation(made.v_f, made.pressure, made.loading)
    if limit:
        raise DataError(f"{file}: {limit}")
    made = _after_approach(
        replace(made, notes=(*table.notes, *made.notes)),
        thickness0 if table.compression == "displacement" and zero is None else None,
    )
    slack = slack_fault(made, thickness0) if known else ""
    if slack:
        raise DataError(f"{file}: {slack}{stated.hint_of_zero(table, made)}")
    return made


@dataclass(frozen=True)
class _Stated:
    """What is stated of a specimen beside its file, see :func:`read_compression`."""

    v_f0: float | None
    thickness0: float | None
    area: float | None
    zero: float | None

    @property
    def given_area(self) -> float:
        assert self.area is not None
        return self.area

    def faults(self, table: CompressionColumns) -> list[str]:
        """What is missing, or does not belong to the columns."""
        fraction, faults = table.compression, []
        if table.load == "force" and self.area is None:
            faults.append("force without a sample area, expected area in m^2 (--area)")
        if self.area is not None and not 1e-10 <= self.area <= 1.0:
            faults.append(
                f"area = {self.area:.6g} m^2, expected 1e-10 to 1 m^2, with its unit, such as "
                "3.14cm^2"
            )
        if fraction == "displacement" and self.thickness0 is None:
            faults.append(
                "displacement without the thickness at its zero, expected thickness0 (--thickness)"
            )
        if self.zero is not None and fraction != "displacement":
            faults.append(
                f"zero = {self.zero:.6g} m is for a column displacement; the file has {fraction}"
            )
        if fraction != "v_f" and self.v_f0 is None:
            faults.append(f"{fraction} without a reference, expected v_f0 (--v-f0)")
        if self.v_f0 is not None and not 0 < self.v_f0 < 1:
            faults.append(f"v_f0 = {self.v_f0:.6g}, expected > 0 and < 1")
        return faults

    def fractions(self, table: CompressionColumns, faults: list[str]) -> tuple[Array, Array | None]:
        """Volume fractions [1], and thicknesses [m] if they are measured."""
        x = table.x
        if table.compression == "v_f":
            return x, None
        assert self.v_f0 is not None
        if table.compression == "strain":
            if not np.all(x < 1):
                faults.append(f"strain up to {np.max(x):.6g}, expected < 1 (compression positive)")
            return self.v_f0 / np.where(x < 1, 1 - x, np.nan), None
        if table.compression == "displacement":
            assert self.thickness0 is not None
            x = self.thickness0 - (x - (self.zero or 0.0))
        h0 = float(np.max(x)) if self.thickness0 is None else self.thickness0
        if not np.all(x > 0):
            faults.append(f"thickness down to {np.min(x):.6g} m, expected > 0")
        elif not 0 < h0 <= 100.0:
            faults.append(f"thickness0 = {h0:.6g} m, expected > 0, at most 100")
        elif self.thickness0 is not None and (thick := thick_fault(x, self.v_f0, h0)):
            faults.append(thick)
        with np.errstate(over="ignore"):  # reported by the caller
            return self.v_f0 * h0 / np.where(x > 0, x, np.nan), x

    def hint_of_zero(self, table: CompressionColumns, made: CompressionData) -> str:
        if table.compression != "displacement" or self.thickness0 is None:
            return ""
        first = (self.zero or 0.0) + self.thickness0 - made.thickest_loaded
        return (
            f"; hint: the displacement at the first contact is {1e3 * first:.4g} mm or less, "
            f"give zero (--zero={1e3 * first:.4g}mm)"
        )
