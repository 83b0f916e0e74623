"""Generator of the blind bench of the full action: the machine as it "really" is.

The machine is not the model: all tolerances are off their values, felt and friction change from
stroke to stroke, beams and string have more shapes and modes, friction turns over at a third of the
speed, the integrator is another one with tighter tolerance, half of the effects act in another form
than the library's. What it shares with the diagnosis is the simulator's contact laws and the
meaning of an effect's magnitude; sensors are its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blind.refined import refined
from feltmb.adapters.changes import Change, Entry
from feltmb.adapters.findings import action_with_effects
from feltmb.adapters.library import Library, load_library
from feltmb.mechanism import Action, load_action
from feltmb.run.results import Run
from feltmb.run.simulate import simulate
from feltmb.run.stroke import Stroke, load_stroke, pulse_stroke, ramp_stroke

Array = NDArray[np.float64]

ACTION = "steinway45"
RATE = 2000.0  # camera and force sensor [1/s]
FIT = ("piano", "mezzo", "staccato")
HELD_OUT = ("forte", "soft_staccato")
STROKES = FIT + HELD_OUT
AFTER_BLOW = 0.010  # records end so long after the hammer was farthest [s]
NOISE_CAMERA, PIXEL = 5e-5, 2e-5  # [m]
NOISE_FORCE, STEP_FORCE = 0.01, 25.0 / 4096.0  # [N]
NOISE_ENCODER = 1e-6  # of the key front [m]
#: What is recorded, and its share of the cases. force: force of the finger and all cameras until
#: shortly after the blow. motion: motion of the key front as input, force of the finger and all
#: cameras as outputs. whole: as force, through check, release and second strikes. one camera: as
#: force, with the camera of the hammer only.
VIEWS = {"force": 0.4, "motion": 0.2, "whole": 0.2, "one camera": 0.2}
ONE_CAMERA = ("hammer_tip.x", "hammer_tip.y")
VARIATION = 0.01  # from stroke to stroke [1]
VARYING = ("felt.", "joint_friction.", "contact_friction.")
LARGEST = 3.0  # of an effect, times the magnitude that one would expect to meet
#: Same number of the mechanism under two names: one is enough.
SYNONYMS = ("compliance.wire", "compliance.shank", "key_lift_off", "channel_gain.hammer")

#: Causes that neither the library nor the tolerances hold: (component, changes by one unit).
OUTSIDE: dict[str, tuple[str, tuple[Change, ...]]] = {
    "butt_leather_shape": (
        "contact 04, jack - hammer butt leather",
        (Change(path="surfaces.Hbp4.point.y", add=2e-4),),
    ),
    "capstan_place": (
        "contact 03, key capstan - whippen",
        (Change(path="surfaces.Kp2.point.x", add=5e-4),),
    ),
    "finger_place": ("key", (Change(path="finger.point.x", add=2e-3),)),
    "head_angle": ("hammer head", (Change(path="bodies.head.angle", add=1e-2),)),
    "jack_toe_place": (
        "contact 05, jack toe - let-off button",
        (Change(path="surfaces.Jp3.point.x", add=2e-4),),
    ),
    "jack_top_radius": (
        "contact 04, jack - hammer butt leather",
        (Change(path="surfaces.Jp2.radius", add=2e-4),),
    ),
    "shank_angle": ("hammer shank", (Change(path="bodies.shank.angle", add=5e-3),)),
    "shank_wood": ("hammer shank", (Change(path="bodies.shank.density", exp=0.1),)),
    "whippen_cushion": (
        "contact 03, key capstan - whippen",
        (Change(path="surfaces.Wp2.point.y", add=2e-4),),
    ),
}
LARGEST_OUTSIDE = 10.0

#: The other form of an effect: (effect, share of its magnitude), the second in its own scale.
MIXED = {
    "felt_stiffness": (0.8, "felt_hardening", 0.3),
    "felt_hardening": (0.8, "felt_stiffness", 0.2),
    "felt_hysteresis": (0.8, "transition_speed", 0.5),
    "felt_thickness": (0.9, "felt_stiffness", -0.1),
    "transition_speed": (0.8, "felt_hysteresis", 0.1),
    "spring_rate": (0.85, "spring_preload", 0.15),
    "spring_preload": (0.85, "spring_rate", 0.15),
}


@dataclass(frozen=True)
class Part:
    """One withheld effect of a case."""

    name: str
    form: str
    """A: the library's form; B: another; outside: a kind that the library does not hold."""
    size: float
    """In the library's unit; for kinds from outside in units of :data:`OUTSIDE`."""
    target: float
    """Noncentrality that the magnitude was chosen for."""


