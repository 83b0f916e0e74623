"""Every public function and method refuses wrong arguments with a message of ours."""

import dataclasses
import importlib
import inspect
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import feltmb
import unmodeled
from feltmb import actuator, contact, felt, fiber, sensitivity
from feltmb.live.page import MODULE
from unmodeled import experiment, fit
from unmodeled.arguments import AnyNumber, checked
from unmodeled.errors import Error, InvalidParameter, shown
from unmodeled.ode import Integrator

MODULES = [
    "feltmb",
    "feltmb.action.actuator",
    "feltmb.contact",
    "feltmb.felt",
    "feltmb.fiber",
    "unmodeled.fit",
    "unmodeled.models",
    "unmodeled.ode",
    "unmodeled",
    "unmodeled.search.result",
    "unmodeled.experiment",
    "feltmb.action.regulate",
    "feltmb.run.sensitivity",
    "feltmb.run.sweep",
    "feltmb.action.touch",
]
DATA = Path(__file__).resolve().parents[2] / "data"

HUGE = 10**400  # an int that no float holds
HOSTILE = [
    *("abc", "0.3 s", "", "a\0b", None, True, -1, 0, -1.5, 1.5, math.nan, math.inf, -math.inf),
    *(HUGE, -HUGE, 10**5000, object(), b"x", [], [1.0], [1.0, 2.0, 3.0], ["a"], [None], [math.nan]),
    *([[1.0], [1.0, 2.0]], {}, {"a": 1}, {1: "a"}, {"a": HUGE}, np.ones((2, 3)), np.array("a")),
    *(lambda: None, 1j, Path("a"), type),
]
FEW = ["0.3 s", HUGE, object()]


# ---------------------------------------------------------------- valid calls


@cache
def pendulum():
    return feltmb.load_action(DATA / "pendulum.toml")


@cache
def stroke():
    return feltmb.pulse_stroke(1.0, 0.0, 0.005, 0.005, duration=0.02)


@cache
def run():
    return feltmb.simulate(pendulum(), stroke())


@cache
def gradient():
    return feltmb.gradient(pendulum(), stroke(), "arm.mass", ["arm.angle"])


@cache
def hammer():
    return felt.load_material("synthetic_hammer")


@cache
def felt_envelope():
    return felt.envelope(hammer(), 5e-3, felt.ConstantArea(1e-4), points=20)


@cache
def compressed():
    v = np.r_[np.linspace(0.05, 0.2, 20), np.linspace(0.2, 0.05, 20)[1:]]
    p = 1e6 * (v**3 - 0.04**3)
    return fiber.CompressionData(v, p, np.arange(v.size) < 20, 0.04)


def compressed_by_thickness():
    """The same test, told by thickness: 10 mm unloaded."""
    data = compressed()
    return dataclasses.replace(data, thickness=0.01 * data.v_f0 / data.v_f)


def hammer_test_data():
    """A compression test that has the shape of the law."""
    felt_ = hammer()
    v = np.linspace(1.001 * felt_.v_f0, felt_.end, 40)
    both = np.r_[v, v[-2::-1]]
    p = np.r_[felt_.pressure("loading", v), felt_.pressure("unloading", v[-2::-1])]
    return fiber.CompressionData(both, p, np.arange(both.size) < v.size, felt_.v_f0)


EYE = np.eye(3)
ISOTROPIC = sum(np.einsum(e, EYE, EYE) for e in ("ij,kl->ijkl", "ik,jl->ijkl", "il,jk->ijkl")) / 15
BOX = fiber.FiberBox(n_fibers=40, n_beads=8)
CYCLE = fiber.Cycle(0.12, 1e-3, 10, 20, 1)


@cache
def fiber_run():
    return fiber.simulate(BOX, CYCLE)


@cache
def law():
    return contact.law("hunt_crossley", stiffness=1e6)


MASS = unmodeled.Coordinate(name="mass", position="q", speed="v", inertia="m")
DRY = unmodeled.Effect(
    name="dry",
    component="guide",
    unit="N",
    scale=0.05,
    rate=lambda _t, x, _u, p, size, _shape: {"v": -size * np.tanh(x.v / 5e-3) / p.m},
)
PATHS = {
    "time": np.linspace(0.0, 1.0, 11),
    "parameters": np.array([[90.0, 2.0]]),
    "starts": np.array([[0.1, 0.0]]),
    "inputs": {"f": np.zeros(11)},
}
ODE = {
    "states": [
        unmodeled.State(name="q", unit="m", scale=0.01),
        unmodeled.State(name="v", scale=0.1),
    ],
    "rates": lambda _t, x, u, p: (x.v, (u.f - p.k * x.q - x.v) / p.m),
    "outputs": {"q": "q"},
    "parameters": [
        unmodeled.Parameter(name="m", value=1.0, sd=0.1, lower=0.1),
        unmodeled.Parameter(name="k", value=100.0, sd=10.0, lower=1.0),
    ],
    "inputs": ["f"],
    "coordinates": [MASS],
    "ports": None,
    "method": "rk4",
    "substeps": 1,
    "hold": "linear",
    "name": "oscillator",
}
REQUEST = {
    "theta": np.array([1.0, 100.0]),
    "start": np.zeros(2),
    "included": (),
    "magnitudes": np.zeros(0),
    "by_theta": (0, 1),
    "by_starts": True,
    "candidates": (),
}
LINEAR = {
    "output": "y",
    "columns": {"slope": lambda record: record.inputs["f"]},
    "parameters": [],
    "name": "line",
}
SIMULATOR = {
    "function": lambda _time, inputs, parameters: {"q": parameters["k"] * inputs["f"]},
    "parameters": [unmodeled.Parameter(name="k", value=1.0, sd=1.0)],
    "inputs": {"f": "N"},
    "outputs": {"q": "m"},
    "unknown": {"extra": fit.Exposed(scale=1.0)},
    "workers": 1,
    "name": "line",
}
FUNCTION = {
    "outputs": {"y": lambda record, p: p.slope * record.inputs["f"]},
    "parameters": [unmodeled.Parameter(name="slope", value=1.0, sd=1.0)],
    "name": "line",
}


@cache
def oscillator():
    return unmodeled.Equations(**ODE)


@cache
def integrator():
    return Integrator(ODE["rates"], states=["q", "v"], parameters=["k", "m"], inputs=["f"])


@cache
def record(name="one", seed=0):
    generator = np.random.default_rng(seed)
    time = np.arange(200) * 4e-3
    force = np.sin(10 * time) + generator.normal(0.0, 0.3, 200)
    bare = unmodeled.Record(
        name=name,
        time=time,
        inputs={"f": force},
        outputs={"q": np.zeros(200)},
        sensors={"q": unmodeled.Sensor(name="q", sigma=1e-4, unit="m")},
        start=unmodeled.StartPrior(mean={"q": 0.0, "v": 0.0}, sd={"q": 0.0, "v": 0.0}),
    )
    outputs = oscillator().simulate(bare, jobs())[0, :, 0]
    return unmodeled.Record(
        name=name,
        time=time,
        inputs=bare.inputs,
        outputs={"q": outputs + generator.normal(0.0, 1e-4, 200)},
        sensors=bare.sensors,
        start=bare.start,
    )


def table():
    """Two runs as a table of pandas."""
    time = 0.01 * np.arange(20)
    both = [pd.DataFrame({"run": k, "time": time, "f": k + time, "q": time**2}) for k in (1, 2)]
    return pd.concat(both, ignore_index=True)


def planned():
    return experiment.plan(oscillator(), [DRY], [record()])


def written(name, text):
    Path(name).write_text(text)
    return name


def jobs():
    return unmodeled.fit.Jobs(theta=np.array([[1.0, 100.0]]), starts=np.zeros((1, 2)))


@cache
def report():
    return unmodeled.diagnose(oscillator(), [DRY], [record("one", 1), record("two", 2)])


V = np.linspace(0.05, 0.2, 8)
CARNABY = {"mu": 0.3, "Wf0": 10.0, "E": 1e9, "d_f": 2e-5, "v_f0": 0.04, "gamma": 2.0,
           "k_bend": 1.0, "Q": 2.0, "form": "repaired"}  # fmt: skip
