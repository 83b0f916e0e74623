"""The laws drive a contact in other engines: the worked examples, where those are installed."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(EXAMPLES))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(EXAMPLES))
    return module


@pytest.mark.parametrize("engine", ["exudyn", "mujoco", "pybullet"])
def test_a_blow_on_felt_has_the_numbers_of_its_energy_balance(engine):
    pytest.importorskip(engine, reason=f"{engine} is not installed: its example was not run")
    example = load(f"felt_in_{engine}")
    got = example.main()
    expected = example.first_impact(example.make_felt(), example.MASS, example.SPEED)
    for name, value in expected.items():
        assert got[name] == pytest.approx(value, rel=2e-4), name
    # Felt takes a third of the energy: no number above is that of an elastic contact.
    assert 0.4 < (got["rebound"] / example.SPEED) ** 2 < 0.8


@pytest.mark.parametrize("substeps", [1, 7])
def test_the_same_blow_with_a_plain_integrator(substeps):
    """The coupling of the examples without an engine: it runs everywhere."""
    from feltmb.contact import law

    balance = load("energy_balance")
    curves = {"loading": (5.52e3, 1.58e3, -0.60e3), "unloading": (0.19e3, 5.04e3, 3.04e3)}
    mass, speed, h = 9e-3, 2.0, 1e-6 / substeps
    felt = law("felt_memory", **curves)
    x, v, top, most = 0.0, speed, 0.0, 0.0
    while x >= 0.0:
        force = felt.step(x, h)
        v -= h * force / mass
        x += h * v
        top, most = max(top, x), max(most, force)
    exact = balance.first_impact(law("felt_memory", **curves), mass, speed)
    assert [top, most, -v] == pytest.approx(
        [exact["compression"], exact["force"], exact["rebound"]], rel=1e-4
    )
    assert np.isclose(felt.state[0], top, rtol=1e-5)
