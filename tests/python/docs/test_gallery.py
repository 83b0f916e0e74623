"""Every example of the gallery: its number by other means, and as the page shows it."""

import importlib
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "examples" / "gallery"
PAGE = (ROOT / "docs" / "tutorials" / "gallery.md").read_text(encoding="utf-8")
EXAMPLES = sorted(p.stem for p in FOLDER.glob("*.py") if p.stem != "show")


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_number_of_an_example_holds(name, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    for module in ("show", name):
        monkeypatch.delitem(sys.modules, module, raising=False)
    found = importlib.import_module(name).compute()
    assert len(found.checks) >= 1
    assert found.faults() == []
    title = name.replace("_", " ").capitalize()
    section = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    shown = re.search(r"^\*\*.*: (\S+)( .*)?\*\*$", section, re.MULTILINE)
    assert shown is not None
    assert float(shown.group(1)) == pytest.approx(found.value, rel=2e-3)
    assert (ROOT / "docs" / f"img/gallery/{name}.png").is_file()


def test_a_wrong_number_is_found(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.delitem(sys.modules, "show", raising=False)
    found = importlib.import_module("show").Found("force", 1.0, "N")
    found.check("force [N]", 1.0, 1.1, 1e-3)
    assert found.faults() == ["force [N]: 1, expected 1.1 to 0.001"]
