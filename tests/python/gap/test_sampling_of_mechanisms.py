"""No adapter moves a signal in time: outputs that are the inputs, and a lag that is known."""

import numpy as np
import pytest

import feltmb
import unmodeled
from feltmb.adapters import mechanism_model
from unmodeled.data import Record
from unmodeled.fit.observe import observe
from unmodeled.models import Candidate


def clock(even, samples=80, interval=0.01):
    time = interval * np.arange(samples)
    return time if even else time + 0.3 * interval * np.sin(40.0 * time)


def readings(model, of, *included):
    chosen = tuple(Candidate(e, e.shapes[0]) for e, _ in included)
    sizes = np.array([size for _, size in included])
    theta = np.array([p.value for p in model.parameters])
    return observe(model, of, theta, np.zeros(len(model.states())), chosen, sizes)


@pytest.mark.parametrize("even", [True, False])
def test_a_mechanism_takes_the_same_sample(rigid, even):
    """The force of the finger is an input and an output."""
    model, effects = mechanism_model(
        rigid, channels=["finger.force"], effects=["input_delay"], tolerances=[], workers=1
    )
    time = clock(even, 60, 1e-3)
    force = 5.0 * np.sin(40.0 * time) ** 2
    given = Record(
        name="r", time=time, inputs={"force": force}, outputs={"finger.force": np.zeros(60)}
    )
    room = 1e-9 if even else 2e-5  # interpolated between the outputs of an even clock
    seen = readings(model, given)[:, 0]
    assert np.max(np.abs(seen - force)) < room
    [delay] = effects
    late = 0.7e-3
    seen = readings(model, given, (delay, -late))[:, 0]
    shift = np.where(time > late, time - late, 0.0)
    assert np.max(np.abs(seen - 5.0 * np.sin(40.0 * shift) ** 2)[3:-3]) < 2e-4


@pytest.mark.parametrize(
    ("drive", "shown"), [("force", "finger.force"), ("key_motion", "finger.displacement")]
)
def test_an_exported_fmu_shows_its_input_at_once(rigid, tmp_path, drive, shown):
    """A held force is its own output; a motion is reached at the end of a step."""
    pytest.importorskip("fmpy")
    path = feltmb.export_fmu(rigid, tmp_path / "own.fmu", drive=drive, parameters=["gravity.*"])
    model = unmodeled.fmu(path, parameters=[], inputs=[drive], outputs=[shown], workers=1)
    time = clock(True, 60, 1e-3)
    size = 5.0 if drive == "force" else 2e-3
    values = size * np.sin(40.0 * time) ** 2
    given = Record(name="r", time=time, inputs={drive: values}, outputs={shown: 0.0 * time})
    seen = readings(model, given)[:, 0]
    assert np.max(np.abs(seen - values)) < 1e-4 * size