WYK = {"model": "van_wyk", "v_f": V, "strain": None, "threads": 1}


def wyk():
    from feltmb.fiber import models

    names = [p.name for p in models()["van_wyk"].parameters]
    return {k: v for k, v in {"k_p": 0.01, "E": 1e9, "v_f0": 0.04}.items() if k in names}


def model_methods(model):
    """Methods that all models have, with arguments."""
    theta = np.array([p.value for p in model.parameters])
    start = np.zeros(len(model.states()))
    rows = unmodeled.fit.Jobs(theta=theta[None], starts=start[None])
    return {
        "accepts": {"effect": DRY},
        "events": {"record": record(), "outputs": {"q": np.zeros(200)}},
        "motion": {"record": record(), "jobs": rows},
        "numbers": {"theta": theta, "included": (), "magnitudes": np.zeros(0)},
        "matched": {"records": [record()]},
        "ready": {"records": [record()]},
        "running": {"executor": None, "cache": None, "workers": None},
        "simulate": {"record": record(), "jobs": rows},
        "simulate_all": {"batches": [(record(), rows)]},
        "doubts": {"batches": [(record(), rows)]},
        "states": {"included": ()},
        "sensitivities": {"requests": [unmodeled.fit.SensitivityRequest(record(), theta, start)]},
        "with_parameters": {"parameters": {p.name: p for p in model.parameters[:1]}},
    }


FREE = {"model": "poisson", "v_f": 0.1, "d_f": 2e-5, "ratio": 1.0, "structure": None,
        "gamma": math.nan, "Q": math.nan, "diameter_cv": 0.0, "as_printed": False}  # fmt: skip


@cache
def steinway():
    action = feltmb.load_action("steinway45")
    return action.with_values({"shank.rigid": True, "wire.rigid": True})


@cache
def string_run():
    return feltmb.simulate(steinway(), "piano", 0.002)


@cache
def wood():
    return actuator.load_actuator("wood")


@cache
def actuator_run():
    return actuator.simulate_actuator("wood", None, 0.002, output_rate=1000.0)


def symptoms():
    return importlib.import_module("feltmb.action.symptoms")


def wear_file():
    path = Path("wear.json")
    path.write_text(json.dumps(symptoms().packaged_wear().as_dict()), encoding="utf-8")
    return path


def sweeps():
    return importlib.import_module("feltmb.run.sweep")


def member():
    return sweeps().Member(pendulum(), stroke(), {}, {"duration": 0.002})


@cache
def swept():
    return feltmb.sweep(
        pendulum(), stroke(), {"arm.mass": [0.02]}, options={"duration": 0.002}, progress=False,
        folder=Path.cwd() / "sweep", summary_only=False,
    )  # fmt: skip


@cache
def one_step():
    return importlib.import_module("feltmb.action.regulate").Step(
        name="height", measure="rest_gap", contact=2, target=0.01, tolerance=1e-5
    )


@cache
def nothing_to_turn():
    return importlib.import_module("feltmb.action.regulate").Targets(
        schema=1, name="t", rounds=1, steps=[one_step()]
    )


def loop():
    e = felt_envelope()
    return e.compression[1:], e.loading[1:], e.unloading[1:]


def envelope_file():
    path = Path("envelope.toml")
    path.write_text(felt_envelope().to_toml(), encoding="utf-8")
    return path


@cache
def measured():
    one = felt_envelope()
    e = np.concatenate([one.compression, one.compression[::-1]])
    return felt.measured_loop(e, np.concatenate([one.loading, one.unloading[::-1]]))


def specimen():
    e = np.linspace(0.0, 1e-3, 40)
    return felt.Specimen("one", e, 1e7 * e**2, zero=0.0)


@cache
def power_law():
    return felt.fit_law(specimen())


def measured_file():
    path = Path("pair.csv")
    found = measured()
    rows = [f"{1e3 * x},{f}" for x, f in zip(found.compression, found.force, strict=True)]
    path.write_text("displacement [mm],force [N]\n" + "\n".join(rows), encoding="utf-8")
    return path


def csv_stroke():
    path = Path("stroke.csv")
    path.write_text("time [s],force [N]\n0,0\n0.1,1\n", encoding="utf-8")
    return path


def csv_compression():
    path = Path("compression.csv")
    rows = [f"{v},{p}" for v, p in zip(compressed().v_f, compressed().pressure, strict=True)]
    path.write_text("\n".join(["v_f,pressure [Pa]", *rows]), encoding="utf-8")
    return path


def csv_directions():
    path = Path("directions.csv")
    path.write_text("x,y,z\n1,0,0\n0,1,0.5\n", encoding="utf-8")
    return path


