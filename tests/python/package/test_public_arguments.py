"""Every function of every public module raises only exceptions of feltmb, whatever it is given.

``test_arguments.py`` gives each argument of a valid call a hostile value. Here, the calls are
made from the annotations, so that no new function is forgotten.
"""

import importlib
import inspect
import math
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import feltmb
import unmodeled
from unmodeled.errors import Error, shown

DATA = Path(__file__).resolve().parents[2] / "data"
HOSTILE = [
    *(object(), None, True, "x", "", "\ud800", "a\0b", "a" * 5000, b"x", {}, {"a": "b"}, lambda: 3),
    *(math.nan, math.inf, -1, 0, 1e300, -1e308, 10**400, 2**62, 1j, Path("x"), Path("a" * 5000)),
    *([], [1.0, 2.0, 3.0], [math.nan], [1e300], ["x"], [None], np.ones((2, 3)), np.zeros(0)),
    *(np.ones((2, 2, 2)), np.array("x")),
]

FEW = [object(), {}, math.nan, 10**400, "\ud800", np.ones((2, 3))]


def public_functions():
    """Functions by name, and classes whose arguments are checked."""
    names = "actuator adapters animate batch contact felt fiber gap graph parameters "
    names += "plot sensitivity viewer"
    homes = [feltmb, *(getattr(feltmb, name) for name in names.split())]
    homes += [importlib.import_module(f"feltmb.{name}") for name in ("live", "mechanism")]
    homes += [unmodeled, unmodeled.data, unmodeled.fit, unmodeled.units]
    found = {}
    for home in homes:
        for name in getattr(home, "__all__", ()):
            member = getattr(home, name)
            is_checked = inspect.isclass(member) and hasattr(member.__init__, "__checks__")
            if inspect.isfunction(member) or is_checked:
                found[f"{member.__module__}.{name}"] = member
    return found


FUNCTIONS = public_functions()


@cache
def valid(annotation):
    """Valid values by the text of an annotation."""
    from unmodeled.data import Record, Sensor

    if "Record" in annotation:
        time = 1e-3 * np.arange(20)
        return Record(
            name="a", time=time, inputs={}, outputs={"q": time}, sensors={"q": Sensor(name="q")}
        )
    if "Action" in annotation:
        return feltmb.load_action(DATA / "pendulum.toml")
    if "Run" in annotation and "RunOptions" not in annotation:
        return feltmb.simulate(valid("Action"), valid("Stroke"), output_rate=1000.0)
    if "Stroke" in annotation:
        return feltmb.pulse_stroke(1.0, 0.0, 0.005, 0.005, duration=0.02)
    for word, value in (
        *(("Mapping", {}), ("Sequence[float]", [0.0, 1.0]), ("Array", np.array([0.0, 1.0]))),
        *(("Sequence[str]", ["arm.angle"]), ("Path", "a.csv"), ("float", 1.0), ("int", 1)),
        *(("str", "m"), ("bool", False)),
    ):
        if word in annotation:
            return value
    raise LookupError(annotation)


def calls(function, value):
    """Arguments with a hostile value: in all places, then in each place of a valid call."""
    parameters = [
        p
        for p in inspect.signature(function).parameters.values()
        if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]
    required = [p for p in parameters if p.default is p.empty]
    if required:
        yield {p.name: value for p in required}
    try:
        given = {p.name: valid(str(p.annotation)) for p in required}
    except LookupError:
        return
    for p in parameters:
        # A function of the caller raises what it likes.
        called = any(word in str(p.annotation) for word in ("Callable", "Density", "Progress"))
        if not (called and callable(value)):
            yield given | {p.name: value}


#: What starts a long computation from a valid call; test_arguments.py calls them.
LONG = ("unmodeled", "unmodeled.fit", "feltmb.fiber", "feltmb.felt", "feltmb.action", "feltmb.live",
        "feltmb.run.sweep", "feltmb.run.fmu", "feltmb.contact")  # fmt: skip


def escapes(name, *, each):
    """Calls that end in an exception that is not ours; ``each``: in each place, too."""
    function = FUNCTIONS[name]
    faults = []
    for value in HOSTILE if each else FEW:
        for k, arguments in enumerate(calls(function, value)):
            if k > 0 and (not each or name.startswith(LONG)):
                break
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # what is told of a value that is taken
                    function(**arguments)
            except Error as error:
                if max(map(len, str(error).split()), default=0) > 210:
                    faults.append(f"{shown(arguments)}: a long name in {str(error)[:300]}")
            except Exception as error:
                faults.append(f"{shown(arguments)}: {error!r:.200}")
    return faults


def test_only_our_exceptions_come_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    faults = {name: found for name in FUNCTIONS if (found := escapes(name, each=False))}
    assert not faults


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
def test_only_our_exceptions_come_out_of_each_argument(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    faults = escapes(name, each=True)
    assert not faults, "\n".join(faults[:20])


def test_every_public_function_with_arguments_is_checked():
    bare = [
        name
        for name, function in FUNCTIONS.items()
        if inspect.isfunction(function)
        and inspect.signature(function).parameters
        and not hasattr(function, "__checks__")
    ]
    assert not bare
