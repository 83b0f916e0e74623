"""Signs of errors of inputs in the blind bench: those of the libraries."""

import numpy as np
import pytest

from blind.key_hammer import SAMPLE_TIME, KeyHammer, effects
from blind.truth import STROKES, Part, plain_case
from blind.truth_sensors import recorded_input
from unmodeled.chain import true_value
from unmodeled.data import Record
from unmodeled.fit import Candidate, Jobs


@pytest.mark.parametrize("mode", ["force", "motion"])
@pytest.mark.parametrize("form", ["A", "B"])
@pytest.mark.parametrize(("error", "size"), [("gain", 0.05), ("offset", 0.2), ("delay", 1e-3)])
def test_the_blind_generator_misreads_inputs_with_the_same_signs(mode, form, error, size):
    fine = np.arange(20001) * 2e-5
    frames = np.arange(20, 700) * SAMPLE_TIME
    part = Part(f"input_{error}", form, size, 0.0)
    shown = recorded_input(plain_case(mode, [part]), STROKES[0], fine, frames)
    truth = recorded_input(plain_case(mode), STROKES[0], fine, frames)
    unit = 1e-3 if mode == "motion" and error == "offset" else 1.0
    record = Record(name="r", time=frames, inputs={"u": shown}, outputs={"y": shown})
    back = true_value(record, shown, {error: unit * size}, "smooth")
    # Form B is another function of the same mean sign and about the same size.
    left, wrong = np.abs(back - truth)[20:-20], np.abs(shown - truth)[20:-20]
    assert np.max(left) < (0.02 if form == "A" else 0.5) * np.max(wrong)


@pytest.mark.parametrize(("error", "size"), [("gain", 0.05), ("offset", 0.2), ("delay", 2e-3)])
def test_the_model_of_the_blind_bench_reads_inputs_with_the_same_signs(error, size):
    """A record with an error, and the error in the model, are the motion without either."""
    model = KeyHammer()
    time = np.arange(400) * SAMPLE_TIME
    truth = 3.0 * np.sin(30.0 * time) ** 2
    shown = {
        "gain": (1.0 + size) * truth,
        "offset": truth + size,
        "delay": 3.0 * np.sin(30.0 * (time - size)) ** 2,
    }[error]
    effect = next(e for e in effects() if e.name == f"input_{error}")
    zero = np.full(time.size, np.nan)

    def motion(values, with_effect):
        record = Record(
            name="r", time=time, inputs={"finger": values}, outputs={"key": zero, "hammer": zero}
        )
        included = (Candidate(effect),) if with_effect else ()
        jobs = Jobs(
            theta=np.array([[p.value for p in model.parameters]]),
            starts=np.zeros((1, len(model.states(included)))),
            included=included,
            magnitudes=np.array([[size]] if with_effect else [[]]),
        )
        return model.simulate(record, jobs)[0]

    plain, taken_back, misread = motion(truth, 0), motion(shown, 1), motion(shown, 0)
    wrong = np.max(np.abs(misread - plain)[:200])
    assert wrong > 1e-5
    assert np.max(np.abs(taken_back - plain)[:200]) < 0.02 * wrong
