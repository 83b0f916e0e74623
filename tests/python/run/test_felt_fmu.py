"""A contact law as a co-simulation unit, against the law itself."""

import ctypes
import re
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest

import feltmb
from feltmb.cli import main
from feltmb.contact import law
from feltmb.felt import envelope, load_material, parse_area

LOOP = {"loading": (5520.0, 1580.0, -600.0), "unloading": (190.0, 5040.0, 3040.0)}
LAYER = {"felt": "synthetic_hammer", "thickness": 6e-3, "compression": "columns",
         "area": {"kind": "crossed_cylinders", "radius_a": 9e-3, "radius_b": 0.55e-3}}  # fmt: skip
LAWS = {
    "felt_return_point": {**LOOP, "kappa": 0.3},
    "felt_memory": {**LOOP, "recovery_time": 0.1, "rate_amplitude": 0.2, "rate_time": 0.01},
    "micromechanical": LAYER,
    "stulov": {"stiffness": 3e8, "exponent": 2.4, "amplitude": 0.3, "time": 5e-3},
    "kelvin_voigt": {"stiffness": 2e4, "damping": 5.0},
    "mean": LOOP,
    "expression": {"force": "k * e^2 + c * e * rate", "parameters": {"k": 1e7, "c": 50.0}},
}
STEP = 1e-3


def history(count=200):
    """Compression [m] and rate [m/s]: strokes of several depths, with openings."""
    t = STEP * np.arange(count)
    a, b = 2 * np.pi * 9.0, 2 * np.pi * 31.0
    x = 0.4e-3 * (1.0 - np.cos(a * t)) + 0.1e-3 * np.sin(b * t) - 0.05e-3
    x -= x[0]
    return x, 0.4e-3 * a * np.sin(a * t) + 0.1e-3 * b * np.cos(b * t)


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy")


def opened(fmpy, path, folder):
    """A slave of either version, ready for steps, and the references by name."""
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    where = fmpy.extract(str(path), str(folder))
    model = fmpy.read_model_description(where)
    kind = FMU3Slave if model.fmiVersion == "3.0" else FMU2Slave
    unit = kind(
        guid=model.guid,
        unzipDirectory=where,
        modelIdentifier=model.coSimulation.modelIdentifier,
        instanceName="one",
    )
    unit.instantiate()
    if model.fmiVersion != "3.0":
        unit.getFloat64, unit.setFloat64 = unit.getReal, unit.setReal
        unit.setupExperiment()
    return unit, {v.name: v.valueReference for v in model.modelVariables}


def start(unit):
    unit.enterInitializationMode()
    unit.exitInitializationMode()


@pytest.mark.parametrize("version", ["3.0", "2.0"])
@pytest.mark.parametrize("name", LAWS)
def test_the_unit_is_the_law(name, version, fmpy, tmp_path):
    """Force and energy at each input, and the prediction behind each step."""
    from fmpy.validation import validate_fmu

    felt = law(name, **LAWS[name])
    path = feltmb.export_felt(felt, tmp_path / "felt.fmu", version=version)
    assert validate_fmu(str(path)) == []
    unit, refs = opened(fmpy, path, tmp_path / "unit")
    start(unit)
    inputs, outputs = [refs["compression"], refs["rate"]], [refs["force"], refs["energy"]]
    seen, mine = [], []
    for k, (x, v) in enumerate(zip(*history(), strict=True)):
        unit.setFloat64(inputs, [x, v])
        seen.append(list(unit.getFloat64(outputs)))
        unit.doStep(k * STEP, STEP)
        seen[-1] += unit.getFloat64(outputs[:1])
        now = felt.step(x, STEP) if k else float(felt.force(x, v))
        mine.append([now, felt.energy, felt.peek(x + v * STEP, STEP)])
    seen, mine = np.array(seen), np.array(mine)
    for i in range(3):
        assert np.max(np.abs(seen[:, i] - mine[:, i])) < 1e-12 * np.max(np.abs(mine[:, i]))
    # The prediction is of second order, the force behind a held input is not.
    if name == "felt_return_point":
        assert np.max(np.abs(seen[:-1, 2] - mine[1:, 0])) < 0.12 * np.max(mine[:, 0])
    unit.terminate()
    unit.freeInstance()


