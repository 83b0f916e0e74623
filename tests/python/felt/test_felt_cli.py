"""Command group ``feltmb felt``."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli.felt import command, felt
from feltmb.felt import load_envelope, load_material
from unmodeled.errors import FileExists, InvalidParameter


def run(*args):
    result = CliRunner().invoke(command, [str(a) for a in args])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def write_test(path, felt_name="synthetic_soft_red"):
    m = load_material(felt_name)
    rng = np.random.default_rng(3)
    v = np.linspace(m.v_f0, m.end, 80)[1:]
    rows = ["# a made test", "strain [%],pressure [kPa],branch"]
    for which, order in (("loading", v), ("unloading", v[::-1])):
        p = m.pressure(which, order) + 2e3 * rng.standard_normal(len(v))
        rows += [
            f"{100 * (1 - m.v_f0 / x):.6f},{y / 1e3:.6f},{which}"
            for x, y in zip(order, p, strict=True)
        ]
    path.write_text("\n".join(rows), encoding="utf-8")


def test_command_is_the_group():
    assert command is felt


def test_from_a_test_to_an_audited_contact(tmp_path):
    write_test(tmp_path / "TEST.csv")
    found = tmp_path / "my_felt.toml"
    out = run(
        "identify", tmp_path / "TEST.csv", "--material", "synthetic_soft_red",
        "-o", found, "--plot", tmp_path / "report",
    )  # fmt: skip
    assert "K_p [Pa]" in out
    truth, m = load_material("synthetic_soft_red"), load_material(found)
    assert m.loading.gamma == pytest.approx(truth.loading.gamma, rel=0.05)
    assert "95 % interval" in (tmp_path / "report" / "report.md").read_text(encoding="utf-8")
    assert (tmp_path / "report" / "identification.png").stat().st_size > 10000
    with pytest.raises(FileExists, match="exists already"):
        run("identify", tmp_path / "TEST.csv", "--material", "synthetic_soft_red", "-o", found)

    table = tmp_path / "envelope.toml"
    run(
        "envelope", found, "--thickness", "6mm", "--area", "constant:100mm^2",
        "-o", table, "--plot", tmp_path / "envelope.png",
    )  # fmt: skip
    assert load_envelope(table).closing == pytest.approx(6e-3 * (1 - m.v_f0 / m.end))
    assert "no faults" in run("audit", table)


def test_identify_json(tmp_path):
    write_test(tmp_path / "TEST.csv")
    out = json.loads(
        run("identify", tmp_path / "TEST.csv", "--material", "synthetic_soft_red", "--json")
    )
    low, high = out["loading"]["interval"]["gamma"]
    assert low < out["loading"]["gamma"] < high


def test_faults_of_a_csv_come_together(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("v_f [-],pressure [kPa]\n0.2,1\nx,2\n0.3,1e999\n", encoding="utf-8")
    with pytest.raises(InvalidParameter, match=r"(?s)line 3: v_f = 'x'.*line 4: pressure = inf"):
        run("identify", path, "--material", "synthetic_soft_red")


def test_envelope_as_a_mechanism(tmp_path):
    out = tmp_path / "act.toml"
    args = ["envelope", "synthetic_hammer", "--thickness", "6mm", "--area"]
    run(*args, "crossed_cylinders:9mm,0.5mm", "--contact", "06", "-o", out)
    assert "no faults" in run("audit", f"{out}:06")
    with pytest.raises(InvalidParameter, match="--contact: got '77'"):
        run(*args, "constant:1mm^2", "--contact", "77")


def test_audit(tmp_path):
    out = run("audit", "steinway45:04", "--plot", tmp_path)
    assert "crossing" in out
    assert (tmp_path / "audit_steinway45_04.png").stat().st_size > 10000
    out = run("audit", "steinway45", "--all", "--set", "contacts.*.law=printed")
    assert out.count("unsound") == 7
    first = json.loads(run("audit", "steinway45:13", "--json"))[0]
    assert first["findings"][0]["value"] == pytest.approx(6.83e-6, rel=1e-2)
