"""What a maintainer adds is one place each: examples of docs/howto, applied to a copy."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb import _core
from feltmb.adapters import load_library
from feltmb.graphics import plot
from feltmb.graphics.viewer.content import default_panels
from feltmb.run.reading import striker_speed
from unmodeled import library
from unmodeled.fit import Coordinate

PART = Coordinate(name="slide", position="q", speed="v", inertia="m")
ROOT = Path(__file__).resolve().parents[2]
DIAGNOSIS = "unmodeled/src"
HOWTO = ROOT / "docs" / "howto"
COMPILER = shutil.which("c++")

needs_compiler = pytest.mark.skipif(
    COMPILER is None or shutil.which("patch") is None, reason="no C++ compiler or no patch"
)


def files_of(page):
    """Files that a page shows, by name."""
    pattern = r"<!-- file (\S+) -->\n```\w+\n(.*?)```"
    return dict(re.findall(pattern, (HOWTO / page).read_text(encoding="utf-8"), re.DOTALL))


def apply(page, folder):
    """Applies a page to a copy of the tree; returns the files of the tree that it touches."""
    touched = []
    for name, text in files_of(page).items():
        if name.endswith(".patch"):
            touched += re.findall(r"^\+\+\+ b/(\S+)", text, re.MULTILINE)
            command = ["patch", "-p1", "--silent", "--fuzz=0"]
            subprocess.run(command, cwd=folder, input=text, text=True, check=True, timeout=60)
        elif name.startswith(("cpp/", "python/", "unmodeled/")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
            touched.append(name)
    return touched


def copy_of(folder, *parts):
    """A copy of parts of the tree in a folder."""
    for part in parts:
        target = folder / part
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / part).is_dir():
            ignore = shutil.ignore_patterns("*.so", "__pycache__")
            shutil.copytree(ROOT / part, target, ignore=ignore)
        else:
            shutil.copy(ROOT / part, target)


def check_syntax(folder, text):
    """The compiler accepts a source that sees the headers of the copy before those of the tree."""
    source = folder / "check.cpp"
    source.write_text(text)
    folders = ["-I", folder / "cpp" / "include", "-I", ROOT / "cpp" / "include"]
    if "channels.hpp" in text:  # the one that needs Eigen
        found = subprocess.run(
            ["pkg-config", "--cflags", "eigen3"], capture_output=True, text=True, check=False
        )
        folders += found.stdout.split() or ["-I", "/usr/include/eigen3"]
    done = subprocess.run(
        [COMPILER, "-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", *folders, source],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stdout + done.stderr == ""
    assert done.returncode == 0


@needs_compiler
def test_a_law_is_two_files_and_its_header_compiles(tmp_path):
    copy_of(tmp_path, "cpp/include/feltmb/contact/laws")
    assert len(apply("add_a_law.md", tmp_path)) == 2
    check_syntax(
        tmp_path,
        '#include "feltmb/contact/laws/list.hpp"\n'
        "using namespace feltmb;\n"
        "static_assert(Law<HardeningPad>);\n"
        "static_assert(std::is_constructible_v<LawParameters, HardeningPad>);\n"
        "double use(const HardeningPad& pad) { return pad.force(1e-3, 0.0).force; }\n",
    )


@needs_compiler
def test_a_friction_term_is_one_file_and_compiles(tmp_path):
    copy_of(tmp_path, "cpp/include/feltmb/contact/friction.hpp")
    assert apply("add_a_friction_term.md", tmp_path) == ["cpp/include/feltmb/contact/friction.hpp"]
    check_syntax(
        tmp_path,
        '#include "feltmb/contact/friction.hpp"\n'
        "using namespace feltmb;\n"
        "static_assert(std::is_base_of_v<GreaseFriction, Friction>);\n"
        "static_assert(std::tuple_size_v<decltype(Friction::fields())> == 10);\n"
        "double use(const Friction& friction) { return friction.at(0.1).value; }\n",
    )


@needs_compiler
def test_an_output_is_one_row_and_compiles(tmp_path):
    copy_of(tmp_path, "cpp/src/model/channels.cpp")
    before = (ROOT / "cpp/src/model/channels.cpp").read_text().count("row(")
    assert apply("add_an_output.md", tmp_path) == ["cpp/src/model/channels.cpp"]
    text = (tmp_path / "cpp/src/model/channels.cpp").read_text()
    assert text.count("row(") == before + 1
    check_syntax(tmp_path, text)


def overlaid(tmp_path, page, *parts, place="python/feltmb"):
    """A package with a page applied: parts of it copied, the rest as links."""
    package = tmp_path / place
    package.mkdir(parents=True)
    for item in (ROOT / place).iterdir():
        if item.name not in ("__pycache__", *parts):
            (package / item.name).symlink_to(item)
    for part in parts:
        copy_of(tmp_path, f"{place}/{part}")
    extension = next(Path(_core.__file__).parent.glob("_core.*.so"))
    if place == "python/feltmb" and not (package / extension.name).exists():
        (package / extension.name).symlink_to(extension)
    return apply(page, tmp_path)


def run_in(tmp_path, script):
    places = [tmp_path / "python", tmp_path / DIAGNOSIS, os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": ":".join(map(str, places))},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_command_is_one_file_and_one_line(tmp_path):
    touched = overlaid(tmp_path, "add_a_command.md", "cli")
    assert touched == ["python/feltmb/cli/outputs.py", "python/feltmb/cli/__init__.py"]
    pendulum = ROOT / "tests" / "data" / "pendulum.toml"
    run = feltmb.simulate(feltmb.load_action(pendulum), feltmb.ramp_stroke(0.1, duration=0.01))
    run.save(tmp_path / "run.nc")
    said = run_in(
        tmp_path,
        "from feltmb.cli import main\nmain(['outputs', 'run.nc'])\n",
    )
    assert "arm.angle" in said
    assert "finger.displacement" in said


def test_a_generic_effect_is_one_file(tmp_path):
    touched = overlaid(
        tmp_path, "add_an_effect.md", "library", "chain", place=f"{DIAGNOSIS}/unmodeled"
    )
    assert sorted(touched) == [
        f"{DIAGNOSIS}/unmodeled/chain/hum.py",
        f"{DIAGNOSIS}/unmodeled/library/magnets.py",
    ]
    said = run_in(
        tmp_path,
        "from unmodeled.fit import Coordinate\n"
        "from unmodeled import library\n"
        "part = Coordinate(name='slide', position='q', speed='v', inertia='m')\n"
        "for e in library.for_coordinate(part, force=2.0, travel=0.1, speed=1.0):\n"
        "    print(e.name, e.scale)\n"
        "print(library.sensor_fault(['q'], 'q', 'hum').name)\n",
    )
    *lines, fault = said.splitlines()
    assert fault == "hum of sensor q"
    assert "end magnet slide 0.2" in lines
    assert len(lines) == 1 + len(library.for_coordinate(PART, force=2.0, travel=0.1, speed=1.0))


def test_a_mechanism_is_one_file(tmp_path):
    """Its summary, plots and viewer need no code."""
    for name, text in files_of("describe_a_mechanism.md").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    action = feltmb.load_action(tmp_path / "lever.toml")
    run = feltmb.simulate(action, feltmb.load_stroke(tmp_path / "push.toml"), output_rate=20000.0)
    stop = run.event_time("stop_met")
    assert run.summary["stop_time"] == stop
    # The largest force of the motion lies between two samples.
    highest = run["contact01.force"].max()
    assert highest <= run.summary["stop_force"] == pytest.approx(highest, rel=1e-3)
    near = np.interp(stop, run.time, run["tip.vy"])
    assert run.summary["meeting_speed"] == pytest.approx(near, rel=1e-4)
    assert np.array_equal(striker_speed(run), run["tip.vy"])
    panels = {p["title"]: p["outputs"] for p in default_panels([run])}
    assert panels["felt stop"] == ["contact01.force"]
    assert panels["tip"] == ["tip.speed"]
    labels = [ax.get_ylabel() for ax in plot.overview(run).axes]
    assert "felt stop [N]" in labels
    assert "tip\nspeed [m/s]" in labels


def test_an_effect_on_a_mechanism_is_one_table(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(files_of("add_an_effect.md")["mine.toml"])
    found = load_library(feltmb.load_action("steinway45"), file)
    assert found.effect("sticky_damper").component == "damper"
    file.write_text(file.read_text().replace("contacts.10.hysteresis", "contacts.10.hysterisis"))
    with pytest.raises(feltmb.InvalidParameter, match="hysterisis"):
        load_library(feltmb.load_action("steinway45"), file)


RUN_LAW = """
import tomllib
import feltmb
from feltmb.contact import LAWS, law
from feltmb.mechanism import Action

