"""Derivatives of the numbers of a summary against central differences, at default tolerances.

``tests/data/peak_derivatives.json`` has differences of runs at rtol 1e-11 whose steps (1e-3 to 3e-6
of a parameter) agree within 1 %, for the parameters that change the largest force most; each is
multiplied by the size of the parameter.
"""

import copy
import json

import pytest

import feltmb
from feltmb.mechanism.parameters import find_parameters, mechanism_with

RIGID = {"shank.rigid": True, "wire.rigid": True}
HAMMER = {
    "mem": {"contacts.06.law": "felt_memory"},
    "hc": {
        "contacts.06.law": "hunt_crossley",
        "contacts.06.hunt_crossley": {"stiffness": 3e8, "exponent": 2.3, "damping": 0.2},
    },
    "stulov": {
        "contacts.06.law": "stulov",
        "contacts.06.stulov": {"stiffness": 3e8, "exponent": 2.3, "amplitude": 0.3, "time": 1e-4},
    },
}
BEATER = {"stiffness": 3e6, "exponent": 1.8, "amplitude": 0.3, "time": 1e-4}


def machine(case, data, tmp_path):
    """Mechanism and stroke of a case, by its name."""
    what, stroke, *law = case.split("_")
    if what.startswith("pedal"):
        text = (data / "kick.toml").read_text().replace('"90 ms"', f'"{stroke} ms"')
        path = tmp_path / "kick.toml"
        path.write_text(text)
        changes = {"contacts.01.law": "stulov", "contacts.01.stulov": BEATER} if law else {}
        return feltmb.load_action(data / "pedal.toml").with_values(changes), feltmb.load_stroke(
            path
        )
    changes = (RIGID if what == "rigid" else {}) | (HAMMER[law[0]] if law else {})
    return feltmb.load_action("steinway45").with_values(changes), feltmb.load_stroke(stroke)


def run(action, stroke, parameter, shift, **options):
    changed = copy.copy(action)
    value = parameter.value + shift * parameter.size
    changed.mechanism = mechanism_with(action, {parameter.path: value})
    return feltmb.simulate(changed, stroke, ledger=False, rtol=1e-11, **options).summary


PEAK = "max_impact_force"
#: The travel of the key is left out: a run has that of its samples, whose differences are rough.
NUMBERS = [
    *(PEAK, "max_impact_force_time", "impact_time", "impact_speed", "rebound_speed"),
    *("impact_duration", "let_off_gap"),
]
FAST = ["pedal_90", "pedal_130", "pedal_200_stulov", "rigid_forte_hc", "flex_forte_mem"]
SLOW = ["rigid_forte", "rigid_piano_stulov", "flex_forte", "flex_piano", "rigid_forte_mem"]


@pytest.mark.parametrize("case", [*FAST, *(pytest.param(c, marks=pytest.mark.slow) for c in SLOW)])
def test_numbers_of_ten_machines_against_differences(case, data, tmp_path):
    table = json.loads((data / "peak_derivatives.json").read_text())[case]
    action, stroke = machine(case, data, tmp_path)
    g = feltmb.gradient(action, stroke, list(table["by"]), (), duration=table["duration"])
    assert g.unknown == {}
    for name in NUMBERS:
        wanted = {p: row[name] for p, row in table["by"].items() if row.get(name)}
        # A derivative that is small beside the others is a difference of large ones.
        room = 1e-3 * max(map(abs, wanted.values()), default=0.0)
        for j, parameter in enumerate(g.parameters):
            if name in g.summary and parameter.path in wanted:
                got = g.summary_gradient[name][j] * parameter.size
                want = pytest.approx(wanted[parameter.path], rel=0.03, abs=room)
                assert got == want, (name, parameter.path)
        assert name != PEAK or len(wanted) >= 8


@pytest.mark.slow
@pytest.mark.parametrize("case", FAST + SLOW)
def test_stored_differences(case, data, tmp_path):
    """One of each case is computed anew."""
    table = json.loads((data / "peak_derivatives.json").read_text())[case]
    action, stroke = machine(case, data, tmp_path)
    path = [p for p, row in table["by"].items() if PEAK in row][3]
    (parameter,) = find_parameters(action, path)
    h = 1e-4  # smaller ones differ by the rounding of the runs
    options = {"duration": table["duration"], "summary_only": True}
    up, down = (run(action, stroke, parameter, s, **options)[PEAK] for s in (h, -h))
    assert (up - down) / (2 * h) == pytest.approx(table["by"][path][PEAK], rel=0.01)


@pytest.mark.parametrize(
    ("hold", "wanted"), [(80, -1645.4), (90, -242.9), (100, -242.0), (130, -242.0), (200, -242.0)]
)
def test_mass_of_the_beater(hold, wanted, data, tmp_path):
    """The peak between two steps, for pulses that differ about the strike or after it."""
    action, stroke = machine(f"pedal_{hold}", data, tmp_path)
    g = feltmb.gradient(action, stroke, ["bodies.beater.mass"], ())
    assert g.summary_gradient[PEAK][0] == pytest.approx(wanted, rel=0.02)


def test_rows_of_the_reading(data, tmp_path):
    """Rows of every kind: at an event, largest, smallest, mean, range, with ends that move."""
    action, stroke = machine("pedal_90", data, tmp_path)
    path = "bodies.beater.mass"
    (parameter,) = find_parameters(action, path)
    options = {"duration": 0.15}
    g = feltmb.gradient(action, stroke, [path], (), output_rate=10_000.0, **options)
    h = 1e-3
    up, down, middle = (run(action, stroke, parameter, s, **options) for s in (h, -h, 0.0))
    assert set(action.config.reading.rows) <= set(g.summary)
    assert g.summary_units["swing"] == "rad"
    for name in action.config.reading.rows:
        by_runs = (up[name] - down[name]) / (2 * h)
        got = g.summary_gradient[name][0] * parameter.size
        assert g.summary[name] == pytest.approx(middle[name], rel=1e-3), name
        assert got == pytest.approx(by_runs, rel=0.03), name
    assert g.summary["head_force"] == pytest.approx(g.summary[PEAK], rel=2e-5)
    assert g.summary_gradient["head_force"] == pytest.approx(g.summary_gradient[PEAK], rel=1e-2)


def test_a_force_that_never_acts_has_no_peak(data, tmp_path):
    action, stroke = machine("pedal_90", data, tmp_path)
    g = feltmb.gradient(action, stroke, ["bodies.beater.mass"], (), duration=0.05)
    assert PEAK not in g.summary
    assert g.summary["head_force"] == 0.0
    assert g.summary_gradient["head_force"] == pytest.approx([0.0])
