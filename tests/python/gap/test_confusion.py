"""The probability of confusion against counts over simulated records of a linear model."""

import numpy as np
import pytest

from feltmb.gap.confusion import confusion, confusion_if_detected
from feltmb.gap.criteria import DETECTABLE
from feltmb.gap.score import set_evidence

DRAWS = 4000


def counted(strength, rho, scale):
    """Predicted probability, and the share of records whose evidence prefers the wrong cause.

    A parameter has the third direction and is projected out. ``scale``: of the rival's magnitude.
    """
    parameter = np.array([0.0, 0.0, 1.0])
    a = strength * np.array([1.0, 0.0, 0.5])
    b = scale * strength * np.array([rho, np.sqrt(1.0 - rho**2), -0.3])
    columns = np.column_stack([a, b])
    left = columns - np.outer(parameter, parameter @ columns)
    gram = left.T @ left
    generator = np.random.default_rng(1)
    wrong = 0
    for _ in range(DRAWS):
        signal = left.T @ (a + 7.0 * parameter + generator.standard_normal(3))
        own, other = (
            set_evidence(
                signal[[i]], gram[np.ix_([i], [i])], signal[[i]] / gram[i, i], inflation=1.0
            )
            for i in (0, 1)
        )
        wrong += other > own
    return confusion(gram, np.ones(2))[0, 1], wrong / DRAWS


@pytest.mark.parametrize("rho", [0.0, 0.7, -0.9, 0.97])
@pytest.mark.parametrize("strength", [1.5, 3.7, 6.0])
def test_it_is_how_often_the_evidence_prefers_the_wrong_cause(strength, rho):
    predicted, share = counted(strength, rho, scale=1.0)
    assert share == pytest.approx(predicted, abs=4.0 * np.sqrt(predicted / DRAWS) + 1e-3)


def test_a_rival_with_a_small_scale_is_confused_as_often():
    """Its prior is as wide as its magnitude, so that it imitates the cause with 30 scales."""
    predicted, share = counted(6.0, 0.9, scale=1.0 / 30.0)
    assert share == pytest.approx(predicted, abs=0.015)
    assert predicted == pytest.approx(counted(6.0, 0.9, scale=1.0)[0])


def test_limits():
    same = np.array([[9.0, -9.0], [-9.0, 9.0]])
    assert confusion(same, np.array([2.0, 2.0])) == pytest.approx(np.full((2, 2), 0.5))
    apart = np.diag([100.0, 100.0])
    assert confusion(apart, np.ones(2))[0, 1] < 1e-10
    assert confusion(apart, np.zeros(2))[0, 1] == 0.5  # nothing to see


def test_weak_effects_are_compared_where_they_are_detectable():
    gram = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]])
    found = confusion_if_detected(gram, np.array([0.1, 10.0, 1.0]))
    assert found[0, 1] == confusion(gram, np.array([DETECTABLE, 0.0, 0.0]))[0, 1]
    assert found[1, 0] == confusion(gram, np.array([0.0, 10.0, 0.0]))[1, 0]
    assert not found[2].any()  # no signature
    assert not found[:, 2].any()