def test_fmpy_simulates_it_from_a_table(fmpy, tmp_path):
    """Inputs by time, as a user of FMPy gives them: halved steps give a quarter of the error."""
    felt = law("felt_return_point", **LOOP)
    path = feltmb.export_felt(felt, tmp_path / "felt.fmu")

    def error(step):
        t = step * np.arange(round(0.05 / step) + 1)
        x = 0.4e-3 * (1.0 - np.cos(2 * np.pi * 20.0 * t))
        v = 0.4e-3 * 2 * np.pi * 20.0 * np.sin(2 * np.pi * 20.0 * t)
        columns = [("time", float), ("compression", float), ("rate", float)]
        table = np.array([*zip(t, x, v, strict=True)], dtype=columns)
        run = fmpy.simulate_fmu(
            str(path), stop_time=0.05, output_interval=step, input=table, output=["force"]
        )
        assert np.allclose(run["time"], t)
        felt.reset()
        exact = np.array([felt.step(e, step) for e in x])
        return np.max(np.abs(run["force"] - exact)) / np.max(exact)

    coarse, fine = error(1e-3), error(5e-4)
    assert fine < coarse < 0.05
    assert coarse / fine == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize("version", ["3.0", "2.0"])
@pytest.mark.parametrize("name", ["felt_return_point", "stulov"])
def test_a_state_is_kept_restored_and_serialized(name, version, fmpy, tmp_path):
    path = feltmb.export_felt(law(name, **LAWS[name]), tmp_path / "felt.fmu", version=version)
    unit, refs = opened(fmpy, path, tmp_path / "unit")
    start(unit)
    inputs, outputs = [refs["compression"], refs["rate"]], [refs["force"], refs["energy"]]
    rows = [*zip(*history(), strict=True)]

    def go(first, last):
        for k in range(first, last):
            unit.setFloat64(inputs, rows[k])
            unit.doStep(k * STEP, STEP)
        return list(unit.getFloat64(outputs))

    state = "State" if version == "3.0" else "state"
    get, put = getattr(unit, f"getFMU{state}"), getattr(unit, f"setFMU{state}")
    pack = unit.serializeFMUState if version == "3.0" else unit.serializeFMUstate
    unpack = unit.deserializeFMUState if version == "3.0" else unit.deSerializeFMUstate
    middle = go(0, 80)
    kept = get()
    saved = bytes(pack(kept))
    end = go(80, 140)
    assert end != middle
    put(kept)
    assert list(unit.getFloat64(outputs)) == middle
    assert go(80, 140) == end
    put(unpack(saved))
    assert go(80, 140) == end
    unit.reset()
    start(unit)
    assert go(0, 80) == middle


def test_parameters_are_those_of_the_law(fmpy, tmp_path):
    path = feltmb.export_felt(law("stulov", **LAWS["stulov"]), tmp_path / "felt.fmu")
    unit, refs = opened(fmpy, path, tmp_path / "unit")
    names = {"time", "compression", "rate", "force", "energy"}
    assert set(refs) - names == {f"law.{key}" for key in LAWS["stulov"]}
    unit.setFloat64([refs["law.amplitude"]], [0.1])
    start(unit)
    felt = law("stulov", **{**LAWS["stulov"], "amplitude": 0.1})
    for k, (x, v) in enumerate(zip(*history(60), strict=True)):
        unit.setFloat64([refs["compression"], refs["rate"]], [x, v])
        mine = felt.step(x, STEP)
        assert unit.getFloat64([refs["force"]])[0] == pytest.approx(mine, rel=1e-12, abs=1e-15)
        unit.doStep(k * STEP, STEP)
    from fmpy.fmi1 import FMICallException

    with pytest.raises(FMICallException):  # fixed
        unit.setFloat64([refs["law.amplitude"]], [0.2])
    with pytest.raises(FMICallException):
        unit.doStep(1.0, STEP)
    with pytest.raises(FMICallException):
        unit.setFloat64([refs["compression"]], [float("nan")])
    with pytest.raises(FMICallException):
        unit.getFloat64([99999])


def test_a_parameter_out_of_range_is_refused(fmpy, tmp_path):
    from fmpy.fmi1 import FMICallException

    path = feltmb.export_felt(law("felt_return_point", **LOOP), tmp_path / "felt.fmu")
    unit, refs = opened(fmpy, path, tmp_path / "unit")
    unit.setFloat64([refs["law.kappa"]], [-1.0])
    unit.enterInitializationMode()
    with pytest.raises(FMICallException):
        unit.exitInitializationMode()


