"""The examples of docs/explanation/felt.md run as they stand."""

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[3] / "docs" / "explanation" / "felt.md"


def test_examples_run(capsys):
    text = DOCS.read_text(encoding="utf-8")
    scope = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(block, "felt.md", "exec"), scope)
    assert scope["action"].config.contacts["06"].law == "felt_memory"
    assert "unloading lies above loading" in capsys.readouterr().out


def test_pictures_exist():
    for name in re.findall(r"\]\((\.\./img/[^)]+)\)", DOCS.read_text(encoding="utf-8")):
        assert (DOCS.parent / name).is_file()