@dataclass(frozen=True)
class Case:
    """Truth of one case; everything random in it comes from the seed."""

    number: int
    parts: tuple[Part, ...]
    tolerances: Mapping[str, float]
    varied: Mapping[str, Mapping[str, float]]
    """By stroke: what is added to the tolerances."""
    strength: Mapping[str, float]
    seed: tuple[int, int]
    view: str = "force"
    """What is recorded, see :data:`VIEWS`."""


def forms(entry: Entry, library: Library) -> list[tuple[str, list[tuple[Entry, float]]]]:
    """Forms of an effect: its name, and the entries with what one unit of magnitude gives each."""
    family, _, rest = entry.name.partition(".")
    out: list[tuple[str, list[tuple[Entry, float]]]] = [("A", [(entry, 1.0)])]
    if family in ("coulomb_friction", "viscous_friction"):
        first = entry.changes[0]
        other = "stribeck" if family == "coulomb_friction" else "quadratic"
        share, more = (0.8, 0.5) if family == "coulomb_friction" else (0.7, 0.2)
        path = f"bodies.{rest}.friction.{other}"
        changes = (
            first.model_copy(update={"add": share}),
            first.model_copy(update={"path": path, "add": more}),
        )
        out.append(("B", [(entry.model_copy(update={"changes": changes}), 1.0)]))
    elif entry.insert is not None and entry.insert.kind == "clearance":
        pin = entry.insert.model_copy(update={"seating": 0.6})
        seated = entry.model_copy(update={"insert": pin})
        out.append(("B", [(seated, 1.0)]))
    elif entry.shape is not None and len(entry.shapes) > 1:
        low, high = entry.shape.values[0], entry.shape.values[-1]
        middle = entry.shape.model_copy(update={"values": (float(np.sqrt(low * high)),)})
        out.append(("B", [(entry.model_copy(update={"shape": middle}), 1.0)]))
    elif family in MIXED:
        share, name, other_share = MIXED[family]
        second = library.effect(f"{name}.{rest}")
        out.append(
            ("B", [(entry, share), (second, other_share * second.magnitude / entry.magnitude)])
        )
    return out


def second_of(part: Part, library: Library) -> str:
    """Effect of the library that form B of a part contains beside its own, or "" if none.

    It changes the same numbers of the mechanism as the form does beside the part's own effect.
    """
    if part.form != "B":
        return ""
    entry = library.effect(part.name)
    mixed = dict(forms(entry, library))["B"]
    added = {c.path for e, _ in mixed for c in e.changes} - {c.path for c in entry.changes}
    found = [e.name for e in library.effects if {c.path for c in e.changes} & added]
    return found[0] if found else ""


def is_signal(entry: Entry) -> bool:
    """Whether the effect is one of sensors or of the input."""
    return entry.sensor is not None or entry.input is not None


def watched(view: str, outputs: Sequence[str]) -> tuple[str, ...]:
    """Outputs that are recorded in a view; ``outputs``: those of all cameras."""
    if view == "one camera":
        return ONE_CAMERA
    return (*outputs, "finger.force") if view == "motion" else tuple(outputs)


