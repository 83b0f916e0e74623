"""Felts from the loops of contacts: round trip, the packaged ones, and what the audit says."""

import importlib.util
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from feltmb import load_action
from feltmb.cli import main
from feltmb.felt import (
    CircleOnLayer,
    ConstantArea,
    audit,
    contact_loop,
    fit_contact,
    load_material,
)
from unmodeled.errors import InvalidParameter

ROOT = Path(__file__).resolve().parents[3]
FELT_ACTION = load_action("steinway45_felt")
PRINTED = load_action("steinway45")
CONTACTS = [key for key in FELT_ACTION.config.contacts if key not in ("02", "16")]


def loop_of(felt, thickness, area, points=60):
    end = thickness * (1 - felt.v_f0 / felt.end)
    e = end * np.linspace(0, 1, points + 1)[1:]
    v = felt.v_f0 / (1 - e / thickness)
    size = area.area(e)
    return e, size * felt.pressure("loading", v), size * felt.pressure("unloading", v)


@pytest.mark.parametrize("given", [False, True], ids=["thickness fitted", "thickness given"])
def test_round_trip(given):
    """The felt that made a loop is found again, from its fibers alone."""
    truth = load_material("synthetic_soft_red")
    assert truth.loading is not None
    area, thickness = CircleOnLayer(8e-3, 9e-3), 4e-3
    e, load, back = loop_of(truth, thickness, area)
    v_half = truth.v_f0 / (1 - e[np.searchsorted(load, 0.5 * load[-1])] / thickness)
    row = truth.branch("loading", [v_half])
    found = fit_contact(
        e, load, back, area, fibers=truth,
        thickness=thickness if given else None,
        gamma=truth.loading.gamma,
        friction_share=float(row.friction[0] / row.pressure[0]),
    )  # fmt: skip
    assert found.thickness == pytest.approx(thickness, rel=2e-3)
    assert found.rms_loading < 1e-4
    assert found.rms_unloading < 1e-3
    for which in ("loading", "unloading"):
        made, meant = getattr(found.material, which), getattr(truth, which)
        assert made.gamma == pytest.approx(meant.gamma, rel=0.01)
        assert made.K_p == pytest.approx(meant.K_p, rel=0.02)
    assert found.material.fiber.withdrawal_force == pytest.approx(0.8, rel=0.02)
    assert not found.warnings


@pytest.mark.parametrize("key", CONTACTS)
def test_packaged_felts_carry_the_printed_loops(key):
    """The contact as the integrator has it, against the curves of Table A.12."""
    layer = FELT_ACTION.config.contacts[key].micromechanical
    assert layer is not None
    contact = PRINTED.config.contacts[key]
    e, load, back = contact_loop(contact, name=key)
    made = layer.envelope
    assert made.closing == pytest.approx(e[-1], rel=1e-5)
    for curve, force in (
        (load, made.loading(e)),
        (back, made.unloading(e, made.closing)),
    ):
        assert math.sqrt(np.mean((np.asarray(force) - curve) ** 2)) < 0.025 * load.max()
    # Energy lost in the loop, as the printed curves have it.
    lost = np.trapezoid(load - back, e)
    assert float(made.loop_area(made.closing)) == pytest.approx(lost, rel=0.1)


def test_packaged_files_are_what_the_tool_writes():
    spec = importlib.util.spec_from_file_location(
        "make_contact_felts", ROOT / "tools" / "make_contact_felts.py"
    )
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    params = ROOT / "python" / "feltmb" / "params"
    # The fit is an optimization: another machine may differ in the last digits.
    import tomllib

    def close(a, b):
        if isinstance(a, dict):
            return a.keys() == b.keys() and all(close(a[k], b[k]) for k in a)
        if isinstance(a, (int, float)):
            return math.isclose(a, b, rel_tol=1e-3)
        return a == b

    for name, text in tool.make().items():
        stored = tomllib.loads((params / name).read_text(encoding="utf-8"))
        assert close(tomllib.loads(text), stored), name


