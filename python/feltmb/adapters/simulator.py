"""Simulation of a mechanism over whole records, with changed parameters and included effects.

Every record starts at rest, for all parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from feltmb import _core
from feltmb.adapters.aliases import Alias, alias_of
from feltmb.adapters.drives import DISPLACEMENT, FORCE, Drives, start_state
from feltmb.adapters.effects import parameter_of
from feltmb.adapters.library import Entry
from feltmb.adapters.sampling import at_times, output_rate
from feltmb.adapters.shifter import Shifter
from feltmb.adapters.variants import Variant, Workshop
from feltmb.data import Array, Record
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.fit import Candidate
from feltmb.fit.latest import Latest
from feltmb.mechanism import Action, MechanismFile

__all__ = ["MechanismSimulator", "key_of"]

#: Largest number of steps per second of a record [1/s], ten times those of a staccato: a mechanism
#: with absurd parameters takes minutes.
MOST_STEPS = 1e6
#: Number of cached simulated motions.
MOTIONS = 64
#: Number of cached versions of the mechanism: all of one linearization.
VERSIONS = 400


class MechanismSimulator:
    """Simulates versions of a mechanism; the last motions and versions are cached.

    Several threads may use it.

    Parameters
    ----------
    action
        The mechanism with its tabulated values.
    outputs
        Names such as ``hammer_tip.x`` (displacement from rest [m]), ``finger.force`` [N] or
        ``finger.displacement`` [m].
    tolerances
        Parameters of the versions.
    rtol
        Relative tolerance of the integrator [1].
    workers
        Number of threads.

    Raises
    ------
    InvalidParameter
        The mechanism has no rest pose, or an output does not exist.
    """

    def __init__(
        self,
        action: Action,
        outputs: Sequence[str],
        tolerances: Sequence[Entry],
        *,
        rtol: float,
        workers: int,
    ):
        self.action = action
        self.outputs = tuple(outputs)
        self.tolerances = tuple(tolerances)
        self.rtol = rtol
        self.workers = workers
        self.units = {o: "N" if o == FORCE else "m" for o in self.outputs}
        """Units of the outputs."""
        self.parameters = tuple(
            replace(
                parameter_of(e),
                label=e.part or f"The {e.component}",
                relative=e.unit == "1",
            )
            for e in self.tolerances
        )
        """The tolerances as parameters of a fit."""
        self.drives = Drives()
        """Inputs of the mechanism in a record."""
        self._aliases: dict[str, Alias | None] = {}
        self._workshop = Workshop()
        self._shifter = Shifter(action.config)
        self._motions: Latest[tuple[object, ...], Array | None] = Latest(MOTIONS)
        self._versions: Latest[tuple[object, ...], Variant] = Latest(VERSIONS)
        try:
            self.base = self._workshop.build(action.config)
        except FeltmbError as error:
            raise InvalidParameter(f"mechanism {action.name!r} has no rest pose: {error}") from None
        self._check_outputs()

    def _check_outputs(self) -> None:
        known = [f"{p}.{axis}" for p in self.base.points for axis in "xy"]
        if self.action.config.finger is not None:
            known += [FORCE, DISPLACEMENT]
        unknown = [o for o in self.outputs if o not in known]
        if unknown:
            raise InvalidParameter(
                f"outputs {', '.join(unknown)}: mechanism {self.action.name!r} has "
                f"{', '.join(known) or 'no tracking points'}"
            )

    # --- versions of the mechanism ----------------------------------------------------------------

    def version(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Variant:
        """The mechanism with given parameters and magnitudes, under the conditions of a record.

        Raises
        ------
        InvalidParameter
            These values define no valid mechanism.
        """

        def make() -> Variant:
            config = self._config(record, theta, included, magnitudes)
            return self.base if config is self.action.config else self._workshop.assemble(config)

        # All records of one linearization need the same versions.
        conditions = tuple(sorted(record.conditions.items()))
        return self._versions.get((key_of(record, theta, included, magnitudes), conditions), make)

    def _config(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> MechanismFile:
        chosen = self.chosen(theta, included, magnitudes)
        return self._shifter.config(chosen, record.conditions)

    def chosen(
        self, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> list[tuple[Entry, float, float | None]]:
        """Entries of the library with their magnitudes and shapes."""
        out: list[tuple[Entry, float, float | None]] = [
            (e, float(v), None) for e, v in zip(self.tolerances, theta, strict=True)
        ]
        for candidate, magnitude in zip(included, magnitudes, strict=True):
            if isinstance(candidate.effect.data, Entry):
                out.append((candidate.effect.data, float(magnitude), candidate.shape))
        return out

    def at_rest(self, variant: Variant, output: str) -> float:
        """Value of an output at rest: position of the tracking point [m]; 0 for a force."""
        point, _, axis = output.rpartition(".")
        return variant.points[point]["xy".index(axis)] if point in variant.points else 0.0

    def alias(self, entry: Entry) -> Alias | None:
        """Tolerance that changes the same values as an effect of the library, or None."""
        if entry.name not in self._aliases:
            self._aliases[entry.name] = alias_of(self.action.config, entry, self.tolerances)
        return self._aliases[entry.name]

    # --- motions ----------------------------------------------------------------------------------

    def motion(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Array | None:
        """Outputs of a version over the whole record, (n, ny); None if it failed."""

        def make() -> Array | None:
            try:
                config = self._config(record, theta, included, magnitudes)
                variant = self._workshop.build(config)
            except FeltmbError:
                return None
            return self.whole(record, variant)

        place = (record.excitation, key_of(record, theta, included, magnitudes))
        return self._motions.get(place, make)

    def as_tabulated(self, record: Record) -> Array | None:
        """Outputs of the tabulated mechanism over a whole record, (n, ny); None if it failed."""
        return self.whole(record, self.base)

    def whole(self, record: Record, variant: Variant) -> Array | None:
        """Outputs of one version over the whole record, (n, ny); None if it failed."""
        run = self.run(record, variant)
        if run is None:
            return None
        time = record.time - record.time[0]
        return self._columns(run, at_times(run.time, run.data, time), variant)

    def raw(self, record: Record, output: str) -> tuple[Array, Array] | None:
        """Time [s] and an output of the tabulated mechanism, as integrated; None if it failed."""
        run = self.run(record, self.base)
        if run is None:
            return None
        column = np.array(run.data)[:, list(run.names).index(output)]
        return record.time[0] + run.time, column - self.at_rest(self.base, output)

    def run(self, record: Record, variant: Variant) -> Any | None:
        """Result of the core for one version; None if the simulation failed."""
        time = record.time - record.time[0]
        options = _core.SimulationOptions()
        options.duration = float(time[-1])
        options.rtol = self.rtol
        options.max_steps = int(MOST_STEPS * options.duration) + 10_000
        options.output_rate = output_rate(time)
        options.ledger = options.events = options.diagnose = False
        options.finger_reference = variant.finger_reference
        drive = self.drives.of(record)
        start = start_state(self.action, variant, drive)
        try:
            result = _core.simulate(
                variant.mechanism,
                drive.input,
                options,
                list(start),
                [],
                None,
                list(variant.memory),
            )
        except (RuntimeError, ValueError, FeltmbError):
            return None
        if result.time.size < 2 or result.reached < time[-1] * (1.0 - 1e-9):
            return None
        return result

    def _columns(self, result: Any, data: Array, variant: Variant) -> Array:
        where = {name: i for i, name in enumerate(result.names)}
        out = np.empty((data.shape[0], len(self.outputs)))
        for o, name in enumerate(self.outputs):
            column = data[:, where[name]] if name in where else np.full(data.shape[0], np.nan)
            out[:, o] = column - self.at_rest(variant, name)
        return out

    def in_parallel(self, work: Callable[[Any], None], tasks: Sequence[Any]) -> None:
        """Run the tasks on the threads; results do not depend on their number."""
        if self.workers <= 1 or len(tasks) < 2:
            for task in tasks:
                work(task)
            return
        with ThreadPoolExecutor(self.workers) as pool:
            futures = [pool.submit(work, task) for task in tasks]
            try:
                for future in futures:
                    future.result()
            finally:  # if the time is over, no further task is started
                for future in futures:
                    future.cancel()


def key_of(
    record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
) -> bytes:
    """Key of a version of a mechanism under the conditions of a record."""
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
