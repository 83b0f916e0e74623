"""An FMU as a simulator, by FMPy; where installed."""

import shutil
import tempfile
import tomllib
import zipfile
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

import unmodeled
from unmodeled import Exposed, Options, Parameter, Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit.fmi import _limits
from unmodeled.models import Candidate, Jobs, SensitivityRequest
from unmodeled.models.elsewhere import running

from . import units

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="cart" guid="{cart}">
  <CoSimulation modelIdentifier="cart" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="mass" valueReference="0" causality="parameter" variability="tunable">
      <Real start="2"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="1" causality="parameter" variability="tunable">
      <Real start="40"/></ScalarVariable>
    <ScalarVariable name="d" valueReference="2" causality="parameter" variability="tunable">
      <Real start="1"/></ScalarVariable>
    <ScalarVariable name="dry" valueReference="3" causality="parameter" variability="tunable">
      <Real start="0"/></ScalarVariable>
    <ScalarVariable name="force" valueReference="4" causality="input">
      <Real start="0"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="5" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="v" valueReference="6" causality="local"><Real/></ScalarVariable>
    <ScalarVariable name="log" valueReference="0" causality="parameter" variability="fixed">
      <Boolean start="true"/></ScalarVariable>
    <ScalarVariable name="table" valueReference="0" causality="parameter" variability="fixed">
      <String start="cart.txt"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="6"/></Outputs></ModelStructure>
