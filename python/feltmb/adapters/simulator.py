"""Simulation of a mechanism over whole records, with changed parameters and included effects.

Every record starts at rest, for all parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from feltmb import _core
from feltmb.adapters.changes import Configurations, Entry
from feltmb.adapters.effects import parameter_of, user_unit_of
from feltmb.mechanism import Action, MechanismFile, describe
from unmodeled.data import Array, Record, evenly_spaced
from unmodeled.data.smoothing import LEAST_SAMPLES, smooth_record
from unmodeled.errors import DataError, Error, InvalidParameter
from unmodeled.fit import Candidate
from unmodeled.fit.running import Latest

__all__ = [
    "DISPLACEMENT",
    "FORCE",
    "Drive",
    "Drives",
    "MechanismSimulator",
    "Variant",
    "Workshop",
    "at_times",
    "input_of",
    "key_of",
    "output_rate",
    "start_state",
]

#: Outputs of the finger: its force [N], and its displacement [m].
FORCE, DISPLACEMENT = "finger.force", "finger.displacement"

#: Number of cached smoothed motions; a diagnosis uses each of them thousands of times.
SMOOTHED = 256
#: Number of cached part definitions: versions of a mechanism share most of theirs.
PARTS = 5000
#: Largest number of steps per second of a record [1/s], ten times those of a staccato: a mechanism
#: with absurd parameters takes minutes.
MOST_STEPS = 1e6
#: Number of cached simulated motions.
MOTIONS = 64
#: Number of cached versions of the mechanism: all of one linearization.
VERSIONS = 400
#: Output samples per short interval of a record with an uneven clock. A tenth of its intervals are
#: shorter.
FINER, SHORT = 8.0, 0.1


T = TypeVar("T")
R = TypeVar("R")


# ------------------------------------------------------------------------------------- inputs


@dataclass(frozen=True)
class Drive:
    """Input of a record: force of the finger [N], or displacement of the key front [m]."""

    time: Array
    value: Array
    motion: bool

    @cached_property
    def profile(self) -> _core.Profile:
        """Input over the time from the first sample.

        A force is interpolated without overshoot. A motion is a spline, because its acceleration
        matters.
        """
        kind = _core.Interpolation.spline if self.motion else _core.Interpolation.monotone
        return _core.Profile(list(self.time - self.time[0]), list(self.value), kind)

    @cached_property
    def input(self) -> _core.InputSignal:
        """Input of the core."""
        return _core.InputSignal(self.profile, "key_motion" if self.motion else "force")


class Drives:
    """Inputs of records; a noisy motion is smoothed once and cached."""

    def __init__(self) -> None:
        self._smoothed: Latest[tuple[object, ...], Array] = Latest(SMOOTHED)

    def of(self, record: Record) -> Drive:
        """Input of a record.

        Raises
        ------
        DataError
            The input of the input mode is missing.
        """
        motion, wanted = record.input_mode == "motion", input_of(record)
        if wanted not in record.inputs:
            raise DataError(
                f"record {record.name}: input {wanted!r} is missing "
                f"(inputs are {', '.join(record.inputs) or 'none'}); "
                f"input_mode {record.input_mode!r} needs it"
            )
        value, sigma = record.inputs[wanted], record.input_sigma.get(wanted, 0.0)
        if motion and sigma > 0.0 and value.size >= LEAST_SAMPLES:
            key = (record.time.tobytes(), value.tobytes(), sigma)
            noisy = value
            value = self._smoothed.get(key, lambda: smooth_record(record.time, noisy, sigma))
        return Drive(record.time, value, motion)


def start_state(action: Action, v: Variant, drive: Drive) -> Array:
    """Full state at the first sample: at rest, but the joint of the finger follows a motion."""
    full = v.rest.copy()
    if not drive.motion:
        return full
    finger = action.config.finger
    assert finger is not None
    coordinates = list(v.mechanism.coordinates)
    k = coordinates.index(action.config.bodies[finger.body].coordinate)
    n, profile = len(coordinates), drive.profile
    wanted = v.finger_reference + float(profile.value(0.0))

    def place(q: Array) -> float:
        return float(_core.finger_place(v.mechanism, q))

    step = 1e-6
    for _ in range(4):
        here = place(full[:n])
        ahead = full[:n].copy()
        ahead[k] += step
        full[k] -= (here - wanted) * step / (place(ahead) - here)
    full[n + k] = 0.0
    here = place(full[:n])
    ahead = full[:n].copy()
    ahead[k] += step
    lever = (place(ahead) - here) / step
    drift = (place(full[:n] + step * full[n : 2 * n]) - here) / step
    full[n + k] = (float(profile.rate(0.0)) - drift) / lever
    return full


def input_of(record: Record) -> str:
    """Name of the input for the input mode of a record."""
    return "displacement" if record.input_mode == "motion" else "force"


# -------------------------------------------------------------------------- versions at rest


class Variant:
    """One mechanism and its rest pose.

    The rest pose is computed when it is needed.

    Parameters
    ----------
    mechanism
        Mechanism, assembled for the core.
    finger
        Whether it has a finger.

    Raises
    ------
    ModelError
        The mechanism has no rest pose; raised by every attribute that needs it.
    """

    def __init__(self, mechanism: _core.Mechanism, *, finger: bool):
        self.mechanism = mechanism
        self._finger = finger

    @property
    def states(self) -> tuple[int, int, int]:
        """Numbers of coordinates, of states of laws, and of modes of strings."""
        m = self.mechanism
        return len(m.coordinates), len(m.law_state_names), m.total_modes

    @cached_property
    def _rest(self) -> Mapping[str, Any]:
        return _core.find_equilibrium(self.mechanism)

    @cached_property
    def rest(self) -> Array:
        """Full state [q, v, law states, eta, d eta/dt] at rest."""
        q = np.asarray(self._rest["q"])
        modes = np.zeros(self.mechanism.total_modes)
        inner = (self._rest["law"], self._rest["eta"])
        return np.concatenate([q, np.zeros(q.size), *inner, modes])

    @cached_property
    def memory(self) -> Array:
        """Compressions that the contacts remember at rest [m]."""
        return np.asarray(self._rest["largest_compression"])

    @cached_property
    def points(self) -> Mapping[str, tuple[float, float]]:
        """Positions of the tracking points at rest [m]."""
        points = {}
        for index, name in enumerate(self.mechanism.point_names):
            x, y = _core.point_position(self.mechanism, index, self._rest["q"])
            points[name] = (float(x), float(y))
        return points

    @cached_property
    def finger_reference(self) -> float:
        """Position of the finger along its direction at rest [m]; 0 without a finger."""
        if not self._finger:
            return 0.0
        return float(_core.finger_place(self.mechanism, self._rest["q"]))


class Workshop:
    """Builds variants, with the parts that they share; usable from several threads."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Any]] = {}

    def build(self, config: MechanismFile) -> Variant:
        """Assemble a configuration and compute its rest pose.

        Raises
        ------
        InvalidParameter, ModelError
            These values define no valid mechanism, or it has no rest pose.
        """
        variant = self.assemble(config)
        _ = variant.rest
        return variant

    def assemble(self, config: MechanismFile) -> Variant:
        """Assemble a configuration; its rest pose is computed when it is needed.

        Raises
        ------
        InvalidParameter
            These values define no valid mechanism.
        """
        if len(self._known) > PARTS:
            self._known = {}
        return Variant(
            _core.assemble(describe(config, self._known)), finger=config.finger is not None
        )


