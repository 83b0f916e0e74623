"""Measured files: what is read, and what is said of files that cannot be used."""

import numpy as np
import pytest

import feltmb
from unmodeled.data import (
    Record,
)
from unmodeled.errors import DataError
from unmodeled.search.records import check_records


def test_the_input_of_a_mechanism_has_a_unit_too():
    from feltmb.adapters import mechanism_model

    model, _ = mechanism_model(feltmb.load_action("steinway45"))
    assert model.units["force"] == "N"
    time = np.arange(20) * 1e-3
    outputs = dict.fromkeys(model.outputs, time)
    record = Record(
        name="a", time=time, inputs={"force": time}, outputs=outputs, input_units={"force": "m"}
    )
    with pytest.raises(DataError, match="a: force is in m, in the model steinway45 in N"):
        check_records([record], model)
