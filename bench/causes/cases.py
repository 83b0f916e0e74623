"""Cases of the leaderboard: folders with records, a model and candidates; the truth is sealed.

A case folder has the format of ``report.write``: ``case.json`` with the priors, the candidates and
the hash of every file, ``records/`` in SI units, and ``model/model.py``, which defines ``model``
and ``effects``. The truth is not in the folder but in ``NAME.truth.json`` beside it; ``case.json``
has its SHA-256 with a salt, so that nobody can change it later.
"""

from __future__ import annotations

import functools
import hashlib
import json
import secrets
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from blind.imperfect.machines import TABLES
from blind.marks import Cause, Truth, without_nan
from blind.yardstick_sets import SETS as BLIND
from blind.yardstick_sets import small
from causes import robots
from unmodeled import Options, Record, Sensor
from unmodeled.data import read_record, write_record
from unmodeled.loading import load_model
from unmodeled.report.case import FORMAT, VERSION, _numbers_of, as_stored, sha256_of, versions
from unmodeled.report.stored import Stored
from unmodeled.verification import _model_again

__all__ = ["SETS", "Case", "opened", "sealed", "truth_of", "write"]

HERE = Path(__file__).resolve().parent
DATA, RIGS = HERE / "data", HERE / "rigs"
GRAM = 9.80665e-3
"""Weight of a gram [N]."""


@dataclass(frozen=True)
class Case:
    """A case before it is written."""

    name: str
    make: Callable[[Path], tuple[Sequence[Record], Truth]]
    """Records and truth; the argument is a folder for simulations."""
    model: str
    """Text of the file of the model."""
    files: Mapping[str, str] | None = None
    """Further files beside the model: name -> text."""


# ---------------------------------------------------------------- folders


def sealed(truth: Truth, salt: str) -> str:
    """SHA-256 of a truth with a salt."""
    plain = json.dumps(without_nan(asdict(truth)), sort_keys=True, default=list)
    return hashlib.sha256((salt + plain).encode()).hexdigest()


def write(case: Case, folder: Path, cache: Path) -> None:
    """Write the folder of a case, and its truth beside it."""
    records, truth = case.make(cache)
    if folder.exists():
        shutil.rmtree(folder)
    (folder / "records").mkdir(parents=True)
    (folder / "model").mkdir()
    kept, rows = [], []
    for k, record in enumerate(records):
        path = folder / "records" / f"{k + 1:02d}.csv"
        kept += [write_record(record, path), path.with_suffix(".toml")]
        own = {"inputs": [*record.inputs], "outputs": [*record.outputs]}
        rows.append({"file": f"records/{path.name}", "name": record.name, **own})
    for name, text in {"model.py": case.model, **(case.files or {})}.items():
        (folder / "model" / name).write_text(text, encoding="utf-8")
        kept.append(folder / "model" / name)
    loaded = load_model(str(folder / "model" / "model.py"))
    effects = loaded.with_records(records).effects
    salt = secrets.token_hex(16)
    stored = {
        "format": FORMAT,
        "version": VERSION,
        "made_with": versions(),
        "model": {
            "name": loaded.model.name, "made_by": "load_model", "file": "model/model.py",
            "object": "", "arguments": {}, "included": [],
            "parameters": [as_stored(p) for p in loaded.model.parameters],
        },
        "candidates": [dict(_numbers_of(e)) for e in effects],
        "records": rows,
        "hold_out": None,
        "options": as_stored({f.name: getattr(Options(), f.name) for f in fields(Options)}),
        "not_stored": [],
        "sha256": {p.relative_to(folder).as_posix(): sha256_of(p) for p in kept},
        "sha256_of_truth": sealed(truth, salt),
    }  # fmt: skip
    (folder / "case.json").write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    plain = {"salt": salt, "truth": without_nan(asdict(truth))}
    _beside(folder).write_text(json.dumps(plain, indent=1, default=list) + "\n", encoding="utf-8")


