"""The ablation of decision thresholds: each is switched off where it is used, and restored."""

import dataclasses
import importlib
import inspect
import pkgutil

from click.testing import CliRunner

from blind.ablation import NEUTRAL, at_value, command
from feltmb import gap
from feltmb.errors import InvalidParameter
from feltmb.gap import Options, acceptance, criteria


def test_every_threshold_exists_and_has_another_value():
    options = {f.name for f in dataclasses.fields(Options)}
    for name, values in NEUTRAL.items():
        now = getattr(Options(), name) if name in options else getattr(criteria, name)
        assert now not in values, name


def test_a_threshold_is_replaced_where_it_is_used_and_restored():
    kept = acceptance.WALD
    with at_value("WALD", 0.0):
        assert acceptance.WALD == criteria.WALD == 0.0
    assert acceptance.WALD == criteria.WALD == kept > 0.0


def test_no_threshold_is_the_default_of_a_function():
    """Such a default would keep its value when the threshold is replaced."""
    values = {id(c.value) for c in criteria.CRITERIA}
    for found in pkgutil.iter_modules(gap.__path__, "feltmb.gap."):
        module = importlib.import_module(found.name)
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ != found.name:
                continue
            defaults = inspect.signature(function).parameters.values()
            kept = [p.name for p in defaults if id(p.default) in values]
            assert not kept, f"{found.name}.{name}: {kept}"


def test_a_folder_that_is_no_bench_is_refused(tmp_path):
    found = CliRunner().invoke(command, [str(tmp_path)])
    assert isinstance(found.exception, InvalidParameter)
    assert "is no bench" in str(found.exception)
