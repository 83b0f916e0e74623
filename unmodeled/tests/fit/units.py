"""Small FMUs in C, compiled by a test."""

import shutil
import subprocess
import zipfile

import pytest

#: Variables by name; the reference of a variable is its place.
VARIABLES = {
    "tau": ("parameter", 0.05),
    "u1": ("input", 0.0),
    "u2": ("input", 0.0),
    "u3": ("input", 0.0),
    "y1": ("output", None),
    "y2": ("output", None),
    "y3": ("output", None),
    "late": ("output", None),
    "rate": ("local", None),
}

#: Three outputs that are the inputs, and a lag of first order of the first input.
SOURCE = r"""
#include <math.h>
#include <stdlib.h>
#include <string.h>
typedef void* C; typedef unsigned int R; typedef int S; typedef const char* T;
enum { TAU, U1, U2, U3, Y1, Y2, Y3, LATE, RATE, COUNT };
static double value(const double* z, R r) {
    return r >= Y1 && r <= Y3 ? z[U1 + r - Y1] : r == RATE ? (z[U1] - z[LATE]) / z[TAU] : z[r];
}
C fmi2Instantiate(T n, S t, T g, T r, const void* f, S v, S l) {
    double* z = calloc(COUNT, sizeof(double));
    z[TAU] = 0.05;
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
S fmi2Reset(C c) { ((double*)c)[LATE] = 0; return 0; }
S fmi2GetReal(C c, const R* r, size_t n, double* v) {
    for (size_t i = 0; i < n; ++i) v[i] = value(c, r[i]);
    return 0;
}
S fmi2SetReal(C c, const R* r, size_t n, const double* v) {
    for (size_t i = 0; i < n; ++i) ((double*)c)[r[i]] = v[i];
    return 0;
}
S fmi2DoStep(C c, double t, double h, S no) {
    double* z = c;
    z[LATE] = z[U1] + (z[LATE] - z[U1]) * exp(-h / z[TAU]);
    return 0;
}
S fmi2EnterEventMode(C c) { return 0; }
S fmi2NewDiscreteStates(C c, int* info) { memset(info, 0, 5 * sizeof(int)); return 0; }
S fmi2EnterContinuousTimeMode(C c) { return 0; }
S fmi2CompletedIntegratorStep(C c, S no, int* event, int* end) { *event = *end = 0; return 0; }
S fmi2SetTime(C c, double t) { return 0; }
S fmi2SetContinuousStates(C c, const double* x, size_t n) { ((double*)c)[LATE] = x[0]; return 0; }
S fmi2GetContinuousStates(C c, double* x, size_t n) { x[0] = ((double*)c)[LATE]; return 0; }
S fmi2GetDerivatives(C c, double* x, size_t n) { x[0] = value(c, RATE); return 0; }
S fmi2GetNominalsOfContinuousStates(C c, double* x, size_t n) { x[0] = 1; return 0; }
S fmi2GetEventIndicators(C c, double* z, size_t n) { return 0; }
"""

#: Functions that these FMUs do not have.
REFUSED = r"""
#define NONE(name) int name(void) { return 3; }
NONE(fmi2GetInteger) NONE(fmi2SetInteger) NONE(fmi2GetBoolean) NONE(fmi2SetBoolean)
NONE(fmi2GetString) NONE(fmi2SetString) NONE(fmi2GetFMUstate) NONE(fmi2SetFMUstate)
NONE(fmi2FreeFMUstate) NONE(fmi2SerializedFMUstateSize) NONE(fmi2SerializeFMUstate)
NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetDirectionalDerivative)
NONE(fmi2SetRealInputDerivatives) NONE(fmi2GetRealOutputDerivatives) NONE(fmi2CancelStep)
NONE(fmi2GetStatus) NONE(fmi2GetRealStatus) NONE(fmi2GetIntegerStatus)
NONE(fmi2GetBooleanStatus) NONE(fmi2GetStringStatus)
"""


def compile_fmu(folder, name, description, source):
    """An FMU 2.0 from its model description and its C source; skips without a compiler."""
    fmpy = pytest.importorskip("fmpy")
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    (folder / f"{name}.c").write_text(source + REFUSED)
    library = folder / f"{name}{fmpy.sharedLibraryExtension}"
    command = [compiler, "-shared", "-fPIC", "-O2", "-o", library, folder / f"{name}.c", "-lm"]
    subprocess.run(command, check=True)
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
    return path


def three_channels(folder, *kinds, variable=True):
    """An FMU of ``SOURCE`` for these kinds; ``variable``: it takes steps of any duration."""
    rows = []
    for place, (name, (causality, start)) in enumerate(VARIABLES.items()):
        variability = "tunable" if causality == "parameter" else "continuous"
        value = "" if start is None else f' start="{start}"'
        value += ' derivative="8"' if name == "rate" else ""
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}" '
            f'variability="{variability}"><Real{value}/></ScalarVariable>'
        )
    steps = ' canHandleVariableCommunicationStepSize="true"' if variable else ""
    heads = [f'<{k} modelIdentifier="three"{steps if k == "CoSimulation" else ""}/>' for k in kinds]
    description = (
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<fmiModelDescription fmiVersion="2.0" modelName="three" guid="{three}" '
        'numberOfEventIndicators="0">' + "".join(heads) + "<ModelVariables>" + "".join(rows)
        + "</ModelVariables><ModelStructure><Outputs>"
        + "".join(f'<Unknown index="{i}"/>' for i in (5, 6, 7, 8))
        + '</Outputs><Derivatives><Unknown index="9"/></Derivatives></ModelStructure>'
        "</fmiModelDescription>"
    )  # fmt: skip
    return compile_fmu(folder, "three", description, SOURCE)


