"""The law of docs/howto/add_a_law.md, added to a copy of the repository: two files."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "howto" / "add_a_law.md"
COMPILER = shutil.which("c++")

pytestmark = [
    pytest.mark.skipif(COMPILER is None, reason="no C++ compiler"),
    pytest.mark.skipif(shutil.which("patch") is None, reason="no patch"),
]


def files_of_the_page():
    pattern = r"<!-- file (\S+) -->\n```\w+\n(.*?)```"
    return dict(re.findall(pattern, PAGE.read_text(encoding="utf-8"), re.DOTALL))


def change(folder):
    """Applies the page to a copy; returns the files of the repository that it touches."""
    files = files_of_the_page()
    touched = []
    for name, text in files.items():
        if name.startswith("cpp/"):
            (folder / name).write_text(text, encoding="utf-8")
            touched.append(name)
    patch = files["list.patch"]
    touched += re.findall(r"^\+\+\+ b/(\S+)", patch, re.MULTILINE)
    subprocess.run(
        ["patch", "-p1", "--silent"], cwd=folder, input=patch, text=True, check=True, timeout=60
    )
    return touched


def test_a_law_is_two_files_and_its_header_compiles(tmp_path):
    laws = tmp_path / "cpp" / "include" / "feltmb" / "contact" / "laws"
    shutil.copytree(ROOT / laws.relative_to(tmp_path), laws)
    touched = change(tmp_path)
    assert len(touched) == 2
    source = tmp_path / "check.cpp"
    source.write_text(
        '#include "feltmb/contact/laws/list.hpp"\n'
        "using namespace feltmb;\n"
        "static_assert(Law<HardeningPad>);\n"
        "static_assert(std::is_constructible_v<LawParameters, HardeningPad>);\n"
        "double use(const HardeningPad& pad) { return pad.force(1e-3, 0.0).force; }\n"
    )
    folders = ["-I", tmp_path / "cpp" / "include", "-I", ROOT / "cpp" / "include"]
    done = subprocess.run(
        [COMPILER, "-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", *folders, source],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stdout + done.stderr == ""
    assert done.returncode == 0


RUN = """
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


@pytest.mark.slow
def test_the_new_law_runs_in_a_mechanism(tmp_path):
    pybind11 = pytest.importorskip("pybind11")
    tree = tmp_path / "tree"
    for part in ("cpp", "python"):
        shutil.copytree(
            ROOT / part, tree / part, ignore=shutil.ignore_patterns("*.so", "__pycache__")
        )
    for name in ("CMakeLists.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tree)
    change(tree)
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
    subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=tree,
        env={"PYTHONPATH": str(tree / "python"), "PATH": "/usr/bin:/bin"},
        check=True,
        timeout=300,
    )
