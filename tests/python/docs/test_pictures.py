"""Pictures of the documentation."""

import importlib
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_every_picture_of_the_docs_is_drawn_by_a_command(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    drawn = importlib.import_module("make_pictures").PICTURES
    benched = {"cost_against_size.png", "peers.png"}  # bench/README.md
    kept = {path.name for path in (ROOT / "docs" / "img").glob("*.png")}
    assert kept == set(drawn) | benched
    shown = "".join(p.read_text() for p in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
    assert all(f"img/{name}" in shown for name in kept)
