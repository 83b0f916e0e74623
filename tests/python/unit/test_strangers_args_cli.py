"""Everyday handling: units by joint, endings of files, pictures of runs, resumed strokes."""

import importlib
import sys
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb import _core, plot
from feltmb.cli import cli
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.mechanism import Action, core_law, describe
from feltmb.mechanism.parameters import all_parameters


def command(*arguments):
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def refusal(*arguments):
    """Message of a command that is refused."""
    done = command(*arguments)
    assert done.exit_code != 0
    assert isinstance(done.exception, (FeltmbError, SystemExit)), done.exception
    return str(done.exception) + done.output


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """The mechanism that ``feltmb new`` writes."""
    path = tmp_path_factory.mktemp("new") / "t.toml"
    assert command("new", path).exit_code == 0
    return path


@pytest.fixture(scope="module")
def sledge(data):
    return feltmb.load_action(data / "mass_spring.toml")


# ---------------------------------------------------------------- item 12


def test_sensitivity_of_the_template(template):
    """The rest pose near a rest pose: the search went to and fro between two roundings."""
    gradient = feltmb.gradient(str(template), "piano", None, ())
    assert gradient.summary
    assert np.all(np.isfinite(gradient.summary_gradient["key_travel"]))


def test_sensitivity_orders_by_what_the_stroke_has(template):
    done = command("sensitivity", template, "piano", "--parameters", "hammer.mass")
    assert done.exit_code == 0, done.exception
    peak = feltmb.simulate(str(template), "piano").summary["max_impact_force"]
    assert f"is {peak:.4g} N" in done.output
    assert "impact_speed" in refusal(
        *("sensitivity", template, "piano", "--parameters", "hammer.mass"),
        *("--number", "impact_speed"),
    )


@pytest.mark.parametrize("written", ["15 g", "0.015 kg", {"value": 15.0, "unit": "g"}, 0.015])
def test_a_value_is_scaled_however_it_is_written(pendulum, written):
    raw = pendulum.raw
    raw["bodies"]["arm"]["mass"] = written
    made = Action(raw)
    axis = importlib.import_module("feltmb.run.sweep").Axis("m", (1.2,), ("arm.mass",), "scale")
    assert made.with_values(axis.at(1.2)).config.bodies["arm"].mass == pytest.approx(0.018)
    table = feltmb.sweep(
        made,
        feltmb.ramp_stroke(1.0, duration=0.002),
        {"arm.mass": {"scale": [1.0, 1.2]}},
        progress=False,
    ).table
    assert list(table["status"]) == ["done", "done"]


def test_a_number_without_a_unit_is_in_si_units_where_the_file_has_a_text(pendulum):
    raw = pendulum.raw
    raw["bodies"]["arm"]["mass"] = "15 g"
    raw["surfaces"]["block"]["point"] = ["9 mm", "350 mm"]
    made = Action(raw).with_values({"arm.mass": 0.016, "surfaces.block.point.x": 0.01})
    assert made.config.bodies["arm"].mass == pytest.approx(0.016)
    assert made.raw["bodies"]["arm"]["mass"] == "16.0 g"
    assert made.config.surfaces["block"].point == pytest.approx((0.010, 0.350))
    assert Action(raw).with_values({"arm.mass": "16 kg"}).config.bodies["arm"].mass == 16.0


def test_units_of_a_spring_are_those_of_its_joint(sledge, pendulum, data):
    raw = pendulum.raw
    raw["springs"] = {"s": {"coordinate": "arm.angle", "stiffness": 1.0, "rest_angle": 0.1}}
    expected = {
        "stiffness": ("N/m", "N m/rad"),
        "rest_angle": ("m", "rad"),
        "damping": ("N s/m", "N m s/rad"),
        "clearance": ("m", "rad"),
        "seating": ("N", "N m"),
    }
    for i, action in enumerate((sledge, Action(raw))):
        found = {p.path.rpartition(".")[2]: p.unit for p in all_parameters(action)
                 if p.path.startswith("springs.")}  # fmt: skip
        assert found == {name: units[i] for name, units in expected.items()}
    shown = command("show", data / "mass_spring.toml").output
    assert "0.001 N/m, from 0 m" in shown
    assert "rad" not in shown.partition("springs and straps")[2]


def test_units_of_friction_are_those_of_joint_or_contact(sledge, pendulum):
    for action, path, unit in (
        (sledge, "bodies.sledge.friction.viscous", "N s/m"),
        (sledge, "bodies.sledge.friction.stribeck_speed", "m/s"),
        (pendulum, "bodies.arm.friction.viscous", "N m s/rad"),
        (pendulum, "bodies.arm.friction.amplitude", "N m"),
        (pendulum, "contacts.01.friction.viscous", "s/m"),
        (pendulum, "contacts.01.friction.amplitude", "1"),
    ):
        assert {p.path: p.unit for p in all_parameters(action)}[path] == unit


