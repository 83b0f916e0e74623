"""Simulates single fibers: a periodic box of bead-spring fibers is compressed and released."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked
from unmodeled.data.columns import read_columns
from unmodeled.data.mapping import unit_of_column, values_in
from unmodeled.errors import DataError, Error, InvalidParameter, shown
from unmodeled.files import check_suffix, read_npz, write_file
from unmodeled.units.quantity import fault_text

Array = NDArray[np.float64]
_FORMAT = 1
_STORED = ("stretching", "bending", "repulsion", "tangential", "kinetic")
_TABLE = (
    *("phase", "step", "v_f", "strain", "pressure", "lateral", *_STORED, "work"),
    *("friction_loss", "drag_loss", "contacts", "smallest_distance", "max_force"),
)
_STATE = (
    "positions",
    "velocities",
    "rest_angles",
    "box",
    "books",
    "contact_pairs",
    "contact_springs",
)


#: Shares of the supplied work: above the first limit a run gets a warning, above the second it
#: fails.
_LEDGER = (0.01, 0.1)  # not accounted for by stored energy, friction and drag
_DRAG = (0.1, 0.5)  # lost to drag, a numerical damping that fibers do not have
_KINETIC = (0.05, 0.25)  # kinetic energy at some time


@checked
@dataclass(frozen=True)
class FiberBox:
    """Fibers, material and numerical parameters of a bead-spring simulation; SI units."""

    n_fibers: int = 60
    """Fibers in the box."""
    n_beads: int = 31
    """Beads per fiber."""
    d_f: float = 25e-6
    """Fiber diameter [m]."""
    segment_length: float = 62.5e-6
    """Distance of beads [m], at least d_f."""
    v_f: float = 0.1
    """Volume fraction of the first, cubic box [-]."""
    crimp: float = 0.3
    """Root mean square turning angle of the unloaded fiber at each bead [rad]."""
    ratio: float = 1.0
    """Initial orientation R of the fibers (1: isotropic)."""
    seed: int = 0
    """Seed of all random draws."""
    E: float = 2.5e9
    """Fiber modulus [Pa]."""
    density: float = 1310.0
    """Density of the fiber material [kg/m^3]."""
    repulsion: str = "hertz"
    """Repulsion between touching segments: hertz with friction, or logarithmic (eq. 2.10)."""
    interaction: float = 0.0
    """Constant K_I [J]; 0: Hertz contact of crossed cylinders, 0.41 E d_f^3."""
    friction: float = 0.0
    """Coefficient of Coulomb friction [-]."""
    tangential: float = 0.3
    """Ratio of tangential to normal contact stiffness [-]."""
    drag: float = 0.001
    """Ratio of drag rate to the highest stretching frequency [-]."""
    time_step: float = 0.2
    """Time step multiplied by that frequency, up to 0.8 [-]."""

    def core(self) -> Any:
        """The parameters, checked, as an object of the core."""
        return _core.BeadSpringParams(**asdict(self))


@checked
@dataclass(frozen=True)
class Cycle:
    """Compression cycle of the box."""

    v_max: float = 0.3
    """Volume fraction at which compression ends and release starts [-]."""
    strain_per_step: float = 2e-5
    """True strain of each step [-]; half of it shows whether the compression is slow enough."""
    relax_steps: int = 4000
    """Number of steps that remove the overlaps of the random initial positions."""
    sample_every: int = 500
    """Number of steps between two samples."""
    cycles: int = 1
    """Number of cycles of compression and release."""


@dataclass
class FiberRun:
    """Samples of a simulation: pressure over volume fraction, contacts, energy balance."""

    box: FiberBox
    cycle: Cycle
    table: dict[str, list[float]] = field(default_factory=dict)
    """Columns: phase (0 loading, 1 unloading), step, v_f [-], strain [-], pressure [Pa],
    lateral [Pa], energies [J] (stretching, bending, repulsion, tangential, kinetic),
    work, friction_loss, drag_loss [J], contacts [1], smallest_distance [-], max_force [-]."""
    laid: dict[str, float] = field(default_factory=dict)
    """Before relaxation: crossings, volume [m^3], and the expectation of Toll's formula."""
    relaxed: dict[str, float] = field(default_factory=dict)
    """After relaxation: contacts, and the expectation of Toll's formula."""
    state: dict[str, Any] = field(default_factory=dict)
    """Final state of the core, for a restart."""
    done: bool = False

    @checked
    def column(self, name: str) -> Array:
        """One column of the table as an array."""
        if name not in self.table:
            raise InvalidParameter(
                f"fiber run: there is no column {name!r}; columns are {', '.join(self.table)}"
            )
        return np.array(self.table[name], dtype=float)

    @property
    def energy(self) -> dict[str, float]:
        """Energy balance of the run [J] and its relative numbers [-].

        ``put_in``: work on the box during compression; ``friction``, ``drag``: losses since the
        start; ``stored``: change since the start. The following are relative to the exchanged
        energy: ``residual_relative``, the largest error of the balance; ``drag_relative``, the
        drag; ``kinetic_relative``, the largest kinetic energy.
        """
        stored = np.sum([self.column(k) for k in _STORED], axis=0)
        work, friction, drag = (self.column(k) for k in ("work", "friction_loss", "drag_loss"))
        put_in = float(np.sum(np.maximum(np.diff(work), 0.0)))
        # A box that was initially in motion has additional energy.
        turned = max(put_in + float(stored[0]), 1e-300)
        residual = work - (stored - stored[0]) - friction - drag
        return {
            "put_in": put_in,
            "stored": float(stored[-1] - stored[0]),
            "friction": float(friction[-1]),
            "drag": float(drag[-1]),
            "residual_relative": float(np.max(np.abs(residual))) / turned,
            "drag_relative": float(drag[-1]) / turned,
            "kinetic_relative": float(np.max(self.column("kinetic"))) / turned,
        }

    def _judged(self) -> list[tuple[int, str]]:
        """Faults with a level (1: warning, 2: the results are invalid) and text."""
        if len(self.table.get("work", ())) < 2:
            return []
        energy = self.energy
        slower = (
            f"reduce strain_per_step (now {self.cycle.strain_per_step:g}), compress well beyond "
            f"where the fibers jam (v_max, now {self.cycle.v_max:g}), or use longer fibers"
        )
        out = []
        for share, limits, text in (
            (
                energy["residual_relative"],
                _LEDGER,
                "of the energy is not accounted for by stored energy, friction and drag: reduce "
                f"time_step (now {self.box.time_step:g}) or strain_per_step "
                f"(now {self.cycle.strain_per_step:g})",
            ),
            (
                energy["drag_relative"],
                _DRAG,
                "of the energy was lost to drag, which is none of the fibers': pressures and "
                f"losses are those of the speed; {slower}",
            ),
            (
                energy["kinetic_relative"],
                _KINETIC,
                f"of the energy was in motion: pressures are those of inertia; {slower}",
            ),
        ):
            # Before the fibers jam, all losses are drag; only the complete run is judged.
            judged = self.done or limits is _LEDGER
            if judged and not share <= limits[0]:
                out.append((1 if share <= limits[1] else 2, f"{100 * share:.3g} % {text}"))
        pressure = self.column("pressure")
        if self.done and np.min(pressure) < -0.05 * np.max(np.abs(pressure)):
            out.append(
                (
                    1,
                    f"the box pulls: its pressure falls to {np.min(pressure):.4g} Pa, the largest "
                    f"is {np.max(pressure):.4g} Pa; {slower}",
                )
            )
        if self.done and not self.loop_loss <= 1.0 + _LEDGER[0]:
            out.append((2, f"release takes work too: the loop loses {100 * self.loop_loss:.4g} %"))
        return out

    @property
    def status(self) -> str:
        """``"done"``, ``"unfinished"``, or ``"failed"`` if the results are invalid."""
        if any(level > 1 for level, _ in self._judged()):
            return "failed"
        return "done" if self.done else "unfinished"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the run; the reasons if it failed."""
        return tuple(text for _, text in self._judged())

    @property
    def loop_loss(self) -> float:
        """Share of the loading work that is lost in the cycle [-]."""
        change = np.diff(self.column("work"))
        unloading = self.column("phase")[1:] > 0
        put_in = float(np.sum(change[~unloading]))
        given_back = -float(np.sum(change[unloading]))
        return 1.0 - given_back / put_in if put_in > 0 else math.nan

    @checked
    def pressure_exponent(self, v_low: float) -> float:
        """Slope of log P over log v_f in the first loading, above ``v_low`` [-].

        It is 3 for van Wyk's law far above its v_f0, and 5 for Toll's planar law.
        """
        v, p, phase = self.column("v_f"), self.column("pressure"), self.column("phase")
        first = int(np.argmax(phase > 0)) if np.any(phase > 0) else len(phase)
        keep = (np.arange(len(v)) < first) & (v > v_low) & (p > 0)
        if keep.sum() < 3:
            raise InvalidParameter(
                f"pressure exponent: {keep.sum()} loading samples above v_low = {v_low:.6g}, "
                "expected at least 3"
            )
        return float(np.polyfit(np.log(v[keep]), np.log(p[keep]), 1)[0])

    def to_vtk(self) -> str:
        """The fibers in their final state as text of a VTK file (legacy ASCII, PolyData), in m.

        Each fiber is a line through its beads, shifted by sides of the box so that its center is
        inside. ``diameter`` [m] is a number of each point, for ParaView's filter Tube, and
        ``fiber`` one of each line.
        """
        if "positions" not in self.state:
            raise InvalidParameter("to_vtk: the run has no state, expected one of simulate")
        count, beads = self.box.n_fibers, self.box.n_beads
        x = np.reshape(self.state["positions"], (count, beads, 3))
        side = np.asarray(self.state["box"], dtype=float)
        x = x - side * np.floor(x.mean(axis=1, keepdims=True) / side)
        points = "\n".join(" ".join(f"{v:.9g}" for v in row) for row in x.reshape(-1, 3))
        lines = "\n".join(
            " ".join(map(str, (beads, *range(first, first + beads))))
            for first in range(0, count * beads, beads)
        )
        fibers = "\n".join(map(str, range(count)))
        diameters = "\n".join([f"{self.box.d_f:.9g}"] * (count * beads))
        table = "LOOKUP_TABLE default"
        return (
            f"# vtk DataFile Version 3.0\n{count} fibers in a box of "
            f"{' x '.join(f'{v:.6g}' for v in side)} m\nASCII\nDATASET POLYDATA\n"
            f"POINTS {count * beads} double\n{points}\n"
            f"LINES {count} {count * (beads + 1)}\n{lines}\n"
            f"CELL_DATA {count}\nSCALARS fiber int 1\n{table}\n{fibers}\n"
            f"POINT_DATA {count * beads}\nSCALARS diameter double 1\n{table}\n{diameters}\n"
        )

    @checked
    def save(self, path: str | Path) -> Path:
        """Write everything to one ``.npz`` file, which is replaced as a whole."""
        file = Path(path)
        check_suffix(file, ".npz")
        header = {
            "format": _FORMAT,
            "box": asdict(self.box),
            "cycle": asdict(self.cycle),
            "laid": self.laid,
            "relaxed": self.relaxed,
            "done": self.done,
        }
        columns = {f"table_{k}": np.array(v, dtype=float) for k, v in self.table.items()}
        state = {f"state_{k}": np.asarray(self.state[k]) for k in _STATE if k in self.state}

        def write(target: Path) -> None:
            with target.open("wb") as out:
                np.savez(out, header=np.array(json.dumps(header)), **columns, **state)  # type: ignore[arg-type]

        return write_file(file, write, force=True)

    @classmethod
    @checked
    def load(cls, path: str | Path) -> FiberRun:
        """Read a file that :meth:`save` has written.

        Raises
        ------
        DataError
            The file does not exist, or :meth:`save` has not written it.
        """
        file = Path(path)
        stored = read_npz(file)
        table = {k[6:]: v for k, v in stored.items() if k.startswith("table_")}
        state = {k[6:]: v for k, v in stored.items() if k.startswith("state_")}
        try:
            header = json.loads(str(stored["header"]))
            if header["format"] != _FORMAT:
                raise ValueError(f"format = {shown(header['format'])}, expected {_FORMAT}")
            _check_arrays(table, state)
            for name, kind in (("box", FiberBox), ("cycle", Cycle)):
                if other := header[name].keys() - {f.name for f in fields(kind)}:
                    raise ValueError(f"{name}: unknown entries {shown(sorted(other))}")
            counts = {
                name: {str(key): float(value) for key, value in header[name].items()}
                for name in ("laid", "relaxed")
            }
            return cls(
                FiberBox(**header["box"]),
                Cycle(**header["cycle"]),
                {name: values.tolist() for name, values in table.items()},
                counts["laid"],
                counts["relaxed"],
                state,
                header["done"] is True,
            )
        except KeyError as error:
            reason = f"{error} is missing"
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            reason = str(error)
        raise DataError(f"{file}: is not a saved fiber simulation: {reason}")


def _check_arrays(table: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Refuse arrays of a file that no simulation has saved."""
    length = np.size(table["phase"])
    for name in (*_TABLE, *table):
        values = table[name]
        shaped = values.dtype == float and values.shape == (length,)
        if not (shaped and np.all(np.isfinite(values))):
            raise ValueError(f"column {name}: expected {length} finite numbers")
    for name in _STATE:
        if state[name].dtype.kind not in "fiu" or state[name].ndim != 1:
            raise ValueError(f"state {name}: expected a list of numbers")