</fmiModelDescription>
"""

SOURCE = r"""
#include <math.h>
#include <stdlib.h>
typedef void* C; typedef unsigned int R; typedef int S; typedef const char* T;
enum { MASS, K, D, DRY, FORCE, X, V, COUNT };
C fmi2Instantiate(T n, S t, T g, T r, const void* f, S v, S l) {
    double* z = calloc(COUNT, sizeof(double));
    z[MASS] = 2; z[K] = 40; z[D] = 1;
    return z;
}
void fmi2FreeInstance(C c) { free(c); }
T fmi2GetTypesPlatform(void) { return "default"; }
T fmi2GetVersion(void) { return "2.0"; }
S fmi2SetDebugLogging(C c, S on, size_t n, const T* k) { return 0; }
S fmi2SetupExperiment(C c, S td, double tol, double t0, S sd, double t1) { return 0; }
S fmi2EnterInitializationMode(C c) { return 0; }
S fmi2ExitInitializationMode(C c) { return 0; }
S fmi2Terminate(C c) { return 0; }
S fmi2Reset(C c) { ((double*)c)[X] = ((double*)c)[V] = 0; return 0; }
S fmi2GetReal(C c, const R* r, size_t n, double* v) {
    for (size_t i = 0; i < n; ++i) v[i] = ((double*)c)[r[i]];
    return 0;
}
S fmi2SetReal(C c, const R* r, size_t n, const double* v) {
    for (size_t i = 0; i < n; ++i) ((double*)c)[r[i]] = v[i];
    return 0;
}
S fmi2DoStep(C c, double t, double h, S no) {
    double* z = c; int n = 10; double s = h / n;
    for (int i = 0; i < n; ++i) {
        z[V] += s / z[MASS] * (z[FORCE] - z[K] * z[X] - z[D] * z[V]);
        double left = fabs(z[V]) - s / z[MASS] * z[DRY];
        z[V] = left > 0 ? copysign(left, z[V]) : 0;
        z[X] += s * z[V];
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    """A cart with dry friction as an FMU 2.0 for co-simulation, compiled here."""
    return units.compile_fmu(tmp_path_factory.mktemp("fmu"), "cart", DESCRIPTION, SOURCE)


def cart(path, **fields):
    fields = {
        "parameters": [
            Parameter(name="mass", value=2.0, sd=0.1, unit="kg", lower=0.1),
            Parameter(name="k", value=40.0, sd=2.0, unit="N/m", lower=1.0),
            Parameter(name="d", value=1.0, sd=0.3, unit="N s/m", lower=0.0),
        ],
        "inputs": {"force": "N"},
        "outputs": {"x": "m"},
        "unknown": {"dry": Exposed(scale=0.5, unit="N", component="guide", sign=1)},
        **fields,
    }
    return unmodeled.fmu(path, **fields)


def test_variables_that_an_fmu_lacks_are_told(fmu):
    with pytest.raises(InvalidParameter, match="has no variable u; there are d, dry, force, k"):
        cart(fmu, inputs=["u"])
    with pytest.raises(InvalidParameter, match="there is no such file"):
        cart(fmu.with_name("other.fmu"))


def test_start_values_are_those_of_the_fmu(fmu):
    """Other variables of it are no numbers."""
    model = cart(fmu, parameters={"mass": (None, 0.1, "kg")}, unknown={"dry": "N"})
    assert model.parameters[0].value == 2.0
    with pytest.raises(InvalidParameter, match="parameter table: got"):
        cart(fmu, parameters={"table": (None, 0.1, "kg")})


def test_a_run_of_an_fmu_does_not_depend_on_those_before(fmu):
    """The library is loaded once, and every run has an instance of its own."""
    time = np.arange(50) * 1e-2
    wave = np.sin(9.0 * time)
    record = Record(name="a", time=time, inputs={"force": wave}, outputs={"x": 0.0 * time})
    one, other = (np.array([[m, 40.0, 1.0]]) for m in (2.0, 1.0))

    def last(model, *thetas):
        return [model.simulate(record, Jobs(theta=t, starts=np.zeros((1, 0)))) for t in thetas][-1]

    alone = last(cart(fmu), one)
    assert np.array_equal(last(cart(fmu), other, one), alone)
    assert not np.array_equal(last(cart(fmu), other), alone)


@pytest.fixture(scope="module")
def fragile(tmp_path_factory):
    """A cart that ends its process if its damping is above 50, and exists once in a process."""
    source = SOURCE.replace(
        "    double* z = calloc", "    if (alive++) return 0;\n    double* z = calloc"
    ).replace("{ free(c); }", "{ alive--; free(c); }")
    source = source.replace("double* z = c; int n", "double* z = c; if (z[D] > 50) _Exit(7); int n")
    source = source.replace("C fmi2Instantiate", "static int alive = 0;\nC fmi2Instantiate")
    once = 'modelIdentifier="cart" canBeInstantiatedOnlyOncePerProcess="true"'
    description = DESCRIPTION.replace('modelIdentifier="cart"', once)
    return units.compile_fmu(tmp_path_factory.mktemp("fragile"), "cart", description, source)


def pushed(size=1.0):
    time = np.arange(60) * 1e-2
    force = size * np.sin(9.0 * time)
    sensors = {"x": Sensor(name="x", unit="m", sigma=1e-4)}
    noise = 1e-4 * np.random.default_rng(0).standard_normal(60)
    seen = {"x": size * 0.01 * np.sin(9.0 * time) ** 2 + noise}
    return Record(
        name=f"{size:g}", time=time, inputs={"force": force}, outputs=seen, sensors=sensors
    )


@pytest.mark.parametrize("path", ["fmu", "fragile"])
def test_a_step_of_an_fmu_is_the_same_on_processes_and_threads(request, path):
    """Equal bytes, and every run once; an FMU that exists once in a process runs alone."""
    path, records = request.getfixturevalue(path), [pushed(1.0), pushed(2.0)]
    point = np.array([2.1, 41.0, 1.1])

    def step(executor=None, **fields):
        model = running(cart(path, **fields), executor=executor).ready(records).model
        before, (dry,) = model.simulations, model.effects
        asks = [
            SensitivityRequest(r, point, np.zeros(0), candidates=(Candidate(dry),)) for r in records
        ]
        found = [model.sensitivities(asks) for _ in range(2)][1]
        columns = [(s.outputs, s.d_theta, s.d_candidates) for s in found]
        # The point, and one or two runs for each parameter and for the friction.
        assert 2 * 5 <= model.simulations - before <= 2 * 9
        return [c.tobytes() for s in columns for c in s], model.simulations

    alone = step(workers=1)
    assert step(workers=2) == alone
    with ThreadPoolExecutor(2) as pool:
        assert step(pool) == alone


@pytest.mark.parametrize("dampings", [[51.0], [1.0, 51.0]])
def test_a_process_that_ends_is_one_message(fragile, dampings):
    """A trial ends its process, alone or with others: this process goes on."""
    model = cart(fragile, workers=2).ready([pushed()]).model
    thetas = np.array([[2.0, 40.0, d] for d in dampings])
    told = r"cart: a process of its function ended without .*, d = .*workers=1 runs it in this"
    with pytest.raises(InvalidParameter, match=told):
        model.simulate(pushed(), Jobs(theta=thetas, starts=np.zeros((len(dampings), 0))))


@pytest.fixture(scope="module")
def clocked(tmp_path_factory):
    return units.clocked(tmp_path_factory.mktemp("clocked"))


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("start", [0.0, 2.5])
@pytest.mark.parametrize("inputs", [(), ("u",)])
def test_model_exchange_gives_the_numbers_of_fmpy(clocked, inputs, start, even):
    """Without an input, all samples but the last one were the start values."""
    import fmpy

    time = start + np.linspace(0.0, 4.0, 201)
    if not even:
        time[1:-1] += 4e-3 * np.sin(np.arange(1, 200))
    force = np.sin(3.0 * time)
    names = ("x", "v", "h", "w")
    model = unmodeled.fmu(clocked, parameters={"mu": (None, 0.1, "1")}, unknown={}, inputs=inputs)
    record = Record(
        name="a",
        time=time,
        inputs={"u": force} if inputs else {},
        outputs={n: np.zeros(201) for n in names},
    )
    got = model.simulate(record, Jobs(theta=np.array([[1.4]]), starts=np.zeros((1, 0))))[0]
    every = start + np.linspace(0.0, 4.0, 2001)
    table = np.array(list(zip(every, np.sin(3.0 * every), strict=True)),
                     [("time", float), ("u", float)])  # fmt: skip
    seen = fmpy.simulate_fmu(
        str(clocked), start_time=start, stop_time=start + 4.0, output_interval=2e-3,
        relative_tolerance=1e-8, start_values={"mu": 1.4}, input=table if inputs else None,
        record_events=False, output=list(names),
    )  # fmt: skip
    for i, name in enumerate(names):
        wanted = np.interp(time, seen["time"], seen[name])
        assert np.ptp(wanted) > 0.9
        # The speed of the ball jumps; FMPy alone gives an input in steps of its output.
        away = np.interp(time, seen["time"], seen["h"]) > 0.1 if name == "w" else np.full(201, True)
        np.testing.assert_allclose(
            got[away, i], wanted[away], atol=1e-3 if inputs else 3e-4, err_msg=name
        )


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"no archive", "cannot be read as an FMU: File is not a zip file"),
        ({"modelDescription.xml": b"<x/>"}, "cannot be read as an FMU"),
        ({"modelDescription.xml": b" " * 100_000_001}, "modelDescription.xml has 100000001 bytes"),
        ({str(k): b"" for k in range(10_001)}, "has 10001 files; the limit is 10000 files"),
        ({"big": 4_000_000_001}, "unpacked it has 4000000001 bytes; the limit is 4000000000"),
    ],
)
def test_an_fmu_that_cannot_be_read_is_told(tmp_path, content, said):
    pytest.importorskip("fmpy")
    path = tmp_path / "bad.fmu"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in content.items():
                archive.writestr(name, text if isinstance(text, bytes) else b"")
        if "big" in content:  # the size that it states
            path.write_bytes(
                path.read_bytes().replace(b"\0\0\0\0\x03\0", b"\x01\x28\x6b\xee\x03\0")
            )
    with pytest.raises(InvalidParameter, match=said):
        unmodeled.fmu(path)