#: "module.function" or "module.Class" -> arguments; "module.Class.method" -> object, arguments.
CALLS = {
    # feltmb
    "feltmb.Action": lambda: {"raw": pendulum().raw, "origin": "a"},
    "feltmb.Action.value": lambda: (pendulum(), {"path": "arm.mass"}),
    "feltmb.Action.with_values": lambda: (pendulum(), {"values": {"arm.mass": "21 g"}}),
    "feltmb.IntegrationError": None,  # an exception: made by the program
    "feltmb.Gradient.effects": lambda: (gradient(), {"change": 0.01}),
    "feltmb.Gradient.of": lambda: (gradient(), {"output": "arm.angle", "column": None}),
    "feltmb.Gradient.plot": lambda: (gradient(), {"number": None, "most": 3}),
    "feltmb.Run.event_time": lambda: (run(), {"name": "felt_on"}),
    "feltmb.Run.plot": lambda: (run(), {"kind": "contact_forces"}),
    "feltmb.Run.save": lambda: (run(), {"path": "run.nc", "force": True, "compress": False}),
    "feltmb.Run.string_displacement": lambda: (string_run(), {"position": 0.5}),
    "feltmb.Run.string_shapes": lambda: (string_run(), {"position": 0.5}),
    "feltmb.Run.unit": lambda: (run(), {"name": "arm.angle"}),
    "feltmb.Run.write_wav": lambda: (
        string_run(),
        {"path": "a.wav", "position": None, "rate": 44100, "slowness": 1.0, "force": True},
    ),
    "feltmb.Stroke": lambda: {
        "name": "s",
        "kind": "force",
        "time": (0.0, 0.1),
        "value": (0.0, 1.0),
        "interpolation": "linear",
        "oscillation_amplitude": 0.0,
        "oscillation_frequency": 0.0,
        "duration": 0.1,
        "source": "",
    },
    "feltmb.Stroke.at": lambda: (stroke(), {"time": 0.01}),
    "feltmb.Stroke.scaled": lambda: (stroke(), {"factor": 2.0}),
    "feltmb.Stroke.shifted": lambda: (stroke(), {"delay": 0.1}),
    "feltmb.Stroke.smoothed": lambda: (
        feltmb.table_stroke(np.arange(50.0), np.sin(np.arange(50.0))),
        {"noise": 0.1},
    ),
    "feltmb.Touch.plot": None,  # minutes of measuring for one path
    "feltmb.evaluate": lambda: {
        "action": pendulum(),
        "q": [0.1],
        "qd": [0.0],
        "finger_force": 0.0,
    },
    "feltmb.gradient": lambda: {
        "action": pendulum(),
        "stroke": stroke(),
        "parameters": ["arm.mass"],
        "outputs": ["arm.angle"],
        "duration": 0.02,
        "rtol": 1e-7,
        "tolerance": 3e-3,
        "output_rate": 1000.0,
    },
    "feltmb.load_action": lambda: {"name_or_path": str(DATA / "pendulum.toml")},
    "feltmb.load_run": lambda: {"path": run().save("loaded.nc", force=True)},
    "feltmb.load_stroke": lambda: {"name_or_path": "piano"},
    "feltmb.load_targets": lambda: {"name_or_path": "steinway45"},
    "feltmb.motion_stroke": lambda: {
        "time": [0.0, 0.1, 0.2],
        "displacement": [0.0, 1e-3, 0.0],
        "of": "finger",
        "interpolation": None,
        "duration": None,
        "name": "m",
    },
    "feltmb.pulse_stroke": lambda: {
        "force": 1.0,
        "start": 0.0,
        "rise": 0.01,
        "fall": 0.01,
        "hold": 0.0,
        "duration": None,
        "name": "p",
    },
    "feltmb.ramp_stroke": lambda: {
        "force": 1.0,
        "start": 0.0,
        "ramp": 0.01,
        "duration": None,
        "oscillation": (0.1, 5.0),
        "name": "r",
    },
    "feltmb.read_stroke_csv": lambda: {"path": csv_stroke(), "interpolation": None},
    "feltmb.regulate": lambda: {
        "action": steinway(),
        "targets": nothing_to_turn(),
        "progress": None,
    },
    "feltmb.repeat": lambda: {
        "action": steinway(),
        "forces": (10.0,),
        "returns": (1.0,),
        "highest": 3.1,
    },
    "feltmb.sequence": lambda: {"strokes": (stroke(), stroke()), "period": None, "name": "twice"},
    "feltmb.RunOptions": lambda: {
        "duration": 0.01,
        "rtol": 1e-6,
        "method": "auto",
        "output_rate": 1e4,
        "ledger": True,
        "events": True,
        "summary_only": False,
        "error": None,
        "max_wall": None,
        "max_step": None,
        "max_order": None,
        "ledger_limit": None,
    },
    "feltmb.simulate": lambda: {
        "action": pendulum(),
        "stroke": stroke(),
        "duration": 0.01,
        "rtol": 1e-6,
        "method": "auto",
        "output_rate": 1000.0,
        "ledger": True,
        "events": True,
        "summary_only": False,
        "error": None,
        "start": None,
        "max_wall": None,
        "max_step": None,
        "max_order": None,
        "progress": None,
    },
    "feltmb.sweep": lambda: {
        "action": pendulum(),
        "stroke": stroke(),
        "values": {"arm.mass": [0.02]},
        "mode": "grid",
        "options": {"duration": 0.001},
        "executor": None,
        "jobs": 1,
        "folder": None,
        "summary_only": True,
        "progress": False,
    },
    "feltmb.table_stroke": lambda: {
        "time": [0.0, 0.1],
        "force": [0.0, 1.0],
        "interpolation": "linear",
        "duration": None,
        "name": "t",
    },
    "feltmb.torque_stroke": lambda: {
        "time": [0.0, 0.1],
        "torque": [0.0, 1.0],
        "interpolation": "linear",
        "duration": None,
        "name": "t",
    },
    "feltmb.touch": lambda: {
        "action": pendulum(),  # has no key: refused after the arguments were looked at
        "forces": (5.0,),
        "speeds": (0.5,),
        "executor": None,
        "progress": None,
    },
    "feltmb.view": lambda: {"runs": run(), "path": "v.html", "force": True, "options": {}},
    "feltmb.Machine": lambda: {
        "action": pendulum(),
        "hold": "zero",
        "rtol": 1e-6,
        "method": "auto",
        "max_order": None,
        "max_step": None,
        "max_wall": None,
        "events": True,
    },
    "feltmb.Machine.advance": lambda: (
        feltmb.Machine(pendulum()),
        {
            "dt": 1e-3,
            "force": 1.0,
            "motion": None,
            "key_motion": None,
            "torque": None,
            "motor_motion": None,
            "speed": None,
        },
    ),
    "feltmb.Machine.reset": lambda: (feltmb.Machine(pendulum()), {"start": {"arm.angle": 0.1}}),
    "feltmb.Machine.read": lambda: (
        feltmb.Machine(pendulum()),
        {"channel": "arm.angle", "unit": "deg"},
    ),
    "feltmb.Machine.restore": lambda: (
        feltmb.Machine(pendulum()),
        {"state": feltmb.Machine(pendulum()).state()},
    ),
    "feltmb.export_felt": lambda: {
        "law": feltmb.contact.law("kelvin_voigt", stiffness=1e4),
        "path": "felt.fmu",
        "name": "pad",
        "version": "2.0",
        "parameters": ["law.*"],
        "force": False,
    },
    "feltmb.export_felt_c": lambda: {
        "law": feltmb.contact.law("kelvin_voigt", stiffness=1e4),
        "folder": "pad",
        "force": False,
    },
    "feltmb.export_fmu": lambda: {
        "action": pendulum(),
        "path": "unit.fmu",
        "version": "3.0",
        "drive": None,
        "hold": None,
        "parameters": ["bodies.*"],
        "rtol": 1e-6,
        "method": "auto",
        "max_order": None,
        "force": True,
    },
    # Without its compiled module it refuses everything.
    "feltmb.export_page": (
        (lambda: {"action": pendulum(), "path": "page.html", "force": True})
        if MODULE.is_file()
        else None
    ),
    # felt
    "feltmb.felt.FeltEnvelope": lambda: {
        "compression": np.array([0.0, 1e-3, 2e-3]),
        "loading": np.array([0.0, 1.0, 4.0]),
        "unloading": np.array([0.0, 0.5, 4.0]),
        "name": "e",
        "about": "",
        "memory": {"kappa": 0.1},
        "made": None,
    },
    "feltmb.felt.FeltEnvelope.law": lambda: (felt_envelope(), {"options": {"kappa": 0.5}}),
    "feltmb.felt.FeltEnvelope.to_toml": lambda: (
        felt_envelope(),
        {"action": "steinway45", "contact": "01"},
    ),
    "feltmb.felt.CircleOnLayer": lambda: {"radius": 5e-3, "width": 0.01, "length": 0.02},
    "feltmb.felt.CircleOnLayer.area": lambda: (
        felt.CircleOnLayer(5e-3, 0.01),
        {"compression": 1e-3},
    ),
    "feltmb.felt.ConstantArea": lambda: {"size": 1e-4},
    "feltmb.felt.ConstantArea.area": lambda: (felt.ConstantArea(1e-4), {"compression": 1e-3}),
    "feltmb.felt.CrossedCylinders": lambda: {"radius_a": 5e-3, "radius_b": 1e-3},
    "feltmb.felt.CrossedCylinders.area": lambda: (
        felt.CrossedCylinders(5e-3, 1e-3),
        {"compression": 1e-3},
    ),
    "feltmb.felt.SphereOnLayer": lambda: {"radius": 5e-3},
    "feltmb.felt.SphereOnLayer.area": lambda: (felt.SphereOnLayer(5e-3), {"compression": 1e-3}),
    "feltmb.felt.FeltMaterial": lambda: {
        "schema": 1,
        "name": "f",
        "about": "",
        "source": {},
        "v_f0": 0.1,
        "v_f_max": 0.4,
        "fiber": hammer().fiber,
        "loading": hammer().loading,
        "unloading": hammer().unloading,
        "critical_angles": None,
    },
    "feltmb.felt.FeltMaterial.branch": lambda: (hammer(), {"which": "loading", "v_f": V + 0.2}),
    "feltmb.felt.FeltMaterial.loss": lambda: (hammer(), {"points": 101}),
    "feltmb.felt.FeltMaterial.pressure": lambda: (hammer(), {"which": "loading", "v_f": 0.3}),
    "feltmb.felt.FeltMaterial.with_branches": lambda: (
        hammer(),
        {
            "loading": hammer().loading,
            "unloading": hammer().unloading,
            "v_f_max": hammer().v_f_max,
        },
    ),
    "feltmb.felt.Branch": lambda: {"K_p": 1e6, "gamma": 2.0},
    "feltmb.felt.Fiber": lambda: {
        "diameter": 2e-5,
        "friction": 0.3,
        "withdrawal_force": 1.0,
        "young_modulus": None,
        "Q": 2.0,
    },
    "feltmb.fiber.material.CriticalAngles": lambda: {
        "v_f": (0.1, 0.2),
        "loading": (0.1, 0.2),
        "unloading": (0.1, 0.2),
        "unit": "rad",
    },
    "feltmb.felt.audit": lambda: {
        "law": law(),
        "name": "l",
        "largest": 1e-3,
        "amplitudes": (0.5, 1.0),
        "frequencies": (1.0,),
    },
    "feltmb.felt.audit_targets": lambda: {
        "text": "synthetic_hammer",
        "settings": (),
        "everything": False,
        "all_hint": "",
    },
    "feltmb.felt.contact_loop": lambda: {
        "contact": pendulum().config.contacts["01"],
        "name": "c",
        "points": 20,
    },
    "feltmb.felt.MeasuredLoop": lambda: {
        f: getattr(measured(), f)
        for f in (
            "compression",
            "force",
            "zero",
            "branches",
            "envelope",
            "uncertainty",
            "notes",
            "by_thickness",
        )
    },
    "feltmb.felt.LoopUncertainty": lambda: {
        f: getattr(measured().uncertainty, f)
        for f in ("loading", "unloading", "loss", "zero", "cycles", "kappa")
    },
    "feltmb.felt.MeasuredLoop.law": lambda: (measured(), {"options": {"kappa": 0.5}}),
    "feltmb.felt.measured_loop": lambda: {
        "displacement": measured().compression,
        "force": measured().force,
        "zero": 0.0,
        "points": 50,
        "name": "pair",
    },
    "feltmb.felt.MeasuredLoop.kawabata": lambda: (measured(), {"area": 1e-4}),
    "feltmb.felt.Specimen": lambda: {
        f: getattr(specimen(), f) for f in ("name", "displacement", "force", "zero", "notes")
    },
    "feltmb.felt.LawFit": lambda: {
        f: getattr(power_law(), f)
        for f in (
            "law",
            "name",
            "values",
            "interval",
            "rms",
            "relative",
            "compression",
            "force",
            "fitted",
            "warnings",
            "entry",
        )
    },
    "feltmb.felt.PooledLaw": lambda: {
        "law": "power",
        "fits": (power_law(),),
        "values": {"exponent": 2.0},
        "interval": {"exponent": (1.0, 3.0)},
        "compression": np.ones(2),
        "force": np.ones(2),
        "scatter": np.ones(2),
    },
    "feltmb.felt.fit_law": lambda: {"test": specimen(), "law": "power", "thickness": None},
    "feltmb.felt.pool": lambda: {"tests": [specimen(), specimen()], "law": "power"},
    "feltmb.felt.bulk": lambda: {"v_f": 0.2, "thickness": 6e-3, "diameter": 2e-5},
    "feltmb.felt.read_specimen": lambda: {"path": measured_file(), "zero": 0.0},
    "feltmb.felt.read_measured_loop": lambda: {
        "path": measured_file(),
        "zero": 0.0,
        "points": 50,
    },
    "feltmb.felt.envelope": lambda: {
        "material": hammer(),
        "thickness": 5e-3,
        "area": felt.ConstantArea(1e-4),
        "compression": "even",
        "largest": None,
        "points": 10,
        "name": None,
    },
    "feltmb.felt.fit_contact": lambda: {
        **dict(zip(("compression", "loading", "unloading"), loop(), strict=True)),
        "area": felt.ConstantArea(1e-4),
        "fibers": hammer(),
        "thickness": None,
        "gamma": math.pi / 2,
        "friction_share": 0.1,
        "name": "f",
        "about": "",
    },
    "feltmb.felt.identify": lambda: {
        "data": hammer_test_data(),
        "pressure": None,
        "material": hammer(),
        "loading": None,
        "v_f0": None,
        "relative": 0.0,
        "level": 0.95,
        "name": None,
    },
    "feltmb.felt.load_envelope": lambda: {"path": envelope_file()},
    "feltmb.felt.load_material": lambda: {"name_or_path": "synthetic_hammer"},
    "feltmb.felt.parse_area": lambda: {"text": "constant:1cm^2"},
    # fiber
    "feltmb.fiber.CompressionData": lambda: {
        "v_f": compressed().v_f,
        "pressure": compressed().pressure,
        "loading": compressed().loading,
        "v_f0": 0.04,
        "name": "d",
    },
    "feltmb.fiber.CompressionData.with_thickness": lambda: (
        compressed_by_thickness(),
        {"thickness0": 0.01},
    ),
    "feltmb.fiber.CompressionData.branch": lambda: (compressed(), {"which": "loading"}),
    "feltmb.fiber.Cycle": lambda: {
        "v_max": 0.3,
        "strain_per_step": 2e-5,
        "relax_steps": 10,
        "sample_every": 10,
        "cycles": 1,
    },
    "feltmb.fiber.FiberBox": lambda: {
        name: getattr(BOX, name) for name in inspect.signature(fiber.FiberBox).parameters
    },
    "feltmb.fiber.FiberRun.column": lambda: (fiber_run(), {"name": "pressure"}),
    "feltmb.fiber.FiberRun.load": lambda: (
        fiber.FiberRun,
        {"path": fiber_run().save("fibers.npz")},
    ),
    "feltmb.fiber.FiberRun.pressure_exponent": lambda: (fiber_run(), {"v_low": 0.01}),
    "feltmb.fiber.FiberRun.save": lambda: (fiber_run(), {"path": "fibers.npz"}),
    "feltmb.fiber.Network.deform": lambda: (
        fiber.network(100),
        {"deformation": np.diag([1.0, 1.0, 0.5])},
    ),
    "feltmb.fiber.Network.structure": lambda: (fiber.network(100), {"threads": 1}),
    "feltmb.fiber.Network.tensors": lambda: (fiber.network(100), {"threads": 1}),
    "feltmb.fiber.unusual": lambda: {"d_f": 25e-6},
    "feltmb.fiber.carnaby_pan": lambda: {"v_f": V, **CARNABY},
    "feltmb.fiber.carnaby_pan_march": lambda: {
        "C": np.linspace(1e-8, 1e-7, 4),
        **CARNABY,
        "substeps": 2,
    },
    "feltmb.fiber.compare": lambda: {
        "data": compressed(),
        "names": ["van_wyk"],
        "branch": "loading",
        "fixed": None,
        "options": {"n_starts": 1},
    },
    "feltmb.fiber.fit_branches": lambda: {
        "data": compressed(),
        "model": "van_wyk",
        "branches": ["loading"],
        "options": {"n_starts": 1},
    },
    "feltmb.fiber.compress_arcs": lambda: {
        "strain": np.linspace(0.0, 0.3, 4),
        "E": 1e9,
        "v_f0": 0.1,
        "scheme": "confined",
        "chord_ratio": 0.9,
        "ratio": 1.0,
        "length_shape": 0.0,
        "slip_stress": 0.0,
    },
    "feltmb.fiber.contact_count": lambda: {
        "model": "poisson",
        "v_f": 0.1,
        "d_f": 2e-5,
        "fiber_length": 1e-3,
        "ratio": 1.0,
        "length_cv": 0.0,
        "gamma": math.nan,
        "k_max": 10,
    },
    "feltmb.fiber.contacts_per_volume": lambda: {
        **FREE,
        "counting": "source",
    },
    "feltmb.fiber.mean_free_length": lambda: dict(FREE),
    "feltmb.fiber.critical_angle": lambda: {"w": V, "mu": 0.3},
    "feltmb.fiber.density_structure": lambda: {
        "density": None,
        "deformation": np.diag([1.0, 1.0, 0.9]),
        "tolerance": 1e-6,
        "obstruction": False,
        "max_nodes": 96,
    },
    "feltmb.fiber.fit": lambda: {
        "data": compressed(),
        "model": "van_wyk",
        "free": None,
        "fixed": None,
        "bounds": None,
        "start": None,
        "branch": "loading",
        "method": "least_squares",
        "n_starts": 1,
        "seed": 0,
        "relative": 0.0,
        "level": 0.95,
    },
    "feltmb.fiber.free_length_survival": lambda: {
        "model": "poisson",
        "x": V,
        "v_f": 0.1,
        "d_f": 2e-5,
        "ratio": 1.0,
        "gamma": math.nan,
    },
    "feltmb.fiber.granular_stress": lambda: {
        "path": [np.diag([1.0, 1.0, 1.0 - e]) for e in (0.0, 0.05, 0.1)],
        "v_random": 0.1,
        "E": 1e9,
        "k_b": 1.0,
        "k_t": 1.0,
        "beta": 0.0,
        "transverse": False,
        "substeps": 1,
        "nodes": 8,
    },
    "feltmb.fiber.history": lambda: {
        "model": "stulov",
        "time": V,
        "compression": V,
        "rate": None,
        "spring": "van_wyk",
        "params": {"stiffness": 1e9, "exponent": 2.5, "amplitude": 0.9, "time": 1e-3},
    },
    "feltmb.fiber.law": lambda: {"model": "van_wyk", "params": wyk()},
    "feltmb.fiber.lay": lambda: {
        "box": BOX,
        "threads": 1,
        "directions": np.eye(3)[np.arange(BOX.n_fibers) % 3],
    },
    "feltmb.fiber.narter_tensors": lambda: {
        "eeee": ISOTROPIC,
        "E": 1e9,
        "v_f": 0.1,
    },
    "feltmb.fiber.network": lambda: {"n": 100, "seed": 0, "spread": 3, "threads": 1},
    "feltmb.fiber.pressure": lambda: {**WYK, "params": wyk()},
    "feltmb.fiber.read_compression": lambda: {
        "path": csv_compression(),
        "v_f0": 0.04,
        "thickness0": None,
        "area": None,
    },
    "feltmb.fiber.read_directions": lambda: {"path": csv_directions()},
    "feltmb.fiber.simulate": lambda: {
        "box": BOX,
        "cycle": CYCLE,
        "resume": None,
        "directions": None,
        "threads": 1,
        "progress": None,
        "checkpoint": None,
        "max_samples": 2,
    },
    "feltmb.fiber.structure": lambda: {"ratio": 1.5},
    "feltmb.fiber.uniaxial_tensor": lambda: {"ratio": 1.5},
    # fit
    "unmodeled.fit.Coordinate": lambda: {
        "name": "mass",
        "position": "q",
        "speed": "v",
        "inertia": 1.0,
        "unit": "N",
        "scale": 1.0,
    },
    "unmodeled.fit.Coordinate.motion": None,  # inside the right-hand side, once a step
    "unmodeled.fit.Coordinate.push": None,  # inside the right-hand side, once a step
    "unmodeled.fit.Coupling": lambda: {
        "name": "link",
        "first": MASS,
        "second": MASS,
        "ratio": 1.0,
        "unit": "N",
        "scale": 1.0,
        "position": "",
        "position_scale": 1.0,
        "speed": "",
    },
    "unmodeled.fit.Coupling.motion": None,  # inside the right-hand side, once a step
    "unmodeled.fit.Coupling.push": None,  # inside the right-hand side, once a step
    "unmodeled.fit.Effect": lambda: {
        name: getattr(DRY, name) for name in inspect.signature(unmodeled.Effect).parameters
    },
    "unmodeled.fit.FunctionModel": lambda: dict(FUNCTION),
    "unmodeled.fit.Simulator": lambda: dict(SIMULATOR),
    "unmodeled.fit.Exposed": lambda: {"scale": 1.0, "unit": "N", "component": "guide"},
    "unmodeled.fit.Exposed.effect": lambda: (fit.Exposed(scale=1.0), {"name": "extra"}),
    "unmodeled.fit.fmu": None,  # needs FMPy and an FMU
    "unmodeled.fit.mujoco": None,  # needs MuJoCo
    "unmodeled.servo_laws": None,  # needs MuJoCo
    "unmodeled.read": lambda: {
        "files": written("read.csv", "time [s],q [m]\n0,1\n1,2\n"),
        "inputs": (),
        "outputs": ["q"],
        "sigma": None,
        "units": None,
        "options": None,
    },
    "unmodeled.records_from_frame": lambda: {
        "frame": table(),
        "by": "run",
        "inputs": ["f"],
        "outputs": ["q"],
    },
    "feltmb.Action.with_laws": lambda: (
        pendulum(),
        {"laws": {pendulum().config.contacts and next(iter(pendulum().config.contacts)): law()}},
    ),
    "unmodeled.models.Jobs": lambda: {
        "theta": np.array([[1.0, 100.0]]),
        "starts": np.zeros((1, 2)),
        "included": (),
        "magnitudes": np.zeros((1, 0)),
        "forces": None,
    },
    "unmodeled.fit.LinearModel": lambda: dict(LINEAR),
    "unmodeled.models.Named": lambda: {"values": {"a": 1.0}},
    "unmodeled.fit.Equations": lambda: dict(ODE),
    "unmodeled.fit.Equations.force_in": None,  # inside the choice of the candidates
    "unmodeled.fit.Equations.is_parameter": None,  # inside the choice of the candidates
    "unmodeled.fit.Equations.drive_of": None,  # inside the choice of the candidates
    "unmodeled.fit.Equations.forces_in": None,  # inside the choice of the candidates
    "unmodeled.fit.Parameter": lambda: {
        "name": "p",
        "value": 1.0,
        "sd": 0.1,
        "unit": "1",
        "lower": -1.0,
        "upper": 2.0,
        "component": "",
        "scale": None,
    },
    "unmodeled.models.Port": lambda: {
        "name": "p",
        "component": "c",
        "unit": "N",
        "scale": 1.0,
        "position": "q",
        "speed": "v",
    },
    "unmodeled.fit.Rate": lambda: {"state": "v"},
    "unmodeled.models.Ready": lambda: {
        "model": oscillator(),
        "records": (record(),),
        "notes": (),
    },
    "unmodeled.models.evenly_spaced": lambda: {"time": 0.1 * np.arange(9)},
    "unmodeled.ode.Derivatives": None,  # a result
    "unmodeled.ode.Integrator": lambda: {
        **{"rates": ODE["rates"], "states": ["q", "v"], "parameters": ["k", "m"], "inputs": ["f"]}
    },
    "unmodeled.ode.Integrator.run": lambda: (integrator(), dict(PATHS)),
    "unmodeled.ode.Integrator.derivatives": lambda: (integrator(), dict(PATHS)),
    "unmodeled.models.running": lambda: {"model": unmodeled.Simulator(**SIMULATOR), "workers": 1},
    "unmodeled.models.Sensitivity": lambda: {
        name: np.zeros((1, 2)) for name in inspect.signature(unmodeled.fit.Sensitivity).parameters
    },
    "unmodeled.models.SensitivityRequest": lambda: REQUEST | {"record": record()},
    "unmodeled.models.SensitivityRequest.check": lambda: (
        unmodeled.fit.SensitivityRequest(**REQUEST, record=record()),
        {"model": oscillator()},
    ),
    "unmodeled.models.SensitivityRequest.parameters_of": lambda: (
        unmodeled.fit.SensitivityRequest(**REQUEST, record=record()),
        {"model": oscillator()},
    ),
    "unmodeled.fit.State": lambda: {
        "name": "q",
        "unit": "m",
        "scale": 1.0,
        "start": 0.0,
        "start_sd": 0.1,
        "hidden": False,
    },
    "unmodeled.models.Candidate": lambda: {"effect": DRY, "shape": None},
    "unmodeled.fit.including": lambda: {
        "model": oscillator(),
        "included": [DRY],
        "magnitudes": [0.01],
    },
    # gap
    "unmodeled.Options": lambda: {
        name: getattr(unmodeled.Options(), name)
        for name in inspect.signature(unmodeled.Options).parameters
    },
    "unmodeled.Record": lambda: {
        name: getattr(record(), name) for name in inspect.signature(unmodeled.Record).parameters
    },
    "unmodeled.Record.cut": lambda: (
        record(),
        {"first": 0, "last": 100, "name": "part", "role": "fit"},
    ),
    "unmodeled.Record.stretched": lambda: (record(), {"factor": 60.0}),
    "unmodeled.Record.output_array": lambda: (record(), {"names": ["q"]}),
    "unmodeled.Record.with_changed_inputs": lambda: (
        record(),
        {"change": lambda whole: {"f": 2.0 * whole.inputs["f"]}},
    ),
    "unmodeled.Record.from_frame": lambda: (
        unmodeled.Record,
        {"frame": table(), "inputs": ["f"], "outputs": ["q"], "sigma": {"q": 0.1}, "name": "a"},
    ),
    "unmodeled.Record.continued": lambda: (record(), {"share": 0.1}),
    "unmodeled.Record.with_noise": lambda: (record(), {"sigma": {"q": 0.1}}),
    "unmodeled.Record.with_columns_as_inputs": lambda: (
        dataclasses.replace(record(), outputs={"q": np.zeros(200), "w": np.ones(200)}),
        {"columns": {"w": "w"}, "mode": None},
    ),
    "unmodeled.Record.with_inputs": lambda: (record(), {"inputs": {"f": np.zeros(200)}}),
    "unmodeled.Record.with_output_as_input": lambda: (
        dataclasses.replace(record(), outputs={"q": np.zeros(200), "w": np.ones(200)}),
        {"output": "w", "name": "w"},
    ),
    "unmodeled.Record.with_sensed_input": lambda: (record(), {"name": "f", "gain": 1.1}),
    "unmodeled.Report.write": lambda: (report(), {"folder": "report", "force": True}),
    "unmodeled.Report.plot": lambda: (report(), {"kind": "residual"}),
    "unmodeled.Report.text": lambda: (report(), {"width": 90}),
    "unmodeled.Sensor": lambda: {
        name: getattr(unmodeled.Sensor(name="q", sigma=0.1), name)
        for name in inspect.signature(unmodeled.Sensor).parameters
    },
    "unmodeled.StartPrior": lambda: {"mean": {"q": 0.0}, "sd": {"q": 0.1}, "known": True},
    "unmodeled.Verdict": None,  # an enumeration
    "unmodeled.candidates": lambda: {"model": oscillator(), "records": [record()]},
    "unmodeled.check": lambda: {"model": oscillator(), "records": [record()]},
    "unmodeled.diagnose": lambda: {
        "model": oscillator(),
        "effects": [DRY],
        "records": [record("one", 1), record("two", 2)],
        "exclude": (),
        "hold_out": None,
        "options": unmodeled.Options(),
        "progress": None,
    },
    "unmodeled.fit_model": lambda: {
        "model": oscillator(),
        "records": [record()],
        "options": None,
        "progress": None,
    },
    "unmodeled.Measured": lambda: {"parameter": "k", "value": 99.0, "sd": 1.0, "how": "scale"},
    "unmodeled.read_measured": lambda: {
        "path": written("measured.toml", "[measured.k]\nvalue = 99.0\nsd = 1.0\n"),
        "model": oscillator(),
    },
    "unmodeled.with_measured": lambda: {
        "model": oscillator(),
        "measured": [unmodeled.Measured(parameter="k", value=99.0, sd=1.0)],
    },
    "unmodeled.search.result.Channel.share": lambda: (report().channels[0], {"residual": 1.0}),
    "unmodeled.Explained.simulate": lambda: (
        unmodeled.explained_model(oscillator(), [DRY], report()),
        {"record": record()},
    ),
    "unmodeled.Explained.film": None,  # of a MuJoCo model: unmodeled/tests/fit/test_mujoco_laws.py
    "unmodeled.Explained.write": None,  # of a mechanism: tests/python/gap/test_cli.py
    "unmodeled.Report.why": lambda: (report(), {"name": report().findings[0].cause}),
    "unmodeled.Report.finding": lambda: (report(), {"name": report().findings[0].cause}),
    "unmodeled.search.result.Result.finding": lambda: (
        report(),
        {"name": report().findings[0].cause},
    ),
    "unmodeled.Options.matters": lambda: (
        unmodeled.Options(),
        {"name": "x", "unit": "m", "compared": 0.1},
    ),
    "unmodeled.Report.html": lambda: (report(), {"title": "oscillator"}),
    "unmodeled.Report.of": lambda: (unmodeled.Report, {"result": report()}),
    "unmodeled.explained_model": lambda: {
        "model": oscillator(),
        "effects": [DRY],
        "result": report(),
    },
    "unmodeled.load_model": lambda: {"name": "steinway45"},
    "unmodeled.verify": None,  # of a stored case: unmodeled/tests/diagnosis/test_case.py
    "unmodeled.withhold": lambda: {
        "model": oscillator(),
        "effects": [DRY],
        "records": [record("one", 1), record("two", 2)],
        "cases": 1,
        "seed": 0,
        "only": None,
        "hold_out": None,
        "options": unmodeled.Options(seconds=2.0),
        "progress": None,
    },
    # experiment
    "unmodeled.experiment.Belief": lambda: {
        "weights": {"dry friction": 0.5},
        "none": 0.1,
        "magnitudes": {"dry friction": 0.1},
    },
    "unmodeled.experiment.Belief.of_report": lambda: (experiment.Belief, {"report": report()}),
    "unmodeled.experiment.PlannedRecord": lambda: vars(planned().records[0]),
    "unmodeled.experiment.PlannedRecord.reasons": lambda: (planned().records[0], {"causes": 1}),
    "unmodeled.experiment.plan": lambda: {
        "model": oscillator(),
        "effects": [DRY],
        "proposed": [record()],
        "records": [record()],
        "aim": "names",
        "belief": None,
        "progress": None,
    },
    # contact
    "feltmb.contact.Law": lambda: {"core": law().core, "name": None},
    "feltmb.contact.Hammer.contact": lambda: (
        feltmb.contact.hammer("stulov:44"),
        {"speed": 2.0, "mass": 5e-3},
    ),
    "feltmb.contact.Law.restore": lambda: (law(), {"saved": law().save()}),
    "feltmb.contact.hammer": lambda: {"name": "stulov:44"},
    "feltmb.contact.Law.force": lambda: (
        law(),
        {"compression": 1e-3, "rate": 0.0, "state": (0.0, ())},
    ),
    "feltmb.contact.Law.path": lambda: (law(), {"compression": [0.0, 1e-3], "time": [0.0, 0.1]}),
    "feltmb.contact.Law.peek": lambda: (law(), {"compression": 1e-3, "duration": 0.1}),
    "feltmb.contact.Law.step": lambda: (law(), {"compression": 1e-3, "duration": 0.1}),
    "feltmb.contact.law": lambda: {
        "name": "hunt_crossley",
        "parameters": {"stiffness": 1e6},
    },
    # actuator
    "feltmb.action.actuator.Actuator": lambda: {"raw": wood().raw, "origin": "a"},
    "feltmb.action.actuator.Actuator.frequencies": lambda: (wood(), {"count": 2, "clamped": False}),
    "feltmb.action.actuator.Actuator.with_action": lambda: (
        wood(),
        {"force": feltmb.table_stroke([0.0, 0.1], [1.0, 2.0])},
    ),
    "feltmb.action.actuator.Actuator.with_damper": lambda: (
        wood(),
        {"kind": "dashpot", "coefficient": 1.0},
    ),
    "feltmb.action.actuator.Actuator.with_values": lambda: (wood(), {"values": {"tip.mass": 0.05}}),
    "feltmb.action.actuator.ActuatorRun.save": lambda: (
        actuator_run(),
        {"path": "actuator.nc", "force": True},
    ),
    "feltmb.action.actuator.compose": lambda: {
        "action": "steinway45",
        "actuator": "wood",
        "pad": None,
    },
    "feltmb.action.actuator.load_actuator": lambda: {"name_or_path": "wood"},
    "feltmb.action.actuator.match": lambda: {
        "actuator": "wood",
        "target": stroke(),
        "action": None,
        "fit": ("damping",),
        "knots": 4,
        "start_torque": None,
        "max_evaluations": 1,
    },
    "feltmb.action.actuator.simulate_actuator": lambda: {
        "actuator": "wood",
        "torque": None,
        "duration": 0.002,
        "output_rate": 1000.0,
        "tolerance": 1e-3,
    },
    "feltmb.action.actuator.stand_alone": lambda: {"actuator": "wood"},
    # regulate
    "feltmb.Wear.from_dict": lambda: (feltmb.Wear, {"data": symptoms().packaged_wear().as_dict()}),
    "feltmb.Wear.read": lambda: (feltmb.Wear, {"path": wear_file()}),
    "feltmb.symptom": lambda: {"name": "blocks", "wear": None},
    "feltmb.wear": lambda: {
        "action": steinway(),
        "parts": ("jack spring",),
        "screws": False,
        "targets": nothing_to_turn(),
        "executor": None,
        "progress": False,
    },
    "feltmb.action.regulate.Screw": lambda: {
        "name": "s",
        "path": "surfaces.Gp3.point",
        "direction": (0.0, 1.0),
        "low": "-5 mm",
        "high": "5 mm",
    },
    "feltmb.action.regulate.Step": lambda: {
        "name": "height",
        "measure": "rest_gap",
        "contact": 2,
        "target": 0.01,
        "tolerance": 1e-5,
    },
    "feltmb.action.regulate.Step.error": lambda: (one_step(), {"value": 0.01}),
    "feltmb.action.regulate.Step.holds": lambda: (one_step(), {"value": 0.01}),
    "feltmb.action.regulate.Targets": lambda: {
        "schema": 1,
        "name": "t",
        "rounds": 2,
        "steps": [one_step()],
    },
    "feltmb.action.regulate.Targets.with_targets": lambda: (
        importlib.import_module("feltmb.action.regulate").load_targets("steinway45"),
        {"targets": {"let-off": "4 mm"}},
    ),
    "feltmb.action.regulate.default_targets": lambda: {
        "action": feltmb.load_action("steinway45"),
    },
    # touch
    "feltmb.action.touch.distances": None,
    "feltmb.action.touch.static_touch": lambda: {"action": pendulum(), "most_travel": 0.02},
    # sweep
    "feltmb.run.sweep.Axis": lambda: {
        "path": "arm.mass",
        "values": (0.02,),
        "how": "set",
    },
    "feltmb.run.sweep.Axis.at": lambda: (
        sweeps().Axis("arm.mass", (2.0,), "scale"),
        {"value": 2.0},
    ),
    "feltmb.run.sweep.Member": lambda: {
        "action": pendulum(),
        "stroke": stroke(),
        "values": {},
        "options": {},
        "name": "m",
        "save_run": "",
    },
    "feltmb.run.sweep.Outcome": None,  # a result
    "feltmb.run.sweep.ProgressBar": lambda: {"progress": False, "total": 3, "title": "t"},
    "feltmb.run.sweep.ProgressBar.step": lambda: (sweeps().ProgressBar(False, 3), {"name": "m"}),
    "feltmb.run.sweep.SweepResult.run": lambda: (swept(), {"index": 0}),
    "feltmb.run.sweep.SweepResult.save": lambda: (swept(), {"path": "t.csv", "force": True}),
    "feltmb.run.sweep.apply_point": lambda: {
        "stroke": stroke(),
        "options": {},
        "values": {"arm.mass": 0.02},
    },
    "feltmb.run.sweep.axis_values": lambda: {"given": [1.0, 2.0], "where": "here"},
    "feltmb.run.sweep.grid_points": lambda: {
        "axes": (sweeps().Axis("arm.mass", (2.0,)),),
        "mode": "grid",
    },
    "feltmb.run.sweep.run_member": lambda: {"member": member()},
    "feltmb.run.sweep.run_members": lambda: {
        "members": [member()],
        "executor": None,
        "jobs": 1,
        "folder": None,
    },
    # sensitivity
    "feltmb.run.sensitivity.Segment": lambda: {
        "begin": 0.0,
        "end": 0.01,
        "state": [0.0, 0.0],
        "memory": None,
    },
    "feltmb.run.sensitivity.state_at": lambda: {
        "action": pendulum(),
        "stroke": stroke(),
        "times": [0.0, 0.01],
        "rtol": 1e-7,
    },
    "feltmb.run.sensitivity.state_names": lambda: {"action": pendulum()},
    "feltmb.run.sensitivity.segments": lambda: {
        "action": pendulum(),
        "stroke": stroke(),
        "segments": [sensitivity.Segment(0.0, 0.01)],
        "parameters": None,
        "outputs": ["arm.angle"],
        "directions": "mechanical",
        "rtol": 1e-7,
        "tolerance": 3e-3,
        "output_rate": 1000.0,
        "jobs": 1,
    },
}