assert LAWS["hardening_pad"] == "k e / (1 - e/h)"
assert abs(law("hardening_pad", stiffness=1e4, thickness=3e-3).step(1e-3, 1.0) - 15.0) < 1e-9
raw = tomllib.loads(open("pendulum.toml").read())
raw["contacts"]["01"].update(
    law="hardening_pad", hardening_pad={"stiffness": "2e5 N/m", "thickness": "3 mm"}
)
run = feltmb.simulate(Action(raw), feltmb.ramp_stroke(0.0, duration=0.1))
assert run["contact01.force"].max() > 0.0
assert run.energy["created_by"] == []
raw["contacts"]["01"]["hardening_pad"] = {"stiffness": 1.0}
try:
    Action(raw)
except feltmb.InvalidParameter as error:
    assert "contacts.01.hardening_pad.thickness: is missing" in str(error)
else:
    raise AssertionError("no fault")
"""

RUN_OUTPUT = """
import numpy as np
import tomllib
import feltmb
from feltmb.mechanism import Action

action = Action(tomllib.loads(open("pendulum.toml").read()))
run = feltmb.simulate(action, feltmb.ramp_stroke(0.5, duration=0.1), output_rate=50000.0)
assert run.unit("finger.power") == "W"
work = np.sum(0.5 * np.diff(run.time) * (run["finger.power"][1:] + run["finger.power"][:-1]))
assert abs(work / run.energy["work_in"] - 1.0) < 1e-3
"""

RUN_FRICTION = """
import tomllib
import feltmb
from feltmb.mechanism import Action

