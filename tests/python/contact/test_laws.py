"""Laws from their table of fields: files, ``law()``, messages; formulas and compiled functions."""

import ctypes
import pickle
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
from calls import refused
from scipy.integrate import solve_ivp

import feltmb
from feltmb.contact import CORE_LAWS, LAWS, law
from feltmb.mechanism import Action, Contact
from unmodeled.errors import InvalidParameter

DATA = Path(__file__).resolve().parents[2] / "data"
SPRING = {"stiffness": 5e6, "exponent": 2.0, "damping": 0.2}
FORMULA = {"force": "k*e^p*(1 + d*rate)", "parameters": {"k": 5e6, "p": 2.0, "d": 0.2}}
SIGNATURE = ctypes.CFUNCTYPE(
    None,
    ctypes.c_double,
    ctypes.c_double,
    ctypes.POINTER(ctypes.c_double),
    ctypes.POINTER(ctypes.c_double),
)


def pendulum(**contact):
    raw = tomllib.loads((DATA / "pendulum.toml").read_text(encoding="utf-8"))
    raw["contacts"]["01"].update(contact)
    raw["finger"]["direction"] = [1.0, 0.0]  # onto the felt
    return raw


def swing(action):
    """The head is pressed into the felt at once."""
    return feltmb.simulate(action, feltmb.ramp_stroke(20.0, 1e-3, duration=0.1), rtol=1e-8)


def test_every_field_of_the_core_is_a_key_of_a_contact_with_its_limits():
    model = Contact.model_json_schema()
    tables = model["$defs"]
    for name in LAWS:
        if name not in CORE_LAWS:
            continue
        info = CORE_LAWS[name]
        for field in info.fields:
            if field.in_contact:
                keys = model["properties"]
            else:
                part = info.table.title().replace("_", "") + "Parameters"
                keys = tables[part]["properties"]
            assert field.name in keys, (name, field.name)
            if field.kind != "number":
                continue
            found = keys[field.name]
            limits = ("exclusiveMinimum", "gt") if field.low_open else ("minimum", "ge")
            assert field.low in [found.get(limit) for limit in limits], (name, field.name)
            assert found.get("default") == field.default, (name, field.name)
            assert found["description"] == field.meaning


def test_a_value_out_of_range_is_refused_alike_everywhere():
    with pytest.raises(feltmb.InvalidParameter, match=r"restitution = 1.5, must be in \[0, 1\]"):
        law("lankarani_nikravesh", stiffness=1e6, restitution=1.5)
    table = {"stiffness": 1e6, "restitution": 1.5}
    with pytest.raises(
        feltmb.InvalidParameter,
        match=r"contacts.01.lankarani_nikravesh.restitution: got 1.5, must be <= 1",
    ):
        Action(pendulum(law="lankarani_nikravesh", lankarani_nikravesh=table))
    with pytest.raises(feltmb.InvalidParameter, match=r"contacts.01.maxwell: is missing; law"):
        Action(pendulum(law="maxwell"))


def test_units_of_a_table_are_those_of_its_fields():
    given = {"stiffness": "8 N/mm", "damping": {"value": 3.0, "unit": "N s/m"}}
    table = Action(pendulum(law={"name": "kelvin_voigt", **given})).config.contacts["01"]
    assert table.kelvin_voigt.stiffness == 8e3


def test_laws_that_are_not_given_change_no_hash():
    """Results of before a law was added keep their hash."""
    assert feltmb.load_action("steinway45").hash.startswith("d29e99c64bb0f009")