def candidates(library: Library, outputs: Sequence[str], view: str = "force") -> list[Entry]:
    """Effects that a case may withhold: those that these records could show."""
    outputs = [o for o in watched(view, outputs) if o != "finger.force"]  # its errors: of the input
    points = {o.rpartition(".")[0] for o in outputs}
    out = []
    for e in library.effects:
        if e.condition is not None or e.name in SYNONYMS:
            continue
        moved = {c.path.split(".")[1] for c in e.changes if c.path.startswith("points.")}
        if moved and not moved & points:
            continue
        near = {*outputs} if e.sensor is None or e.sensor.channels == "camera" else {
            *library.outputs([e.sensor.channels])
        }  # fmt: skip
        if near & {*outputs}:
            out.append(e)
    return out


def varying(library: Library) -> list[str]:
    """Tolerances that change from stroke to stroke."""
    return [e.name for e in library.tolerances if e.unit == "1" and e.name.startswith(VARYING)]


def draw(
    seed: int,
    number: int,
    scales: Mapping[str, float],
    library: Library,
    outputs: Sequence[str],
    *,
    mix: Sequence[float] = (0.25, 0.45, 0.15, 0.05, 0.10),
    views: Mapping[str, float] = MappingProxyType(VIEWS),
) -> Case:
    """Draw the truth of a case.

    ``scales``: {"name:form": noncentrality per unit of magnitude in the view "force"}. ``mix``:
    shares of none, one, two, three effects, outside. ``views``: shares of the views.
    """
    shares = np.array(list(views.values()))
    own = np.random.default_rng([seed, number, 5])
    view = [*views][int(own.choice(shares.size, p=shares / shares.sum()))]
    rng = np.random.default_rng([seed, number, 1])
    kind = int(rng.choice(5, p=np.asarray(mix) / np.sum(mix)))
    entries = {e.name: e for e in candidates(library, outputs, view)}
    pool = [
        (name, form, LARGEST * e.magnitude)
        for name, e in sorted(entries.items())
        for form, _ in forms(e, library)
        if f"{name}:{form}" in scales  # the gain of the force sensor has none
    ]
    if kind == 4:
        pool = [(name, "outside", LARGEST_OUTSIDE) for name in sorted(OUTSIDE)]
    weakest = 5.0 if kind == 4 else 0.5
    parts: list[Part] = []
    while len(parts) < (1 if kind == 4 else kind):
        target = float(np.exp(rng.uniform(np.log(weakest), np.log(50.0))))
        able = [
            (name, form, target / scales[f"{name}:{form}"])
            for name, form, limit in pool
            if limit * scales[f"{name}:{form}"] >= target and all(name != q.name for q in parts)
        ]
        if not able:
            continue
        names = sorted({name for name, _, _ in able})
        name = names[int(rng.integers(len(names)))]
        chosen = [(form, size) for other, form, size in able if other == name]
        form, size = chosen[int(rng.integers(len(chosen)))]
        signed = form == "outside" or entries[name].sign == 0
        if signed and rng.random() < 0.5:
            size = -size
        if form != "outside" and not entries[name].lower <= size <= entries[name].upper:
            size = -size
        parts.append(Part(name, form, float(size), target))
    tolerances = {
        e.name: float(e.magnitude * np.clip(rng.standard_normal(), -2.5, 2.5))
        for e in library.tolerances
    }
    varied = {
        s: {n: float(VARIATION * rng.standard_normal()) for n in varying(library)} for s in STROKES
    }
    strength = {s: float(np.exp(0.05 * rng.standard_normal())) for s in STROKES}
    return Case(number, tuple(parts), tolerances, varied, strength, (seed, number), view)


def plain_case(parts: Sequence[Part] = (), view: str = "force") -> Case:
    """Drawing values, plain strokes: for the calibration of magnitudes."""
    return Case(0, tuple(parts), {}, {}, {}, (0, 0), view)


def as_dict(case: Case) -> dict[str, Any]:
    """Plain data."""
    return asdict(case)


