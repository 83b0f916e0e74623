"""Signs of errors of sensors and inputs: one convention in both libraries."""

import numpy as np
import pytest

from feltmb import load_action
from feltmb.adapters.changes import InputError, SensorError
from feltmb.adapters.effects import excite_by, observe_by
from feltmb.adapters.library import load_library
from unmodeled import library
from unmodeled.data import Record
from unmodeled.errors import InvalidParameter

TIME = np.linspace(0.0, 1.0, 1001)


def _truth(time):
    return 5.0 + 2.0 * np.sin(9.0 * time)


READINGS = {
    "gain": (0.02, 1.02 * _truth(TIME)),
    "offset": (0.05, _truth(TIME) + 0.05),
    "delay": (0.003, _truth(TIME - 0.003)),
}


def _input_record(values):
    return Record(name="r", time=TIME, inputs={"f": values}, outputs={"f": values})


@pytest.mark.parametrize("error", list(READINGS))
def test_an_input_is_taken_back_to_what_acted_by_both_libraries(error):
    """5.1 N shown with a gain of +0.02 are 5.0 N; the same for offset and delay."""
    size, reading = READINGS[error]
    record = _input_record(reading)
    generic = {
        "gain": library.input_fault("f", "gain"),
        "offset": library.input_fault("f", "offset", unit="N", scale=1.0),
        "delay": library.input_fault("f", "delay", scale=1.0),
    }[error]
    mechanical = excite_by(InputError(kind=error))
    inside = slice(10, -10)
    for excite in (generic.excite, mechanical):
        found = excite(record, size, None)["f"]
        assert found[inside] == pytest.approx(_truth(TIME)[inside], abs=1e-4)


@pytest.mark.parametrize("error", list(READINGS))
def test_a_sensor_and_an_input_have_the_same_signs(error):
    """What a sensor of the size makes of a truth, an input of the size takes back."""
    size, reading = READINGS[error]
    record = _input_record(reading)
    sensor = {
        "gain": library.sensor_fault(["f"], "f", "gain"),
        "offset": library.sensor_fault(["f"], "f", "offset", unit="N", scale=1.0),
        "delay": library.sensor_fault(["f"], "f", "delay", scale=1.0),
    }[error]
    truth = _truth(TIME)[None, :, None]
    mechanical = observe_by(SensorError(kind=error, channels="f"), ["f"], {})
    for observe in (sensor.observe, mechanical):
        shown = observe(record, truth, np.array([size]), None)[0, :, 0]
        assert shown[10:-10] == pytest.approx(reading[10:-10], abs=1e-5)


def test_the_library_refuses_a_tilt_of_an_input(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'schema = 1\nname = "own"\nextends = "mechanism"\n'
        '[effects.bent]\ncomponent = "c"\nmechanism = "m"\nkind = "input"\nsize = 0.1\n'
        'input = { kind = "tilt" }\n'
    )
    with pytest.raises(InvalidParameter, match=r"effects\.bent\.input\.kind"):
        load_library(load_action("steinway45"), path)
