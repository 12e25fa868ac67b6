from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from animtool.rig.shapes import combined_weights


def test_a_product_is_added_to_the_own_weight() -> None:
    own = [np.array([0.5, 1.0]), np.array([0.4]), np.array([0.1])]
    made = combined_weights(own, [(), (), (0, 1)])
    assert_array_equal(made[2], 0.1 + np.array([0.5, 1.0]) * 0.4)
    assert made[0] is own[0]


def test_a_combined_shape_may_drive_a_later_one() -> None:
    own = [np.array([0.5]), np.array([0.5]), np.zeros(1), np.zeros(1)]
    made = combined_weights(own, [(), (), (0, 1), (0, 2)])
    assert made[3].tolist() == [0.125]
