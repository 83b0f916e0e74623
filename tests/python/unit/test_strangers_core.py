"""What strangers broke in the core: energy out of nothing, rest poses, damaged starts, threads."""

import dataclasses
import math
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import feltmb

STILL = feltmb.ramp_stroke(0.0, duration=0.02)


def members(shapes, count):
    return {
        path: value
        for member in ("wire", "shank")
        for path, value in {f"{member}.shapes": shapes, f"{member}.lateral_shapes": count}.items()
    }


def run_alone(text, timeout=120):
    """A program in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(text)],
        capture_output=True, text=True, check=False, timeout=timeout,
    )  # fmt: skip


# --- energy --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ringing(action):
    """Members with undamped modes up to 20 kHz."""
    return action.with_values(members("craig_bampton", 6))


def test_fast_undamped_members_make_no_energy(ringing):
    run = feltmb.simulate(ringing, "staccato", 0.1)
    assert run.energy["residual_relative"] < 1e-4
    assert not run.stats["warnings"]


def test_with_strings_in_the_integrator_members_make_no_energy_either(ringing):
    # The string of 7 % damping alone would allow order 3, under which they grow.
    run = feltmb.simulate(ringing, "staccato", 0.06, method="cvode")
    assert run.energy["residual_relative"] < 1e-3


@pytest.mark.parametrize("name", ["steinway45", "steinway45_damped"])
def test_long_ringing_with_strings_in_the_integrator_makes_no_energy(name):
    """Order 3 let the wire grow by a fifth of its energy in half a second: 1.2e-3 missing."""
    run = feltmb.simulate(name, "staccato", method="cvode")
    assert run.energy["residual_relative"] < 4e-4
    assert run.stats["steps"] < 65_000  # order 2: 140 000


def test_a_run_whose_ledger_is_off_has_failed_and_keeps_its_trajectory(ringing):
    options = {"duration": 0.1, "rtol": 1e-5, "max_order": 3}
    with pytest.raises(
        feltmb.IntegrationError, match=r"energy balance error.*ledger_limit"
    ) as caught:
        feltmb.simulate(ringing, "staccato", **options)
    run = caught.value.partial
    assert run.status == "failed"
    assert run.time[-1] == pytest.approx(0.1)
    assert run.energy["residual_relative"] > 0.1
    assert feltmb.simulate(ringing, "staccato", ledger_limit=1e9, **options).status == "done"


def test_rows_of_a_sweep_whose_ledger_is_off_have_failed(ringing):
    table = feltmb.sweep(
        ringing, "staccato", {"options.max_order": [3, 5]},
        options={"duration": 0.1, "rtol": 1e-5, "ledger": True},
    ).table  # fmt: skip
    assert list(table["status"]) == ["failed", "done"]
    assert "energy balance error" in table["error"][0]


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan])
def test_a_limit_of_the_ledger_is_positive(rigid, limit):
    with pytest.raises(feltmb.InvalidParameter, match="ledger_limit"):
        feltmb.simulate(rigid, STILL, 0.001, ledger_limit=limit)


def test_the_ledger_counts_where_no_work_is_done(data, state_of):
    """A hammer thrown at a string: no work comes in, only its own energy is exchanged."""
    action = feltmb.load_action(data / "hammer_string.toml")
    start = state_of(action, [0.0], [3.0])
    rough = feltmb.simulate(action, STILL, rtol=1e-2, start=start)
    fine = feltmb.simulate(action, STILL, rtol=1e-8, start=start)
    kinetic = 0.5 * 9e-3 * 3.0**2
    for run in (rough, fine):
        assert run.energy["work_throughput"] == 0.0
        assert run.energy["turned_over"] == pytest.approx(kinetic, rel=0.05)
        ratio = run.energy["residual_largest"] / run.energy["turned_over"]
        assert run.energy["residual_relative"] == pytest.approx(ratio, rel=1e-12)
    assert rough.energy["residual_relative"] > 1e-3
    assert any("energy balance error" in w for w in rough.stats["warnings"])
    assert 0.0 < fine.energy["residual_relative"] < 1e-5


def test_at_rest_nothing_is_missing(rigid):
    run = feltmb.simulate(rigid, STILL)
    assert run.energy["residual_relative"] < 1e-3
    assert not run.stats["warnings"]


def test_the_ledger_of_late_samples_counts_from_the_start(rigid):
    whole = feltmb.simulate(rigid, "forte")
    late = feltmb.simulate(rigid, "forte", summary_only=True)
    assert late.time[0] > 0.1
    assert late.energy["residual_relative"] < 1e-3
    for key in ("work_in", "kinetic", "potential", "elastic", "dissipated_total"):
        assert late.energy[key] == pytest.approx(whole.energy[key], rel=1e-9, abs=1e-12)


# --- rest poses ----------------------------------------------------------------------------------


def resting_on_the_string(data, **values):
    """The hammer of the tests, pulled onto its string by a weight."""
    return feltmb.load_action(data / "hammer_string.toml").with_values(
        {"gravity": [9.81, 0.0], "contacts.01.law": "guarded", **values}
    )


@pytest.mark.parametrize("start", [-0.01, 0.002, 0.02])
def test_a_string_under_a_weight_takes_its_static_deflection(data, start):
    """Wherever the search starts, also deep behind the string."""
    action = resting_on_the_string(data, **{"start_pose": {"hammer.x": start}})
    run = feltmb.simulate(action, STILL, 0.001)
    weight = 9e-3 * 9.81
    assert run["contact01.force"][0] == pytest.approx(weight, rel=1e-6)
    string = run._string()
    shape = np.sqrt(2.0 / (5.98e-3 * 0.6315)) * np.sin(
        np.pi * np.arange(1, 41) * 0.0789375 / 0.6315
    )
    deflection = weight * np.sum(shape**2 / string.angular_frequency**2)
    assert run["string.strike"][0] == pytest.approx(deflection, rel=1e-6)
    assert np.ptp(run["hammer.x"]) < 1e-9


@pytest.mark.parametrize(
    ("radius", "what"),
    [(0.573, r"J in contacts.*strap bridle_strap"), (0.43, r"J in contacts.*contact05")],
)
def test_a_rest_pose_with_energy_from_nowhere_is_refused(action, radius, what):
    """The rail of the key is lifted by decimeters: bodies are pushed past each other and jam."""
    moved = action.with_values({"surfaces.Gp2.radius": radius})
    with pytest.raises(feltmb.ModelError, match=what) as caught:
        moved.rest_pose  # noqa: B018
    for word in ("rest pose makes no sense", "expected at most", "start_pose"):
        assert word in str(caught.value)


def test_a_member_bent_beyond_its_length_is_no_rest_pose(action):
    soft = action.with_values({"wire.young_modulus": 1e4})
    with pytest.raises(feltmb.ModelError, match=r'member "wire" of .* is deflected by'):
        soft.rest_pose  # noqa: B018


def test_members_beyond_small_deflections_are_told(action):
    """A force of the finger that no finger has bends the wire by centimeters."""
    soft = action.with_values({"wire.young_modulus": 2e7})
    run = feltmb.simulate(soft, "forte", 0.1)
    found = [
        w for w in run.stats["warnings"] if w.startswith("member wire of 66.1 mm is deflected")
    ]
    assert len(found) == 1
    assert not any("member" in w for w in feltmb.simulate(action, "forte", 0.1).stats["warnings"])


# --- starts --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ended(action):
    """A strike on felt that remembers, and its end."""
    felt = action.with_values(
        {"shank.rigid": True, "wire.rigid": True, "contacts.*.law": "felt_memory"}
    )
    return felt, feltmb.simulate(felt, "forte", 0.02)


def damage(values, how):
    out = np.array(values, dtype=float)
    if how == "empty":
        return out[:0]
    if how == "short":
        return out[:-1]
    out[0] = {"nan": np.nan, "inf": np.inf, "huge": 1e308, "negative": -1.0}[how]
    return out


@pytest.mark.parametrize("how", ["nan", "inf", "huge", "negative", "empty", "short"])
def test_a_damaged_memory_is_refused(ended, how):
    felt, run = ended
    broken = dataclasses.replace(run, end_memory=damage(run.end_memory, how))
    with pytest.raises(feltmb.InvalidParameter, match=r"memory|remembered"):
        feltmb.simulate(felt, STILL, start=broken)


@pytest.mark.parametrize("how", ["nan", "inf", "huge", "empty", "short"])
def test_a_damaged_state_is_refused_or_fails(ended, how):
    felt, run = ended
    for at in (0, len(felt.coordinates), -1):  # a place, a speed, a mode of the string
        state = np.roll(damage(np.roll(run.end_state, -at), how), at)
        broken = dataclasses.replace(run, end_state=state)
        with pytest.raises((feltmb.InvalidParameter, feltmb.IntegrationError)) as caught:
            feltmb.simulate(felt, STILL, start=broken)
        assert str(caught.value)
        partial = getattr(caught.value, "partial", None)
        assert partial is None or np.all(np.isfinite(partial.values))


@pytest.mark.parametrize("name", ["end_state", "end_memory"])
@pytest.mark.parametrize("kind", [complex, str, object, None])
def test_a_start_of_other_than_numbers_is_refused(ended, name, kind):
    felt, run = ended
    broken = None if kind is None else getattr(run, name).astype(kind)
    with pytest.raises(feltmb.InvalidParameter, match=f"start: {name} is an array of"):
        feltmb.simulate(felt, STILL, start=dataclasses.replace(run, **{name: broken}))


# --- threads -------------------------------------------------------------------------------------


def test_absurd_jobs_and_threads_that_cannot_be_created_end_in_results():
    done = run_alone(
        """
        import ctypes, threading
        import feltmb
        a = feltmb.load_action("steinway45").with_values({"shank.rigid": True, "wire.rigid": True})
        options = {"duration": 0.002}
        axis = {"stroke.scale": [1.0, 1.1, 1.2]}
        many = feltmb.sweep(a, "forte", axis, options=options, jobs=100000).table
        # From here on new threads of the core ask for more stack than there are addresses.
        threading.stack_size(1 << 20)
        libc = ctypes.CDLL(None)
        attributes = ctypes.create_string_buffer(256)
        assert libc.pthread_attr_init(attributes) == 0
        assert libc.pthread_attr_setstacksize(attributes, ctypes.c_size_t(1 << 47)) == 0
        assert libc.pthread_setattr_default_np(attributes) == 0
        few = feltmb.sweep(a, "forte", axis, options=options, jobs=100000).table
        assert list(many["status"]) == list(few["status"]) == ["done"] * 3
        for name in ("impact_time", "key_travel", "steps"):
            if name in many:
                assert list(many[name]) == list(few[name])
        print("both")
        """
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "both"


def test_where_no_thread_at_all_can_be_created_a_sweep_ends_in_an_error():
    done = run_alone(
        """
        import threading
        import feltmb
        a = feltmb.load_action("steinway45").with_values({"shank.rigid": True, "wire.rigid": True})
        def refused(self):
            raise RuntimeError("can't start new thread")
        threading.Thread.start = refused
        try:
            feltmb.sweep(a, "forte", {"stroke.scale": [1.0]}, options={"duration": 0.002})
        except feltmb.FeltmbError as error:
            print(error)
        """
    )
    assert done.returncode == 0, done.stderr
    assert "can't start new thread" in done.stdout


@pytest.mark.parametrize("progress", ["None", "look", "dawdle"])
@pytest.mark.parametrize("call", ["simulate", "batch"])
def test_daemon_threads_that_simulate_at_exit_end_cleanly(progress, call):
    """With 12 threads, some ask for the interpreter's lock at whatever moment it ends."""
    if call == "batch" and progress != "None":
        pytest.skip("a batch reports no progress")
    done = run_alone(
        f"""
        import itertools, threading, time
        from feltmb.run.batch import simulate_many
        import feltmb
        rigid = {{"shank.rigid": True, "wire.rigid": True}}
        a = feltmb.load_action("steinway45").with_values(rigid)
        a.rest_pose
        stroke = feltmb.load_stroke("forte")
        def look(t):
            return True
        def dawdle(t):
            time.sleep(0.01)
            return True
        begun = threading.Semaphore(0)
        def work():
            begun.release()
            while True:
                if {call!r} == "simulate":
                    feltmb.simulate(a, stroke, 30.0, output_rate=100.0, progress={progress})
                else:
                    simulate_many(
                        itertools.repeat((a, stroke, {{"duration": 0.002}})),
                        lambda i, r: True,
                        jobs=2,
                    )
        for _ in range(12):
            threading.Thread(target=work, daemon=True).start()
        for _ in range(12):
            begun.acquire()
        time.sleep(0.3)
        print("end")
        """
    )
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
    assert done.stdout.strip() == "end"
    assert not done.stderr.strip(), done.stderr[-2000:]
