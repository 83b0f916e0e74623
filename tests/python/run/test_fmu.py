"""Co-simulation units: valid, with the numbers of simulate, without Python."""

import ctypes
import os
import re
import subprocess
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest

import feltmb
import unmodeled
from feltmb import _core
from feltmb.cli import main
from unmodeled import fit

STEP = 1e-3
OUTPUTS = ("key.angle", "hammer.angle", "finger.displacement", "finger.force", "string.strike")


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


@pytest.fixture(scope="module")
def unit(action, tmp_path_factory):
    return feltmb.export_fmu(action, tmp_path_factory.mktemp("units") / "action.fmu")


@pytest.fixture(scope="module")
def small(pendulum, tmp_path_factory):
    return feltmb.export_fmu(pendulum, tmp_path_factory.mktemp("units") / "pendulum.fmu")


def description(path):
    with zipfile.ZipFile(path) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


# ---------------------------------------------------------------- what a unit holds


def test_a_unit_names_its_variables_with_units_and_start_values(unit, action):
    tree = description(unit)
    assert tree.get("fmiVersion") == "3.0"
    variables = {v.get("name"): v for v in tree.iter("Float64")}
    force = variables["force"]
    assert (force.get("causality"), force.get("unit"), force.get("start")) == ("input", "N", "0.0")
    machine = feltmb.Machine(action)
    outputs = [n for n, v in variables.items() if v.get("causality") == "output"]
    peaks = [f"{n}.force.peak" for n in action.mechanism.contact_names if n != "finger"]
    assert tuple(outputs) == (*machine.names, *peaks)
    assert variables["key.angle"].get("unit") == "rad"
    mass = variables["bodies.key.mass"]
    assert (mass.get("causality"), mass.get("variability")) == ("parameter", "fixed")
    assert float(mass.get("start")) == action.config.bodies["key"].mass
    assert mass.get("min") == "0.0"
    defined = {u.get("name"): u for u in tree.iter("Unit")}
    assert {v.get("unit") for v in variables.values() if v.get("unit")} == set(defined)
    torque = defined["N m s/rad"].find("BaseUnit")
    assert torque.attrib == {"kg": "1", "m": "2", "s": "-1", "rad": "-1"}


def test_parameters_have_the_paths_of_the_file(unit, action):
    """Where the core has a number as the file has it, both call it the same."""
    from feltmb.mechanism.parameters import all_parameters

    here = {
        v.get("name"): float(v.get("start"))
        for v in description(unit).iter("Float64")
        if v.get("causality") == "parameter"
    }
    rods = [f"bodies.{name}." for name, b in action.config.bodies.items() if b.kind == "beam"]
    shared = {p.path: p.value for p in all_parameters(action) if p.path in here}
    for path in [p for p in shared if p.startswith(tuple(rods))]:
        del shared[path]  # mass and inertia of a rod follow from its density
    assert len(shared) > 200
    for path, value in shared.items():
        assert here[path] == pytest.approx(value, rel=1e-12), path
    for path in ("contacts.06.loading.a", "string.tension", "springs", "gravity.y"):
        assert any(name.startswith(path) for name in here), path


def names_of(path):
    return {v.get("name") for v in description(path).iter("Float64")}


def test_parameters_are_the_numbers_that_act(action, tmp_path):
    """A line has no radius, a circle no normal, a hinge no axis, an open contact no law."""
    kinds = {"line": ("normal",), "circle": ("radius",), "concave": ("radius",),
             "hybrid": ("radius", "arc")}  # fmt: skip
    off = action.with_values({"contacts.06.enabled": False})
    path = feltmb.export_fmu(off, tmp_path / "off.fmu", parameters="*")
    names = names_of(path)
    seen = set()
    for name, surface in off.config.surfaces.items():
        own = {n.split(".")[2] for n in names if n.startswith(f"surfaces.{name}.")}
        assert own == {"point", *kinds[surface.kind]}, name
        seen.add(surface.kind)
    assert {"line", "circle", "hybrid"} <= seen
    assert "bodies.key.mass" in names
    assert "bodies.jack.axis.x" not in names  # it turns
    assert "bodies.jack.angle" in names
    assert not any(n.startswith("contacts.06.") for n in names)
    assert any(n.startswith("contacts.05.") for n in names)
    assert not any(n.startswith("finger.pad.") for n in names)
    moved = feltmb.export_fmu(off, tmp_path / "moved.fmu", drive="motion")
    assert any(n.startswith("finger.pad.") for n in names_of(moved))


def test_a_rod_has_its_mass_from_its_density(tmp_path):
    names = names_of(feltmb.export_fmu("steinway45", tmp_path / "rods.fmu", parameters="bodies.*"))
    assert "bodies.shank.beam.linear_density" in names
    assert not {"bodies.shank.mass", "bodies.shank.inertia", "bodies.shank.friction.b1"} & names
    assert "bodies.key.friction.b1" in names


