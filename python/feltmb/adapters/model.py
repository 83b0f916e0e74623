"""A mechanism as a model that :mod:`unmodeled.fit` can fit and :mod:`unmodeled` can diagnose.

Outputs are displacements of tracking points from rest [m] and, with motion input, the force of the
finger [N]. Every record starts at rest, for all parameters, and is simulated as a whole, so that a
point of the fit costs one run per record.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from feltmb.adapters.changes import Entry, same_values
from feltmb.adapters.derivatives import Derivatives
from feltmb.adapters.effects import columns_of, effect_of, partners
from feltmb.adapters.findings import action_of_findings
from feltmb.adapters.library import Library, load_library
from feltmb.adapters.records import (
    check_input_zero,
    driven,
    first_turn,
    from_rest,
    landmarks,
    unreached,
    with_force_error,
    with_noise,
)
from feltmb.adapters.simulator import DISPLACEMENT, FORCE, MechanismSimulator, key_of
from feltmb.mechanism import Action, load_action, packaged_actions
from feltmb.mechanism.parameters import with_noted_values
from feltmb.run.stroke import load_stroke
from unmodeled.arguments import checked
from unmodeled.data import Array, Record, Sensor
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import check_suffix, write_text
from unmodeled.fit import (
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
from unmodeled.models.writing import suffixes, write

#: Magnitudes of no effects.
NONE = np.zeros(0)
#: Longest record [s]; the simulation of a wrong clock would take minutes.
LONGEST = 20.0
#: Beginnings of the names of parameters of felt and friction, which vary from stroke to stroke.
VARYING = ("felt.", "joint_friction.", "contact_friction.")

#: Settings of a command: name -> meaning.
SETTINGS = {
    "channels": "channels or outputs, with commas: key,hammer_tip (default: those of the library)",
    "effects": "names or patterns, with commas: felt_*,let_off_button (default: all)",
    "tolerances": "parameters to estimate, names or patterns (default: all of the library)",
    "library": "packaged library of effects or TOML file (default: that of the mechanism)",
    "rtol": "relative tolerance of the integrator (default 1e-6)",
    "until": "time after the impact up to which samples are used in s, or end: all "
    "samples (default: that of the library, 0.01)",
    "variation": "relative change of felt and friction from stroke to stroke "
    "(default 0.01), none: no variation",
}
#: Settings that are numbers: a word in their place, and what it means.
NUMBERS: Mapping[str, tuple[str, float | None]] = {
    "rtol": ("", None),
    "until": ("end", math.inf),
    "variation": ("none", None),
}


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
        if variation is not None and not 0.0 <= variation <= 0.5:
            raise InvalidParameter(f"variation = {variation!r}, expected 0 to 0.5, or None")
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
        self.until = None if until == math.inf else library.until
        if until is not None and until < math.inf:
            if library.until is None:
                raise InvalidParameter(
                    f"until: the library {library.name} does not specify the reversal of a stroke "
                    "(defaults.until); the whole record is used"
                )
            self.until = library.until.model_copy(update={"after_turn": until})
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
        known = True
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
            check_input_zero(record, "displacement")
            record, said, placed = self._referred(record)
            known = known and placed
            notes += said
            record = with_noise(record, notes)
            turn = self._turn(record)
            if turn is not None and self.until is not None:
                last = turn + self.until.after_turn
                kept = int(np.searchsorted(record.time, last + 1e-9, side="right"))
                if 2 <= kept < record.samples:
                    notes.append(
                        f"{record.name}: samples after {record.time[kept - 1]:.4g} s are not used, "
                        f"{self.until.after_turn:g} s after the reversal of {self.until.output}: "
                        "later samples are chaotic and are excluded (--set until=end, in Python "
                        "until=math.inf, uses them)"
                    )
                    record = record.cut(0, kept)
            cut.append(with_error(record, turn))
        # A stroke is cut at its reversal, which a channel without a known zero does not show.
        far = unreached(self.simulator, cut) if known else ""
        notes += [far] * bool(far)
        return Ready(self if model.carried == self.carried else model, tuple(cut), tuple(notes))

    def _referred(self, record: Record) -> tuple[Record, tuple[str, ...], bool]:
        """Channels of tracking points as displacements from rest, also if they are absolute.

        The sensor states whether a channel is absolute, or its first value shows this.
        """
        rest, base = self.simulator.at_rest, self.simulator.base
        at = {o: rest(base, o) for o in self.outputs if self.units[o] == "m"}
        return from_rest(record, at, self.name)

    def _turn(self, record: Record) -> float | None:
        """Time at which the stroke of a record reverses [s]: measured, or else simulated.

        None: it does not reverse, or the whole record is used.
        """
        if self.until is None:
            return None
        name = self.until.output
        if name in record.outputs and np.isfinite(record.outputs[name]).sum() > 10:
            return first_turn(record.time, record.outputs[name])
        turn = self.simulator.raw(record, name)
        return None if turn is None else first_turn(*turn)

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has an :class:`Entry`, or is a sensor or input effect."""
        return isinstance(effect.data, Entry) or super().accepts(effect)

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """Start and end of the key's motion, and reversal of the hammer, if channels show them."""
        return landmarks(record.time, outputs, self.action.config.reading)

    # --- simulations and derivatives --------------------------------------------------------------

    def simulate(self, record: Record, jobs: Jobs) -> Array:  # noqa: D102
        return self.simulate_all([(record, jobs)])[0]

    def simulate_all(  # noqa: D102
        self, batches: Sequence[tuple[Record, Jobs]]
    ) -> list[Array]:
        # All records at once; equal versions of the mechanism are run once.
        versions = [
            (record, jobs.theta[b], jobs.included, jobs.magnitudes[b] if jobs.included else NONE)
            for record, jobs in batches
            for b in range(jobs.count)
        ]
        motions = iter(
            self.simulator.in_parallel(
                lambda version: self.simulator.motion(*version),
                versions,
                lambda version: (version[0].excitation, key_of(*version)),
            )
        )
        failed = [np.full((record.samples, len(self.outputs)), np.nan) for record, _ in batches]
        return [
            np.array([bad if (y := next(motions)) is None else y for _ in range(jobs.count)])
            for (_, jobs), bad in zip(batches, failed, strict=True)
        ]

    def sensitivities(  # noqa: D102
        self, requests: Sequence[SensitivityRequest]
    ) -> list[Sensitivity]:
        # Exact derivatives, those at one point in one pass, or one after another.
        for request in requests:
            request.check(self)
        return self.derivatives.of(requests)


