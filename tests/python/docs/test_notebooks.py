"""The notebooks of the manual run from top to bottom."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells(file, kind):
    found = json.loads(file.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in found if cell["cell_type"] == kind]


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_notebook_is_kept_without_outputs_and_says_what_it_is(file):
    assert all(cell["outputs"] == [] for cell in cells(file, "code"))
    assert cells(file, "markdown")[0]["source"][0].startswith("# ")


def test_notebook_installs_the_package_only_where_it_is_not(monkeypatch):
    """In Colab; elsewhere the cell does nothing."""
    (file,) = [f for f in NOTEBOOKS if f.stem == "diagnosis_of_a_model"]
    first, called = "".join(cells(file, "code")[0]["source"]), []
    monkeypatch.setattr("subprocess.run", lambda command, **_: called.append(command[1:]))
    exec(compile(first, str(file), "exec"), {})
    assert called == []
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    exec(compile(first, str(file), "exec"), {})
    assert called == [["-m", "pip", "install", "-q", "unmodeled"]]


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda f: f.stem)
def test_notebook_runs(file, tmp_path, monkeypatch):
    if "dask" in file.stem:
        pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FELTMB_ROOT", str(ROOT))
    scope = {"__name__": "__main__"}
    for cell in cells(file, "code"):
        exec(compile("".join(cell["source"]), str(file), "exec"), scope)
    if file.stem == "diagnosis_of_a_model":
        assert [c.cause for c in scope["report"].named] == ["dry friction x"]
    if file.stem == "strokes_and_regulation":
        assert scope["result"].converged
    if file.stem == "sweep_with_dask":
        assert dict(scope["data"].sizes)["stroke"] == 2
        assert scope["swept"].failed.empty
