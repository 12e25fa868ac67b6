"""Places and pixels that float64 does not hold."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.capture.cameras.camera import Camera, pixel_rays, project

NONE, LENS = (0.0,) * 8, (0.1, 0.01, 0.001, 0.001, 0.01, 0.0, 0.0, 0.0)


def camera(distortion: tuple[float, ...]) -> Camera:
    return Camera(
        *("a", (100.0, 100.0), (50.0, 40.0), np.eye(3), np.zeros(3)),
        distortion=distortion,
    )


@pytest.mark.parametrize("lens", [NONE, LENS], ids=["none", "a lens"])
def test_a_point_whose_pixel_overflows_is_on_no_image(lens: tuple[float, ...]) -> None:
    points = np.array([[0.0, 0.0, 2.0], [1e300, 0.0, 1e-300], [1e308, 1e308, 1.0]])
    seen = project(camera(lens), points)
    assert np.isfinite(seen).all(axis=1).tolist() == [True, False, False]
    assert np.isnan(seen[1:]).all()


def test_a_pixel_that_overflows_has_no_ray() -> None:
    pixels = np.array([[50.0, 40.0], [1e308, 1e308], [-1e300, 40.0]])
    found = pixel_rays(camera(LENS), pixels)
    assert np.isfinite(found).all(axis=1).tolist() == [True, False, False]
    assert np.isnan(found[1:]).all()
