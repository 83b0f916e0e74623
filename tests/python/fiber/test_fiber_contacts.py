"""Contact counts: closed forms, identities between models, Monte Carlo."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from feltmb.fiber import (
    contact_count,
    contacts_per_volume,
    density_structure,
    free_length_survival,
    mean_free_length,
    structure,
)
from unmodeled.errors import InvalidParameter

D = 25e-6
MODELS = ("van_wyk", "van_wyk_tube", "komori_makishima", "pan", "poisson", "binomial", "toll")


def extra(model):
    return {"gamma": 1.3} if model == "binomial" else {}


def test_isotropic_closed_forms():
    v = 0.1
    for model in ("van_wyk", "van_wyk_tube", "komori_makishima", "poisson", "toll"):
        assert mean_free_length(model, v, D) == pytest.approx(D / (2 * v), rel=1e-14)
    pan = (2 + math.pi * v) * D / (4 * v)  # eq. 3.10
    assert mean_free_length("pan", v, D) == pytest.approx(pan, rel=1e-14)
    binomial = 1.3 * D / (1 - math.exp(-2 * v * 1.3))  # eq. 3.15
    assert mean_free_length("binomial", v, D, gamma=1.3) == pytest.approx(binomial, rel=1e-14)
    count = 2 * v * (1 - math.exp(-2 * v * 1.3)) / (math.pi * D**3 * 1.3)
    assert contacts_per_volume("binomial", v, D, gamma=1.3) == pytest.approx(count, rel=1e-14)
    assert contacts_per_volume("komori_makishima", v, D) == pytest.approx(
        4 * v**2 / (math.pi * D**3), rel=1e-14
    )


def test_toll_counts_both_fibers():
    f = math.pi / 4
    printed = 4 * f * 0.1**2 / (math.pi**2 * (D / 2) ** 3)  # eq. 3.51
    assert contacts_per_volume("toll", 0.1, D) == pytest.approx(printed, rel=1e-14)
    once = contacts_per_volume("toll", 0.1, D, counting="once")
    assert once == pytest.approx(contacts_per_volume("komori_makishima", 0.1, D), rel=1e-14)
    assert printed == pytest.approx(2 * once, rel=1e-14)


def test_printed_tube_constant():
    right = mean_free_length("van_wyk_tube", 0.1, D)
    printed = mean_free_length("van_wyk_tube", 0.1, D, as_printed=True)
    assert printed / right == pytest.approx((4 / math.pi) ** 2, rel=1e-14)


@given(st.sampled_from(MODELS), st.floats(1e-4, 0.8), st.floats(1, 50))
def test_every_model_is_consistent(model, v, ratio):
    free = mean_free_length(model, v, D, ratio=ratio, **extra(model))
    count = contacts_per_volume(model, v, D, ratio=ratio, counting="once", **extra(model))
    length = 4 * v / (math.pi * D**2)
    assert count * free == pytest.approx(length / 2, rel=1e-12)  # eq. 3.61 repaired
    assert contacts_per_volume(
        model, v, D, ratio=ratio, counting="ends", **extra(model)
    ) == pytest.approx(2 * count, rel=1e-14)


def test_ratio_uses_f_and_any_density_agrees():
    s = structure(3.0)
    f = s.f
    for model in ("komori_makishima", "poisson", "toll"):
        assert mean_free_length(model, 0.1, D, ratio=3) == pytest.approx(
            math.pi * D / (8 * f * 0.1), rel=1e-12
        )
    general = density_structure(
        deformation=np.diag([1, 1, 1 / 3]), obstruction=True, tolerance=1e-7
    )
    for model in ("komori_makishima", "pan", "binomial"):
        assert mean_free_length(model, 0.1, D, structure=general, **extra(model)) == pytest.approx(
            mean_free_length(model, 0.1, D, ratio=3, **extra(model)), rel=1e-6
        )


def test_low_fraction_limit_and_low_gamma():
    v = 1e-5
    for model in MODELS:
        assert mean_free_length(model, v, D, **extra(model)) == pytest.approx(D / 2 / v, rel=1e-4)
    small = mean_free_length("binomial", 0.2, D, gamma=1e-7)
    assert small == pytest.approx(mean_free_length("poisson", 0.2, D), rel=1e-6)


def test_arrays():
    v = np.array([0.05, 0.1])
    free = mean_free_length("pan", v, D)
    assert free.shape == (2,)
    assert free[1] == mean_free_length("pan", 0.1, D)


def test_diameter_distribution_by_excluded_volume():
    """Pairs of diameters weigh (d_i + d_j)/2; means over a two-point distribution."""
    d, cv, v = D, 0.5, 0.05
    diameters, share = np.array([d * (1 - cv), d * (1 + cv)]), np.array([0.5, 0.5])
    length = v / (math.pi / 4 * np.sum(share * diameters**2))
    pairs = sum(
        a * b * length**2 * math.pi / 4 * (x + y) / 2
        for x, a in zip(diameters, share, strict=True)
        for y, b in zip(diameters, share, strict=True)
    )
    got = contacts_per_volume("komori_makishima", v, d, diameter_cv=cv)
    assert got == pytest.approx(pairs, rel=1e-13)


def test_count_distributions():
    c = contact_count("poisson", 0.1, D, 1e-3)
    mean = 8 * 0.1 * 1e-3 * (math.pi / 4) / (math.pi * D)
    assert c.probability.sum() == pytest.approx(1, abs=1e-11)
    assert c.mean == pytest.approx(mean, rel=1e-10)
    assert c.variance == pytest.approx(mean, rel=1e-9)
    b = contact_count("binomial", 0.1, D, 30 * 1.3 * D, gamma=1.3)
    s = 1 - math.exp(-2 * 0.1 * 1.3)
    assert b.mean == pytest.approx(30 * s, rel=1e-10)
    assert b.variance == pytest.approx(30 * s * (1 - s), rel=1e-9)


def test_binomial_is_thinned_poisson():
    """Erratum 3.13: Poisson candidates thrown into equal slots, each slot held by the first."""
    rng = np.random.default_rng(0)
    slots, mean = 10, 10.0
    hits = rng.poisson(mean / slots, size=(40000, slots))
    taken = np.sum(hits > 0, axis=1)
    v = mean * math.pi * D / (8 * (slots * 2.0 * D) * (math.pi / 4))
    c = contact_count("binomial", v, D, slots * 2.0 * D, gamma=2.0)
    assert abs(c.mean - taken.mean()) < 4 * taken.std() / 200
    observed = np.bincount(taken, minlength=len(c.k))[: slots + 1] / len(taken)
    error = np.sqrt(c.probability[: slots + 1] / len(taken)) + 1e-4
    assert np.all(np.abs(observed - c.probability[: slots + 1]) < 4.5 * error)


def test_gamma_lengths_give_negative_binomial():
    from scipy import stats

    cv, mean = 0.6, 8 * 0.1 * 1e-3 * (math.pi / 4) / (math.pi * D)
    c = contact_count("poisson", 0.1, D, 1e-3, length_cv=cv)
    shape = 1 / cv**2
    exact = stats.nbinom.pmf(c.k, shape, shape / (shape + mean))
    assert np.max(np.abs(c.probability - exact)) < 1e-10


def test_count_over_directions():
    c = contact_count("poisson", 0.1, D, 1e-3, ratio=10.0)
    s = structure(10.0)
    mean = 8 * 0.1 * 1e-3 * s.f / (math.pi * D)
    assert c.mean == pytest.approx(mean, rel=1e-8)
    assert c.variance > c.mean  # directions differ in their number of contacts


def test_free_length_distribution():
    x = np.linspace(0, 1e-3, 4001)
    p = free_length_survival("poisson", x, 0.1, D)
    assert integrate.trapezoid(p, x) == pytest.approx(mean_free_length("poisson", 0.1, D), rel=2e-3)
    q = free_length_survival("binomial", np.linspace(0, 2e-3, 200001), 0.1, D, gamma=1.3)
    mean = np.sum(q) * 1e-8
    assert mean == pytest.approx(mean_free_length("binomial", 0.1, D, gamma=1.3), rel=1e-3)
    assert free_length_survival("poisson", 0.0, 0.1, D, ratio=5.0) == pytest.approx(1)


def test_komori_makishima_monte_carlo():
    """Straight fibers thrown into a periodic box; crossings counted by brute force in numpy."""
    rng = np.random.default_rng(5)
    n, length, box, d = 400, 0.4, 1.0, 0.01
    e = rng.normal(size=(n, 3))
    e /= np.linalg.norm(e, axis=1)[:, None]
    x = rng.uniform(size=(n, 3))
    i, j = np.triu_indices(n, 1)
    r = x[i] - x[j]
    r -= np.round(r)
    b = np.sum(e[i] * e[j], axis=1)
    ri, rj = np.sum(e[i] * r, axis=1), np.sum(e[j] * r, axis=1)
    s = (b * rj - ri) / (1 - b**2)
    t = (rj - b * ri) / (1 - b**2)
    gap = np.linalg.norm(r + s[:, None] * e[i] - t[:, None] * e[j], axis=1)
    count = np.sum((np.abs(s) < length / 2) & (np.abs(t) < length / 2) & (gap < d))
    v = n * length * math.pi / 4 * d**2 / box**3
    expected = contacts_per_volume("komori_makishima", v, d) * (1 - 1 / n)
    assert abs(count - expected) < 3 * math.sqrt(expected)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: mean_free_length("wyk", 0.1, D), ["model", "wyk", "van_wyk", "toll"]),
        (lambda: mean_free_length("toll", -1, 0.0), ["v_f = -1", "d_f = 0 m"]),
        (lambda: mean_free_length("binomial", 0.1, D), ["gamma", "pi/2"]),
        (lambda: mean_free_length("pan", 0.1, D, diameter_cv=0.2), ["diameter_cv", "0.2"]),
        (lambda: mean_free_length("toll", 0.1, D, as_printed=True), ["as_printed"]),
        (lambda: mean_free_length("toll", 0.1, D, ratio=2, structure=structure(2)), ["not both"]),
        (lambda: contacts_per_volume("toll", 0.1, D, counting="twice"), ["counting", "once"]),
        (lambda: contact_count("pan", 0.1, D, 1e-3), ["no distribution"]),
        (lambda: contact_count("binomial", 0.1, D, 1e-3), ["gamma"]),
    ],
)
def test_bad_input(call, words):
    with pytest.raises(InvalidParameter) as caught:
        call()
    for word in words:
        assert word in str(caught.value)
