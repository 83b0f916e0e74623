"""What is imported when: heavy libraries wait until they are used. Times are measured in bench/."""

import importlib
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import feltmb
import unmodeled
from unmodeled.lazy import lazy_import

HEAVY = (
    *(
        "numpy",
        "scipy",
        "pandas",
        "xarray",
        "h5netcdf",
        "h5py",
        "matplotlib",
        "pydantic",
        "tomlkit",
    ),
    *("rich", "jinja2", "PIL"),
)


def loaded(code):
    """Modules after running some code in a new interpreter."""
    script = f"{code}\nimport sys\nprint('\\n'.join(sys.modules), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(done.stderr.split())


@pytest.mark.parametrize(
    "code",
    [
        "import feltmb",
        "import feltmb; dir(feltmb)",
        "from feltmb.cli import main\ntry:\n    main(['--help'])\nexcept SystemExit: pass",
    ],
)
def test_nothing_heavy(code):
    modules = loaded(code)
    assert not modules & set(HEAVY)
    assert "feltmb._core" not in modules


def test_a_mechanism_needs_no_tables_or_plots():
    modules = loaded("import feltmb; feltmb.load_action('steinway45')")
    assert not modules & {"pandas", "xarray", "matplotlib", "scipy", "h5netcdf", "rich"}


def test_a_diagnosis_starts_without_scipy():
    """Of its libraries only NumPy and pydantic (files) are imported at first."""
    modules = loaded("from feltmb import gap; gap.diagnose")
    late = {"numpy", "pydantic"}.symmetric_difference(HEAVY)
    assert not modules & late
    assert not {m for m in modules if m.startswith(("feltmb.mechanism", "feltmb.run"))}


def test_a_list_reads_no_mechanism():
    modules = loaded(
        "from feltmb.cli import main\ntry:\n    main(['list'])\nexcept SystemExit: pass"
    )
    assert "feltmb.params" in modules
    assert not modules & {"scipy", "pandas", "xarray", "matplotlib", "h5netcdf", "h5py", "jinja2"}
    assert not modules & {
        "feltmb.mechanism",
        "feltmb.fiber",
        "unmodeled.data",
        "feltmb.run.simulate",
    }


def test_functions_that_bear_the_name_of_their_module():
    """Whatever was imported first, feltmb.sweep is the function."""
    code = (
        "import feltmb.run.sweep\n"
        "from feltmb.action.touch import Touch\n"
        "import feltmb\n"
        "for f in (feltmb.sweep, feltmb.touch, feltmb.simulate, feltmb.regulate):\n"
        "    assert callable(f), f\n"
        "from feltmb import sweep\n"
        "assert callable(sweep)\n"
    )
    loaded(code)


def test_all_names_are_there():
    import feltmb

    for name in feltmb.__all__:
        assert getattr(feltmb, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = feltmb.nothing


def test_the_command_line_leaves_threads_of_the_blas_alone():
    """They wait for each other longer than they compute; who sets a number keeps it."""
    code = (
        "import os, sys, feltmb.cli\n"
        "try:\n    feltmb.cli.main(['--version'])\nexcept SystemExit:\n    pass\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'], os.environ['OMP_NUM_THREADS'])"
    )
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    out = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**environment, "OMP_NUM_THREADS": "3"},
    )
    assert out.stdout.split()[-2:] == ["1", "3"]


def test_fits_in_python_use_one_thread_of_the_blas():
    """NumPy is loaded there; the number is set back, and one that the user sets is kept."""
    code = (
        "import numpy, threadpoolctl\n"
        "from unmodeled.blas import one_thread\n"
        "def most(): return max(p['num_threads'] for p in threadpoolctl.threadpool_info())\n"
        "threadpoolctl.threadpool_limits(2)\n"
        "with one_thread():\n    print(most())\n"
        "print(most())"
    )
    free = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    for environment, inside in ((free, "1"), ({**free, "OMP_NUM_THREADS": "2"}, "2")):
        out = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
        )
        assert out.stdout.split() == [inside, "2"]


def test_fits_in_several_threads_set_the_number_back():
    """The limit is one of the process: the block that ends last must not keep it."""
    code = (
        "import threading, numpy, threadpoolctl\n"
        "from unmodeled.blas import one_thread\n"
        "def most(): return max(p['num_threads'] for p in threadpoolctl.threadpool_info())\n"
        "before = most()\n"
        "began, both = threading.Event(), threading.Event()\n"
        "def first():\n"
        "    with one_thread():\n        began.set(); both.wait()\n"
        "def second():\n"
        "    began.wait()\n"
        "    with one_thread():\n        both.set(); one.join()\n"
        "one, two = threading.Thread(target=first), threading.Thread(target=second)\n"
        "one.start(); two.start(); two.join()\n"
        "assert most() == before, (most(), before)\n"
        "with one_thread():\n"
        "    with one_thread():\n        assert most() == 1\n"
        "    assert most() == 1\n"
        "assert most() == before"
    )
    free = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=free)
    assert not done.returncode, done.stderr


def test_help_of_the_package_fits_two_screens():
    """In a process of its own, since names that were used before must not lengthen it."""
    script = (
        "import feltmb, pydoc; feltmb.simulate; feltmb.Run; "
        "print(len(pydoc.render_doc(feltmb).splitlines())); print('simulate' in dir(feltmb))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    lines, listed = done.stdout.split()
    assert int(lines) <= 100
    assert listed == "True"


def test_help_names_what_the_package_offers():
    words = set(re.findall(r"\w+", feltmb.__doc__))
    assert {name for name in feltmb.__all__ if not name.startswith("__")} <= words


def test_parts_for_other_models_are_public():
    assert {"adapters", "contact", "felt", "fiber", "gap"} <= set(feltmb.__all__)


def test_a_user_of_a_diagnosis_meets_few_names():
    """What only authors of models need is in models, results are in search.result."""
    assert len({*unmodeled.__all__, *unmodeled.fit.__all__, *unmodeled.data.__all__}) <= 60


def test_no_name_is_a_module_and_something_else():
    both = []
    for found in pkgutil.walk_packages(feltmb.__path__, "feltmb."):
        # Two libraries for other programs lie in the package and are no modules.
        if not found.name.endswith(("__main__", "_core_fmu", "libfeltmb_felt")):
            module = importlib.import_module(found.name)
            package, _, name = found.name.rpartition(".")
            if getattr(importlib.import_module(package), name) is not module:
                both.append(found.name)
    assert both == []


def test_parts_that_are_called_by_name_exist():
    """``lazy_import("module:name")``: no import tells that the function was moved."""
    places = [
        place
        for package in (feltmb, unmodeled)
        for path in Path(package.__file__).parent.rglob("*.py")
        for place in re.findall(r'\blazy_import\(\s*f?"([\w.]+:\w+)"\)', path.read_text("utf-8"))
    ]
    assert len(places) >= 4
    for place in places:
        assert lazy_import(place) is not None
