"""The full action as a machine of the bench: what is drawn, and what is recorded."""

import json

import numpy as np
import pytest

from blind import action_machine, action_truth
from blind.action_machine import packaged_scales


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Truths of a seed, and the records of one case with one effect."""
    folder = tmp_path_factory.mktemp("bench")
    truths = action_machine.draw(4, 40)
    (folder / "truths.json").write_text(json.dumps(truths))
    number = next(t["number"] for t in truths if len(t["parts"]) == 1 and
                  t["parts"][0]["form"] == "A" and t["view"] == "force")  # fmt: skip
    action_machine.make_records(folder, [number])
    return truths, action_machine.read_records(folder / "records" / f"{number}.npz")


def test_truths_are_those_of_the_seed(made):
    assert action_machine.draw(4, 3) == made[0][:3]
    assert action_machine.draw(5, 3) != made[0][:3]


def test_every_number_is_off_and_magnitudes_are_plausible(made):
    _, _, library, outputs = action_truth.setup()
    scales = packaged_scales()
    entries = {e.name: e for e in action_truth.candidates(library, outputs)}
    kinds = set()
    for data in made[0]:
        case = action_truth.from_dict(data)
        assert set(case.tolerances) == {e.name for e in library.tolerances}
        assert all(v != 0.0 for v in case.tolerances.values())
        for part in case.parts:
            kinds.add(part.form)
            unit = scales[f"{part.name}:{part.form}"]
            assert abs(part.size) * unit == pytest.approx(part.target)
            if part.form == "outside":
                assert part.name in action_truth.OUTSIDE
                assert part.name not in entries
            else:
                entry = entries[part.name]
                assert abs(part.size) <= action_truth.LARGEST * entry.magnitude * 1.0001
                assert entry.lower <= part.size <= entry.upper
    assert kinds == {"A", "B", "outside"}


def test_records_are_as_the_data_sheet_says_and_end_after_the_impact(made):
    _, records = made
    assert [r.role for r in records] == ["fit"] * 3 + ["held_out"] * 2
    for r in records:
        tip = r.outputs["hammer_tip.x"]
        farthest = r.time[int(np.argmax(np.abs(tip)))]
        assert r.time[-1] - farthest == pytest.approx(action_truth.AFTER_BLOW, abs=2e-3)
        still = np.diff(r.outputs["key_front.y"][:20])
        assert 1e-5 < np.std(still) < 1e-4
        steps = tip / action_truth.PIXEL
        assert np.allclose(steps, np.round(steps), atol=1e-6)


def test_views_are_drawn_in_their_shares_and_do_not_change_the_rest():
    _, _, library, outputs = action_truth.setup()
    scales = packaged_scales()
    cases = [action_truth.draw(1, n, scales, library, outputs) for n in range(200)]
    for view, share in action_truth.VIEWS.items():
        count = sum(c.view == view for c in cases)
        assert abs(count - 200 * share) < 4.0 * np.sqrt(200 * share * (1.0 - share))
    one = next(c for c in cases if c.view == "whole")
    again = action_truth.draw(1, one.number, scales, library, outputs, views={"force": 1.0})
    assert again.view == "force"
    assert (again.parts, again.tolerances) == (one.parts, one.tolerances)
    assert all(p.name != "channel_gain.force" for c in cases if c.view == "motion" for p in c.parts)


def test_views_show_what_they_say():
    _, base, library, outputs = action_truth.setup()

    def seen(view, **more):
        case = action_truth.plain_case(view=view)
        return action_truth.record(base, library, case, "staccato", outputs, ideal=True, **more)

    force, _ = seen("force")
    assert set(force) == {"force", *outputs}
    assert set(seen("one camera")[0]) == {"force", *action_truth.ONE_CAMERA}
    whole, _ = seen("whole")
    assert whole["force"].size > 2 * force["force"].size
    np.testing.assert_array_equal(whole["hammer_tip.x"][:50], force["hammer_tip.x"][:50])
    motion, _ = seen("motion")
    assert set(motion) == {"displacement", "finger.force", *outputs}
    np.testing.assert_allclose(motion["displacement"], -force["key_front.y"], atol=5e-6)
    np.testing.assert_array_equal(motion["finger.force"], force["force"])
    np.testing.assert_array_equal(motion["hammer_tip.x"], force["hammer_tip.x"])


def test_the_second_effect_of_a_mixed_form_is_true():
    """A form that is a mixture of two effects of the library was named as both: scored wrong."""
    _, _, library, outputs = action_truth.setup()
    known = {e.name: e for e in library.effects}
    mixed = 0
    for entry in action_truth.candidates(library, outputs):
        for form, parts in action_truth.forms(entry, library):
            part = action_truth.Part(entry.name, form, 1.0, 1.0)
            second = action_truth.second_of(part, library)
            paths = {c.path for e, _ in parts for c in e.changes} - {c.path for c in entry.changes}
            if second:
                mixed += 1
                assert {c.path for c in known[second].changes} & paths
            elif form == "A":
                assert not paths
    assert mixed > 20
    # The other form of this viscous friction is mostly quadratic, which is an effect of its own.
    part = action_truth.Part("viscous_friction.butt", "B", 1.0, 1.0)
    assert action_truth.second_of(part, library) == "hammer_air_drag"


def test_both_forms_of_an_effect_are_the_model_at_size_zero():
    action, _, library, outputs = action_truth.setup()
    for entry in action_truth.candidates(library, outputs)[::7]:
        for form, _ in action_truth.forms(entry, library):
            part = action_truth.Part(entry.name, form, 0.0, 0.0)
            case = action_truth.plain_case([part])
            assert action_truth.machine(action, library, case, "forte") is action


def test_an_effect_shows_when_ideal_records_differ():
    time = np.arange(100) / action_truth.RATE
    still = {"force": np.ones(100), "hammer_tip.x": np.zeros(100), "finger.force": np.zeros(100)}
    noise = action_truth.NOISE_CAMERA
    ramp = {**still, "hammer_tip.x": 40.0 * noise * time / time[-1]}
    # A tenth of the largest difference, which is 40 times the noise.
    assert action_truth.shows(ramp, still) == pytest.approx(time[10])
    weak = {**still, "finger.force": 0.5 * action_truth.NOISE_FORCE * time / time[-1]}
    assert action_truth.shows(weak, still) == pytest.approx(time[20])  # a tenth of the noise
    assert np.isnan(action_truth.shows({**still, "force": np.zeros(100)}, still))  # the input


def test_an_effect_of_the_string_shows_at_the_impact():
    _, base, library, outputs = action_truth.setup()
    parts = tuple(
        action_truth.Part(name, "A", size, 0.0)
        for name, size in (("string_tension", -0.2), ("channel_gain.key", 0.02))
    )
    case = action_truth.plain_case(parts)
    view, _ = action_truth.record(base, library, case, "forte", outputs, ideal=True)
    farthest = np.argmax(np.abs(view["hammer_tip.x"])) / action_truth.RATE
    string, gain = action_truth.moments(base, library, case, "forte", outputs)
    assert farthest - 0.002 < string < farthest + 0.002
    assert gain < string - 0.02  # from the first motion of the key on


def test_no_effect_or_tolerance_of_the_library_is_a_cause_from_outside():
    _, _, library, _ = action_truth.setup()
    held = {c.path for e in (*library.effects, *library.tolerances) for c in e.changes}
    assert "surfaces.Gp6.point.x" in held
    for name, (_, changes) in action_truth.OUTSIDE.items():
        assert not held & {c.path for c in changes}, name


def test_every_cause_from_outside_can_be_drawn_with_both_signs():
    _, base, library, _ = action_truth.setup()
    scales = packaged_scales()
    for name in action_truth.OUTSIDE:
        unit = scales[f"{name}:outside"]
        size = min(50.0 / unit, action_truth.LARGEST_OUTSIDE)
        assert size * unit > 5.0
        for sign in (-1.0, 1.0):
            part = action_truth.Part(name, "outside", sign * size, 50.0)
            case = action_truth.plain_case((part,))
            assert action_truth.machine(base, library, case, "mezzo").config is not base.config
