"""Completion in the shell: names of packaged data, of laws and of effects."""

import pytest
from click.shell_completion import BashComplete

from feltmb.cli import cli


def completed(line, monkeypatch):
    """What bash would offer for the last word of a line."""
    words = line.split(" ")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    complete = BashComplete(cli, {}, "feltmb", "_FELTMB_COMPLETE")
    return [item.value for item in complete.get_completions(words[1:-1], words[-1])]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("feltmb stroke steinway45_f", ["steinway45_felt", "steinway45_felt_hammer"]),
        ("feltmb stroke steinway45 fo", ["forte", "forte_finger"]),
        ("feltmb stroke steinway45 --actuator al", ["aluminum"]),
        ("feltmb study wire", ["wire", "wire_vibration"]),
        ("feltmb regulate steinway45 --targets steinway45_s", ["steinway45_shipped"]),
        ("feltmb felt show synthetic_h", ["synthetic_hammer"]),
        ("feltmb fiber pressure van", ["van_wyk"]),
        ("feltmb gap diagnose steinway45 a.csv --include coulomb_friction.w", None),
        ("feltmb gap diagnose own.py a.csv --include coulomb", []),
    ],
)
def test_names_are_completed(line, wanted, monkeypatch):
    found = completed(line, monkeypatch)
    if "--include" in line:
        assert found == (["coulomb_friction.whippen"] if wanted is None else wanted)
        return
    # The word itself stands for files: shells list them where no name fits.
    assert found == [line.split(" ")[-1], *wanted]
