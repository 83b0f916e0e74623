"""Noise of inputs and parts of records, by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Parameter, diagnose
from unmodeled.search.options import Options
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.variation import MODES, _changes, _with, varies, with_variation

from .conftest import SIGMA, spring_record


def prepared(spring, **what):
    record = replace(spring_record("fit", 2), **what)
    return prepare(ready_records(spring, [record]), (), (), Options())


def test_the_knots_of_the_noise_of_an_input_add_up_to_its_size():
    record = replace(spring_record("fit", 2), input_sigma={"x": 1e-3})
    changes = _changes(record)
    assert len(changes) == record.samples // 2
    total = sum(c["x"] for c in changes)
    assert total == pytest.approx(np.full(record.samples, total[0]))
    assert total[0] > 0.0
    assert _changes(replace(record, input_sigma={"x": 0.0})) == []


def test_the_modes_have_the_covariance_of_the_patterns(spring):
    (observed,) = prepared(spring).fit
    n = observed.record.samples
    patterns = np.random.default_rng(0).standard_normal((n, 1, 3))
    found = _with(observed, patterns)
    assert [(q.kind, q.index) for q in found.local] == [("mode", j) for j in range(3)]
    one, two = found.modes.reshape(n, 3), patterns.reshape(n, 3)
    assert one @ one.T == pytest.approx(two @ two.T)
    small = 0.2 * SIGMA * patterns / np.linalg.norm(patterns)  # below the noise of all samples
    assert _with(observed, small).modes.shape == (n, 1, 0)
    many = np.random.default_rng(1).standard_normal((n, 1, 40))
    assert _with(observed, many).modes.shape == (n, 1, MODES)
    assert _with(observed, 0.0 * patterns) is observed


def test_a_parameter_that_varies_is_an_unknown_of_each_record(spring):
    assert not varies(prepared(spring))
    assert varies(prepared(spring, input_sigma={"x": 1e-3}))
    model = spring.with_parameters(
        {"k": Parameter(name="k", value=95.0, sd=10.0, unit="N/m", process_sd=2.0)}
    )
    problem = prepared(model)
    assert varies(problem)
    (observed,) = with_variation(problem).fit
    # The output is k x.
    column = 2.0 * observed.record.inputs["x"]
    assert np.abs(observed.modes[:, 0, 0]) == pytest.approx(np.abs(column), abs=1e-9)
    again = with_variation(with_variation(problem)).fit[0]
    assert len(again.local) == len(observed.local)


def test_a_first_part_of_a_record_has_its_share_of_the_samples(spring):
    (observed,) = prepared(spring).fit
    n = observed.record.samples
    part = observed.first(0.25)
    assert n / 4 - 2 <= part.record.samples <= n / 4 + 2
    assert len(part.measured) == len(part.valid) == len(part.sd) == part.record.samples
    assert observed.first(1e-3).record.samples == 10
    assert observed.first(1.0) is observed


@pytest.mark.parametrize(("hardening", "named"), [(0.0, []), (3000.0, ["hardening"])])
def test_the_noise_of_an_input_is_no_cause_and_hides_none(spring, causes, hardening, named):
    """A displacement that is known to 2 mm moves the force by four times its noise."""
    records = []
    for k in (2, 3, 5):
        record = spring_record(str(k), k, hardening=hardening)
        x = record.inputs["x"] + 2e-3 * np.random.default_rng(k).standard_normal(record.samples)
        records.append(replace(record, inputs={"x": x}, input_sigma={"x": 2e-3}))
    result = diagnose(spring, causes, records)
    assert [n.cause for n in result.named] == named
    assert result.classes == ()
    assert result.complete
