"""Options of a run: the same limits in every function and command."""

import math

import pytest
from calls import refused
from click.testing import CliRunner

import feltmb
from feltmb.cli import cli
from feltmb.run.batch import simulate_many
from feltmb.run.stroke import load_stroke

WRONG = [
    (name, value)
    for name, values in {
        "max_wall": (0, -1.0, math.nan, math.inf, "1", True, 10**400),
        "max_step": (0.0, -1e-3, math.nan, math.inf, "1"),
        "max_order": (0, -1, 6, 1.5, math.nan, "2", True),
    }.items()
    for value in values
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_limits_are_refused_alike_everywhere(pendulum, name, value):
    stroke = load_stroke("staccato")
    options = {name: value}
    refused(lambda: feltmb.simulate(pendulum, stroke, 0.001, **options), name)
    refused(lambda: simulate_many([(pendulum, stroke)], lambda *_: True, **options), name)
    refused(lambda: feltmb.sweep(pendulum, stroke, {}, options=options, progress=False), name)
    if value != 10**400:  # that is refused by the sweep as a whole
        found = feltmb.sweep(pendulum, stroke, {f"options.{name}": [value]}, progress=False)
        assert found.table["status"].tolist() == ["failed"]
        assert name in found.table["error"][0]


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_limits_of_the_command_line(value):
    done = CliRunner().invoke(cli, ["stroke", "steinway45", "piano", "--max-wall", value])
    assert done.exit_code == 2
    assert "--max-wall" in done.output


def test_unknown_options_of_a_batch_are_told(pendulum):
    # TypeError in a thread
    stroke = load_stroke("staccato")
    refused(lambda: simulate_many([(pendulum, stroke)], lambda *_: True, rtoll=1), "rtoll")
