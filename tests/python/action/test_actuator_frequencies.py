"""Finite elements of the arm against the transcendental equation of a hub with beam and tip mass.

The witness solves EI y'''' = rho A w^2 y section by section in trigonometric and hyperbolic
functions, y the total displacement, with the natural boundary conditions of Hamilton's principle,
which SymPy derives in the first test. It shares nothing with the elements.
"""

import numpy as np
import pytest
import sympy as sp
from scipy.optimize import brentq

from feltmb.action.actuator import load_actuator
from unmodeled.errors import InvalidParameter


def solutions(x, b):
    """cos, sin, cosh, sinh of b x and their first three derivatives: rows by derivative."""
    c, s, ch, sh = np.cos(b * x), np.sin(b * x), np.cosh(b * x), np.sinh(b * x)
    return np.array(
        [
            [c, s, ch, sh],
            [-b * s, b * c, b * sh, b * ch],
            [-(b**2) * c, -(b**2) * s, b**2 * ch, b**2 * sh],
            [b**3 * s, -(b**3) * c, b**3 * sh, b**3 * ch],
        ]
    )


def determinant(actuator, w):
    """Of the boundary and continuity conditions at w [rad/s]; zero at a natural frequency."""
    c = actuator.config
    stretches = c.arm.stretches()
    n = len(stretches)
    rows = []

    def put(section, row):
        full = np.zeros(4 * n)
        full[4 * section : 4 * section + 4] = row
        return full

    b = [
        (s.density * s.area * w**2 / (s.young_modulus * s.second_moment)) ** 0.25 for s in stretches
    ]
    root = solutions(0.0, b[0])
    bend = stretches[0].young_modulus * stretches[0].second_moment
    rows.append(put(0, root[0] - c.hub.radius * root[1]))
    rows.append(put(0, c.hub.inertia * w**2 * root[1] + bend * (root[2] - c.hub.radius * root[3])))
    for i in range(n - 1):
        left, right = solutions(stretches[i].length, b[i]), solutions(0.0, b[i + 1])
        e = [s.young_modulus * s.second_moment for s in stretches[i : i + 2]]
        for k, (u, v) in enumerate([(1, 1), (1, 1), e, e]):
            rows.append(put(i, u * left[k]) - put(i + 1, v * right[k]))
    end = solutions(stretches[-1].length, b[-1])
    bend = stretches[-1].young_modulus * stretches[-1].second_moment
    m, r = c.tip.mass, c.tip.eccentricity
    if c.tip.placement == "across":
        rows.append(put(n - 1, bend * end[2] - w**2 * m * r**2 * end[1]))
        rows.append(put(n - 1, bend * end[3] + w**2 * m * end[0]))
    else:
        moved = end[0] + r * end[1]
        rows.append(put(n - 1, bend * end[2] - w**2 * m * r * moved))
        rows.append(put(n - 1, bend * end[3] + w**2 * m * moved))
    matrix = np.array(rows)
    matrix /= np.linalg.norm(matrix, axis=1, keepdims=True)
    return np.linalg.det(matrix / np.linalg.norm(matrix, axis=0, keepdims=True))


def exact_frequencies(actuator, count, near):
    """Roots [Hz] that the determinant's sign brackets, found from below."""
    w = 2 * np.pi * np.geomspace(0.2 * near[0], 1.2 * near[count - 1], 3000)
    values = np.array([determinant(actuator, x) for x in w])
    turns = np.nonzero(values[:-1] * values[1:] < 0)[0]
    roots = [brentq(lambda x: determinant(actuator, x), w[i], w[i + 1], xtol=1e-9) for i in turns]
    return np.array(roots[:count]) / (2 * np.pi)


def test_boundary_conditions_from_hamiltons_principle():
    """Integrate EI y'' dy'' by parts for any shapes; what is left at the ends is used above."""
    x, length, e = sp.symbols("x L E", positive=True)
    y = sum(sp.Symbol(f"c{i}") * x**i for i in range(6))
    dy = sum(sp.Symbol(f"d{i}") * x**i for i in range(6))
    inner = sp.integrate(e * sp.diff(y, x, 2) * sp.diff(dy, x, 2), (x, 0, length))
    bulk = sp.integrate(e * sp.diff(y, x, 4) * dy, (x, 0, length))
    ends = e * (sp.diff(y, x, 2) * sp.diff(dy, x) - sp.diff(y, x, 3) * dy)
    assert sp.expand(inner - bulk - (ends.subs(x, length) - ends.subs(x, 0))) == 0


