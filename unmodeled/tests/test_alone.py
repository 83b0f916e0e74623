"""unmodeled works without feltmb, without a compiler and without compiled modules."""

import os
import subprocess
import sys
import textwrap

ALONE = """
    import sys

    class Forbidden:
        def find_spec(self, name, path=None, target=None):
            if name.split(".")[0] == "feltmb":
                raise AssertionError(f"imports {name}")

    sys.meta_path.insert(0, Forbidden())
    import importlib
    import importlib.metadata
    import pkgutil

    importlib.metadata.entry_points = lambda **_: ()
    import unmodeled

    for module in pkgutil.walk_packages(unmodeled.__path__, "unmodeled."):
        if not module.name.endswith(("__main__", "_tape")):  # a shared object is no module
            importlib.import_module(module.name)
    for name in unmodeled.__all__:
        assert getattr(unmodeled, name) is not None, name
    from unmodeled.cli import cli

    for command in cli.list_commands(None):
        assert cli.get_command(None, command).params
    assert not [n for n in sys.modules if n.split(".")[0] == "feltmb"]
"""


#: As in a browser: no thread and no process can be started, and a module of the latter is absent.
SERIAL = """
    import os
    import subprocess
    import sys
    import threading

    def refused(*_, **__):
        raise RuntimeError("can't start new thread")

    threading.Thread.start = refused
    os.fork = os.posix_spawn = subprocess.Popen.__init__ = refused
    sys.modules["_multiprocessing"] = sys.modules["_posixsubprocess"] = None
    import numpy as np
    import unmodeled

    clock = np.arange(300) * 0.01
    push = np.sin(3.0 * clock) + np.sin(7.0 * clock)

    def cart(time, inputs, parameters):
        v = np.zeros(time.size)
        friction, mass = parameters["friction"], parameters["mass"]
        for i in range(1, time.size):
            v[i] = v[i - 1] + 0.01 * inputs["force"][i] / mass
            v[i] -= np.clip(v[i], -0.01 * friction / mass, 0.01 * friction / mass)
        return {"v": v}

    truth = cart(clock, {"force": push}, {"mass": 1.02, "friction": 0.3})["v"]
    record = unmodeled.Record(
        name="run", time=clock, inputs={"force": push},
        outputs={"v": truth + 1e-3 * np.random.default_rng(0).standard_normal(clock.size)},
        sensors={"v": unmodeled.Sensor(name="v", sigma=1e-3, unit="m/s")},
    )
    prior = {"mass": (1.0, 0.05, "kg")}
    own = unmodeled.Simulator(
        cart, parameters=prior, unknown={"friction": (0.0, 0.2, "N")},
        inputs={"force": "N"}, outputs={"v": "m/s"}, workers=2,
    )
    report = unmodeled.diagnose(own, ["friction"], record)
    assert [n.cause for n in report.named] == ["friction"], report
    assert any("no process could be started" in n for n in report.notes), report.notes

    equations = unmodeled.Equations(
        lambda t, x, u, p: (x.v, u.force / p.mass), parameters=prior, outputs={"v": "v"},
        states={"x": (0.0, 0.0, "m"), "v": (0.0, 0.0, "m/s")},
    )
    report = unmodeled.diagnose(equations, ["dry friction*", "offset of input*"], record)
    assert [n.cause for n in report.named] == ["dry friction x"], report
    # These take as long to start as such a diagnosis.
    slow = "pydantic", "scipy.optimize", "pandas", "matplotlib"
    assert not [n for n in slow if n in sys.modules]
"""


def run(script, **variables):
    """Run a script in a Python of its own."""
    words = [sys.executable, "-c", textwrap.dedent(script)]
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, env={**os.environ, **variables}
    )
    assert done.returncode == 0, done.stderr


def test_nothing_of_feltmb_is_imported():
    run(ALONE)


def test_a_diagnosis_needs_no_thread_no_process_and_no_slow_package():
    run(SERIAL, UNMODELED_NO_EXTENSION="1")
