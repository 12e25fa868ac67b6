from __future__ import annotations

import numpy as np
import pytest

from animtool.preview.pictures.camera import VIEW_ANGLES, Bounds, CameraView

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("preset", VIEW_ANGLES)
@pytest.mark.parametrize(("wide", "high"), [(960, 540), (300, 500), (400, 400)])
@pytest.mark.parametrize("inset", [0, 90])
def test_what_is_framed_is_in_the_picture_beneath_the_text(
    preset: str, wide: int, high: int, inset: int
) -> None:
    points = RNG.normal(size=(40, 3)) * [1.0, 2.0, 0.4] + [3.0, 1.0, -2.0]
    box = Bounds()
    box.add(points)
    view = CameraView(wide, high, inset)
    view.yaw, view.pitch = VIEW_ANGLES[preset]
    view.frame_bounds(box)
    clip = (
        np.column_stack([points, np.ones(len(points))])
        @ view.eye_matrices().view_projection.T
    )
    flat = clip[:, :2] / clip[:, 3:]
    pixels = (flat * [1, -1] + 1) / 2 * [wide, high]
    assert (clip[:, 3] > 0).all()
    assert pixels[:, 0].min() > 0
    assert pixels[:, 0].max() < wide
    assert pixels[:, 1].min() > inset
    assert pixels[:, 1].max() < high
    # It fills more than a third of what is free.
    assert max(np.ptp(pixels, axis=0) / [wide, high - inset]) > 1 / 3


def test_a_camera_goes_along_level() -> None:
    view = CameraView(100, 100, is_following=True)
    view.follow_position(np.zeros(3))
    before = view.target
    view.follow_position(np.array([1.0, 5.0, -2.0]))
    np.testing.assert_allclose(view.target - before, [1.0, 0.0, -2.0])


def test_depths_of_a_part_of_the_range() -> None:
    view = CameraView(100, 100)
    points = np.column_stack([RNG.normal(size=(20, 3)), np.ones(20)])
    eye = view.eye_matrices()
    clip, near = (
        points @ e.view_projection.T for e in (eye, eye.with_depth_range(0.0, 0.1))
    )
    np.testing.assert_allclose(clip[:, [0, 1, 3]], near[:, [0, 1, 3]])
    depth, own = ((c[:, 2] / c[:, 3] + 1) / 2 for c in (clip, near))
    np.testing.assert_allclose(own, depth * 0.1, atol=1e-12)