def from_dict(data: Mapping[str, Any]) -> Case:
    """Back from plain data."""
    values = dict(data)
    values["parts"] = tuple(Part(**p) for p in values["parts"])
    values["seed"] = tuple(values["seed"])
    return Case(**values)


# ---------------------------------------------------------------- the machine


def machine(base: Action, library: Library, case: Case, stroke: str) -> Action:
    """The machine at one stroke of a case."""
    entries: list[tuple[Entry, float, float | None]] = []
    varied = case.varied.get(stroke, {})
    for e in library.tolerances:
        value = case.tolerances.get(e.name, 0.0) + varied.get(e.name, 0.0)
        if value != 0.0:
            entries.append((e, value, None))
    for part in case.parts:
        if part.form == "outside":
            component, changes = OUTSIDE[part.name]
            kind = Entry(
                name=part.name, kind="parameter", component=component, mechanism="", unit="1",
                magnitude=1.0, changes=changes,
            )  # fmt: skip
            entries.append((kind, part.size, None))
            continue
        entry = library.effect(part.name)
        if is_signal(entry):
            continue
        for other, share in dict(forms(entry, library))[part.form]:
            entries.append((other, share * part.size, other.shapes[0]))
    return action_with_effects(base, entries)


def command(stroke: str, case: Case) -> tuple[Stroke, float]:
    """What the finger does, and for how long it is watched at most [s]."""
    plans = {
        "piano": lambda: (load_stroke("piano"), 0.32),
        "mezzo": lambda: (ramp_stroke(12.0, 0.05, 0.18, name="mezzo"), 0.22),
        "staccato": lambda: (pulse_stroke(17.0, 0.045, name="staccato"), 0.15),
        "forte": lambda: (load_stroke("forte"), 0.16),
        "soft_staccato": lambda: (pulse_stroke(12.0, 0.05, name="soft_staccato"), 0.2),
    }
    made, length = plans[stroke]()
    return made.scaled(case.strength.get(stroke, 1.0)), length


# ---------------------------------------------------------------- the sensors


def _magnitudes(case: Case) -> dict[str, float]:
    return {p.name: p.size for p in case.parts}


def _seen(run: Run, output: str, frames: Array, size: Mapping[str, float]) -> Array:
    """A tracked point as the camera sees it: mean over half a frame, from rest."""
    point, _, axis = output.rpartition(".")
    late = size.get("camera_skew", 0.0)
    moments = frames[:, None] - late + np.linspace(-0.25, 0.25, 5)[None, :] / RATE

    def moved(name: str) -> Array:
        values = run[name] - run[name][0]
        return np.asarray(np.interp(moments, run.time, values).mean(axis=1))

    value = moved(output)
    tilt = size.get("camera_tilt", 0.0)
    if tilt:
        value = value + (tilt if axis == "x" else -tilt) * moved(
            f"{point}.{'y' if axis == 'x' else 'x'}"
        )
    gain = 1.0 + size.get("camera_scale", 0.0)
    return np.asarray(gain * value)


def shown_force(played: Stroke, case: Case, time: Array) -> Array:
    """Force that the sensor shows at these times, without noise [N]."""
    size = _magnitudes(case)
    force = played.at(time - size.get("input_delay", 0.0))
    return np.asarray((1.0 + size.get("input_gain", 0.0)) * force + size.get("input_offset", 0.0))