def test_bench_model_is_what_the_tool_writes():
    spec = importlib.util.spec_from_file_location(
        "make_bench_model", ROOT / "tools" / "make_bench_model.py"
    )
    assert spec is not None
    assert spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    assert (ROOT / "bench" / "speed" / "steinway45.hpp").read_text(encoding="utf-8") == tool.text()


def test_faults_are_told_at_once():
    e = np.linspace(0, 1e-3, 20)
    with pytest.raises(InvalidParameter, match=r"(?s)must be finite, > 0 and grow.*thickness = -1"):
        fit_contact(
            e, e, e, ConstantArea(1e-4), fibers=load_material("synthetic_hammer"), thickness=-1
        )
    with pytest.raises(InvalidParameter, match=r"thickness = 0.001 m, must be > 0.001"):
        fit_contact(
            e[1:], e[1:], e[1:], ConstantArea(1e-4),
            fibers=load_material("synthetic_hammer"), thickness=1e-3,
        )  # fmt: skip
    with pytest.raises(InvalidParameter, match="has no loading and unloading curves"):
        contact_loop(load_material("synthetic_hammer"), name="x")


def run(*words):
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    return stop.value.code


def test_command(tmp_path, capsys):
    target = tmp_path / "button.toml"
    command = ["felt", "fit", "steinway45:05", "--area", "circle_on_layer:4mm,8mm"]
    assert run(*command, "--fibers", "synthetic_soft_red", "-o", target) == 0
    assert "1.87" in capsys.readouterr().out
    packaged = load_material("a12_05")
    assert load_material(target).loading.K_p == pytest.approx(packaged.loading.K_p, rel=1e-3)
    assert run(*command, "--fibers", "wool") == 2
    assert "felt 'wool' is unknown" in capsys.readouterr().err


def test_audit_of_a_micromechanical_contact():
    found = audit(FELT_ACTION.config.contacts["06"], name="hammer")
    assert found.law_is_sound
    assert found.closing == pytest.approx(0.781e-3, rel=2e-3)
    losses = [c.loss for c in found.cycles if c.amplitude == pytest.approx(found.closing)]
    # Rate independent: the same at 0.03 and at 300 Hz.
    assert max(losses) - min(losses) < 1e-6
    assert 0.2 < found.cycles[-1].first_loss < 0.35


@pytest.mark.parametrize(("key", "share"), [("05", 0.0109), ("06", 0.0012), ("09", None)])
def test_audit_tells_where_the_share_of_unloading_falls(key, share):
    contact = PRINTED.config.contacts[key].model_copy(update={"law": "felt_memory"})
    shapes = [f for f in audit(contact, name=key).findings if f.kind == "shape"]
    if share is None:
        assert shapes == []
        return
    (finding,) = shapes
    top = float(contact_loop(contact, name=key)[1][-1])
    assert finding.value / top == pytest.approx(share, rel=0.1)
    assert 0 <= finding.low < finding.high < 1e-3


def test_a_law_is_drawn_through_its_points_whatever_thickness_it_estimates():
    """Only the first law was drawn at the volume fractions of its own thickness."""
    from feltmb.fiber.plot import plot_fits

    made = []
    for thickness0 in (5e-3, 6e-3):
        v = np.linspace(0.25, 0.4, 9)
        one = SimpleNamespace(
            model=f"law {thickness0}",
            branch="loading",
            name="test",
            values={"v_f0": 0.2, "thickness0": thickness0},
            v_f=v * thickness0 / 5e-3,
            pressure=1e5 * v,
            residuals=0.0 * v,
        )
        slope = 1e5 * 5e-3 / thickness0
        one.law = lambda slope=slope: SimpleNamespace(v_f0=0.2, pressure=lambda x: slope * x)
        made.append(one)
    top = plot_fits(made).axes[0]
    data, *laws = top.get_lines()
    assert len(laws) == 2
    x, y = map(np.asarray, data.get_data())
    for line in laws:
        at = np.argsort(line.get_xdata())
        drawn = np.interp(x, line.get_xdata()[at], line.get_ydata()[at])
        np.testing.assert_allclose(drawn, y, rtol=1e-3)
    assert plot_fits(made).axes[1].get_xlabel() == "thickness [mm]"