def _models():
    """Classes of models and one of each."""
    line = fit.LinearModel(**LINEAR)
    return {
        "Model": oscillator(),
        "Equations": oscillator(),
        "LinearModel": line,
        "FunctionModel": fit.FunctionModel(**FUNCTION),
        "Simulator": fit.Simulator(**SIMULATOR),
        "Including": fit.including(oscillator(), [DRY], [0.01]),
    }


def call_of(name):
    """What is called and its arguments; None where there is nothing to call."""
    parts = name.split(".")
    if name not in CALLS and parts[-2] in _models():
        if parts[-1] in ("write", "check_writing"):
            return None  # these models are made from no file
        model = _models()[parts[-2]]
        if parts[-1] == "whole":
            return model.whole, {"record": record(), "theta": np.array([1.0])}
        return getattr(model, parts[-1]), model_methods(model)[parts[-1]]
    made = CALLS[name]
    if made is None:
        return None
    made = made()
    if isinstance(made, tuple):
        return getattr(made[0], parts[-1]), made[1]
    home = importlib.import_module(".".join(parts[:-1]))
    return getattr(home, parts[-1]), made


def do(function, arguments):
    """Call, and take what a generator gives."""
    args, kwargs = [], {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in arguments:
            continue
        if parameter.kind is parameter.VAR_POSITIONAL:
            args = [*kwargs.values(), *arguments[name]]
            kwargs = {}
        elif parameter.kind is parameter.VAR_KEYWORD:
            kwargs.update(arguments[name])
        elif parameter.kind is parameter.POSITIONAL_ONLY:
            args.append(arguments[name])
        else:
            kwargs[name] = arguments[name]
    kwargs |= {
        k: v for k, v in arguments.items() if k not in inspect.signature(function).parameters
    }
    out = function(*args, **kwargs)
    return list(out) if inspect.isgenerator(out) else out


def public_names():
    """Every public function, class and method of the public modules, by its first name."""
    seen, names = set(), []
    for module in MODULES:
        home = importlib.import_module(module)
        for name in home.__all__:
            member = getattr(home, name)
            if not callable(member) or id(member) in seen:
                continue
            seen.add(id(member))
            full = f"{module}.{name}"
            if inspect.isclass(member):
                names += _of_class(full, member)
            elif inspect.isfunction(member) and inspect.signature(member).parameters:
                names.append(full)
    return names


def _of_class(full, cls):
    if hasattr(vars(cls).get("__init__", None), "__checks__") or full in CALLS:
        yield full
    for name in dir(cls):
        method = inspect.getattr_static(cls, name)
        method = getattr(method, "__func__", method)
        if name.startswith("_") or not inspect.isfunction(method):
            continue
        if name in ("diagnose", "fit"):  # unmodeled.diagnose and unmodeled.fit_model of every model
            continue
        if (
            method.__module__.startswith(("feltmb", "unmodeled"))
            and len(inspect.signature(method).parameters) > 1
        ):
            yield f"{full}.{name}"


NAMES = public_names()


def test_every_public_callable_has_a_valid_call():
    """So that none is forgotten below."""
    models = ("Model", "Equations", "LinearModel", "FunctionModel", "Simulator", "Including")
    missing = [n for n in NAMES if n not in CALLS and n.split(".")[-2] not in models]
    assert not missing
    assert not set(CALLS) - {*NAMES, *_constructed()}


def _constructed():
    """Classes whose arguments are checked by their schema."""
    return ["feltmb.felt.Branch", "feltmb.felt.Fiber", "feltmb.fiber.material.CriticalAngles"] + [
        f"feltmb.action.regulate.{n}" for n in ("Screw", "Step", "Targets")
    ]


SLOW_VALID = (
    "feltmb.regulate",
    "feltmb.touch",
    "feltmb.wear",
    "feltmb.action.actuator.match",
    "feltmb.action.touch.static_touch",
)


@pytest.mark.parametrize("name", NAMES)
def test_valid_call_works(name, tmp_path, monkeypatch):
    """What stands in the table is valid, or what follows would prove nothing."""
    monkeypatch.chdir(tmp_path)
    call = call_of(name)
    if call is not None and name not in SLOW_VALID:
        do(*call)


def variants(function, arguments, value):
    """The arguments with a hostile value in the place of each in turn."""
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in arguments or (callable(value) and _takes_functions(parameter)):
            continue  # what a function of the user's raises is the user's
        if parameter.kind is parameter.VAR_POSITIONAL:
            yield name, {**arguments, name: (value, *arguments[name][1:])}
        elif parameter.kind is parameter.VAR_KEYWORD:
            for key in arguments[name]:
                yield key, {**arguments, name: {**arguments[name], key: value}}
        else:
            yield name, {**arguments, name: value}
    for name in arguments.keys() - inspect.signature(function).parameters.keys():
        yield name, {**arguments, name: value}  # of a schema


def _takes_functions(parameter):
    text = str(parameter.annotation)
    return any(word in text for word in ("Callable", "Progress", "Density"))


def escapes(name, values, folder, monkeypatch):
    """Arguments that end in an exception that is not ours."""
    monkeypatch.chdir(folder)
    call = call_of(name)
    faults = []
    for value in values if call is not None else ():
        function, arguments = call_of(name)
        for where, changed in variants(function, arguments, value):
            try:
                do(function, changed)
            except Error:
                pass
            except Exception as error:
                faults.append(f"{where} = {shown(value)}: {error!r:.200}")
    return faults


@pytest.mark.parametrize("name", NAMES)
def test_arguments_of_the_wrong_kind(name, tmp_path, monkeypatch):
    faults = escapes(name, FEW, tmp_path, monkeypatch)
    assert not faults, "\n".join(["", *faults])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_hostile_arguments(name, tmp_path, monkeypatch):
    faults = escapes(name, HOSTILE, tmp_path, monkeypatch)
    assert not faults, "\n".join(["", *faults])


def test_what_an_annotation_names_is_known(tmp_path, monkeypatch):
    """A name that no module knows would refuse every value."""
    monkeypatch.chdir(tmp_path)  # some valid calls need a file
    classes = {"Executor", "DataFrame"}
    for module in [*MODULES, "feltmb._core", "feltmb._core.fiber"]:
        home = importlib.import_module(module)
        for member in vars(home).values():
            classes |= {c.__name__ for c in getattr(member, "__mro__", ())}
    for name in NAMES:
        call = call_of(name)
        checks = getattr(call[0], "__checks__", None) if call is not None else None
        if checks is not None:
            assert checks().unknown <= classes, name


@checked
def measure(
    length: float,
    count: int = 1,
    reach: float = math.inf,
    names: Sequence[str] = (),
    place: tuple[float, float] | None = None,
    table: Mapping[str, float] | None = None,
    level: AnyNumber | None = None,
) -> tuple[object, ...]:
    """For the tests below."""
    return length, count, reach, names, place, table, level


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"length": "0.3 s"}, "length: got '0.3 s', expected a finite number; numbers are SI "),
        ({"length": "300 ms"}, "without a unit, write 0.3$"),
        ({"length": "long"}, "got 'long', expected a finite number$"),
        ({"length": True}, "got True, expected a finite number"),
        ({"length": math.inf}, "got inf, expected a finite number"),
        ({"length": HUGE}, "expected a finite number that a float can hold"),
        ({"length": 10**5000}, "got an object of type int, expected a finite number"),
        ({"length": 1.0, "count": -1}, "count: got -1, expected a whole number >= 0"),
        ({"length": 1.0, "count": 1.5}, "count: got 1.5, expected a whole number"),
        ({"length": 1.0, "names": "ab"}, "names: got 'ab', expected a sequence"),
        ({"length": 1.0, "names": ["a", 1]}, r"names\[1\]: got 1, expected a text"),
        ({"length": 1.0, "place": (1.0,)}, "place: got \\(1.0,\\), expected 2 values or None"),
        ({"length": 1.0, "table": {"a": "b"}}, r"table\['a'\]: got 'b', expected a finite number"),
        ({"length": 1.0, "level": "high"}, "level: got 'high', expected a number or None"),
        ({"length": "\x1b[31m\u202e"}, r"got '\\x1b\[31m\\u202e', expected"),
    ],
)
def test_messages_name_what_where_got_expected(arguments, message):
    with pytest.raises(InvalidParameter, match=f"measure: .*{message}|{message}") as caught:
        measure(**arguments)
    assert str(caught.value).startswith("measure: ")
    assert "\x1b" not in str(caught.value)