@pytest.mark.parametrize("arm", ["wood", "aluminum"])
@pytest.mark.parametrize("placement", ["across", "along"])
def test_against_the_transcendental_equation(arm, placement):
    actuator = load_actuator(arm).with_values({"arm.elements": 24, "tip.placement": placement})
    found = actuator.frequencies(4)
    exact = exact_frequencies(actuator, 4, found)
    assert found[:2] == pytest.approx(exact[:2], rel=1e-6)
    assert found == pytest.approx(exact, rel=3e-5)


def test_a_tapered_arm():
    """Three sections: 12 conditions in the witness, elements shared out by length."""
    wood = load_actuator("wood")
    base = wood.raw["arm"]
    raw = wood.raw
    common = {k: base[k] for k in ("density", "young_modulus")}
    raw["arm"] = {
        "elements": 24,
        "sections": {
            "root": {**common, "length": "14 mm", "area": "30 mm^2", "second_moment": "9 mm^4"},
            "middle": {**common, "length": "12 mm", "area": "22 mm^2", "second_moment": "6 mm^4"},
            "end": {**common, "length": "7.05 mm", "area": "15 mm^2", "second_moment": "3 mm^4"},
        },
    }
    tapered = type(wood)(raw)
    found = tapered.frequencies(3)
    assert found == pytest.approx(exact_frequencies(tapered, 3, found), rel=2e-5)
    assert found[0] > wood.frequencies(1)[0]


@pytest.mark.parametrize("arm", ["wood", "aluminum"])
def test_mesh_convergence_of_fourth_order(arm):
    actuator = load_actuator(arm)
    exact = exact_frequencies(actuator, 2, actuator.frequencies(2))
    errors = np.array(
        [actuator.with_values({"arm.elements": n}).frequencies(2) - exact for n in (2, 4, 8)]
    )
    assert np.all(errors > 0.0)  # Rayleigh: from above
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(orders > 3.4), orders
    assert orders[-1] == pytest.approx(4.0, abs=0.1)


def test_published_first_frequencies():
    """Without the eccentricity: aluminum 3.58 kHz, wood 338 Hz (checked by a second program)."""
    for arm, hertz in (("aluminum", 3582.57), ("wood", 337.721)):
        point = load_actuator(arm).with_values({"tip.eccentricity": 0.0})
        assert point.frequencies(1)[0] == pytest.approx(hertz, rel=1e-5)


def test_the_printed_shape_function_does_not_converge():
    """Eq. 5.2 as printed: the first frequency doubles with each halving of the mesh."""
    printed = load_actuator("aluminum").with_values(
        {"arm.printed_shapes": True, "tip.eccentricity": 0.0}
    )
    f = [printed.with_values({"arm.elements": n}).frequencies(1)[0] for n in (4, 8, 16)]
    assert f == pytest.approx([5.4e3, 10.5e3, 20.6e3], rel=0.01)


def test_cantilever():
    """Hub held, no tip mass: cos b cosh b = -1."""
    arm = load_actuator("wood").with_values({"tip.mass": 0.0, "arm.elements": 12})
    s = arm.config.arm.stretches()[0]
    b = np.array([1.875104068711961, 4.694091132974174]) / s.length
    exact = b**2 * np.sqrt(s.young_modulus * s.second_moment / (s.density * s.area)) / (2 * np.pi)
    assert arm.frequencies(2, clamped=True) == pytest.approx(exact, rel=3e-5)


def test_rigid_inertia():
    c = load_actuator("wood").config
    s, a = c.arm.stretches()[0], c.hub.radius
    arm = s.density * s.area * ((a + s.length) ** 3 - a**3) / 3.0
    tip = c.tip.mass * ((a + s.length) ** 2 + c.tip.eccentricity**2)
    assert load_actuator("wood").rigid_inertia == pytest.approx(
        c.hub.inertia + arm + tip, rel=1e-12
    )


def test_faults_are_listed_together():
    wood = load_actuator("wood")
    raw = wood.raw
    raw["hub"]["inertia"]["value"] = -1.0
    raw["arm"]["elements"] = 0
    del raw["arm"]["density"]
    raw["stop"]["law"] = "stulov"
    raw["stop"]["gapp"] = 1.0
    with pytest.raises(InvalidParameter) as caught:
        type(wood)(raw, "mine.toml")
    text = str(caught.value)
    for part in (
        "mine.toml: 5 faults",
        "hub.inertia: got -1.0 kg m^2, must be > 0",
        "arm.elements: got 0, must be >= 1",
        "arm.density: is missing",
        "stop.stulov: is missing; law 'stulov' needs it",
        "stop.gapp: unknown key; did you mean 'gap'?",
    ):
        assert part in text
    with pytest.raises(InvalidParameter, match="'oak' is unknown; packaged are aluminum, wood"):
        load_actuator("oak")
