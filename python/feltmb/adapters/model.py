"""A mechanism as a model that :mod:`feltmb.fit` can fit and :mod:`feltmb.gap` can diagnose.

Outputs are displacements of tracking points from rest [m] and, with motion input, the force of the
finger [N]. Every record starts at rest, for all parameters, and is simulated as a whole, so that a
point of the fit costs one run per record.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from feltmb.adapters.accuracy import with_force_error, with_integration_error
from feltmb.adapters.derivatives import Derivatives, SimulatedPoint
from feltmb.adapters.drives import DISPLACEMENT, FORCE, driven, with_noise
from feltmb.adapters.landmarks import first_turn, landmarks
from feltmb.adapters.library import Entry, Library
from feltmb.adapters.references import from_rest
from feltmb.adapters.simulator import Simulator, key_of
from feltmb.adapters.unreached import unreached
from feltmb.adapters.variability import RunVariability, variability_of
from feltmb.adapters.writing import write_mechanism
from feltmb.data import Array, Record
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit import (
    VARIABILITY,
    Candidate,
    Effect,
    Jobs,
    Model,
    Parameter,
    Ready,
    Sensitivity,
    SensitivityRequest,
    State,
)
from feltmb.mechanism import Action

__all__ = ["MechanismModel"]

#: Longest record [s]; the simulation of a wrong clock would take minutes.
LONGEST = 20.0


class MechanismModel(Model):
    """A mechanism as a model of a fit or a diagnosis: parameters, records, files.

    :func:`mechanism_model` makes one. ``chaotic`` is False: records should end soon after the
    impact, while a stroke is still a smooth function of the parameters.

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
    until
        Time after the first reversal of the library's ``until.output`` (the
        impact) that is used [s]; infinite: to the end of the record. Default: the value of the
        library.
    workers
        Number of threads; default: number of cores.
    variation
        Relative variation of felt and friction from stroke to stroke [1], for
        :meth:`with_variability`; None: no variability.

    Raises
    ------
    InvalidParameter
        An output that the mechanism does not have.
    """

    difference_step = 0.1
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
        until: float | None = None,
        workers: int | None = None,
        variation: float | None = 0.01,
    ):
        if not 0.0 < rtol < 1.0:
            raise InvalidParameter(f"rtol = {rtol!r}, expected in (0, 1)")
        if until is not None and not until >= 0.0:
            raise InvalidParameter(f"until = {until!r} s, expected >= 0")
        self.library = library
        self.name = action.name
        both = FORCE in outputs and DISPLACEMENT not in outputs
        self.outputs = (*outputs, DISPLACEMENT) if both else tuple(outputs)
        self.beside: frozenset[str] = frozenset()
        """Outputs that no planned record has; sensor effects mix them into other outputs."""
        self.simulator = Simulator(
            action,
            self.outputs,
            library.tolerances if tolerances is None else tolerances,
            rtol=rtol,
            workers=workers or min(8, os.cpu_count() or 1),
        )
        self.derivatives = Derivatives(self.simulator)
        self.units = self.simulator.units | {"force": "N", "displacement": "m"}
        self.parameters = self.simulator.parameters
        self.until = library.until
        if until is not None and math.isfinite(until) and library.until is None:
            raise InvalidParameter(
                f"until: the library {library.name} does not specify the reversal of a stroke "
                "(defaults.until); the whole record is used"
            )
        if until is not None and library.until is not None:
            self.until = None if math.isinf(until) else replace(library.until, after_turn=until)
        self.carried: frozenset[int] = frozenset()
        """Motions whose noise was carried into the force of their records by :meth:`ready`."""
        self.variation = variation
        self.variabilities: dict[str, RunVariability] = {}
        """Run-to-run variability by record."""

    @property
    def action(self) -> Action:
        """The mechanism with its tabulated values."""
        return self.simulator.action

    @property
    def tolerances(self) -> tuple[Entry, ...]:
        """Estimated parameters of the mechanism."""
        return self.simulator.tolerances

    @property
    def mechanical(self) -> int:
        """Number of parameters of the mechanism; those of the variability follow."""
        return len(self.simulator.parameters)

    # --- the interface of Model ---------------------------------------------------------------

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """No states: every record starts at rest."""
        del included
        return ()

    def ready(self, records: Sequence[Record]) -> Ready:
        """Prepare records: the part until shortly after the impact, with their variability.

        The noise of the input is estimated if it is not specified.
        """
        cut: list[Record] = []
        notes: list[str] = []
        model = copy.copy(self)
        if DISPLACEMENT in self.outputs:
            records, said = driven(records)
            notes += said

        def mark(record: Record) -> int:
            """Identity of the inputs of a record and of the noise of its force."""
            forces = [s.sigma for n, s in record.sensors.items() if self.units.get(n) == "N"]
            return hash((*(v.tobytes() for v in record.inputs.values()), *forces))

        def with_error(record: Record, turn: float | None) -> Record:
            if mark(record) in self.carried:
                return record
            out = with_force_error(self.simulator, record, turn, notes)
            if out is not record:
                model.carried |= {mark(out)}
            return out

        for record in records:
            if (lasts := float(np.ptp(record.time))) > LONGEST:
                raise DataError(
                    f"record {record.name}: lasts {lasts:.4g} s, expected a stroke of at most "
                    f"{LONGEST:g} s: is the unit of its time another one (--unit time=ms, unit of "
                    "the time in the TOML file)?"
                )
            record, said = self._referred(record)
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
        ready = tuple(with_integration_error(self.simulator, cut, notes))
        far = unreached(self.simulator, ready)
        notes += [far] * bool(far)
        if model.carried == self.carried:
            model = self
        known = [(r, model.variabilities.get(r.name)) for r in ready]
        if not all(v is not None and v.covers(r) for r, v in known):
            model = model.with_variability(ready)
        return Ready(model, ready, tuple(notes))

    def _referred(self, record: Record) -> tuple[Record, tuple[str, ...]]:
        """Channels of tracking points as displacements from rest, also if they are absolute.

        The sensor states whether a channel is absolute, or its first value shows this.
        """
        rest, base = self.simulator.at_rest, self.simulator.base
        at = {o: rest(base, o) for o in self.outputs if self.units[o] == "m"}
        return from_rest(record, at, self.name)

    def _turn(self, record: Record) -> float | None:
        """Time at which the stroke of a record reverses [s]: measured, or else simulated."""
        assert self.until is not None
        name = self.until.output
        if name in record.outputs and np.isfinite(record.outputs[name]).sum() > 10:
            return first_turn(record.time, record.outputs[name])
        seen = self.simulator.raw(record, name)
        return None if seen is None else first_turn(*seen)

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has an :class:`Entry`, or is a sensor or input effect."""
        return isinstance(effect.data, Entry) or super().accepts(effect)

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """Start and end of the key's motion, and reversal of the hammer, if channels show them."""
        return landmarks(record.time, outputs, self.action.config.reading)

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
            self.simulator.chosen(theta[: self.mechanical], tuple(included), magnitudes),
            provenance=provenance,
            besides=[t.name for t in included if not isinstance(t.effect.data, Entry)],
            force=force,
        )

    # --- run-to-run variability -------------------------------------------------------------------

    @property
    def variability_has_input_noise(self) -> bool:  # type: ignore[override]
        """Whether the records have a run-to-run variability; it contains the noise of the force."""
        return bool(self.variabilities)

    @property
    def _tabulated(self) -> Array:
        return np.array([p.value for p in self.simulator.parameters])

    def with_variability(
        self, records: Sequence[Record], variation: float | None = None
    ) -> MechanismModel:
        """The same model with the run-to-run variability of records.

        Parameters
        ----------
        records
            All records of the diagnosis, held-out ones included.
        variation
            Relative standard deviation of felt and friction from stroke to stroke [1]; None: the
            value of the model.

        Returns
        -------
        MechanismModel
            Model with additional parameters ``variability.RECORD.K``; the model itself if its own
            variation is None as well.
        """
        variation = self.variation if variation is None else variation
        if variation is None:
            return self
        at, none = self._tabulated, np.zeros(0)
        out = copy.copy(self)
        out.variabilities = {
            r.name: variability_of(self.derivatives, r, variation, at, (), none)
            or RunVariability(
                r, np.zeros((r.samples, len(self.outputs), 0)), variation, at, (), none
            )
            for r in records
        }
        out.parameters = self.simulator.parameters + tuple(
            Parameter(name=f"variability.{name}.{k + 1}", value=0.0, sd=1.0, component=VARIABILITY)
            for name, known in out.variabilities.items()
            for k in range(known.count)
        )
        return out

    def _variability_of(self, record: Record) -> tuple[RunVariability, slice] | None:
        """Variability of a record, or of the record from which it was cut; its parameters."""
        own = self.variabilities.get(record.name) or self.variabilities.get(record.whole)
        at = self.mechanical
        for known in self.variabilities.values():
            if known is own:
                return known, slice(at, at + known.count)
            at += known.count
        return None

    def _variability_shift(self, record: Record, theta: Array) -> Array | None:
        """Change of the outputs (n, ny) by the variability; None: no change."""
        own = self._variability_of(record)
        if own is None or not np.any(theta[own[1]]):
            return None
        known, at = own
        return np.asarray(known.over(record) @ theta[at])

    # --- simulations and derivatives --------------------------------------------------------------

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """Simulate jobs; equal versions of the mechanism are run once. Variability is added."""
        outputs = np.full((jobs.count, record.samples, len(self.outputs)), np.nan)
        groups: dict[bytes, list[int]] = {}
        for b in range(jobs.count):
            magnitudes = jobs.magnitudes[b] if jobs.included else np.zeros(0)
            theta = jobs.theta[b, : self.mechanical]
            groups.setdefault(key_of(record, theta, jobs.included, magnitudes), []).append(b)

        def work(rows: list[int]) -> None:
            magnitudes = jobs.magnitudes[rows[0]] if jobs.included else np.zeros(0)
            theta = jobs.theta[rows[0], : self.mechanical]
            motion = self.simulator.motion(record, theta, jobs.included, magnitudes)
            if motion is None:
                return
            for b in rows:
                shift = self._variability_shift(record, jobs.theta[b])
                outputs[b] = motion if shift is None else motion + shift

        self.simulator.in_parallel(work, list(groups.values()))
        return outputs

    def sensitivities(  # noqa: D102
        self, requests: Sequence[SensitivityRequest]
    ) -> list[Sensitivity]:
        # Exact derivatives, all in one pass.
        return [self._sensitivity(request) for request in requests]

    def _sensitivity(self, request: SensitivityRequest) -> Sensitivity:
        request.check(self)
        record, theta, included = request.record, request.theta, request.included
        candidates, wanted = request.candidates, request.parameters_of(self)
        own, changes = theta[: self.mechanical], request.input_changes
        base = self.simulator.motion(record, own, included, request.sizes)
        none = np.zeros((record.samples, len(self.outputs), 0))
        if base is None:
            counts = (len(wanted), len(included), len(candidates), len(changes))
            blank = [np.zeros((*none.shape[:2], k)) for k in counts]
            return Sensitivity(
                outputs=np.full(none.shape[:2], np.nan),
                d_theta=blank[0],
                d_magnitudes=blank[1],
                d_starts=none,
                d_candidates=blank[2],
                d_inputs=blank[3],
            )
        shift = self._variability_shift(record, theta)
        inner = [i for i in wanted if i < self.mechanical]
        point = SimulatedPoint(record, own, included, request.sizes, base)
        found, of, by_inputs = self.derivatives.at(point, inner, (*included, *candidates), changes)
        return Sensitivity(
            outputs=base if shift is None else base + shift,
            d_theta=self._with_own_variability(record, found, wanted),
            d_magnitudes=of[..., : len(included)],
            d_starts=none,
            d_candidates=of[..., len(included) :],
            d_inputs=by_inputs,
        )

    def _with_own_variability(
        self, record: Record, mechanical: Array, wanted: Sequence[int]
    ) -> Array:
        """Derivatives (n, ny, p) by parameters of the mechanism and of the variability."""
        out = np.zeros((*mechanical.shape[:2], len(wanted)))
        out[..., [c for c, i in enumerate(wanted) if i < self.mechanical]] = mechanical
        own = self._variability_of(record)
        if own is not None:
            known, at = own
            columns = known.over(record)
            for c, i in enumerate(wanted):
                if at.start <= i < at.stop:
                    out[..., c] = columns[..., i - at.start]
        return out