def _beside(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.truth.json")


def _stored(folder: Path) -> dict[str, Any]:
    case: dict[str, Any] = json.loads((folder / "case.json").read_text("utf-8"))
    return case


def opened(folder: Path) -> tuple[Any, tuple[Any, ...], tuple[Record, ...]]:
    """Model, candidates and records of a folder whose files are those that were written.

    Raises
    ------
    ValueError
        A file is another one.
    """
    case = _stored(folder)
    changed = [n for n, digest in case["sha256"].items() if sha256_of(folder / n) != digest]
    if changed:
        raise ValueError(f"{folder}: changed after it was written: {', '.join(changed)}")
    records = tuple(
        read_record(folder / r["file"], inputs=r["inputs"], outputs=r["outputs"])
        for r in case["records"]
    )
    return (
        *_model_again(
            folder,
            Stored(**{k: v for k, v in case.items() if k in Stored.model_fields}),
            "",
            records,
        ),
        records,
    )


def truth_of(folder: Path) -> tuple[Truth, str]:
    """Truth of a case and its salt.

    Raises
    ------
    ValueError
        It is not the truth that was sealed.
    """
    plain = json.loads(_beside(folder).read_text("utf-8"))
    truth = Truth.of(plain["truth"])
    if sealed(truth, plain["salt"]) != _stored(folder)["sha256_of_truth"]:
        raise ValueError(f"{folder}: the truth is not the one that was sealed")
    return truth, plain["salt"]


# ---------------------------------------------------------------- interventions

FRICTION = ("dry friction", "friction along the travel", "hysteresis")
ELASTIC = ("constant force", "linear stiffness", "quadratic stiffness", "cubic stiffness")
#: Before, after, truth.
SWITCHES: tuple[tuple[str, str, Truth], ...] = (
    *((a, b, Truth("effect", (Cause(FRICTION), Cause(ELASTIC)), about=about))
      for a, b, about in (
          ("yellow_without_leaf", "yellow_with_leaf", "leaf spring put in"),
          ("yellow_with_leaf", "yellow_without_leaf", "leaf spring removed"),
      )),
    # The lubricated switch is another sample: its spring is a little different.
    *((a, b, Truth("effect", (Cause(FRICTION),), free=ELASTIC, about=about))
      for a, b, about in (
          ("twilight_dry", "twilight_lubricated", "lubricated"),
          ("twilight_lubricated", "twilight_dry", "lubricant removed"),
      )),
    # A film moves the leaf against the slider: the bump changes, which no candidate has.
    *((f"ergo_{a}", f"ergo_{b}",
       Truth("outside", (Cause((), FRICTION),), about=f"film behind the leaf: {a} to {b}"))
      for a, b in (
          ("stock", "leaf_1_layer"), ("stock", "leaf_2_layers"), ("leaf_1_layer", "leaf_2_layers"),
          ("leaf_1_layer", "stock"), ("leaf_2_layers", "stock"), ("leaf_2_layers", "leaf_1_layer"),
      )),
)  # fmt: skip
#: Part of the travel that is compared: the finger touches, and the switch is not at its end [m].
TRAVEL = 0.6e-3, 3.9e-3


def _press(name: str) -> np.ndarray:
    """Travel [m] and force [N] of a switch."""
    path = DATA / "key_switches" / f"{name}.csv"
    return np.loadtxt(path, delimiter=",", skiprows=1) * (1e-3, GRAM)


def _switch(before: str, after: str, truth: Truth) -> Case:
    """A change of a switch. If nothing was changed, samples alternate: table, record, ..."""
    every = 2 if before == after else 1
    table, whole = _press(before)[::every], _press(after)[every - 1 :: 2 * every]

    def make(cache: Path) -> tuple[Sequence[Record], Truth]:
        x, force = whole.T
        v = 1e-3 * np.sign(np.gradient(x))
        seen = (x >= TRAVEL[0]) & (x <= TRAVEL[1]) & (v != 0.0)
        time = np.arange(int(seen.sum())) * float(np.median(np.abs(np.diff(x)))) / 1e-3
        record = Record(
            name=after, time=time, inputs={"x": x[seen], "v": v[seen]},
            input_units={"x": "m", "v": "m/s"}, outputs={"force": force[seen]},
            sensors={"force": Sensor(name="force", unit="N")}, input_mode="motion",
        )  # fmt: skip
        return [record], truth

    rows = "".join(f"{x:.9g},{f:.9g}\n" for x, f in table)
    name = f"{before}-nothing" if before == after else f"{before}-to-{after}"
    text = (RIGS / "switch.py").read_text("utf-8")
    return Case(name, make, text, {"before.csv": f"x [m],force [N]\n{rows}"})


def _gaveau(springs: bool) -> Case:
    """Springs of the whippens put in, or one rough key."""

    def make(cache: Path) -> tuple[Sequence[Record], Truth]:
        table = np.genfromtxt(DATA / "gaveau_keys.csv", delimiter=",", skip_header=1)
        columns = table.T if not springs else table[np.isfinite(table).all(axis=1)].T
        key, after, before, up = columns[0], *(GRAM * c for c in columns[1:4])
        friction = 0.5 * (before - up)
        inputs = {"key": key, "before": before, "friction": friction,
                  "front": GRAM * columns[4], "strike": GRAM * columns[5]}  # fmt: skip
        if not springs:
            del inputs["friction"]  # it is the output
        good = np.all([np.isfinite(v) for v in inputs.values()], axis=0)
        inputs = {n: v[good] for n, v in inputs.items()}
        output = {"down": after[good]} if springs else {"friction": friction[good]}
        cause = "support spring" if springs else "rough key 4"
        about = "springs put in, 15 gf (published)" if springs else "key 4 is rough, 18 gf"
        record = Record(
            name="gaveau", time=key[good], inputs=inputs, outputs=output,
            input_units={n: "1" if n == "key" else "N" for n in inputs},
            sensors={n: Sensor(name=n, unit="N", sigma=2.0 * GRAM) for n in output},
            input_mode="motion",
        )  # fmt: skip
        # Nobody knows whether the springs are the same along the keyboard.
        free = ("friction", "slope*") if springs else ("strike weight", "front weight", "slope*")
        return [record], Truth("effect", (Cause((cause,)),), free=free, about=about)

    name = "gaveau-springs" if springs else "gaveau-key-4"
    rig = "gaveau_springs.py" if springs else "gaveau_friction.py"
    return Case(name, make, (RIGS / rig).read_text("utf-8"))


def _interventions() -> list[Case]:
    nothing = Truth("control", about="nothing was changed: other samples of the same press")
    alone = sorted(p.stem for p in (DATA / "key_switches").glob("*.csv"))
    changes = [_switch(*s) for s in SWITCHES] + [_switch(n, n, nothing) for n in alone]
    return [*changes, _gaveau(True), _gaveau(False)]


# ---------------------------------------------------------------- cases of the blind benches

_OF_TASK = '''"""Case {number} of the set {blind} of bench/blind; bench is on the path of Python."""

from pathlib import Path

from blind.yardstick_sets import SETS

task = SETS["{blind}"].task({number}, Path())
model, effects = task.model, list(task.effects)
'''
_OF_MACHINE = '''"""The {machine} as an engineer states it; bench is on the path of Python."""

from pathlib import Path

from blind.imperfect.machines import TABLES
from blind.imperfect.stated import stated
from unmodeled.data import read_record

table = next(t for t in TABLES if t.name == "{machine}")
outputs = list(table.outputs)
inputs = [n for n in table.units if n not in outputs]
first = Path(__file__).resolve().parents[1] / "records" / "01.csv"
model, effects = stated(table, read_record(first, inputs=inputs, outputs=outputs))
effects = list(effects)
'''
_OF_SMALL = '''"""Key and hammer as stated; bench is on the path of Python."""

from blind.key_hammer import effects as known
from blind.small_machine import stated_model

model, effects = stated_model(), list(known())
'''
#: Seed and number of new machines of the key-and-hammer bench.
SMALL_SEED, SMALL_COUNT = 20261130, 30


def _blind(found: Any, number: int, name: str, text: str) -> Case:
    def make(cache: Path) -> tuple[Sequence[Record], Truth]:
        found.make([number], cache)
        task = found.task(number, cache)
        return task.records, task.truth

    return Case(name, make, text)


def _tasks(blind: str, names: Iterable[str]) -> list[Case]:
    return [
        _blind(BLIND[blind], n, name, _OF_TASK.format(blind=blind, number=n))
        for n, name in enumerate(names)
    ]


def _machines() -> list[Case]:
    imperfect = [
        _blind(BLIND["imperfect"], n, f"{table.name.replace(' ', '_')}-{n % 10}",
               _OF_MACHINE.format(machine=table.name))
        for n in range(10 * len(TABLES))
        for table in (TABLES[n // 10],)
    ]  # fmt: skip
    drawn = small(SMALL_SEED, SMALL_COUNT)
    return imperfect + [_blind(drawn, n, f"key_hammer-{n}", _OF_SMALL) for n in range(SMALL_COUNT)]


MEASURED = (
    "emps", "silverbox", "tanks", "leg_motor", "pendulum", "bouc_wen", "ball", "leg_motor_no_noise",
)  # fmt: skip
QUESTIONS = (
    "overdamped_joint", "slow_clock", "offset_of_each_run", "few_samples",
    *(f"one_way_motion_{k}" for k in range(4)), "free_swing",
)  # fmt: skip

#: Set -> its cases.
SETS: Mapping[str, Callable[[], list[Case]]] = {
    "interventions": functools.cache(_interventions),
    "measured": functools.cache(lambda: _tasks("measured", MEASURED)),
    "machines": functools.cache(_machines),
    "questions": functools.cache(lambda: _tasks("trials", QUESTIONS)),
    "robots": functools.cache(
        lambda: [
            Case(f"robot-{n}", robot.make, robots.MODEL, {"robot.xml": robot.xml})
            for n in range(len(robots.FAULTS))
            for robot in (robots.Robot(n),)
        ]
    ),
}
