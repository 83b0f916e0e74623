"""A measured force of the action in place of its mass (thesis section 5.1.1)."""

import numpy as np
import pytest

import feltmb
from feltmb import actuator
from feltmb.action.actuator.plot import plot_run
from feltmb.cli import main


@pytest.fixture(scope="module")
def wood():
    return actuator.load_actuator("wood")


@pytest.fixture(scope="module")
def with_mass(wood):
    return actuator.simulate_actuator(wood, duration=0.06)


@pytest.fixture(scope="module")
def measured(with_mass):
    """What a load cell between tip and key would have shown of the action."""
    return feltmb.table_stroke(with_mass.time, with_mass["action.force"], interpolation="linear")


def test_the_force_of_a_mass_moves_the_tip_as_the_mass_did(wood, with_mass, measured):
    run = actuator.simulate_actuator(wood.with_action(measured), duration=0.06)
    contact = with_mass.summary["first_contact_time"]
    assert run.summary["first_contact_time"] == pytest.approx(contact, abs=3e-6)
    before = with_mass.time < contact
    for name, within in (("tip.travel", 5e-6), ("hub.angle", 5e-5), ("tip.speed", 5e-4)):
        assert np.max(np.abs(run[name] - with_mass[name])[before]) < within, name
    assert abs(run.energy["residual_relative"]) < 1e-4
    work = run["work.action"][-1]
    assert work == pytest.approx(with_mass["work.action"][-1], rel=4e-3)


def test_a_constant_force_turns_a_stiff_arm_as_its_moment_does(wood):
    """Closed form: theta = -F (a + L) t^2 / (2 J)."""
    stiff = wood.with_values(
        {"gravity": 0.0, "stop.enabled": False, "arm.young_modulus": {"value": 1e6, "unit": "GPa"}}
    )
    force = feltmb.table_stroke([0.0, 1.0], [5.0, 5.0], interpolation="linear")
    no_torque = feltmb.torque_stroke([0.0, 1.0], [0.0, 0.0])
    run = actuator.simulate_actuator(stiff.with_action(force), no_torque, 0.02)
    wanted = -0.5 * 5.0 * stiff.reach / stiff.rigid_inertia * run.time**2
    assert np.max(np.abs(run["hub.angle"] - wanted)) < 1e-3 * abs(wanted[-1])
    assert run["work.action"][-1] == pytest.approx(5.0 * run["tip.travel"][-1], rel=1e-3)
    assert np.all(run["action.force"] == 5.0)


def test_it_is_kept_in_the_file(wood, measured, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(wood.with_action(measured).to_toml())
    again = actuator.load_actuator(path)
    assert again.config.action.mass == 0.0
    assert np.allclose(again.config.action.force.value, measured.value)


def test_the_command_takes_a_record(tmp_path, monkeypatch, measured, capsys):
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(
        f"{1e3 * t:.6g},{v:.9g}" for t, v in zip(measured.time, measured.value, strict=True)
    )
    (tmp_path / "cell.csv").write_text(f"time [ms],force [N]\n{rows}\n")
    with pytest.raises(SystemExit) as end:
        main(["actuator", "--action-force", "cell.csv", "--duration", "0.05", "--json"])
    assert end.value.code == 0
    assert '"first_contact_time": 0.0323' in capsys.readouterr().out
    for options, shown in (
        (["--action-force", "cell.csv"], "force of the action record replaces the mass"),
        ([], "mass of the action 0.27 kg"),
    ):
        with pytest.raises(SystemExit):
            main(["actuator", *options, "--duration", "0.05"])
        assert shown in " ".join(capsys.readouterr().out.split())


def test_the_legend_is_outside_the_axes(wood):
    figure = plot_run(actuator.simulate_actuator(wood, duration=0.02))
    figure.canvas.draw()
    legends = [ax.get_legend() for ax in figure.axes if ax.get_legend() is not None]
    assert legends
    for legend in legends:
        assert not legend.get_window_extent().overlaps(legend.axes.get_window_extent())


@pytest.mark.parametrize(
    ("stroke", "message"),
    [
        (feltmb.torque_stroke([0.0, 0.1], [0.0, 1.0]), "is a torque; the action answers with a"),
        (
            feltmb.Stroke("o", "force", (0.0, 0.1), (0.0, 1.0), "linear", 0.1, 50.0),
            "oscillates; give its force as a table",
        ),
    ],
)
def test_other_inputs_are_refused(wood, stroke, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        wood.with_action(stroke)


def test_faults_of_a_file(wood):
    raw = wood.raw
    raw["action"] = {"force": {"time": [0.0, 0.0], "value": [1.0, 2.0]}}
    with pytest.raises(feltmb.InvalidParameter, match=r"action\.force"):
        actuator.Actuator(raw)
