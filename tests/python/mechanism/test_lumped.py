"""Networks of lumped masses: descriptions, faults, agreement with an independent integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from blind import build
from blind.lumped import Network
from unmodeled.errors import Error, InvalidParameter

DESCRIPTION = {
    "masses": {"x": "m"},
    "elements": [
        {
            "name": "felt",
            "kind": "contact",
            "coordinates": {"x": 1.0},
            "offset": ["-gap", -1e-4],
            "stiffness": 1e5,
            "exponent": 1.7,
            "loss": 0.4,
            "gates": [{"coordinates": {"x": -1.0}, "offset": 4e-3, "width": 5e-4}],
        },
        {
            "name": "hinge",
            "kind": "friction",
            "coordinates": {"x": 1.0},
            "viscous": 0.2,
            "quadratic": 0.3,
        },
        {"name": "finger", "kind": "drive", "coordinates": {"x": 1.0}, "input": 1.0},
    ],
    "hidden": {
        "bend": {"kind": "mode", "sources": ["felt"], "gain": 1e-6, "omega": 300.0, "damping": 0.1}
    },
    "sensors": {
        "x": {"coordinates": {"x": 1.0}, "hidden": {"bend": -1.0}, "scale": 0.02},
    },
}


def test_network_agrees_with_another_integrator():
    network = Network(DESCRIPTION, ("m", "gap"), sample_time=5e-4, substeps=8)
    n = 120
    u = np.full(n, 1.5)
    y, ends, _, _, forces = network.simulate(
        np.array([[0.05, 1e-3]]),
        [u],
        np.array([[0, 0, n - 1, 0]], dtype=np.intc),
        np.zeros((1, 4)),
        forces=True,
    )

    def felt(x, v):
        d = x - 1e-3 - 1e-4
        gate = 1.0 / (1.0 + np.exp(-(4e-3 - x) / 5e-4))
        return 1e5 * max(d, 0.0) ** 1.7 * max(1.0 + 0.4 * v, 0.0) * gate

    def rates(_, s):
        x, v, b, c = s
        f = felt(x, v)
        a = (1.5 - f - 0.2 * v - 0.3 * v * abs(v)) / 0.05
        return [v, a, c, 300.0**2 * (1e-6 * f - b) - 2 * 0.1 * 300.0 * c]

    t = np.arange(n) * 5e-4
    ref = solve_ivp(rates, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-10, atol=1e-14).y
    assert np.max(np.abs(y[:, 0] - 1.02 * (ref[0] - ref[2]))) < 2e-7
    assert ends[0] == pytest.approx(ref[:, -1], rel=1e-3, abs=1e-6)
    assert forces[:, 0] == pytest.approx(
        [felt(x, v) for x, v in zip(ref[0], ref[1], strict=True)], abs=2e-2
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"masses": {"x": "weight"}}, "no parameter 'weight'"),
        (
            {"sensors": {"x": {"coordinates": {"z": 1.0}}}},
            "no coordinate 'z'",
        ),
        ({"elements": [{"name": "a", "kind": "rope", "coordinates": {"x": 1.0}}]}, "kind 'rope'"),
        (
            {
                "elements": [
                    {"name": "a", "kind": "friction", "coordinates": {"x": 1.0}, "coulomb": "m"}
                ],
                "sensors": {"x": {"coordinates": {"x": 1.0}}},
            },
            "sliding_speed",
        ),
    ],
)
def test_bad_description_is_told(change, message):
    with pytest.raises(InvalidParameter, match=message):
        Network({**DESCRIPTION, "hidden": {}, **change}, ("m", "gap"), sample_time=1e-3)


def test_network_is_built_only_when_it_is_out_of_date(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")  # no CMake: whoever builds fails
    build.build_network()
    monkeypatch.setattr(build, "BUILD", tmp_path)
    monkeypatch.setattr(build, "LIBRARY", tmp_path / "none.so")
    with pytest.raises(Error, match="needs cmake, which is not installed"):
        build.build_network()
