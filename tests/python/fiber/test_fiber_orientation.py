"""Structural numbers: closed values, two independent methods, Monte Carlo within its error."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from feltmb.fiber import density_structure, narter_tensors, network, structure, uniaxial_tensor
from unmodeled.errors import InvalidParameter


def density(ratio, c):
    """Psi of the full sphere, written down again for the tests."""
    return ratio / (4 * math.pi * (1 - c**2 + ratio**2 * c**2) ** 1.5)


def brute_force(ratio, n_polar=160, n_azimuth=128):
    """Double average by a tensor rule in the affine variable; nothing shared with the core."""
    x, w = np.polynomial.legendre.leggauss(n_polar)
    g, w = 0.5 * (x + 1), 0.5 * w
    c = g / np.sqrt(ratio**2 * (1 - g**2) + g**2)
    s = np.sqrt(1 - c**2)
    phi = (np.arange(n_azimuth) + 0.5) * 2 * math.pi / n_azimuth
    f = n = e = 0.0
    for sign in (1, -1):
        for p in phi:
            dot = np.outer(c, sign * c) + np.outer(s, s) * math.cos(p)
            sine = np.sqrt(np.maximum(1 - dot**2, 0))
            n3 = np.outer(s, s) * math.sin(p) / np.maximum(sine, 1e-300)
            weight = np.outer(w, w) / (2 * n_azimuth)
            f += np.sum(weight * sine)
            n += np.sum(weight * sine * n3**4)
            e += np.sum(weight * sine * (c**4)[:, None])
    return f, n / f, e / f


def test_isotropic_values():
    s = structure(1)
    assert s.f == pytest.approx(math.pi / 4, abs=1e-12)
    assert s.n3 == pytest.approx(0.2, abs=1e-12)
    assert s.e3 == pytest.approx(0.2, abs=1e-12)
    assert pytest.approx(0.5, abs=1e-14) == s.K3
    assert pytest.approx(2 / 3, abs=1e-13) == s.M3
    assert s.cos4 == pytest.approx(0.2, abs=1e-13)
    assert s.obstruction() == pytest.approx(math.pi**2 / 8, abs=1e-11)


def test_planar_limit():
    s = structure(1e6)
    assert s.f == pytest.approx(2 / math.pi, abs=1e-9)
    assert s.n3 == pytest.approx(1, abs=1e-6)
    assert s.e3 < 1e-11
    assert pytest.approx(1, abs=1e-8) == s.M3


@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.5, 3.0, 8.0])
def test_contact_averages_against_brute_force(ratio):
    s = structure(ratio)
    f, n3, e3 = brute_force(ratio)
    # The tensor rule has a cusp at e = e': third order, about 1e-5.
    assert s.f == pytest.approx(f, abs=3e-5)
    assert s.n3 == pytest.approx(n3, abs=3e-4)
    assert s.e3 == pytest.approx(e3, abs=3e-5)


@pytest.mark.parametrize("ratio", [0.4, 1.0, 1.02, 2.0, 5.0])
def test_great_circle_rule_agrees_to_1e_9(ratio):
    exact = structure(ratio)
    s = density_structure(deformation=np.diag([1, 1, 1 / ratio]), tolerance=1e-11, max_nodes=200)
    for name in ("f", "n3", "e3", "K3", "M3"):
        assert getattr(s, name) == pytest.approx(getattr(exact, name), abs=1e-9)


@pytest.mark.parametrize("ratio", [0.2, 0.999, 1.001, 1.5, 7.0, 100.0])
def test_fiber_averages_against_quadrature(ratio):
    s = structure(ratio)

    def mean(q):
        edge = [1 / ratio] if ratio > 2 else None
        return integrate.quad(
            lambda c: 4 * math.pi * density(ratio, c) * q(c),
            0,
            1,
            points=edge,
            epsabs=1e-13,
            epsrel=1e-12,
            limit=400,
        )[0]

    assert mean(lambda _: 1.0) == pytest.approx(1, abs=1e-11)
    assert mean(abs) == pytest.approx(s.K3, abs=1e-11)
    assert mean(lambda c: 1 - c**2) == pytest.approx(s.M3, abs=1e-11)
    assert mean(lambda c: c**4) == pytest.approx(s.cos4, abs=1e-11)
    assert mean(lambda c: math.sqrt(1 - c**2)) == pytest.approx(s.sine, abs=1e-10)
    assert s.density(0.3) == pytest.approx(2 * density(ratio, 0.3), rel=1e-13)


@pytest.mark.parametrize(("ratio", "theta"), [(1.0, 0.7), (2.0, 1.2), (6.0, 1.5), (0.4, 0.2)])
def test_mean_sine_and_inverse_sine(ratio, theta):
    s = structure(ratio)

    # Polar coordinates around the fiber itself: sin(kappa) dkappa dchi has no singularity left.
    def inner(power):
        def q(chi, kappa):
            c = math.cos(kappa) * math.cos(theta) + math.sin(kappa) * math.sin(theta) * math.cos(
                chi
            )
            return density(ratio, c) * math.sin(kappa) ** (1 + power)

        return integrate.dblquad(q, 0, math.pi, 0, 2 * math.pi, epsabs=1e-9, epsrel=1e-9)[0]

    c = math.cos(theta)
    assert float(s.mean_sine(c)) == pytest.approx(inner(1), abs=1e-7)
    assert float(s.mean_inverse_sine(c)) == pytest.approx(inner(-1), abs=1e-7)


@pytest.mark.parametrize("ratio", [1.0, 3.0, 30.0])
def test_f_is_mean_of_mean_sine_and_obstruction(ratio):
    s = structure(ratio)
    x, w = np.polynomial.legendre.leggauss(200)
    g = 0.5 * (x + 1)
    # Quadratic grading at g = 1, where the cosine changes quickly.
    y, w = 1 - (1 - g) ** 3, 0.5 * w * 3 * (1 - g) ** 2
    c = y / np.sqrt(ratio**2 * (1 - y**2) + y**2)
    j, t = s.mean_sine(c), s.mean_inverse_sine(c)
    assert np.sum(w * j) == pytest.approx(s.f, abs=1e-8)
    assert np.sum(w * j * t) == pytest.approx(s.obstruction(), abs=1e-7)


def test_mean_inverse_sine_of_errata():
    for ratio, value in ((1, 1.5708), (5, 2.1041), (20, 2.9220)):
        s = structure(ratio)
        x, w = np.polynomial.legendre.leggauss(400)
        g = 0.5 * (x + 1)
        y, w = 1 - (1 - g) ** 3, 0.5 * w * 3 * (1 - g) ** 2
        c = y / np.sqrt(ratio**2 * (1 - y**2) + y**2)
        assert np.sum(w * s.mean_inverse_sine(c)) == pytest.approx(value, abs=6e-5)


@given(st.floats(1e-3, 1e6))
def test_structure_is_physical(ratio):
    s = structure(ratio)
    assert 0 < s.f <= math.pi / 4 + 1e-12
    assert 0 < s.n3 < 1
    assert 0 < s.e3 < 1
    assert pytest.approx(1 / (1 + ratio), rel=1e-13) == s.K3
    # Cauchy-Schwarz on the fiber moments.
    assert s.cos4 >= (1 - s.M3) ** 2 * (1 - 1e-9)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), 1e9])
def test_bad_ratio(bad):
    with pytest.raises(InvalidParameter, match="ratio"):
        structure(bad)


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_monte_carlo_within_its_error(ratio):
    exact = structure(ratio)
    for seed in range(3):
        s = network(4000, seed, spread=0).deform(ratio).structure()
        for name, error in s.error.items():
            assert abs(getattr(s, name) - getattr(exact, name)) < 4 * error


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 2.0, 10.0])
def test_monte_carlo_error_is_right(ratio):
    """Scores of many independent networks have unit variance: the error is neither too small nor
    too large."""
    exact = structure(ratio)
    scores = []
    for seed in range(150):
        s = network(3000, 1000 + seed, spread=0).deform(ratio).structure()
        scores.append([(getattr(s, k) - getattr(exact, k)) / s.error[k] for k in s.error])
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    # Isotropic f has no first-order term; its error is a little too large.
    assert np.all(rms > 0.65)
    # Few steep fibers carry e3 at R = 10: its error is a little too small.
    assert np.all(rms < 1.35)


def test_spreading_makes_the_network_more_isotropic():
    def anisotropy(n):
        return np.linalg.norm(n.tensors().ee - np.eye(3) / 3)

    rough = np.mean([anisotropy(network(800, s, 0)) for s in range(6)])
    even = np.mean([anisotropy(network(800, s, 40)) for s in range(6)])
    assert even < 0.4 * rough


def test_network_is_reproducible_and_independent_of_threads():
    a, b = network(500, 7, 5, threads=1), network(500, 7, 5, threads=3)
    assert np.array_equal(a.directions, b.directions)
    assert a.structure(1) == b.structure(3)
    assert not np.array_equal(a.directions, network(500, 8, 5).directions)
    assert not a.directions.flags.writeable
    assert np.allclose(np.linalg.norm(a.directions, axis=1), 1, atol=1e-14)


def test_general_deformation_composes():
    rng = np.random.default_rng(3)
    first = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    second = np.eye(3) + 0.2 * rng.normal(size=(3, 3))
    assert np.linalg.det(first) > 0  # the draw of this seed keeps orientation
    assert np.linalg.det(second) > 0
    n = network(100, 1, 0)
    twice = n.deform(first).deform(second)
    assert np.allclose(twice.directions, n.deform(second @ first).directions, atol=1e-12)
    assert np.allclose(twice.deformation, second @ first)


def test_general_density_tensors_against_samples():
    """Triaxial affine density: quadrature tensors against pair sums over random fibers."""
    deformation = np.array([[1.0, 0.4, 0.0], [0.0, 0.8, 0.1], [0.0, 0.0, 0.5]])
    exact = density_structure(deformation=deformation, tolerance=1e-9, max_nodes=160)
    sampled = network(6000, 5, 0).deform(deformation).tensors()
    assert sampled.f == pytest.approx(exact.f, abs=0.004)
    for name in ("eeee", "nnnn_contact", "eeee_contact", "tttt_contact"):
        assert np.max(np.abs(getattr(sampled, name) - getattr(exact, name))) < 0.03
    for name in ("eeee", "nnnn_contact", "eeee_contact", "tttt_contact"):
        t = getattr(exact, name)
        assert np.einsum("iijj", t) == pytest.approx(1, abs=1e-9)
        assert np.allclose(t, np.transpose(t, (1, 0, 2, 3)))
        assert np.allclose(t, np.transpose(t, (2, 1, 0, 3)))


def test_density_function_and_its_errors():
    exact = structure(2.0)
    s = density_structure(
        lambda theta, phi: density(2.0, np.cos(theta)) + 0 * phi, obstruction=True, tolerance=1e-8
    )
    assert s.f == pytest.approx(exact.f, abs=1e-9)
    assert s.obstruction == pytest.approx(exact.obstruction(), abs=1e-7)
    with pytest.raises(InvalidParameter, match="must be finite and >= 0"):
        density_structure(lambda theta, phi: np.cos(theta) + 0 * phi)
    with pytest.raises(InvalidParameter, match="still changes"):
        density_structure(lambda theta, _: (np.abs(theta - 1.2) < 0.2) * 1.0, max_nodes=20)
    with pytest.raises(InvalidParameter, match="either density or deformation"):
        density_structure()


@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0])
def test_uniaxial_tensor(ratio):
    s = density_structure(deformation=np.diag([1, 1, 1 / ratio]), tolerance=1e-11, max_nodes=200)
    assert np.allclose(uniaxial_tensor(ratio), s.eeee, atol=1e-10)


def test_narter_isotropic_compliance():
    modulus, v = 2.5e9, 0.1
    t = narter_tensors(density_structure(deformation=np.eye(3)).eeee, modulus, v)
    k = modulus * v
    expected = np.diag([6 / k] * 3 + [15 / k] * 3)
    expected[:3, :3] += -1.5 / k * (1 - np.eye(3))
    assert np.allclose(t.compliance, expected, rtol=1e-9, atol=1e-9 / k)
    assert t.young == pytest.approx([k / 6] * 3, rel=1e-9)
    assert t.shear == pytest.approx([k / 15] * 3, rel=1e-9)
    assert t.poisson["nu12"] == pytest.approx(0.25, rel=1e-9)
    assert t.stiffness[2, 2] == pytest.approx(k / 5, rel=1e-9)  # laterally confined, eq. 3.26
    minor = np.linalg.det(np.delete(np.delete(t.stiffness, 0, 0), 0, 1))
    assert np.linalg.det(t.stiffness) / minor == pytest.approx(k / 6, rel=1e-9)  # eq. 3.25


def test_narter_stiffness_by_direct_integration():
    """Eq. 3.22 with the strain of eq. 3.16, integrated without any tensor."""
    deformation = np.diag([1.2, 0.9, 0.6])
    s = density_structure(deformation=deformation, tolerance=1e-10, max_nodes=160)
    t = narter_tensors(s.eeee, 1.0, 0.5)
    x, w = np.polynomial.legendre.leggauss(80)
    phi = (np.arange(160) + 0.5) * 2 * math.pi / 160
    c, p = np.meshgrid(x, phi, indexing="ij")
    e = np.stack([np.sqrt(1 - c**2) * np.cos(p), np.sqrt(1 - c**2) * np.sin(p), c], -1)
    before = e / np.diag(deformation)
    psi = 1 / (4 * math.pi * np.linalg.det(deformation) * np.linalg.norm(before, axis=-1) ** 3)
    weight = w[:, None] * (2 * math.pi / 160) * psi
    strain_of = [
        e[..., 0] ** 2,
        e[..., 1] ** 2,
        e[..., 2] ** 2,
        e[..., 0] * e[..., 1],
        e[..., 0] * e[..., 2],
        e[..., 1] * e[..., 2],
    ]
    direct = [[0.5 * np.sum(weight * a * b) for b in strain_of] for a in strain_of]
    assert np.allclose(t.stiffness, direct, atol=1e-9)


def test_narter_refuses_planar_fibers():
    flat = np.zeros((3, 3, 3, 3))
    flat[0, 0, 0, 0] = flat[1, 1, 1, 1] = 3 / 8
    for i, j, k, m in [
        (0, 0, 1, 1),
        (1, 1, 0, 0),
        (0, 1, 0, 1),
        (0, 1, 1, 0),
        (1, 0, 0, 1),
        (1, 0, 1, 0),
    ]:
        flat[i, j, k, m] = 1 / 8
    with pytest.raises(InvalidParameter, match="spatial orientation"):
        narter_tensors(flat, 1e9, 0.1)


def test_spreading_keeps_neighbors_apart():
    def nearest(n):
        dot = np.abs(n.directions @ n.directions.T)
        np.fill_diagonal(dot, 0)
        return np.arccos(np.clip(dot.max(axis=1), 0, 1))

    rough, even = nearest(network(800, 1, 0)), nearest(network(800, 1, 100))
    assert even.mean() > 1.5 * rough.mean()
    assert even.std() < 0.6 * rough.std()
