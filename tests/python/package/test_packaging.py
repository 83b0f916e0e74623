"""What is shipped: SUNDIALS inside, licenses of third parties, types, what the code reads."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PARTIES = ("SUNDIALS", "Eigen", "pybind11")
#: That of `feltmb page`, which tools/wasm.sh builds.
MODULE = "python/feltmb/_core_page.wasm"


def test_the_extension_needs_no_installed_sundials():
    """Of all libraries that are mapped after a stroke, none is SUNDIALS'."""
    code = (
        "import feltmb; feltmb.simulate('steinway45', 'forte', 0.001)\n"
        "print('\\n'.join(sorted({line.split()[-1] for line in open('/proc/self/maps')})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    mapped = done.stdout.lower().splitlines()
    assert any("/_core" in name for name in mapped)
    assert not [name for name in mapped if "sundials" in name or "cvodes" in name]


def test_licenses_of_third_parties_are_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "licenses/*" in project["license-files"]
    for name in PARTIES:
        text = (ROOT / "licenses" / f"{name}.txt").read_text(encoding="utf-8")
        assert "Copyright" in text
        assert len(text) > 1000


def build(what, target):
    """Wheel or source distribution of this tree, by the tools that are installed."""
    pytest.importorskip("scikit_build_core")
    pytest.importorskip("pybind11")
    code = (
        f"import sys; from scikit_build_core import build\nprint(build.build_{what}(sys.argv[1]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(target)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": ""},
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return target / done.stdout.strip().splitlines()[-1]


@pytest.mark.parametrize("made", [True, False])
def test_a_wheel_carries_the_module_of_the_page_if_it_was_built(tmp_path, made):
    """With the settings and the rule of this tree, but without its compilation."""
    pytest.importorskip("scikit_build_core")
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    settings = re.sub("(?m)^build.targets = .*$", "", settings)
    (tmp_path / "pyproject.toml").write_text(settings, encoding="utf-8")
    (rule,) = re.findall(
        r"install\(FILES \S+\.wasm .*\)", (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
    )
    (tmp_path / "CMakeLists.txt").write_text(
        f"cmake_minimum_required(VERSION 3.22)\nproject(feltmb LANGUAGES NONE)\n{rule}\n"
    )
    (tmp_path / "python" / "feltmb").mkdir(parents=True)
    shutil.copytree(ROOT / "licenses", tmp_path / "licenses")
    for name in ("README.md", "LICENSE", ".gitignore", "python/feltmb/__init__.py"):
        shutil.copy(ROOT / name, tmp_path / name)
    if made:
        (tmp_path / MODULE).write_bytes(b"\0asm")
    code = (
        "from scikit_build_core import build; print(build.build_sdist('.'), build.build_wheel('.'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    sdist, wheel = (tmp_path / name for name in done.stdout.split()[-2:])
    with tarfile.open(sdist) as archive:
        assert (MODULE in {n.partition("/")[2] for n in archive.getnames()}) == made
    with zipfile.ZipFile(wheel) as archive:
        assert archive.namelist().count(MODULE.removeprefix("python/")) == made


@pytest.mark.slow
def test_the_source_distribution_holds_what_the_wheel_needs(tmp_path):
    path = build("sdist", tmp_path)
    with tarfile.open(path) as archive:
        names = {n.partition("/")[2] for n in archive.getnames()}
    for needed in (
        "CMakeLists.txt",
        "LICENSE",
        "cpp/CMakeLists.txt",
        "cpp/bindings/CMakeLists.txt",
        "python/feltmb/graphics/viewer/assets/viewer.js",
        "python/feltmb/params/steinway45.toml",
        *(f"licenses/{name}.txt" for name in PARTIES),
    ):
        assert needed in names, needed
    assert not [n for n in names if n.startswith(("build/", ".venv/", "out/"))]
    # Wheels that are built from it need no emscripten.
    assert (MODULE in names) == (ROOT / MODULE).is_file()


@pytest.mark.slow
def test_the_wheel_runs_where_nothing_of_this_tree_is(tmp_path):
    source = tmp_path / "source"
    with tarfile.open(build("sdist", tmp_path)) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    shutil.move(next((tmp_path / "unpacked").iterdir()), source)
    code = "import sys; from scikit_build_core import build; print(build.build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        cwd=source,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": ""},
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    wheel = tmp_path / done.stdout.strip().splitlines()[-1]
    place = tmp_path / "place"
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        archive.extractall(place)
    for name in PARTIES:
        assert [n for n in names if n.endswith(f"licenses/licenses/{name}.txt")], name
    assert "feltmb/py.typed" in names
    assert (MODULE.removeprefix("python/") in names) == (ROOT / MODULE).is_file()
    assert "feltmb/_core/__init__.pyi" in names
    shutil.rmtree(source)
    code = (
        "import feltmb, sys\n"
        "run = feltmb.simulate('steinway45', 'forte', 0.1)\n"
        "assert run.summary['impact_speed'] > 3\n"
        "feltmb.view(run, sys.argv[1]); run.save(sys.argv[2])\n"
        "print(feltmb.__file__)\n"
        "print(' '.join({line.split()[-1] for line in open('/proc/self/maps')}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "a.html"), str(tmp_path / "a.nc")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(place)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(place))
    assert not re.search("sundials|cvodes", done.stdout.splitlines()[1], re.IGNORECASE)
