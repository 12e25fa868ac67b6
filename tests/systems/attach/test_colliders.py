"""Points of strands and the capsules that keep them out, in numbers."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from animtool.systems.attach.colliders import capsule_distances


def test_how_far_points_are_outside_a_capsule() -> None:
    """An axis of 4 m that is off all of the world's, and a radius of half a metre."""
    along = np.array([2.0, -1, 2]) / 3
    across = np.array([1.0, 2, 0]) / np.sqrt(5)
    start = np.array([1.0, 2, 3])
    ends = np.stack([start, start + 4 * along])
    points = start + np.array(
        [
            1.0 * along + 0.75 * across,  # beside it
            3.0 * along - 0.2 * across,  # within
            -2.0 * along,  # before its beginning
            5.5 * along,  # behind its end
            2.0 * along,  # on the axis
        ]
    )
    distances = capsule_distances(points, ends, 0.5)
    assert_allclose(distances, [0.25, -0.3, 1.5, 1.0, -0.5], atol=1e-12)


def test_a_capsule_without_length_is_a_ball() -> None:
    ends = np.array([[1.0, 2, 3], [1, 2, 3]])
    points = np.array([[1.0, 2, 5], [1, 2, 3]])
    assert_allclose(capsule_distances(points, ends, 0.5), [1.5, -0.5])