@pytest.mark.parametrize(("stated", "comes"), [(0.5, 0.725), (0.7, 0.796), (0.9, 0.913)])
def test_the_restitution_of_lankarani_nikravesh_is_larger_than_the_stated_one(stated, comes):
    """As docs/explanation/model.md tells; 10 g at 2 m/s, integrated by SciPy."""
    felt = law("lankarani_nikravesh", stiffness=1e7, restitution=stated, impact_speed=2.0)

    def leaves(_, y):
        return y[0]

    leaves.terminal, leaves.direction = True, -1.0
    run = solve_ivp(
        lambda _, y: [y[1], -float(felt.force(y[0], y[1])) / 0.01],
        (0.0, 0.1),
        [1e-12, 2.0],
        events=leaves,
        rtol=1e-7,
        atol=1e-12,
        max_step=1e-4,
    )
    assert -run.y[1, -1] / 2.0 == pytest.approx(comes, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("kelvin_voigt", {"stiffness": 4e3, "damping": 2.0}),
        ("lankarani_nikravesh", {"stiffness": 5e5, "restitution": 0.8, "impact_speed": 1.0}),
        ("stulov_differential", {"stiffness": 5e8, "exponent": 2.5, "time": 5e-5}),
        ("maxwell", {"stiffness": 1e8, "branch_stiffness": 2e8}),
        (
            "dunlop",
            {"stiffness": 5e5, "share": 0.2, "friction_1": 0.2, "friction_3": 1.0, "damping": 20.0},
        ),
        ("expression", FORMULA),
    ],
)
def test_energies_of_a_blow_add_up(name, table):
    run = swing(Action(pendulum(law=name, **{name: table})))
    assert run["contact01.force"].max() > 15.0
    assert run.energy["residual_relative"] < 1e-6
    assert run.energy["created_by"] == []


# ---------------------------------------------------------------- formulas


def test_a_formula_is_the_law_that_it_writes():
    ours = swing(Action(pendulum(law="expression", expression=FORMULA)))
    theirs = swing(Action(pendulum(law="hunt_crossley", hunt_crossley=SPRING)))
    for name in ("arm.angle", "contact01.force"):
        top = np.abs(theirs[name]).max()
        assert np.abs(ours[name] - theirs[name]).max() < 1e-6 * top
    assert ours.energy["dissipated"] == pytest.approx(theirs.energy["dissipated"], rel=1e-6)


def test_a_fault_of_a_formula_is_one_line_with_its_place():
    with pytest.raises(feltmb.InvalidParameter) as error:
        Action(pendulum(law="expression", expression={**FORMULA, "force": "k*e^p*(1 + d*speed)"}))
    line = str(error.value).splitlines()[1].strip()
    assert line.startswith(
        "contacts.01: expression: force: column 14: unknown name 'speed'; known are e, rate, pi, d"
    )
    with pytest.raises(feltmb.InvalidParameter, match=r"expression.force: is missing"):
        Action(pendulum(law="expression", expression={"parameters": {}}))
    with pytest.raises(feltmb.InvalidParameter, match=r"parameters.k: got 'x', expected a finite"):
        Action(pendulum(law="expression", expression={"force": "k*e", "parameters": {"k": "x"}}))
    with pytest.raises(feltmb.InvalidParameter, match=r"force = 3, expected a text"):
        law("expression", force=3)
    with pytest.raises(feltmb.InvalidParameter, match=r"parameters = \[1\], expected numbers by"):
        law("expression", force="e", parameters=[1])


def test_a_formula_is_never_run_as_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text in (
        "__import__('os').mkdir('x')",
        "e.__class__",
        "e; e",
        "[e]",
        "lambda: e",
        "e if 1",
    ):
        with pytest.raises(feltmb.InvalidParameter, match="column"):
            law("expression", force=text)
    assert list(tmp_path.iterdir()) == []


def test_a_formula_without_a_number_fails_the_run_and_says_where():
    formula = {"force": "1e4*e + 0*sqrt(1.2e-3 - e)", "parameters": {}}
    with pytest.raises(feltmb.IntegrationError) as error:
        swing(Action(pendulum(law="expression", expression=formula)))
    assert 'law "expression" of contact01 gives force' in str(error.value)
    assert "at compression 0.0012" in str(error.value)


# ---------------------------------------------------------------- compiled functions


def python_spring(e, rate, p, out):
    elastic = p[0] * e ** p[1]
    out[0] = elastic * (1.0 + p[2] * rate)
    out[1] = p[1] * elastic / e * (1.0 + p[2] * rate)
    out[2] = elastic * p[2]