def test_numbers_of_all_kinds_are_taken():
    for one in (1, 1.0, np.float32(1.0), np.int64(1), np.array(1.0)):
        assert measure(one, one)[:2] == (1, 1)
    assert measure(1.0, reach=math.inf)[2] == math.inf
    assert [measure(1.0, level=x)[6] for x in (math.inf, 1)] == [math.inf, 1]
    assert measure(1.0, names=iter("ab"))[3] == ["a", "b"]
    assert measure(1.0, place=[1, 2])[4] == (1, 2)


def test_a_call_with_a_missing_argument_is_pythons_error():
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        measure()
    with pytest.raises(TypeError, match="unexpected keyword"):
        measure(1.0, lenght=2.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda: feltmb.simulate(pendulum(), 5.0),
        lambda: feltmb.simulate(pendulum(), stroke(), duration="0.3 s"),
        lambda: law().step("a", 1),
        lambda: law().peek(None, 1),
        lambda: pendulum().with_values({"arm.mass": HUGE}),
        lambda: pendulum().with_values({"arm.mass": 10**5000}),
        lambda: feltmb.Action({**pendulum().raw, "bodies": {1: 2}}),
        lambda: feltmb.sweep(pendulum(), stroke(), {"arm.mass": [10**5000]}, progress=False),
        lambda: felt.Fiber(diameter="thin", friction=0.1, withdrawal_force=1.0),
    ],
)
def test_calls_of_the_issue(call):
    with pytest.raises(Error):
        call()


