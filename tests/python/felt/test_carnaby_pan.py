"""Friction of a fiber mass from Python: identities of the errata, both drives, both forms."""

import numpy as np
import pytest
from scipy.integrate import quad

from feltmb.fiber import carnaby_pan, carnaby_pan_march, critical_angle, mean_free_length, structure
from unmodeled.errors import InvalidParameter

MASS = {
    "mu": 0.35,
    "Wf0": 0.8,
    "E": 2.5e9,
    "d_f": 25e-6,
    "v_f0": 0.132,
    "gamma": 1.3,
    "k_bend": 0.64,
}
V = np.linspace(0.132, 0.33, 101)


def free_length(v):
    return np.array(
        [mean_free_length("binomial", x, MASS["d_f"], gamma=MASS["gamma"], Q=2.0) for x in v]
    )


@pytest.fixture(scope="module")
def loop():
    return carnaby_pan(V, **MASS)


def test_contact_force_follows_from_bending(loop):
    inertia = np.pi * MASS["d_f"] ** 4 / 64

    def rate(v):
        s = structure(v / MASS["v_f0"])
        return MASS["k_bend"] * MASS["E"] * inertia * s.K3 / (s.M3 * free_length([v])[0] ** 2 * v)

    for i in (10, 50, 100):
        expected = quad(rate, MASS["v_f0"], V[i], epsabs=0, epsrel=1e-10)[0]
        assert loop.C[i] == pytest.approx(expected, rel=1e-8)


def test_angle_proportion_and_forces_by_quadrature(loop):
    for i in (20, 60, 100):
        w = MASS["Wf0"] * free_length(V[i : i + 1])[0] / loop.C[i]
        ratio = V[i] / MASS["v_f0"]
        density = structure(ratio).density
        theta = loop.theta_cr[i]
        assert np.cos(theta) == pytest.approx(MASS["mu"] * np.sin(theta) + w, rel=1e-12)
        assert theta == pytest.approx(float(critical_angle(w, MASS["mu"])), rel=1e-12)

        def caps(f, density=density, theta=theta):
            # pi in azimuth, twice for both caps of the half sphere
            def integrand(t):
                return 2 * np.pi * float(density(np.cos(t))) * np.sin(t) * f(t)

            return quad(integrand, 0, theta, epsrel=1e-11)[0]

        r = caps(np.ones_like)
        assert loop.r_sc[i] == pytest.approx(r, rel=1e-8)
        unit = MASS["Wf0"] * free_length(V[i : i + 1])[0]
        up = unit * caps(lambda t: 1 / (np.cos(t) - MASS["mu"] * np.sin(t))) / r
        down = unit * caps(lambda t: 1 / np.cos(t)) / r
        assert loop.C_s_loading[i] == pytest.approx(up, rel=1e-8)
        assert loop.C_s_unloading[i] == pytest.approx(down, rel=1e-8)
        assert unit <= down <= up <= loop.C[i]


def test_total_form_of_the_pressures(loop):
    n = 2 * V / (np.pi * MASS["d_f"] ** 2) / (1 + V / MASS["v_f0"])
    np.testing.assert_allclose(loop.sigma_el, (1 - loop.r_sc) * n * loop.C, rtol=1e-12)
    slide = loop.r_sc * n
    np.testing.assert_allclose(loop.P_loading, loop.sigma_el + slide * loop.C_s_loading, rtol=1e-12)
    np.testing.assert_allclose(
        loop.P_unloading, loop.sigma_el - slide * loop.C_s_unloading, rtol=1e-12
    )
    assert np.all(np.diff(loop.P_loading) > 0)
    assert np.all(np.diff(loop.P_unloading) > 0)  # mu above 0.30
    assert 0.1 < loop.loss < 0.4


def test_isotropy_identity_at_the_start():
    # At R = 1: (1 - r) C = Wf0 lambda + mu C sin(theta_cr).
    v0 = 0.2
    c = np.geomspace(2e-4, 0.1, 7)
    made = [carnaby_pan_march([x], 0.35, 0.8, 1e30, 25e-6, v0, 1.3, 24.0) for x in c]
    unit = 0.8 * mean_free_length("binomial", v0, 25e-6, gamma=1.3, Q=2.0)
    for x, m in zip(c, made, strict=True):
        assert m.v_f[0] == pytest.approx(v0, rel=1e-9)  # so stiff that nothing moves
        right = unit + 0.35 * x * np.sin(m.theta_cr[0])
        assert (1 - m.r_sc[0]) * x == pytest.approx(right, rel=1e-7)


@pytest.mark.parametrize("form", ["repaired", "printed"])
def test_load_driven_march_agrees(form):
    a = carnaby_pan(V, **MASS, form=form)
    b = carnaby_pan_march(a.C, **MASS, form=form, substeps=16)
    np.testing.assert_allclose(b.v_f, V, rtol=1e-7)
    np.testing.assert_allclose(b.P_loading, a.P_loading, rtol=1e-5)
    np.testing.assert_allclose(b.P_unloading, a.P_unloading, rtol=1e-5, atol=1e-3)


def test_march_is_of_fourth_order():
    c = carnaby_pan(V[[0, 40, 100]], **MASS).C
    error = [abs(carnaby_pan_march(c, **MASS, substeps=n).v_f[-1] / V[-1] - 1) for n in (8, 16, 32)]
    assert np.log2(error[0] / error[1]) > 3.5
    assert np.log2(error[1] / error[2]) > 3.5


def test_printed_form_makes_energy_and_starves_friction(loop):
    printed = carnaby_pan(V, **MASS, form="printed")
    assert printed.loss < 0 < loop.loss
    np.testing.assert_allclose(printed.r_sc, 0.5 * loop.r_sc, rtol=1e-12)
    # One cap and no average: the friction stress is several times too small.
    slides = loop.r_sc > 0.2
    whole = (loop.r_sc * loop.C_s_loading)[slides]
    ratio = whole / (printed.r_sc * printed.C_s_loading)[slides]
    assert 8 < ratio.min() < ratio.max() < 21
    # P is continuous at the reversal there, and jumps in the total form.
    assert printed.P_unloading[-1] == printed.P_loading[-1]
    assert loop.P_unloading[-1] < 0.95 * loop.P_loading[-1]


def test_no_friction_without_withdrawal_force(loop):
    weak = carnaby_pan(V, **{**MASS, "Wf0": 1e-9})
    assert weak.loss < 1e-6
    strong = carnaby_pan(V, **{**MASS, "Wf0": 1e6})
    assert strong.loss == 0.0
    assert strong.r_sc.max() == 0.0
    assert loop.loss > 0.1


def test_all_faults_are_named():
    with pytest.raises(InvalidParameter, match=r"(?s)mu = -1.*Wf0 = 0 N/m.*gamma = -1"):
        carnaby_pan(V, **{**MASS, "mu": -1, "Wf0": 0, "gamma": -1})
    with pytest.raises(InvalidParameter, match="form"):
        carnaby_pan(V, **MASS, form="other")
    with pytest.raises(InvalidParameter, match=r"v_f\[1\] = 0.14 after 0.2, must grow"):
        carnaby_pan([0.2, 0.14], **MASS)
    with pytest.raises(InvalidParameter, match=r"leads to v_f"):
        carnaby_pan_march([10.0], **MASS)