def test_it_starts_at_rest_under_its_compression(fmpy, tmp_path):
    """A preloaded felt has relaxed; its first step is from there."""
    felt = law("maxwell", stiffness=1e7, exponent=2.0, branch_stiffness=1e7, branch_exponent=2.0,
               branch_time=0.01)  # fmt: skip
    path = feltmb.export_felt(felt, tmp_path / "felt.fmu")
    unit, refs = opened(fmpy, path, tmp_path / "unit")
    unit.setFloat64([refs["compression"]], [1e-3])
    start(unit)
    force = [refs["force"]]
    assert unit.getFloat64(force)[0] == pytest.approx(1e7 * 1e-6, rel=1e-12)
    for k in range(3):
        unit.doStep(k * STEP, STEP)
    assert unit.getFloat64(force)[0] == pytest.approx(1e7 * 1e-6, rel=1e-9)


def test_the_binary_alone(tmp_path):
    """Without an importer: the functions of the interface by their names."""
    felt = law("mean", **LOOP)
    path = feltmb.export_felt(felt, tmp_path / "felt.fmu")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "unit")
        token = ET.fromstring(archive.read("modelDescription.xml")).get("instantiationToken")
        [binary] = [n for n in archive.namelist() if n.endswith(".so")]
    fmi = ctypes.CDLL(str(tmp_path / "unit" / binary))
    fmi.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
    resources = str(tmp_path / "unit" / "resources").encode()
    made = fmi.fmi3InstantiateCoSimulation(
        b"a", token.encode(), resources, False, False, False, False, None, ctypes.c_size_t(0),
        None, None, None,
    )  # fmt: skip
    unit = ctypes.c_void_p(made)
    assert made
    value, place = ctypes.c_double(0.7e-3), ctypes.c_uint32(1)
    size = ctypes.c_size_t(1)
    assert fmi.fmi3SetFloat64(unit, ctypes.byref(place), size, ctypes.byref(value), size) == 0
    place.value = 1000
    assert fmi.fmi3GetFloat64(unit, ctypes.byref(place), size, ctypes.byref(value), size) == 0
    assert value.value == float(felt.force(0.7e-3))
    fmi.fmi3FreeInstance(unit)
    wrong = fmi.fmi3InstantiateCoSimulation(
        b"a", b"other", resources, False, False, False, False, None, ctypes.c_size_t(0), None,
        None, None,
    )  # fmt: skip
    assert not wrong


def test_the_command_takes_contacts_envelopes_and_laws(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    made = envelope(load_material("synthetic_hammer"), 6e-3, parse_area("constant:1cm2"))
    (tmp_path / "loop.toml").write_text(made.to_toml())
    (tmp_path / "law.toml").write_text(
        'law = "stulov"\nstulov = {stiffness = 3e8, exponent = 2.4, amplitude = 0.3, time = "5 ms"}'
    )
    (tmp_path / "wrong.toml").write_text('law = "stulov"\n[stulov]\nstifness = 3e8\n')
    for i, text in enumerate(["steinway45:04", "loop.toml", "law.toml"]):
        with pytest.raises(SystemExit) as end:
            main(["felt", "fmu", text, "-o", f"{i}.fmu"])
        assert end.value.code == 0, capsys.readouterr().err
    with zipfile.ZipFile("2.fmu") as archive:
        xml = ET.fromstring(archive.read("modelDescription.xml"))
    found = {v.get("name"): v for v in xml.iter("Float64")}
    assert found["law.stiffness"].get("start") == "300000000.0"
    assert xml.get("modelName") == "law"
    for text, message in [
        ("synthetic_hammer", "felt without a thickness and an area.*felt envelope"),
        ("steinway45", "names no contact"),
        ("none.toml", "none.toml"),
        ("wrong.toml", r"wrong\.toml.*stulov\.stiffness.*stifness"),
    ]:
        with pytest.raises(SystemExit) as end:
            main(["felt", "fmu", text, "-o", "x.fmu"])
        assert end.value.code == 2
        assert re.search(message, " ".join(capsys.readouterr().err.split()))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "a.zip"}, "cannot write .zip, expected .fmu"),
        ({"parameters": "alpha"}, "'alpha' matches no number of the law .*expected .*law.kappa"),
        ({"version": "1.0"}, "version"),
    ],
)
def test_bad_exports(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    felt = law("felt_return_point", **LOOP)
    with pytest.raises(feltmb.InvalidParameter, match=message):
        feltmb.export_felt(**{"law": felt, "path": "a.fmu", **arguments})
    assert not any(tmp_path.iterdir())