def test_the_same_mechanism_gives_the_same_bytes(pendulum, small, tmp_path):
    again = feltmb.export_fmu(pendulum, tmp_path / "again.fmu")
    assert again.read_bytes() == small.read_bytes()


def test_a_description_survives_its_text(action, pendulum):
    from feltmb.mechanism import describe

    damped = feltmb.load_action("steinway45_damped")
    for each in (action, pendulum, damped, feltmb.load_action("steinway45")):
        text = _core.write_description(describe(each.config))
        assert _core.write_description(_core.read_description(text)) == text
        for bad in (text[:-40], text.replace("bodies", "bodes", 1), text + "x "):
            with pytest.raises(feltmb.InvalidParameter, match="description of a mechanism, letter"):
                _core.read_description(bad)


def test_the_binary_needs_no_python(unit, tmp_path):
    """It is loaded by a process that has none of feltmb, and asks for the C library alone."""
    with zipfile.ZipFile(unit) as archive:
        [name] = [n for n in archive.namelist() if n.endswith(".so")]
        archive.extract(name, tmp_path)
    binary = tmp_path / name
    assert binary.parent.name.endswith("-linux")
    shown = subprocess.run(
        ["readelf", "-d", str(binary)], capture_output=True, text=True, check=False
    )
    if shown.returncode == 0:
        needed = re.findall(r"NEEDED.*\[(.*?)\]", shown.stdout)
        assert all(re.match(r"lib[cm]\.so|ld-linux|libgcc_s", n) for n in needed), needed
    library = ctypes.CDLL(str(binary), mode=os.RTLD_LOCAL)
    library.fmi3GetVersion.restype = library.fmi2GetVersion.restype = ctypes.c_char_p
    assert library.fmi3GetVersion() == b"3.0"
    assert library.fmi2GetVersion() == b"2.0"


# ---------------------------------------------------------------- FMPy


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy")


def validate(path):
    from fmpy.validation import validate_fmu

    return validate_fmu(str(path))


def held(action, force, steps, outputs=OUTPUTS):
    machine = feltmb.Machine(action)
    rows = [[machine.read(n) for n in outputs]]
    for _ in range(steps):
        machine.advance(STEP, force=force)
        rows.append([machine.read(n) for n in outputs])
    return np.array(rows)


@pytest.mark.parametrize("version", ["3.0", "2.0"])
def test_fmpy_finds_nothing_wrong_and_gets_the_numbers_of_simulate(version, fmpy, action, tmp_path):
    path = feltmb.export_fmu(action, tmp_path / "action.fmu", version=version)
    assert validate(path) == []
    seen = fmpy.simulate_fmu(
        str(path),
        stop_time=0.1,
        output_interval=STEP,
        start_values={"force": 8.0},
        output=list(OUTPUTS),
    )
    mine = held(action, 8.0, 100)
    stroke = feltmb.table_stroke([0.0, 1.0], [8.0, 8.0], interpolation="linear", duration=0.1)
    run = feltmb.simulate(action, stroke, output_rate=1 / STEP, rtol=1e-8)
    assert len(seen) == 101
    for i, name in enumerate(OUTPUTS):
        # Times that FMPy adds up differ by rounding: so do the last bits of a step's length.
        room = 1e-4 * np.abs(mine[1:, i]) + 2e-5 * np.ptp(mine[:, i])
        assert np.all(np.abs(seen[name] - mine[:, i])[1:] < room), name
        # The input acts from the first sample on, before any step.
        scale = np.ptp(run[name]) or 1.0
        assert np.max(np.abs(seen[name] - run[name])) < 5e-4 * scale, name


def test_an_input_by_time(fmpy, action, tmp_path):
    """Linear hold: the ramp of the table, a step later."""
    path = feltmb.export_fmu(action, tmp_path / "action.fmu", hold="linear", rtol=1e-8)
    stroke = feltmb.ramp_stroke(10.0, 0.01, 0.03, duration=0.09)
    table = np.zeros(91, dtype=[("time", float), ("force", float)])
    table["time"] = np.arange(91) * STEP
    table["force"] = stroke.at(table["time"])
    seen = fmpy.simulate_fmu(
        str(path), stop_time=0.09, output_interval=STEP, input=table, output=list(OUTPUTS)
    )
    run = feltmb.simulate(action, stroke.shifted(STEP), output_rate=1 / STEP, rtol=1e-8)
    for name in OUTPUTS[:3]:
        assert np.max(np.abs(seen[name] - run[name][:91])) < 2e-4 * np.ptp(run[name]), name