@write.register
def _(
    model: MechanismModel,
    path: Path,
    theta: Array,
    included: Sequence[Candidate],
    magnitudes: Array,
    *,
    provenance: str = "",
    force: bool = False,
) -> Path:
    # The mechanism with these values as TOML.
    check_suffix(path, *suffixes(model))
    changed = action_of_findings(
        model.action,
        model.simulator.chosen(theta, tuple(included), magnitudes),
        provenance=provenance,
        besides=[t.name for t in included if not isinstance(t.effect.data, Entry)],
    )
    return write_text(path, changed.to_toml(), force=force)


def varies(parameter: Parameter) -> bool:
    """Whether a parameter scales a law of felt or friction, which vary from stroke to stroke."""
    return parameter.unit == "1" and parameter.name.startswith(VARYING)


# ------------------------------------------------------------------ with its library, by name


@checked
def mechanism_model(
    action: Action,
    *,
    channels: Sequence[str] = (),
    library: Library | str | None = None,
    effects: Sequence[str] = (),
    tolerances: Sequence[str | Entry] | None = None,
    **options: Any,
) -> tuple[MechanismModel, tuple[Effect, ...]]:
    """A mechanism with its tolerances and effects as a model of a fit or a diagnosis.

    Parameters
    ----------
    channels
        Channel names of the library (``key``, ``hammer_tip``) or outputs (``hammer_tip.x``);
        default: the default channels of the library.
    library
        A library, its name or path; default: the library of the mechanism.
    effects
        Names or patterns (``felt_*``); default: all effects of the library.
    tolerances
        Parameters that a fit estimates: names, patterns or entries of the library; default: all of
        the library. An empty list: none.
    options
        Options of :class:`MechanismModel`.

    Raises
    ------
    InvalidParameter
        A name is unknown; the message has the nearest known ones. A text is given instead of a list
        of names.
    """
    if not isinstance(library, Library):
        library = load_library(action, library)
    estimated = _chosen(library, tolerances)
    model = MechanismModel(
        action, library, library.outputs(channels), tolerances=estimated, **options
    )
    made = []
    for e in library.select(effects):
        if not _can_show(model, e):
            continue
        effect = effect_of(e, model.outputs, library.channels)
        if (same := same_values(action.config, e, model.tolerances)) is not None:
            tolerance, ratio = same
            effect = replace(effect, tolerance_parameter=tolerance.name, tolerance_ratio=ratio)
        made.append(effect)
    model.effects, model.offers_all = tuple(made), True
    return model, model.effects


def _chosen(library: Library, tolerances: Sequence[str | Entry] | None) -> tuple[Entry, ...]:
    """Tolerances by name, pattern or entry; None: all of the library."""
    if tolerances is None:
        return library.tolerances
    out: list[Entry] = []
    for t in tolerances:
        out += [t] if isinstance(t, Entry) else library.choose_tolerances([t])
    return tuple({t.name: t for t in out}.values())


