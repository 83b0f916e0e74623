"""An installed feltmb can be used by a C++ project of somebody else."""

import subprocess
import tomllib
from pathlib import Path

import pytest

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


@pytest.mark.slow
def test_find_package_after_install(tmp_path):
    library, prefix, consumer = tmp_path / "library", tmp_path / "prefix", tmp_path / "consumer"
    unoptimised = "-DCMAKE_BUILD_TYPE=Debug"
    without = ["-DFELTMB_TESTS=OFF", "-DFELTMB_BENCH=OFF", "-DFELTMB_PYTHON=OFF"]
    run("cmake", "-S", ROOT, "-B", library, unoptimised, *without)
    run("cmake", "--build", library)
    run("cmake", "--install", library, "--prefix", prefix)

    source = ROOT / "tests" / "cmake_consumer"
    run("cmake", "-S", source, "-B", consumer, unoptimised, f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", consumer)

    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert run(consumer / "consumer").splitlines() == [version, "stiffness = -4e+08 N/m"]
