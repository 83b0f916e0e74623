"""A mechanism as a model that :mod:`feltmb.fit` can fit and :mod:`feltmb.gap` can diagnose.

Outputs are displacements of tracking points from rest [m] and, with motion input, the force of the
finger [N]. Every record starts at rest, for all parameters, and is simulated as a whole.
"""

from __future__ import annotations

import copy
import fnmatch
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from feltmb import _core
from feltmb.adapters.accuracy import with_force_error, with_integration_error
from feltmb.adapters.aliases import Alias, alias_of
from feltmb.adapters.differentiable import DifferentiableMechanism
from feltmb.adapters.drives import (
    DISPLACEMENT,
    FORCE,
    Drives,
    driven,
    start_state,
    with_noise,
)
from feltmb.adapters.landmarks import first_turn, landmarks
from feltmb.adapters.library import Entry, Library
from feltmb.adapters.references import from_rest
from feltmb.adapters.sampling import at_times, output_rate
from feltmb.adapters.shifter import Shifter
from feltmb.adapters.variants import Variant, Workshop
from feltmb.adapters.writing import write_mechanism
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.fit import Candidate, Effect, Parameter, Ready, State
from feltmb.fit.watch import simulated
from feltmb.mechanism import Action

__all__ = ["MechanismModel"]

#: Tolerances of felt and friction, which vary from stroke to stroke.
VARYING = ("felt.*", "joint_friction.*", "contact_friction.*")