def record(
    base: Action,
    library: Library,
    case: Case,
    stroke: str,
    outputs: Sequence[str],
    *,
    rtol: float = 1e-8,
    ideal: bool = False,
    length: float | None = None,
    played: Stroke | None = None,
) -> tuple[dict[str, Array], Run]:
    """Sensors' view of one stroke, {input, output, ...}, and the run behind it.

    The input is "force" [N], in the view "motion" "displacement" [m] of the key front, downward
    from rest. ``outputs``: those of all cameras. ``ideal``: no noise and no steps. ``length``: of
    the record [s]; None: until ``AFTER_BLOW`` after the hammer was farthest, in the view "whole"
    all of it. ``played``: another stroke than the one of that name.
    """
    if played is None:
        played, longest = command(stroke, case)
    else:
        longest = float(played.duration)
    whole = case.view == "whole"
    if whole:
        longest = float(played.duration)
    run = simulate(
        machine(base, library, case, stroke), played, duration=length or longest, rtol=rtol,
        method="cvode", output_rate=8.0 * RATE, ledger=False, events=False,
    )  # fmt: skip
    if length is None:
        tip = run["hammer_tip.x"]
        farthest = float(run.time[int(np.argmax(np.abs(tip - tip[0])))])
        length = longest if whole else min(longest, farthest + AFTER_BLOW)
    frames = np.arange(int(length * RATE + 1e-9)) / RATE
    size = _magnitudes(case)
    order = STROKES.index(stroke) if stroke in STROKES else len(STROKES)
    rng = np.random.default_rng([*case.seed, 2, order])
    seen = watched(case.view, outputs)
    cameras = [o for o in seen if o != "finger.force"]
    view = {o: _seen(run, o, frames, size) for o in cameras}
    for channel, names in library.channels.items():
        gain = size.get(f"channel_gain.{channel}", 0.0)
        for o in names:
            if o in view and gain:
                view[o] = (1.0 + gain) * view[o]
    force = shown_force(played, case, frames)
    if case.view == "motion":
        view["displacement"] = np.interp(frames, run.time, run["finger.displacement"])
    view["finger.force" if case.view == "motion" else "force"] = force
    if ideal:
        return view, run
    for name in ("force", "finger.force"):
        if name in view:
            value = view[name] + NOISE_FORCE * rng.standard_normal(frames.size)
            view[name] = np.round(value / STEP_FORCE) * STEP_FORCE
    if "displacement" in view:
        view["displacement"] += NOISE_ENCODER * rng.standard_normal(frames.size)
    for o in cameras:
        white = rng.standard_normal(frames.size + 2)
        grain = (white[:-2] + white[1:-1] + white[2:]) / np.sqrt(3.0)
        view[o] = np.round((view[o] + NOISE_CAMERA * grain) / PIXEL) * PIXEL
    return view, run


def shows(with_it: Mapping[str, Array], without: Mapping[str, Array]) -> float:
    """Time [s] from which ideal records of a stroke differ by an effect; NaN: never.

    By a tenth of the noise and of their largest difference, in any output.
    """
    outputs = [o for o in with_it if o not in ("force", "displacement")]
    apart = np.max(
        [
            np.abs(with_it[o] - without[o]) / (NOISE_FORCE if o == "finger.force" else NOISE_CAMERA)
            for o in outputs
        ],
        axis=0,
    )
    there = np.flatnonzero(apart > 0.1 * max(1.0, float(np.max(apart))))
    return float(there[0] / RATE) if there.size else float("nan")


def moments(
    base: Action, library: Library, case: Case, stroke: str, outputs: Sequence[str]
) -> list[float]:
    """Times [s] from which each part of a case shows in a stroke, see :func:`shows`."""
    if not case.parts:
        return []
    view, _ = record(base, library, case, stroke, outputs, ideal=True)
    length = len(next(iter(view.values()))) / RATE
    out = []
    for k in range(len(case.parts)):
        other = replace(case, parts=case.parts[:k] + case.parts[k + 1 :])
        without, _ = record(base, library, other, stroke, outputs, ideal=True, length=length)
        out.append(shows(view, without))
    return out


def setup(outputs: Sequence[str] = ()) -> tuple[Action, Action, Library, tuple[str, ...]]:
    """Packaged action, the refined one, the library, the measured outputs."""
    action = load_action(ACTION)
    library = load_library(action)
    return action, refined(action), library, tuple(outputs or library.outputs())
