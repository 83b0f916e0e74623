"""Small key-hammer model with its library of effects: the model of the blind bench.

Two masses, the key front x and the hammer tip h: jack felt with let-off, bed felt, string felt,
backcheck; driven by a finger force or by a stiff actuator that follows a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blind.lumped import Network
from unmodeled.data import Array, Record
from unmodeled.fit import (
    Candidate,
    Effect,
    Jobs,
    Model,
    Parameter,
    Port,
    Sensitivity,
    SensitivityRequest,
    State,
)

__all__ = ["SAMPLE_TIME", "KeyHammer", "effects"]

SAMPLE_TIME = 0.5e-3
RATIO = 5.0
SUBSTEPS = 2

#: name, value, tolerance (sd), unit, component
PARAMETERS = (
    ("key_mass", 0.080, 0.03 * 0.080, "kg", "key"),
    ("hammer_mass", 0.0090, 0.03 * 0.0090, "kg", "hammer"),
    ("jack_stiffness", 1.5e5, 0.08 * 1.5e5, "N/m^1.5", "jack felt"),
    ("letoff_position", 8.2e-3, 0.2e-3 / 5.0, "m", "let-off"),
    ("bed_stiffness", 5.0e7, 0.08 * 5.0e7, "N/m^p", "bed felt"),
    ("bed_exponent", 2.0, 0.1, "1", "bed felt"),
    ("bed_position", 9.6e-3, 0.2e-3, "m", "bed felt"),
    ("string_stiffness", 1.5e8, 0.08 * 1.5e8, "N/m^p", "string felt"),
    ("string_exponent", 2.4, 0.1, "1", "string felt"),
    ("check_position", 30.0e-3, 0.5e-3, "m", "backcheck"),
    ("key_damping", 1.0, 0.2, "N s/m", "key pivot"),
    ("hammer_damping", 0.020, 0.004, "N s/m", "hammer pivot"),
    ("key_balance", 0.25, 0.05, "N", "key"),
    ("hammer_spring_rate", 2.0, 0.16, "N/m", "butt spring"),
    ("camera_skew", 0.15e-3, 0.1e-3, "s", "hammer camera"),
)

#: name, component, unit, magnitude expected, sign, kind, remedy, mechanism
EFFECTS: tuple[tuple[str, str, str, float, int, str, str, str], ...] = (
    ("key_dry_friction", "key pivot", "N", 0.1, 1, "force", "ease the bushing",
     "A dry friction force opposes the motion of the key."),
    ("hammer_dry_friction", "hammer pivot", "N", 0.02, 1, "force", "ease the center",
     "A dry friction force opposes the motion of the hammer."),
    ("hammer_drag", "hammer", "N s^2/m^2", 0.003, 1, "force", "add air drag",
     "A force that grows with the square of the speed opposes the hammer."),
    ("spring_preload", "butt spring", "N", 0.02, 0, "force", "regulate the butt spring",
     "The butt spring pushes with a constant force more than assumed."),
    ("hammer_bridle", "bridle strap", "N/m", 5.0, 1, "force", "lengthen the strap",
     "A strap between key and hammer pulls back once the hammer has run ahead of the key."),
    ("jack_hysteresis", "jack felt", "s/m", 0.3, 1, "force", "use a felt law with memory",
     "The jack felt gives back less force in unloading than in loading."),
    ("bed_hysteresis", "bed felt", "s/m", 0.2, 0, "force", "use a felt law with memory",
     "The bed felt loses more or less energy in an impact than assumed."),
    ("string_hysteresis", "string felt", "s/m", 0.05, 0, "force", "use a felt law with memory",
     "The hammer felt loses more or less energy in an impact than assumed."),
    ("bed_creep", "bed felt", "m/N", 2e-5, 1, "state", "add a creep branch",
     "Under load the bed felt gives way with time and recovers slowly."),
    ("string_compliance", "string", "m/N", 5e-6, 1, "state", "let the string move",
     "The string gives way under the hammer and springs back."),
    ("shank_flexibility", "shank", "m/N", 5e-5, 1, "state", "add a bending mode of the shank",
     "The shank bends under the jack's force, so that the hammer head lags the butt."),
    ("lost_motion", "jack felt", "m", 2e-4, 1, "kinematic", "regulate the capstan",
     "The jack has a gap to close before it lifts the hammer."),
    ("hammer_wear", "string felt", "m", 2e-4, 0, "kinematic", "measure the striking distance",
     "The hammer meets the string later than assumed (or earlier)."),
    ("check_friction", "backcheck", "s/m", 2.0, 0, "force", "measure the check leather",
     "The backcheck damps the caught hammer more or less than assumed."),
    ("rest_felt_hardening", "back rail", "N/m^1.5", 2e5, 0, "force", "measure the rail felt",
     "The felt below the resting key is harder or softer than assumed."),
    ("key_flexibility", "key", "m/N", 2e-5, 1, "kinematic", "add the bending of the key",
     "The key bends, so that the measured point moves with the finger's force."),
    ("key_spring", "key", "N/m", 10.0, 0, "force", "add a spring at the key",
     "A spring acts on the key over its whole travel."),
    ("input_gain", "input", "1", 0.02, 0, "input", "calibrate the input sensor",
     "The input sensor has another gain."),
    ("input_offset", "input", "N or mm", 0.05, 0, "input", "zero the input sensor",
     "The input sensor has an offset."),
    ("input_delay", "input", "s", 2e-4, 0, "input", "check the clocks",
     "The recorded input comes early or late."),
    ("hammer_scale", "hammer camera", "1", 0.005, 0, "sensor", "calibrate the camera",
     "The hammer's camera has another scale."),
    ("hammer_offset", "hammer camera", "m", 2e-4, 0, "sensor", "check the tracked point",
     "The tracked point of the hammer is off by a constant."),
)  # fmt: skip

#: hidden states that an effect brings
HIDDEN = {
    "bed_creep": ("bed_set",),
    "string_compliance": ("string_give",),
    "shank_flexibility": ("shank_bend", "shank_bend_rate"),
}
SCALES = {
    "key": 1e-3,
    "hammer": 5e-3,
    "key_speed": 0.2,
    "hammer_speed": 1.0,
    "bed_set": 1e-4,
    "string_give": 1e-4,
    "shank_bend": 1e-4,
    "shank_bend_rate": 0.05,
}
MOTION_OFFSET = 1e-3  # an offset of 1 in the table is 1 mm for motion
ACTUATOR = (2.0e4, 20.0)  # stiffness [N/m] and damping [N s/m] of the motion drive


def effects() -> tuple[Effect, ...]:
    """Return the library of the key-hammer model."""
    return tuple(
        Effect(
            name=name,
            component=component,
            unit=unit,
            scale=scale,
            sign=sign,  # type: ignore[arg-type]
            kind=kind,  # type: ignore[arg-type]
            remedy=remedy,
            mechanism=mechanism,
            hidden=tuple(
                State(name=s, unit="m/s" if s.endswith("rate") else "m", scale=SCALES[s],
                      start_sd=0.0, hidden=True)
                for s in HIDDEN.get(name, ())
            ),
        )
        for name, component, unit, scale, sign, kind, remedy, mechanism in EFFECTS
    )  # fmt: skip


#: Distance over which let-off and backcheck engage [m].
GATE_WIDTH = 1e-4


def describe(mode: str, width: float | str = GATE_WIDTH) -> dict[str, Any]:
    """Return the network; `mode` is force or motion, `width` that of let-off and backcheck [m]."""
    jack = {"key": RATIO, "hammer": -1.0}
    elements: list[dict[str, Any]] = [
        {
            "name": "jack",
            "kind": "contact",
            "coordinates": jack,
            "offset": "-lost_motion",
            "stiffness": "jack_stiffness",
            "exponent": 1.5,
            "loss": [0.3, "jack_hysteresis"],
            "gates": [
                # Let-off: the jack leaves when the key has passed the let-off position ...
                {"coordinates": {"key": -1.0}, "offset": "letoff_position", "width": width},
                # ... and does not push while the hammer hangs too far behind for it to be below.
                {"coordinates": {"key": -RATIO, "hammer": 1.0}, "offset": 2e-3, "width": 2e-4},
            ],
        },
        {
            "name": "bed",
            "kind": "contact",
            "coordinates": {"key": 1.0},
            "hidden": {"bed_set": -1.0},
            "offset": "-bed_position",
            "stiffness": "bed_stiffness",
            "exponent": "bed_exponent",
            "loss": [1.0, "bed_hysteresis"],
        },
        {
            "name": "string",
            "kind": "contact",
            "coordinates": {"hammer": 1.0},
            "hidden": {"string_give": -1.0, "shank_bend": -1.0},
            "offset": [-45.0e-3, "-hammer_wear"],
            "stiffness": "string_stiffness",
            "exponent": "string_exponent",
            "loss": [0.15, "string_hysteresis"],
        },
        {
            "name": "check",
            "kind": "contact",
            "coordinates": {"hammer": -1.0},
            "offset": "check_position",
            "stiffness": 3.0e5,
            "exponent": 1.5,
            "loss": [5.0, "check_friction"],
            "gates": [{"coordinates": {"key": 1.0}, "offset": -8.6e-3, "width": width}],
        },
        {
            "name": "key_rest",
            "kind": "contact",
            "coordinates": {"key": -1.0},
            "stiffness": [1.0e6, "rest_felt_hardening"],
            "exponent": 1.5,
            "loss": 3.0,
        },
        {
            "name": "hammer_rest",
            "kind": "contact",
            "coordinates": {"hammer": -1.0},
            "stiffness": 1.0e5,
            "exponent": 1.5,
            "loss": 3.0,
        },
        {"name": "key_balance", "kind": "drive", "coordinates": {"key": 1.0},
         "constant": "-key_balance"},
        {"name": "key_spring", "kind": "spring", "coordinates": {"key": 1.0},
         "stiffness": "key_spring"},
        {"name": "butt_spring", "kind": "spring", "coordinates": {"hammer": 1.0},
         "stiffness": "hammer_spring_rate"},
        {"name": "butt_preload", "kind": "drive", "coordinates": {"hammer": -1.0},
         "constant": [0.05, "spring_preload"]},
        {"name": "key_friction", "kind": "friction", "coordinates": {"key": 1.0},
         "viscous": "key_damping", "coulomb": "key_dry_friction", "sliding_speed": 5e-3},
        {"name": "hammer_friction", "kind": "friction", "coordinates": {"hammer": 1.0},
         "viscous": "hammer_damping", "coulomb": "hammer_dry_friction", "sliding_speed": 2.5e-2,
         "quadratic": "hammer_drag"},
        {
            "name": "bridle",
            "kind": "contact",
            "coordinates": {"hammer": 1.0, "key": -RATIO},
            "offset": -1.0e-3,
            "stiffness": "hammer_bridle",
            "exponent": 1.0,
        },
    ]  # fmt: skip
    if mode == "force":
        elements.append(
            {"name": "finger", "kind": "drive", "coordinates": {"key": 1.0}, "input": 1.0}
        )
    else:
        elements.append(
            {"name": "finger", "kind": "spring", "coordinates": {"key": 1.0}, "input": -1.0,
             "stiffness": ACTUATOR[0], "damping": ACTUATOR[1]}
        )  # fmt: skip
    return {
        "masses": {"key": "key_mass", "hammer": "hammer_mass"},
        "elements": elements,
        "hidden": {
            "bed_set": {"kind": "lag", "sources": ["bed"], "gain": "bed_creep", "time": 30e-3},
            "string_give": {
                "kind": "lag",
                "sources": ["string"],
                "gain": "string_compliance",
                "time": 1e-3,
            },
            "shank_bend": {
                "kind": "mode",
                "sources": ["jack"],
                "gain": "shank_flexibility",
                "omega": 2.0 * np.pi * 50.0,
                "damping": 0.05,
            },
        },
        "sensors": {
            # The force of a drive is counted against the coordinate: the key bends by -force.
            "key": {"coordinates": {"key": 1.0}, "element": "finger",
                    "flexibility": "-key_flexibility"},
            "hammer": {"coordinates": {"hammer": 1.0}, "hidden": {"shank_bend": -1.0},
                       "scale": "hammer_scale", "gauge_offset": "hammer_offset",
                       "delay": "camera_skew"},
        },
        "input": {"gain": "input_gain", "offset": "input_offset", "delay": "input_delay"},
    }  # fmt: skip


class KeyHammer(Model):
    """Model of the blind bench: key front and hammer tip, by force or by motion.

    Outputs ``key`` and ``hammer`` [m]; the input is called ``finger`` [N] or [m], by the record's
    ``input_mode``. Records are sampled at 2 kHz.
    """

    name = "key_hammer"
    outputs = ("key", "hammer")
    units = MappingProxyType({"key": "m", "hammer": "m"})
    chaotic = True
    cheap_derivatives = True
    ports = (
        Port(name="key", component="key", unit="N", scale=0.1),
        Port(name="hammer", component="hammer", unit="N", scale=0.02),
    )

    def __init__(self, *, width_sd: float = 0.0) -> None:
        parameters = tuple(
            Parameter(name=n, value=v, sd=sd, unit=u, component=c, lower=0.2 * v, upper=3.0 * v)
            if n != "camera_skew"
            else Parameter(name=n, value=v, sd=sd, unit=u, component=c, lower=-2e-4, upper=5e-4)
            for n, v, sd, u, c in PARAMETERS
        )
        width: float | str = GATE_WIDTH
        if width_sd > 0.0:
            width = "gate_width"
            own = Parameter(
                name=width, value=GATE_WIDTH, sd=width_sd, unit="m", component="let-off",
                lower=0.2 * GATE_WIDTH, upper=3.0 * GATE_WIDTH,
            )  # fmt: skip
            parameters = (*parameters, own)
        self.parameters = parameters
        self._effects = tuple(e[0] for e in EFFECTS)
        names = (*(p.name for p in self.parameters), *self._effects)
        self._networks = {
            mode: Network(describe(mode, width), names, sample_time=SAMPLE_TIME, substeps=SUBSTEPS)
            for mode in ("force", "motion")
        }
        self._states = self._networks["force"].states
        self._base = tuple(
            State(
                name=s,
                unit="m/s" if s.endswith("speed") else "m",
                scale=SCALES[s],
                start=0.0,
                start_sd={"key": 3e-4, "hammer": 5e-4, "key_speed": 5e-3, "hammer_speed": 2e-2}[s],
            )
            for s in self._states[:4]
        )

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """Base states, then the hidden ones of the included effects."""
        return (*self._base, *(s for t in included for s in t.effect.hidden))

    def accepts(self, effect: Effect) -> bool:
        """Whether the effect is of this library, or needs no help."""
        return effect.name in self._effects or super().accepts(effect)

    def _known(self, included: Sequence[Candidate]) -> list[tuple[int, int]]:
        """Included effects that this model applies: (index among them, index of the parameter)."""
        n = len(self.parameters)
        return [
            (k, n + self._effects.index(t.name))
            for k, t in enumerate(included)
            if t.name in self._effects
        ]

    def _rows(
        self, record: Record, theta: Array, included: Sequence[Candidate], magnitudes: Array
    ) -> Array:
        full = np.zeros((theta.shape[0], len(self.parameters) + len(self._effects)))
        full[:, : len(self.parameters)] = theta
        for k, place in self._known(included):
            full[:, place] = magnitudes[:, k] * self._unit(record, place)
        return full

    def _unit(self, record: Record, place: int) -> float:
        offset = len(self.parameters) + self._effects.index("input_offset")
        return MOTION_OFFSET if place == offset and record.input_mode == "motion" else 1.0

    def _places(self, included: Sequence[Candidate]) -> list[int]:
        """Where the states (included effects) are among those of the network."""
        return [self._states.index(s.name) for s in self.states(included)]

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """Simulate every job in one call of the core."""
        rows = self._rows(record, jobs.theta, jobs.included, jobs.magnitudes)
        changed = np.any(rows[1:] != rows[:-1], axis=1)
        row = np.concatenate([[0], np.cumsum(changed)]).astype(np.intc)
        rows = rows[np.concatenate([[True], changed])]
        starts = np.zeros((jobs.count, len(self._states)))
        places = self._places(jobs.included)
        starts[:, places] = jobs.starts
        unknown = jobs.forces
        outputs, _, _, _, _ = self._network(record).simulate(
            rows, [record.inputs["finger"]], _whole(record, row), starts, unknown=unknown
        )
        return np.asarray(outputs).reshape(jobs.count, record.samples, -1)

    def _network(self, record: Record) -> Network:
        return self._networks[record.input_mode]

    def sensitivities(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """Exact derivatives of the discrete scheme, in one pass; see the base class."""
        return [self._sensitivity(request) for request in requests]

    def _sensitivity(self, request: SensitivityRequest) -> Sensitivity:
        record, theta = request.record, request.theta
        included, candidates = request.included, request.candidates
        by_starts, wanted_theta = request.by_starts, request.parameters_of(self)
        of_included = self._known(included)
        of_candidates = self._known(candidates)
        wanted = [*wanted_theta, *(p for _, p in of_included), *(p for _, p in of_candidates)]
        places = self._places(included)
        states = [*places] if by_starts else []
        full = np.zeros((1, len(self._states)))
        full[:, places] = request.start
        rows = self._rows(record, theta[None, :], included, request.sizes[None, :])
        y, _, dy, _, _ = self._network(record).simulate(
            rows,
            [record.inputs["finger"]],
            _whole(record, np.zeros(1, dtype=np.intc)),
            full,
            wanted=wanted,
            wanted_states=states,
        )
        for column, place in enumerate(wanted):
            unit = self._unit(record, place) if place >= len(self.parameters) else 1.0
            if unit != 1.0:
                dy[..., column] *= unit
        y = np.asarray(y).reshape(record.samples, -1)
        dy = np.asarray(dy).reshape(*y.shape, -1)
        n_t, n_k, n_c = len(wanted_theta), len(of_included), len(of_candidates)
        first = n_t + n_k + n_c
        return Sensitivity(
            outputs=y,
            d_theta=dy[..., :n_t],
            d_magnitudes=_scatter(dy[..., n_t : n_t + n_k], of_included, len(included)),
            d_starts=dy[..., first : first + len(places)] if by_starts else dy[..., :0],
            d_candidates=_scatter(dy[..., n_t + n_k : first], of_candidates, len(candidates)),
        )


def _whole(record: Record, row: NDArray[np.intc]) -> NDArray[np.intc]:
    """The whole record, once for each row of parameters, as the network takes it."""
    zero = np.zeros(len(row))
    return np.column_stack([zero, zero, zero + record.samples - 1, row]).astype(np.intc)


def _scatter(values: Array, known: Sequence[tuple[int, int]], count: int) -> Array:
    if len(known) == count:
        return values
    out = np.zeros((*values.shape[:-1], count))
    for column, (k, _) in enumerate(known):
        out[..., k] = values[..., column]
    return out