class MechanismModel(DifferentiableMechanism):
    """A mechanism as a model of a fit or a diagnosis: parameters, records, files.

    Abstract; :class:`~feltmb.adapters.strokes.StrokeModel` simulates and differentiates it, and
    :func:`mechanism_model` makes one.

    Parameters
    ----------
    action
        The mechanism.
    library
        Effects and tolerances, see :func:`load_library`.
    outputs
        Names such as ``hammer_tip.x`` (displacement from rest [m]) or ``finger.force`` [N]. With
        the latter, ``finger.displacement`` [m] is an output too: a record of a motion whose force
        is measured is compared as a record of a force whose motion is measured.
    tolerances
        Estimated parameters; default: all tolerances of the library.
    rtol
        Relative tolerance of the integrator.
    segment
        Length of the segments [s].
    until
        Time after the first reversal of the library's ``until.output`` (the
        impact) that is used [s]; infinite: to the end of the record. Default: the value of the
        library.
    workers
        Number of threads; default: number of cores.

    Raises
    ------
    InvalidParameter
        An output that the mechanism does not have.
    """

    from_rest = True
    difference_step = 0.1
    many_outputs = True
    input_modes = MappingProxyType({"force": ("force",), "motion": ("displacement",)})
    input_names = MappingProxyType(
        {"force": (FORCE,), "displacement": (DISPLACEMENT,), DISPLACEMENT: ("displacement",)}
    )

    def __init__(
        self,
        action: Action,
        library: Library,
        outputs: Sequence[str],
        *,
        tolerances: Sequence[Entry] | None = None,
        rtol: float = 1e-6,
        segment: float | None = None,
        until: float | None = None,
        workers: int | None = None,
    ):
        if not 0.0 < rtol < 1.0:
            raise InvalidParameter(f"rtol = {rtol!r}, expected in (0, 1)")
        if until is not None and not until >= 0.0:
            raise InvalidParameter(f"until = {until!r} s, expected >= 0")
        self.action = action
        self.library = library
        self.name = action.name
        both = FORCE in outputs and DISPLACEMENT not in outputs
        self.outputs = (*outputs, DISPLACEMENT) if both else tuple(outputs)
        self.beside: frozenset[str] = frozenset()
        """Outputs that no planned record has; sensor effects mix them into other outputs."""
        self.units = {o: "N" if o == FORCE else "m" for o in self.outputs}
        self.units |= {"force": "N", "displacement": "m"}
        self.tolerances = tuple(library.tolerances if tolerances is None else tolerances)
        self.parameters = tuple(
            Parameter(
                name=e.name,
                value=0.0,
                sd=e.magnitude,
                unit=e.unit,
                lower=max(e.lower, -0.9 if e.unit == "1" else -math.inf),
                upper=e.upper,
                component=e.component,
                label=e.part or f"The {e.component}",
                words=e.words,
                relative=e.unit == "1",
            )
            for e in self.tolerances
        )
        self.segment = library.segment if segment is None else segment
        self.rtol = rtol
        self.until = library.until
        if until is not None and math.isfinite(until) and library.until is None:
            raise InvalidParameter(
                f"until: the library {library.name} does not specify the reversal of a stroke "
                "(defaults.until); the whole record is used"
            )
        if until is not None and library.until is not None:
            self.until = None if math.isinf(until) else replace(library.until, after_turn=until)
        self.workers = workers or min(8, os.cpu_count() or 1)
        self.drives = Drives()
        self.carried: frozenset[int] = frozenset()
        """Motions whose noise was carried into the force of their records by :meth:`ready`."""
        self._aliases: dict[str, Alias | None] = {}
        self._workshop = Workshop()
        self._shifter = Shifter(action.config)
        try:
            self._base = self._workshop.build(action.config)
        except FeltmbError as error:
            raise InvalidParameter(f"mechanism {action.name!r} has no rest pose: {error}") from None
        self._check_outputs(self._base)

    def _check_outputs(self, base: Variant) -> None:
        known = [f"{p}.{axis}" for p in base.points for axis in "xy"]
        if self.action.config.finger is not None:
            known += [FORCE, DISPLACEMENT]
        unknown = [o for o in self.outputs if o not in known]
        if unknown:
            raise InvalidParameter(
                f"outputs {', '.join(unknown)}: mechanism {self.name!r} has "
                f"{', '.join(known) or 'no tracking points'}"
            )

    # --- the interface of Model ---------------------------------------------------------------

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """No states: every record starts at rest."""
        del included
        return ()

    def ready(self, records: Sequence[Record]) -> Ready:
        """Prepare records: the part until shortly after the impact.

        The noise of the input is estimated if it is not specified.
        """
        cut: list[Record] = []
        notes: list[str] = []
        model = copy.copy(self)

        def mark(record: Record) -> int:
            """Identity of the inputs of a record and of the noise of its force."""
            forces = [s.sigma for n, s in record.sensors.items() if self.units.get(n) == "N"]
            return hash((*(v.tobytes() for v in record.inputs.values()), *forces))

        def with_error(record: Record, turn: float | None) -> Record:
            if mark(record) in self.carried:
                return record
            out = with_force_error(self, record, turn, notes)
            if out is not record:
                model.carried |= {mark(out)}
            return out

        for record in records:
            record, said = self.referred(record)
            notes += said
            record = with_noise(record, notes)
            if self.until is None:
                cut.append(with_error(record, None))
                continue
            turn = self._turn(record)
            last = record.time[-1] if turn is None else turn + self.until.after_turn
            kept = int(np.searchsorted(record.time, last + 1e-9, side="right"))
            if self.least_samples <= kept < record.samples:
                notes.append(
                    f"{record.name}: samples after {record.time[kept - 1]:.4g} s are not used, "
                    f"{self.until.after_turn:g} s after the reversal of {self.until.output}: later "
                    "samples are chaotic and are excluded (--set until=end, in Python "
                    "until=math.inf, uses them)"
                )
                record = record.cut(0, kept)
            cut.append(with_error(record, turn))
        ready = with_integration_error(self, cut, notes)
        same = model.carried == self.carried
        return Ready(self if same else model, tuple(ready), tuple(notes))

    def driven(self, records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
        """Where motion and force are measured, the force is the input, and the motion an output."""
        if DISPLACEMENT not in self.outputs:
            return tuple(records), ()
        return driven(records)

    def referred(self, record: Record) -> tuple[Record, tuple[str, ...]]:
        """Channels of tracking points as displacements from rest, also if they are absolute.

        The sensor states whether a channel is absolute, or its first value shows this.
        """
        at = {o: self.at_rest(self._base, o) for o in self.outputs if self.units[o] == "m"}
        return from_rest(record, at, self.name)

    def _turn(self, record: Record) -> float | None:
        """Time at which the stroke of a record reverses [s]: measured, or else simulated."""
        assert self.until is not None
        name = self.until.output
        if name in record.outputs and np.isfinite(record.outputs[name]).sum() > 10:
            return first_turn(record.time, record.outputs[name])
        run = self._integrate(record, self._base)
        if run is None:
            return None
        result = run[1]
        column = np.array(result.data)[:, list(result.names).index(name)]
        return first_turn(record.time[0] + result.time, column - self.at_rest(self._base, name))

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has an :class:`Entry`, or is a sensor or input effect."""
        return isinstance(effect.data, Entry) or super().accepts(effect)

    def identity(self) -> str | None:
        """See :class:`~feltmb.fit.Model`: tables of the mechanism, and options of the model."""
        options = (self.tolerances, self.rtol, self.until, self.segment, self.outputs)
        return repr((type(self).__name__, self.action.raw, *options))

    def as_tabulated(self, record: Record) -> Array | None:  # noqa: D102
        return self.whole(record, self._base)

    def whole(self, record: Record, variant: Variant) -> Array | None:
        """Outputs of one version over the whole record from rest, (n, ny); None if it failed."""
        run = self._integrate(record, variant)
        return None if run is None else run[0]

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """Start and end of the key's motion, and reversal of the hammer, if channels show them."""
        return landmarks(record.time, outputs, self.action.config.reading)

    def alias(self, entry: Entry) -> Alias | None:
        """Tolerance that changes the same values as an effect of the library, or None."""
        if entry.name not in self._aliases:
            self._aliases[entry.name] = alias_of(self.action.config, entry, self.tolerances)
        return self._aliases[entry.name]

    def check_writing(self, path: Path) -> None:
        """See :class:`~feltmb.fit.Model`: a mechanism can be written."""
        if path.suffix != ".toml":
            raise InvalidParameter(f"{path}: expected the name of a TOML file, such as found.toml")

    def write(  # noqa: D102
        self,
        path: Path,
        theta: Array,
        included: Sequence[Candidate],
        magnitudes: Array,
        *,
        provenance: str = "",
        force: bool = False,
    ) -> Path:
        # The mechanism with these values as TOML.
        self.check_writing(path)
        return write_mechanism(
            path,
            self.action,
            self._chosen(theta[: len(self.tolerances)], tuple(included), magnitudes),
            provenance=provenance,
            besides=[t.name for t in included if not isinstance(t.effect.data, Entry)],
            force=force,
        )

    # --- for feltmb.adapters ----------------------------------------------------------------------

    def _chosen(
        self, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> list[tuple[Entry, float, float | None]]:
        out: list[tuple[Entry, float, float | None]] = [
            (e, float(v), None) for e, v in zip(self.tolerances, theta, strict=True)
        ]
        for candidate, magnitude in zip(included, magnitudes, strict=True):
            if isinstance(candidate.effect.data, Entry):
                out.append((candidate.effect.data, float(magnitude), candidate.shape))
        return out

    def _key(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> bytes:
        drifting = [
            (t.effect.data.condition.factor(record.conditions) if t.effect.data.condition else 1.0)
            if isinstance(t.effect.data, Entry)
            else 1.0
            for t in included
        ]
        parts = [theta.tobytes()]
        parts += [
            f"{t.name}|{t.shape}|{float(magnitude * drift)!r}".encode()
            for t, magnitude, drift in zip(included, magnitudes, drifting, strict=True)
            if magnitude * drift != 0.0
        ]
        return b";".join(parts)

    def at_rest(self, variant: Variant, output: str) -> float:
        """Value of an output at rest: position of the tracking point [m]; 0 for a force."""
        point, _, axis = output.rpartition(".")
        return variant.points[point]["xy".index(axis)] if point in variant.points else 0.0

    def in_parallel(self, work: Callable[[Any], None], tasks: Sequence[Any]) -> None:
        """Run the tasks on the threads of the model; results do not depend on their number."""
        if self.workers <= 1 or len(tasks) < 2:
            for task in tasks:
                work(task)
            return
        with ThreadPoolExecutor(self.workers) as pool:
            list(pool.map(work, tasks))

    def _integrate(self, record: Record, v: Variant) -> tuple[Array, Any] | None:
        """Outputs (n, ny) at the samples of a record, and the run; None if it failed."""
        time = record.time - record.time[0]
        options = _core.SimulationOptions()
        options.duration = float(time[-1])
        options.rtol = self.rtol
        options.output_rate = output_rate(time)
        options.ledger = options.events = options.diagnose = False
        options.finger_reference = v.finger_reference
        drive = self.drives.of(record)
        start = start_state(self.action, v, drive)
        simulated(1.0)
        try:
            result = _core.simulate(
                v.mechanism,
                drive.input,
                options,
                list(start),
                [],
                None,
                list(v.memory),
            )
        except (RuntimeError, ValueError, FeltmbError):
            return None
        if result.time.size < 2 or result.reached < time[-1] * (1.0 - 1e-9):
            return None
        return self._columns(result, at_times(result.time, result.data, time), v), result

    def _columns(self, result: Any, data: Array, v: Variant) -> Array:
        where = {name: i for i, name in enumerate(result.names)}
        out = np.empty((data.shape[0], len(self.outputs)))
        for o, name in enumerate(self.outputs):
            column = data[:, where[name]] if name in where else np.full(data.shape[0], np.nan)
            out[:, o] = column - self.at_rest(v, name)
        return out


def is_law(entry: Entry) -> bool:
    """Whether a tolerance scales a law of felt or friction."""
    return entry.unit == "1" and any(fnmatch.fnmatch(entry.name, v) for v in VARYING)