def test_the_core_names_units_by_joint_too(sledge):
    description = describe(sledge.config, None)
    (spring,) = description.springs
    spring.stiffness = spring.damping = float("inf")
    description.springs = [spring]
    with pytest.raises(InvalidParameter, match=r"stiffness = inf N/m, must be >= 0") as caught:
        _core.assemble(description)
    assert "damping = inf N s/m, must be >= 0" in str(caught.value)


@pytest.mark.parametrize("law", ["guarded", "micromechanical"])
def test_two_lines_are_told_as_such(pendulum, law):
    raw = pendulum.raw
    raw["surfaces"]["head"] = {"body": "arm", "kind": "line", "point": [0, -0.15], "normal": [1, 0]}
    if law == "micromechanical":
        area = {"kind": "circle_on_layer", "width": "9 mm"}
        raw["contacts"]["01"] = {
            "surfaces": ["head", "block"],
            "law": {"name": law, "felt": "synthetic_hammer", "thickness": "6 mm", "area": area},
        }
    with pytest.raises(InvalidParameter) as caught:
        Action(raw)
    assert "a line (head) cannot meet a line (block); one of the pair must be a circle" in str(
        caught.value
    )
    assert "radius" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("duraton = 0.3\n[ram]\nforce = 5.0", "did you mean 'ramp'?"),
        ("kind = 'force'\ntime = [0, 1]\nvalue = [0, 1]", "give one of ramp, pulse, knots"),
        ("[body.a]\nmass = 1.0\n[surface.b]", "did you mean 'bodies'?"),
        ("about = 'nothing'", "is neither a stroke nor a mechanism"),
    ],
)
def test_a_file_is_judged_as_what_it_is_meant_to_be(tmp_path, text, message):
    path = tmp_path / "x.toml"
    path.write_text(f'schema = 1\nname = "x"\n{text}\n', encoding="utf-8")
    told = refusal("validate", path)
    assert message in told
    assert ("bodies: is missing" in told) == ("bodies" in message)


def test_the_mechanism_of_a_run_is_drawn_at_impact(template):
    from feltmb.graphics.plot.portrait import moment_of_run

    action = feltmb.load_action(template)
    run = feltmb.simulate(action, "press_release")
    title = moment_of_run(run).texts[0].get_text()
    assert f"at impact, {1e3 * run.summary['impact_time']:.1f}" in title
    still = feltmb.simulate(action, feltmb.ramp_stroke(0.1, duration=0.02))
    assert "impact_time" not in still.summary
    assert "farthest from its start" in moment_of_run(still).texts[0].get_text()


def test_help_of_the_actuator_writes_a_mass_with_its_unit():
    told = command("actuator", "--help").output
    assert "tip.mass=0.05" not in told
    assert "tip.mass=1.5g" in told
    from feltmb.action.actuator import load_actuator

    assert load_actuator("wood").with_values({"tip.mass": "1.5g"}).config.tip.mass == 0.0015


# ---------------------------------------------------------------- item 10

LAWS = {
    "hunt_crossley": {"hunt_crossley": {"stiffness": 2e6, "exponent": 1.5, "damping": 0.5}},
    "stulov": {"stulov": {"stiffness": 2e6, "exponent": 1.5, "amplitude": 0.5, "time": 1e-3}},
    "micromechanical": {
        "micromechanical": {
            "felt": "synthetic_hammer",
            "thickness": "6 mm",
            "area": {"kind": "circle_on_layer", "width": "9 mm"},
        }
    },
    "mean": {},
    "felt_memory": {},
}


@pytest.mark.parametrize(
    ("law", "inherited"),
    [(law, True) for law in LAWS] + [(law, False) for law in LAWS if LAWS[law]],
)
def test_the_law_in_use_is_drawn(template, law, inherited):
    """With or without curves that another law of the base file had."""
    raw = tomllib.loads(template.read_text(encoding="utf-8"))
    contact = raw["contacts"]["01"]
    contact.update({"law": law, **LAWS[law]})
    if not inherited:
        del contact["loading"], contact["unloading"]
    run = feltmb.simulate(Action(raw), "press_release", 0.6)
    ax = plot.loops(run, [1]).axes[0]
    drawn = {line.get_label(): line for line in ax.get_lines()}
    pressed = drawn["law alone, pressed"]
    deepest = float(run["contact01.compression"].max())
    assert pressed.get_xdata()[-1] == pytest.approx(1e3 * deepest)
    if law in ("hunt_crossley", "mean"):  # the same number by the law's own static force
        made = core_law(Action(raw).config.contacts["01"])
        static = float(np.asarray(made.force(np.array([deepest])))[0])
        assert pressed.get_ydata()[-1] == pytest.approx(static, rel=0.2)