def _expected(box: FiberBox, directions: Array, v_f: float, volume: float) -> dict[str, float]:
    # Toll's formula with one contact per pair is d l^2 <sin> N(N-1)/2 2/V; pairs of segments of one
    # fiber are excluded.
    step = max(1, len(directions) // 4000)
    f = _core.estimate_structure(np.ascontiguousarray(directions[::step]))["f"][0]
    length = v_f * volume / (math.pi / 4 * box.d_f**2)
    contacts = box.d_f * length**2 * f / volume * (1 - 1 / box.n_fibers)
    return {"toll": contacts, "f": f, "volume": volume}


@checked
def lay(box: FiberBox, threads: int = 0, *, directions: npt.ArrayLike | None = None) -> Any:
    """Place the fibers at random; return the core's network (see ``feltmb.fiber.simulate``).

    Parameters
    ----------
    box
        The fibers; their lengths are equal.
    threads
        Number of threads; 0: all cores.
    directions
        Direction of each fiber, from its first to its last bead, an array of n_fibers rows x, y, z;
        default: at random, by ``ratio``.
    """
    network = _core.BeadSpringNetwork(box.core(), threads)
    if directions is None:
        return network
    wanted = np.asarray(directions, dtype=float)
    if wanted.shape != (box.n_fibers, 3):
        raise InvalidParameter(
            f"directions: got the shape {wanted.shape}, expected ({box.n_fibers}, 3): x, y and z "
            "of each fiber (n_fibers)"
        )
    lengths = np.linalg.norm(wanted, axis=1)
    if not (np.all(np.isfinite(lengths)) and np.all(lengths > 0.0)):
        bad = int(np.flatnonzero(~(np.isfinite(lengths) & (lengths > 0.0)))[0])
        raise InvalidParameter(
            f"directions: row {bad + 1} is {shown(wanted[bad].tolist())}, expected finite numbers "
            "that are not all 0"
        )
    state = network.state()
    x = np.reshape(state["positions"], (box.n_fibers, box.n_beads, 3))
    center = x.mean(axis=1, keepdims=True)
    old = x[:, -1] - x[:, 0]
    old /= np.linalg.norm(old, axis=1, keepdims=True)
    new = wanted / lengths[:, None]
    new = np.where(np.sum(old * new, axis=1, keepdims=True) < 0.0, -new, new)  # no sense of a line
    # Each fiber turns as a rigid body, about its center: its crimp stays.
    axis, cosine = np.cross(old, new)[:, None], np.sum(old * new, axis=1)[:, None, None]
    arm = x - center
    turned = cosine * arm + np.cross(axis, arm)
    turned += axis * np.sum(axis * arm, axis=2, keepdims=True) / (1.0 + cosine)
    state["positions"] = (center + turned).ravel()
    return _core.BeadSpringNetwork(box.core(), state, threads)


@checked
def read_directions(path: str | Path) -> Array:
    """Read the directions of fibers from a table with the columns x, y and z.

    A row is a fiber; z is the axis of compression. The numbers need not have the length 1, and may
    be lengths with units.

    Raises
    ------
    DataError
        The file has faults; all of them are in the message.
    """
    file = Path(path)
    columns = read_columns(file)
    named = {name: columns.find(name) for name in "xyz"}
    missing = [name for name, column in named.items() if not column]
    if missing:
        raise DataError(
            f"{file}: no column {', '.join(missing)}; there are {columns}; expected x, y and z of "
            "the direction of each fiber"
        )
    faults: list[str] = []
    plain = {unit_of_column(columns, c) for c in named.values()} <= {"", "1"}
    rows = [values_in(columns, c, "1" if plain else "m", faults) for c in named.values()]
    if faults:
        raise DataError(fault_text(f"{file}: expected x, y and z as numbers or lengths", faults))
    return np.column_stack(rows)


@checked
def simulate(
    box: FiberBox,
    cycle: Cycle | None = None,
    *,
    resume: FiberRun | None = None,
    directions: npt.ArrayLike | None = None,
    threads: int = 0,
    progress: Callable[[float, dict[str, Any]], object] | None = None,
    checkpoint: str | Path | None = None,
    max_samples: int | None = None,
) -> FiberRun:
    """Place, relax, compress and release a box of fibers.

    Parameters
    ----------
    box, cycle
        The box of fibers and the cycle of compression.
    resume
        Unfinished run that continues (``box`` and ``cycle`` must be equal).
    directions
        Direction of each fiber, from its first to its last bead, an array of n_fibers rows x, y, z;
        z is the axis of compression. Default: at random, by ``ratio``. Places and crimp are random.
    threads
        Number of threads; 0: all cores. The result does not depend on it.
    progress
        Function that is called after every sample with the completed share and the sample. If it
        returns False, the run stops there and can be resumed; any other value, None included,
        continues it.
    checkpoint
        File that is written after every tenth sample and at the end.
    max_samples
        Largest number of new samples; the run can be resumed.

    Returns
    -------
    FiberRun
        Samples, contact counts compared with Toll's formula, final state. If the energy balance has
        a large error, or if drag dominates the pressures, ``status`` is "failed" and ``warnings``
        states the reason.

    Raises
    ------
    InvalidParameter
        Values are invalid; all of them are in the message.
    Error
        The box became too small for the neighbor search, or the motion is unstable.
    """
    plan = cycle or Cycle()
    faults = _plan_faults(box, plan)
    if resume is not None and directions is not None:
        faults.append("simulate: directions are of the beginning, expected none with resume")
    if resume is not None and (resume.box != box or resume.cycle != plan):
        faults.append("simulate: resume is a run of another box or cycle, expected the same")
    if faults:
        raise InvalidParameter("\n".join(faults))
    if resume is not None:
        run = resume
        network = _core.BeadSpringNetwork(box.core(), run.state, threads)
    else:
        run, network = _begin(box, plan, threads, directions)
    total_strain = math.log(plan.v_max / box.v_f)
    legs_samples = math.ceil(total_strain / plan.strain_per_step / plan.sample_every)
    strain = total_strain / (legs_samples * plan.sample_every)
    total = 2 * plan.cycles * legs_samples
    taken = max(0, len(run.table.get("step", [])) - 1)
    if not run.table:
        _append(run, network.sample(), 0)
    last = total if max_samples is None else min(total, taken + max_samples)
    while taken < last:
        unloading = (taken // legs_samples) % 2
        network.advance(plan.sample_every, -strain if unloading else strain)
        sample = network.sample()
        if not math.isfinite(sample["pressure"]):
            raise Error(
                f"simulate: pressure is not finite at step {sample['step']}; reduce time_step"
            )
        taken += 1
        _append(run, sample, unloading)
        stopped = progress is not None and progress(taken / total, sample) is False
        if checkpoint is not None and taken % 10 == 0:
            run.state = network.state()
            run.save(checkpoint)
        if stopped:
            break
    run.state = network.state()
    run.done = taken >= total
    if checkpoint is not None:
        run.save(checkpoint)
    return run


def _plan_faults(box: FiberBox, plan: Cycle) -> list[str]:
    faults = []
    if not box.v_f < plan.v_max < 0.9:
        faults.append(
            f"simulate: v_max = {plan.v_max:.6g}, expected between v_f = {box.v_f:.6g} and 0.9"
        )
    if not 0 < plan.strain_per_step < 0.01:
        faults.append(
            f"simulate: strain_per_step = {plan.strain_per_step:.6g}, expected > 0 and < 0.01"
        )
    for name in ("sample_every", "cycles"):
        if getattr(plan, name) < 1:
            faults.append(f"simulate: {name} = {getattr(plan, name)}, expected >= 1")
    if plan.relax_steps < 0:
        faults.append(f"simulate: relax_steps = {plan.relax_steps}, expected >= 0")
    return faults


def _begin(
    box: FiberBox, plan: Cycle, threads: int, directions: npt.ArrayLike | None
) -> tuple[FiberRun, Any]:
    """Place and relax the fibers; the run without samples, and the network of the core."""
    network = lay(box, threads, directions=directions)
    if plan.v_max > network.densest():
        raise InvalidParameter(
            f"simulate: v_max = {plan.v_max:.6g}, but this box can be compressed to "
            f"{network.densest():.6g} only: beyond, it is lower than two segments; expected "
            "more or longer fibers (n_fibers, n_beads), or a lower v_max"
        )
    run = FiberRun(box, plan)
    volume = float(np.prod(network.state()["box"]))
    run.laid = {
        "crossings": float(network.crossings()),
        **_expected(box, network.directions(), box.v_f, volume),
    }
    network.relax(plan.relax_steps)
    run.relaxed = {
        "contacts": float(network.sample()["contacts"]),
        **_expected(box, network.directions(), box.v_f, volume),
    }
    return run, network


def _append(run: FiberRun, sample: dict[str, Any], phase: int) -> None:
    for key, value in {"phase": phase, **sample}.items():
        run.table.setdefault(key, []).append(float(value))
