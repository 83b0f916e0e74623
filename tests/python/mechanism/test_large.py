"""Large mechanisms: rest pose and check in a bounded number of steps."""

import numpy as np
import pytest

import feltmb


def chain(count, **more):
    return {
        "schema": 1,
        "name": "chain",
        "bodies": {
            f"b{i}": {
                "parent": f"b{i - 1}" if i else "ground",
                "coordinate": f"q{i}",
                "position": [0.0, -0.1] if i else [0.0, 0.0],
                "angle": 0.05 if i else 0.3,
                "mass": 0.1,
                "center_of_mass": [0.0, -0.05],
                "inertia": 1e-4,
            }
            for i in range(count)
        },
        **more,
    }


@pytest.mark.parametrize("sprung", [False, True])
@pytest.mark.parametrize("count", [25, 60])
def test_chains_come_to_rest_in_some_hundred_steps(count, sprung):
    # steps that the softest direction held up: 20000 for 100 bodies, and no rest then
    springs = {
        f"s{i}": {"coordinate": f"q{i}", "stiffness": 2.0, "rest_angle": 0.1} for i in range(count)
    }
    action = feltmb.Action(chain(count, **({"springs": springs} if sprung else {})))
    assert action.rest_iterations < 8 * count
    if not sprung:  # it hangs straight down
        turns = np.cumsum(action.rest_pose) + 0.3 + 0.05 * np.arange(count)
        np.testing.assert_allclose(turns, 0.0, atol=1e-9)


def test_thousands_of_points_are_checked_in_one_pass():
    # each name was counted in all of them: 2.7 s for 4000 points, and 60 times that for these
    from feltmb.mechanism.checking import output_faults

    outputs = [f"p{i}.{axis}" for i in range(30_000) for axis in ("x", "y", "vx", "vy")]
    assert output_faults(outputs) == []
    told = output_faults([*outputs, "p1.x", "time", "x/y.x", "x/y.y", "x/y.vx"])
    assert len(told) == 5