raw = tomllib.loads(open("pendulum.toml").read())
[body] = raw["bodies"]
stroke = feltmb.ramp_stroke(0.0, duration=0.1)
free = feltmb.simulate(Action(raw), stroke)
raw["bodies"][body]["friction"] = {"grease": "20 N mm", "grease_speed": "0.5 rad/s"}
stiff = feltmb.simulate(Action(raw), stroke)
assert stiff.energy["dissipated_total"] > free.energy["dissipated_total"]
assert stiff.energy["residual_relative"] < 1e-3
raw["bodies"][body]["friction"] = {"grease": -1.0}
try:
    Action(raw)
except feltmb.InvalidParameter as error:
    assert "friction.grease: got -1.0, must be >= 0" in str(error)
else:
    raise AssertionError("no fault")
"""


@pytest.mark.slow
@needs_compiler
def test_what_is_added_to_the_core_runs_in_a_mechanism(tmp_path):
    pybind11 = pytest.importorskip("pybind11")
    tree = tmp_path / "tree"
    copy_of(tree, "cpp", "python", "CMakeLists.txt", "pyproject.toml")
    for page in ("add_a_law.md", "add_a_friction_term.md", "add_an_output.md"):
        apply(page, tree)
    options = [
        "-DCMAKE_BUILD_TYPE=Release", "-DFELTMB_PYTHON=ON", "-DFELTMB_TESTS=OFF",
        "-DFELTMB_BENCH=OFF", f"-Dpybind11_DIR={pybind11.get_cmake_dir()}",
        f"-DPython_EXECUTABLE={sys.executable}",
    ]  # fmt: skip
    if shutil.which("ccache"):
        options.append("-DCMAKE_CXX_COMPILER_LAUNCHER=ccache")
    build = tree / "build"
    subprocess.run(["cmake", "-S", tree, "-B", build, *options], check=True, timeout=300)
    subprocess.run(
        ["cmake", "--build", build, "--target", "_core", "-j2"], check=True, timeout=3000
    )
    for made in (build / "cpp" / "bindings").glob("_core*"):
        if made.is_file():
            shutil.copy(made, tree / "python" / "feltmb")
    shutil.copy(ROOT / "tests" / "data" / "pendulum.toml", tree)
    for script in (RUN_LAW, RUN_FRICTION, RUN_OUTPUT):
        subprocess.run(
            [sys.executable, "-c", script],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": str(tree / "python")},
            check=True,
            timeout=300,
        )
