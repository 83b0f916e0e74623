"""Sets of the yardstick: cases with a stated model, candidates, records, and the truth.

All seeds are frozen. Records that are simulated are stored in a folder (``cache``) when they are
first needed; measured ones are in ``bench/data`` and ``unmodeled/examples/data``.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blind import rigs
from blind.imperfect.generate import SEED, load
from blind.imperfect.machines import TABLES
from blind.imperfect.stated import stated, to_records
from blind.marks import Cause, Truth
from blind.task import Task
from unmodeled import (
    Coordinate,
    Equations,
    LinearModel,
    Parameter,
    Record,
    Sensor,
    State,
    candidates,
    library,
)
from unmodeled.data import StartPrior, read_records

Array = NDArray[np.float64]

__all__ = ["SEALED", "SETS", "Set", "Task"]

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "bench" / "data"
EXAMPLES = ROOT / "unmodeled" / "examples"
#: Frozen seeds of the development cases of both blind benches.
SMALL_SEED, SMALL_CASES = 20270101, 300
ACTION_SEED, ACTION_CASES = 20270102, 60
#: Relative tolerance of the integrator of the stated action: near let-off a motion is seen to jump
#: by 0.1 of the noise of the camera at 3e-6, by 0.02 at this one.
RTOL = 1e-6
#: Time after the turn of the hammer that counts in the set ``small`` [s].
AFTER_TURN = 0.08


@dataclass(frozen=True)
class Set:
    """Cases with numbers from 0."""

    name: str
    count: int
    task: Callable[[int, Path], Task]
    """``task(number, cache)``."""
    make: Callable[[Sequence[int], Path], None] = lambda numbers, cache: None
    """Simulate what the cache lacks."""

    def third(self) -> list[int]:
        """Every third case: for trials of rules; the whole set is for each landing."""
        return list(range(0, self.count, 3))


# ---------------------------------------------------------------- imperfect machines

#: Rows of a machine in the set; the last two of :data:`ROWS` are the set ``perfect``.
FOREIGN_ROWS = 10


def _imperfect(machine: int, row: int, folder: Path, seed: int = SEED) -> Task:
    table = TABLES[machine]
    made = load(table, machine, folder, seed)[row]
    records = to_records(table, made.records, made.noise)
    model, effects = stated(table, records[0])
    about = f"{table.name}, discrepancy {made.row.share:.1%}"
    if made.cause is None:
        truth = Truth("control", numbers=made.parameters, about=about)
    else:
        sizes = {n: f * made.size for n, f in made.cause.literal.items()}
        truth = Truth(
            "effect",
            (Cause(made.cause.right, made.cause.near),),
            made.parameters,
            sizes,
            about=f"{about}, {made.cause.name} at {made.row.ratio:g} times it",
        )
    return Task(model, effects, records, truth)


def imperfect(seed: int, count: int) -> Set:
    """The imperfect machines with a seed, at most ten cases of each."""
    name = "imperfect" if seed == SEED else f"imperfect-{seed}"

    def make(numbers: Sequence[int], cache: Path) -> None:
        made = {}
        for k in sorted({n // FOREIGN_ROWS for n in numbers}):
            cases = load(TABLES[k], k, cache / name, seed)
            made[TABLES[k].name] = [(m.parameters, m.size, m.foreign) for m in cases]
        (cache / name / "truths.json").write_text(json.dumps(made), encoding="utf-8")

    def task(number: int, cache: Path) -> Task:
        return _imperfect(number // FOREIGN_ROWS, number % FOREIGN_ROWS, cache / name, seed)

    return Set(name, min(count, FOREIGN_ROWS * len(TABLES)), task, make)


# ---------------------------------------------------------------- blind benches


def _truths(machine: ModuleType, seed: int, cases: int, folder: Path) -> list[Any]:
    """Truths of a bench, drawn once."""
    path = folder / "truths.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(machine.draw(seed, cases)), encoding="utf-8")
    return list(json.loads(path.read_text("utf-8")))


def _make_records(
    machine: ModuleType, seed: int, count: int, numbers: Sequence[int], folder: Path
) -> None:
    _truths(machine, seed, count, folder)
    todo = [n for n in numbers if not (folder / "records" / f"{n}.npz").exists()]
    for k in range(0, len(todo), machine.CHUNK):
        machine.make_records(folder, todo[k : k + machine.CHUNK])


def small(seed: int, count: int) -> Set:
    """The key-and-hammer bench with a seed; its folder has the seed unless it is the frozen one."""
    name = "small" if seed == SMALL_SEED else f"small-{seed}"

    def make(numbers: Sequence[int], cache: Path) -> None:
        from blind import small_machine
        from blind.build import build_network

        build_network()
        _make_records(small_machine, seed, count, numbers, cache / name)

    return Set(name, count, lambda n, cache: _small(n, cache / name, seed, count), make)


def action(seed: int, count: int) -> Set:
    """The whole action with a seed; its folder has the seed unless it is the frozen one."""
    name = "action" if seed == ACTION_SEED else f"action-{seed}"

    def make(numbers: Sequence[int], cache: Path) -> None:
        from blind import action_machine

        _make_records(action_machine, seed, count, numbers, cache / name)

    return Set(name, count, lambda n, cache: _action(n, cache / name, seed, count), make)


def _small(number: int, folder: Path, seed: int, count: int) -> Task:
    from blind import small_machine
    from blind.key_hammer import effects

    told = _truths(small_machine, seed, count, folder)[number]
    parts = told["parts"]
    about = ", ".join(f"{p['name']} {p['form']} nc {p['target']:.0f}" for p in parts) or "nothing"
    numbers = {n: float(np.mean(v)) for n, v in told["parameters"].items()}
    numbers["camera_skew"] = float(told["skew"])
    truth = Truth(
        _kind(parts),
        tuple(Cause((p["name"],)) for p in parts if p["form"] != "outside"),
        numbers,
        {p["name"]: p["size"] for p in parts if p["form"] == "A"},
        about=f"{told['mode']}: {about}",
    )
    whole = small_machine.read_records(folder / "records" / f"{number}.npz")
    records = [_until_after_turn(r) for r in whole]
    return Task(small_machine.stated_model(), effects(), records, truth)


def _until_after_turn(record: Record) -> Record:
    """A stroke until 80 ms after the turn of the hammer: later rebounds repeat no better."""
    turn = int(np.nanargmax(record.outputs["hammer"]))
    last = int(np.searchsorted(record.time, record.time[turn] + AFTER_TURN))
    return record.cut(0, min(last, record.samples), name=record.name)


def _kind(parts: Sequence[Mapping[str, Any]]) -> Any:
    if not parts:
        return "control"
    return "outside" if any(p["form"] == "outside" for p in parts) else "effect"


def _action(number: int, folder: Path, seed: int, count: int) -> Task:
    from blind import action_machine, action_truth
    from feltmb.adapters import mechanism_model

    told = _truths(action_machine, seed, count, folder)[number]
    records = action_machine.read_records(folder / "records" / f"{number}.npz")
    machine, _, known, outputs = action_truth.setup()
    first = records[0]
    seen = outputs if first.outputs.keys() >= {*outputs} else action_truth.ONE_CAMERA
    model, effects = mechanism_model(
        machine,
        channels=[*first.outputs],
        library=known,
        effects=[e.name for e in action_truth.candidates(known, seen)],
        rtol=RTOL,
        workers=1,
    )
    same = {e.name: e.tolerance_parameter for e in effects}
    parts, causes = told["parts"], []
    for p in parts:
        if p["form"] == "outside":
            near = _alike().get(str(number), ()) if seed == ACTION_SEED else ()
            causes.append(Cause((), tuple(near)))
            continue
        second = action_truth.second_of(action_truth.Part(**p), known)
        own = same.get(p["name"], "")
        right = (p["name"], *((f"parameter:{own}",) if own else ()))
        causes.append(Cause(right, (second,) if second else ()))
    about = ", ".join(f"{p['name']} {p['form']} nc {p['target']:.0f}" for p in parts) or "nothing"
    truth = Truth(
        _kind(parts),
        tuple(causes),
        {n: float(v) for n, v in told["tolerances"].items()},
        {p["name"]: p["size"] for p in parts if p["form"] == "A"},
        about=f"{told['view']}: {about}",
    )
    return Task(model, effects, records, truth)


@functools.cache
def _alike() -> dict[str, list[str]]:
    """Effects that leave a noncentrality below 5 of a cause from outside, by frozen case."""
    path = Path(__file__).with_name("action_alike.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


# ---------------------------------------------------------------- measured machines


@functools.cache
def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"yardstick_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def _example(name: str, truth: Truth) -> Task:
    """An example of the documentation with its records."""
    module = _module(EXAMPLES / f"{name}.py")
    paths = [p for p in sorted((EXAMPLES / "data").glob(f"{name}_*")) if p.suffix != ".toml"]
    model = module.model
    records = read_records(paths, inputs=model.inputs, outputs=model.outputs, units=model.units)
    held = {"emps_pulses"} if name == "emps" else set()
    records = tuple(replace(r, role="held_out") if r.name in held else r for r in records)
    return Task(model, module.effects, records, truth)


def _emps() -> Task:
    return _example(
        "emps",
        Truth(
            "effect",
            (Cause(("dry friction",), ("Stribeck friction",)),),
            {"mass": 95.1, "viscous": 203.5},
            {"dry friction": 20.4},
            # The published model has an offset of -3.16 N, too.
            free=("constant force", "one-sided friction"),
            about="EMPS, dry friction of 20.4 N (published)",
        ),
    )


def _silverbox() -> Task:
    return _example(
        "silverbox",
        Truth(
            "effect",
            (Cause(("cubic stiffness mass",)),),
            # The means of input and output, at a static gain of 1, differ by 5.2 to 5.4 mV.
            free=("constant force mass", "offset of input u", "offset of sensor y"),
            about="Silverbox, cubic stiffness",
        ),
    )


def _tanks() -> Task:
    causes = (Cause(("overflow upper",), ("overflow lower", "loss ~ upper^2")),)
    return _example("tanks", Truth("effect", causes, about="cascaded tanks, overflow"))


G, ARM, LENGTH = 9.80665, 0.078, 0.15  # m/s^2, kg, m


def _go1(sigma: float | None = 2e-3) -> Task:
    """Motor of a robot leg; records with 2 kg are fitted, those with 0 kg are held out."""
    table = np.loadtxt(DATA / "unitree_go1.csv", delimiter=",", skiprows=1)
    records = []
    for run in np.unique(table[:, 0]):
        _, mass, t, target, enabled, q = table[table[:, 0] == run].T
        inputs = {
            "target": target,
            "enabled": enabled,
            "arm": np.full(t.size, mass[0] * LENGTH**2 + ARM * LENGTH**2 / 3.0),
            "weight": np.full(t.size, (mass[0] + 0.5 * ARM) * G * LENGTH),
        }
        records.append(
            Record(
                name=f"{mass[0]:g} kg, run {run:g}",
                time=t,
                inputs=inputs,
                outputs={"position": q},
                sensors={"position": Sensor(name="position", unit="rad", sigma=sigma)},
                role="fit" if mass[0] > 0.0 else "held_out",
                start=StartPrior(mean={"q": float(q[0]), "v": 0.0}, sd={"q": 5e-3, "v": 0.05}),
            )
        )
    motor = Coordinate(
        name="motor",
        position="q",
        speed="v",
        inertia=lambda t, x, u, p: p.rotor + u.arm,
        unit="N m",
    )

    def rates(t: Any, x: Any, u: Any, p: Any) -> Any:
        torque = u.enabled * (p.ratio * 10.0 * (u.target - x.q) - 0.3 * x.v)
        return x.v, (torque - u.weight * np.sin(x.q + p.zero)) / (p.rotor + u.arm)

    model = Equations(
        name="motor of a leg",
        states=[
            State(name="q", unit="rad", scale=1.0, start_sd=5e-3),
            State(name="v", unit="rad/s", scale=5.0, start_sd=0.05),
        ],
        parameters=[
            Parameter(name="rotor", value=0.008, sd=0.004, unit="kg m^2", lower=1e-4),
            Parameter(name="ratio", value=1.0, sd=0.1, lower=0.1),
            Parameter(name="zero", value=0.0, sd=0.03, unit="rad"),
        ],
        inputs={"target": "rad", "enabled": "1", "arm": "kg m^2", "weight": "N m"},
        rates=rates,
        outputs={"position": "q"},
        coordinates=[motor],
        substeps=6,
        hold="zero",
    )
    effects = candidates(model, records)
    causes = (
        Cause(("dry friction motor",), ("Stribeck friction motor", "hysteresis motor")),
        Cause(("viscous friction motor",)),
    )
    about = (
        "motor of a leg, dry friction of 0.08 to 0.14 N m and viscous of 0.04 to 0.055 N m s/rad"
        f"{', noise not told' * (sigma is None)}"
    )
    truth = Truth("effect", causes, engineer=0.0371, about=about)
    return Task(model, effects, records, truth)


MEASURED: tuple[Callable[[], Task], ...] = (
    _emps,
    _silverbox,
    _tanks,
    _go1,
    *rigs.MEASURED,
    functools.partial(_go1, None),
)


# ---------------------------------------------------------------- trials


def _table(path: Path) -> Array:
    return np.loadtxt(path, delimiter=",", skiprows=1)


def _runs(folder: str) -> list[Array]:
    return [_table(p) for p in sorted((DATA / "trials" / folder).glob("*.csv"))]


def _overdamped() -> Task:
    """A servo whose model has too much damping and no dry friction."""
    joint = Coordinate(name="joint", position="q", speed="v", inertia="J", unit="N m")
    model = Equations(
        name="joint",
        states=[
            State(name="q", unit="rad", scale=0.3, start_sd=1e-3),
            State(name="v", unit="rad/s", scale=5.0, start_sd=1e-2),
        ],
        parameters=[
            Parameter(name="J", value=0.04, sd=0.02, unit="kg m^2", lower=1e-3),
            Parameter(name="d", value=0.3, sd=0.3, unit="N m s/rad", lower=0.0),
        ],
        inputs={"target": "rad"},
        hold="zero",
        rates=lambda t, x, u, p: (
            x.v, (60.0 * (u.target - x.q) - 3.0 * x.v - p.d * x.v) / p.J,
        ),
        outputs={"position": "q"},
        coordinates=[joint],
    )  # fmt: skip
    records = [
        Record(
            name=f"chirp {k}", time=t, inputs={"target": u}, outputs={"position": q},
            input_units={"target": "rad"},
            sensors={"position": Sensor(name="position", unit="rad")},
        )
        for k, (t, u, q) in enumerate(r.T for r in _runs("overdamped_joint"))
    ]  # fmt: skip
    effects = candidates(model, records)
    causes = (
        Cause(("dry friction joint",), ("Stribeck friction joint",)),
        Cause(("viscous friction joint",)),
    )
    about = "overdamped joint: viscous friction of -2.0 net and dry friction of 0.19 N m"
    return Task(model, effects, records, Truth("effect", causes, about=about))


def _slow_clock() -> Task:
    """A pendulum whose camera has a clock that is 2 % slow."""
    bob = Coordinate(name="bob", position="q", speed="v", unit="N m")
    model = Equations(
        name="pendulum",
        states=[
            State(name="q", unit="rad", scale=0.3, start=0.2, start_sd=0.3),
            State(name="v", unit="rad/s", scale=1.0, start_sd=0.1),
        ],
        parameters=[
            Parameter(name="L", value=1.0, sd=1e-3, unit="m", lower=0.5),
            Parameter(name="b", value=0.03, sd=0.02, unit="1/s", lower=0.0),
        ],
        rates=lambda t, x, u, p: (x.v, -9.81 / p.L * np.sin(x.q) - p.b * x.v),
        outputs={"bob": lambda t, x, u, p: p.L * np.sin(x.q)},
        coordinates=[bob],
    )
    records = [
        Record(
            name=f"video {k}", time=1e-3 * t, inputs={}, outputs={"bob": 1e-3 * y},
            sensors={"bob": Sensor(name="bob", unit="m")},
        )
        for k, (t, y) in enumerate(r.T for r in _runs("slow_clock"))
    ]  # fmt: skip
    effects = candidates(model, records)
    truth = Truth(
        "effect",
        (Cause(("*clock*", "parameter:L", "*outside its tolerance*")),),
        about="slow clock: the clock or the length, never a force",
    )
    return Task(model, effects, records, truth)


def _offsets() -> Task:
    """Free swings of a mass; each run has its own offset of the sensor."""
    mass = Coordinate(name="mass", position="x", speed="v", inertia="m")
    model = Equations(
        name="mass spring damper",
        states=[
            State(name="x", unit="m", scale=0.3, start_sd=0.5),
            State(name="v", unit="m/s", scale=1.0, start_sd=2.0),
        ],
        parameters=[
            Parameter(name="m", value=1.0, sd=0.0, unit="kg"),
            Parameter(name="k", value=15.0, sd=10.0, unit="N/m", lower=0.0),
            Parameter(name="c", value=0.5, sd=0.5, unit="N s/m", lower=0.0),
        ],
        rates=lambda t, x, u, p: (x.v, (-p.k * x.x - p.c * x.v) / p.m),
        outputs={"x": "x"},
        coordinates=[mass],
    )
    records = [
        Record(
            name=f"run {k}", time=t, inputs={}, outputs={"x": y},
            sensors={"x": Sensor(name="x", unit="m")},
        )
        for k, (t, y) in enumerate(r.T for r in _runs("offset_of_each_run"))
    ]  # fmt: skip
    effects = candidates(model, records)
    truth = Truth(
        "numbers", numbers={"k": 20.0, "c": 0.8}, free=("offset of sensor x*",), accuracy=0.1,
        about="an offset of each run: k = 20, c = 0.8",
    )  # fmt: skip
    return Task(model, effects, records, truth)


def _few() -> Task:
    """Six samples, one parameter."""
    model = Equations(
        name="first-order decay",
        states=[State(name="Ca", unit="mol/l", scale=1.0, start=2.0081, start_sd=0.0)],
        parameters=[Parameter(name="k", value=1.3, unit="1/s", lower=0.0)],
        rates=lambda t, x, u, p: (-p.k * x.Ca,),
        outputs={"Ca": "Ca"},
    )
    ((t, y),) = (r.T for r in _runs("few_samples"))
    sensors = {"Ca": Sensor(name="Ca", unit="mol/l", sigma=0.01)}
    record = Record(name="decay", time=t, inputs={}, outputs={"Ca": y}, sensors=sensors)
    truth = Truth("numbers", numbers={"k": 2.589}, about="six samples: k = 2.589")
    return Task(model, (), [record], truth)


def _one_way(threshold: float) -> Task:
    """Motion that never reverses: dry and one-sided friction cannot be told apart."""
    model = LinearModel(
        name="m",
        output="force",
        columns={"mass": lambda r: r.inputs["a"], "viscous": lambda r: r.inputs["v"]},
        parameters=[
            Parameter(name="mass", value=25.0, sd=1.0, unit="kg"),
            Parameter(name="viscous", value=60.0, sd=60.0, unit="N s/m", lower=0.0),
        ],
    )
    records = []
    for k in range(4):
        rng, t = np.random.default_rng(k), np.arange(0.0, 0.6, 0.002)
        v = 0.3 * (1.0 - np.cos(2.0 * np.pi * t / 0.6)) * (1.0 + 0.3 * np.sin(40.0 * t + k))
        v = np.maximum(v, 0.0)
        a, x = np.gradient(v, t), 0.002 * np.cumsum(v)
        force = 25.0 * a + 60.0 * v + 15.0 * np.tanh(v / threshold)
        records.append(
            Record(
                name=f"r{k}",
                time=t,
                inputs={"x": x, "v": v, "a": a},
                outputs={"force": force + 0.5 * rng.standard_normal(t.size)},
                sensors={"force": Sensor(name="force", unit="N", sigma=0.5)},
                input_mode="motion",
                role="held_out" if k == 3 else "fit",
            )
        )
    effects = library.for_force_balance("x", "v", force=50.0, travel=0.15, pace=0.3)
    causes = (Cause(("dry friction", "one-sided friction")),)
    about = f"one-way motion, dry friction below {threshold:g} m/s: ONE OF with one-sided"
    return Task(model, effects, records, Truth("one of", causes, about=about))


def _swing() -> Task:
    """Free swings with unknown starts and nothing missing."""
    arm = Coordinate(name="arm", position="q", speed="v", inertia=1.0, unit="rad/s^2")
    model = Equations(
        name="free swing",
        states=[
            State(name="q", unit="rad", scale=1.0, start_sd=2.0),
            State(name="v", unit="rad/s", scale=8.0, start_sd=15.0),
        ],
        parameters=[
            Parameter(name="w2", value=64.0, sd=10.0, unit="1/s^2"),
            Parameter(name="d", value=0.1, sd=0.1, unit="1/s"),
        ],
        rates=lambda t, x, u, p: (x.v, -p.w2 * np.sin(x.q) - p.d * x.v),
        outputs={"q": "q"},
        coordinates=[arm],
    )
    from scipy.integrate import odeint

    rng, t = np.random.default_rng(0), np.arange(0.0, 3.0, 0.02)
    records = []
    for i in range(3):
        y = odeint(
            lambda x, _: (x[1], -64.0 * np.sin(x[0]) - 0.1 * x[1]), (1.0 - 0.2 * i, 0.0), t,
            rtol=1e-10,
        )  # fmt: skip
        records.append(
            Record(
                name=f"r{i}",
                time=t,
                inputs={},
                outputs={"q": y[:, 0] + 1e-3 * rng.standard_normal(t.size)},
                sensors={"q": Sensor(name="q", unit="rad", sigma=1e-3)},
                role="held_out" if i == 2 else "fit",
            )
        )
    effects = (library.dry_friction(arm, scale=1.0, speed=5.0),)
    truth = Truth("control", numbers={"w2": 64.0, "d": 0.1}, about="free swing")
    return Task(model, effects, records, truth)


TRIALS: tuple[Callable[[], Task], ...] = (
    _overdamped,
    _slow_clock,
    _offsets,
    _few,
    *(functools.partial(_one_way, v) for v in (3e-4, 3e-3, 9e-3, 0.02)),
    _swing,
)


# ---------------------------------------------------------------- stories


def _stories() -> ModuleType:
    return _module(ROOT / "bench" / "stories" / "stories.py")


def _story_names() -> list[str]:
    """Stories that a model of the action can be diagnosed with; "unit" is refused before."""
    return [n for n, s in _stories().STORIES.items() if n != "unit"]


def _make_stories(numbers: Sequence[int], cache: Path) -> None:
    module = _stories()
    for n in numbers:
        name = _story_names()[n]
        folder = cache / "stories" / name
        if not all((folder / f"{s}.csv").exists() for s in module.STROKES):
            module.make(module.STORIES[name], folder)


def _story(number: int, cache: Path) -> Task:
    from feltmb.adapters.model import resolve

    module, name = _stories(), _story_names()[number]
    story = module.STORIES[name]
    found = resolve("steinway45", {}, (), notify=lambda _: None)
    assert found is not None
    model, effects = found
    records = read_records(
        [cache / "stories" / name / f"{s}.csv" for s in module.STROKES],
        inputs=model.inputs,
        outputs=model.outputs,
        modes=model.input_modes,
        units=model.units,
        names=model.input_names,
    )
    if story.size is None:
        truth = Truth("control", about=name)
    else:
        own = {str(story.size[0])}
        own |= {e.name for e in effects if e.tolerance_parameter in own}
        own |= {e.tolerance_parameter for e in effects if e.name in own and e.tolerance_parameter}
        right = (*sorted(own), *(f"parameter:{n}" for n in sorted(own)))
        truth = Truth("effect", (Cause(right),), about=f"{name}, {story.size[0]}")
    return Task(model, effects, records, truth)


def _of(tasks: Sequence[Callable[[], Task]]) -> Callable[[int, Path], Task]:
    return lambda number, cache: tasks[number]()


SETS: dict[str, Set] = {
    s.name: s
    for s in (
        imperfect(SEED, FOREIGN_ROWS * len(TABLES)),
        Set(
            "perfect",
            2 * len(TABLES),
            lambda n, cache: _imperfect(n // 2, FOREIGN_ROWS + n % 2, cache / "imperfect"),
            lambda numbers, cache: SETS["imperfect"].make(
                [n // 2 * FOREIGN_ROWS for n in numbers], cache
            ),
        ),
        small(SMALL_SEED, SMALL_CASES),
        action(ACTION_SEED, ACTION_CASES),
        Set("measured", len(MEASURED), _of(MEASURED)),
        Set("trials", len(TRIALS), _of(TRIALS)),
        Set("signals", len(rigs.SIGNALS), _of(rigs.SIGNALS)),
        Set("stories", len(_story_names()), _story, _make_stories),
    )
}
#: Sets that can be drawn with a new seed.
SEALED: Mapping[str, Callable[[int, int], Set]] = {
    "imperfect": imperfect,
    "small": small,
    "action": action,
}
