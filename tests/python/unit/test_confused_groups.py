"""Effects that are taken for each other, as groups."""

import numpy as np
from feltmb.gap.confusion import confused_groups


def test_groups_hold_what_is_linked_directly_or_by_a_third():
    chance = np.zeros((6, 6))
    for i, j in ((0, 1), (1, 2), (3, 4)):
        chance[i, j] = chance[j, i] = 0.2
    chance[2, 5] = chance[5, 2] = 0.05  # told apart
    names = ["d", "b", "a", "c", "c", "e"]  # two shapes of c
    assert confused_groups(names, chance) == (("a", "b", "d"),)
    # What is not tested links, but is not told.
    assert confused_groups(["d", "", "a", "c", "c", "e"], chance) == (("a", "d"),)
    assert confused_groups([], np.zeros((0, 0))) == ()
