"""Where a head is: by turns alone, and in frames that show too little of it."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from animtool.capture.face.poses import estimate_head_poses, last_good_poses
from animtool.maths import so3

FLAT = np.array(
    [[0.0, 0, 0], [0.1, 0, 0], [0, 0.07, 0], [0.03, 0.09, 0.004], [0.08, 0.05, -0.003]]
)


def test_a_mirrored_face_is_turned_and_never_mirrored() -> None:
    """What is nearly flat lies nearest to its mirror image without any turn."""
    shift = np.array([1.0, 2.0, 3.0])
    (pose,) = estimate_head_poses(FLAT, (FLAT * [1.0, 1.0, -1.0] + shift)[None])
    assert_allclose(np.linalg.norm(pose[:4]), 1.0)
    assert so3.angle_between(pose[:4], so3.IDENTITY) < 0.1
    assert_allclose(pose[4:], shift, atol=0.01)


def test_poses_are_exact_whatever_the_turn() -> None:
    turns = so3.exp(np.array([[0.0, 0, 0], [0.3, -2.0, 1.0], [0.0, 3.1, 0.0]]))
    points = so3.rotate(turns[:, None], FLAT[None]) + np.array([0.2, 1.6, -2.0])
    poses = estimate_head_poses(FLAT, points)
    assert so3.angle_between(poses[:, :4], turns).max() < 1e-6
    assert_allclose(poses[:, 4:], np.tile([0.2, 1.6, -2.0], (3, 1)), atol=1e-8)


def test_poses_are_held_and_the_first_good_one_before_it_too() -> None:
    poses = np.arange(6.0)[:, None] * np.ones(7)
    good = np.array([False, False, True, False, True, False])
    assert last_good_poses(poses, good)[:, 0].tolist() == [2, 2, 2, 2, 4, 4]
    assert last_good_poses(poses, ~good)[:, 0].tolist() == [0, 1, 1, 3, 3, 5]
    assert last_good_poses(poses, np.zeros(6, np.bool_))[:, 0].tolist() == [
        0,
        1,
        2,
        3,
        4,
        5,
    ]