def test_a_peak_is_the_largest_force_since_the_last_communication_point(fmpy, action, tmp_path):
    """Steps of 5 ms are longer than the hammer touches the string."""
    path = feltmb.export_fmu(action, tmp_path / "action.fmu", rtol=1e-8, parameters=["gravity.*"])
    forces = [f"{n}.force" for n in action.mechanism.contact_names if n != "finger"]
    peaks = [f"{n}.peak" for n in forces]
    step, count = 5e-3, 20
    seen = fmpy.simulate_fmu(
        str(path),
        stop_time=count * step,
        output_interval=step,
        start_values={"force": 15.0},
        output=[*forces, *peaks],
    )
    held = feltmb.table_stroke([0.0, 1.0], [15.0, 15.0], interpolation="linear", duration=0.1)
    run = feltmb.simulate(action, held, output_rate=1e5, rtol=1e-8)
    scale = max(np.max(run[f]) for f in forces)
    hidden = 0.0
    for force, peak in zip(forces, peaks, strict=True):
        fine = run[force]
        assert seen[peak][0] == seen[force][0]  # no step yet
        for k in range(1, count + 1):
            largest = np.max(fine[(k - 1) * 500 : k * 500 + 1])
            assert abs(seen[peak][k] - largest) < 1e-3 * scale, (force, k)
            hidden = max(hidden, largest - max(seen[force][k - 1], seen[force][k]))
    assert hidden > 0.3 * scale  # no communication point shows it


def test_parameters_change_the_mechanism(fmpy, pendulum, small):
    heavier = pendulum.with_values({"arm.mass": {"value": 40.0, "unit": "g"}})
    seen = fmpy.simulate_fmu(
        str(small),
        stop_time=0.05,
        output_interval=STEP,
        start_values={"force": -0.5, "bodies.arm.mass": 0.04},
        output=["arm.angle"],
    )
    there = held(heavier, -0.5, 50, ("arm.angle",))[:, 0]
    here = held(pendulum, -0.5, 50, ("arm.angle",))[:, 0]
    assert np.allclose(seen["arm.angle"], there, rtol=1e-6, atol=1e-9)
    assert np.max(np.abs(seen["arm.angle"] - here)) > 1e-3


@pytest.mark.parametrize("version", ["3.0", "2.0"])
def test_initial_values_count_from_rest(version, fmpy, pendulum, tmp_path):
    path = feltmb.export_fmu(pendulum, tmp_path / "pendulum.fmu", version=version)
    seen = fmpy.simulate_fmu(
        str(path),
        stop_time=0.05,
        output_interval=STEP,
        start_values={"start_offset.arm.angle": -0.02, "start_rate.arm.angle": 0.3},
        output=["arm.angle", "arm.angle.rate"],
    )
    rest = pendulum.rest_pose[0]
    start = {"arm.angle": rest - 0.02, "arm.angle.rate": 0.3}
    still = feltmb.ramp_stroke(0.0, duration=0.05)
    run = feltmb.simulate(pendulum, still, start=start, output_rate=1 / STEP, rtol=1e-8)
    assert seen["arm.angle"][0] == pytest.approx(rest - 0.02, rel=1e-12)
    assert np.allclose(seen["arm.angle"], run["arm.angle"], rtol=1e-5, atol=1e-7)
    assert np.allclose(seen["arm.angle.rate"], run["arm.angle.rate"], rtol=1e-4, atol=1e-5)


@pytest.fixture
def loaded(fmpy, small, tmp_path):
    """The unit of the pendulum, ready for steps."""
    from fmpy.fmi3 import FMU3Slave

    folder = fmpy.extract(str(small), str(tmp_path / "unit"))
    model = fmpy.read_model_description(folder)
    unit = FMU3Slave(
        guid=model.guid,
        unzipDirectory=folder,
        modelIdentifier=model.coSimulation.modelIdentifier,
        instanceName="one",
    )
    unit.instantiate()
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    references = {v.name: v.valueReference for v in model.modelVariables}
    yield unit, references
    unit.terminate()
    unit.freeInstance()


def test_a_state_is_kept_and_restored(loaded):
    unit, references = loaded
    unit.setFloat64([references["start_rate.arm.angle"]], [0.1])
    shown = [references["arm.angle"], references["contact01.force.peak"]]
    force = [references["force"]]

    def go(start, steps, value):
        unit.setFloat64(force, [value])
        for k in range(steps):
            unit.doStep(currentCommunicationPoint=start + k * STEP, communicationStepSize=STEP)
        return list(unit.getFloat64(shown))

    before = go(0.0, 20, -0.5)
    state = unit.getFMUState()
    saved = bytes(unit.serializeFMUState(state))
    end = go(0.02, 30, -1.0)
    unit.setFMUState(state)
    assert before != end
    assert list(unit.getFloat64(shown)) == before
    assert unit.getFloat64([references["time"]])[0] == pytest.approx(0.02)
    assert go(0.02, 30, -1.0) == end
    unit.setFMUState(unit.deserializeFMUState(saved))
    assert go(0.02, 30, -1.0) == end
    unit.freeFMUState(state)