def _can_show(model: MechanismModel, entry: Entry) -> bool:
    """Whether the channel of a sensor effect exists."""
    if entry.sensor is None:
        moved = {c.path.split(".")[1] for c in entry.changes if c.path.startswith("points.")}
        return not moved or any(o.rpartition(".")[0] in moved for o in model.outputs)
    return bool(columns_of(entry.sensor, model.outputs, model.library.channels))


def model_of(action: Action, records: Sequence[Record] | Record) -> MechanismModel:
    """A mechanism as a model, with the default channels and the outputs that records show.

    Parameters
    ----------
    action
        The mechanism.
    records
        Measured runs.
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    library = load_library(action)
    known = {f"{point}.{axis}" for point in action.config.points for axis in "xy"}
    known |= {FORCE} if action.config.finger is not None else set()
    shown = list(dict.fromkeys(n for r in records for n in r.outputs if n in known))
    channels = ",".join(shown or library.default_channels)
    found = resolve(action, {"channels": channels} if channels else {})
    assert found is not None
    return found[0]


def resolve(
    name: str | Action,
    settings: Mapping[str, str],
    also: Sequence[str] = (),
    *,
    notify: Callable[[str], None] | None = None,
) -> tuple[MechanismModel, tuple[Effect, ...]] | None:
    """Model and effects of a packaged mechanism or a mechanism file; None for other names.

    Parameters
    ----------
    name
        Name, path of a file, or a mechanism.
    settings
        Settings of :data:`SETTINGS`; a name with a dot is a path of the mechanism,
        ``string.modes``.
    also
        Channels in addition to those of the settings.
    notify
        Function that receives sentences about assumptions.

    Raises
    ------
    InvalidParameter
        A setting, channel or effect is unknown; the message has the known ones.
    """
    if not isinstance(name, Action):
        if name not in packaged_actions() and not name.endswith(".toml"):
            return None
        name = load_action(name)
    paths = {k: v for k, v in settings.items() if "." in k}
    unknown = sorted(set(settings) - set(SETTINGS) - set(paths))
    if unknown:
        raise InvalidParameter(
            f"--set {', '.join(unknown)}: expected {', '.join(SETTINGS)}, or a path of the "
            "mechanism such as string.modes"
        )
    action = with_noted_values(name, [f"{k}={v}" for k, v in paths.items()], notify)
    options: dict[str, Any] = {}
    for key, (word, meaning) in NUMBERS.items():
        if key in settings:
            text = settings[key]
            options[key] = meaning if text == word else _number(key, text, word)
    library = load_library(action, settings.get("library"))
    if "tolerances" in settings:
        options["tolerances"] = _list(settings["tolerances"])
    channels = _list(settings.get("channels", "")) or list(library.default_channels)
    effects = _list(settings.get("effects", ""))
    outputs = library.outputs([*channels, *also])
    turned = [e.sensor for e in library.select(effects) if e.sensor and e.sensor.kind == "tilt"]
    beside = partners(turned, outputs, library.channels)
    model, made = mechanism_model(
        action, channels=[*outputs, *beside], effects=effects, library=library, **options
    )
    model.beside = frozenset(beside)
    return model, made


def _number(name: str, text: str, word: str) -> float:
    try:
        return float(text)
    except ValueError:
        other = f", or {word}" if word else ""
        raise InvalidParameter(f"{name}: got {text!r}, expected a number{other}") from None


def _list(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


# ------------------------------------------------------------------------------- planned strokes

#: Packaged strokes, the most informative first.
STROKES = ("forte", "piano", "staccato")
#: Sample rate [Hz].
RATE = 2000.0
#: Noise of a camera that resolves a fifth of a pixel of 0.1 mm [m], and of a good load cell [N].
CAMERA, LOAD_CELL = 2e-5, 0.01


@checked
def planned_strokes(model: MechanismModel, names: Sequence[str] = STROKES) -> tuple[Record, ...]:
    """Packaged strokes as records without measured values, with typical commercial sensors.

    The noise is 0.01 N for the force and 0.02 mm for displacements, at 2 kHz. None for a mechanism
    without a finger.

    Parameters
    ----------
    names
        Packaged strokes or files of strokes.
    """
    if model.action.config.finger is None:
        return ()
    shown = [o for o in model.outputs if o not in model.beside and o != DISPLACEMENT]
    sensors = {
        o: Sensor(
            name=o,
            unit=model.units[o],
            sigma=LOAD_CELL if o == "finger.force" else CAMERA,
        )
        for o in shown
    }
    records = []
    for name in names:
        stroke = load_stroke(name)
        time = np.arange(0.0, stroke.duration, 1.0 / RATE)
        records.append(
            Record(
                name=name,
                time=time,
                inputs={"force": stroke.at(time)},
                outputs={o: np.zeros(time.size) for o in shown},
                sensors=sensors,
                input_sigma={"force": LOAD_CELL},
            )
        )
    return tuple(records)
