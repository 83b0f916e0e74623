"""Threads that cannot be created, and threads that run at exit."""

import subprocess
import sys
import textwrap

import pytest


def run_alone(text, timeout=120):
    """A program in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(text)],
        capture_output=True, text=True, check=False, timeout=timeout,
    )  # fmt: skip


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
        except feltmb.Error as error:
            print(error)
        """
    )
    assert done.returncode == 0, done.stderr
    assert "can't start new thread" in done.stdout


@pytest.mark.parametrize(
    "progress", ["None", pytest.param("look", marks=pytest.mark.slow), "dawdle"]
)
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