@pytest.mark.parametrize("name", [5, None, ["lift"], "nope", b"x"])
def test_a_name_that_a_result_does_not_have(name):
    # a TypeError for a number or a list, KeyError for a unit
    run = feltmb.simulate(pendulum(), stroke(), duration=0.001)
    for look_up in (run.__getitem__, run.unit):
        with pytest.raises(InvalidParameter, match=r"there is no output|unit: name"):
            look_up(name)


def test_an_unknown_option_of_a_simulation_is_told():
    with pytest.raises(InvalidParameter, match=r"option 'rtoll' is unknown; there are duration"):
        feltmb.simulate(pendulum(), stroke(), rtoll=1)


@pytest.mark.parametrize("jobs", [-1, 10**400])
def test_a_count_that_is_none_is_said_to_be_a_whole_number_from_zero(jobs):
    with pytest.raises(InvalidParameter, match=r"expected a whole number >= 0 or None"):
        feltmb.sweep(pendulum(), stroke(), [{}], jobs=jobs)


@pytest.mark.parametrize("value", [HUGE, "x", None, [1], {"a": 1}, object(), b"x"])
@pytest.mark.parametrize("path", ["arm.mass", "stroke.scale", "options.rtol", "options.duration"])
def test_a_bad_value_is_the_fault_of_its_member(path, value):
    try:
        result = feltmb.sweep(
            pendulum(),
            stroke(),
            [{path: value}, {"arm.mass": 0.02}],
            options={"duration": 0.001},
            progress=False,
            jobs=1,
        )
    except Error:
        assert value == HUGE  # no float holds it: refused at the door
        return
    fine = value is None and path == "options.duration"  # None: that of the stroke
    assert list(result.table["status"]) == ["done" if fine else "failed", "done"]


def test_a_long_chain_of_extends_is_refused(tmp_path):
    for i in range(200):
        base = f"c{i - 1}.toml" if i else "steinway45"
        text = f'schema = 1\nname = "c"\nextends = "{base}"\n'
        (tmp_path / f"c{i}.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidParameter, match=r"c199.toml: extends: leads over more than 20"):
        feltmb.load_action(tmp_path / "c199.toml")
    assert feltmb.load_action(tmp_path / "c9.toml").name == "c"
