"""The generator of the blind bench: its independence, its agreement with the model."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

from blind import key_hammer, small_machine, truth, truth_machine, truth_outside, truth_sensors
from unmodeled.fit import Candidate
from unmodeled.fit.observe import observe

FOLDER = Path(truth.__file__).parent
KINDS = truth.load_outside(truth_outside)


def imported(name):
    tree = ast.parse((FOLDER / f"{name}.py").read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            yield node.module


@pytest.mark.parametrize(
    ("name", "may"),
    [
        ("truth", ()),
        ("truth_machine", ("blind.truth",)),
        ("truth_sensors", ("blind.truth", "blind.truth_machine")),
        ("truth_outside", ()),
        ("marks", ()),
    ],
)
def test_generator_and_scorer_share_no_code_with_the_engine(name, may):
    for module in imported(name):
        top = module.split(".")[0]
        assert module in may or top == "numpy" or top in sys.stdlib_module_names, module


def test_tables_of_generator_and_model_agree():
    own = {n: (v, sd) for n, v, sd, _, _ in key_hammer.PARAMETERS if n != "camera_skew"}
    assert set(own) == set(truth.DRAWN)
    for name, numbers in own.items():
        assert numbers == pytest.approx(truth.DRAWN[name]), name
    library = {e.name: e for e in key_hammer.effects()}
    assert set(library) == set(truth.EFFECTS)
    for name, effect in library.items():
        assert effect.component == truth.EFFECTS[name][0]
        assert (effect.sign == 0) == (name in truth.BOTH_SIGNS), name
    scales = small_machine.packaged_scales()
    wanted = {f"{n}:{f}" for n in truth.EFFECTS for f in "AB"} | {f"{n}:outside" for n in KINDS}
    assert set(scales["force"]) == set(scales["motion"]) == wanted
    assert len(KINDS) >= 8


def views(cases):
    """Ideal fitted records of cases, by case and stroke."""
    result = truth_machine.integrate(cases, [truth.FIT] * len(cases), KINDS)
    for i, case in enumerate(cases):
        shown = truth_sensors.record(case, truth.FIT, result, 3 * i, KINDS, ideal=True)
        yield [small_machine.record_of_view(n, shown[n], case.mode, "fit") for n in truth.FIT]


def shares_left(mode, names):
    """Share of what an effect does, form A, that the effect of the library leaves."""
    scales = small_machine.packaged_scales()
    sizes = {n: 3.0 / scales[mode][f"{n}:A"] for n in names}
    parts = [truth.Part(n, "A", v, 3.0) for n, v in sizes.items()]
    cases = [truth.plain_case(mode), *(truth.plain_case(mode, [part]) for part in parts)]
    plain, *others = views(cases)
    model, library = key_hammer.KeyHammer(), {e.name: e for e in key_hammer.effects()}
    theta, out = np.array([p.value for p in model.parameters]), {}

    def simulated(record, *given):
        included = tuple(Candidate(library[n]) for n in given)
        start = np.zeros(len(model.states(included)))
        return observe(model, record, theta, start, included, np.array([sizes[n] for n in given]))

    for name, records in zip(names, others, strict=True):
        without = left = 0.0
        for bare, record in zip(plain, records, strict=True):
            n = min(bare.samples, record.samples)
            rest = (bare.output_array(model.outputs) - simulated(bare))[:n]
            seen = record.output_array(model.outputs)[:n] - rest
            without += np.sum((seen - simulated(record)[:n]) ** 2)
            left += np.sum((seen - simulated(record, name)[:n]) ** 2)
        out[name] = float(np.sqrt(left / without))
    return out


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["force", "motion"])
def test_effects_mean_the_same_in_generator_and_library(mode):
    scales = small_machine.packaged_scales()[mode]
    able = [n for n in truth.EFFECTS if truth._largest(n, mode) * scales[f"{n}:A"] > 10.0]
    assert len(able) >= 14
    found = shares_left(mode, able)
    assert max(found.values()) < 0.2, found


@pytest.mark.parametrize("mode", ["force", pytest.param("motion", marks=pytest.mark.slow)])
def test_generator_and_model_agree_without_an_effect(mode):
    model = key_hammer.KeyHammer()
    theta = np.array([p.value for p in model.parameters])
    (records,) = views([truth.plain_case(mode)])
    for record in records:
        gap = observe(model, record, theta, np.zeros(4)) - record.output_array(model.outputs)
        # Open loop through an impact; exposure rounds its corner by up to 20 um.
        assert np.max(np.abs(gap)) < 3e-5, record.name


def test_same_seed_same_truth_and_shares_of_the_mix():
    scales = small_machine.packaged_scales()
    largest = {k: 30.0 * v.size for k, v in KINDS.items()}
    drawn = [truth.draw(3, n, scales, largest) for n in range(600)]
    again = truth.draw(3, 17, scales, largest)
    assert again == drawn[17]
    outside = [c for c in drawn if any(p.form == "outside" for p in c.parts)]
    counts = np.bincount([len(c.parts) for c in drawn if c not in outside], minlength=4) / 600
    assert counts == pytest.approx([0.25, 0.45, 0.15, 0.05], abs=0.06)
    assert len(outside) / 600 == pytest.approx(0.10, abs=0.04)
    nc = np.log([c.parts[0].target for c in drawn if len(c.parts) == 1 and c not in outside])
    assert np.min(nc) >= np.log(0.5)
    assert np.max(nc) <= np.log(50.0)
    assert np.mean(nc) == pytest.approx(0.5 * np.log(25.0), abs=0.2)
    forms = [p.form for c in drawn for p in c.parts if p.form != "outside"]
    assert np.mean([f == "B" for f in forms]) == pytest.approx(0.5, abs=0.08)
    for c in drawn:
        for p in c.parts:
            if p.form != "outside":
                assert abs(p.size) <= truth._largest(p.name, c.mode) * (1 + 1e-12)


def test_camera_noise_is_correlated_over_three_frames():
    noise = truth_sensors._grain(200_000, np.random.default_rng(1))
    rho = [np.mean(noise[k:] * noise[: noise.size - k]) for k in range(4)]
    assert rho == pytest.approx([1.0, 2 / 3, 1 / 3, 0.0], abs=0.02)
