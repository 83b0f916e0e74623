"""The check of arguments by their annotations."""

import math

import numpy as np
import pytest

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter


def test_the_sequences_of_numbers_are_finite():
    @checked
    def take(values: "Sequence[float]"):  # noqa: F821
        return values

    assert take([1.0, 2]) == [1.0, 2]
    assert take(np.array([1.0, 2.0])).tolist() == [1.0, 2.0]
    with pytest.raises(InvalidParameter, match=r"take: values\[1\]: got nan, expected a finite"):
        take([1.0, math.nan])
    with pytest.raises(InvalidParameter, match=r"values\[0\]: got inf"):
        take(np.array([np.inf]))