# ----------------------------------------------------------------------------------- motions


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
                user_unit=user_unit_of(e, action.config),
            )
            for e in self.tolerances
        )
        """The tolerances as parameters of a fit."""
        self.drives = Drives()
        """Inputs of the mechanism in a record."""
        self._workshop = Workshop()
        self._configurations = Configurations(action.config)
        self._motions: Latest[tuple[object, ...], Array | None] = Latest(MOTIONS)
        self._versions: Latest[tuple[object, ...], Variant] = Latest(VERSIONS)
        try:
            self.base = self._workshop.build(action.config)
        except Error as error:
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
        return self._configurations.of(chosen, record.conditions)

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

    # --- motions ----------------------------------------------------------------------------------

    def motion(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Array | None:
        """Outputs of a version over the whole record, (n, ny); None if it failed."""

        def make() -> Array | None:
            try:
                config = self._config(record, theta, included, magnitudes)
                variant = self._workshop.build(config)
            except Error:
                return None
            return self.whole(record, variant)

        place = (record.excitation, key_of(record, theta, included, magnitudes))
        return self._motions.get(place, make)

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
        except (RuntimeError, ValueError, Error):
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

    def in_parallel(
        self, work: Callable[[T], R], tasks: Sequence[T], place: Callable[[T], object] = id
    ) -> list[R]:
        """Results of tasks, from the threads; they do not depend on the number of threads.

        Tasks of the same place run one after another.
        """
        groups: dict[object, list[int]] = {}
        for k, task in enumerate(tasks):
            groups.setdefault(place(task), []).append(k)

        def run(group: list[int]) -> list[tuple[int, R]]:
            with np.errstate(all="ignore"):  # each thread has its own
                return [(k, work(tasks[k])) for k in group]

        with ThreadPoolExecutor(self.workers) as pool:
            results = dict(pair for pairs in pool.map(run, groups.values()) for pair in pairs)
        return [results[k] for k in range(len(tasks))]


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


def output_rate(time: Array) -> float:
    """Rate of the outputs of a simulation from which :func:`at_times` takes the samples [Hz].

    With an even clock, every output is a sample.
    """
    if evenly_spaced(time):
        return (time.size - 1) / float(time[-1] - time[0])
    duration = float(time[-1] - time[0])
    step = float(np.quantile(np.diff(time), SHORT))
    return math.ceil(FINER * duration / step) / duration


def at_times(simulated: Array, values: Array, time: Array) -> Array:
    """Values (n, ...) at the times of the samples, from values at the times of the simulation.

    They are returned unchanged if the clock of the samples is even, else interpolated by cubic
    polynomials.
    """
    if simulated.size == time.size and evenly_spaced(time):
        return values
    from scipy.interpolate import CubicHermiteSpline

    slope = np.gradient(values, simulated, axis=0)
    between: Array = CubicHermiteSpline(simulated, values, slope, axis=0)(time)
    return between