#: A van der Pol oscillator whose second rate also has the input and the time, and a ball that
#: bounces: variable -> causality, start.
CLOCKED = {
    "x": ("output", 2.0),
    "v": ("output", 0.0),
    "h": ("output", 1.0),
    "w": ("output", 0.0),
    "mu": ("parameter", 1.0),
    "u": ("input", 0.0),
    "der(x)": ("local", None),
    "der(v)": ("local", None),
    "der(h)": ("local", None),
    "der(w)": ("local", None),
}

CLOCKED_SOURCE = (
    SOURCE[: SOURCE.index("enum {")]
    + r"""
typedef struct { double z[6], t; } M;
static void rates(const M* m, double* d) {
    const double* z = m->z;
    d[0] = z[1];
    d[1] = z[4] * (1 - z[0] * z[0]) * z[1] - z[0] + z[5] + 0.3 * sin(m->t);
    d[2] = z[3];
    d[3] = -9.81;
}
C fmi2Instantiate(T n, S t, T g, T r, const void* f, S v, S l) {
    M* m = calloc(1, sizeof(M));
    m->z[0] = 2; m->z[2] = 1; m->z[4] = 1;
    return m;
}
S fmi2SetupExperiment(C c, S td, double tol, double t0, S sd, double t1) {
    ((M*)c)->t = t0; return 0;
}
S fmi2GetReal(C c, const R* r, size_t n, double* v) {
    double d[4];
    rates(c, d);
    for (size_t i = 0; i < n; ++i) v[i] = r[i] < 6 ? ((M*)c)->z[r[i]] : d[r[i] - 6];
    return 0;
}
S fmi2SetReal(C c, const R* r, size_t n, const double* v) {
    for (size_t i = 0; i < n; ++i) ((M*)c)->z[r[i]] = v[i];
    return 0;
}
S fmi2NewDiscreteStates(C c, int* info) {
    M* m = c;
    memset(info, 0, 5 * sizeof(int));
    if (m->z[2] <= 0 && m->z[3] < 0) { m->z[2] = 0; m->z[3] *= -0.9; info[3] = 1; }
    return 0;
}
S fmi2SetTime(C c, double t) { ((M*)c)->t = t; return 0; }
S fmi2SetContinuousStates(C c, const double* x, size_t n) { memcpy(c, x, n * sizeof *x); return 0; }
S fmi2GetContinuousStates(C c, double* x, size_t n) { memcpy(x, c, n * sizeof *x); return 0; }
S fmi2GetDerivatives(C c, double* x, size_t n) { rates(c, x); return 0; }
S fmi2GetNominalsOfContinuousStates(C c, double* x, size_t n) {
    for (size_t i = 0; i < n; ++i) x[i] = 1;
    return 0;
}
S fmi2GetEventIndicators(C c, double* z, size_t n) { z[0] = ((M*)c)->z[2]; return 0; }
void fmi2FreeInstance(C c) { free(c); }
T fmi2GetTypesPlatform(void) { return "default"; }
T fmi2GetVersion(void) { return "2.0"; }
S fmi2SetDebugLogging(C c, S on, size_t n, const T* k) { return 0; }
S fmi2EnterInitializationMode(C c) { return 0; }
S fmi2ExitInitializationMode(C c) { return 0; }
S fmi2Terminate(C c) { return 0; }
S fmi2Reset(C c) { return 0; }
S fmi2DoStep(C c, double t, double h, S no) { return 3; }
S fmi2EnterEventMode(C c) { return 0; }
S fmi2EnterContinuousTimeMode(C c) { return 0; }
S fmi2CompletedIntegratorStep(C c, S no, int* event, int* end) { *event = *end = 0; return 0; }
"""
)


def clocked(folder):
    """An FMU of ``CLOCKED_SOURCE`` for model exchange: time, an input, events, states."""
    rows = []
    for place, (name, (causality, start)) in enumerate(CLOCKED.items()):
        variability = "tunable" if causality == "parameter" else "continuous"
        value = "" if start is None else f' start="{start}"'
        value += f' derivative="{place - 5}"' if start is None else ""
        exact = ' initial="exact"' if causality == "output" else ""
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}" '
            f'variability="{variability}"{exact}><Real{value}/></ScalarVariable>'
        )
    description = (
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<fmiModelDescription fmiVersion="2.0" modelName="clocked" guid="{clocked}" '
        'numberOfEventIndicators="1"><ModelExchange modelIdentifier="clocked"/><ModelVariables>'
        + "".join(rows) + "</ModelVariables><ModelStructure><Outputs>"
        + "".join(f'<Unknown index="{i}"/>' for i in (1, 2, 3, 4))
        + "</Outputs><Derivatives>" + "".join(f'<Unknown index="{i}"/>' for i in (7, 8, 9, 10))
        + "</Derivatives></ModelStructure></fmiModelDescription>"
    )  # fmt: skip
    return compile_fmu(folder, "clocked", description, CLOCKED_SOURCE)
