"""What a maintainer adds is one place each: the worked examples of docs/howto, applied to a copy."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
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
        elif name.startswith(("cpp/", "python/")):
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
    assert "friction.grease: got -1, must be >= 0" in str(error)
else:
    raise AssertionError("no fault")
"""


@pytest.mark.slow
@needs_compiler
def test_what_is_added_to_the_core_runs_in_a_mechanism(tmp_path):
    pybind11 = pytest.importorskip("pybind11")
    tree = tmp_path / "tree"
    copy_of(tree, "cpp", "python", "CMakeLists.txt", "pyproject.toml")
    for page in ("add_a_law.md", "add_a_friction_term.md"):
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
    for script in (RUN_LAW, RUN_FRICTION):
        subprocess.run(
            [sys.executable, "-c", script],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": str(tree / "python")},
            check=True,
            timeout=300,
        )
