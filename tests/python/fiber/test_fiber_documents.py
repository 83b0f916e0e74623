"""The commands and the example of docs/explanation/fiber.md run as printed."""

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from feltmb.cli.fiber import fiber
from feltmb.fiber import pressure

DOCS = Path(__file__).resolve().parents[3] / "docs"
TEXT = (DOCS / "explanation" / "fiber.md").read_text(encoding="utf-8")
COMMANDS = [
    shlex.split(re.sub(r"   .*", "", line))[2:]
    for line in TEXT.splitlines()
    if line.startswith("feltmb fiber ")
]


def test_python_example_runs():
    for block in re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL):
        exec(compile(block, "docs/explanation/fiber.md", "exec"), {})


def test_every_command_is_shown():
    assert {c[0] for c in COMMANDS} == set(fiber.commands)


@pytest.mark.parametrize(
    "arguments",
    [pytest.param(c, marks=pytest.mark.slow if c[0] == "simulate" else ()) for c in COMMANDS],
    ids=lambda c: c[0],
)
def test_command_runs(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [
        f"{v / 1000},{pressure('binomial', v / 1000, K_p=4e6, gamma=1.3, v_f0=0.13) / 1e3}"
        for v in range(130, 330, 10)
    ]
    Path("test.csv").write_text("v_f [-],pressure [kPa]\n" + "\n".join(rows) + "\n")
    Path("path.csv").write_text("time [s],strain [-]\n0,0\n1,0.3\n2,0.1\n")
    result = CliRunner().invoke(fiber, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