def test_a_peak_that_is_asked_for_late_is_the_same(loaded):
    """It is sought once it is asked for; the step before is then made once more."""
    unit, references = loaded
    shown = [references[n] for n in ("contact01.force.peak", "arm.angle", "arm.angle.rate")]

    def run(asking):
        for k in range(30):
            unit.doStep(currentCommunicationPoint=k * STEP, communicationStepSize=STEP)
            if asking:
                unit.getFloat64(shown)
        return list(unit.getFloat64(shown))

    unit.setFloat64([references["force"]], [-0.5])
    late = run(False)
    unit.reset()
    unit.enterInitializationMode()
    unit.setFloat64([references["force"]], [-0.5])
    unit.exitInitializationMode()
    assert run(True) == late
    assert late[0] > 0.0


def test_faults_are_told(loaded):
    from fmpy.fmi1 import FMICallException

    unit, references = loaded
    with pytest.raises(FMICallException):
        unit.doStep(currentCommunicationPoint=1.0, communicationStepSize=STEP)
    with pytest.raises(FMICallException):
        unit.getFloat64([99999])
    unit.doStep(currentCommunicationPoint=0.0, communicationStepSize=STEP)
    with pytest.raises(FMICallException):
        unit.setFloat64([references["bodies.arm.mass"]], [1.0])
    with pytest.raises(FMICallException):
        unit.setFloat64([references["start_rate.arm.angle"]], [1.0])
    with pytest.raises(FMICallException):  # fixed as well; it would start anew
        unit.setFloat64([references["rtol"]], [1e-4])
    assert unit.getFloat64([references["time"]])[0] == pytest.approx(STEP)


@pytest.mark.usefixtures("fmpy")
def test_a_unit_is_a_model_of_a_diagnosis(pendulum, tmp_path):
    """The mass of the arm is found from a record, by the unit alone."""
    path = feltmb.export_fmu(pendulum, tmp_path / "p.fmu", parameters=["bodies.arm.*"])
    model = unmodeled.fmu(
        path,
        parameters=[fit.Parameter(name="bodies.arm.mass", value=0.02, sd=0.01, unit="kg")],
        inputs={"force": "N"},
        outputs={"arm.angle": "rad"},
        workers=1,
    )
    time = np.arange(60) * STEP
    record = unmodeled.Record(
        name="one",
        time=time,
        inputs={"force": np.full(60, -0.4)},
        outputs={"arm.angle": np.zeros(60)},
        sensors={"arm.angle": unmodeled.Sensor(name="arm.angle", sigma=1e-5, unit="rad")},
    )
    jobs = fit.Jobs(theta=np.array([[0.02], [0.025]]), starts=np.zeros((2, 0)))
    out = model.simulate(record, jobs)[:, :, 0]
    heavier = pendulum.with_values({"arm.mass": {"value": 25.0, "unit": "g"}})
    for row, each in zip(out, (pendulum, heavier), strict=True):
        assert np.allclose(row, held(each, -0.4, 59, ("arm.angle",))[:, 0], atol=1e-6)


# ---------------------------------------------------------------- command and bad input


def test_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["fmu", "steinway45", "-o", "action.fmu", "--parameter", "contacts.06.*"])
    assert end.value.code == 0
    names = [
        v.get("name")
        for v in description(tmp_path / "action.fmu").iter("Float64")
        if v.get("causality") == "parameter"
    ]
    assert names[0] == "rtol"
    assert all(n.startswith("contacts.06.") for n in names[1:])
    assert len(names) > 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "a.zip"}, "cannot write .zip, expected .fmu"),
        ({"drive": "torque"}, "the input of the unit is a torque, but mechanism .* no motor"),
        ({"parameters": "contacts.99.*"}, r"parameters: 'contacts.99.\*' matches no number"),
        (
            {"parameters": ["finger.pad.*"], "drive": "force"},
            r"no effect under .* force.*--input motion",
        ),
        ({"action": "cool.py"}, "Python file.*cannot be exported"),
        ({"rtol": 1.0}, r"rtol = 1, must be in"),
        ({"version": "1.0"}, "version"),
    ],
)
def test_bad_exports(action, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.export_fmu(**{"action": action, "path": "a.fmu", **arguments})
    assert not any(tmp_path.iterdir())


def test_an_existing_file_stays(small, pendulum):
    with pytest.raises(feltmb.FileExists):
        feltmb.export_fmu(pendulum, small)
