"""An installed feltmb can be used by a C++ project of somebody else."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pybind11
import pytest

from feltmb.contact import law
from feltmb.felt import SphereOnLayer

ROOT = Path(__file__).resolve().parents[2]


def run(*command: str | Path) -> str:
    done = subprocess.run(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}"
    return done.stdout


@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs CMake")
def test_every_file_is_compiled_with_the_arithmetic_of_the_core(tmp_path):
    """Bindings, tests and projects of others compile the laws of the headers, too."""
    library, prefix, consumer = tmp_path / "library", tmp_path / "prefix", tmp_path / "consumer"
    options = ["-DFELTMB_PYTHON=ON", f"-Dpybind11_DIR={pybind11.get_cmake_dir()}"]
    run("cmake", "-S", ROOT, "-B", library, f"-DPython_EXECUTABLE={sys.executable}", *options)
    # Nothing is compiled: an empty file stands for the library.
    (library / "cpp" / "libfeltmb.a").touch()
    run("cmake", "--install", library, "--prefix", prefix, "--component", "cpp")
    source, found = ROOT / "tests" / "cmake_consumer", f"-DCMAKE_PREFIX_PATH={prefix}"
    run("cmake", "-S", source, "-B", consumer, found, "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON")
    commands = [
        entry
        for folder in (library, consumer)
        for entry in json.loads((folder / "compile_commands.json").read_text())
    ]
    files = " ".join(entry["file"] for entry in commands)
    for part in ("bindings", "cpp/fmu", "tests/cpp", "bench/speed", "cmake_consumer"):
        assert part in files
    for entry in commands:
        assert "-ffp-contract=off" in entry["command"], entry["file"]
        assert "-fno-math-errno" in entry["command"], entry["file"]


@pytest.mark.slow
def test_find_package_after_install(tmp_path):
    library, prefix, consumer = tmp_path / "library", tmp_path / "prefix", tmp_path / "consumer"
    unoptimized = "-DCMAKE_BUILD_TYPE=Debug"
    without = ["-DFELTMB_TESTS=OFF", "-DFELTMB_BENCH=OFF", "-DFELTMB_PYTHON=OFF"]
    run("cmake", "-S", ROOT, "-B", library, unoptimized, *without)
    run("cmake", "--build", library)
    run("cmake", "--install", library, "--prefix", prefix)

    source = ROOT / "tests" / "cmake_consumer"
    run("cmake", "-S", source, "-B", consumer, unoptimized, f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", consumer)

    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    printed = run(consumer / "consumer").splitlines()
    assert printed[:2] == [version, "stiffness = -4e+08 N/m"]
    laws = {
        "felt_memory": law(
            "felt_memory", loading=(5.52e3, 1.58e3, -0.60e3), unloading=(0.19e3, 5.04e3, 3.04e3)
        ),
        "micromechanical": law(
            "micromechanical",
            felt="synthetic_soft_red",
            thickness=6e-3,
            area=SphereOnLayer(9e-3),
            compression="columns",
        ),
    }
    for line, (name, felt) in zip(printed[2:], laws.items(), strict=True):
        word, *forces = line.split()
        assert word == name
        expected = [felt.step(e, 1e-3) for e in (2e-4, 4e-4, 2e-4, 4e-4)]
        assert [float(f) for f in forces] == pytest.approx(expected, rel=1e-8)

    # The project that the page shows.
    page = (ROOT / "docs" / "howto" / "install.md").read_text(encoding="utf-8")
    source = tmp_path / "page"
    source.mkdir()
    for name, text in re.findall(r"<!-- file (\S+) -->\n```\w+\n(.*?)```", page, flags=re.DOTALL):
        (source / name).write_text(text)
    shown = re.search(r"\$ build/consumer\n(.*?)```", page, flags=re.DOTALL)
    run("cmake", "-S", source, "-B", source / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", source / "build")
    assert run(source / "build" / "consumer") == shown[1]