def test_a_picture_that_fails_loses_nothing(template, tmp_path, monkeypatch):
    import feltmb.graphics.plot

    def fail(*_args, **_options):
        raise AssertionError("no curve")

    monkeypatch.setattr(feltmb.plot, "save_all", fail)
    done = command("stroke", template, "press_release", "piano", "--plot", "-o", tmp_path / "out")
    assert done.exit_code != 0
    assert done.output.count("right-hand sides") == 2  # both tables
    for name in ("press_release", "piano"):
        assert feltmb.load_run(tmp_path / "out" / f"{name}.nc").status == "done"
    assert "no picture or sound: AssertionError: no curve" in str(done.exception)


# ---------------------------------------------------------------- item 19


def test_csv_of_a_stroke_has_units_and_all_outputs(template, tmp_path):
    path = tmp_path / "run.csv"
    done = command("stroke", template, "piano", "--duration", "0.02", "-o", path)
    assert done.exit_code == 0, done.exception
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    run = feltmb.simulate(str(template), "piano", 0.02)
    titles = ["time [s]", *(f"{n} [{u}]" for n, u in zip(run.names, run.units, strict=True))]
    assert head.split(",") == titles
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    np.testing.assert_allclose(table[:, 0], run.time, rtol=1e-8)
    np.testing.assert_allclose(table[:, 1:], run.values, rtol=1e-8, atol=1e-300)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("stroke", "{t}", "piano", "-o", "run.mp3"),
            "cannot write .mp3, expected .nc, .h5 or .csv",
        ),
        (("stroke", "{t}", "piano", "forte", "-o", "run.nc"), "expected that of a folder"),
        (("wav", "{t}", "-o", "a.mp3"), "cannot write .mp3, expected .wav"),
        (("touch", "{t}", "--plot", "t.png"), "t.png: is the name of a file, expected that of a"),
        (("plot", "{t}", "-o", "t.png"), "expected that of a folder"),
        (("study", "letoff", "-o", "t.html"), "expected that of a folder"),
        (("demo", "-o", "t.csv"), "expected that of a folder"),
        (("regulate", "steinway45", "-o", "t.json"), "cannot write .json, expected .toml"),
        (("sensitivity", "{t}", "piano", "-o", "t.nc"), "cannot write .nc, expected .csv"),
        (("actuator", "-o", "t.txt"), "cannot write .txt, expected .nc or .csv"),
        (("actuator", "study", "-o", "t.png"), "expected that of a folder"),
        (
            ("felt", "envelope", "synthetic_hammer", "-o", "t.csv"),
            "cannot write .csv, expected .toml",
        ),
    ],
)
def test_the_ending_decides_and_is_checked_first(
    template, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    told = refusal(*(str(template) if a == "{t}" else a for a in arguments))
    assert message in told
    assert not list(tmp_path.iterdir())


def test_endings_of_the_library(template, tmp_path):
    run = feltmb.simulate(str(template), "piano", 0.005)
    with pytest.raises(InvalidParameter, match=r"cannot write \.txt, expected \.nc, \.h5 or \.csv"):
        run.save(tmp_path / "run.txt")
    with pytest.raises(InvalidParameter, match=r"cannot write a name without ending"):
        run.save(tmp_path / "run")


def test_a_cut_off_command_goes_on(template, tmp_path, monkeypatch):
    out = tmp_path / "out"
    short = ("--duration", "0.01", "-o", out)
    assert command("stroke", template, "piano", "forte", *short).exit_code == 0
    (out / "forte.nc").unlink()  # as if it had been killed
    before = (out / "piano.nc").read_bytes()
    simulated = []
    module = sys.modules["feltmb.run.simulate"]
    real = module.simulate

    def count(action, stroke, *args, **options):
        simulated.append(stroke.name)
        return real(action, stroke, *args, **options)

    monkeypatch.setattr(module, "simulate", count)
    done = command("stroke", template, "piano", "forte", *short, "--resume")
    assert done.exit_code == 0, done.exception
    assert simulated == ["forte"]
    assert done.output.count("right-hand sides") == 2
    assert (out / "piano.nc").read_bytes() == before
    # Other inputs are other runs: nothing is replaced unasked.
    for other in (("--rtol", "1e-5"), ("--set", "hammer.mass=0.013")):
        told = refusal("stroke", template, "piano", "forte", *short, "--resume", *other)
        assert "exists already" in told
    done = command("stroke", template, "piano", *short, "--resume", "--rtol", "1e-5", "--force")
    assert done.exit_code == 0, done.exception
    assert simulated == ["forte", "piano"]


def test_resume_needs_a_place(template):
    assert "--resume needs --out" in refusal("stroke", template, "piano", "--resume")