def test_no_folder_stays_behind_if_an_fmu_cannot_be_unpacked(fmu, tmp_path, monkeypatch):
    path = shutil.copy(fmu, tmp_path / "cart.fmu")
    model = cart(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("C:/x", b"")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    time = np.arange(3.0)
    record = Record(name="a", time=time, inputs={"force": time}, outputs={"x": time})
    with pytest.raises(InvalidParameter, match="cannot be unpacked as an FMU: Illegal path C:/x"):
        model.ready([record])
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.slow
def test_friction_is_named_and_its_start_value_closes_the_gap_in_fmpy(fmu, tmp_path):
    """From the file and records to the cause, in the short form, with the default candidates."""
    fmpy = pytest.importorskip("fmpy")
    time = np.arange(300) * 1e-2

    def played(force, values):
        table = np.array(list(zip(time, force, strict=True)), [("time", float), ("force", float)])
        seen = fmpy.simulate_fmu(str(fmu), start_values=values, input=table, output=["x"],
                                 stop_time=time[-1], output_interval=time[1])  # fmt: skip
        return np.interp(time, seen["time"], seen["x"])

    random = np.random.default_rng(1)
    truth, records = {"mass": 2.06, "k": 40.8, "d": 1.1, "dry": 0.43}, []
    for size, role in ((1.0, "fit"), (2.0, "fit"), (3.0, "held_out")):
        rates, phases = random.uniform(2, 15, 5), random.uniform(0, 6, 5)
        force = size * np.sin(np.outer(time, rates) + phases).sum(axis=1)
        x = played(force, truth) + 1e-4 * random.standard_normal(time.size)
        sensors = {"x": Sensor(name="x", unit="m", sigma=1e-4)}
        records.append(Record(name=f"size {size}", time=time, inputs={"force": force},
                              outputs={"x": x}, sensors=sensors, role=role))  # fmt: skip
    prior = {"mass": (None, 0.1, "kg"), "k": (None, 2.0, "N/m"), "d": (None, 0.3, "N s/m")}
    model = unmodeled.fmu(fmu, parameters=prior, unknown={"dry": "N"}, hold="zero")
    report = model.diagnose(records, options=Options(seconds=900.0))
    (named,) = report.named
    assert named.cause == "dry"
    assert named.magnitude == pytest.approx(0.43, rel=0.03)
    values = tomllib.loads(report.model.write(tmp_path / "found.toml").read_text())["parameters"]
    last = records[-1]
    before, after = (
        np.sqrt(np.mean((played(last.inputs["force"], v) - last.outputs["x"]) ** 2))
        for v in ({}, values)
    )
    assert after == pytest.approx(report.channels[0].held_out_explained, rel=0.02)
    assert after < 0.1 * before


def test_limits_that_an_fmu_states_are_those_of_its_parameters():
    def variable(low, high):
        return SimpleNamespace(min=low, max=high)

    variables = {"k": variable("0.5", None), "x": variable("0", "1"), "d": variable(None, None),
                 "gain": variable(None, "2")}  # fmt: skip
    found = _limits(variables, ["k", "d", "gain"])
    assert found == {"k": (0.5, np.inf), "gain": (-np.inf, 2.0)}
