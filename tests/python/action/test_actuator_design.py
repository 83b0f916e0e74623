"""Match of a target force, the commands."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb.action.actuator import load_actuator, match, simulate_actuator
from feltmb.cli import cli
from unmodeled.errors import InvalidParameter


def target_of(actuator, torque, end, noise=0.0):
    run = simulate_actuator(actuator, torque, end)
    force = run["finger.force"] + noise * np.random.default_rng(1).standard_normal(run.time.size)
    return feltmb.table_stroke(run.time, force, interpolation="linear")


def check_recovery(found, truth, noise):
    """All of the truth within three times the half widths of the intervals; rms at the noise."""
    assert found.rms < 1.3 * noise / np.sqrt(10.0) + 0.01
    for parameter, value in zip(found.parameters, truth, strict=True):
        half = 0.5 * (parameter.high - parameter.low)
        assert abs(parameter.value - value) < 3.0 * half + 0.01, parameter
        assert not parameter.at_bound


@pytest.mark.slow
def test_torque_and_stiffness_are_recovered():
    """Before the stop is met: 28 ms, three knots; the wooden arm shows its stiffness there."""
    made = load_actuator("wood").with_values({"arm.young_modulus": 16e9, "arm.elements": 3})
    torque = feltmb.torque_stroke([0.0, 0.014, 0.028], [0.1, 0.9, 1.2], interpolation="monotone")
    target = target_of(made, torque, 0.028, noise=0.02)
    start = load_actuator("wood").with_values({"arm.elements": 3})
    found = match(start, target, fit=("stiffness", "torque"), knots=3)
    check_recovery(found, [1.6, 0.1, 0.9, 1.2], 0.02)
    assert found.relative < 0.01 < found.rms_start
    assert found.actuator.config.arm.young_modulus == pytest.approx(16e9, rel=0.05)
    # What is designed simulates as it was fitted, from its own file.
    again = feltmb.actuator.Actuator(found.actuator.raw)
    run = simulate_actuator(again, duration=0.028)
    assert np.mean(run["finger.force"][200:210]) == pytest.approx(found.force[20], abs=0.05)


@pytest.mark.slow
def test_all_parameters_are_recovered_through_the_strike():
    made = load_actuator("wood").with_values({"arm.young_modulus": 16e9})
    made = made.with_damper("one-sided", 0.03)
    knots = np.linspace(0.0, 0.12, 8)
    values = [0.0, 0.6, 1.5, 2.2, 2.8, 3.0, 2.6, 2.4]
    torque = feltmb.torque_stroke(knots, values, interpolation="monotone")
    target = target_of(made, torque, 0.12, noise=0.05)
    found = match(load_actuator("wood").with_damper("one-sided"), target)
    check_recovery(found, [1.6, 0.03, *values], 0.05)


def test_what_cannot_be_matched():
    force = feltmb.table_stroke([0.0, 0.05], [0.0, 5.0])
    with pytest.raises(InvalidParameter) as caught:
        match("wood", feltmb.torque_stroke([0.0, 0.005], [0.0, 1.0]), fit=("mass",), knots=1)
    for part in (
        "'mass' is none of",
        "is a torque, expected a force",
        "ends at 0.005 s",
        "knots = 1",
    ):
        assert part in str(caught.value)
    with pytest.raises(InvalidParameter, match="a damping needs a damper"):
        match("wood", force)


def run_cli(*arguments):
    from click.testing import CliRunner

    return CliRunner().invoke(cli, ["actuator", *map(str, arguments)])


def test_command(tmp_path):
    out = tmp_path / "run.csv"
    done = run_cli("--arm", "aluminum", "--damper", "one-sided", "--elements", 4, "--plot",
                   "--duration", 0.05, "--out", out)  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "natural frequency 1" in done.output
    assert out.exists()
    assert (tmp_path / "actuator_aluminum.png").stat().st_size > 10_000
    told = json.loads(run_cli("--json", "--duration", 0.04).stdout)
    assert told["summary"]["first_contact_time"] == pytest.approx(0.0323, abs=2e-4)
    assert told["frequencies"][0] == pytest.approx(328.7, abs=0.2)


def test_match_command(tmp_path):
    path = tmp_path / "target.csv"
    t = np.linspace(0.0, 0.02, 81)
    rows = "".join(f"{a:.5f},{400.0 * a:.4f}\n" for a in t)
    path.write_text("time [s],force [N]\n" + rows)
    design = tmp_path / "design.toml"
    done = run_cli("match", path, "--fit", "torque", "--knots", 3, "--out", design,
                   "--plot", tmp_path / "match.png")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "torque at 10 ms" in done.output
    assert load_actuator(design).config.torque.interpolation == "monotone"
    assert (tmp_path / "match.png").exists()


def test_stroke_command_with_an_actuator(tmp_path):
    from click.testing import CliRunner

    torque = tmp_path / "ramp.csv"
    torque.write_text("time [ms],torque [N m]\n0,0\n60,3\n100,3\n")
    runner = CliRunner()
    done = runner.invoke(
        cli,
        ["stroke", "steinway45", "--actuator", "aluminum", "--torque", str(torque), "--json"],
    )
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)["ramp"]["summary"]
    # The whole action, no equivalent mass: the thesis's first contact, 0.032 s, by itself.
    assert summary["key_landing_time"] == pytest.approx(0.032, abs=1e-3)
    none = runner.invoke(cli, ["stroke", "steinway45", "--torque", str(torque)])
    assert none.exit_code == 2
    assert "need --actuator" in none.output


def test_a_name_does_not_lead_out_of_the_folder(tmp_path, monkeypatch):
    inner = tmp_path / "inner"
    inner.mkdir()
    monkeypatch.chdir(inner)
    arguments = ["actuator", "--set", "name=../../evil/x", "--duration", "0.01", "--plot"]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    assert [f.name for f in tmp_path.rglob("*.png")] == ["actuator_.._.._evil_x.png"]
    assert [f.name for f in inner.iterdir()] == ["actuator_.._.._evil_x.png"]


def test_match_refuses_a_force_for_a_torque():
    target = target_of(load_actuator("wood"), feltmb.torque_stroke([0, 0.04], [0, 0.4]), 0.03)
    force = feltmb.table_stroke([0, 0.04], [0, 5.0])
    with pytest.raises(InvalidParameter, match=r"is a force, not a torque; max_evaluations = 0"):
        match("wood", target, fit=("torque",), start_torque=force, max_evaluations=0)