def test_a_function_is_the_law_that_it_computes():
    own = law("callback", function=SIGNATURE(python_spring), parameters=[5e6, 2.0, 0.2])
    base = Action(pendulum(law="hunt_crossley", hunt_crossley=SPRING))
    action = base.with_laws({"01": own})
    ours, theirs = swing(action), swing(base)
    top = np.abs(theirs["contact01.force"]).max()
    assert np.abs(ours["contact01.force"] - theirs["contact01.force"]).max() < 1e-6 * top
    assert action.hash != base.hash
    assert ours.provenance["hash"] == action.hash
    assert "# contact 01 followed 'callback' instead" in action.to_toml()
    changed = action.with_values({"arm.mass": 0.021})
    assert changed.mechanism.contact_numbers == action.mechanism.contact_numbers
    assert changed.hash not in (action.hash, base.hash)
    assert changed.with_laws({"01": law("mean", loading=(1, 1, 1), unloading=(1, 1, 1))}).hash
    with pytest.raises(feltmb.InvalidParameter, match="cannot be pickled"):
        pickle.dumps(action)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_a_function_compiled_from_c(tmp_path):
    source = tmp_path / "spring.c"
    source.write_text(
        "void spring(double e, double r, const double* p, double* out)"
        "{ out[0] = p[0] * e; out[1] = p[0]; out[2] = 0.0; (void)r; }"
    )
    library = tmp_path / "spring.so"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", source, "-o", library], check=True, timeout=60)
    function = ctypes.CDLL(str(library)).spring
    assert law("callback", function=function, parameters=[3e3]).force(1e-3)[()] == 3.0
    address = ctypes.cast(function, ctypes.c_void_p).value
    assert law("callback", function=address, parameters=[3e3]).force(1e-3)[()] == 3.0


def test_no_number_from_a_function_fails_the_run_and_says_where():
    def broken(e, rate, p, out):
        python_spring(e, rate, p, out)
        if e > 1.2e-3:
            out[0] = float("nan")

    own = law("callback", function=SIGNATURE(broken), parameters=[5e6, 2.0, 0.2])
    with pytest.raises(feltmb.IntegrationError) as error:
        swing(Action(pendulum()).with_laws({"01": own}))
    assert 'law "callback" of contact01 gives force nan N' in str(error.value)


def test_what_is_no_function_and_what_is_no_contact_are_refused():
    for wrong in (None, "f", 0, 1.5, python_spring, True):
        with pytest.raises(feltmb.InvalidParameter, match="expected a compiled function"):
            law("callback", function=wrong)
    with pytest.raises(feltmb.InvalidParameter, match="parameter 'function' is missing"):
        law("callback")
    own = law("callback", function=SIGNATURE(python_spring), parameters=[5e6, 2.0, 0.2])
    action = Action(pendulum())
    with pytest.raises(feltmb.InvalidParameter, match="contact '07' is missing; known are 01"):
        action.with_laws({"07": own})
    with pytest.raises(feltmb.InvalidParameter, match="got 3, expected a Law"):
        action.with_laws({"01": 3})


def test_no_file_can_name_a_function():
    """An address in a file would be a call into anything."""
    assert "callback" not in LAWS
    with pytest.raises(feltmb.InvalidParameter, match="got 'callback', expected 'guarded'"):
        Action(pendulum(law="callback", callback={"function": 4096}))
    with pytest.raises(feltmb.InvalidParameter, match=r"contacts.01.callback: unknown key"):
        Action(pendulum(callback={"function": 4096}))


def test_curve_of_a_law_that_is_a_number():
    # TypeError: object of type 'int' has no len()
    refused(lambda: law("mean", loading=5, unloading=(1.0, 2.0, 3.0)), "loading = 5, expected")


def test_lengths_of_compression_and_rate():
    law = feltmb.contact.law("stulov", stiffness=1e8, exponent=2.5, amplitude=0.3, time=1e-3)
    with pytest.raises(InvalidParameter, match="shape"):
        law.force([1e-3, 2e-3], [0.0, 0.0, 0.0])
    assert law.force([1e-3, 2e-3], 0.0).shape == (2,)
