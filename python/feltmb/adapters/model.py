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

from feltmb.adapters.accuracy import with_force_error
from feltmb.adapters.derivatives import Derivatives, SimulatedPoint
from feltmb.adapters.drives import DISPLACEMENT, FORCE, driven, with_noise
from feltmb.adapters.landmarks import first_turn, landmarks
from feltmb.adapters.library import Entry, Library
from feltmb.adapters.references import from_rest
from feltmb.adapters.simulator import MechanismSimulator, key_of
from feltmb.adapters.unreached import unreached
from feltmb.adapters.writing import write_mechanism
from feltmb.data import Array, Record
from feltmb.errors import DataError, InvalidParameter
from feltmb.fit import (
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
#: Beginnings of the names of parameters of felt and friction, which vary from stroke to stroke.
VARYING = ("felt.", "joint_friction.", "contact_friction.")


class MechanismModel(Model):
    """A mechanism as a model of a fit or a diagnosis: parameters, records, files.

    :func:`mechanism_model` makes one. Records should end soon after the impact, while a stroke is
    still a smooth function of the parameters.

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
        Relative standard deviation of felt and friction from stroke to stroke [1]; None: no
        variation.

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
        self.simulator = MechanismSimulator(
            action,
            self.outputs,
            library.tolerances if tolerances is None else tolerances,
            rtol=rtol,
            workers=workers or min(8, os.cpu_count() or 1),
        )
        self.derivatives = Derivatives(self.simulator)
        self.units = self.simulator.units | {"force": "N", "displacement": "m"}
        self.parameters = tuple(
            replace(p, process_sd=variation or 0.0) if varies(p) else p
            for p in self.simulator.parameters
        )
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

    @property
    def action(self) -> Action:
        """The mechanism with its tabulated values."""
        return self.simulator.action

    @property
    def tolerances(self) -> tuple[Entry, ...]:
        """Estimated parameters of the mechanism."""
        return self.simulator.tolerances

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
            if 2 <= kept < record.samples:
                notes.append(
                    f"{record.name}: samples after {record.time[kept - 1]:.4g} s are not used, "
                    f"{self.until.after_turn:g} s after the reversal of {self.until.output}: later "
                    "samples are chaotic and are excluded (--set until=end, in Python "
                    "until=math.inf, uses them)"
                )
                record = record.cut(0, kept)
            cut.append(with_error(record, turn))
        far = unreached(self.simulator, cut)
        notes += [far] * bool(far)
        return Ready(self if model.carried == self.carried else model, tuple(cut), tuple(notes))

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
            self.simulator.chosen(theta, tuple(included), magnitudes),
            provenance=provenance,
            besides=[t.name for t in included if not isinstance(t.effect.data, Entry)],
            force=force,
        )

    # --- simulations and derivatives --------------------------------------------------------------

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """Simulate jobs; equal versions of the mechanism are run once."""
        outputs = np.full((jobs.count, record.samples, len(self.outputs)), np.nan)
        sizes = jobs.magnitudes if jobs.included else np.zeros((jobs.count, 0))
        groups: dict[bytes, list[int]] = {}
        for b in range(jobs.count):
            key = key_of(record, jobs.theta[b], jobs.included, sizes[b])
            groups.setdefault(key, []).append(b)

        def work(rows: list[int]) -> None:
            first = rows[0]
            motion = self.simulator.motion(record, jobs.theta[first], jobs.included, sizes[first])
            if motion is not None:
                outputs[rows] = motion

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
        wanted, effects = request.parameters_of(self), (*included, *request.candidates)
        base = self.simulator.motion(record, theta, included, request.sizes)
        none = np.zeros((record.samples, len(self.outputs), 0))
        if base is None:
            base = np.full(none.shape[:2], np.nan)
            counts = (len(wanted), len(effects), len(request.input_changes))
            by, of, by_inputs = (np.zeros((*base.shape, k)) for k in counts)
        else:
            point = SimulatedPoint(record, theta, included, request.sizes, base)
            by, of, by_inputs = self.derivatives.at(point, wanted, effects, request.input_changes)
        return Sensitivity(
            outputs=base,
            d_theta=by,
            d_magnitudes=of[..., : len(included)],
            d_starts=none,
            d_candidates=of[..., len(included) :],
            d_inputs=by_inputs,
        )


def varies(parameter: Parameter) -> bool:
    """Whether a parameter scales a law of felt or friction, which vary from stroke to stroke."""
    return parameter.unit == "1" and parameter.name.startswith(VARYING)
