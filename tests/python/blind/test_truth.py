"""The generator of the blind bench: its independence, its agreement with the model."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

from blind import calibration, key_hammer, truth, truth_machine, truth_outside, truth_sensors
from feltmb.fit import Candidate, Jobs

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
        ("score", ()),
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
    scales = calibration.packaged_scales()
    wanted = {f"{n}:{f}" for n in truth.EFFECTS for f in "AB"} | {f"{n}:outside" for n in KINDS}
    assert set(scales["force"]) == set(scales["motion"]) == wanted
    assert len(KINDS) >= 8


def residuals(mode, names):
    """{effect: (noncentrality, noncentrality left once the model has the effect)}, form A."""
    scales = calibration.packaged_scales()
    base = truth.plain_case(mode)
    cases = [base] + [
        truth.plain_case(mode, [truth.Part(n, "A", 10.0 / scales[mode][f"{n}:A"], 10.0)])
        for n in names
    ]
    result = truth_machine.integrate(cases, [truth.FIT] * len(cases), {})
    records, starts = calibration._view(base, result, 0, {})
    view = calibration._Whitener(records, starts)
    plain = [view.residual(r, s) for r, s in zip(records, starts, strict=True)]
    library = {e.name: e for e in key_hammer.effects()}
    out = {}
    for i, name in enumerate(names):
        candidate = Candidate(library[name])
        size = cases[1 + i].parts[0].size
        records, starts = calibration._view(cases[1 + i], result, 3 * (1 + i), {})
        without, rest = [], []
        for r, s, p in zip(records, starts, plain, strict=True):
            without.append([a - b for a, b in zip(view.residual(r, s), p, strict=True)])
            hidden, rows = np.zeros(len(candidate.effect.hidden)), []
            for w, (a, b) in enumerate(view.segments):
                run = view.model.simulate(
                    r,
                    Jobs(
                        theta=view.theta[None],
                        segments=view.segments[w : w + 1],
                        starts=np.concatenate([s[w], hidden])[None],
                        included=(candidate,),
                        magnitudes=np.array([[size]]),
                    ),
                )
                hidden = run.ends[0, 4:]
                seen = r.output_array(view.model.outputs)[a:b]
                rows.append((seen - run.outputs[0][: b - a]).T.ravel() - p[w])
            rest.append(rows)
        out[name] = view.noncentrality(without), view.noncentrality(rest)
    return out


def check(found):
    for name, (nc, left) in found.items():
        # The gain of a force is taken up by masses and springs to first order: what is left grows
        # with its square, and the secant of its scale is off by two.
        assert 7.0 < nc < (21.0 if name == "input_gain" else 20.0), (name, nc)
        # Sharper friction and another step leave a little.
        assert left < 0.15 * nc, (name, nc, left)


def test_effects_mean_the_same_in_generator_and_library():
    check(residuals("force", ["jack_hysteresis", "bed_creep", "shank_flexibility", "input_delay"]))


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["force", "motion"])
def test_all_effects_mean_the_same_in_generator_and_library(mode):
    scales = calibration.packaged_scales()[mode]
    able = [n for n in truth.EFFECTS if truth._largest(n, mode) * scales[f"{n}:A"] > 10.0]
    assert len(able) >= 14
    check(residuals(mode, able))


def test_generator_and_model_agree_without_an_effect():
    model = key_hammer.KeyHammer()
    theta = np.array([[p.value for p in model.parameters]])
    for mode in ("force", "motion"):
        case = truth.plain_case(mode)
        result = truth_machine.integrate([case], [truth.FIT], {})
        records, _ = calibration._view(case, result, 0, {})
        for record in records:
            run = model.simulate(
                record,
                Jobs(
                    theta=theta,
                    segments=np.array([[0, record.samples - 1]]),
                    starts=np.zeros((1, 4)),
                    magnitudes=np.zeros((1, 0)),
                ),
            )
            gap = run.outputs[0] - record.output_array(model.outputs)
            # Open loop through an impact; exposure rounds its corner by up to 20 um.
            assert np.max(np.abs(gap)) < 3e-5, (mode, record.name)


def test_same_seed_same_truth_and_shares_of_the_mix():
    scales = calibration.packaged_scales()
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
